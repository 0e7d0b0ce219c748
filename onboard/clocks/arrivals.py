"""The boot clock by when messages arrive, for links whose autopilot does not answer TIMESYNC, with a stated sigma."""

from __future__ import annotations

import math
from dataclasses import dataclass

from onboard.clocks.boot_clock import BootClock, Mode

NS_PER_S = 1_000_000_000
MEMORY_NS = 120 * NS_PER_S
SHORT_MEMORY_NS = 24 * NS_PER_S  # long enough for `BootClock` to distinguish a drift from a queue
BIN_NS = NS_PER_S
RECENT_BINS = 10
NEAREST_BINS = 3


@dataclass
class _Bin:
    """The arrivals of one second of boot time; offsets less the first one's."""

    boot_ns: int
    least_ns: int
    total_ns: int = 0
    count: int = 0


class Arrivals:
    """Boot time -> offset to the session's clock from arrivals alone. A constant of the last two minutes, or a drift;
    where the rate changes meanwhile, the last 24 s count."""

    def __init__(self, mode: Mode) -> None:
        self._long = BootClock(mode, MEMORY_NS)
        self._short = BootClock(mode, SHORT_MEMORY_NS) if mode == "auto" else self._long
        self._bins: dict[int, _Bin] = {}
        self.segments = 0  # runs of the boot clock so far

    def add(self, boot_ns: int, arrival_ns: int) -> bool:
        """Take one message's boot stamp and arrival; returns whether it begins a new run of the boot clock."""
        started = self._long.add(boot_ns, arrival_ns) + 1 > self.segments
        if self._short is not self._long:
            self._short.add(boot_ns, arrival_ns)
        if started:
            self.segments = self._long.segments
            self._bins.clear()
        offset_ns = arrival_ns - boot_ns
        key = boot_ns // BIN_NS
        held = self._bins.get(key)
        if held is None:
            held = self._bins[key] = _Bin(boot_ns, offset_ns)
            for old in [k for k in self._bins if k <= key - RECENT_BINS]:
                del self._bins[old]
        if offset_ns < held.least_ns:
            held.boot_ns, held.least_ns = boot_ns, offset_ns
        held.total_ns += offset_ns
        held.count += 1
        return started

    def nearest_offset_ns(self) -> int:
        """The least of the last three seconds' arrivals less boot times: the offset plus the least delay of then."""
        newest = max(self._bins)
        return min(held.least_ns for key, held in self._bins.items() if key > newest - NEAREST_BINS)

    def line(self, boot_ns: int) -> tuple[int, float, float]:
        """Offset (ns) and drift at a boot time, and one sigma (ns) as far as arrivals show it.

        The sigma holds how far the last seconds' least offsets lie from the line, and how late messages usually are.
        A delay that is the same for all of them cannot be detected.
        """
        chosen = self._long
        miss = self._miss_ns(chosen)
        if self._short.drift() and self._short is not chosen:
            other = self._miss_ns(self._short)
            if other < miss:
                chosen, miss = self._short, other
        count = sum(held.count for held in self._bins.values())
        late = sum(held.total_ns - held.least_ns * held.count for held in self._bins.values()) / count
        return chosen.to_host_ns(boot_ns) - boot_ns, chosen.drift(), math.hypot(miss, late)

    def _miss_ns(self, clock: BootClock) -> float:
        misses = [held.boot_ns + held.least_ns - clock.to_host_ns(held.boot_ns) for held in self._bins.values()]
        return math.sqrt(sum(float(miss) ** 2 for miss in misses) / len(misses))
