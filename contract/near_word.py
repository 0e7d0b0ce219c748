"""The word that a mistyped one was probably meant to be: of commands, options and keys."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable
from typing import Any

CUTOFF = 0.6  # least likeness by difflib: two letters swapped in a word of five have it, another word does not
_UNKNOWN = re.compile(r"invalid choice: '([^']*)' \(choose from (.*)\)", re.DOTALL)


def near_word(word: str, known: Iterable[str]) -> str | None:
    """The known word that is written nearly so; None where none is."""
    names = list(known)
    begun = [name for name in names if name.startswith(f"{word.lower()}_")]  # without its unit
    found = begun or difflib.get_close_matches(word.lower(), names, n=1, cutoff=CUTOFF)
    return found[0] if found else None


def options_of(parser: Any) -> list[str]:
    """All options of a parser of argparse and of its commands."""
    out: list[str] = []
    for action in parser._actions:
        out += [option for option in action.option_strings if option.startswith("--")]
        if isinstance(action.choices, dict):  # commands, each with a parser
            for command in action.choices.values():
                out += options_of(command)
    return out


def in_usage(message: str, options: Iterable[str] = ()) -> str:
    """An error of argparse, with what a mistyped command or option was probably meant to be."""
    if choice := _UNKNOWN.search(message):
        known = [name.strip("' ") for name in choice[2].split(",")]
        near = near_word(choice[1], known)
        where = message[: choice.start()] if message.startswith("argument -") else "no command "
        return message if near is None else f"{where}{choice[1]!r}; did you mean {near!r}?"
    if message.startswith("unrecognized arguments: --"):
        word = message.split()[2].partition("=")[0]
        if word in options:
            return f"{message}, which is another command's"
        near = near_word(word, options)
        return message if near is None else f"{message}; did you mean {near}?"
    return message
