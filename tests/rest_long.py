"""Parameters of which the first stand for all: the rest are of `make test-long`."""

from collections.abc import Iterable
from typing import Any

import pytest


def rest_long(values: Iterable[Any], kept: int = 1) -> list[Any]:
    """For `parametrize`: the first `kept` values as they are, those after them marked `long`. A tuple is one test's."""
    every = [value if isinstance(value, tuple) else (value,) for value in values]
    return [
        pytest.param(*value, marks=pytest.mark.long if number >= kept else ()) for number, value in enumerate(every)
    ]
