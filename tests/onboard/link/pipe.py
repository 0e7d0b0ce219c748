"""A telemetry radio in virtual time: byte-limited, lossy, delaying, reordering, with an autopilot's own stream beside.

What is forwarded for others is dropped without a word where the autopilot's buffer has no room, as ArduPilot does.
"""

import heapq
import itertools
import random
from dataclasses import dataclass, field
from pathlib import Path
from typing import Generic, TypeVar

T = TypeVar("T")

RECORDED = Path(__file__).resolve().parents[2] / "data" / "copter_leg.tlog"
HEARTBEAT_BYTES = 21
STAMP_BYTES = 8


@dataclass
class Way(Generic[T]):
    """One direction. Jitter is the mean of an exponential delay on top, by which packets overtake each other."""

    bit_rate: float
    loss: float = 0.0
    delay_s: float = 0.0
    jitter_s: float = 0.0
    buffer_bytes: float = 512.0
    seed: int = 1
    dropped: int = 0
    carried: list[tuple[float, int]] = field(default_factory=list)  # when put, bytes; not the autopilot's own
    own_waits_s: list[float] = field(default_factory=list)  # of the autopilot's messages, in the buffer

    def __post_init__(self) -> None:
        self._free_at_s = 0.0
        self._random = random.Random(self.seed)
        self._under_way: list[tuple[float, int, T]] = []
        self._order = itertools.count()

    def put(self, now_s: float, size: int, item: T) -> None:
        waiting = max(self._free_at_s - now_s, 0.0) * self.bit_rate / 8.0
        if waiting + size > self.buffer_bytes:
            self.dropped += 1
            return
        self.carried.append((now_s, size))
        self._occupy(now_s, size)
        if self._random.random() >= self.loss:
            late_s = self._random.expovariate(1.0 / self.jitter_s) if self.jitter_s else 0.0
            arrival_s = self._free_at_s + self.delay_s + late_s
            heapq.heappush(self._under_way, (arrival_s, next(self._order), item))

    def put_own(self, now_s: float, size: int) -> None:
        self.own_waits_s.append(max(self._free_at_s - now_s, 0.0))
        self._occupy(now_s, size)

    def _occupy(self, now_s: float, size: int) -> None:
        self._free_at_s = max(self._free_at_s, now_s) + 8.0 * size / self.bit_rate

    def arrived(self, now_s: float) -> list[T]:
        """What has come by now, in the order in which it came."""
        out = []
        while self._under_way and self._under_way[0][0] <= now_s:
            out.append(heapq.heappop(self._under_way)[2])
        return out


def own_stream(bit_rate: float, share: float, seconds: float, seed: int = 2) -> list[tuple[float, int]]:
    """A recorded autopilot's messages (time, bytes), as many as take a share of a link; a heartbeat a second always."""
    data = RECORDED.read_bytes()
    recorded: list[tuple[float, int]] = []
    at = 0
    while at + STAMP_BYTES + 12 <= len(data):
        stamp_s = int.from_bytes(data[at : at + STAMP_BYTES], "big") / 1e6
        payload, magic = data[at + STAMP_BYTES + 1], data[at + STAMP_BYTES]
        size = payload + (12 if magic == 0xFD else 8)
        recorded.append((stamp_s, size))
        at += STAMP_BYTES + size
    first_s, length_s = recorded[0][0], recorded[-1][0] - recorded[0][0]
    recorded_rate = 8.0 * sum(size for _, size in recorded) / length_s
    kept = max(share - 8.0 * HEARTBEAT_BYTES / bit_rate, 0.0) * bit_rate / recorded_rate
    chosen = random.Random(seed)
    out = [(float(second), HEARTBEAT_BYTES) for second in range(round(seconds))]
    for turn in range(int(seconds / length_s) + 1):
        for stamp_s, size in recorded:
            copies = int(kept) + (chosen.random() < kept % 1.0)
            out += [(turn * length_s + stamp_s - first_s, size)] * copies
    return sorted(pair for pair in out if pair[0] < seconds)
