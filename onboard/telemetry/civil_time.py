"""Dates and times of day as programs and spreadsheets write them -> Unix time, and whether their zone is stated."""

from __future__ import annotations

import re
from collections.abc import Iterable
from datetime import UTC, datetime, timedelta, timezone

NS_PER_S = 1_000_000_000
_MOMENT = re.compile(
    r"(\d{1,4})([-./])(\d{1,2})\2(\d{1,4})[ T]+(\d{1,2}):(\d{2}):(\d{2})(?:[.,](\d{1,9}))?\s*"
    r"([ap]\.?m\.?)?\s*(z|utc|[+-]\d{2}:?\d{2})?",
    re.IGNORECASE,
)


def moment_ns(text: str) -> tuple[int, bool] | None:
    """Return a moment, Unix ns, and whether its zone is stated: one without is taken as UTC. None for another text."""
    return moments_ns([text])[0]


def moments_ns(texts: Iterable[str]) -> list[tuple[int, bool] | None]:
    """Return the moments of one column, each as `moment_ns` does.

    Dates whose year stands last have all the same order: that in which every month has a number up to 12. Where both
    are possible the month is first with times of twelve hours, as in the United States, else the day.
    """
    found = [_MOMENT.fullmatch(text.strip()) for text in texts]
    month_first = _is_month_first([one for one in found if one is not None and len(one[4]) == 4])
    return [None if one is None else _moment(one, month_first) for one in found]


def _is_month_first(found: list[re.Match[str]]) -> bool:
    days_first, days_second = (sum(int(one[at]) > 12 for one in found) for at in (1, 3))
    if days_first or days_second:
        return days_second > days_first
    return any(one[9] for one in found)


def _moment(found: re.Match[str], month_first: bool) -> tuple[int, bool] | None:
    first, _, second, third, hour, minute, second_of, fraction, half, zone = found.groups()
    year, month, day = int(third), int(second), int(first)
    if len(first) == 4:
        year, month, day = int(first), int(second), int(third)
    elif month_first:
        month, day = day, month
    hours = int(hour)
    if half is not None:
        if not 1 <= hours <= 12:
            return None
        hours = hours % 12 + 12 * half.lower().startswith("p")
    try:
        moment = datetime(year, month, day, hours, int(minute), int(second_of), tzinfo=_zone(zone))
        whole = round((moment - datetime(1970, 1, 1, tzinfo=UTC)).total_seconds())
    except (ValueError, OverflowError):
        return None
    return whole * NS_PER_S + int((fraction or "0").ljust(9, "0")), zone is not None


def _zone(text: str | None) -> timezone:
    if text is None or text.lower() in ("z", "utc"):
        return UTC
    sign = -1 if text.startswith("-") else 1
    return timezone(sign * timedelta(hours=int(text[1:3]), minutes=int(text[-2:])))
