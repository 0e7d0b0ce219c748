"""A clock for a flight that runs as fast as the machine can fly it, and slower where it cannot keep up.

The daemon's process owns it and passes it to the others by a small file: flight time is linear in CLOCK_MONOTONIC,
which all processes share, from one change of speed to the next.
"""

from __future__ import annotations

import os
import struct
import time
from dataclasses import dataclass, field
from pathlib import Path

from onboard.events.session_clock import SessionClock

_RECORD = struct.Struct("<qqdqq")
AHEAD_S, BEHIND_S = 0.2, 0.45  # of pictures waiting: less and it runs faster, more and it runs slower
FASTER = 1.35  # a second of flight
SLOWER, SETTLE_NS = 0.8, 300_000_000  # not again before the last step can have helped
SLACK_NS = 300_000_000  # how far it runs past the next picture's moment before that picture has come


@dataclass(frozen=True)
class Pace:
    """The pace of a flight's clock, which read `flight_ns` (Unix) at `monotonic_ns`. Since then it runs `speed` times
    as fast. It stands still at `limit_ns`.
    """

    monotonic_ns: int
    flight_ns: int
    speed: float
    limit_ns: int

    def at(self, monotonic_ns: int) -> int:
        """The flight's clock at a moment of CLOCK_MONOTONIC."""
        return min(self.flight_ns + round((monotonic_ns - self.monotonic_ns) * self.speed), self.limit_ns)

    def now_ns(self) -> int:
        """The flight's clock now."""
        return self.at(time.monotonic_ns())


class Governor:
    """Keeps the pace, and the file that holds it. The camera's thread governs; any may ask.

    A process that others keep from running for a moment would find that moment's pictures all due at once, several
    times as many as in real time: so the flight waits for its camera. How much time that took shows in the factor, and
    in what is measured by the wall.
    """

    def __init__(self, path: Path, top_speed: float, lead_ns: int) -> None:
        """Real time for `lead_ns`, if the camera governs by then; later never faster than `top_speed`."""
        began_ns = time.time_ns()
        self.pace = Pace(time.monotonic_ns(), began_ns, 1.0, began_ns + lead_ns)
        self._top_speed = top_speed
        self._slowed_ns = 0
        self._next_ns = began_ns + lead_ns
        self._file = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
        self._tell()

    def govern(self, waiting_s: float, next_ns: int) -> None:
        """So many seconds of pictures wait for the pipeline, and the next one is due then."""
        pace, speed, now_ns = self.pace, self.pace.speed, time.monotonic_ns()
        if waiting_s >= BEHIND_S:
            if now_ns - self._slowed_ns > SETTLE_NS:
                speed, self._slowed_ns = max(speed * SLOWER, 1.0), now_ns
        elif waiting_s < AHEAD_S:
            speed = min(speed * FASTER ** ((next_ns - self._next_ns) / 1e9), self._top_speed)
        self._next_ns = next_ns
        self.pace = Pace(now_ns, pace.at(now_ns), speed, max(next_ns + SLACK_NS, pace.limit_ns))
        self._tell()

    def _tell(self) -> None:
        pace = self.pace
        check = pace.monotonic_ns ^ pace.flight_ns ^ pace.limit_ns
        os.pwrite(self._file, _RECORD.pack(pace.monotonic_ns, pace.flight_ns, pace.speed, pace.limit_ns, check), 0)


class StatedClock:
    """The flight's clock in another process. A `simulation.autopilot.fake.Clock`."""

    def __init__(self, path: Path) -> None:
        self._file = os.open(path, os.O_RDONLY)
        self._pace = Pace(0, 0, 1.0, 0)

    def pace(self) -> Pace:
        """The newest pace of the clock."""
        record = os.pread(self._file, _RECORD.size, 0)
        if len(record) == _RECORD.size:
            monotonic_ns, flight_ns, speed, limit_ns, check = _RECORD.unpack(record)
            if monotonic_ns ^ flight_ns ^ limit_ns == check:  # else it is just being written
                self._pace = Pace(monotonic_ns, flight_ns, speed, limit_ns)
        return self._pace

    def now_ns(self) -> int:
        """The flight's clock now."""
        return self.pace().now_ns()

    def wall_s(self, ns: int) -> float:
        """Real seconds that so much of the flight takes at this speed."""
        return ns / 1e9 / self._pace.speed

    def close(self) -> None:
        """The end of it."""
        os.close(self._file)


@dataclass(frozen=True)
class FlightClock(SessionClock):
    """The session's clock, at the governor's pace."""

    governor: Governor = field(kw_only=True)

    def from_monotonic_ns(self, monotonic_ns: int) -> int:
        """A moment on the flight's clock."""
        return self.governor.pace.at(monotonic_ns)

    def now_ns(self) -> int:
        """Now, in flight."""
        return self.governor.pace.now_ns()

    def wall_s(self, ns: int) -> float:
        """Real seconds that so much of the flight takes at this speed."""
        return ns / 1e9 / self.governor.pace.speed
