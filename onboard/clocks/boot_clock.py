"""The autopilot's boot clock -> our clock, from nothing but when messages with a boot stamp arrived.

A message may come late but never early, so arrival minus boot time is the clocks' offset plus a delay that is never
negative: the offset is its lower envelope. Whether that envelope is one constant or a drift is decided by evidence.
A rising envelope is ambiguous (a queue that grows, a simulator that stalls and a drifting clock all look so); it is
taken as a drift only if it is both large and straight. Measured: a recorded ArduPilot simulation rises by 0.16 to
0.38 s in five to eight minutes, but in steps, 20 to 35 ms rms off a straight line, and its truth keeps to one constant;
a real flight's stays within 10 ms over three minutes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

NS_PER_S = 1_000_000_000
BIN_NS = 2 * NS_PER_S
MAX_BINS = 4096

# Boot stamps of different messages may be slightly out of order; a reboot starts again from nearly nothing.
REBOOT_NS = 1 * NS_PER_S
# No link holds a message back this long and then catches up at once: the offset itself has stepped.
STEP_NS = 5 * NS_PER_S

MIN_DRIFT_SPAN_NS = 20 * NS_PER_S
MIN_DRIFT_NS = 0.1 * NS_PER_S
STRAIGHT_NS = 0.005 * NS_PER_S
STRAIGHT_SHARE = 0.02

Mode = Literal["auto", "constant", "drift"]


@dataclass
class _Segment:
    """One run of the boot clock: the least offset seen in each bin of boot time."""

    boot_origin_ns: int
    offset_origin_ns: int
    newest_boot_ns: int
    newest_offset_ns: int
    bin_ns: int = BIN_NS
    memory_ns: int | None = None
    least: dict[int, tuple[int, int]] = field(default_factory=dict)  # bin -> (boot, offset), relative to the origins
    line_ns: tuple[float, float] | None = None  # offset at the origin, slope; None: to be fitted again

    def add(self, boot_ns: int, offset_ns: int) -> None:
        boot, offset = boot_ns - self.boot_origin_ns, offset_ns - self.offset_origin_ns
        self.newest_boot_ns, self.newest_offset_ns = max(self.newest_boot_ns, boot_ns), offset_ns
        key = boot // self.bin_ns
        if self.memory_ns is not None and key not in self.least:
            oldest = (boot - self.memory_ns) // self.bin_ns
            self.least = {k: value for k, value in self.least.items() if k >= oldest}
        if key not in self.least or offset < self.least[key][1]:
            self.least[key] = (boot, offset)
            self.line_ns = None
        if len(self.least) > MAX_BINS:
            self._coarsen()

    def _coarsen(self) -> None:
        self.bin_ns *= 2
        merged: dict[int, tuple[int, int]] = {}
        for boot, offset in self.least.values():
            key = boot // self.bin_ns
            if key not in merged or offset < merged[key][1]:
                merged[key] = (boot, offset)
        self.least = merged


class BootClock:
    """Maps boot time to our clock. Fed in order of arrival; answers from all it has been fed so far.

    Feed a whole log first to map it by the least delay of the whole log, or feed and ask in turn when live.
    A reboot, or a step of either clock, starts a new segment; `add` returns its number. With `memory_ns` older
    arrivals are forgotten, so that a constant offset follows a slow drift: for a link that runs for hours.
    """

    def __init__(self, mode: Mode = "auto", memory_ns: int | None = None) -> None:
        self.mode = mode
        self._memory_ns = memory_ns
        self._segments: list[_Segment] = []

    def add(self, boot_ns: int, arrival_ns: int) -> int:
        """Take one message's boot stamp and arrival; returns the segment it belongs to, counted from 0."""
        offset_ns = arrival_ns - boot_ns
        if not self._segments or self._is_new(boot_ns, offset_ns):
            self._segments.append(_Segment(boot_ns, offset_ns, boot_ns, offset_ns, memory_ns=self._memory_ns))
        self._segments[-1].add(boot_ns, offset_ns)
        return len(self._segments) - 1

    def _is_new(self, boot_ns: int, offset_ns: int) -> bool:
        segment = self._segments[-1]
        return boot_ns < segment.newest_boot_ns - REBOOT_NS or abs(offset_ns - segment.newest_offset_ns) > STEP_NS

    def to_host_ns(self, boot_ns: int, segment: int = -1) -> int:
        """Boot time of a segment (the newest by default) on our clock; raises LookupError before the first `add`."""
        if not self._segments:
            raise LookupError("the clock has not seen a message yet")
        chosen = self._segments[segment]
        return boot_ns + self._offset_ns(chosen, boot_ns)

    @property
    def segments(self) -> int:
        """The number of times that the boot clock has started."""
        return len(self._segments)

    def drift(self, segment: int = -1) -> float:
        """Return by what fraction our clock runs faster than the boot clock; 0 where a constant offset is used."""
        return self._line(self._segments[segment])[1]

    def _offset_ns(self, segment: _Segment, boot_ns: int) -> int:
        level, slope = self._line(segment)
        return segment.offset_origin_ns + round(level + slope * (boot_ns - segment.boot_origin_ns))

    def _line(self, segment: _Segment) -> tuple[float, float]:
        if segment.line_ns is None:
            segment.line_ns = _lower_envelope(segment, self.mode)
        return segment.line_ns


def _lower_envelope(segment: _Segment, mode: Mode) -> tuple[float, float]:
    """Level at the origin (ns) and slope of the offset."""
    points = np.array(sorted(segment.least.values()), float)
    boot, offset = points[:, 0], points[:, 1]
    constant = float(offset.min()), 0.0
    span = boot[-1] - boot[0]
    if mode == "constant" or span < MIN_DRIFT_SPAN_NS or len(points) < 5:
        return constant
    # Late bins (nothing prompt arrived in them) lie above the line: fit again to the lower half of the residuals.
    middle = boot.mean()
    keep = np.ones(len(boot), bool)
    for _ in range(4):
        slope, level = np.polyfit(boot[keep] - middle, offset[keep], 1)
        residual = offset - level - slope * (boot - middle)
        keep = residual <= np.median(residual)
    rise = abs(slope) * span
    # Steps leave whole stretches off the line; single late bins do not move the lower quartiles.
    spread = np.subtract(*np.percentile(residual, [50, 5]))
    straight = spread < max(STRAIGHT_NS, STRAIGHT_SHARE * rise)
    if mode == "auto" and (rise < MIN_DRIFT_NS or not straight):
        return constant
    level += residual.min()
    return float(level - slope * middle), float(slope)
