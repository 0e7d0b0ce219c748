"""Warnings of a command that runs on, on standard error: each when it changes, not again and again."""

from __future__ import annotations

import sys
from collections.abc import Sequence


class Warnings:
    """The warnings printed last. One that only counts on is printed again when its number has doubled."""

    def __init__(self) -> None:
        self._shown: dict[str, int] = {}

    def show(self, lines: Sequence[str], *, always: bool = False) -> None:
        """Print those that are new; `always`, as on a screen that was cleared, all of them."""
        for line in lines:
            words, _, number = line.rpartition(": ")
            count = int(first) if (first := number.partition(" ")[0]).isdecimal() else 0
            if always or words not in self._shown or count >= 2 * max(self._shown[words], 1):
                self._shown[words] = count
                print(f"pc-ground: warning: {line}", file=sys.stderr, flush=True)
