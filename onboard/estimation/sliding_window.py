"""The sliding window of keyframes: what each saw and where it was, and the newest solution.

The window holds no picture and knows no clock: keyframes come in with their measurements and their navigation state.
When to add one is the pipeline's decision, and also when a request made by `prepare` is adjusted and its outcome
adopted. Nothing but the window changes what it holds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera, Sigma
from contract.feature_set import Status
from contract.rotations import mount_rotation
from onboard.config.schema import Config
from onboard.estimation.boresight import Alignment, PlatformEstimate
from onboard.estimation.camera_states import COUNT, corrected, readout_s, taken, without_readout
from onboard.estimation.clock_profile import ClockProfile
from onboard.estimation.counted_from import CountedFrom
from onboard.estimation.factors import RATES
from onboard.estimation.ground_slope import GroundSlope, SlopeSeen, seen_alone
from onboard.estimation.ground_variogram import slope_variance
from onboard.estimation.information import Information, with_marginal
from onboard.estimation.keyframe import Keyframe, Observation, seen_with, stamp_sigma_s, with_attitude
from onboard.estimation.moved_optics import MOVED
from onboard.estimation.platform_states import DELAY, OFFSET, PLANE, STATES
from onboard.estimation.sensor_factors import level_sigma, with_delays_held_open
from onboard.estimation.sensor_orientation import by_attitude
from onboard.estimation.shared_errors import SensorPose, make_sensor_pose
from onboard.estimation.solved_window import Solved
from onboard.estimation.window_acceptance import MIN_POINTS, Memory, off_take_off
from onboard.estimation.window_problem import Outcome
from onboard.estimation.window_request import Noise, Request
from onboard.estimation.window_solver import adjust
from onboard.estimation.window_start import follow, start_tolerance_rad
from onboard.geometry.plane_homography import Pose
from onboard.geometry.relative_orientation import rotation_only
from onboard.geometry.terrain_grid import Terrain
from onboard.navigation.limits import LIKELY_SIGMAS
from onboard.navigation.navigator import Navigation, NavState
from onboard.navigation.position_interpolation import Displacement

Array = NDArray[np.float64]

GUESS_STEPS = 2  # of a rotation that is only the start of a resection or a solve
LEAST_SIGMA_S = 0.005  # of attitudes' stamps, the same for all: a share of a turn of an autopilot's loop (2.5 to 20 ms)
LEAST_OFFSET_S, LEAST_DELAY_S = 0.003, 0.02  # of 3 rad/s and 30 m/s: half a degree and half a metre
MIN_UPDATE = 5  # keyframes of a last, short window that may still update the alignment


class Window:
    """Keyframes in, solutions out."""

    def __init__(self, config: Config, camera: Camera) -> None:
        self.config = config
        self.camera_file = camera
        self.camera = camera  # as it is estimated now: new observations are made with it
        mount = config.mount
        self.R_body_cam = mount_rotation(mount.roll_deg, mount.pitch_deg, mount.yaw_deg)
        self.keyframes: list[Keyframe] = []
        self.solved: Solved | None = None
        self.memory = Memory()
        self.refusal = ""  # why the newest window has no solution, in words; empty if it has one
        self.noise = Noise(config.solve.pixel_sigma_px, config.camera.sigma_jitter_s)
        self.is_mirrored: bool | None = None  # windows have shown the pictures to be mirror images, or not to be
        self.is_stretched: bool | None = None  # and to be stretched along one side against the camera file
        self.terrain: Terrain | None = None  # of the area below, if known
        self.terrain_doubt = ""  # how far that is off the ground, as windows or the take-off show; empty: it is not
        self._has_terrain_agreed = False  # with the ground that a window showed
        self.alignment = Alignment(
            np.radians(mount.sigma_deg),
            config.camera.sigma_latency_s,
            config.solve.attitude_correlation_time_s,
            config.gps.sigma_latency_s,
            np.radians(config.solve.heading_sigma_deg),
            camera,
            (config.camera.readout_s, config.camera.sigma_readout_s),
            CountedFrom.of(config, camera, self.R_body_cam),
        )
        self.camera_taken = np.zeros_like(self.alignment.platform.mean[STATES:])  # what parts `camera` from its file
        self.ground_slope = GroundSlope(level_sigma(config))
        self._times_s: tuple[float, float] | None = None  # offset and delay as the newest window found them
        self._request = self.prepare()  # the newest

    @property
    def platform(self) -> PlatformEstimate:
        """The newest estimate of the platform, with no delay surer than declared, (5.15)."""
        return with_delays_held_open(self.config, self.alignment.platform)

    def times_s(self) -> tuple[float, float]:
        """Time offset and position delay about which the next solve may take their effects as linear.

        What the newest window found itself, which the estimate may only follow minutes later; else the estimate.
        """
        mean = self.alignment.platform.mean
        return (float(mean[OFFSET]), float(mean[DELAY])) if self._times_s is None else self._times_s

    def reset(self) -> None:
        """Forget keyframes and structure: nothing links what comes to what was."""
        self.keyframes.clear()
        self.solved = None
        self.memory = self.memory.without_windows()
        self.is_mirrored = self.is_mirrored or None  # a camera that has begun again may flip its pictures

    def change_lens(self, camera: Camera, sigma: float) -> None:
        """Begin again behind a lens that has been zoomed to `camera`, known to one `sigma` of its focal length."""
        self.reset()
        self.alignment.lens_changed(camera, sigma)
        self.camera_file = camera
        states = self.alignment.platform.mean[STATES:]
        self.camera_taken, self.camera = states.copy(), corrected(camera, states)

    def change_terrain(self, terrain: Terrain | None) -> None:
        """Take the terrain of the area below, as far as it is known."""
        self.terrain = terrain

    def see_take_off(self, nav: NavState) -> None:
        """Take a state: one that stands shows where the ground is, as long as no window has. (16.17)"""
        if self.terrain is not None and self.solved is None and not self._has_terrain_agreed:
            found = off_take_off(self.config, self.terrain, nav)
            self.terrain_doubt = self.terrain_doubt if found is None else found

    def forget_ground(self) -> None:
        """Forget terrain and slope: the frame that they are in has been left."""
        self.terrain = None
        self.ground_slope.forget()

    def change_mount(self, keyframes: Sequence[Keyframe], noise: Noise) -> None:
        """Take the keyframes with another mount's attitudes, and its noise; what was solved by the old is forgotten."""
        self._forget_solutions()
        self.keyframes, self.noise = list(keyframes), noise

    def look_up_again(self, navigation: Navigation) -> None:
        """Look up the keyframes' navigation at the newest time offset and delay; where one has none, all keep theirs.

        An offset acts on a window by first derivatives, (5.4) to (5.7), which hold for some tens of milliseconds of a
        roll.
        """
        offset_s, delay_s = self.times_s()
        if (
            all(
                abs(k.nav_offset_s - offset_s) <= LEAST_OFFSET_S and abs(k.nav_delay_s - delay_s) <= LEAST_DELAY_S
                for k in self.keyframes
            )
            or not with_attitude(self.keyframes).any()
        ):
            return
        offset_ns = round(offset_s * 1e9)
        solved = set() if self.solved is None else set(self.solved.frames)
        found: list[Keyframe] = []
        for k in self.keyframes:
            nav = navigation.state_at(k.nav.stamp_ns, offset_s, k.nav.stamp_sigma_s, delay_s)
            rate = navigation.body_rate_at(k.nav.stamp_ns + offset_ns)
            if isinstance(nav, Status) or nav.stretch != k.nav.stretch or (rate is None and nav.R_enu_body is not None):
                return
            rate = k.body_rate_rad_s if rate is None else rate
            displacement = None
            if found and k.displacement is not None:
                displacement = navigation.displacement(found[-1].nav.stamp_ns + offset_ns, k.nav.stamp_ns + offset_ns)
            now = replace(
                k, nav=nav, nav_offset_s=offset_s, nav_delay_s=delay_s, body_rate_rad_s=rate, displacement=displacement
            )
            R_cam_enu = self.attitude_guess(nav)
            if k.frame not in solved and R_cam_enu is not None:  # its start was by the navigation that is replaced
                now = replace(now, R_cam_enu=R_cam_enu, centre_enu_m=self.position_guess(nav))
            found.append(now)
        self.keyframes = found

    def forget_solution_since(self, stamp_ns: int) -> None:
        """Forget the newest solution if the window holds a picture taken then or later."""
        if any(k.nav.stamp_ns >= stamp_ns for k in self.keyframes):
            self.solved = None

    def _forget_solutions(self) -> None:
        """Forget what was solved, and what later windows are compared with; the keyframes stay."""
        self.solved, self.memory = None, Memory()

    def begin_again(self) -> None:
        """Forget all but the newest keyframe, and the estimate of its pose."""
        newest = self.keyframes[-1]
        self.reset()
        times_s = newest.nav_offset_s, newest.nav_delay_s
        self.add(newest.frame, newest.observation, newest.nav, times_s, newest.body_rate_rad_s, None)

    def attitude_guess(self, nav: NavState) -> Array | None:
        """R_cam_enu from the autopilot through mount and boresight, or None without attitude."""
        return by_attitude(nav, self.alignment.platform, self.R_body_cam)

    def sensor_pose(self, nav: NavState) -> SensorPose | None:
        """The camera's pose by sensors alone with its covariance; None without attitude."""
        R_cam_enu = self.attitude_guess(nav)
        if R_cam_enu is None:
            return None
        rate = np.linalg.norm(self.keyframes[-1].body_rate_rad_s) if self.keyframes else 0.0
        return make_sensor_pose(
            self.config,
            nav,
            self.alignment.platform.widened(nav.stamp_sigma_s),
            R_cam_enu,
            self.noise.factors_at(nav.stamp_ns),
            self.R_body_cam.T @ np.array(self.config.mount.lever_arm_m),
            (self.noise.jitter_s, float(rate)),
        )

    def position_guess(self, nav: NavState) -> Array:
        """The camera's centre by GPS, shifted as the nearest solved keyframe was shifted by its solution."""
        if self.solved is None:
            return nav.position_enu_m
        near = self.solved.keyframes[self.solved.nearest(nav.stamp_ns)]
        return nav.position_enu_m + (near.centre_enu_m - near.nav.position_enu_m)

    def pose_guess(self, seen: Observation, nav: NavState) -> Pose | None:
        """A first pose of a new view; None where nothing gives an orientation.

        The orientation comes from known points if there are enough, else from the autopilot, else from the newest
        keyframe; the place is `position_guess`.
        """
        centre = self.position_guess(nav)
        if self.solved is not None:
            rows, known = self.solved.rows(seen.ids)
            if np.count_nonzero(known) >= MIN_POINTS:
                directions = self.solved.solution.state.points_enu_m[rows[known]] - centre
                rays = np.column_stack([seen.xy[known], np.ones(len(directions))])
                return Pose(rotation_only(directions, rays, GUESS_STEPS), centre)
        attitude = self.attitude_guess(nav)
        if attitude is None:
            attitude = self._after_newest(seen, centre)
        return None if attitude is None else Pose(attitude, centre)

    def _after_newest(self, seen: Observation, centre_enu_m: Array) -> Array | None:
        """R_cam_enu from what a view has in common with the newest keyframe, once that is oriented."""
        newest = self.keyframes[-1] if self.keyframes else None
        if self.solved is None or newest is None or not newest.is_oriented:
            return None
        _, before, now = np.intersect1d(newest.observation.ids, seen.ids, assume_unique=True, return_indices=True)
        rays_before = np.column_stack([newest.observation.xy[before], np.ones(len(before))])
        rays = np.column_stack([seen.xy[now], np.ones(len(now))])
        travel_enu_m = centre_enu_m - newest.centre_enu_m
        tolerance_rad = start_tolerance_rad(self.noise.pixel_sigma_px, self.camera)
        return follow(rays_before, rays, newest.R_cam_enu, travel_enu_m, tolerance_rad)

    def add(
        self,
        frame: int,
        seen: Observation,
        nav: NavState,
        times_s: tuple[float, float],
        body_rate_rad_s: Array | None,
        displacement: Displacement | None,
        flow_disagreement_px: Array | None = None,
    ) -> None:
        """Take a keyframe; the oldest leaves a full window. `flow_disagreement_px`: since the one before."""
        guess = self.pose_guess(seen, nav)
        # Without any attitude the start waits for the window's first solve; the mount alone is a placeholder.
        pose = guess or Pose(self.R_body_cam.T, nav.position_enu_m)
        rate = np.zeros(3) if body_rate_rad_s is None else body_rate_rad_s
        flow_disagreement_xy = None if flow_disagreement_px is None else flow_disagreement_px / self.camera.focal_px
        start = pose.R_cam_enu, pose.centre_enu_m
        made = Keyframe(frame, seen, nav, rate, *times_s, displacement, *start, flow_disagreement_xy, guess is not None)
        self.keyframes.append(made)
        del self.keyframes[: -self.config.solve.keyframes]

    def prepare(self, *, is_mount_open: bool = False) -> Request:
        """The window as it stands, for `window_solver.adjust`; nothing done to the window later changes it."""
        self._see_with_estimate()  # which may have been restored from the state directory
        start_ns = self.keyframes[0].nav.stamp_ns if self.keyframes else 0
        has_slope = self.config.solve.level_ground and self.keyframes
        self._request = Request(
            self.config,
            self.camera,
            self.camera_file,
            taken(self.camera_taken),
            self.R_body_cam,
            tuple(self.keyframes),
            self.solved,
            self.terrain,
            self.alignment.prior_for(start_ns).widened(stamp_sigma_s(self.keyframes)),
            self.noise,
            self.ground_slope.prior_for(start_ns, self._place_enu_m()) if has_slope else None,
            self.memory,
            is_mount_open,
            has_terrain_agreed=self._has_terrain_agreed,
            is_terrain_left_out=bool(self.terrain_doubt) and not self._has_terrain_agreed,
            is_mirrored=self.is_mirrored,
            is_stretched=self.is_stretched,
        )
        return self._request

    def _place_enu_m(self) -> Array:
        """The window's mean position, east and north (2,)."""
        out: Array = np.mean([k.nav.position_enu_m[:2] for k in self.keyframes], axis=0)
        return out

    def adopt(self, outcome: Outcome, clock: ClockProfile | None = None) -> Status:
        """Take what came of the newest request; OK and a new `solved`, or why there is none (an older one stays).

        `clock`: how its orientations fit the autopilot's at other time offsets. No keyframe may have been added since.
        """
        self.keyframes = list(outcome.keyframes)
        if clock is not None and clock.rejects(self.times_s()[0]):
            return self._begin_at(clock)
        self.noise = outcome.noise
        self.refusal = outcome.reason
        self.is_mirrored = self.is_mirrored if outcome.is_mirrored is None else outcome.is_mirrored
        self.is_stretched = self.is_stretched if outcome.is_stretched is None else outcome.is_stretched
        if outcome.solved is not None or outcome.terrain_doubt:
            self.terrain_doubt = outcome.terrain_doubt
        if outcome.solved is not None and self._request.terrain is not None:
            self._has_terrain_agreed |= not outcome.terrain_doubt
        if outcome.status in MOVED:
            self.solved = None  # what it places is placed through optics that it knows nothing of
        if outcome.lens_moved:
            self.alignment.lens_moved(outcome.lens_moved)
        found = outcome.solved or outcome.rejected
        if found is not None:
            self.memory = self.memory.after(found, outcome.agreed, outcome.solved is not None)
        if outcome.solved is not None:
            self.solved = self.memory.windows[-1]
            self._see_slope(outcome.solved)
            is_wrong = outcome.noise.failing.fails_at(self.keyframes[-1].nav.stamp_ns)  # what a sensor reports
            if len(self.keyframes) == self.config.solve.keyframes and not is_wrong:
                self.learn(outcome.solved, clock)  # a sensor that is wrong teaches nothing about mount and clock
            platform = outcome.solved.solution.state.platform
            self._times_s = float(platform[OFFSET]), float(platform[DELAY])
        self._see_with_estimate()
        return outcome.status

    def _begin_at(self, clock: ClockProfile) -> Status:
        """Begin again at the time offset that fits; all that windows found at another is forgotten."""
        offset_s, delay_s = self.times_s()
        self.refusal = f"attitudes fit at another time offset: {clock.best_s:+.2f} s, not {offset_s:+.2f}"
        self._forget_solutions()
        failing = replace(self.noise.failing, failures={})  # the clock contradicted, no sensor
        self.noise = replace(self.noise, failing=failing)
        if clock.rejects(float(self.alignment.platform.mean[OFFSET])):
            self.alignment.forget()
        self._times_s = clock.best_s, delay_s
        return Status.STARTING

    def solve(self) -> Status:
        """Prepare, adjust and adopt at once."""
        return self.adopt(adjust(self.prepare()))

    def _see_slope(self, solved: Solved) -> None:
        """Keep what the window that `prepare` asked for alone shows of the ground's slope."""
        request, layout = self._request, solved.layout
        if request.slope is None or not (request.terrain is None or request.is_terrain_left_out):
            return  # over a terrain model the plane is what that is off by
        start_ns, end_ns = self.keyframes[0].nav.stamp_ns, self.keyframes[-1].nav.stamp_ns
        state, covariance = solved.solution.state, solved.covariance_at((start_ns + end_ns) // 2)
        covariance = solved.variance_factor * covariance  # of (16.10): where a turn is known less, so is the slope
        shared = np.concatenate([state.platform, state.plane])
        slope, sigma2 = seen_alone(solved.known, shared, covariance[layout.shared, layout.shared])
        along = state.centres_enu_m[-1, :2] - state.centres_enu_m[0, :2]
        good = solved.good
        varies = slope_variance(state.points_enu_m[good], solved.solution.point_covariance[good, 2, 2], along)
        seen = SlopeSeen(end_ns, self._place_enu_m(), slope, sigma2, varies)
        self.ground_slope.newest = seen
        if len(self.keyframes) == self.config.solve.keyframes:
            self.ground_slope.offer(start_ns, seen)

    def learn(self, solved: Solved, clock: ClockProfile | None = None) -> None:
        """Offer a solved window's boresight and time offset as a posterior update."""
        if not with_attitude(self.keyframes).any() or stamp_sigma_s(self.keyframes):
            return
        mean, shared = solved.solution.state.platform, solved.layout.platform
        start, end = self.keyframes[0].nav.stamp_ns, self.keyframes[-1].nav.stamp_ns
        covariance = solved.covariance_at((start + end) // 2)[shared, shared]
        covariance[OFFSET, OFFSET] += LEAST_SIGMA_S**2
        before = self.alignment.prior_for(start)
        known, known_covariance = solved.known.mean[:-PLANE], solved.known.covariance[:-PLANE, :-PLANE]
        if RATES in solved.layout.blocks:
            mean, covariance = without_readout(mean, covariance, known, known_covariance)
        # The window's own information is added to the learned prior, which may be tighter: no delay is held open.
        gained = Information.gained(mean, covariance, known, known_covariance)
        if max(solved.mount_sigmas) > LIKELY_SIGMAS:  # less is noise, which must not unlearn what turns have taught
            before = before.with_mount_sigmas(solved.mount_sigmas)
        mean, covariance = gained.upon(before.mean, before.covariance)
        if clock is not None and covariance[OFFSET, OFFSET] < clock.variance:
            value_s = clock.mean_s if clock.is_wide else float(mean[OFFSET])
            mean, covariance = with_marginal(mean, covariance, OFFSET, value_s, clock.variance)
        self.alignment.offer(start, end, mean, covariance)

    def camera_found(self) -> tuple[Camera, Sigma]:
        """The camera as the flight found it, and one sigma of each of its states; the file's own if it has none."""
        platform = self.alignment.platform
        if len(platform.mean) == STATES:
            return self.camera_file, self.camera_file.sigma
        f, x, y, k1, k2 = platform.sigma[STATES:][:COUNT].tolist()
        return corrected(self.camera_file, platform.mean[STATES:]), (f, x, y, k1, k2)

    @property
    def readout(self) -> tuple[float, float]:
        """The readout time of the rows, as estimated now, and one sigma (s); 0 and 0 of a global shutter."""
        camera, platform = self.config.camera, self.alignment.platform
        return camera.readout_s + readout_s(platform.mean[STATES:]), readout_s(platform.sigma[STATES:])

    def _see_with_estimate(self) -> None:
        """Compute the keyframes' observations again if the estimate of the camera has changed. Equation (15.2)."""
        states = self.alignment.platform.mean[STATES:]
        if np.array_equal(states, self.camera_taken):
            return
        self.camera_taken, self.camera = states.copy(), corrected(self.camera_file, states)
        self.keyframes = [
            replace(k, observation=seen_with(self.camera, k.observation, self.readout[0])) for k in self.keyframes
        ]

    def conclude(self) -> None:
        """The end of a stretch: update the alignment from its last window even if it never filled."""
        if self.solved is not None and len(self.keyframes) == len(self.solved.keyframes) >= MIN_UPDATE:
            self.learn(self.solved)
