"""A zoom lens followed by what is reported of it: whether it moves, and which camera it is where it stands.

Reports may be late by some tenths of a second, quantised, seldom, or not be numbers, and their clock may not be the
pictures'. So each holds for an interval of picture stamps, and all pictures count as zoomed in which the lens may have
moved, (21.3). Without a report a lens stays where it was reported last.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import get_args

import numpy as np

from contract.camera import Camera
from onboard.events.types import Zoom, ZoomUnit
from onboard.navigation.limits import LATE_NS, LIKELY_SIGMAS, RECENT_NS

SAME = 0.002  # of the focal length's logarithm: a lens that stands still is reported with this error


@dataclass(frozen=True)
class _Report:
    stamp_ns: int
    log_focal: float
    sigma: float
    first_ns: int  # picture stamps between which the lens was so
    last_ns: int


class ZoomFollowing:
    """Takes zoom reports in order of arrival. `camera`: the camera file; `sigma`: of a report, of the focal length."""

    def __init__(self, camera: Camera, sigma: float) -> None:
        self._file, self._sigma = camera, sigma
        self._newest: _Report | None = None
        self._is_standing = True
        # Picture stamps between which it may have moved, the last time, perhaps before that was reported.
        self.suspect_since_ns = self._until_ns = 0
        self._changed_ns: float = -math.inf  # stamp of the newest report of a change
        self._confirmed_ns = 0  # until when the lens may have moved, if a report confirms that change
        self._rank = len(get_args(ZoomUnit))  # of the newest report's unit

    def note(self, event: Zoom, offset_s: float = 0.0, offset_sigma_s: float = 0.0) -> None:
        """Take one report; what is no number, or nothing that this lens can be, changes nothing.

        `offset_s`: the moment of a picture by telemetry's clock, less its stamp, and one sigma of it.
        """
        log_focal = self._log_focal(event.value, event.unit)
        if log_focal is None:
            return
        before = self._newest
        if before is not None and event.stamp_ns <= before.stamp_ns:
            return
        rank = get_args(ZoomUnit).index(event.unit)
        if rank > self._rank and before is not None and event.stamp_ns - before.stamp_ns < RECENT_NS:
            return  # a report in a better unit came not long ago
        self._rank = rank
        last = math.log(self._file.focal_px) if before is None else before.log_focal
        is_change = abs(log_focal - last) > SAME
        stamp_ns, unsure_ns = event.stamp_ns, 0  # of a picture at the moment of the report
        if not event.is_of_picture:
            stamp_ns, unsure_ns = stamp_ns - round(offset_s * 1e9), round(LIKELY_SIGMAS * offset_sigma_s * 1e9)
        first_ns, last_ns = stamp_ns - LATE_NS - unsure_ns, stamp_ns + unsure_ns
        value = log_focal if is_change else last
        self._newest = _Report(event.stamp_ns, value, self._sigma_of(event), first_ns, last_ns)
        if is_change:
            self._change(before, self._newest)
        else:
            self._until_ns = min(self._until_ns, self._confirmed_ns)

    def _change(self, before: _Report | None, report: _Report) -> None:
        """A report is of another lens than the one before it."""
        if self._is_standing:
            self._is_standing = False
            earliest_ns = report.first_ns if before is None else before.first_ns
            self.suspect_since_ns = max(earliest_ns, report.first_ns - RECENT_NS)
        # Steps may report one that moves slowly less often than reports come.
        before_ns = -math.inf if before is None else before.stamp_ns
        began_ns = [ns for ns in (self._changed_ns, before_ns) if report.stamp_ns - ns <= RECENT_NS]
        lasted_ns = report.stamp_ns - int(min(began_ns, default=report.stamp_ns))
        self._confirmed_ns = report.last_ns + max(lasted_ns, LATE_NS)
        self._changed_ns, self._until_ns = report.stamp_ns, report.last_ns + RECENT_NS

    def _sigma_of(self, event: Zoom) -> float:
        """One sigma of what is reported: as configured, and anywhere within its step."""
        ends = [self._log_focal(event.value + side * event.step, event.unit) for side in (-0.5, 0.0, 0.5)]
        known = [end for end in ends if end is not None]
        share = (len(known) - 1) / 2.0  # of the step that lies between them
        step = (max(known) - min(known)) / share if share else 0.0
        return float(np.linalg.norm([self._sigma, SAME, step / math.sqrt(12.0)]))

    def _log_focal(self, value: float, unit: str) -> float | None:
        table = self._file.zoom
        if unit in ("times", "percent"):
            return table.log_focal(value) if table is not None and table.unit == unit else None
        if unit == "hfov_deg":
            if table is None:  # autopilots report what is set in their parameters, of lenses that do not zoom too
                return None
            value = self._file.fx_of_hfov(value) if 0.0 < value < 179.0 else 0.0
        if not 0.0 < value < math.inf:
            return None
        # Both are of the picture's width, and pixels need not be square.
        log_focal = math.log(value * self._file.focal_px / self._file.fx_px)
        return log_focal if table is None or table.has(log_focal) else None

    def is_moving(self, stamp_ns: int) -> bool:
        """Return whether the lens may be moving in a picture with this stamp, by the reports so far."""
        return not self._is_standing and self.suspect_since_ns <= stamp_ns <= self._until_ns

    def stands(self, stamp_ns: int) -> tuple[Camera, float] | None:
        """The camera that the lens has become, and one sigma of its focal length's logarithm as it is reported.

        None where it has not moved since the last time, or may still do so in a picture with this stamp.
        """
        if self._is_standing or self._newest is None or stamp_ns <= self._until_ns:
            return None
        self._is_standing = True
        return self._file.zoomed(self._newest.log_focal), self._newest.sigma
