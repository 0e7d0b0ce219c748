"""The protocol of the one thing that we ever have the autopilot do: look at a place, or look there no longer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

ACCEPTED = "accepted"
NO_AUTOPILOT = "no_autopilot"  # nothing was sent
NOT_ACKNOWLEDGED = "not_acknowledged"  # it was sent, and may have been done


@dataclass(frozen=True)
class Target:
    """A place to look at: degrees, metres above mean sea level."""

    lat_deg: float
    lon_deg: float
    height_amsl_m: float


class PointingEnd(Protocol):
    """Our end of an autopilot that may be commanded."""

    def point(self, target: Target | None) -> str:
        """Have it look at a place, or with None no longer. Waits seconds for what comes of it, in a word: ACCEPTED,
        NO_AUTOPILOT, NOT_ACKNOWLEDGED, or the autopilot's own reason to refuse, as in MAVLink's MAV_RESULT. One at a
        time; from any thread but the telemetry's.
        """
