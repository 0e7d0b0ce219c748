"""The sliding window of keyframes: what each saw and where it was, assembled into one bundle problem and solved.

The window holds no picture and knows no clock: keyframes come in with their measurements and their navigation state,
solutions go out with covariances. When to add a keyframe is the pipeline's decision; whether the result may be believed
is decided here, by evidence.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.feature_set import SlowPosition, Status
from contract.rotations import exp_so3, mount_rotation
from onboard import starting
from onboard.alignment import STATES as SHARED
from onboard.alignment import Alignment
from onboard.bundle import Problem, Solution, solve
from onboard.config import Config
from onboard.keyframe import Ids, Keyframe, Sighting
from onboard.levelling import fit_plane
from onboard.navigation import NavState
from onboard.orientation import rotation_only
from onboard.prediction import Believed
from onboard.residuals import (
    AttitudePrior,
    Layout,
    Prior,
    SharedPrior,
    State,
    VelocityPrior,
)
from onboard.sensors import sensor_priors
from onboard.terrain import Terrain
from onboard.triangulation import triangulate

Array = NDArray[np.float64]

MIN_KEYFRAMES = 3
MIN_POINTS = 12
MIN_LESSON = 5  # keyframes of a last, short window that may still teach
MIN_PARALLAX_RAD = 0.008  # below this a point starts on the ground plane and not where its rays meet
START_SIGMAS = 5.0  # of an inlier at the start, at 640 px width: larger pictures carry larger calibration errors
OUTLIER_SIGMAS = 4.0
MIN_INLIERS = 0.5
MIN_PIXEL_SIGMA_PX = 0.08  # tracks err together by more than their residuals show
MAX_FIT_SIGMAS = 4.0  # median residual, in configured pixel sigmas, above which the fit explains nothing
MAX_DEPTH_SIGMA = 0.15  # relative; a scene less known than this has no parallax to speak of
MAX_PRIOR_SIGMAS = 3.5  # root mean square of a sensor's whitened residuals that a true solution may show
SHARED_SIGMAS = 5.0  # as far as one shared state may be from what was believed of it
MAX_GROUND_SLOPE = 1.0
WEIGHING_ROUNDS = 5
TOLERATED_RMS = 1.3  # of velocity's and attitude's whitened residuals
MAX_JITTER_S = 0.02
MAX_DISCORD = 2.0


@dataclass(frozen=True, eq=False)
class Solved:
    """A solved window: poses of its keyframes, its points by id, and everything the covariances need."""

    frames: tuple[int, ...]
    layout: Layout
    solution: Solution
    point_ids: Ids  # sorted
    good: NDArray[np.bool_]  # (P,) points whose measurements agree and which have parallax or plane to stand on
    plane: Array  # height at the ENU origin (m), slope east, slope north
    pixel_sigma_px: float
    reprojection_px: float
    keyframes: tuple[Keyframe, ...]

    def rows(self, ids: Ids) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
        """Row of each id among the points, and whether it is there and good."""
        if not len(self.point_ids):
            return np.zeros(len(ids), np.intp), np.zeros(len(ids), bool)
        at = np.minimum(np.searchsorted(self.point_ids, ids), len(self.point_ids) - 1)
        return at, (self.point_ids[at] == ids) & self.good[at]


class Window:
    """Keyframes in, solutions out."""

    def __init__(self, config: Config, camera: Camera) -> None:
        self.config = config
        self.camera = camera
        mount = config.mount
        self.R_body_cam = mount_rotation(mount.roll_deg, mount.pitch_deg, mount.yaw_deg)
        self.keyframes: list[Keyframe] = []
        self.solved: Solved | None = None
        self.pixel_sigma_px = config.solve.pixel_sigma_px
        self.jitter_s = config.camera.sigma_jitter_s
        self.discord = 1.0  # how much less than by their own scatter pixels are trusted
        self.terrain: Terrain | None = None  # of the area flown over, if known
        self.alignment = Alignment(
            np.radians(mount.sigma_deg), config.camera.sigma_latency_s, config.solve.attitude_wander_time_s
        )

    def reset(self) -> None:
        """Forget keyframes and structure: nothing links what comes to what was."""
        self.keyframes.clear()
        self.solved = None

    def attitude_guess(self, nav: NavState) -> Array | None:
        """R_cam_enu from the autopilot through mount and boresight, or None without attitude."""
        if nav.R_enu_body is None:
            return None
        out: Array = (nav.R_enu_body @ self.R_body_cam @ exp_so3(self.alignment.belief.mean[:3])).T
        return out

    def believed(self, nav: NavState) -> Believed | None:
        """The camera's pose by sensors alone with its covariance; None without attitude."""
        R_cam_enu = self.attitude_guess(nav)
        if R_cam_enu is None:
            return None
        solve_, belief = self.config.solve, self.alignment.belief
        speed = np.zeros(3) if nav.velocity_enu_m_s is None else nav.velocity_enu_m_s
        covariance = np.zeros((7, 7))
        white = nav.sigma_white_m
        position = np.array([nav.sigma_horizontal_m] * 2 + [nav.sigma_vertical_m]) ** 2 + white**2
        covariance[:3, :3] = np.diag(position) + belief.covariance[3, 3] * np.outer(speed, speed)
        tilt, heading = np.radians(solve_.attitude_sigma_deg), np.radians(solve_.heading_sigma_deg)
        boresight = R_cam_enu.T @ belief.covariance[:3, :3] @ R_cam_enu
        covariance[3:6, 3:6] = np.diag([tilt**2, tilt**2, heading**2]) + boresight
        gps = self.config.gps
        slow = SlowPosition(nav.sigma_horizontal_m, nav.sigma_vertical_m, gps.wander_time_s)
        return Believed(R_cam_enu, nav.position_enu_m, covariance, slow)

    def position_guess(self, nav: NavState) -> Array:
        """The camera's centre by GPS, shifted as the newest solved keyframe was shifted by its solution."""
        shift = np.zeros(3)
        if self.solved is not None:
            newest = self.solved.keyframes[-1]
            shift = newest.centre_enu_m - newest.nav.position_enu_m
        return nav.position_enu_m + shift

    def pose_guess(self, seen: Sighting, nav: NavState) -> tuple[Array, Array] | None:
        """R_cam_enu and centre of a new view: from known points where there are enough, else from the autopilot."""
        centre = self.position_guess(nav)
        if self.solved is not None:
            rows, known = self.solved.rows(seen.ids)
            if np.count_nonzero(known) >= MIN_POINTS:
                directions = self.solved.solution.state.points_enu_m[rows[known]] - centre
                rays = np.concatenate([seen.xy[known], np.ones((np.count_nonzero(known), 1))], axis=1)
                return rotation_only(directions, rays), centre
        attitude = self.attitude_guess(nav)
        return None if attitude is None else (attitude, centre)

    def add(
        self,
        frame: int,
        seen: Sighting,
        nav: NavState,
        nav_offset_s: float,
        body_rate_rad_s: Array | None,
        flown_enu_m: Array | None,
    ) -> None:
        """Take a keyframe; the oldest leaves a full window."""
        guess = self.pose_guess(seen, nav)
        # Without any attitude the start waits for the window's first solve; the mount alone is a placeholder.
        R, centre = guess if guess is not None else (self.R_body_cam.T, nav.position_enu_m)
        rate = np.zeros(3) if body_rate_rad_s is None else body_rate_rad_s
        self.keyframes.append(Keyframe(frame, seen, nav, rate, nav_offset_s, flown_enu_m, R, centre))
        del self.keyframes[: -self.config.solve.keyframes]

    def solve(self) -> Status:
        """Solve the window; OK and a new `solved`, or the reason why there is none (an older `solved` stays)."""
        if len(self.keyframes) < MIN_KEYFRAMES:
            return Status.STARTING
        ids, counts = np.unique(np.concatenate([k.sighting.ids for k in self.keyframes]), return_counts=True)
        ids = ids[counts >= 2]
        if len(ids) < MIN_POINTS:
            return Status.FEATURELESS
        xy, weight = self._grid(ids)
        if not self._orient(ids, xy, weight > 0):
            return Status.LOW_PARALLAX if self._travel_m() < 1.0 else Status.POOR_FIT
        layout = Layout(len(self.keyframes))
        R = np.stack([k.R_cam_enu for k in self.keyframes])
        C = np.stack([k.centre_enu_m for k in self.keyframes])
        points, reference, plane = self._points(ids, R, C, xy, weight > 0)
        belief = self.alignment.prior_for(self.keyframes[0].nav.stamp_ns)
        state = State(R, C, points, belief.mean[:3], float(belief.mean[3]), plane)
        relief, terrain = self._ground(points)
        if terrain is not None:
            reference[2] = 0.0
            state = replace(state, plane=np.zeros(3))
        clearance_m = None if terrain is not None else float(C[:, 2].mean() - reference[2])
        for _ in range(WEIGHING_ROUNDS):
            priors = sensor_priors(
                self.config, self.R_body_cam, self.keyframes, layout, belief, terrain is not None, self.jitter_s
            )
            problem = Problem(layout, xy, weight / self.discord, priors, reference, relief, terrain, clearance_m)
            first = solve(problem, state, scale=3.0, tolerance=1e-4)
            if not self._reweigh(priors, first.state):
                break
            state = first.state
        weight = problem.weight
        outlier = first.residual_sigmas > OUTLIER_SIGMAS * max(self._fit(first.residual_sigmas), 1.0)
        kept = np.where(outlier, 0.0, weight)
        kept[:, np.count_nonzero(kept > 0, axis=0) < 2] = 0.0
        # The window's own noise, not the flight's so far, is what its covariances must be built on.
        own = self._fit(np.where(kept > 0, first.residual_sigmas, np.nan))
        if not np.isfinite(own):
            return Status.POOR_FIT
        own = max(own, MIN_PIXEL_SIGMA_PX / (self.pixel_sigma_px * self.discord))
        second = solve(replace(problem, weight=kept / own), first.state, scale=6.0, tolerance=1e-6)
        return self._judge(ids, layout, priors, second, weight, kept, own)

    def _reweigh(self, priors: list[Prior], state: State) -> bool:
        """Learn from velocity and attitude residuals how pictures and autopilot disagree; True if weights changed.

        Stamps that stray by some milliseconds (photographs, USB) show in both at once, and are allowed for first. What
        disagreement remains is the picture's: a calibration's error moves many features together, bends the poses and
        hardly shows in the features' own residuals. All pixels are then trusted less, until both sides agree. (6.7)
        """
        measured = [p for p in priors if isinstance(p, VelocityPrior | AttitudePrior)]
        if self.keyframes[0].nav.R_enu_body is None:
            measured = [p for p in measured if isinstance(p, VelocityPrior)]
        if not measured:
            return False
        rms = max(float(np.sqrt(np.mean(p.evaluate(state)[0] ** 2))) for p in measured)
        if rms > TOLERATED_RMS:
            if self.jitter_s < MAX_JITTER_S:
                self.jitter_s = min(max(self.jitter_s, 0.003) * min(rms, 3.0), MAX_JITTER_S)
                return True
            if self.discord < MAX_DISCORD:
                self.discord = min(self.discord * min(rms, 2.0), MAX_DISCORD)
                return True
        elif rms < 1.0 / TOLERATED_RMS:
            self.jitter_s = max(0.95 * self.jitter_s, self.config.camera.sigma_jitter_s)
            self.discord = max(0.95 * self.discord, 1.0)
        return False

    def _judge(
        self, ids: Ids, layout: Layout, priors: list[Prior], s: Solution, weight: Array, kept: Array, own: float
    ) -> Status:
        """Decide by evidence whether a solution may be published, and keep it if so."""
        seen, used = np.count_nonzero(weight > 0), np.count_nonzero(kept > 0)
        fit = self._fit(s.residual_sigmas)
        sigma_px = self.pixel_sigma_px * self.discord * own * fit
        depth = np.abs(
            np.einsum("kj,kpj->kp", s.state.R_cam_enu[:, 2], s.state.points_enu_m - s.state.centres_enu_m[:, None])
        )
        depth_m = np.where(kept > 0, depth, np.nan)
        median_depth = float(np.nanmedian(depth_m)) if used else np.nan
        good = np.count_nonzero(kept > 0, axis=0) >= 2
        if used < MIN_INLIERS * seen or np.count_nonzero(good) < MIN_POINTS or not np.isfinite(median_depth):
            return Status.POOR_FIT
        if sigma_px > MAX_FIT_SIGMAS * self.config.solve.pixel_sigma_px * max(1.0, self.camera.width_px / 640.0):
            return Status.POOR_FIT
        scale = max(fit, 1.0) ** 2
        spread = _depth_sigma(s, good, layout) / median_depth
        if float(np.median(spread)) * np.sqrt(scale) > MAX_DEPTH_SIGMA:
            return Status.LOW_PARALLAX
        below = np.einsum("j,kpj->kp", [0.0, 0.0, 1.0], s.state.points_enu_m - s.state.centres_enu_m[:, None]) < 0.0
        if np.count_nonzero(below & (kept > 0)) < 0.9 * used or np.abs(s.state.plane[1:]).max() > MAX_GROUND_SLOPE:
            return Status.POOR_FIT  # the ground above the aircraft, or a wall: a turned-over solution
        if np.linalg.eigvalsh(s.covariance)[0] <= 0.0:
            return Status.POOR_FIT
        for prior in priors:
            r = prior.evaluate(s.state)[0]
            # What is shared (mount, delay) must not be bent far in any one direction to explain a scene that moves.
            worst = np.abs(r).max() / SHARED_SIGMAS if isinstance(prior, SharedPrior) else 0.0
            if max(float(np.sqrt(np.mean(r * r))) / MAX_PRIOR_SIGMAS, worst) > 1.0:
                return Status.POOR_FIT
        self.keyframes = [
            replace(k, R_cam_enu=R, centre_enu_m=C)
            for k, R, C in zip(self.keyframes, s.state.R_cam_enu, s.state.centres_enu_m, strict=True)
        ]
        plane, _ = fit_plane(s.state.points_enu_m[good])
        if len(self.keyframes) == self.config.solve.keyframes:
            self.learn(s, layout)
        # The noise of tracking is learned slowly, so that one odd window changes little.
        self.pixel_sigma_px = float(
            np.clip(self.pixel_sigma_px * (own * fit * self.discord) ** 0.3, MIN_PIXEL_SIGMA_PX, 5.0)
        )
        self.solved = Solved(
            tuple(k.frame for k in self.keyframes),
            layout,
            s,
            ids,
            good,
            plane,
            sigma_px,
            sigma_px * 1.177,
            tuple(self.keyframes),
        )
        return Status.OK

    def learn(self, s: Solution, layout: Layout) -> None:
        """Offer a solved window's boresight and time offset as a lesson."""
        if self.keyframes[0].nav.R_enu_body is None:
            return
        shared = slice(layout.boresight.start, layout.boresight.start + SHARED)
        mean = np.append(s.state.boresight_rad, s.state.offset_s)
        start, end = self.keyframes[0].nav.stamp_ns, self.keyframes[-1].nav.stamp_ns
        self.alignment.offer(start, end, mean, s.covariance[shared, shared])

    def conclude(self) -> None:
        """The end of a stretch: learn from its last window even if it never filled."""
        if self.solved is not None and len(self.keyframes) == len(self.solved.keyframes) >= MIN_LESSON:
            self.learn(self.solved.solution, self.solved.layout)

    @staticmethod
    def _fit(sigmas: Array) -> float:
        """Robust one sigma per axis of whitened residual lengths (K, P): their median over a Rayleigh distribution's.

        Residuals of a fit are smaller than the noise by what the fit has swallowed: three unknowns a point, six a view.
        """
        known = np.isfinite(sigmas)
        n = 2 * np.count_nonzero(known)
        if n == 0:
            return float("inf")
        unknowns = 3 * np.count_nonzero(known.any(axis=0)) + 6 * len(sigmas)
        swallowed = np.sqrt(n / max(n - unknowns, 0.2 * n))
        return float(np.median(sigmas[known]) / 1.1774 * swallowed)

    def _travel_m(self) -> float:
        positions = np.stack([k.nav.position_enu_m for k in self.keyframes])
        return float(np.linalg.norm(np.ptp(positions, axis=0)))

    def _ground(self, points: Array) -> tuple[Array, Terrain | None]:
        """1 / sigma of the ground under each point (P,), and the terrain if it is known under all of them."""
        if self.terrain is not None:
            height, _ = self.terrain.height_and_slope(points[:, :2])
            if np.all(np.isfinite(height)):
                return np.full(len(points), 1.0 / self.config.terrain.sigma_m), self.terrain
        return np.full(len(points), 1.0 / max(self.config.solve.relief_sigma_m, 1e-3)), None

    def _grid(self, ids: Ids) -> tuple[Array, Array]:
        """Measurements and weights on the (keyframe, point) grid."""
        xy = np.zeros((len(self.keyframes), len(ids), 2))
        weight = np.zeros((len(self.keyframes), len(ids)))
        for k, keyframe in enumerate(self.keyframes):
            seen = keyframe.sighting
            at = np.minimum(np.searchsorted(ids, seen.ids), len(ids) - 1)
            known = ids[at] == seen.ids
            xy[k, at[known]] = seen.xy[known]
            weight[k, at[known]] = 1.0 / (self.pixel_sigma_px * seen.gain[known])
        return xy, weight

    def _orient(self, ids: Ids, xy: Array, seen: NDArray[np.bool_]) -> bool:
        """Give every keyframe a starting orientation; False if the rays support none."""
        if self.solved is not None or all(k.nav.R_enu_body is not None for k in self.keyframes):
            return True
        centres = np.stack([k.nav.position_enu_m for k in self.keyframes])
        tolerance = START_SIGMAS * self.pixel_sigma_px * max(1.0, self.camera.width_px / 640.0) / self.camera.focal_px
        rotations = starting.orient(xy, seen, centres, self.R_body_cam, tolerance)
        if rotations is None:
            return False
        self.keyframes = [
            replace(k, R_cam_enu=R, centre_enu_m=k.nav.position_enu_m)
            for k, R in zip(self.keyframes, rotations, strict=True)
        ]
        return True

    def _points(self, ids: Ids, R: Array, C: Array, xy: Array, seen: NDArray[np.bool_]) -> tuple[Array, Array, Array]:
        """Starting points (P, 3), the plane's reference point, and the plane about it."""
        rays = triangulate(R, C, xy, seen)
        points = rays.points_enu_m.copy()
        sound = rays.is_ahead & (rays.parallax_rad > MIN_PARALLAX_RAD)
        previous = self.solved
        if previous is not None:
            rows, known = previous.rows(ids)
            points[known] = previous.solution.state.points_enu_m[rows[known]]
            sound |= known
        if np.count_nonzero(sound) >= MIN_POINTS:
            plane, _ = fit_plane(points[sound])
        elif previous is not None:
            plane = previous.plane
        else:
            newest = self.keyframes[-1].nav
            height = newest.height_above_home_m or 100.0
            plane = np.array([newest.position_enu_m[2] - height, 0.0, 0.0])
        if np.any(np.abs(plane[1:]) > 0.6):  # steeper than any ground an orientation was right about
            plane = np.array([float(np.median(points[sound, 2])), 0.0, 0.0])
        loose = ~sound
        if np.any(loose):
            points[loose] = _on_plane(R, C, xy, seen, plane)[loose]
        reference = np.array([*np.median(points[:, :2], axis=0), 0.0])
        reference[2] = plane[0] + plane[1:] @ reference[:2]
        return points, reference, np.array([0.0, plane[1], plane[2]])


def _depth_sigma(s: Solution, good: NDArray[np.bool_], layout: Layout) -> Array:
    """One sigma (m) of each good point along the newest keyframe's axis, relative to that keyframe."""
    axis = s.state.R_cam_enu[-1, 2]
    gain = s.point_gain[good] * -1.0
    M = np.einsum("i,pid->pd", axis, gain)
    M[:, layout.centre(layout.keyframes - 1)] -= axis
    own = np.einsum("i,pij,j->p", axis, s.point_covariance[good], axis)
    out: Array = np.sqrt(np.maximum(np.einsum("pd,de,pe->p", M, s.covariance, M) + own, 0.0))
    return out


def _on_plane(R: Array, C: Array, xy: Array, seen: NDArray[np.bool_], plane: Array) -> Array:
    """Each point where its newest ray meets the plane (height at origin, slopes); far rays at ten clearances."""
    newest = len(seen) - 1 - np.argmax(seen[::-1], axis=0)
    P = np.arange(seen.shape[1])
    rays = np.concatenate([xy[newest, P], np.ones((len(P), 1))], axis=1)
    d = np.einsum("pi,pij->pj", rays, R[newest])
    normal = np.array([-plane[1], -plane[2], 1.0])
    clearance = np.maximum(C[newest] @ normal - plane[0], 1.0)
    down = np.maximum(-(d @ normal), 0.1)
    out: Array = C[newest] + d * (clearance / down)[:, None]
    return out
