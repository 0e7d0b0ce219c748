"""The stamps of a helper's frames -> CLOCK_MONOTONIC, with a sigma.

A stamp of this computer's clock is taken as it is. One of the sender's clock is mapped by when pictures came: they may
come late but never early, so the least delay is the offset between the clocks plus what every picture is late by at
least. That least delay cannot be seen here: it is part of `camera.latency_s`, and turns show it in flight.
"""

from __future__ import annotations

import math

from onboard.camera.frame_protocol import Clock, Header, Origin
from onboard.clocks.arrivals import Arrivals
from onboard.events.session_clock import SessionClock

FUTURE_NS = 5_000_000  # a picture that is here was not taken later than that
MAX_AGE_NS = 5_000_000_000  # no one flies with pictures that old: no stamp of this clock
# A stream begins with what had been waiting: pictures are timed once none has been less late than those before for a
# while. Half a second is two thirds of a jitter's range after the first pictures; five, and something else is wrong.
SETTLING_NS, STILL_NS, MAX_SETTLING_NS = 1_000_000_000, 500_000_000, 5_000_000_000
FELL_NS = 5_000_000


class _Mapped:
    """One clock of a sender: nothing until the least delay stands still, then the filter of arrivals."""

    def __init__(self, arrival_ns: int) -> None:
        self._begun_ns = self._fell_ns = arrival_ns
        self._least: tuple[int, int] | None = None  # stamp and arrival of the picture that was least late
        self.arrivals: Arrivals | None = None

    def add(self, stamp_ns: int, arrival_ns: int) -> bool:
        """Take a picture; whether its stamp can be mapped."""
        if self.arrivals is not None:
            self.arrivals.add(stamp_ns, arrival_ns)
            return True
        least = self._least
        if least is None or arrival_ns - stamp_ns < least[1] - least[0]:
            if least is not None and least[1] - least[0] - (arrival_ns - stamp_ns) > FELL_NS:
                self._fell_ns = arrival_ns
            self._least = least = stamp_ns, arrival_ns
        waited_ns, still_ns = arrival_ns - self._begun_ns, arrival_ns - self._fell_ns
        if waited_ns < SETTLING_NS or (still_ns < STILL_NS and waited_ns < MAX_SETTLING_NS):
            return False
        # What was waiting at the stream's beginning came late, and has no part in how late pictures are.
        self.arrivals = Arrivals("auto")
        self.arrivals.add(*least)
        self.arrivals.add(stamp_ns, arrival_ns)
        return True


class SenderClock:
    """Fed with every frame of one source, over restarts of its helper too."""

    def __init__(self, clock: SessionClock, is_utc_trusted: bool) -> None:
        """`is_utc_trusted`: both ends are set by GPS or NTP, so that the sender's Unix time is ours."""
        self._clock, self._is_utc_trusted = clock, is_utc_trusted
        self._known: dict[tuple[Clock, Origin], _Mapped] = {}  # by what kind of stamp it is
        self.sigma_s: float | None = None  # of the newest stamp, as its source or arrivals show it; None: unknown
        self.is_settling = False  # the newest picture came before the least delay was known
        self.complaint = ""
        self.meaning = ""

    def restart(self) -> None:
        """Another stream: its clock may count from elsewhere."""
        self._known.clear()

    def to_monotonic_ns(self, header: Header, now_ns: int) -> int | None:
        """Return when the picture was taken by its stamp, on CLOCK_MONOTONIC, as `now_ns` is.

        None: that cannot be (see `complaint`), or is not known yet (`is_settling`).
        """
        self.complaint, self.is_settling = "", False
        if header.clock is Clock.MONOTONIC:
            self.sigma_s = header.sigma_s if header.sigma_s >= 0.0 else None
            self.meaning = "its own clock"
            return self._if_possible(header.stamp_ns, now_ns)
        arrival_ns = header.arrival_ns if 0 <= now_ns - header.arrival_ns <= MAX_AGE_NS else now_ns
        if header.clock is Clock.SENDER_UTC and self._is_utc_trusted:
            own_ns = header.stamp_ns - self._clock.offset_ns
            if -FUTURE_NS <= arrival_ns - own_ns <= MAX_AGE_NS:
                self.sigma_s = header.sigma_s if header.sigma_s >= 0.0 else None
                self.meaning = "the sender's UTC, taken for ours"
                return own_ns
            ahead_s = (own_ns - arrival_ns) / 1e9
            self.complaint = (
                f"the sender's UTC is {ahead_s:+.1f} s off ours, and no picture is used: set both clocks, or "
                'camera.stream_clock = "own"'
            )
            return None
        return self._by_arrival(header, arrival_ns)

    def _if_possible(self, stamp_ns: int, now_ns: int) -> int | None:
        age_s = (now_ns - stamp_ns) / 1e9
        if -FUTURE_NS <= now_ns - stamp_ns <= MAX_AGE_NS:
            return stamp_ns
        self.complaint = f"stamps are no times of CLOCK_MONOTONIC: {age_s:.4g} s old, and not used"
        return None

    def _by_arrival(self, header: Header, arrival_ns: int) -> int | None:
        mapped = self._known.setdefault((header.clock, header.origin), _Mapped(arrival_ns))
        self.is_settling = not mapped.add(header.stamp_ns, arrival_ns)
        if mapped.arrivals is None:
            return None
        offset_ns, _, sigma_ns = mapped.arrivals.line(header.stamp_ns)
        own_sigma_s = header.sigma_s if header.sigma_s >= 0.0 else 0.0
        self.sigma_s = math.hypot(sigma_ns / 1e9, own_sigma_s)
        self.meaning = "the sender's clock, by the least delay of arrivals"
        return header.stamp_ns + offset_ns
