"""Gathers what pictures and attitudes show of the camera's time offset; asks `rotation_timing` when there is news."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from onboard.config.schema import Config
from onboard.estimation.boresight import PlatformEstimate
from onboard.estimation.keyframe import Ids
from onboard.estimation.platform_states import BORESIGHT, OFFSET
from onboard.estimation.rotation_timing import COARSE_S, FEATURES, REACH_S, Course, Pair, Timing, timing
from onboard.navigation.limits import MEMORY_NS, PATIENCE_NS
from onboard.navigation.navigator import Motion, Navigation
from onboard.pipeline.keyframes import TELLING_S

Array = NDArray[np.float64]

STEP_NS = round(COARSE_S * 1e9)  # of the attitudes that pairs are compared with
REACH_STEPS = round(REACH_S / COARSE_S) + 3
LEAST_APART_NS, MOST_APART_NS = 200_000_000, 1_500_000_000  # of the pictures of a pair
MOST_PAIRS = 40  # the newest that are informative
MIN_CHANGE_RAD_S = 0.08  # of the angular rate: 0.1 s of it is then half a degree, as much as an attitude is off
NEWS, NEWS_NS = 3, 2_500_000_000  # pairs, and time, after which the estimate is made again
RELAXED, RELAXED_NS = 10, 10_000_000_000  # the same once the offset is known well


class OffsetWatch:
    """Fed with every picture's features; gives a time offset whenever turns have shown one."""

    def __init__(self, config: Config, camera: Camera, R_body_cam: Array) -> None:
        solve = config.solve
        self._camera, self._R_body_cam = camera, R_body_cam
        self._sigma_px = solve.pixel_sigma_px
        self._sigma_rad = float(np.radians(np.hypot(solve.attitude_white_sigma_deg, solve.attitude_sigma_deg / 2.0)))
        self._last: tuple[int, Ids, Array] | None = None
        self._waiting: deque[Pair] = deque()
        self._pairs: deque[Pair] = deque(maxlen=MOST_PAIRS)
        self._motions: dict[int, Motion] = {}
        self._centre_s: float | None = None
        self._news = 0
        self._asked_ns = 0

    def forget(self) -> None:
        """Begin with new pairs: those so far have been used, or the clock has changed."""
        self._waiting.clear()
        self._pairs.clear()
        self._motions.clear()
        self._centre_s, self._news = None, 0

    def change_lens(self, camera: Camera) -> None:
        """Take pixels by another lens from now on; pairs of rays stay what they are."""
        self._camera, self._last = camera, None

    def note(self, stamp_ns: int, ids: Ids, uv_px: Array) -> None:
        """Take a picture's features: ids (N,), pixels (N, 2)."""
        last = self._last
        if last is not None and 0 < stamp_ns - last[0] < LEAST_APART_NS:
            return
        self._last = (stamp_ns, ids, uv_px)
        if last is None or not LEAST_APART_NS <= stamp_ns - last[0] <= MOST_APART_NS:
            return
        common, one, other = np.intersect1d(last[1], ids, return_indices=True)
        if len(common) >= FEATURES // 2:
            chosen = np.linspace(0, len(common) - 1, min(FEATURES, len(common))).astype(np.intp)
            self._waiting.append(self._pair(last[0], stamp_ns, last[2][one[chosen]], uv_px[other[chosen]]))

    def estimate(self, navigation: Navigation, platform: PlatformEstimate, now_ns: int) -> Timing | None:
        """The offset by the turns so far; None while there is no news, or where they do not determine one."""
        if self._centre_s is None or abs(platform.mean[OFFSET] - self._centre_s) > 0.5 * REACH_S:
            self.forget()
            self._centre_s = float(platform.mean[OFFSET])
        while self._waiting and self._take(self._waiting[0], navigation, now_ns):
            self._waiting.popleft()
        while self._pairs and self._pairs[0].start_ns < now_ns - MEMORY_NS // 2:
            self._pairs.popleft()
        if len(self._motions) > MEMORY_NS // STEP_NS:
            oldest = (now_ns - MEMORY_NS // 2) // STEP_NS - REACH_STEPS + round(self._centre_s * 1e9) // STEP_NS
            self._motions = {k: motion for k, motion in self._motions.items() if k >= oldest}
        news, after_ns = (RELAXED, RELAXED_NS) if platform.sigma[OFFSET] < TELLING_S else (NEWS, NEWS_NS)
        if self._news < news or now_ns - self._asked_ns < after_ns:
            return None
        self._news, self._asked_ns = 0, now_ns
        if not self._pairs:
            return None
        return timing(list(self._pairs), self._course(), self._centre_s, platform.mean[BORESIGHT], self._sigma_rad)

    def _pair(self, start_ns: int, end_ns: int, uv1: Array, uv2: Array) -> Pair:
        (one, valid1), (other, valid2) = self._camera.unproject(uv1), self._camera.unproject(uv2)
        valid = valid1 & valid2
        n = np.count_nonzero(valid)
        rays = np.tile([0.0, 0.0, 1.0], (2, FEATURES, 1))
        rays[0, :n], rays[1, :n] = one[valid] / one[valid, 2:], other[valid] / other[valid, 2:]
        weight = np.where(np.arange(FEATURES) < n, self._camera.focal_px / self._sigma_px, 0.0)
        return Pair(start_ns, end_ns, rays[0], rays[1], weight)

    def _take(self, pair: Pair, navigation: Navigation, now_ns: int) -> bool:
        """Look up the motion about a pair; False while that is still to come."""
        assert self._centre_s is not None
        centre_ns = round(self._centre_s * 1e9)
        first = (pair.start_ns + centre_ns) // STEP_NS - REACH_STEPS
        last = (pair.end_ns + centre_ns) // STEP_NS + 1 + REACH_STEPS
        for k in range(last, first - 1, -1):  # the newest decides whether to wait
            if k not in self._motions:
                motion = navigation.motion_at(k * STEP_NS)
                if motion is None:
                    return k != last or now_ns - pair.end_ns > PATIENCE_NS
                self._motions[k] = motion
        R = np.stack([self._motions[k].R_enu_body for k in range(first, last + 1)])
        step = R[:-1].transpose(0, 2, 1) @ R[1:]
        turned = 0.5 * np.stack(
            [step[:, 2, 1] - step[:, 1, 2], step[:, 0, 2] - step[:, 2, 0], step[:, 1, 0] - step[:, 0, 1]], axis=1
        )
        apart = (pair.end_ns - pair.start_ns) // STEP_NS
        changed = np.linalg.norm(turned[apart:] - turned[:-apart], axis=1).max() / (STEP_NS / 1e9)
        if changed > MIN_CHANGE_RAD_S:
            self._pairs.append(pair)
            self._news += 1
        return True

    def _course(self) -> Course:
        """The motions about pairs; what lies between them and was not asked for is nothing."""
        first, last = min(self._motions), max(self._motions)
        R = np.tile(np.eye(3), (last - first + 1, 1, 1))
        v, sigma = np.zeros((last - first + 1, 3)), np.zeros(last - first + 1)
        for k, motion in self._motions.items():
            R[k - first] = motion.R_enu_body @ self._R_body_cam
            v[k - first], sigma[k - first] = motion.velocity_enu_m_s, motion.sigma_rad
        return Course(first * STEP_NS, STEP_NS, R, v, sigma)
