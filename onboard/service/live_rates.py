"""The last seconds of the sources and the pipeline: rates, delays, what became of the newest pictures.

Written by the source's and the pipeline's threads, read by the daemon's. All moments are on the session's clock.
"""

from __future__ import annotations

import threading
from collections import Counter, deque
from dataclasses import dataclass

from contract.feature_set import FeatureSet, Status

RATE_WINDOW_NS = 3_000_000_000
OUTCOME_WINDOW_NS = 1_000_000_000  # of captures: what the newest pictures came to
STALE_NS = 3_000_000_000  # without a set for so long there is no outcome


@dataclass
class _Picture:
    capture_ns: int
    status: Status


class LiveRates:
    """Counts over the last seconds."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._came_ns: deque[int] = deque()
        self._answered_ns: deque[int] = deque()
        self._newest_came_ns: int | None = None
        self._pictures: dict[int, _Picture] = {}  # by frame, of the last captures
        self._made_ns: int | None = None  # when the newest set was
        self.session = 0
        self.frame = -1
        self.delay_s = 0.0

    def picture_came(self, now_ns: int) -> None:
        with self._lock:
            self._newest_came_ns = now_ns
            self._came_ns.append(now_ns)
            _forget(self._came_ns, now_ns)

    def set_made(self, output: FeatureSet, now_ns: int) -> None:
        """The pipeline has made a set, or a new revision of one."""
        with self._lock:
            self._made_ns, self.session = now_ns, output.session
            before = self._pictures.get(output.frame)
            if before is None and output.frame <= self.frame and output.revision:
                return  # a last revision of a picture long counted
            if output.is_ok and (before is None or before.status is not Status.OK):
                self._answered_ns.append(now_ns)
                _forget(self._answered_ns, now_ns)
            self._pictures[output.frame] = _Picture(output.capture_unix_ns, output.status)
            if output.frame > self.frame:
                self.frame = output.frame
                self.delay_s = (now_ns - output.capture_unix_ns) / 1e9
                oldest_ns = output.capture_unix_ns - 5 * OUTCOME_WINDOW_NS
                for frame in [f for f, picture in self._pictures.items() if picture.capture_ns < oldest_ns]:
                    del self._pictures[frame]

    def outcome(self, now_ns: int) -> Status | None:
        """OK if any of the newest pictures can be clicked, else the commonest reason why not; None without any."""
        with self._lock:
            if self._made_ns is None or now_ns - self._made_ns > STALE_NS:
                return None
            newest_ns = max(picture.capture_ns for picture in self._pictures.values())
            of_late = Counter(
                p.status for p in self._pictures.values() if newest_ns - p.capture_ns <= OUTCOME_WINDOW_NS
            )
        return Status.OK if Status.OK in of_late else of_late.most_common(1)[0][0]

    def picture_age_s(self, now_ns: int) -> float | None:
        """Since the last picture came; None before the first."""
        came_ns = self._newest_came_ns
        return None if came_ns is None else (now_ns - came_ns) / 1e9

    def camera_hz(self, now_ns: int) -> float:
        return self._rate_hz(self._came_ns, now_ns)

    def ok_hz(self, now_ns: int) -> float:
        return self._rate_hz(self._answered_ns, now_ns)

    def _rate_hz(self, moments_ns: deque[int], now_ns: int) -> float:
        with self._lock:
            _forget(moments_ns, now_ns)
            return len(moments_ns) / (RATE_WINDOW_NS / 1e9)


def _forget(moments_ns: deque[int], now_ns: int) -> None:
    while moments_ns and moments_ns[0] < now_ns - RATE_WINDOW_NS:
        moments_ns.popleft()
