"""What became of a flight's pictures, counted in bounded memory, and where the processor's time went."""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from contract.feature_set import Status
from onboard.pipeline.estimates import Contradiction, Estimate, SensorError
from onboard.pipeline.shortfall import REMEMBERED, Evidence, Shortfall


@dataclass(frozen=True)
class LeftOut:
    """Shares (0 to 1) of the picture where no features are taken."""

    masked: float = 0.0  # by `camera.mask`
    standing: float = 0.0  # found in flight: it stands still while the ground moves

    def __str__(self) -> str:
        """Empty if nothing is left out."""
        why = "found: stands still while the ground moves (a display, or the aircraft itself)"
        parts = ((self.masked, "by camera.mask"), (self.standing, why))
        return ", ".join(f"{100.0 * share:.0f} % {what}" for share, what in parts if share > 0.0)


@dataclass
class Summary:
    """What became of the pictures. `refused` counts reasons; `stage_seconds` is processor time by stage."""

    frames: int = 0
    shortfall: Shortfall | None = None  # why nothing was solved, where nothing was
    keyframes: int = 0
    solved: int = 0
    refused: dict[str, int] = field(default_factory=dict)
    refused_windows: dict[str, int] = field(default_factory=dict)  # by what spoke against them
    median_tracks: float = 0.0
    reprojection_px: float = 0.0
    estimates: tuple[Estimate, ...] = ()  # of the platform; empty before the first update
    sensor_errors: tuple[SensorError, ...] = ()  # how large they are, as estimated and as configured
    unconfirmed: tuple[Estimate, ...] = ()  # found, but too far from the prior to be adopted by itself
    contradictions: tuple[Contradiction, ...] = ()  # sensors that contradict the others, or did
    carrier: str = ""  # what the camera was assumed to be mounted on
    left_out: LeftOut = field(default_factory=LeftOut)
    stage_seconds: dict[str, float] = field(default_factory=dict)


class RunStatistics:
    """Counts."""

    def __init__(self, evidence: Evidence) -> None:
        self.evidence = evidence
        self.keyframes = 0
        self.track_counts: deque[int] = deque(maxlen=REMEMBERED)
        self.reprojections_px: deque[float] = deque(maxlen=REMEMBERED)
        self._status: dict[int, Status] = {}  # of the newest pictures, by index; all are counted in `_outcomes`
        self._outcomes: Counter[Status] = Counter()
        self._stages: dict[str, float] = {}
        self._windows: Counter[str] = Counter()

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Add what this thread does meanwhile to a stage."""
        began = time.thread_time()
        yield
        self.spend(stage, time.thread_time() - began)

    def spend(self, stage: str, seconds: float) -> None:
        """Add processor time to a stage."""
        self._stages[stage] = self._stages.get(stage, 0.0) + seconds

    def note_window(self, refusal: str) -> None:
        """Count a window by why it was refused, `what: how much`; empty if it was not."""
        if refusal:
            self._windows[refusal.partition(":")[0]] += 1

    def note(self, index: int, status: Status) -> None:
        """Count a picture by its latest status; an hour of pictures must not be remembered one by one."""
        before = self._status.get(index)
        if before is not None:
            self._outcomes[before] -= 1
        self._outcomes[status] += 1
        self._status[index] = status
        while len(self._status) > REMEMBERED:
            del self._status[next(iter(self._status))]

    @property
    def summary(self) -> Summary:
        """Counts so far; a picture counts by its latest revision."""
        refused = Counter({s.value: n for s, n in self._outcomes.items() if s is not Status.OK and n})
        return Summary(
            shortfall=None if self._outcomes[Status.OK] else self.evidence.why(+self._outcomes, self.keyframes),
            frames=self._outcomes.total(),
            keyframes=self.keyframes,
            solved=self._outcomes[Status.OK],
            refused=dict(refused.most_common()),
            refused_windows=dict(self._windows.most_common()),
            median_tracks=float(np.median(self.track_counts)) if self.track_counts else 0.0,
            reprojection_px=float(np.median(self.reprojections_px)) if self.reprojections_px else 0.0,
            stage_seconds=dict(self._stages),
        )
