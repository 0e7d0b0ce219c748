"""Questions at a terminal: asked again until the answer is one, with a default that an empty line takes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

from contract.errors import ConfigError

Value = TypeVar("Value")
MOST_TRIES = 5


@dataclass(frozen=True)
class Terminal:
    """A person to ask. `read` takes a prompt and returns a line; EOFError where there are no more answers."""

    read: Callable[[str], str] = input
    show: Callable[[str], None] = print

    def ask(self, question: str, parse: Callable[[str], Value], default: str | None = None) -> Value:
        """The answer as `parse` makes it, which raises ValueError with what would be right.

        Raises ConfigError where there is no answer, or never a usable one.
        """
        shown = f"{question} [{default}]: " if default else f"{question}: "
        for _ in range(MOST_TRIES):
            try:
                line = self.read(shown).strip()
            except EOFError as error:
                raise ConfigError(f"setup: no answer to {question!r}; give it as an option (--help)") from error
            try:
                return parse(line or default or "")
            except ValueError as error:
                self.show(f"  {error}")
        raise ConfigError(f"setup: no usable answer to {question!r} in {MOST_TRIES} tries")

    def choose(self, question: str, options: Sequence[str]) -> int:
        """Show some options, numbered from 1, and return the index of the one chosen; the first is the default."""
        for number, option in enumerate(options, 1):
            self.show(f"  {number}  {option}")

        def parse(line: str) -> int:
            if not line.isdecimal() or not 1 <= int(line) <= len(options):
                raise ValueError(f"a number from 1 to {len(options)}")
            return int(line) - 1

        return self.ask(question, parse, "1")
