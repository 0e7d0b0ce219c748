"""The content of a file of places, as pins with entered positions."""

from __future__ import annotations

import math
import re
import uuid
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime

from contract.errors import InputError
from ground.pins.model import MAX_NAME, MAX_NOTE, Category, Pin, PinClick

MAX_REASON = 200  # characters
_HAS_TIME = re.compile(r"[T ]\d\d")
_NO_NUMBER = re.compile(r"could not convert string to float: (.*)")  # Python's words


@dataclass(eq=False)
class Imported:
    """Pins of a file, the crops of their clicks, how many of its things are no points, and a line for each that should
    be one and cannot be read: the others are taken.
    """

    pins: list[Pin] = field(default_factory=list)
    crops: dict[str, bytes] = field(default_factory=dict)
    left_out: int = 0
    bad: list[str] = field(default_factory=list)

    def take(self, what: str, make: Callable[[], Pin]) -> None:
        """Append a pin, or note why it is none; `what` names the thing in the file."""
        try:
            self.pins.append(make())
        except (InputError, ValueError, OverflowError, IndexError) as error:
            why = _NO_NUMBER.sub(r"\1 is no number", " ".join(str(error).split()))
            self.bad.append(f"{what}: {why.removeprefix('click: ')[:MAX_REASON]}")

    def checked(self) -> Imported:
        """Itself. Raises InputError if everything in the file that should be a point is bad."""
        if self.bad and not self.pins:
            more = f" (and {len(self.bad) - 1} more)" if len(self.bad) > 1 else ""
            raise InputError(f"{self.bad[0]}{more}")
        return self


def entered_pin(
    *,
    lat_deg: float,
    lon_deg: float,
    height_ellipsoid_m: float | None = None,
    height_amsl_m: float | None = None,
    sigma_m: float | None = None,
    sigma_height_m: float | None = None,
    name: object = "",
    note: object = "",
    category: object = "",
    who: str = "",
    time_text: object = "",
    now_unix_ns: int = 0,
) -> Pin:
    """A pin at a place that was not clicked; texts are cut to what is kept. Raises InputError for no such place.

    A height that is no number, and a sigma that is not above 0, are not known: the place is all the same.
    """
    if lat_deg == 0.0 and lon_deg == 0.0:
        raise InputError("latitude and longitude are both exactly 0: what programs write where there is no place")
    words = {c.value for c in Category}
    when = unix_ns_of(time_text) if isinstance(time_text, str) else None
    click = PinClick.entered(
        lat_deg, lon_deg, height_ellipsoid_m=_finite(height_ellipsoid_m), height_amsl_m=_finite(height_amsl_m),
        sigma_m=_positive(sigma_m), sigma_height_m=_positive(sigma_height_m), who=who, clicked_unix_ns=now_unix_ns,
        seen_unix_ns=when,
    )  # fmt: skip
    return Pin(
        uuid.uuid4().hex, 0, _text(name, MAX_NAME), _text(note, MAX_NOTE),
        Category(category) if isinstance(category, str) and category in words else Category.POI,
        who, now_unix_ns, now_unix_ns, who, (click,),
    )  # fmt: skip


def unix_ns_of(text: str) -> int | None:
    """Unix time of an ISO 8601 moment, UTC where it has no offset; None for any other text, or a moment before 1970.

    A day alone is no moment: taken for its first second it would state a time at which nothing was seen.
    """
    try:
        if not _HAS_TIME.search(text):
            return None
        moment = datetime.fromisoformat(text.strip().replace("Z", "+00:00"))
    except ValueError:
        return None
    if moment.tzinfo is None:
        moment = moment.replace(tzinfo=UTC)
    whole = moment - datetime(1970, 1, 1, tzinfo=UTC)
    ns = (whole.days * 86_400 + whole.seconds) * 1_000_000_000 + whole.microseconds * 1000
    return ns if ns >= 0 else None


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


def _positive(value: float | None) -> float | None:
    return value if value is not None and 0.0 < value < math.inf else None


def _text(value: object, most: int) -> str:
    """A text that can be kept; of another kind, none."""
    text = value if isinstance(value, str) else ""
    return text.encode("utf-8", "replace").decode("utf-8")[:most]
