"""`pc-ground`: the light client. What it does lives in the module of each command."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from contract.errors import PointclickError
from ground import click
from ground.web import command as web


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; returns its exit status. argparse itself exits with 2 on wrong arguments."""
    parser = argparse.ArgumentParser(prog="pc-ground", description="Where is the thing in this pixel?")
    commands = parser.add_subparsers(dest="command", required=True)
    adding = commands.add_parser("click", help="a pixel's position on the ground")
    click.add_arguments(adding)
    adding.set_defaults(run=click.run)
    adding = commands.add_parser("web", help="a page with the pictures to click, a map and pins")
    web.add_arguments(adding)
    adding.set_defaults(run=web.run)
    args = parser.parse_args([_shielded(a) for a in (sys.argv[1:] if argv is None else argv)])
    try:
        return int(args.run(args))
    except PointclickError as error:
        print(f"pc-ground: error: {error}", file=sys.stderr)
        return click.WRONG_USAGE


def _shielded(argument: str) -> str:
    """A negative number with a space before it, which keeps argparse from taking it (-1e3, -3.) for an option."""
    if argument.startswith("-"):
        try:
            float(argument)
        except ValueError:
            return argument
        return f" {argument}"
    return argument


if __name__ == "__main__":
    sys.exit(main())
