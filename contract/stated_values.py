"""Values out of a file that other people or programs wrote: known keys, numbers within their range, or one line.

Python's JSON reads 1e999 as infinity and NaN as a number, and a key that is misspelt is silently none.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from typing import Any

from contract.errors import InputError
from contract.near_word import near_word


def number_or_nan(text: str) -> float:
    """A number; NaN, which is in no range, where it is none."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def object_of(text: str | bytes, what: str) -> dict[str, Any]:
    """The JSON object in a text, each of its keys once. Raises InputError, which begins with `what`."""
    try:
        content = json.loads(text, object_pairs_hook=each_once)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{what}: not JSON ({error})") from error
    if not isinstance(content, dict):
        raise InputError(f"{what}: not a JSON object, which begins with {{")
    return content


def each_once(pairs: Iterable[tuple[Any, Any]]) -> dict[Any, Any]:
    """Return a mapping of pairs. Raises ValueError for a key that comes twice: which of its values is meant?"""
    out: dict[Any, Any] = {}
    for key, value in pairs:
        if key in out:
            raise ValueError(f"{str(key)[:40]!r} is there twice")
        out[key] = value
    return out


def check_keys(content: Iterable[str], known: Sequence[str], what: str, needed: Iterable[str] = ()) -> None:
    """Raise InputError for a key that is not known, with the one that may be meant, and for one that is missing."""
    keys = list(content)
    for key in keys:
        if key not in known:
            near = near_word(key, known)
            hint = f"known are {', '.join(known)}" if near is None else f"did you mean {near!r}?"
            raise InputError(f"{what}: unknown key {key[:40]!r}; {hint}")
    for key in needed:
        if key not in keys:
            raise InputError(f"{what}: key {key!r} is missing")


def number(value: object, low: float, high: float, what: str, unit: str = "") -> float:
    """A number from `low` to `high`. Raises InputError, which begins with `what` and states the range."""
    if isinstance(value, int | float) and not isinstance(value, bool) and low <= value <= high:
        return float(value)
    shown = json.dumps(value)[:40] if isinstance(value, int | float | str) or value is None else type(value).__name__
    raise InputError(f"{what} is {shown}: must be a number from {low:g} to {high:g}{unit and ' '}{unit}")


def whole(value: object, low: int, high: int, what: str) -> int:
    """A whole number from `low` to `high`. Raises InputError."""
    found = number(value, low, high, what)
    if found != math.floor(found):
        raise InputError(f"{what} is {found:g}: must be a whole number")
    return int(found)


def numbers(value: object, count: int, most: float, what: str) -> list[float]:
    """A list of so many numbers of at most that size, either sign. Raises InputError."""
    if not isinstance(value, list) or len(value) != count:
        raise InputError(f"{what}: must be a list of {count} numbers")
    return [number(one, -most, most, what) for one in value]
