"""Outcomes of a flight's pictures, counted in bounded memory: why none has an answer, and where the time went."""

from __future__ import annotations

import time
from collections import Counter, defaultdict, deque
from collections.abc import Iterator
from contextlib import contextmanager
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.feature_set import Status
from onboard.config.schema import Config
from onboard.estimation.moved_optics import MOVED
from onboard.estimation.window_problem import MIN_KEYFRAMES
from onboard.geometry.plane_homography import move, pixel_grid
from onboard.navigation.limits import MEMORY_NS, PATIENCE_NS
from onboard.navigation.navigator import NavState
from onboard.pipeline.summary import Shortfall, Summary

Array = NDArray[np.float64]

REMEMBERED = 5000  # pictures: many times what a window spans
MIN_OVERLAP = 0.25  # rendered flights: answered in full at 0.27 of the picture in common, not at all at 0.17
MIN_SPAN = 0.1  # of the height above ground, travelled during a window: less is no parallax


class Break(Enum):
    """Reasons why no window may hold both a picture and the one before it."""

    APART = "apart"
    OUTAGE = "outage"
    JUMP = "jump"
    STAMPS = "stamps"


REMEDIES: dict[Status | Break, str] = {
    Break.APART: "take pictures more often",
    Break.OUTAGE: "fly where the receiver keeps its fix",
    Break.JUMP: "fly where the receiver keeps its fix",
    Break.STAMPS: "check that pictures and autopilot share a clock",
    Status.BAD_PICTURE: "check the camera and its files",
    Status.NO_GPS: "wait for a fix before the first picture; see GPS_RAW_INT and EKF_STATUS_REPORT in the log",
    Status.UNSYNCHRONISED: "raise the rates of GLOBAL_POSITION_INT and ATTITUDE; "
    "pictures and log must have the same clock",
    Status.FEATURELESS: "check focus, exposure and that the lens looks at the ground",
    Status.TURNING: "take pictures more often, or turn slower",
    Status.REPETITIVE: "take pictures more often or fly higher: where each one is must be predicted to half a row; a "
    "field's border or a path in the picture helps",
    Status.LOW_PARALLAX: "fly on, or state where the ground is: terrain.path, solve.home_level or a range finder",
    Status.STABILISED: "switch the camera's image stabilisation (EIS) off",
    Status.ZOOMED: "fix zoom and focus where they were calibrated",
    Status.MIRRORED: "switch the camera's flip (mirror) off, or flip the pictures back",
    Status.STRETCHED: "calibrate at this picture size, or state the shape of its pixels in camera.json",
    Status.POOR_FIT: "check mount.*_deg, camera.json, and that pictures and log are of one flight and one clock",
}


class RunStatistics:
    """Counts, and of the latest pictures what a flight without answers is judged by."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self.keyframes = 0
        self.track_counts: deque[int] = deque(maxlen=REMEMBERED)
        self.reprojections_px: deque[float] = deque(maxlen=REMEMBERED)
        self.refused_windows: Counter[str] = Counter()  # by what spoke against them
        self.stage_seconds: defaultdict[str, float] = defaultdict(float)  # of the processor
        self.position_fault = ""  # why the position was not accepted, the last time it was not
        self._status: dict[int, Status] = {}  # of the newest pictures, by index; all are counted in `_outcomes`
        self._outcomes: Counter[Status] = Counter()
        self._apart_s: deque[float] = deque(maxlen=REMEMBERED)
        self._overlap: deque[tuple[float, float]] = deque(maxlen=REMEMBERED)
        self._parted_by: deque[Break | None] = deque(maxlen=REMEMBERED)  # of each of these
        self._has_attitude = False
        self._first_enu_m: Array | None = None  # of what one window may hold
        self._span_m = 0.0  # the farthest travelled within one
        self._height_m = float("nan")  # above home, the last known

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Add what this thread does meanwhile to a stage."""
        began = time.thread_time()
        yield
        self.stage_seconds[stage] += time.thread_time() - began

    def note(self, index: int, status: Status) -> None:
        """Count a picture by its latest status; an hour of pictures must not be remembered one by one."""
        before = self._status.get(index)
        if before is not None:
            self._outcomes[before] -= 1
        self._outcomes[status] += 1
        self._status[index] = status
        if len(self._status) > REMEMBERED:
            del self._status[next(iter(self._status))]

    def note_state(self, last: NavState | None, nav: NavState, parted_by: Break | None) -> None:
        """Note the states of a picture and of the one before it, and the break between the two, if there is one."""
        if last is not None:
            self._apart_s.append((nav.stamp_ns - last.stamp_ns) / 1e9)
            self._parted_by.append(parted_by)
        if self._first_enu_m is None or parted_by is not None:
            self._first_enu_m = nav.position_enu_m
        self._span_m = max(self._span_m, float(np.linalg.norm(nav.position_enu_m - self._first_enu_m)))
        self._has_attitude |= nav.R_enu_body is not None
        self._height_m = self._height_m if nav.height_above_home_m is None else nav.height_above_home_m

    def note_overlap(self, camera: Camera, predicted: Array | None, was: NavState | None, nav: NavState) -> float:
        """Note and return the share (0 to 1) of the keyframe of `was` that this picture should show; 1 if not known.

        It follows from the motion since, `predicted` H (3, 3), else as if the camera looked straight down.
        """
        if was is None:
            return 1.0
        if predicted is not None:
            share = float(np.mean(camera.contains(move(predicted, pixel_grid(camera.size_px, (16, 12))))))
        elif nav.height_above_home_m is not None and nav.height_above_home_m > 0.0:
            across_m = min(camera.size_px) * nav.height_above_home_m / camera.focal_px
            share = max(1.0 - float(np.linalg.norm(nav.position_enu_m - was.position_enu_m)) / across_m, 0.0)
        else:
            return 1.0
        self._overlap.append(((nav.stamp_ns - was.stamp_ns) / 1e9, share))
        return share

    @property
    def summary(self) -> Summary:
        """Counts so far; a picture counts by its latest revision."""
        counts = self._outcomes.most_common()
        return Summary(
            shortfall=None if self._outcomes[Status.OK] else self._shortfall(),
            frames=self._outcomes.total(),
            keyframes=self.keyframes,
            solved=self._outcomes[Status.OK],
            refused={status.value: n for status, n in counts if n and status is not Status.OK},
            refused_windows=dict(self.refused_windows.most_common()),
            median_tracks=float(np.median(self.track_counts)) if self.track_counts else 0.0,
            reprojection_px=float(np.median(self.reprojections_px)) if self.reprojections_px else 0.0,
            stage_seconds=dict(self.stage_seconds),
        )

    def _shortfall(self) -> Shortfall:
        """The likely reason why no picture has an answer."""
        statuses, frames, usable = +self._outcomes, self._outcomes.total(), len(self._apart_s) + 1
        if not frames:
            return Shortfall("no pictures", "check the folder of pictures, their stamps and the log's time")
        useless = max((Status.BAD_PICTURE, Status.NO_GPS, Status.UNSYNCHRONISED), key=lambda s: statuses[s])
        if 2 * statuses[useless] > frames:
            return self._shortfall_of(useless)
        if self._apart_s and (apart := self._too_far_apart()):
            return apart
        if usable < MIN_KEYFRAMES:
            return Shortfall(
                f"{usable} usable pictures of {frames}",
                f"at least {MIN_KEYFRAMES} in a row must show the same ground and have telemetry about them",
            )
        worst = max((s for s in statuses if s is not Status.STARTING), key=lambda s: statuses[s], default=None)
        is_still = self._span_m < MIN_SPAN * self._height_m and sum(self._apart_s) > PATIENCE_NS / 1e9
        if (
            worst in (Status.FEATURELESS, Status.TURNING, Status.REPETITIVE)
            and statuses[worst] > statuses[Status.STARTING]
        ):
            return self._shortfall_of(worst)
        if worst is Status.LOW_PARALLAX or is_still:
            return self._shortfall_of(Status.LOW_PARALLAX)
        if not self._has_attitude and self._config.solve.attitude == "autopilot":
            return Shortfall(
                "no attitude in the telemetry", "ask the autopilot for ATTITUDE, or set solve.level_ground = true"
            )
        if worst in (*MOVED, Status.POOR_FIT):
            return self._shortfall_of(worst)
        return Shortfall(
            f"too short: {self.keyframes} keyframes within {self._span_m:.0f} m travelled",
            f"at least {MIN_KEYFRAMES} keyframes are needed, each a tenth of a picture farther on: fly on",
        )

    @property
    def _breaks(self) -> Counter[Break]:
        return Counter(b for b in self._parted_by if b is not None)

    def _too_far_apart(self) -> Shortfall | None:
        if 3 * self._breaks.total() >= len(self._apart_s):
            return self._shortfall_of(self._breaks.most_common(1)[0][0])
        shares = np.array(self._overlap)
        if not len(shares) or np.median(shares[:, 1]) >= MIN_OVERLAP:
            return None
        # Overlap is lost evenly with time: from what was lost, when too little is left.
        most_s = float(np.median(shares[:, 0] * (1.0 - MIN_OVERLAP) / np.maximum(1.0 - shares[:, 1], 1e-6)))
        return Shortfall(
            f"no overlap: pictures {np.median(self._apart_s):.1f} s apart, at most {most_s:.1f} here, where less than "
            f"{100 * MIN_OVERLAP:.0f} % of the ground is on both",
            "take pictures more often, fly slower or higher, or use a wider lens",
        )

    def _shortfall_of(self, why: Status | Break) -> Shortfall:
        """The shortfall, with its remedy, behind a status of many pictures or a break between many pairs of them."""
        count, pairs = self._outcomes[why] if isinstance(why, Status) else self._breaks[why], len(self._apart_s)
        where = f"between {count} of {pairs} pairs of pictures"
        usual_s, most_s = np.median(self._apart_s or [0.0]), MEMORY_NS / 1e9 / self._config.solve.keyframes
        fault = f" ({self.position_fault})" if self.position_fault else ""
        reasons: dict[Status | Break, str] = {
            Break.APART: f"pictures {usual_s:.1f} s apart, at most {most_s:.1f}",
            Break.OUTAGE: f"GPS was lost or doubted {where}",
            Break.JUMP: f"the position jumped {where}",
            Break.STAMPS: f"the stamps' own error changed {count} times",
            Status.BAD_PICTURE: f"{count} pictures are damaged or repeat an earlier one",
            Status.NO_GPS: f"no accepted position for {count} pictures{fault}",
            Status.UNSYNCHRONISED: f"telemetry gap: no position within {self._config.gps.max_gap_s:g} s about {count} "
            "pictures",
            Status.FEATURELESS: f"nothing to follow on {count} pictures",
            Status.TURNING: f"turning too fast to follow the ground on {count} pictures",
            Status.REPETITIVE: f"the ground repeats itself (rows, tiles) on {count} pictures: a match may be a row off",
            Status.LOW_PARALLAX: f"no parallax: {self._span_m:.0f} m travelled at {self._height_m:.0f} m above home",
            Status.STABILISED: f"electronic stabilisation shifted {count} pictures",
            Status.ZOOMED: f"the lens had zoomed or refocused on {count} pictures",
            Status.MIRRORED: f"{count} pictures are mirror images of the ground",
            Status.STRETCHED: f"{count} pictures are stretched along one side against the camera file",
            Status.POOR_FIT: f"pictures and telemetry contradict each other on {count} pictures",
        }
        return Shortfall(reasons[why], REMEDIES[why])
