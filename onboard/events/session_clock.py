"""One clock for a session: Unix time that never jumps.

The host's clock may be stepped by hours when NTP or a GPS reaches it. CLOCK_MONOTONIC is not; V4L2 stamps its buffers
with it. So everything live is stamped with monotonic time plus one constant, read once at the start of the session.
"""

from __future__ import annotations

import time
from dataclasses import dataclass


@dataclass(frozen=True)
class SessionClock:
    """Monotonic nanoseconds -> Unix nanoseconds of this session."""

    offset_ns: int

    @classmethod
    def start(cls) -> SessionClock:
        """A new session's clock: Unix time as the host has it now."""
        before = time.monotonic_ns()
        unix_ns = time.time_ns()
        return cls(unix_ns - (before + time.monotonic_ns()) // 2)

    def from_monotonic_ns(self, monotonic_ns: int) -> int:
        """A value of CLOCK_MONOTONIC on the session's clock."""
        return monotonic_ns + self.offset_ns

    def now_ns(self) -> int:
        return time.monotonic_ns() + self.offset_ns

    def host_step_s(self) -> float:
        """The host's Unix clock minus the session's (s): steps and slews since the start."""
        return (time.time_ns() - self.now_ns()) / 1e9
