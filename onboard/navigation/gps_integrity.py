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
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from onboard.config.schema import Config
from onboard.events.types import FilterStatus, GpsQuality
from onboard.navigation.position_doubt import ALIKE_SIGMAS, PositionDoubt
from onboard.navigation.position_interpolation import Position, finite
from onboard.navigation.position_slip import Slip, SlipTest
from onboard.navigation.time_series import MEMORY_NS, Series

Array = NDArray[np.float64]
T = TypeVar("T")

CLAIM_WINDOW_NS = 2_000_000_000
FLAPPING_NS = 10_000_000_000
UNUSABLE_FIX = 2  # GPS_FIX_TYPE up to this one
GLITCH_SIGMAS = 5.0
BELIEF_STEP_NS = 500_000_000  # of `was_believed`: shorter than any refusal lasts

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
        self._config, self._gps = config, config.gps
        self._slip = SlipTest(config.gps)
        self.quality: Series[GpsQuality] = Series()
        self.filter: Series[FilterStatus] = Series()
        self.positions: Series[Position] = Series()
        self._jumps: list[tuple[int, int, str]] = []  # refused from, until (ns), and why
        self._had_fix = False
        self._doubt = PositionDoubt(config, self._slip, self._was_unfit)

    def forget(self) -> None:
        """The clock was set back: nothing held can be compared any more."""
        self.quality, self.filter, self.positions = Series(), Series(), Series()
        self._jumps.clear()
        self._doubt = PositionDoubt(self._config, self._slip, self._was_unfit)

    def begin(self, positions: Series[Position], jumped_ns: int | None) -> None:
        """Positions in a new frame; `jumped_ns`: when those of the old frame were found to be elsewhere, if so."""
        self.positions = positions
        self._doubt.begin()
        if jumped_ns is not None:
            until_ns = jumped_ns + round(self._gps.settle_s * 1e9)
            self._jumps.append((jumped_ns, until_ns, "the position began to be somewhere else altogether, settling"))

    # ------------------------------------------------------------------ before there is a frame

    def first_belief(self, first_ns: int, now_ns: int) -> tuple[int | None, str]:
        """Since when positions may be accepted with data up to `now_ns`, or None and why they may not.

        `first_ns`: stamp of the first position. Receiver and filter are waited for: a filter without a fix reports a
        place that it remembers, and its own report may come later than that place.
        """
        unfit_ns = 0
        for said_ns, is_fit, why in self._last_words():
            if not is_fit:
                return None, why
            unfit_ns = max(unfit_ns, said_ns)
        has_spoken = bool(self.quality.stamps_ns) and bool(self.filter.stamps_ns)
        if not has_spoken and now_ns - first_ns < self._gps.quality_timeout_s * 1e9:
            return None, UNHEARD
        return unfit_ns, ""

    @property
    def is_unfit_now(self) -> bool:
        """Whether the newest report of receiver or filter denies that there is a position."""
        quality, status = self.quality.values, self.filter.values
        return bool(quality and quality[-1].fix_type <= UNUSABLE_FIX) or bool(status and not status[-1].has_position)

    def _last_words(self) -> list[tuple[int, bool, str]]:
        """Of receiver and filter: when each last was unfit (0: never), whether it is fit now, and why not."""
        out = []
        if self.quality.stamps_ns:
            fit = [q.fix_type > UNUSABLE_FIX for q in self.quality.values]
            out.append((_last_unfit_ns(self.quality.stamps_ns, fit), fit[-1], FIX_LOST if any(fit) else NO_FIX_YET))
        if self.filter.stamps_ns:
            fit = [f.has_position for f in self.filter.values]
            out.append((_last_unfit_ns(self.filter.stamps_ns, fit), fit[-1], NO_ABSOLUTE_POSITION))
        return out

    # ------------------------------------------------------------------ what comes in

    def note_quality(self, quality: GpsQuality) -> None:
        """The receiver's report."""
        self.quality.insert(quality.stamp_ns, quality)
        self._had_fix |= quality.fix_type > UNUSABLE_FIX

    def note_filter(self, status: FilterStatus) -> None:
        """The filter's report."""
        self.filter.insert(status.stamp_ns, status)

    def note_position(self, index: int) -> None:
        """A position inserted at `index`: remember a jump that velocity does not explain until it has settled."""
        if index == len(self.positions.stamps_ns) - 1:
            self._doubt.append(self.positions, self.claims(self.positions.stamps_ns[index])[0])
        if index == 0:
            return
        gps, stamps = self._gps, self.positions.stamps_ns
        before, after = self.positions.values[index - 1], self.positions.values[index]
        start_ns, end_ns = stamps[index - 1], stamps[index]
        seconds = (end_ns - start_ns) / 1e9
        if seconds > gps.max_gap_s:
            return
        both = (before.velocity_enu_m_s, after.velocity_enu_m_s)
        velocities = [finite(v) for v in both if v is not None]
        if velocities:
            predicted = np.mean(velocities, axis=0) * seconds
        elif index > 1:
            earlier_s = (start_ns - stamps[index - 2]) / 1e9
            predicted = (before.enu_m - self.positions.values[index - 2].enu_m) * (seconds / earlier_s)
        else:
            return
        sigma_horizontal_m, sigma_vertical_m = self.claims(end_ns)
        miss = after.enu_m - before.enu_m - predicted
        horizontal = np.hypot(miss[0], miss[1]) > max(gps.glitch_m, GLITCH_SIGMAS * sigma_horizontal_m)
        if not horizontal and abs(miss[2]) <= max(gps.glitch_m, GLITCH_SIGMAS * sigma_vertical_m):
            return
        why = f"position jumped {np.linalg.norm(miss):.0f} m against velocity, settling"
        self._jumps.append((start_ns, end_ns + round(gps.settle_s * 1e9), why))
        self._jumps = [jump for jump in self._jumps if jump[1] > stamps[-1] - 2 * MEMORY_NS]
        if not velocities or not horizontal:  # else it is measured as slip
            self._doubt.jumped(start_ns, end_ns, miss, sigma_horizontal_m)

    # ------------------------------------------------------------------ what is asked

    def fault_at(self, moment_ns: int, slip: Slip) -> str:
        """Why a position at a moment is not accepted; empty if it is. `slip`: `slip_at` the same moment."""
        why = self._receiver_fault(moment_ns) or self._filter_fault(moment_ns)
        if why:
            return why
        for start_ns, end_ns, jump in self._jumps:
            if start_ns <= moment_ns < end_ns:
                return jump
        if slip.exceeds(self._gps.max_slip_m_s):
            return f"position moves {slip.surely_m_s:.1f} m/s against velocity"
        return ""

    def was_believed(self, start_ns: int, end_ns: int) -> bool:
        """As `Navigation.was_believed`."""
        stamps = self.positions.stamps_ns
        before_ns = next_ns = start_ns
        for stamp_ns in stamps[bisect.bisect_right(stamps, start_ns) : bisect.bisect_left(stamps, end_ns)]:
            if stamp_ns - before_ns > self._gps.max_gap_s * 1e9:
                # The receiver's own report comes later than the first position after a gap.
                next_ns = stamp_ns + round(self._gps.quality_timeout_s * 1e9)
            before_ns = stamp_ns
            if stamp_ns >= next_ns:
                if self.fault_at(stamp_ns, self.slip_at(stamp_ns)):
                    return False
                next_ns = stamp_ns + BELIEF_STEP_NS
        return True

    def slip_at(self, moment_ns: int) -> Slip:
        """How position moves against velocity about a moment."""
        return self._slip.at(self.positions, moment_ns)

    def stretch_at(self, moment_ns: int) -> int:
        """A number that changes when positions before a moment cannot be compared with those after it."""
        return self._doubt.stretch_at(moment_ns)

    def sigmas(self, moment_ns: int) -> tuple[float, float]:
        """One sigma (m) of the Gauss-Markov error, horizontal and vertical: `claims`, and jumps left unexplained."""
        horizontal_m, vertical_m = self.claims(moment_ns)
        doubt_m = self._doubt.at(moment_ns)
        return float(np.hypot(horizontal_m, doubt_m[0])), float(np.hypot(vertical_m, doubt_m[1]))

    def claims(self, moment_ns: int) -> tuple[float, float]:
        """The receiver's worst claim of the last two seconds (when jammed it alternates), bounded below."""
        gps, claims = self._gps, _recent(self.quality, moment_ns)
        return (
            max([gps.sigma_correlated_horizontal_m, *(c.sigma_horizontal_m for c in claims if c.sigma_horizontal_m)]),
            max([gps.sigma_correlated_vertical_m, *(c.sigma_vertical_m for c in claims if c.sigma_vertical_m)]),
        )

    def velocity_claim_m_s(self, moment_ns: int) -> float:
        """One sigma of the velocity, the worst that receiver or filter claimed in the last two seconds; 0: neither."""
        claims = [c.sigma_velocity_m_s for c in _recent(self.quality, moment_ns)]
        claims += [c.sigma_velocity_m_s for c in _recent(self.filter, moment_ns)]
        return max((c for c in claims if c is not None), default=0.0)

    def datum_sigma_m(self, moment_ns: int) -> float:
        """One sigma (m) of where the log's heights count from, as far as the log reported it until a moment."""
        last = self.quality.last_until(moment_ns)
        return 0.0 if last is None else self.quality.values[last].sigma_datum_m or 0.0

    def _was_unfit(self, start_ns: int, end_ns: int, moved_m: float) -> bool:
        """Whether receiver or filter reported an error as large as `moved_m` shortly before or in a stretch of time.

        The position that follows then corrects what was known to be wrong.
        """
        since_ns = start_ns - FLAPPING_NS
        for quality in _between(self.quality, since_ns, end_ns):
            claim_m = quality.sigma_horizontal_m or 0.0
            if quality.fix_type <= UNUSABLE_FIX or ALIKE_SIGMAS * claim_m >= moved_m:
                return True
        if any(not status.has_position for status in _between(self.filter, since_ns, end_ns)):
            return True
        return self._receiver_fault(start_ns) != ""

    def _receiver_fault(self, moment_ns: int) -> str:
        """The receiver, if it ever spoke, has a fix, spoke lately, and has had both since `recovery_s`."""
        if not self.quality.stamps_ns:
            return ""
        gps, stamps = self._gps, self.quality.stamps_ns
        none = FIX_LOST if self._had_fix else NO_FIX_YET
        last = self.quality.last_until(moment_ns)
        if last is None:  # it had not spoken yet
            return "" if self.quality.values[0].fix_type > UNUSABLE_FIX else none
        if moment_ns - stamps[last] > gps.quality_timeout_s * 1e9:
            return f"the receiver has been silent for more than {gps.quality_timeout_s:g} s"
        # The message after an exposure also holds for the moment before it.
        after = min(last + 1, len(stamps) - 1)
        if stamps[after] - moment_ns > gps.quality_timeout_s * 1e9:
            after = last
        recent = min(bisect.bisect_right(stamps, moment_ns - FLAPPING_NS), last)
        has_fix = [quality.fix_type > UNUSABLE_FIX for quality in self.quality.values[recent : after + 1]]
        losses = sum(was and not now for was, now in itertools.pairwise(has_fix))
        # A fix that comes and goes is a jammed receiver's: back it is no better than after a glitch.
        wait_s = gps.recovery_s if losses < 2 else max(gps.recovery_s, gps.settle_s)
        since = bisect.bisect_right(stamps, moment_ns - round(wait_s * 1e9))
        if all(has_fix[max(min(since, last) - recent, 0) :]):
            return ""
        return RECOVERING if has_fix[-1] else none

    def _filter_fault(self, moment_ns: int) -> str:
        """The autopilot's filter accepts its position and its GPS, and has since `recovery_s` ago; or never reported.

        Between two reports the later one counts as well; a bad one stands until a good one comes.
        """
        stamps = self.filter.stamps_ns
        if not stamps:
            return ""
        last = self.filter.last_until(moment_ns)
        if last is None:
            last = 0  # it had not spoken yet
        first = min(bisect.bisect_right(stamps, moment_ns - round(self._gps.recovery_s * 1e9)), last)
        after = min(last + 1, len(stamps) - 1)
        if stamps[after] - moment_ns > self._gps.quality_timeout_s * 1e9:
            after = last
        said = self.filter.values[first : after + 1]
        if all(s.has_position and not s.is_glitching for s in said):
            return ""
        if not said[-1].has_position:
            return NO_ABSOLUTE_POSITION
        return FILTER_GLITCH if said[-1].is_glitching else RECOVERING


def _last_unfit_ns(stamps_ns: list[int], fit: list[bool]) -> int:
    return next((stamp for stamp, good in zip(reversed(stamps_ns), reversed(fit), strict=True) if not good), 0)


def _recent(series: Series[T], moment_ns: int) -> list[T]:
    """Reports of the last two seconds until a moment; where there are none, the last one before them."""
    last = bisect.bisect_right(series.stamps_ns, moment_ns)
    first = bisect.bisect_left(series.stamps_ns, moment_ns - CLAIM_WINDOW_NS)
    return series.values[min(first, max(last - 1, 0)) : last]


def _between(series: Series[T], start_ns: int, end_ns: int) -> list[T]:
    first, last = bisect.bisect_left(series.stamps_ns, start_ns), bisect.bisect_right(series.stamps_ns, end_ns)
    return series.values[first:last]
