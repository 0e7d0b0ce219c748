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
    Home,
    NavEvent,
    PositionFix,
    RangeFinder,
    Zoom,
)
from onboard.navigation.attitude_interpolation import Attitudes, Orientation
from onboard.navigation.gimbal import Gimbal, MountHypothesis
from onboard.navigation.gps_integrity import GpsIntegrity, Refusal
from onboard.navigation.limits import LATE_NS, PATIENCE_NS, RECENT_NS
from onboard.navigation.position_interpolation import Displacement, Joined, Position
from onboard.navigation.time_series import Series

Array = NDArray[np.float64]

# So far from the origin the frame's up and the vertical differ by 0.2 degrees: level ground would slope in the frame.
FRAME_REACH_M = 20_000.0


@dataclass(frozen=True, eq=False)
class GroundRange:
    """The range finder's measurement: the vector (3,), ENU m, from vehicle to ground, and one sigma along it."""

    vector_enu_m: Array
    sigma_m: float


@dataclass(frozen=True, eq=False)
class NavState:
    """The vehicle at one exposure. Position and velocity in `Navigation.frame`, attitude in ENU axes at the vehicle.

    `velocity_enu_m_s` and `R_enu_body` are None where the log has none, or none near enough; `R_enu_body` also where
    `solve.attitude` is "none". `motion_enu_m_s` is the velocity, else that of the positions about it: an error of
    time moves the state along it; 0 where nothing is known. The sigmas are the receiver's claim for the Gauss-Markov
    error, bounded below by the configuration, and jumps that nothing has explained; `sigma_white_m` is the dispersion
    of positions about their own velocity, bounded likewise. `mount_hypotheses` holds R_enu_body by every mount
    hypothesis while more than one is possible. States of different `stretch` must not be compared: the position jumped,
    or the frame moved, between them. `stamp_sigma_s`: one sigma of the time it was asked for, beyond the time offset's
    own, common to all states that have it.
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
    path_velocity_enu_m_s: Array | None = None  # by the positions, where none is measured
    home_enu_m: Array | None = None  # where it was armed, if the autopilot states that

    @property
    def motion_enu_m_s(self) -> Array:
        """The velocity (3,): measured, else by the positions about it; 0 where nothing is known."""
        velocities = (self.velocity_enu_m_s, self.path_velocity_enu_m_s)
        return next((v for v in velocities if v is not None), np.zeros(3))


class Navigation:
    """Takes events in order of arrival and answers for any moment of the last two minutes."""

    def __init__(self, config: Config) -> None:
        self.config = config
        self.frame: LocalFrame | None = None
        self.reason: str = Refusal.NOTHING_YET  # why no position is accepted at present, for people; empty when one is
        self._integrity = GpsIntegrity(config)
        self._moves = 0  # of the frame
        self._undulation_m = float("nan") if config.gps.undulation_m is None else config.gps.undulation_m
        self._latency_ns = round(config.gps.latency_s * 1e9)
        self._yaw_sigma_rad = float(np.radians(config.mount.gimbal_yaw_sigma_deg))
        self._forget()
        # The accepted hypothesis of mount and gimbal; while that is open, the part that sees pictures decides.
        self.mount_hypothesis = MountHypothesis.GIMBAL if self.gimbal.is_certain else MountHypothesis.MOUNT

    def _forget(self) -> None:
        """Begin without any data, as where the clock was set back: nothing held can be compared any more."""
        max_gap_s = self.config.telemetry.max_attitude_gap_s
        self._fixes: Series[PositionFix] = Series()  # as they came; those in the frame, or all before there is one
        self._attitudes = Attitudes(max_gap_s)
        self.gimbal = Gimbal(self.config, self._attitudes)
        self._ranges: Series[RangeFinder] = Series(max_gap_s)
        self._home: Home | None = None
        self._integrity.forget()

    def add(self, event: NavEvent) -> None:
        """Take one event; events with a stamp already held are ignored, and so is what the lens does."""
        if isinstance(event, Zoom):
            return
        if isinstance(event, Home):
            self._home = event
            return
        stamps_ns = {
            PositionFix: self._fixes.stamps_ns,
            GpsQuality: self._integrity.quality.stamps_ns,
            FilterStatus: self._integrity.filter.stamps_ns,
            Attitude: self._attitudes.stamps_ns,
            GimbalAttitude: self.gimbal.attitudes.stamps_ns,
            RangeFinder: self._ranges.stamps_ns,
        }[type(event)]
        if stamps_ns and event.stamp_ns < stamps_ns[-1] - PATIENCE_NS:
            self._forget()
        match event:
            case PositionFix():
                self._add_position(event)
            case GpsQuality():
                self._add_quality(event)
            case FilterStatus():
                self._integrity.filter.insert(event.stamp_ns, event)
            case Attitude():
                rate = None if event.rate_body_rad_s is None else np.array(event.rate_body_rad_s)
                attitude = Orientation(matrix_from_quaternion(event.q_ned_body), rate)
                self._attitudes.insert(event.stamp_ns, attitude)
            case GimbalAttitude():
                self.gimbal.insert(event)
            case RangeFinder():
                self._ranges.insert(event.stamp_ns, event)
        if isinstance(event, PositionFix | GpsQuality | FilterStatus) and self.frame is None:
            self._place_frame(event.stamp_ns)
        newest_ns = self._integrity.positions.stamps_ns[-1:]
        if isinstance(event, GpsQuality | FilterStatus) and newest_ns:  # no picture may ask
            self.reason, _ = self._integrity.judge(newest_ns[0])

    def _add_quality(self, quality: GpsQuality) -> None:
        self._integrity.note_quality(quality)
        if quality.fix is not None and self.frame is not None:
            self._integrity.note_receiver_position(quality.fix.stamp_ns, self._in_frame(quality.fix))
        if quality.undulation_m is not None:
            self._undulation_m = quality.undulation_m

    def _add_position(self, fix: PositionFix) -> None:
        """Move the origin to an accepted position far from it; what pictures still wait for is kept if it is near."""
        if self._fixes.insert(fix.stamp_ns, fix) is None or self.frame is None:
            return
        if self._integrity.unfit or np.linalg.norm(self._enu(fix)) <= FRAME_REACH_M:
            self._insert(fix)
            return
        recent = self._fixes.between(fix.stamp_ns - PATIENCE_NS, fix.stamp_ns + PATIENCE_NS).values
        near = self._put_frame(fix, recent)
        self._moves += 1
        self._hold(near, None if len(near) == len(recent) > 1 else fix.stamp_ns)

    def _place_frame(self, now_ns: int) -> None:
        """Put the frame where the first accepted position is, once there is one."""
        if not self._fixes.stamps_ns:
            return
        accepted, self.reason = self._integrity.first_accepted(self._fixes, now_ns)
        if accepted:
            # Earlier positions may be compared with the newest only as far as the aircraft can have travelled since.
            near = self._put_frame(accepted[-1], accepted)
            self._put_frame(near[0], near)
            self._hold(near)

    def _put_frame(self, at: PositionFix, fixes: list[PositionFix]) -> list[PositionFix]:
        """Put the origin at a position; which of some are near it."""
        self.frame = LocalFrame(at.lat_deg, at.lon_deg, at.height_amsl_m)
        return [fix for fix in fixes if np.linalg.norm(self._enu(fix)) <= FRAME_REACH_M]

    def _hold(self, fixes: list[PositionFix], jumped_ns: int | None = None) -> None:
        """Begin with these in the frame as it now is."""
        self._fixes = Series()
        self._integrity.begin(jumped_ns)
        for fix in fixes:
            self._fixes.insert(fix.stamp_ns, fix)
            self._insert(fix)

    def _enu(self, fix: PositionFix | Home) -> Array:
        assert self.frame is not None
        return self.frame.to_enu(fix.lat_deg, fix.lon_deg, fix.height_amsl_m)

    def _insert(self, fix: PositionFix) -> None:
        self._integrity.note_position(fix.stamp_ns - self._latency_ns, self._in_frame(fix))

    def _in_frame(self, fix: PositionFix) -> Position:
        enu, velocity = self._enu(fix), None
        if fix.velocity_ned_m_s is not None:
            velocity = self._R_frame_ned(enu) @ np.nan_to_num(fix.velocity_ned_m_s)
            if not np.isfinite(fix.velocity_ned_m_s[2]):
                velocity[2] = np.nan
        return Position(enu, velocity, fix.height_above_home_m)

    def covers(self, stamp_ns: int, delay_ns: int = 0) -> bool:
        """Return whether waiting would not improve `state_at`: data after this moment has arrived.

        Attitude counts if the configuration uses it and any has been received; one that would come too late to be
        interpolated with is not awaited.
        """
        positions = self._integrity.positions
        if not positions.covers(stamp_ns + delay_ns):
            return False
        received_ns = positions.stamps_ns[-1] - LATE_NS
        needed = self.gimbal.needed(self._mount) if any(self.received) else []
        return all(held.covers(stamp_ns) or held.has_gap(stamp_ns, received_ns) for held in needed)

    @property
    def behind_ns(self) -> int:
        """The time after a moment until its telemetry has arrived, beyond any link's delay: latency and spacing."""
        positions_ns = self._integrity.positions.spacing_ns + max(self._latency_ns, 0)
        return max(positions_ns, self._attitudes.spacing_ns)

    @property
    def received(self) -> tuple[bool, bool]:
        """Two flags: usable attitudes of the vehicle, and of a gimbal, have been received."""
        if self.config.solve.attitude == "none":
            return False, False
        has_gimbal = self.config.mount.gimbal != "never" and bool(self.gimbal.attitudes.stamps_ns)
        return bool(self._attitudes.stamps_ns), has_gimbal

    @property
    def _mount(self) -> MountHypothesis:
        """The mount hypothesis in use: the accepted one, as far as attitudes for it have been received.

        A gimbal's attitude is used instead of a fixed mount's if it is certain, or the only one received.
        """
        if self.config.mount.gimbal == "never" or not self.gimbal.attitudes.stamps_ns:
            return MountHypothesis.MOUNT
        has_no_other = self.gimbal.is_certain or not self._attitudes.stamps_ns
        is_mount = self.mount_hypothesis is MountHypothesis.MOUNT
        return MountHypothesis.GIMBAL if is_mount and has_no_other else self.mount_hypothesis

    @property
    def _uses_gimbal(self) -> bool:
        return self._mount is not MountHypothesis.MOUNT

    def attitudes_at(self, moments_ns: Sequence[int], position_enu_m: Array) -> Array | None:
        """R_enu_body (N, 3, 3), as a state at this place would have it; None where one of them is not known."""
        if not any(self.received) or self.frame is None:
            return None
        found = []
        for moment_ns in moments_ns:
            R_ned_body = self.gimbal.at(moment_ns, self._mount)
            if isinstance(R_ned_body, Status):
                return None
            found.append(R_ned_body)
        return self._R_frame_ned(position_enu_m) @ np.stack(found)

    def state_at(
        self, stamp_ns: int, offset_s: float = 0.0, stamp_sigma_s: float = 0.0, delay_s: float = 0.0
    ) -> NavState | Status:
        """The vehicle at `stamp_ns` + `offset_s` (camera-to-autopilot time offset), or why not.

        Position and velocity are looked up `delay_s` later: they are older than their stamps.

        STARTING before the first data, UNSYNCHRONISED in a gap of the positions or past their end, NO_GPS where GPS is
        not accepted. In a gap of the attitudes the state has none: those about it have, and pictures join them.
        """
        moment_ns = stamp_ns + round(offset_s * 1e9)
        place_ns, positions = moment_ns + round(delay_s * 1e9), self._integrity.positions
        if not positions.stamps_ns:
            return Status.NO_GPS if self._integrity.unfit else Status.STARTING
        position = positions.at(place_ns)
        if isinstance(position, Status):
            return position
        self.reason, sigma_white_m = self._integrity.judge(moment_ns)
        if self.reason:
            return Status.NO_GPS
        R_enu_body, mount_hypotheses = None, {}
        if any(self.received):
            R_ned_body, R_frame_ned = self.gimbal.at(moment_ns, self._mount), self._R_frame_ned(position.enu_m)
            if not isinstance(R_ned_body, Status):
                R_enu_body = R_frame_ned @ R_ned_body
                mount_hypotheses = {h: R_frame_ned @ R for h, R in self.gimbal.open_at(moment_ns).items()}
        return NavState(
            stamp_ns,
            position.enu_m,
            position.velocity_enu_m_s,
            R_enu_body,
            *self._integrity.sigmas(moment_ns),
            sigma_white_m,
            self._undulation_m,
            position.height_above_home_m,
            self._range_at(moment_ns, position.enu_m) if self.config.range_finder.use else None,
            mount_hypotheses,
            self._moves + self._integrity.jumps.stretch_at(moment_ns),
            stamp_sigma_s,
            self._integrity.datum_sigma_m(moment_ns),
            0.0 if R_enu_body is None else self.gimbal.sigma_at(moment_ns, self._mount),
            0.0 if R_enu_body is None or not self._uses_gimbal else self._yaw_sigma_rad,
            self._integrity.velocity_claim_m_s(moment_ns),
            positions.joined_at(place_ns),
            None if position.velocity_enu_m_s is not None else positions.slope_at(place_ns, RECENT_NS // 2),
            None if self._home is None else self._enu(self._home),
        )

    def was_accepted(self, start_ns: int, end_ns: int) -> bool:
        """Return whether no position between two moments was refused; a gap in telemetry alone is no refusal."""
        gps, before_ns, next_ns = self.config.gps, start_ns, start_ns
        for stamp_ns in self._integrity.positions.between(start_ns + 1, end_ns - 1).stamps_ns:
            if stamp_ns - before_ns > gps.max_gap_s * 1e9:
                # The receiver's own report comes later than the first position after a gap.
                next_ns = stamp_ns + round(gps.quality_timeout_s * 1e9)
            before_ns = stamp_ns
            if stamp_ns >= next_ns and self._integrity.judge(stamp_ns)[0]:
                return False
        return True

    def _range_at(self, moment_ns: int, position_enu_m: Array) -> GroundRange | None:
        """The range finder between its messages about a moment; None without it, the vehicle's attitude or an echo."""
        settings = self.config.range_finder
        bracket, R_ned_body = self._ranges.joined(moment_ns), self._attitudes.at(moment_ns)
        if isinstance(bracket, Status) or isinstance(R_ned_body, Status):
            return None
        a, b = (self._ranges.values[i] for i in bracket)
        if a.direction_body != b.direction_body:
            return None
        distance_m = a.distance_m + self._ranges.share(*bracket, moment_ns) * (b.distance_m - a.distance_m)
        # Between two echoes the ground may do anything that the echoes differ by.
        sigma_m = max(settings.sigma_m, a.sigma_m or 0.0, b.sigma_m or 0.0) + settings.sigma_share * distance_m
        sigma_m = float(np.hypot(sigma_m, 0.5 * (b.distance_m - a.distance_m)))
        vector: Array = self._R_frame_ned(position_enu_m) @ R_ned_body @ np.array(a.direction_body) * distance_m
        return GroundRange(vector, sigma_m) if vector[2] < 0.0 else None

    def _R_frame_ned(self, position_enu_m: Array) -> Array:
        """North-east-down at a place -> the frame's east-north-up."""
        assert self.frame is not None
        lat, lon, _ = self.frame.to_geodetic(position_enu_m)
        return self.frame.R_enu_ecef @ rotation_enu_ecef(float(lat), float(lon)).T @ R_ENU_NED

    def body_rate_at(self, stamp_ns: int) -> Array | None:
        """Angular rate (3,), rad/s, axes of `NavState.R_enu_body`: measured, or from attitudes; None if unknown."""
        return self.gimbal.rate_at(stamp_ns, self._mount)

    def rate_sigma_at(self, stamp_ns: int, jitter_s: float) -> float | None:
        """One sigma (rad/s) of that rate, (1.8); None if it is not measured, but the difference of noisy attitudes."""
        return None if self._uses_gimbal else self._attitudes.rate_sigma_at(stamp_ns, jitter_s)

    def turned(self, start_ns: int, end_ns: int, white_rad: float) -> tuple[Array, float] | None:
        """The turn (3, 3) between two moments by the vehicle's rates alone, and one sigma (rad) of it, (1.10).

        Axes of `NavState.R_enu_body`; None where rates are not measured, or the camera is on a gimbal.
        """
        turn = None if self._uses_gimbal else self._attitudes.turned(start_ns, end_ns)
        return None if turn is None else (turn, self._attitudes.turned_sigma(start_ns, end_ns, white_rad))

    def displacement(self, start_ns: int, end_ns: int) -> Displacement | None:
        """Distance travelled by the velocities alone (trapezium rule); None where any is missing."""
        return self._integrity.positions.displacement(start_ns, end_ns)
