"""Why a flight's pictures gave no answer: the likely reason and what to do, from what was noticed on the way."""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.feature_set import Status
from onboard.config.schema import Config
from onboard.estimation.window_problem import MIN_KEYFRAMES
from onboard.geometry.plane_homography import move, pixel_grid
from onboard.navigation.limits import MEMORY_NS, PATIENCE_NS
from onboard.navigation.navigator import NavState

Array = NDArray[np.float64]

REMEMBERED = 5000  # pictures: many times what a window spans
MIN_OVERLAP = 0.25  # rendered flights: answered in full at 0.27 of the picture in common, not at all at 0.17
MIN_SPAN = 0.1  # of the height above ground, travelled during a window: less is no parallax
STANDING_PER_S = 0.01  # of the height above ground: slower than this is no parallax for as long as it lasts
LEAST_HEIGHT_M = 20.0  # that this is of
STANDING_S = 3.0  # before standing still is called that


class Break(Enum):
    """Why no window may hold both a picture and the one before it."""

    APART = "apart"
    OUTAGE = "outage"
    JUMP = "jump"
    STAMPS = "stamps"


@dataclass(frozen=True)
class Shortfall:
    """The likely reason, and its remedy, one line each."""

    reason: str
    remedy: str


@dataclass
class Evidence:
    """What a flight without answers is judged by: its latest pictures, in bounded memory."""

    config: Config
    apart_s: deque[float] = field(default_factory=lambda: deque(maxlen=REMEMBERED))
    overlap: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=REMEMBERED))
    breaks: Counter[Break] = field(default_factory=Counter)
    has_attitude: bool = False
    navigation: str = ""  # why the position was not accepted, the last time it was not
    span_m: float = 0.0  # the farthest travelled within one window
    height_m: float = float("nan")  # above home, the last known
    _first_enu_m: Array | None = None

    def note_step(self, apart_s: float, why: Break | None) -> None:
        """Two pictures in a row, both with navigation, and what parts them, if anything does."""
        self.apart_s.append(apart_s)
        if why is not None:
            self.breaks[why] += 1
            self._first_enu_m = None

    def note_place(self, position_enu_m: Array, height_m: float | None, has_attitude: bool) -> None:
        """Where a picture with navigation was taken."""
        if self._first_enu_m is None:
            self._first_enu_m = position_enu_m
        self.span_m = max(self.span_m, float(np.linalg.norm(position_enu_m - self._first_enu_m)))
        self.has_attitude |= has_attitude
        self.height_m = self.height_m if height_m is None else height_m

    def note_overlap(self, camera: Camera, predicted: Array | None, was: NavState | None, nav: NavState) -> float:
        """How much of the keyframe of `was` this picture should show; `predicted` (3, 3) is the motion since."""
        if was is None:
            return 1.0
        travelled_m = float(np.linalg.norm(nav.position_enu_m - was.position_enu_m))
        share = overlap_share(camera, predicted, travelled_m, nav.height_above_home_m)
        if share is None:
            return 1.0
        self.overlap.append(((nav.stamp_ns - was.stamp_ns) / 1e9, share))
        return share

    def why(self, statuses: Counter[Status], keyframes: int) -> Shortfall:
        """The likely reason why none of the pictures with these statuses has an answer."""
        frames, usable = statuses.total(), len(self.apart_s) + 1
        if not frames:
            return Shortfall("no pictures", "check the folder of pictures, their stamps and the log's time")
        useless = max((Status.BAD_PICTURE, Status.NO_GPS, Status.UNSYNCHRONISED), key=lambda s: statuses[s])
        if 2 * statuses[useless] > frames:
            return self._said_of(useless, statuses[useless])
        apart = self._too_far_apart() if self.apart_s else None
        if apart is not None:
            return apart
        if usable < MIN_KEYFRAMES:
            return Shortfall(
                f"{usable} usable pictures of {frames}",
                f"at least {MIN_KEYFRAMES} in a row must show the same ground and have telemetry about them",
            )
        worst = max((s for s in statuses if s is not Status.STARTING), key=lambda s: statuses[s], default=None)
        is_still = self.span_m < MIN_SPAN * self.height_m and sum(self.apart_s) > PATIENCE_NS / 1e9
        if worst in (Status.FEATURELESS, Status.TURNING) and statuses[worst] > statuses[Status.STARTING]:
            return self._said_of(worst, statuses[worst])
        if worst is Status.LOW_PARALLAX or is_still:
            return self._said_of(Status.LOW_PARALLAX, 0)
        if not self.has_attitude and self.config.solve.attitude == "autopilot":
            return Shortfall(
                "no attitude in the telemetry", "ask the autopilot for ATTITUDE, or set solve.level_ground = true"
            )
        if worst in (Status.STABILISED, Status.ZOOMED, Status.POOR_FIT):
            return self._said_of(worst, statuses[worst])
        return Shortfall(
            f"too short: {keyframes} keyframes within {self.span_m:.0f} m travelled",
            f"at least {MIN_KEYFRAMES} keyframes are needed, each a tenth of a picture farther on: fly on",
        )

    def _said_of(self, status: Status, count: int) -> Shortfall:
        """What it means that so many pictures have a status."""
        said = {
            Status.BAD_PICTURE: Shortfall(
                f"{count} pictures are damaged or repeat an earlier one", "check the camera and its files"
            ),
            Status.NO_GPS: Shortfall(
                f"no accepted position for {count} pictures" + (f" ({self.navigation})" if self.navigation else ""),
                "wait for a fix before the first picture; see GPS_RAW_INT and EKF_STATUS_REPORT in the log",
            ),
            Status.UNSYNCHRONISED: Shortfall(
                f"telemetry gap: no position within {self.config.gps.max_gap_s:g} s or no attitude within "
                f"{self.config.telemetry.max_attitude_gap_s:g} s about {count} pictures",
                "raise the rates of GLOBAL_POSITION_INT and ATTITUDE; pictures and log must have the same clock",
            ),
            Status.FEATURELESS: Shortfall(
                f"nothing to follow on {count} pictures", "check focus, exposure and that the lens looks at the ground"
            ),
            Status.TURNING: Shortfall(
                f"turning too fast to follow the ground on {count} pictures", "take pictures more often, or turn slower"
            ),
            Status.LOW_PARALLAX: Shortfall(
                f"no parallax: {self.span_m:.0f} m travelled at {self.height_m:.0f} m above home",
                "fly on, or state where the ground is: terrain.path, solve.home_level or a range finder",
            ),
            Status.STABILISED: Shortfall(
                f"electronic stabilisation shifted {count} pictures",
                "switch the camera's image stabilisation (EIS) off",
            ),
            Status.ZOOMED: Shortfall(
                f"the lens had zoomed or refocused on {count} pictures", "fix zoom and focus where they were calibrated"
            ),
            Status.POOR_FIT: Shortfall(
                f"pictures and telemetry contradict each other on {count} pictures",
                "check mount.*_deg, camera.json, and that pictures and log are of one flight and one clock",
            ),
        }
        return said[status]

    def _too_far_apart(self) -> Shortfall | None:
        steps, usual_s = len(self.apart_s), float(np.median(self.apart_s))
        if 3 * self.breaks.total() >= steps:
            why, count = self.breaks.most_common(1)[0]
            where, steady = f"between {count} of {steps} pairs of pictures", "fly where the receiver keeps its fix"
            said = {
                Break.APART: Shortfall(
                    f"pictures {usual_s:.1f} s apart, at most {MEMORY_NS / 1e9 / self.config.solve.keyframes:.1f}",
                    "take pictures more often",
                ),
                Break.OUTAGE: Shortfall(f"GPS was lost or doubted {where}", steady),
                Break.JUMP: Shortfall(f"the position jumped {where}", steady),
                Break.STAMPS: Shortfall(
                    f"the stamps' own error changed {count} times", "check that pictures and autopilot share a clock"
                ),
            }
            return said[why]
        if not self.overlap:
            return None
        shares = np.array(self.overlap)
        if np.median(shares[:, 1]) >= MIN_OVERLAP:
            return None
        # Overlap is lost evenly with time: from what was lost, when too little is left.
        most_s = float(np.median(shares[:, 0] * (1.0 - MIN_OVERLAP) / np.maximum(1.0 - shares[:, 1], 1e-6)))
        return Shortfall(
            f"no overlap: pictures {usual_s:.1f} s apart, at most {most_s:.1f} here, where less than "
            f"{100 * MIN_OVERLAP:.0f} % of the ground is on both",
            "take pictures more often, fly slower or higher, or use a wider lens",
        )


def overlap_share(camera: Camera, predicted: Array | None, travelled_m: float, height_m: float | None) -> float | None:
    """How much of a keyframe another picture shows: by the predicted motion H (3, 3), else as if looking down."""
    if predicted is None:
        if height_m is None or height_m <= 0.0:
            return None
        across_m = min(camera.size_px) * height_m / camera.focal_px
        return max(1.0 - travelled_m / across_m, 0.0)
    return float(np.mean(camera.contains(move(predicted, pixel_grid(camera.size_px, (16, 12))))))


def is_standing_still(first: NavState, nav: NavState) -> bool:
    """Whether two states are too close to each other for parallax, for so long that it will not come by itself.

    By the mean speed: in a hover wind and receiver move the position by metres, but on the whole nowhere.
    """
    lasted_s = (nav.stamp_ns - first.stamp_ns) / 1e9
    travelled_m = float(np.linalg.norm(nav.position_enu_m - first.position_enu_m))
    height_m = max(nav.height_above_home_m or 0.0, LEAST_HEIGHT_M)
    return lasted_s > STANDING_S and travelled_m < STANDING_PER_S * height_m * lasted_s
