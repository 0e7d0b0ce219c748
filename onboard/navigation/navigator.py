"""Fixes and attitudes -> position, velocity and attitude at an exposure, or the reason why there is none.

How they are joined is in `position_interpolation` and `attitude_interpolation`, whether a position is accepted in
`gps_integrity`.

The local frame lies where the first accepted position is, and moves to an accepted position that is far from it: what
an autopilot reports before its receiver has a fix is not a position (ArduPilot sends 0.0003 N 0.0001 W).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from contract.feature_set import Status
from contract.geodesy import LocalFrame, rotation_enu_ecef
from contract.rotations import R_ENU_NED, matrix_from_quaternion
from onboard.config.schema import Config
from onboard.events.types import (
    Attitude,
    FilterStatus,
    GimbalAttitude,
    GpsQuality,
    NavEvent,
    PositionFix,
    RangeFinder,
    Zoom,
)
from onboard.navigation.attitude_interpolation import Attitudes
from onboard.navigation.gimbal import Gimbal, MountHypothesis
from onboard.navigation.gps_integrity import GpsIntegrity, Refusal
from onboard.navigation.limits import PATIENCE_NS, RECENT_NS
from onboard.navigation.position_interpolation import Displacement, Joined, Path, Position, finite
from onboard.navigation.time_series import Series

Array = NDArray[np.float64]

# From its origin the frame's up and the vertical differ by 0.2 degrees here; ground taken for level in it would slope.
FRAME_REACH_M = 20_000.0


@dataclass(frozen=True, eq=False)
class GroundRange:
    """What the range finder measures: the vector (3,), ENU m, from vehicle to ground, and one sigma along it."""

    vector_enu_m: Array
    sigma_m: float


@dataclass(frozen=True, eq=False)
class NavState:
    """The vehicle at one exposure. Position and velocity in `Navigation.frame`, attitude in ENU axes at the vehicle.

    `velocity_enu_m_s` and `R_enu_body` are None where the log has none; `R_enu_body` also where `solve.attitude` is
    "none". The sigmas are the receiver's claim for the Gauss-Markov error, bounded below by the configuration, and
    jumps that nothing has explained; `sigma_white_m` is the dispersion of positions about their own velocity, bounded
    likewise. `mount_hypotheses` holds R_enu_body by every mount hypothesis while more than one is possible. States of
    different `stretch` must not be compared: the position jumped, or the frame moved, between them. `stamp_sigma_s`:
    one sigma of the time it was asked for, beyond the time offset's own, common to all states that have it.
    """

    stamp_ns: int
    position_enu_m: Array
    velocity_enu_m_s: Array | None
    R_enu_body: Array | None
    sigma_horizontal_m: float
    sigma_vertical_m: float
    sigma_white_m: float
    undulation_m: float
    height_above_home_m: float | None
    ground_range: GroundRange | None = None
    mount_hypotheses: Mapping[MountHypothesis, Array] = field(default_factory=dict)
    stretch: int = 0
    stamp_sigma_s: float = 0.0
    sigma_datum_m: float = 0.0  # of all heights as a whole: where the log counts them from
    attitude_sigma_rad: float = 0.0  # of the attitude, because its messages come more slowly than the vehicle turns
    yaw_sigma_rad: float = 0.0  # of the yaw as a whole, where a gimbal's counts from nowhere
    sigma_velocity_m_s: float = 0.0  # of the velocity, as the receiver or the filter claims; 0: neither does
    joined: Joined = field(default_factory=Joined)  # from which positions


class Navigation:
    """Fed with events in order of arrival; answers for any moment of the last two minutes."""

    def __init__(self, config: Config) -> None:
        self.config = config
        self.frame: LocalFrame | None = None
        self.reason: str = Refusal.NOTHING_YET  # why no position is accepted at present, for people; empty when one is
        self._fixes: Series[PositionFix] = Series()  # as they came; those of `_positions`, or all before a frame is
        self._positions: Series[Position] = Series()
        self._integrity = GpsIntegrity(config)
        self._moves = 0  # of the frame
        self._attitudes = Attitudes(config.telemetry.max_attitude_gap_s)
        self.gimbal = Gimbal(config)
        # Which hypothesis of mount and gimbal is accepted; where that is open, the part that sees pictures decides.
        self.mount_hypothesis = MountHypothesis.GIMBAL if self.gimbal.is_certain else MountHypothesis.MOUNT
        self._ranges: Series[RangeFinder] = Series()
        self._undulation_m = float("nan") if config.gps.undulation_m is None else config.gps.undulation_m
        self._latency_ns = round(config.gps.latency_s * 1e9)
        self._yaw_sigma_rad = float(np.radians(config.mount.gimbal_yaw_sigma_deg))

    def add(self, event: NavEvent) -> None:
        """Take one event; events with a stamp already held are ignored, and so is what the lens does."""
        if isinstance(event, Zoom):
            return
        stamps_ns, take = {
            PositionFix: (self._fixes.stamps_ns, self._add_position),
            GpsQuality: (self._integrity.quality.stamps_ns, self._add_quality),
            FilterStatus: (self._integrity.filter.stamps_ns, self._integrity.note_filter),
            Attitude: (self._attitudes.stamps_ns, self._add_attitude),
            GimbalAttitude: (self.gimbal.stamps_ns, self.gimbal.insert),
            RangeFinder: (self._ranges.stamps_ns, self._add_range),
        }[type(event)]
        if stamps_ns and event.stamp_ns < stamps_ns[-1] - PATIENCE_NS:
            self._forget()  # the clock was set back: nothing held can be compared any more
        take(event)  # type: ignore[operator]
        if isinstance(event, PositionFix | GpsQuality | FilterStatus):
            if self.frame is None:
                self._place_frame(event.stamp_ns)
            if not isinstance(event, PositionFix):
                self._judge_now()

    def _add_quality(self, quality: GpsQuality) -> None:
        self._integrity.note_quality(quality)
        if quality.undulation_m is not None:
            self._undulation_m = quality.undulation_m

    def _add_attitude(self, attitude: Attitude) -> None:
        rate = None if attitude.rate_body_rad_s is None else np.array(attitude.rate_body_rad_s)
        self._attitudes.insert(attitude.stamp_ns, matrix_from_quaternion(attitude.q_ned_body), rate)

    def _add_range(self, distance: RangeFinder) -> None:
        self._ranges.insert(distance.stamp_ns, distance)

    def _forget(self) -> None:
        self._fixes, self._positions, self._ranges = Series(), Series(), Series()
        self._integrity.forget()
        self._integrity.positions = self._positions
        self._attitudes.forget()
        self.gimbal.forget()

    def _add_position(self, fix: PositionFix) -> None:
        if self._fixes.insert(fix.stamp_ns, fix) is None or self.frame is None:
            return
        is_believed = not self._integrity.is_unfit_now
        if is_believed and np.linalg.norm(self._enu(fix)) > FRAME_REACH_M:
            self._move_frame(fix)
        else:
            self._insert(fix)

    def _enu(self, fix: PositionFix) -> Array:
        assert self.frame is not None
        return self.frame.to_enu(fix.lat_deg, fix.lon_deg, fix.height_amsl_m)

    def _insert(self, fix: PositionFix) -> None:
        assert self.frame is not None
        velocity = None
        if fix.velocity_ned_m_s is not None:
            R_frame_here = self.frame.R_enu_ecef @ rotation_enu_ecef(fix.lat_deg, fix.lon_deg).T
            velocity = R_frame_here @ (R_ENU_NED @ finite(np.array(fix.velocity_ned_m_s)))
            if not np.isfinite(fix.velocity_ned_m_s[2]):
                velocity[2] = np.nan
        position = Position(self._enu(fix), velocity, fix.height_above_home_m)
        index = self._positions.insert(fix.stamp_ns - self._latency_ns, position)
        if index is not None:
            self._integrity.note_position(index)

    def _place_frame(self, now_ns: int) -> None:
        """Put the frame where the first accepted position is, once there is one."""
        if not self._fixes.stamps_ns:
            return
        since_ns, self.reason = self._integrity.first_estimate(self._fixes.stamps_ns[0], now_ns)
        if since_ns is None:
            return
        accepted = [fix for fix in self._fixes.values if fix.stamp_ns > since_ns]
        if not accepted:
            self.reason = Refusal.RECOVERING
            return
        newest = accepted[-1]
        self.frame = LocalFrame(newest.lat_deg, newest.lon_deg, newest.height_amsl_m)
        near = [fix for fix in accepted if np.linalg.norm(self._enu(fix)) <= FRAME_REACH_M]
        # What came before may be compared with the newest only as far as the aircraft can have travelled since.
        first = near[0]
        self.frame = LocalFrame(first.lat_deg, first.lon_deg, first.height_amsl_m)
        self._hold(near)

    def _move_frame(self, fix: PositionFix) -> None:
        """Move the origin to an accepted position far from it; what pictures still wait for is kept if it is near."""
        recent = [f for f in self._fixes.values if abs(f.stamp_ns - fix.stamp_ns) <= PATIENCE_NS]
        self.frame = LocalFrame(fix.lat_deg, fix.lon_deg, fix.height_amsl_m)
        self._moves += 1
        near = [held for held in recent if np.linalg.norm(self._enu(held)) <= FRAME_REACH_M]
        is_one_path = len(near) == len(recent) > 1
        self._hold(near, None if is_one_path else fix.stamp_ns)

    def _hold(self, fixes: list[PositionFix], jumped_ns: int | None = None) -> None:
        self._fixes, self._positions = Series(), Series()
        self._integrity.begin(self._positions, jumped_ns)
        for fix in fixes:
            self._fixes.insert(fix.stamp_ns, fix)
            self._insert(fix)

    def _judge_now(self) -> None:
        """Bring `reason` up to date where no picture asks."""
        if self.frame is not None and self._positions.stamps_ns:
            newest_ns = self._positions.stamps_ns[-1]
            self.reason = self._integrity.fault_at(newest_ns, self._integrity.slip_at(newest_ns))

    def covers(self, stamp_ns: int, delay_ns: int = 0) -> bool:
        """Whether `state_at` can do no better by waiting: data after this moment has arrived.

        Attitude counts if the configuration uses it and any has been seen.
        """
        needed: list[list[int]] = []
        if self._wants_attitude:
            needed += self.gimbal.needed(self._attitudes) if self._uses_gimbal else [self._attitudes.stamps_ns]
        positions, moment_ns = self._positions.stamps_ns, stamp_ns + delay_ns
        return bool(positions and positions[0] <= moment_ns <= positions[-1]) and all(
            stamps and stamps[0] <= stamp_ns <= stamps[-1] for stamps in needed
        )

    @property
    def _wants_attitude(self) -> bool:
        known = bool(self._attitudes.stamps_ns) or self._uses_gimbal
        return self.config.solve.attitude == "autopilot" and known

    @property
    def behind_ns(self) -> int:
        """How long after a moment what it is joined by comes, beyond what any link takes: latency and spacing."""
        positions_ns = self._positions.spacing_ns(self.config.gps.max_gap_s) + max(self._latency_ns, 0)
        return max(positions_ns, self._attitudes.spacing_ns)

    @property
    def received(self) -> tuple[bool, bool]:
        """Whether there are attitudes of the vehicle, and of a gimbal, that may be used."""
        if self.config.solve.attitude == "none":
            return False, False
        return bool(self._attitudes.stamps_ns), self.config.mount.gimbal != "never" and bool(self.gimbal.stamps_ns)

    @property
    def _carrier(self) -> MountHypothesis:
        """Whose attitude the camera's is: the hypothesis that is accepted, as far as it has sent any."""
        if self.config.mount.gimbal == "never" or not self.gimbal.stamps_ns:
            return MountHypothesis.MOUNT
        has_no_other = self.gimbal.is_certain or not self._attitudes.stamps_ns
        is_mount = self.mount_hypothesis is MountHypothesis.MOUNT
        return MountHypothesis.GIMBAL if is_mount and has_no_other else self.mount_hypothesis

    @property
    def _uses_gimbal(self) -> bool:
        return self._carrier is not MountHypothesis.MOUNT

    def _attitude_at(self, moment_ns: int, hypothesis: MountHypothesis | None = None) -> Array | Status:
        """R_ned_body as the mount sees it: with a gimbal, of the body that would carry a fixed camera the same way."""
        hypothesis = hypothesis or self._carrier
        if hypothesis is MountHypothesis.MOUNT:
            return self._attitudes.at(moment_ns)
        return self.gimbal.at(moment_ns, self._attitudes, hypothesis)

    def attitudes_at(self, moments_ns: Sequence[int], position_enu_m: Array) -> Array | None:
        """R_enu_body (N, 3, 3), as a state at this place would have it; None where one of them is not known."""
        if not self._wants_attitude or self.frame is None:
            return None
        found = [self._attitude_at(moment_ns) for moment_ns in moments_ns]
        known = [R for R in found if not isinstance(R, Status)]
        return self._R_frame_ned(position_enu_m) @ np.stack(known) if len(known) == len(found) else None

    def _mount_hypotheses_at(self, moment_ns: int, R_frame_ned: Array) -> dict[MountHypothesis, Array]:
        """R_enu_body by every hypothesis, where more than one is possible; the mount first, for where others agree."""
        if not (self.gimbal.is_open and self._attitudes.stamps_ns):
            return {}
        found = {c: self._attitude_at(moment_ns, c) for c in (MountHypothesis.MOUNT, *self.gimbal.readings)}
        return {c: R_frame_ned @ R for c, R in found.items() if not isinstance(R, Status)}

    def state_at(
        self, stamp_ns: int, offset_s: float = 0.0, stamp_sigma_s: float = 0.0, delay_s: float = 0.0
    ) -> NavState | Status:
        """The vehicle at `stamp_ns` + `offset_s` (camera-to-autopilot time offset), or why not.

        Position and velocity are looked up `delay_s` later: they are older than their stamps.

        STARTING before the first data, UNSYNCHRONISED in a gap or past the end, NO_GPS where GPS is not accepted.
        """
        moment_ns = stamp_ns + round(offset_s * 1e9)
        if self.frame is None or not self._positions.stamps_ns:
            return Status.NO_GPS if self._integrity.is_unfit_now else Status.STARTING
        position = self._path.at(moment_ns + round(delay_s * 1e9))
        if isinstance(position, Status):
            return position
        slip = self._integrity.slip_at(moment_ns)
        self.reason = self._integrity.fault_at(moment_ns, slip)
        if self.reason:
            return Status.NO_GPS
        R_enu_body, mount_hypotheses = None, {}
        if self._wants_attitude:
            R_ned_body, R_frame_ned = self._attitude_at(moment_ns), self._R_frame_ned(position.enu_m)
            if isinstance(R_ned_body, Status):
                return R_ned_body
            R_enu_body = R_frame_ned @ R_ned_body
            mount_hypotheses = self._mount_hypotheses_at(moment_ns, R_frame_ned)
        return NavState(
            stamp_ns,
            position.enu_m,
            position.velocity_enu_m_s,
            R_enu_body,
            *self._integrity.sigmas(moment_ns),
            max(self.config.gps.sigma_white_m, min(slip.dispersion_m, self.config.gps.glitch_m)),
            self._undulation_m,
            position.height_above_home_m,
            self._range_at(moment_ns, position.enu_m),
            mount_hypotheses,
            self._moves + self._integrity.stretch_at(moment_ns),
            stamp_sigma_s,
            self._integrity.datum_sigma_m(moment_ns),
            0.0 if R_enu_body is None or self._uses_gimbal else self._attitudes.sigma_at(moment_ns),
            self._yaw_sigma_rad if R_enu_body is not None and self._uses_gimbal else 0.0,
            self._integrity.velocity_claim_m_s(moment_ns),
            self._path.joined_at(moment_ns + round(delay_s * 1e9)),
        )

    def was_believed(self, start_ns: int, end_ns: int) -> bool:
        """Whether no position between two moments was refused; a gap in telemetry alone is no reason to refuse them."""
        return self._integrity.was_believed(start_ns, end_ns)

    def _range_at(self, moment_ns: int, position_enu_m: Array) -> GroundRange | None:
        """The range finder between its messages about a moment; None without it, the vehicle's attitude or an echo."""
        settings = self.config.range_finder
        if not (settings.use and self._ranges.stamps_ns and self._attitudes.stamps_ns):
            return None
        bracket = self._ranges.joined(moment_ns, self.config.telemetry.max_attitude_gap_s)
        R_ned_body = self._attitudes.at(moment_ns)
        if isinstance(bracket, Status) or isinstance(R_ned_body, Status):
            return None
        a, b = (self._ranges.values[i] for i in bracket)
        if a.direction_body != b.direction_body:
            return None
        share = (moment_ns - a.stamp_ns) / (b.stamp_ns - a.stamp_ns) if a is not b else 0.0
        distance_m = a.distance_m + share * (b.distance_m - a.distance_m)
        # Between two echoes the ground may do anything that the echoes differ by.
        sigma_m = max(settings.sigma_m, a.sigma_m or 0.0, b.sigma_m or 0.0) + settings.sigma_share * distance_m
        sigma_m = float(np.hypot(sigma_m, 0.5 * (b.distance_m - a.distance_m)))
        vector: Array = self._R_frame_ned(position_enu_m) @ R_ned_body @ np.array(a.direction_body) * distance_m
        return GroundRange(vector, sigma_m) if vector[2] < 0.0 else None

    def _R_frame_ned(self, position_enu_m: Array) -> Array:
        """North-east-down at a place -> the frame's east-north-up."""
        assert self.frame is not None
        lat, lon, _ = self.frame.to_geodetic(position_enu_m)
        out: Array = self.frame.R_enu_ecef @ rotation_enu_ecef(float(lat), float(lon)).T @ R_ENU_NED
        return out

    def body_rate_at(self, stamp_ns: int) -> Array | None:
        """Angular rate (3,), rad/s, axes of `NavState.R_enu_body`: measured, or from attitudes; None if unknown."""
        if self._uses_gimbal:
            return self.gimbal.rate_at(stamp_ns, self._attitudes, self._carrier)
        return self._attitudes.rate_at(stamp_ns)

    def rate_sigma_at(self, stamp_ns: int, jitter_s: float) -> float | None:
        """One sigma (rad/s) of that rate, (1.8); None if it is not measured, but the difference of noisy attitudes."""
        return None if self._uses_gimbal else self._attitudes.rate_sigma_at(stamp_ns, jitter_s)

    def velocity_at(self, nav: NavState) -> Array:
        """Velocity (3,), ENU m/s, of a state: measured, else by the positions about it; 0 where nothing is known."""
        known, bracket = nav.velocity_enu_m_s, self._positions.bracket(nav.stamp_ns)
        if bracket is None or (known is not None and np.all(np.isfinite(known))):
            return np.zeros(3) if known is None else known
        return self._path.velocity(bracket[0], RECENT_NS // 2)

    def displacement(self, start_ns: int, end_ns: int) -> Displacement | None:
        """Distance travelled by the velocities alone (trapezium rule); None where any is missing."""
        return self._path.displacement(start_ns, end_ns)

    @property
    def _path(self) -> Path:
        return Path(self._positions, self.config.gps.max_gap_s)
