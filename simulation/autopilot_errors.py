"""Errors of a navigation filter's position, velocity and attitude beyond noise, as recordings of real ones show them.

A filter whose GPS delay is not what it assumes lags along its path (a turn it keeps in time, by its inertial
sensors) and its velocity lags by less; its level is trimmed wrong and tilts with acceleration; its heading is wrong by
an amount that depends on the heading (soft and hard iron) and drifts; its velocity's error grows with acceleration; it
follows a GPS glitch. `simulation.ordinary` samples all of these as they were measured.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contract.errors import InputError
from contract.rotations import R_ENU_NED, exp_so3
from simulation.trajectory import Trajectory

Array = NDArray[np.float64]

SLOW_STEP_S = 0.05
ACCELERATION_STEP_S = 0.25


@dataclass(frozen=True)
class AutopilotErrors:
    """One flight's; none by default. Slow parts are Ornstein-Uhlenbeck, given by one sigma and correlation time.

    `position_lag_s`: the position is this much of the velocity behind; negative, ahead. `velocity_lag_s`: the velocity
    this much of the acceleration. `trim_deg`: roll and pitch, constant. `tilt_per_m_s2_deg`: roll by acceleration to
    the right, pitch by acceleration ahead. Heading (right positive) is off by `heading_deg` + `heading_cos_deg`
    cos(heading) + `heading_sin_deg` sin(heading) + drift. `velocity_per_m_s2`: one sigma of velocity per acceleration.
    The glitch: the receiver's position moves by `glitch_m` (east, north, up) for `glitch_s`, from `glitch_start_share`
    of the flight on; the filter follows with the time constant `glitch_follow_s`, and shows `glitch_in_velocity` of
    that motion in its velocity.
    """

    position_lag_s: float = 0.0
    velocity_lag_s: float = 0.0
    trim_deg: tuple[float, float] = (0.0, 0.0)
    tilt_deg: float = 0.0
    tilt_time_s: float = 20.0
    tilt_per_m_s2_deg: tuple[float, float] = (0.0, 0.0)
    heading_deg: float = 0.0
    heading_cos_deg: float = 0.0
    heading_sin_deg: float = 0.0
    heading_drift_deg: float = 0.0
    heading_time_s: float = 60.0
    velocity_m_s: float = 0.0
    velocity_per_m_s2: float = 0.0
    velocity_time_s: float = 2.0
    glitch_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    glitch_start_share: float = 0.5
    glitch_s: float = 10.0
    glitch_follow_s: float = 2.0
    glitch_in_velocity: float = 0.3

    def __post_init__(self) -> None:
        if min(self.tilt_time_s, self.heading_time_s, self.velocity_time_s, self.glitch_follow_s) <= 0.0:
            raise InputError("autopilot errors: time constants must be positive")


class ErringFilter:
    """The errors along one flight; the same seed gives the same errors."""

    def __init__(self, errors: AutopilotErrors, trajectory: Trajectory, seed: int) -> None:
        self._errors, self._trajectory = errors, trajectory
        start, end = trajectory.start_s, trajectory.end_s
        rng = np.random.default_rng([seed, 606])
        self._tilt = SlowError(rng, start, end, errors.tilt_time_s)
        self._drift = SlowError(rng, start, end, errors.heading_time_s)
        self._velocity = SlowError(rng, start, end, errors.velocity_time_s)
        self._glitch_start_s = start + errors.glitch_start_share * (end - start)

    def acceleration_m_s2(self, time_s: Array) -> Array:
        """(N, 3) ENU, over half a second."""
        start, end = self._trajectory.start_s, self._trajectory.end_s
        before, after = (np.clip(time_s + h, start, end) for h in (-ACCELERATION_STEP_S, ACCELERATION_STEP_S))
        gained = self._trajectory.velocity_enu_m_s(after) - self._trajectory.velocity_enu_m_s(before)
        return gained / (after - before)[:, None]

    def position_m(self, time_s: Array) -> Array:
        """The error of the filter's position (N, 3), ENU."""
        return self._followed(time_s)[0] - self._errors.position_lag_s * self._trajectory.velocity_enu_m_s(time_s)

    def velocity_m_s(self, time_s: Array) -> Array:
        """The error of the filter's velocity (N, 3), ENU."""
        e, acceleration = self._errors, self.acceleration_m_s2(time_s)
        sigma = np.hypot(e.velocity_m_s, e.velocity_per_m_s2 * np.linalg.norm(acceleration, axis=1))
        out: Array = sigma[:, None] * self._velocity(time_s) - e.velocity_lag_s * acceleration
        out += e.glitch_in_velocity * self._followed(time_s)[1]
        return out

    def receiver_m(self, time_s: Array) -> Array:
        """The error of the receiver's own position (N, 3), ENU: a glitch, from one message to the next."""
        since = time_s - self._glitch_start_s
        out: Array = ((since >= 0.0) & (since < self._errors.glitch_s))[:, None] * np.array(self._errors.glitch_m)
        return out

    def attitude(self, time_s: Array, R_ned_body: Array) -> Array:
        """Attitudes (N, 3, 3) as the filter has them."""
        e = self._errors
        nose = R_ned_body[:, :2, 0] / np.linalg.norm(R_ned_body[:, :2, 0], axis=1, keepdims=True)
        ned = self.acceleration_m_s2(time_s) @ R_ENU_NED
        ahead = ned[:, 0] * nose[:, 0] + ned[:, 1] * nose[:, 1]
        right = ned[:, 1] * nose[:, 0] - ned[:, 0] * nose[:, 1]
        tilt = np.array([*e.trim_deg, 0.0]) + e.tilt_deg * self._tilt(time_s) * [1.0, 1.0, 0.0]
        tilt[:, 0] += e.tilt_per_m_s2_deg[0] * right
        tilt[:, 1] += e.tilt_per_m_s2_deg[1] * ahead
        heading = e.heading_deg + nose @ [e.heading_cos_deg, e.heading_sin_deg]
        heading = heading + e.heading_drift_deg * self._drift(time_s)[:, 0]
        turn = exp_so3(np.radians(heading)[:, None] * [0.0, 0.0, 1.0])
        return turn @ R_ned_body @ exp_so3(np.radians(tilt))

    def _followed(self, time_s: Array) -> tuple[Array, Array]:
        """The filter's response to the glitch: how far it has followed (N, 3), m, and how fast it does, m/s."""
        e = self._errors
        since = time_s - self._glitch_start_s
        there = np.where(since > 0.0, 1.0 - np.exp(-np.maximum(since, 0.0) / e.glitch_follow_s), 0.0)
        back = since - e.glitch_s
        returned = np.where(back > 0.0, 1.0 - np.exp(-np.maximum(back, 0.0) / e.glitch_follow_s), 0.0)
        share = there - returned
        rate = ((since > 0.0) * (1.0 - there) - (back > 0.0) * (1.0 - returned)) / e.glitch_follow_s
        return np.outer(share, e.glitch_m), np.outer(rate, e.glitch_m)


class SlowError:
    """Three independent Ornstein-Uhlenbeck processes of unit variance, interpolated: time (N,) -> (N, 3)."""

    def __init__(self, rng: np.random.Generator, start_s: float, end_s: float, time_constant_s: float) -> None:
        self._time = np.arange(start_s, end_s + SLOW_STEP_S, SLOW_STEP_S)
        keep = float(np.exp(-SLOW_STEP_S / time_constant_s))
        push = np.sqrt(1.0 - keep * keep) * rng.standard_normal((len(self._time), 3))
        state = rng.standard_normal(3)
        self._values = np.empty((len(self._time), 3))
        for k in range(len(self._time)):
            self._values[k] = state
            state = keep * state + push[k]

    def __call__(self, time_s: Array) -> Array:
        """Values (N, 3) at times (N,)."""
        return np.stack([np.interp(time_s, self._time, column) for column in self._values.T], axis=1)
