"""Look there: an aircraft's camera is sent to a clicked place. Requests and answers; docs/wire-format.md, section 16.

In two steps, so that a person confirms the place that the aircraft itself has found: a click is asked about and
answered with an offer, and the offer's ticket is confirmed. Only that has a command sent to the autopilot. What the
camera looks at the aircraft may be asked to circle about, in two steps of its own.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import Any

from contract.errors import InputError, LinkError
from contract.fleet import NAME
from contract.stated_values import number_or_nan
from contract.topics import LOOK

MOST_REQUEST = 300  # characters
MOST_PX = 65535.0
OFFER_S = 30.0  # for which an offer may be confirmed
LATE_S = 5.0  # on the way, of offer and confirmation together: a later one is not done
ANSWERED_WITHIN_S = 8.0  # that a ground waits: LATE_S, and three for the autopilot to acknowledge it
END, TICKET, WAITED, CIRCLE = "end", "ticket", "waited", "circle"
UNREADABLE = "the aircraft's offer cannot be read"
_CLICK = "session", "frame", "u", "v", "lat", "lon", "radius"


@dataclass(frozen=True)
class AskLook:
    """A click on a picture, and the place that its answer gave the person who asks, with its 90 % radius."""

    session: int
    frame: int
    u_px: float
    v_px: float
    lat_deg: float
    lon_deg: float
    radius_m: float


@dataclass(frozen=True)
class ConfirmLook:
    """An offer's ticket, and for how long the offer has been with the person who confirms it."""

    ticket: str
    waited_s: float


@dataclass(frozen=True)
class EndLook:
    """Look there no longer: the autopilot is given its camera back."""


@dataclass(frozen=True)
class AskCircle:
    """Circle about the place that the camera was sent to look at, by the ticket of that offer."""

    ticket: str


LookRequest = AskLook | ConfirmLook | EndLook | AskCircle


@dataclass(frozen=True)
class Circle:
    """The circle that the aircraft would fly: radius, height above mean sea level, and that above the place, m."""

    radius_m: float
    height_amsl_m: float
    above_place_m: float


@dataclass(frozen=True)
class Offer:
    """The place that the aircraft has found and would look at: degrees, metres above mean sea level, its CE90 and how
    old its picture is; and the circle that it would fly about it, if that was asked for.
    """

    ticket: str
    lat_deg: float
    lon_deg: float
    height_amsl_m: float
    ce90_m: float
    age_s: float
    circle: Circle | None = None

    def to_json(self) -> bytes:
        """The answer to a click, or to a circle, that is asked about."""
        content: dict[str, Any] = {
            "ticket": self.ticket, "lat_deg": round(self.lat_deg, 7), "lon_deg": round(self.lon_deg, 7),
            "height_amsl_m": round(self.height_amsl_m, 1), "ce90_m": round(self.ce90_m, 1),
            "age_s": round(self.age_s, 1),
        }  # fmt: skip
        if self.circle is not None:
            content[CIRCLE] = {key: round(value, 1) for key, value in vars(self.circle).items()}
        return json.dumps(content, separators=(",", ":")).encode()

    @classmethod
    def of(cls, content: dict[str, Any]) -> Offer:
        """Read an answer. Raises LinkError for one that is none."""
        lat, lon, height, ce90, age = _numbers(content, "lat_deg", "lon_deg", "height_amsl_m", "ce90_m", "age_s")
        ticket, circle = content.get(TICKET), content.get(CIRCLE)
        if not isinstance(ticket, str) or not isinstance(circle, dict | None):
            raise LinkError(UNREADABLE)
        path = None if circle is None else Circle(*_numbers(circle, "radius_m", "height_amsl_m", "above_place_m"))
        return cls(ticket, lat, lon, height, ce90, age, path)


def _numbers(content: dict[str, Any], *keys: str) -> list[float]:
    values = [content.get(key) for key in keys]
    if not all(_is_number(value) for value in values):
        raise LinkError(UNREADABLE)
    return [float(value) for value in values if value is not None]


def look_key(vehicle: str, name: str) -> str:
    """The key of one person's questions: a certificate opens its own and no other. Raises ValueError."""
    if NAME.fullmatch(name) is None:
        raise ValueError(f"name {name!r} must be 1 to 32 letters, digits, '_', '.' or '-'")
    return f"{LOOK.key(vehicle)}/{name}"


def parameters_of(request: LookRequest) -> str:
    """A request as a query's parameters."""
    if isinstance(request, EndLook):
        return f"{END}=1"
    if isinstance(request, AskCircle):
        return f"{CIRCLE}={request.ticket}"
    if isinstance(request, ConfirmLook):
        return f"{TICKET}={request.ticket};{WAITED}={request.waited_s:.2f}"
    r = request
    values = r.session, r.frame, r.u_px, r.v_px, round(r.lat_deg, 9), round(r.lon_deg, 9), round(r.radius_m, 3)
    return ";".join(f"{key}={value!r}" for key, value in zip(_CLICK, values, strict=True))


def read_request(text: str) -> LookRequest:
    """Read the request out of a query's parameters. Raises InputError in one line for anything else."""
    if len(text) > MOST_REQUEST:
        raise InputError(f"more than {MOST_REQUEST} characters")
    pairs = [part.partition("=")[::2] for part in text.split(";") if part]
    given = dict(pairs)
    if len(given) < len(pairs):
        raise InputError("something is given twice")
    if given == {END: "1"}:
        return EndLook()
    if set(given) == {TICKET, WAITED}:
        return ConfirmLook(_ticket(given, TICKET), _number(given, WAITED, 0.0, math.inf))
    if set(given) == {CIRCLE}:
        return AskCircle(_ticket(given, CIRCLE))
    if set(given) != set(_CLICK):
        raise InputError(
            f"a look is asked for with {', '.join(_CLICK)}; confirmed with ticket and waited; ended with end=1; "
            "a circle is asked for with circle"
        )
    return AskLook(
        _whole(given, "session"),
        _whole(given, "frame"),
        _number(given, "u", -0.5, MOST_PX),
        _number(given, "v", -0.5, MOST_PX),
        _number(given, "lat", -90.0, 90.0),
        _number(given, "lon", -180.0, 180.0),
        _number(given, "radius", 0.0, 1e5),
    )


def _ticket(given: dict[str, str], key: str) -> str:
    ticket = given[key]
    if not (ticket.isascii() and ticket.isalnum() and len(ticket) <= 32):
        raise InputError(f"{key}: not the ticket of an offer")
    return ticket


def _whole(given: dict[str, str], key: str) -> int:
    text = given[key]
    if not (text.isascii() and text.isdecimal() and len(text) <= 10 and int(text) < 2**32):
        raise InputError(f"{key}: not a whole number below 2^32")
    return int(text)


def _number(given: dict[str, str], key: str, low: float, high: float) -> float:
    text = given[key]
    value = number_or_nan(text) if len(text) <= 32 else math.nan
    if not low <= value <= high:
        raise InputError(f"{key}: not a number from {low:g} to {high:g}")
    return value


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
