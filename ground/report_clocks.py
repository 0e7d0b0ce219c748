"""The stamps of reports by the ground's own clock: each session is judged by when its reports came. No clock, no I/O.

A vehicle's clock may be hours ahead or behind, and any one stamp may be false. What a session's reports agree on is how
much earlier they are stamped than they come; the least of that ties its clock to the ground's.
"""

from __future__ import annotations

from collections import deque

from contract.spot import SpotReport
from ground.aircraft_clock import AHEAD_S
from ground.last_received import LastReceived

MOST_SESSIONS = 1000  # a peer may invent vehicles
HELD = 15  # newest reports of a session by which its clock is judged
AGREED_NS = round(AHEAD_S * 1e9)  # by which reports of one clock may come later than others


class ReportClocks:
    """Takes every report as it comes. Not for use by several threads at once."""

    def __init__(self) -> None:
        self._lags = LastReceived(lambda _: deque[int](maxlen=HELD), MOST_SESSIONS)
        self._doubted: dict[str, tuple[int, SpotReport]] = {}
        self.false_stamps = 0

    def accepted(self, report: SpotReport, received_unix_ns: int) -> list[SpotReport]:
        """Note a report that came, and return those that are accepted now: none if its stamp contradicts those of
        its session, or, of a first one, the ground's clock; of a clock that is wrong the first comes with the second.
        """
        key = _key(report.vehicle, report.session)
        lags, lag = self._lags.of(key), received_unix_ns - report.capture_unix_ns
        lags.append(lag)
        out = []
        if (before := self._doubted.pop(key, None)) is not None:
            if abs(before[0] - _usual(lags)) <= AGREED_NS:
                out.append(before[1])
            else:
                self.false_stamps += 1
        if abs(lag - _usual(lags)) <= AGREED_NS:
            return [*out, report]
        if len(self._doubted) < MOST_SESSIONS:
            self._doubted[key] = lag, report
        return out

    @property
    def waiting(self) -> int:
        """The number of reports that the next one of their session judges."""
        return len(self._doubted)

    def at_unix_ns(self, vehicle: str, session: int, stamp_unix_ns: int, received_unix_ns: int | None = None) -> int:
        """The ground's time at which something was captured, at the latest; of a false stamp, when it came."""
        lags = self._lags.get(_key(vehicle, session))
        if not lags:
            return stamp_unix_ns if received_unix_ns is None else received_unix_ns
        # The votes of the reports alone: also a clock that is wrong is that of its session.
        usual = sorted(lags)[len(lags) // 2]
        if received_unix_ns is not None and abs(received_unix_ns - stamp_unix_ns - usual) > AGREED_NS:
            return received_unix_ns
        return stamp_unix_ns + min(lag for lag in lags if abs(lag - usual) <= AGREED_NS)

    def copy(self) -> ReportClocks:
        """The same, for a look while more come."""
        out = ReportClocks()
        for key in self._lags:
            out._lags.of(key).extend(self._lags.get(key) or ())
        return out


def _key(vehicle: str, session: int) -> str:
    return f"{session} {vehicle}"


def _usual(lags: deque[int]) -> int:
    """The median of the lags and of a clock that agrees with the ground's; of the middle two the lesser difference."""
    ordered = sorted([0, *lags])
    middle = ordered[(len(ordered) - 1) // 2 : len(ordered) // 2 + 1]
    return min(middle, key=abs)
