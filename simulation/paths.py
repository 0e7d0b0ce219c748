"""Described paths: an aircraft that steers through waypoints, crabs in the wind and is shaken a little.

East-north metres about the session's origin; the first picture is taken at time 0, the path starts MARGIN_S earlier.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from contract.errors import InputError
from contract.rotations import R_ENU_NED, matrix_from_euler
from simulation.trajectory import Trajectory

Array = NDArray[np.float64]

KINDS = ("straight", "turns", "hover", "orbit", "survey", "waypoints")
MARGIN_S = 5.0
STEP_S = 0.02
GRAVITY_M_S2 = 9.80665
WOBBLE_TONES = 6


@dataclass(frozen=True)
class PathSpec:
    """Motion over the ground. `crab_deg`: the nose points this much right of the direction of travel.

    `wobble_deg` is one sigma of roll and pitch and twice that of yaw; never more than three sigmas.
    `waypoints_m` (east, north) pairs serve the kind "waypoints"; the last leg continues for ever.
    """

    kind: str = "straight"
    speed_m_s: float = 20.0
    height_m: float = 250.0  # at time 0
    climb_m_s: float = 0.0
    heading_deg: float = 30.0
    crab_deg: float = 0.0
    pitch_deg: float = 2.0
    wobble_deg: float = 0.6
    bank_deg: float = 25.0
    leg_m: float = 400.0
    spacing_m: float = 150.0
    radius_m: float = 200.0
    waypoints_m: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise InputError(f"path {self.kind!r} is not known; use one of {', '.join(KINDS)}")
        if self.kind == "waypoints" and len(self.waypoints_m) < 2:
            raise InputError("path 'waypoints' needs at least two of them")
        lengths = (self.speed_m_s, self.height_m, self.leg_m, self.spacing_m, self.radius_m)
        if min(lengths) <= 0 or not 1.0 <= self.bank_deg <= 60.0 or not 0.0 <= self.wobble_deg <= 10.0:
            raise InputError(
                "path: speed, height, leg, spacing and radius must be positive, "
                "bank lie in 1..60 and wobble in 0..10 degrees"
            )


def fly_path(spec: PathSpec, seconds: float, seed: int) -> Trajectory:
    """True motion from -MARGIN_S to `seconds` + MARGIN_S."""
    time = np.arange(-MARGIN_S, seconds + MARGIN_S + STEP_S, STEP_S)
    rng = np.random.default_rng([seed, 404])
    if spec.kind == "hover":
        east_north = 0.4 * np.stack([disturbance(rng, time, 3.0, 12.0), disturbance(rng, time, 3.0, 12.0)], axis=1)
        track = np.full(len(time), np.radians(spec.heading_deg))
        bank = np.zeros(len(time))
    else:
        rate = gaussian_filter1d(_turn_rate(spec, time), 0.6 / STEP_S, mode="nearest")
        track = np.radians(spec.heading_deg) + np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1])) * STEP_S])
        velocity = spec.speed_m_s * np.stack([np.sin(track), np.cos(track)], axis=1)
        steps = 0.5 * (velocity[1:] + velocity[:-1]) * STEP_S
        east_north = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
        if spec.kind != "waypoints":
            east_north -= east_north[np.searchsorted(time, 0.5 * seconds)]
        else:
            east_north += spec.waypoints_m[0]
        bank = np.arctan(spec.speed_m_s * rate / GRAVITY_M_S2)
    up = spec.height_m + spec.climb_m_s * time + 0.5 * disturbance(rng, time, 8.0, 30.0)
    sigma = np.radians(spec.wobble_deg)
    roll = bank + sigma * disturbance(rng, time, 1.5, 9.0)
    pitch = np.radians(spec.pitch_deg) + sigma * disturbance(rng, time, 1.5, 9.0)
    yaw = track + np.radians(spec.crab_deg) + 2.0 * sigma * disturbance(rng, time, 3.0, 12.0)
    R_enu_body = R_ENU_NED @ matrix_from_euler(roll, pitch, yaw)
    return Trajectory(time, np.column_stack([east_north, up]), R_enu_body)


def disturbance(rng: np.random.Generator, time: Array, shortest_s: float, longest_s: float) -> Array:
    """A smooth random function of unit variance, bounded by 3, made of a few tones."""
    period = np.exp(rng.uniform(np.log(shortest_s), np.log(longest_s), WOBBLE_TONES))
    phase = rng.uniform(0.0, 2.0 * np.pi, WOBBLE_TONES)
    tones = np.sin(2.0 * np.pi * time[:, None] / period + phase)
    out: Array = np.clip(tones.sum(axis=1) * np.sqrt(2.0 / WOBBLE_TONES), -3.0, 3.0)
    return out


def _turn_rate(spec: PathSpec, time: Array) -> Array:
    """Rate of the track over the ground, rad/s, right positive."""
    fastest = GRAVITY_M_S2 * np.tan(np.radians(spec.bank_deg)) / spec.speed_m_s
    if spec.kind == "straight":
        return np.zeros(len(time))
    if spec.kind == "orbit":
        return np.full(len(time), spec.speed_m_s / spec.radius_m)
    if spec.kind == "waypoints":
        return _steer(spec, len(time), fastest)
    # A leg, a turn, a leg, a turn the other way. Survey turns go right round; the others a right angle.
    turn_rad = np.pi if spec.kind == "survey" else 0.5 * np.pi
    rate = min(fastest, 2.0 * spec.speed_m_s / spec.spacing_m) if spec.kind == "survey" else fastest
    leg_s, turn_s = spec.leg_m / spec.speed_m_s, turn_rad / rate
    cycle, within = np.divmod(time - time[0], leg_s + turn_s)
    return np.where(within < leg_s, 0.0, np.where(cycle % 2 == 0, rate, -rate))


def _steer(spec: PathSpec, steps: int, fastest: float) -> Array:
    """Turn towards each waypoint in turn, no faster than the bank allows."""
    points = np.asarray(spec.waypoints_m, float)
    place, target = points[0].copy(), 1
    track = np.radians(spec.heading_deg)
    rates = np.zeros(steps)
    for k in range(steps):
        to_go = points[target] - place
        if np.hypot(*to_go) < spec.speed_m_s * 1.5 and target < len(points) - 1:
            target += 1
            to_go = points[target] - place
        passed = target == len(points) - 1 and np.hypot(*to_go) < spec.speed_m_s * 1.5
        if not passed and not (target == len(points) - 1 and rates[k - 1] == 0.0 and _is_behind(to_go, track)):
            error = (np.arctan2(to_go[0], to_go[1]) - track + np.pi) % (2.0 * np.pi) - np.pi
            rates[k] = np.clip(0.8 * error, -fastest, fastest)
        track += rates[k] * STEP_S
        place += spec.speed_m_s * STEP_S * np.array([np.sin(track), np.cos(track)])
    return rates


def _is_behind(to_go: Array, track: float) -> bool:
    return bool(to_go[0] * np.sin(track) + to_go[1] * np.cos(track) < 0.0)
