"""`pc-ground`: the light client. What it does lives in the module of each command, imported when it is asked for."""

from __future__ import annotations

import argparse
import errno
import importlib
import os
import sys
from collections.abc import Sequence
from typing import Any, NoReturn

from contract.errors import PointclickError
from contract.near_word import in_usage, options_of

PROGRAM = "pc-ground"
WRONG_USAGE, INTERRUPTED = 2, 130

# By name: the module with add_arguments(parser), run(args) and, perhaps, EXAMPLES; and what it is for. A module is
# named and not imported: the commands are built on this package, and most of them are not asked for.
COMMANDS = {
    "open": ("ground.web.open_command", "your own flight in the browser: video and log, photographs, or a session"),
    "live": ("ground.web.live_command", "the downlink's video and the radio's telemetry, on this machine"),
    "click": ("ground.commands.click", "a pixel's position on the ground"),
    "track": ("ground.commands.track", "follow what is at a pixel: where it goes, how fast and where to"),
    "look": ("ground.commands.look", "have the camera look at what is at a pixel, where that is allowed"),
    "vehicles": ("ground.commands.vehicles", "which aircraft are there, and how they are"),
    "watch": ("ground.commands.watch", "a live table of the aircraft"),
    "measure": ("ground.commands.measure", "distance, bearing and height difference between two pixels"),
    "pins": ("ground.commands.pins", "keep, list, export and import pins"),
    "cot": ("ground.commands.cot", "send pins and aircraft to TAK as Cursor on Target"),
    "accuracy": ("ground.commands.accuracy", "how far clicks on surveyed marks are from them"),
    "web": ("ground.web.command", "a page with the pictures to click, a map and pins"),
    "mavlink": ("ground.commands.mavlink", "a MAVLink camera: clicks in QGroundControl's video are answered"),
    "router": ("ground.commands.router", "a router for many aircraft and people, with certificates and rights"),
    "seen": ("ground.commands.seen", "which ground was seen, when, how often, how finely; and the gaps"),
    "spots": (
        "ground.commands.spots",
        "hot spots of thermal pictures as things: where, how hot, how they move",
    ),
    "record": ("ground.commands.record", "keep what the link delivers as a recording"),
    "completion": ("ground.commands.completion", "completion of these commands for a shell"),
}


class Parser(argparse.ArgumentParser):
    """Wrong usage is one line, as every other error."""

    def error(self, message: str) -> NoReturn:
        self.exit(
            WRONG_USAGE,
            f"{PROGRAM}: error: {in_usage(' '.join(message.split()), options_of(self))} (see {self.prog} --help)\n",
        )


class Version(argparse.Action):
    """`--version`, looked up only when it is asked for."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        """Print it and exit."""
        from contract.version import version_line  # noqa: PLC0415

        print(version_line(PROGRAM))
        parser.exit(0)


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; returns its exit status. Wrong arguments exit with 2."""
    try:
        try:
            return _run(argv)
        finally:
            sys.stdout.flush()  # here, where an error can be reported, and not by the interpreter at its end
    except BrokenPipeError:
        _drop_output()  # the reader has closed the pipe, as `head` does
        return 1
    except OSError as error:
        if not _is_output_lost(error):
            raise
        _drop_output()
        print(f"{PROGRAM}: error: the output cannot be written: {error.strerror}", file=sys.stderr)
        return WRONG_USAGE


def _run(argv: Sequence[str] | None) -> int:
    words = [_shielded(a) for a in (sys.argv[1:] if argv is None else argv)]
    named = next((word for word in words if not word.startswith("-")), None)
    parser = parser_of([named] if named in COMMANDS else [])
    args = parser.parse_args(words)
    try:
        return int(_module(args.command).run(args))
    except PointclickError as error:
        print(f"{PROGRAM}: error: {error}", file=sys.stderr)
        return WRONG_USAGE
    except KeyboardInterrupt:
        return INTERRUPTED


def _is_output_lost(error: OSError) -> bool:
    """Return whether an error is of writing to a full or broken standard output: files of ours have names in theirs."""
    return error.filename is None and error.errno in (errno.ENOSPC, errno.EIO, errno.EDQUOT, errno.EFBIG)


def _drop_output() -> None:
    """Discard the output still to be written: Python must not complain when it flushes at the end."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, sys.stdout.fileno())
    os.close(nowhere)


def parser_of(commands: Sequence[str]) -> argparse.ArgumentParser:
    """The parser with the options of these commands; the others are there by name."""
    parser = Parser(
        prog=PROGRAM,
        description="Where is the thing in this pixel?",
        epilog=f"Each command has examples: {PROGRAM} click --help",
    )
    parser.add_argument("--version", action=Version, nargs=0, help="print the version and exit")
    adding = parser.add_subparsers(dest="command", required=True)
    for name, (_, meaning) in COMMANDS.items():
        if name not in commands:
            adding.add_parser(name, help=meaning)
            continue
        module = _module(name)
        command = adding.add_parser(
            name,
            help=meaning,
            description=f"{meaning[0].upper()}{meaning[1:]}.",
            epilog=getattr(module, "EXAMPLES", None),
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        module.add_arguments(command)
    return parser


def _module(name: str) -> Any:
    return importlib.import_module(COMMANDS[name][0])


def _shielded(argument: str) -> str:
    """A negative number with a space before it, which keeps argparse from taking it (-1e3, -3.) for an option."""
    if argument.startswith("-"):
        try:
            float(argument.split(",", maxsplit=1)[0])
        except ValueError:
            return argument
        return f" {argument}"
    return argument


if __name__ == "__main__":
    sys.exit(main())
