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
from contract.feature_set import Status
from contract.rotations import exp_so3, mount_rotation
from onboard import starting
from onboard.alignment import STATES as SHARED
from onboard.alignment import Alignment, Belief
from onboard.bundle import Problem, Solution, solve
from onboard.config import Config
from onboard.levelling import fit_plane
from onboard.navigation import NavState
from onboard.orientation import rotation_only
from onboard.residuals import (
    AttitudePrior,
    Layout,
    PositionPrior,
    Prior,
    SharedPrior,
    State,
    VelocityPrior,
    wandering_sqrt_information,
)
from onboard.triangulation import triangulate

Array = NDArray[np.float64]
Ids = NDArray[np.int64]

MIN_KEYFRAMES = 3
MIN_POINTS = 12
MIN_PARALLAX_RAD = 0.008  # below this a point starts on the ground plane and not where its rays meet
START_SIGMAS = 5.0  # of an inlier at the start, at 640 px width: larger pictures carry larger calibration errors
OUTLIER_SIGMAS = 4.0
MIN_INLIERS = 0.5
MAX_FIT_SIGMAS = 4.0  # median residual, in configured pixel sigmas, above which the fit explains nothing
MAX_DEPTH_SIGMA = 0.15  # relative; a scene less known than this has no parallax to speak of
MAX_PRIOR_SIGMAS = 3.5  # root mean square of a sensor's whitened residuals that a true solution may show
MAX_GROUND_SLOPE = 1.0
# How far an aircraft without attitude sensor may be from flying level along its path in a coordinated turn.
PATH_SIGMA_RAD = 0.25
PATH_WHITE_SIGMA_RAD = 0.15
GRAVITY_M_S2 = 9.81


@dataclass(frozen=True, eq=False)
class Sighting:
    """What one picture saw: feature ids (N,), pixels, unit-depth coordinates (N, 2), and unit-depth per pixel (N,)."""

    ids: Ids
    uv_px: Array
    xy: Array
    gain: Array


@dataclass(frozen=True, eq=False)
class Keyframe:
    """A sighting with the vehicle's state and the current estimate of the camera's pose."""

    frame: int
    sighting: Sighting
    nav: NavState
    body_rate_rad_s: Array
    nav_offset_s: float  # camera-to-autopilot offset at which `nav` was taken
    flown_enu_m: Array | None  # since the keyframe before, by integrated velocity
    R_cam_enu: Array
    centre_enu_m: Array


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


def sighting(camera: Camera, ids: Ids, uv_px: Array) -> Sighting:
    """Undistort pixels once; those without a ray are left out."""
    rays, valid = camera.unproject(uv_px)
    xy = rays[valid, :2]
    J = camera.distortion_jacobian(xy)
    det = np.abs(J[:, 0, 0] * J[:, 1, 1] - J[:, 0, 1] * J[:, 1, 0])
    gain = 1.0 / (camera.focal_px * np.sqrt(np.maximum(det, 0.05)))
    return Sighting(ids[valid], uv_px[valid], xy, gain)


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
        priors = self._priors(layout, belief)
        relief = np.full(len(ids), 1.0 / max(self.config.solve.relief_sigma_m, 1e-3))
        problem = Problem(layout, xy, weight, priors, reference, relief)
        first = solve(problem, state, scale=3.0, tolerance=1e-4)
        outlier = first.residual_sigmas > OUTLIER_SIGMAS * max(self._fit(first.residual_sigmas), 1.0)
        kept = np.where(outlier, 0.0, weight)
        kept[:, np.count_nonzero(kept > 0, axis=0) < 2] = 0.0
        second = solve(replace(problem, weight=kept), first.state, scale=6.0, tolerance=1e-6)
        return self._judge(ids, layout, priors, second, weight, kept, reference)

    def _judge(
        self, ids: Ids, layout: Layout, priors: list[Prior], s: Solution, weight: Array, kept: Array, reference: Array
    ) -> Status:
        """Decide by evidence whether a solution may be published, and keep it if so."""
        seen, used = np.count_nonzero(weight > 0), np.count_nonzero(kept > 0)
        fit = self._fit(s.residual_sigmas)
        sigma_px = self.pixel_sigma_px * fit
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
            if float(np.sqrt(np.mean(r * r))) > MAX_PRIOR_SIGMAS:
                return Status.POOR_FIT
        self.keyframes = [
            replace(k, R_cam_enu=R, centre_enu_m=C)
            for k, R, C in zip(self.keyframes, s.state.R_cam_enu, s.state.centres_enu_m, strict=True)
        ]
        slopes = s.state.plane[1:]
        plane = np.array([reference[2] + s.state.plane[0] - slopes @ reference[:2], *slopes])
        self._learn(s, layout)
        # The noise of tracking is learned slowly, so that one odd window changes little.
        self.pixel_sigma_px = float(np.clip(self.pixel_sigma_px * fit**0.3, 0.08, 5.0))
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

    def _learn(self, s: Solution, layout: Layout) -> None:
        """Offer a full window's boresight and time offset as a lesson."""
        if len(self.keyframes) < self.config.solve.keyframes or self.keyframes[0].nav.R_enu_body is None:
            return
        shared = slice(layout.boresight.start, layout.boresight.start + SHARED)
        mean = np.append(s.state.boresight_rad, s.state.offset_s)
        start, end = self.keyframes[0].nav.stamp_ns, self.keyframes[-1].nav.stamp_ns
        self.alignment.offer(start, end, mean, s.covariance[shared, shared])

    @staticmethod
    def _fit(sigmas: Array) -> float:
        """Robust one sigma per axis of whitened residual lengths: their median over that of a Rayleigh distribution."""
        known = sigmas[np.isfinite(sigmas)]
        return float(np.median(known)) / 1.1774 if len(known) else float("inf")

    def _travel_m(self) -> float:
        positions = np.stack([k.nav.position_enu_m for k in self.keyframes])
        return float(np.linalg.norm(np.ptp(positions, axis=0)))

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

    def _priors(self, layout: Layout, belief: Belief) -> list[Prior]:
        solve_, gps = self.config.solve, self.config.gps
        stamps_ns = np.array([k.nav.stamp_ns for k in self.keyframes], np.int64)
        stamps = (stamps_ns - stamps_ns[0]) / 1e9
        offsets = np.array([k.nav_offset_s for k in self.keyframes])
        positions = np.stack([k.nav.position_enu_m for k in self.keyframes])
        velocities = np.stack(
            [np.zeros(3) if k.nav.velocity_enu_m_s is None else k.nav.velocity_enu_m_s for k in self.keyframes]
        )
        horizontal = max(k.nav.sigma_horizontal_m for k in self.keyframes)
        vertical = max(k.nav.sigma_vertical_m for k in self.keyframes)
        whitener = np.stack(
            [
                wandering_sqrt_information(stamps, gps.sigma_white_m * grow, wander, gps.wander_time_s)
                for wander, grow in ((horizontal, 1.0), (horizontal, 1.0), (vertical, 1.5))
            ]
        )
        priors: list[Prior] = [PositionPrior(layout, positions, velocities, whitener, offsets)]
        flown = [k.flown_enu_m for k in self.keyframes[1:]]
        if solve_.velocity and all(f is not None for f in flown):
            sigma = gps.sigma_velocity_m_s * np.maximum(np.diff(stamps), 0.05)
            priors.append(VelocityPrior(layout, np.array(flown), sigma))
        if all(k.nav.R_enu_body is not None for k in self.keyframes):
            R_enu_cam = np.stack(
                [k.nav.R_enu_body @ self.R_body_cam for k in self.keyframes if k.nav.R_enu_body is not None]
            )
            rates = np.stack([k.body_rate_rad_s for k in self.keyframes]) @ self.R_body_cam
            attitude = np.stack(
                [
                    wandering_sqrt_information(
                        stamps,
                        np.radians(solve_.attitude_white_sigma_deg),
                        np.radians(sigma_deg),
                        solve_.attitude_wander_time_s,
                    )
                    for sigma_deg in (solve_.attitude_sigma_deg, solve_.attitude_sigma_deg, solve_.heading_sigma_deg)
                ]
            )
            priors.append(AttitudePrior(layout, R_enu_cam, rates, attitude, offsets))
        else:
            coordinated = self._coordinated(stamps, velocities)
            if coordinated is not None:
                loose = wandering_sqrt_information(stamps, PATH_WHITE_SIGMA_RAD, PATH_SIGMA_RAD, gps.wander_time_s)
                heading = wandering_sqrt_information(
                    stamps, PATH_WHITE_SIGMA_RAD, 2 * PATH_SIGMA_RAD, gps.wander_time_s
                )
                still = np.zeros((layout.keyframes, 3))
                priors.append(AttitudePrior(layout, coordinated, still, np.stack([loose, loose, heading]), offsets))
        priors.append(self._shared_prior(layout, belief))
        return priors

    def _coordinated(self, stamps_s: Array, velocities: Array) -> Array | None:
        """R_enu_cam (K, 3, 3) of a vehicle that heads where it flies and banks into its turns; None while it is slow.

        What keeps any aircraft in the air pushes along its own up axis, so that axis lies near acceleration plus
        gravity. A weak belief, (5.10), but one that a turned-over solution contradicts.
        """
        if len(stamps_s) < 2 or np.linalg.norm(velocities[:, :2], axis=1).min() < 3.0:
            return None
        acceleration = np.gradient(velocities, stamps_s, axis=0)
        up = acceleration + np.array([0.0, 0.0, GRAVITY_M_S2])
        down = -up / np.linalg.norm(up, axis=1, keepdims=True)
        ahead = velocities - np.sum(velocities * down, axis=1, keepdims=True) * down
        ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
        R_enu_body = np.stack([ahead, np.cross(down, ahead), down], axis=-1)
        out: Array = R_enu_body @ self.R_body_cam
        return out

    def _shared_prior(self, layout: Layout, belief: Belief) -> SharedPrior:
        covariance = np.zeros((7, 7))
        covariance[:SHARED, :SHARED] = belief.covariance
        slope = np.tan(np.radians(self.config.solve.level_ground_sigma_deg)) if self.config.solve.level_ground else 3.0
        covariance[4:, 4:] = np.diag([1e8, slope**2, slope**2])
        mean = np.zeros(7)
        mean[:SHARED] = belief.mean
        return SharedPrior(layout, mean, np.linalg.inv(np.linalg.cholesky(covariance)))


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
