"""The time a test may take, its fixtures included, so that one that hangs is named and ends by itself.

Several times what the slowest of a kind takes on two busy cores: a limit ends what hangs and judges no speed.
"""

from functools import cache
from pathlib import Path

import pytest

ORDINARY_S = 240.0
LONG_S = 1200.0
GUEST_S = 1500.0  # of tests/bench and tests/arm64: one boots a computer and runs a file of tests in it
TESTS = Path(__file__).parent


def limit_s(item: pytest.Item) -> float:
    """Return the limit of a test in seconds, by its marker and its folder."""
    if is_in_guest(item.path.parent):
        return GUEST_S
    return LONG_S if item.get_closest_marker("long") else ORDINARY_S


@cache
def is_in_guest(folder: Path) -> bool:
    return any(folder.is_relative_to(TESTS / name) for name in ("bench", "arm64"))


def limit(items: list[pytest.Item]) -> None:
    """Give each test its limit, but where it names one of its own."""
    for item in items:
        if item.get_closest_marker("timeout") is None:
            item.add_marker(pytest.mark.timeout(limit_s(item)))
