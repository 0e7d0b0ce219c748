"""The protocol of all that we ever have an autopilot do: look at a place, look there no longer, circle about it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

ACCEPTED = "accepted"
NO_AUTOPILOT = "no_autopilot"  # nothing was sent
NOT_ACKNOWLEDGED = "not_acknowledged"  # it was sent, and may have been done
ON_GROUND = "on_ground"  # by the autopilot's own word; nothing was sent
NO_CIRCLE = "no_circle"  # it is none of the kinds that are sent to circle, or has not reported which; nothing was sent


@dataclass(frozen=True)
class LookAt:
    """The camera looks at a place: degrees, metres above mean sea level."""

    lat_deg: float
    lon_deg: float
    height_amsl_m: float

    def __str__(self) -> str:
        return f"at {self.lat_deg:.5f} {self.lon_deg:.5f}, {self.height_amsl_m:.0f} m"


@dataclass(frozen=True)
class LookAhead:
    """The camera looks at a place no longer."""

    def __str__(self) -> str:
        return "ahead"


@dataclass(frozen=True)
class CircleAbout:
    """The aircraft flies a circle about a place, clockwise: degrees; its height above mean sea level and radius, m."""

    lat_deg: float
    lon_deg: float
    height_amsl_m: float
    radius_m: float

    def __str__(self) -> str:
        place = f"{self.lat_deg:.5f} {self.lon_deg:.5f}"
        return f"circling {place} at {self.height_amsl_m:.0f} m, radius {self.radius_m:.0f} m"


Order = LookAt | LookAhead | CircleAbout


class PointingEnd(Protocol):
    """Our end of an autopilot that may be commanded."""

    def command(self, order: Order) -> str:
        """Have an order obeyed. Waits seconds for what comes of it, in a word: ACCEPTED, NO_AUTOPILOT, NO_CIRCLE,
        ON_GROUND, NOT_ACKNOWLEDGED, or the autopilot's own reason to refuse, as in MAVLink's MAV_RESULT. One at a
        time; from any thread but the telemetry's.
        """

    def height_amsl_m(self) -> float | None:
        """The aircraft's height above mean sea level (m) as the autopilot itself counts it now; None where unknown."""
