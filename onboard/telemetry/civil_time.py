"""Dates and times of day as programs and spreadsheets write them -> Unix time, and whether their zone is stated."""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta, timezone

NS_PER_S = 1_000_000_000
_MOMENT = re.compile(
    r"(\d{1,4})([-./])(\d{1,2})\2(\d{1,4})[ T]+(\d{1,2}):(\d{2}):(\d{2})(?:[.,](\d{1,9}))?\s*"
    r"([ap]\.?m\.?)?\s*(z|utc|[+-]\d{2}:?\d{2})?",
    re.IGNORECASE,
)


def moment_ns(text: str) -> tuple[int, bool] | None:
    """Return a moment, Unix ns, and whether its zone is stated: one without is taken as UTC. None for another text.

    A date whose year stands last has its month first where the time is one of twelve hours, as in the United States,
    else its day; the other way round where no month has that number.
    """
    found = _MOMENT.fullmatch(text.strip())
    if found is None:
        return None
    first, _, second, third, hour, minute, second_of, fraction, half, zone = found.groups()
    year, month, day = int(third), int(second), int(first)
    if len(first) == 4:
        year, month, day = int(first), int(second), int(third)
    elif (half is not None and day <= 12) or month > 12:
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
