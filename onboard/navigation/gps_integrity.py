"""Acceptance of positions, and their sigmas: receiver, autopilot's filter, position against velocity.

GPS is accepted until the messages contradict it: a lost or silent fix, a jump that the velocity does not explain, or a
filter that slips (moves its position against its own velocity, as it does while it corrects an error) refuses every
moment from then until it has settled again. Slip is measured over two seconds: at most 0.3 m/s in recorded clean
flights, 0.65 m/s in the real one; 1 to 4 m/s while jammed and for the ten seconds of recovery in which the receiver's
own figures are already perfect and the position is still 28 to 4 m off.
"""

from __future__ import annotations

import itertools
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from onboard.config.schema import Config
from onboard.events.types import FilterStatus, GpsQuality, PositionFix
from onboard.navigation.limits import LIKELY_SIGMAS, LONG_NS, MEMORY_NS, RECENT_NS
from onboard.navigation.position_interpolation import Path, Position
from onboard.navigation.position_jumps import PositionJumps
from onboard.navigation.position_slip import slip_at
from onboard.navigation.receiver_positions import ReceiverPositions
from onboard.navigation.time_series import Series, T

Array = NDArray[np.float64]


class Refusal(StrEnum):
    """Reasons why no position is accepted: the words that people see."""

    NOTHING_YET = "no position yet"
    UNHEARD = "waiting for the receiver's and the filter's own report"
    NO_FIX_YET = "no fix yet"
    FIX_LOST = "fix lost"
    NO_ABSOLUTE_POSITION = "the autopilot's filter has no absolute position"
    FILTER_GLITCH = "the autopilot's filter calls the GPS a glitch"
    RECOVERING = "recovering"


class GpsIntegrity:
    """Takes positions, receiver and filter reports; determines for any moment whether its position is accepted."""

    def __init__(self, config: Config) -> None:
        self._gps, self._had_fix = config.gps, False
        self.forget()

    def forget(self) -> None:
        """The clock was set back: nothing held can be compared any more."""
        self.quality: Series[GpsQuality] = Series()
        self.filter: Series[FilterStatus] = Series()
        self.positions = Path(self._gps.max_gap_s)
        self.jumps = PositionJumps(self._gps, self._was_unfit)
        self._receiver = ReceiverPositions(self._gps, self._was_receiver_unfit)

    def begin(self, jumped_ns: int | None) -> None:
        """Positions come in a new frame; `jumped_ns`: when those of the old were found to be elsewhere, if so."""
        self.positions = Path(self._gps.max_gap_s)
        self.jumps.begin(jumped_ns)
        self._receiver.begin(jumped_ns)

    def first_accepted(self, fixes: Series[PositionFix], now_ns: int) -> tuple[list[PositionFix], str]:
        """The first positions that may be accepted with data up to `now_ns`, and the reason if there are none.

        Reports of receiver and filter are awaited: a filter without a fix reports a place that it remembers, and its
        own report may come later than that place.
        """
        receiver, filters = self.quality.values, self.filter.values
        is_waiting = now_ns - fixes.stamps_ns[0] < self._gps.quality_timeout_s * 1e9
        if self.unfit or (is_waiting and not (receiver and filters)):
            return [], self.unfit or Refusal.UNHEARD
        unfit_ns = [q.stamp_ns for q in receiver if not q.has_fix] + [f.stamp_ns for f in filters if not f.has_position]
        accepted = [fix for fix in fixes.values if fix.stamp_ns > max(unfit_ns, default=0)]
        return accepted, "" if accepted else Refusal.RECOVERING

    @property
    def unfit(self) -> str:
        """The reason for no position by the newest report of receiver or filter; empty if neither denies it."""
        if self.quality.values and not self.quality.values[-1].has_fix:
            return self._no_fix
        if self.filter.values and not self.filter.values[-1].has_position:
            return Refusal.NO_ABSOLUTE_POSITION
        return ""

    @property
    def _no_fix(self) -> Refusal:
        return Refusal.FIX_LOST if self._had_fix else Refusal.NO_FIX_YET

    def note_quality(self, quality: GpsQuality) -> None:
        """The receiver's report."""
        self.quality.insert(quality.stamp_ns, quality)
        self._had_fix |= quality.has_fix

    def note_receiver_position(self, stamp_ns: int, position: Position) -> None:
        """The receiver's own position."""
        self._receiver.insert(stamp_ns, position, self.claims(stamp_ns))

    def note_position(self, stamp_ns: int, position: Position) -> None:
        """The filter's position, or the receiver's if there is no other."""
        if self.positions.insert(stamp_ns, position) == len(self.positions.stamps_ns) - 1:
            claims = self.claims(stamp_ns)
            self.jumps.append(self.positions, claims)
            self._receiver.compare(self.positions, claims[0])

    def judge(self, moment_ns: int) -> tuple[str, float]:
        """The reason why a position at a moment is not accepted, empty if it is; one sigma (m) of its white part."""
        slip = slip_at(self.positions, moment_ns, self._gps)
        slips = f"position moves {slip.surely_m_s:.1f} m/s against velocity"
        fault = (
            self._receiver_fault(moment_ns)
            or self._filter_fault(moment_ns)
            or self.jumps.refusal_at(moment_ns)
            or self._receiver.jumps.refusal_at(moment_ns)
            or (slips if slip.exceeds(self._gps.max_slip_m_s) else "")
        )
        return fault, max(self._gps.sigma_white_m, min(slip.dispersion_m, self._gps.glitch_m))

    def sigmas(self, moment_ns: int) -> tuple[float, float]:
        """One sigma (m) of the Gauss-Markov error, horizontal and vertical: `claims`, and what is in doubt.

        The receiver's velocity is horizontal, so its heights are not judged by it.
        """
        horizontal_m, vertical_m = self.claims(moment_ns)
        doubt_m, by_receiver_m = self.jumps.at(moment_ns), self._receiver.doubt_m(moment_ns)
        horizontal_doubt_m = doubt_m[0] if by_receiver_m is None else by_receiver_m
        return float(np.hypot(horizontal_m, horizontal_doubt_m)), float(np.hypot(vertical_m, doubt_m[1]))

    def claims(self, moment_ns: int) -> tuple[float, float]:
        """The receiver's worst claim of the last two seconds (when jammed it alternates), bounded below."""
        gps, claims = self._gps, self.quality.latest(moment_ns, RECENT_NS)
        return (
            max([gps.sigma_correlated_horizontal_m, *(c.sigma_horizontal_m for c in claims if c.sigma_horizontal_m)]),
            max([gps.sigma_correlated_vertical_m, *(c.sigma_vertical_m for c in claims if c.sigma_vertical_m)]),
        )

    def velocity_claim_m_s(self, moment_ns: int) -> float:
        """One sigma of the velocity, the worst that receiver or filter claimed in the last two seconds; 0: neither."""
        claims = [q.sigma_velocity_m_s or 0.0 for q in self.quality.latest(moment_ns, RECENT_NS)]
        claims += [f.sigma_velocity_m_s or 0.0 for f in self.filter.latest(moment_ns, RECENT_NS)]
        return max(claims, default=0.0)

    def datum_sigma_m(self, moment_ns: int) -> float:
        """One sigma (m) of where the log's heights count from, as far as the log reported it until a moment."""
        return max((quality.sigma_datum_m or 0.0 for quality in self.quality.latest(moment_ns)), default=0.0)

    def _was_unfit(self, start_ns: int, end_ns: int, moved_m: float) -> bool:
        """Return whether receiver or filter reported an error as large as `moved_m` in or shortly before a stretch.

        The position that follows then corrects an error that was known. Where the receiver's own position did not jump,
        the filter's velocity was wrong.
        """
        reports = self.filter.between(start_ns - LONG_NS, end_ns).values
        return (
            self._was_receiver_unfit(start_ns, end_ns, moved_m)
            or not all(f.has_position for f in reports)
            or self._receiver.was_steady(start_ns, end_ns)
        )

    def _was_receiver_unfit(self, start_ns: int, end_ns: int, moved_m: float) -> bool:
        claims = self.quality.between(start_ns - LONG_NS, end_ns).values
        return (
            any(not q.has_fix or LIKELY_SIGMAS * (q.sigma_horizontal_m or 0.0) >= moved_m for q in claims)
            or self._receiver_fault(start_ns) != ""
        )

    def _receiver_fault(self, moment_ns: int) -> str:
        """The receiver, if it ever reported, has a fix, reported recently, and has had both since `recovery_s`."""
        gps, last = self._gps, self.quality.latest(moment_ns)
        if last and moment_ns - last[-1].stamp_ns > gps.quality_timeout_s * 1e9:
            return f"the receiver has been silent for more than {gps.quality_timeout_s:g} s"
        has_fix = [quality.has_fix for quality in self._reports(self.quality, moment_ns, LONG_NS)]
        losses = sum(was and not now for was, now in itertools.pairwise(has_fix))
        # A fix that comes and goes is a jammed receiver's: back it is no better than after a glitch.
        wait_s = gps.recovery_s if losses < 2 else max(gps.recovery_s, gps.settle_s)
        if all(quality.has_fix for quality in self._reports(self.quality, moment_ns, round(wait_s * 1e9))):
            return ""
        return Refusal.RECOVERING if has_fix[-1] else self._no_fix

    def _filter_fault(self, moment_ns: int) -> str:
        """The autopilot's filter accepts its position and its GPS, and has since `recovery_s` ago; or never reported.

        A bad report stands until a good one comes; but not that of a glitch that is over, for ArduPilot rejects its
        receiver for ten seconds more, and calls it one for another ten.
        """
        reports = self._reports(self.filter, moment_ns, round(self._gps.recovery_s * 1e9))
        if all(s.has_position and (not s.is_glitching or self._is_over(s.stamp_ns)) for s in reports):
            return ""
        if not reports[-1].has_position:
            return Refusal.NO_ABSOLUTE_POSITION
        return Refusal.FILTER_GLITCH if reports[-1].is_glitching else Refusal.RECOVERING

    def _is_over(self, moment_ns: int) -> bool:
        """Return whether what the filter calls a glitch is one that the receiver has come back from, as has the filter.

        Where the receiver did not jump, which of the two was wrong cannot be determined.
        """
        reports = reversed(self.filter.latest(moment_ns, MEMORY_NS))
        *_, first = itertools.takewhile(lambda report: report.is_glitching, reports)
        doubt_m = self._receiver.doubt_m(moment_ns)
        return (
            doubt_m is not None
            and doubt_m <= LIKELY_SIGMAS * self.claims(moment_ns)[0]
            and not self._receiver.was_steady(first.stamp_ns, moment_ns)
        )

    def _reports(self, series: Series[T], moment_ns: int, for_ns: int) -> list[T]:
        """Reports of so long until a moment, and the next one: it also holds for the moment before it.

        The first one where none had come yet.
        """
        next_ns = moment_ns + round(self._gps.quality_timeout_s * 1e9)
        reports = [*series.latest(moment_ns, for_ns), *series.between(moment_ns + 1, next_ns).values[:1]]
        return reports or series.values[:1]
