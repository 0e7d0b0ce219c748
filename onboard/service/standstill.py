"""Detection that the aircraft stands on the ground: then it is no fault that pictures show no motion.

PX4 reports it itself (FilterStatus). Others are taken to stand where their velocity is nothing but its own noise for as
long as the pipeline waits before it calls that standing still, at the height of home as far as that is known.
"""

from __future__ import annotations

import math

from onboard.config.schema import Gps
from onboard.events.types import Event, FilterStatus, PositionFix

SIGMAS = 3.0
PERSISTENT_NS = 3_000_000_000


class Standstill:
    """Fed with every event by the pipeline's thread; asked by any."""

    def __init__(self, gps: Gps) -> None:
        self._max_speed_m_s = SIGMAS * gps.sigma_velocity_m_s
        self._max_height_m = SIGMAS * gps.sigma_correlated_vertical_m
        self._still_since_ns: int | None = None
        self._newest_ns = 0
        self._is_held = False

    def note(self, event: Event) -> None:
        if isinstance(event, FilterStatus):
            self._is_held = event.is_at_rest
        elif isinstance(event, PositionFix):
            if not self._is_still(event):
                self._still_since_ns = None
            elif self._still_since_ns is None or event.stamp_ns < self._newest_ns:
                self._still_since_ns = event.stamp_ns
            self._newest_ns = event.stamp_ns

    @property
    def is_at_rest(self) -> bool:
        """True if it stands, as far as is known; False where nothing is."""
        since_ns = self._still_since_ns
        return self._is_held or (since_ns is not None and self._newest_ns - since_ns >= PERSISTENT_NS)

    def _is_still(self, fix: PositionFix) -> bool:
        height_m, velocity = fix.height_above_home_m, fix.velocity_ned_m_s
        if height_m is None or velocity is None:
            return False
        speed_m_s = math.hypot(*(v for v in velocity if math.isfinite(v)))
        return speed_m_s <= self._max_speed_m_s and abs(height_m) <= self._max_height_m
