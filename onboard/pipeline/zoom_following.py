"""A zoom lens followed by what is told of it: whether it moves, and which camera it is where it stands. (21.3)

Reports may be late by some tenths of a second, quantised, seldom, or not be numbers. While they change, and for as long
again as they may be late, the lens counts as moving, and its pictures as zoomed; what was taken that long before the
first change may have been zoomed already. A lens of which nothing is told stays where it was told last.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from contract.camera import Camera
from onboard.events.types import Zoom

LATE_NS = 350_000_000  # that a report may lag behind the lens
SILENT_NS = 2_000_000_000  # after which a worse unit counts again
UNITS = ("focal_px", "times", "percent", "hfov_deg")  # the better first
SAME = 0.002  # of the focal length's logarithm: a lens that stands still is told so to this


@dataclass(frozen=True)
class _Told:
    stamp_ns: int
    log_focal: float
    sigma: float


class ZoomFollowing:
    """Fed with reports in order of arrival. `camera` is the camera file; `sigma` of a report, of the focal length."""

    def __init__(self, camera: Camera, sigma: float) -> None:
        self._file, self._sigma = camera, sigma
        self._told: _Told | None = None  # the newest
        self._began_ns = 0  # the first report of a change since the lens last stood still
        self._moved_ns: int | None = None  # the newest such report; None while it stands
        self._stood = math.log(camera.focal_px)  # where it stands, or stood last
        self._rank = len(UNITS)  # of the newest report's unit
        self.unusable = 0  # reports that told nothing

    def note(self, event: Zoom) -> None:
        """Take one report; what is no number, or nothing that this lens can be, tells nothing."""
        log_focal = self._log_focal(event.value, event.unit)
        if log_focal is None:
            self.unusable += 1
            return
        if self._told is not None and event.stamp_ns <= self._told.stamp_ns:
            return
        rank = UNITS.index(event.unit)
        if rank > self._rank and self._told is not None and event.stamp_ns - self._told.stamp_ns < SILENT_NS:
            return  # somebody who knows better speaks
        self._rank = rank
        last = self._stood if self._told is None else self._told.log_focal
        if abs(log_focal - last) > SAME:
            if self._moved_ns is None:
                self._began_ns = event.stamp_ns
            self._moved_ns = event.stamp_ns
        else:
            log_focal = last
        self._told = _Told(event.stamp_ns, log_focal, self._sigma_of(event))

    def _sigma_of(self, event: Zoom) -> float:
        """One sigma of what a report says: as configured, and anywhere within its step."""
        ends = [self._log_focal(event.value + side * event.step, event.unit) for side in (-0.5, 0.0, 0.5)]
        known = [end for end in ends if end is not None]
        share = (len(known) - 1) / 2.0  # of the step that lies between them
        step = (max(known) - min(known)) / share if share else 0.0
        return float(np.linalg.norm([self._sigma, SAME, step / math.sqrt(12.0)]))

    def _log_focal(self, value: float, unit: str) -> float | None:
        table = self._file.zoom
        if not math.isfinite(value) or value < 0.0:
            return None
        if unit in ("times", "percent"):
            return table.log_focal(value) if table is not None and table.unit == unit else None
        if unit == "hfov_deg":
            if table is None:  # autopilots report what is set in their parameters, of lenses that do not zoom too
                return None
            value = 0.5 * self._file.width_px / math.tan(math.radians(value) / 2.0) if 0.0 < value < 179.0 else 0.0
        if value <= 0.0:
            return None
        # Both are of the picture's width, and pixels need not be square.
        log_focal = math.log(value * self._file.focal_px / self._file.fx_px)
        return log_focal if table is None or table.has(log_focal) else None

    @property
    def suspect_since_ns(self) -> int:
        """From when on pictures may have been taken by a lens that moved, though nobody had told of it yet."""
        return self._began_ns - LATE_NS

    def is_moving(self, stamp_ns: int) -> bool:
        """Whether the lens may be moving at a moment, by what has been told so far."""
        return self._moved_ns is not None and self.suspect_since_ns <= stamp_ns <= self._moved_ns + LATE_NS

    def stands(self, stamp_ns: int) -> tuple[Camera, float] | None:
        """The camera that the lens has become, and one sigma of its focal length's logarithm as it is told.

        None where it has not moved since the last time, or still does at this moment.
        """
        if self._moved_ns is None or self._told is None or stamp_ns <= self._moved_ns + LATE_NS:
            return None
        self._moved_ns, self._stood = None, self._told.log_focal
        return self._file.zoomed(self._stood), self._told.sigma
