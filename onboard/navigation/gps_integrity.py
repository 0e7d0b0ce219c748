"""Whether a position is accepted, and with what sigma: receiver, autopilot's filter, position against velocity.

GPS is accepted until the messages contradict it: a lost or silent fix, a jump that the velocity does not explain, or a
filter that slips (moves its position against its own velocity, as it does while it corrects an error) refuses every
moment from then until it has settled again. Slip is measured over two seconds: at most 0.3 m/s in recorded clean
flights, 0.65 m/s in the real one; 1 to 4 m/s while jammed and for the ten seconds of recovery in which the receiver's
own figures are already perfect and the position is still 28 to 4 m off.
"""

from __future__ import annotations

import bisect
import itertools
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from onboard.config.schema import Config
from onboard.events.types import FilterStatus, GpsQuality
from onboard.navigation.limits import LIKELY_SIGMAS, LONG_NS, RECENT_NS
from onboard.navigation.position_interpolation import Position
from onboard.navigation.position_jumps import PositionJumps
from onboard.navigation.position_slip import Slip, SlipTest
from onboard.navigation.time_series import Series, T

Array = NDArray[np.float64]


class Refusal(StrEnum):
    """Why no position is accepted: the words that people see."""

    NOTHING_YET = "no position yet"
    UNHEARD = "waiting for the receiver's and the filter's own report"
    NO_FIX_YET = "no fix yet"
    FIX_LOST = "fix lost"
    NO_ABSOLUTE_POSITION = "the autopilot's filter has no absolute position"
    FILTER_GLITCH = "the autopilot's filter calls the GPS a glitch"
    RECOVERING = "recovering"


class GpsIntegrity:
    """Fed with positions, receiver and filter reports; determines for any moment whether its position is accepted."""

    def __init__(self, config: Config) -> None:
        self._gps, self._slip = config.gps, SlipTest(config.gps)
        self.quality: Series[GpsQuality] = Series()
        self.filter: Series[FilterStatus] = Series()
        self.positions: Series[Position] = Series()
        self._jumps = PositionJumps(config.gps, self._was_unfit)
        self._had_fix = False

    def forget(self) -> None:
        """The clock was set back: nothing held can be compared any more."""
        self.quality, self.filter, self.positions = Series(), Series(), Series()
        self._jumps = PositionJumps(self._gps, self._was_unfit)

    def begin(self, positions: Series[Position], jumped_ns: int | None) -> None:
        """Positions in a new frame; `jumped_ns`: when those of the old frame were found to be elsewhere, if so."""
        self.positions = positions
        self._jumps.begin(jumped_ns)

    # ------------------------------------------------------------------ before there is a frame

    def first_estimate(self, first_ns: int, now_ns: int) -> tuple[int | None, str]:
        """Since when positions may be accepted with data up to `now_ns`, or None and why they may not.

        `first_ns`: stamp of the first position. Receiver and filter are waited for: a filter without a fix reports a
        place that it remembers, and its own report may come later than that place.
        """
        receiver = [(q.stamp_ns, q.has_fix) for q in self.quality.values]
        filters = [(f.stamp_ns, f.has_position) for f in self.filter.values]
        unfit_ns = 0
        for said, why in ((receiver, self._no_fix), (filters, Refusal.NO_ABSOLUTE_POSITION)):
            if said and not said[-1][1]:
                return None, why
            unfit_ns = max([unfit_ns, *(said_ns for said_ns, is_fit in said if not is_fit)])
        if not (receiver and filters) and now_ns - first_ns < self._gps.quality_timeout_s * 1e9:
            return None, Refusal.UNHEARD
        return unfit_ns, ""

    @property
    def _no_fix(self) -> Refusal:
        return Refusal.FIX_LOST if self._had_fix else Refusal.NO_FIX_YET

    @property
    def is_unfit_now(self) -> bool:
        """Whether the newest report of receiver or filter denies that there is a position."""
        quality, status = self.quality.values, self.filter.values
        return bool(quality and not quality[-1].has_fix) or bool(status and not status[-1].has_position)

    # ------------------------------------------------------------------ what comes in

    def note_quality(self, quality: GpsQuality) -> None:
        """The receiver's report."""
        self.quality.insert(quality.stamp_ns, quality)
        self._had_fix |= quality.has_fix

    def note_filter(self, status: FilterStatus) -> None:
        """The filter's report."""
        self.filter.insert(status.stamp_ns, status)

    def note_position(self, index: int) -> None:
        """A position inserted at `index`."""
        if index == len(self.positions.stamps_ns) - 1:
            self._jumps.append(self.positions, self.claims(self.positions.stamps_ns[index]))

    # ------------------------------------------------------------------ what is asked

    def fault_at(self, moment_ns: int, slip: Slip) -> str:
        """Why a position at a moment is not accepted; empty if it is. `slip`: `slip_at` the same moment."""
        slips = f"position moves {slip.surely_m_s:.1f} m/s against velocity"
        return (
            self._receiver_fault(moment_ns)
            or self._filter_fault(moment_ns)
            or self._jumps.refusal_at(moment_ns)
            or (slips if slip.exceeds(self._gps.max_slip_m_s) else "")
        )

    def was_believed(self, start_ns: int, end_ns: int) -> bool:
        """As `Navigation.was_believed`."""
        stamps = self.positions.stamps_ns
        before_ns = next_ns = start_ns
        for stamp_ns in stamps[bisect.bisect_right(stamps, start_ns) : bisect.bisect_left(stamps, end_ns)]:
            if stamp_ns - before_ns > self._gps.max_gap_s * 1e9:
                # The receiver's own report comes later than the first position after a gap.
                next_ns = stamp_ns + round(self._gps.quality_timeout_s * 1e9)
            before_ns = stamp_ns
            if stamp_ns >= next_ns and self.fault_at(stamp_ns, self.slip_at(stamp_ns)):
                return False
        return True

    def slip_at(self, moment_ns: int) -> Slip:
        """How position moves against velocity about a moment."""
        return self._slip.at(self.positions, moment_ns)

    def stretch_at(self, moment_ns: int) -> int:
        """A number that changes when positions before a moment cannot be compared with those after it."""
        return self._jumps.stretch_at(moment_ns)

    def sigmas(self, moment_ns: int) -> tuple[float, float]:
        """One sigma (m) of the Gauss-Markov error, horizontal and vertical: `claims`, and jumps left unexplained."""
        horizontal_m, vertical_m = self.claims(moment_ns)
        doubt_m = self._jumps.at(moment_ns)
        return float(np.hypot(horizontal_m, doubt_m[0])), float(np.hypot(vertical_m, doubt_m[1]))

    def claims(self, moment_ns: int) -> tuple[float, float]:
        """The receiver's worst claim of the last two seconds (when jammed it alternates), bounded below."""
        gps, claims = self._gps, self.quality.latest(moment_ns, RECENT_NS)
        return (
            max([gps.sigma_correlated_horizontal_m, *(c.sigma_horizontal_m for c in claims if c.sigma_horizontal_m)]),
            max([gps.sigma_correlated_vertical_m, *(c.sigma_vertical_m for c in claims if c.sigma_vertical_m)]),
        )

    def velocity_claim_m_s(self, moment_ns: int) -> float:
        """One sigma of the velocity, the worst that receiver or filter claimed in the last two seconds; 0: neither."""
        claims = [c.sigma_velocity_m_s for c in self.quality.latest(moment_ns, RECENT_NS)]
        claims += [c.sigma_velocity_m_s for c in self.filter.latest(moment_ns, RECENT_NS)]
        return max((c for c in claims if c is not None), default=0.0)

    def datum_sigma_m(self, moment_ns: int) -> float:
        """One sigma (m) of where the log's heights count from, as far as the log reported it until a moment."""
        return max((quality.sigma_datum_m or 0.0 for quality in self.quality.latest(moment_ns)), default=0.0)

    def _was_unfit(self, start_ns: int, end_ns: int, moved_m: float) -> bool:
        """Whether receiver or filter reported an error as large as `moved_m` shortly before or in a stretch of time.

        The position that follows then corrects what was known to be wrong.
        """
        since_ns = start_ns - LONG_NS
        for quality in self.quality.between(since_ns, end_ns):
            claim_m = quality.sigma_horizontal_m or 0.0
            if not quality.has_fix or LIKELY_SIGMAS * claim_m >= moved_m:
                return True
        if any(not status.has_position for status in self.filter.between(since_ns, end_ns)):
            return True
        return self._receiver_fault(start_ns) != ""

    def _receiver_fault(self, moment_ns: int) -> str:
        """The receiver, if it ever reported, has a fix, reported recently, and has had both since `recovery_s`."""
        gps, last = self._gps, self.quality.latest(moment_ns)
        if last and moment_ns - last[-1].stamp_ns > gps.quality_timeout_s * 1e9:
            return f"the receiver has been silent for more than {gps.quality_timeout_s:g} s"
        has_fix = [quality.has_fix for quality in self._said(self.quality, moment_ns, LONG_NS)]
        losses = sum(was and not now for was, now in itertools.pairwise(has_fix))
        # A fix that comes and goes is a jammed receiver's: back it is no better than after a glitch.
        wait_s = gps.recovery_s if losses < 2 else max(gps.recovery_s, gps.settle_s)
        if all(quality.has_fix for quality in self._said(self.quality, moment_ns, round(wait_s * 1e9))):
            return ""
        return Refusal.RECOVERING if has_fix[-1] else self._no_fix

    def _filter_fault(self, moment_ns: int) -> str:
        """The autopilot's filter accepts its position and its GPS, and has since `recovery_s` ago; or never reported.

        A bad report stands until a good one comes.
        """
        said = self._said(self.filter, moment_ns, round(self._gps.recovery_s * 1e9))
        if all(s.has_position and not s.is_glitching for s in said):
            return ""
        if not said[-1].has_position:
            return Refusal.NO_ABSOLUTE_POSITION
        return Refusal.FILTER_GLITCH if said[-1].is_glitching else Refusal.RECOVERING

    def _said(self, series: Series[T], moment_ns: int, for_ns: int) -> list[T]:
        """Reports of so long until a moment, and the next one: it also holds for the moment before it.

        The first one where none had come yet.
        """
        next_ns = moment_ns + round(self._gps.quality_timeout_s * 1e9)
        said = [*series.latest(moment_ns, for_ns), *series.between(moment_ns + 1, next_ns)[:1]]
        return said or series.values[:1]
