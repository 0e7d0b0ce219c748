"""`pc-ground completion`: what makes a shell complete our commands and options. Extra `completion` (shtab)."""

from __future__ import annotations

import argparse
import importlib

from contract.errors import InputError
from ground.commands import ANSWERED

SHELLS = ("bash", "zsh", "fish")
EXAMPLES = """\
examples:
  pc-ground completion bash > ~/.local/share/bash-completion/completions/pc-ground
  pc-ground completion zsh > ~/.zfunc/_pc-ground                  (~/.zfunc in fpath, before compinit)
  pc-ground completion fish > ~/.config/fish/completions/pc-ground.fish
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("shell", choices=SHELLS)


def run(args: argparse.Namespace) -> int:
    """Print it. Raises InputError without the extra."""
    try:
        import shtab  # noqa: PLC0415
    except ImportError as error:
        raise InputError(
            "this needs the package shtab: install pointclick with its extra [completion] (README)"
        ) from error
    program = importlib.import_module("ground.__main__")  # by name: it is built on this package
    print(shtab.complete(program.parser_of(list(program.COMMANDS)), shell=args.shell))
    return ANSWERED
