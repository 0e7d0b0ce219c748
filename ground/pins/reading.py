"""JSON from a file or another server -> checked values. Every error is an InputError that names the field."""

from __future__ import annotations

import base64
import math
import re
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from contract.errors import InputError

Array = NDArray[np.float64]
T = TypeVar("T")

MOST_PART = 80  # characters of a part's name
_IDENTITY = re.compile(r"[0-9A-Za-z_-]{1,64}")  # what may also be a file's name or a chunk of a zenoh key


class Reader:
    """The fields of one JSON object, by name and kind. Raises InputError if it is none."""

    def __init__(self, content: object, what: str) -> None:
        if not isinstance(content, dict):
            raise InputError(f"{what}: must be a JSON object")
        self._content: dict[str, Any] = content
        self._what = what

    def get(self, name: str) -> Any:
        """The value as it is; None where it is missing."""
        return self._content.get(name)

    def maybe(self, name: str, read: Callable[[str], T]) -> T | None:
        """None, or what `read` makes of it."""
        return None if self.get(name) is None else read(name)

    def text(self, name: str, most: int) -> str:
        """A text of at most so many characters that UTF-8 can hold."""
        value = self.get(name)
        if not isinstance(value, str):
            raise self._wrong(name, "a text")
        if len(value) > most:
            raise InputError(f"{self._what}: {name} has {len(value)} characters; at most {most} are kept")
        try:
            value.encode()
        except UnicodeEncodeError as error:
            raise self._wrong(name, "a text of whole characters") from error
        return value

    def identity(self, name: str) -> str:
        """An id: letters, digits, - and _."""
        value = self.text(name, 64)
        if not _IDENTITY.fullmatch(value):
            raise self._wrong(name, "an id of letters, digits, - and _")
        return value

    def flag(self, name: str) -> bool:
        """True or false."""
        value = self.get(name)
        if not isinstance(value, bool):
            raise self._wrong(name, "true or false")
        return value

    def whole(self, name: str) -> int:
        """A whole number from 0, of at most 63 bits."""
        value = self.get(name)
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 2**63:
            raise self._wrong(name, "a whole number from 0")
        return value

    def number(self, name: str, least: float, most: float) -> float:
        """A number within bounds."""
        value = self.get(name)
        if isinstance(value, bool) or not isinstance(value, int | float) or not least <= value <= most:
            raise self._wrong(name, f"a number from {least:g} to {most:g}")
        return float(value)

    def latitude(self, name: str) -> float:
        return self.number(name, -90.0, 90.0)

    def longitude(self, name: str) -> float:
        return self.number(name, -180.0, 180.0)

    def height(self, name: str) -> float:
        return self.number(name, -12_000.0, 100_000.0)

    def pixel(self, name: str) -> float:
        return self.number(name, -1e5, 1e5)

    def list(self, name: str, most: int) -> list[Any]:
        """A list of at most `most` items of any kind."""
        value = self.get(name)
        if not isinstance(value, list) or len(value) > most:
            raise self._wrong(name, f"a list of at most {most}")
        return value

    def wholes(self, name: str, most: int) -> tuple[int, ...]:
        """Whole numbers from 1, at most `most`; none where there is no such list."""
        value = [] if self.get(name) is None else self.list(name, most)
        if not all(isinstance(n, int) and not isinstance(n, bool) and 0 < n < 2**63 for n in value):
            raise self._wrong(name, "whole numbers from 1")
        return tuple(value)

    def stamps(self, name: str, most: int, characters: int, last_ns: int) -> dict[str, tuple[int, str]]:
        """Times, whole numbers of at most `last_ns`, and names, by a word; none where there is no such object."""
        value = {} if self.get(name) is None else self.get(name)
        if not isinstance(value, dict) or len(value) > most:
            raise self._wrong(name, f"an object of at most {most}")
        out = {}
        for part, stamp in value.items():
            if not isinstance(stamp, list) or len(stamp) != 2 or len(part) > MOST_PART:
                raise self._wrong(name, "of times with names")
            r = Reader({"time": stamp[0], "who": stamp[1]}, f"{self._what}: {name}")
            out[part] = r.whole("time"), r.text("who", characters)
            if out[part][0] > last_ns:
                raise self._wrong(name, "of times no later than the pin's last change")
        return out

    def array(self, name: str, shape: tuple[int, ...], most: float, least: float = -math.inf) -> Array:
        """Nested lists of this shape, every number within bounds."""
        try:
            value = np.array(self.get(name), dtype=np.float64)
        except (ValueError, TypeError, OverflowError) as error:
            raise self._wrong(name, f"numbers of shape {shape}") from error
        if value.shape != shape or not np.all((np.abs(value) <= most) & (value >= least)):
            raise self._wrong(name, f"numbers of shape {shape} up to {most:g}")
        return value

    def covariance(self, name: str, size: int) -> Array:
        """Symmetric, no eigenvalue below zero but by rounding."""
        return self.checked(name, self.array(name, (size, size), 1e15))

    def checked(self, name: str, value: Array) -> Array:
        """A covariance (N, N), if it is one."""
        scale = float(np.max(np.abs(value), initial=0.0))
        if not (scale <= 1e15 and float(np.max(np.abs(value - value.T))) <= 1e-6 * scale) or (
            float(np.linalg.eigvalsh(value)[0]) < -1e-6 * max(scale, 1e-12)
        ):
            raise InputError(f"{self._what}: {name} is no covariance")
        return value

    def packed(self, name: str, shapes: dict[str, tuple[int, ...]]) -> dict[str, Array]:
        """Arrays that were written as one text: base64 of little-endian float64, one after the other; all finite."""
        value = self.get(name)
        try:
            flat = np.frombuffer(base64.b64decode(value, validate=True), "<f8").astype(np.float64)
        except (ValueError, TypeError) as error:
            raise self._wrong(name, "base64") from error
        if len(flat) != sum(math.prod(shape) for shape in shapes.values()) or not np.all(np.isfinite(flat)):
            raise self._wrong(name, "as many finite numbers as it has to hold")
        out, begin = {}, 0
        for key, shape in shapes.items():
            end = begin + math.prod(shape)
            out[key], begin = flat[begin:end].reshape(shape), end
        return out

    def _wrong(self, name: str, wanted: str) -> InputError:
        return InputError(f"{self._what}: {name} = {str(self.get(name))[:40]!r} must be {wanted}")
