"""Selection of pins by a request of OGC API - Features: bbox, datetime, limit and page. Values and refusals only."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

from contract.errors import PointclickError
from ground.formats.mark import Mark

DEFAULT_LIMIT, MAX_LIMIT = 1000, 10_000
# `f` is what other servers choose a format by, and clients send it unasked.
PARAMETERS = ("bbox", "datetime", "limit", "after", "f")


class WrongParameter(PointclickError):
    """A parameter that is not as the standard and this server's API definition state it: status 400."""


@dataclass(frozen=True)
class Selection:
    """`bbox`: west, south, east, north in degrees, across the antimeridian where west > east; times in Unix seconds.

    `after`: pins with a higher number; pages are not shifted by what is added or deleted meanwhile.
    """

    bbox: tuple[float, float, float, float] | None = None
    heights_m: tuple[float, float] | None = None
    times_s: tuple[float, float] | None = None
    limit: int = DEFAULT_LIMIT
    after: int = 0

    @classmethod
    def of(cls, asked: Mapping[str, str]) -> Selection:
        """Read the parameters of a query string. Raises WrongParameter."""
        unknown = sorted(set(asked) - set(PARAMETERS))
        if unknown:
            raise WrongParameter(f"no parameter {unknown[0][:40]!r}; there are {', '.join(PARAMETERS)}")
        if asked.get("f", "json") not in ("json", "geojson"):
            raise WrongParameter("f: json is the only format")
        limit = _whole("limit", asked.get("limit", str(DEFAULT_LIMIT)), 1)
        after = _whole("after", asked.get("after", "0"), 0)
        bbox, heights_m = _bbox(asked["bbox"]) if "bbox" in asked else (None, None)
        times_s = _times(asked["datetime"]) if "datetime" in asked else None
        return cls(bbox, heights_m, times_s, min(limit, MAX_LIMIT), after)

    def of_marks(self, marks: Sequence[Mark]) -> list[Mark]:
        return [mark for mark in marks if self._has_place(mark) and self._has_time(mark)]

    def page(self, matching: Sequence[Mark]) -> tuple[list[Mark], int | None]:
        """This page of those that match, by number; and what the next page comes after, None behind the last."""
        rest = [mark for mark in matching if (mark.number or 0) > self.after]
        rest.sort(key=lambda mark: mark.number or 0)
        page = rest[: self.limit]
        return page, page[-1].number if len(rest) > len(page) else None

    def _has_place(self, mark: Mark) -> bool:
        if self.bbox is None:
            return True
        if not mark.is_placed:
            return False
        lat, lon = mark.position
        west, south, east, north = self.bbox
        is_between = west <= lon <= east if west <= east else lon >= west or lon <= east
        height = mark.height_ellipsoid_m
        is_high = self.heights_m is None or height is None or self.heights_m[0] <= height <= self.heights_m[1]
        return south <= lat <= north and is_between and is_high

    def _has_time(self, mark: Mark) -> bool:
        if self.times_s is None:
            return True
        if mark.time_unix_ns is None:
            return False
        begin_s, end_s = self.times_s
        return begin_s <= mark.time_unix_ns / 1e9 <= end_s


def _whole(name: str, text: str, least: int) -> int:
    if not text.isascii() or not text.isdecimal() or len(text) > 12 or int(text) < least:
        raise WrongParameter(f"{name} must be a whole number, {least} or more")
    return int(text)


def _bbox(text: str) -> tuple[tuple[float, float, float, float], tuple[float, float] | None]:
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) not in (4, 6) or not all(math.isfinite(value) for value in values):
        raise WrongParameter("bbox must be west,south,east,north, or west,south,lowest,east,north,highest")
    half = len(values) // 2
    west, south, east, north = values[0], values[1], values[half], values[half + 1]
    if south > north or not all(abs(lon) <= 180.0 for lon in (west, east)) or max(abs(south), abs(north)) > 90.0:
        raise WrongParameter("bbox: degrees of longitude and latitude, south not above north")
    return (west, south, east, north), (values[2], values[5]) if half == 3 else None


def _times(text: str) -> tuple[float, float]:
    parts = text.split("/")
    if len(parts) > 2:
        raise WrongParameter("datetime must be a moment, or two with a slash between")
    begin_s, end_s = (_moment(part, k) for k, part in enumerate((parts[0], parts[-1])))
    if len(parts) == 1 and not (math.isfinite(begin_s) and begin_s == end_s):
        raise WrongParameter("datetime: a moment is needed")
    if begin_s > end_s:
        raise WrongParameter("datetime: the second moment is before the first")
    return begin_s, end_s


def _moment(text: str, end: int) -> float:
    """Unix seconds of RFC 3339, or without end where it is left open."""
    if text in ("", ".."):
        return math.inf if end else -math.inf
    try:
        found = datetime.fromisoformat(text)
    except ValueError as error:
        raise WrongParameter(f"datetime: {text[:40]!r} is no moment like 2026-05-01T12:00:00Z") from error
    return (found if found.tzinfo else found.replace(tzinfo=UTC)).timestamp()
