"""The camera's time offset from rotations alone: right where turns show it, silent where they do not."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from contract.rotations import R_ENU_NED, exp_so3, matrix_from_euler, mount_rotation
from onboard.estimation.rotation_timing import FEATURES, Course, Pair, Timing, timing
from tests.rest_long import rest_long

Array = NDArray[np.float64]

STEP_NS = 50_000_000
EPOCH_NS = 1_795_217_000_000_000_000
R_BODY_CAM = mount_rotation(0.0, -90.0, 0.0)  # looks down
SPEED_M_S, HEIGHT_M, G = 20.0, 100.0, 9.81
SIGMA_RAD = np.radians(0.3)
FOCAL_PX, SIGMA_PX = 800.0, 0.3
TURNS = tuple((4.0 + 8.0 * k, (-1) ** k * 40.0) for k in range(4))  # begins at, bank in degrees


class Flight:
    """Coordinated turns: rolls in, holds the bank for three seconds, rolls out."""

    def __init__(self, turns: tuple[tuple[float, float], ...], roll_s: float = 1.2) -> None:
        self.time_s = np.arange(-2.0, 42.0, 0.01)
        bank = np.zeros(len(self.time_s))
        for begin, degrees in turns:
            rise = np.clip((self.time_s - begin) / roll_s, 0.0, 1.0)
            fall = np.clip((self.time_s - begin - 3.0) / roll_s, 0.0, 1.0)
            smooth = rise**2 * (3 - 2 * rise) - fall**2 * (3 - 2 * fall)
            bank += np.radians(degrees) * smooth
        heading = np.cumsum(G * np.tan(bank) / SPEED_M_S) * 0.01
        self.bank, self.heading = bank, heading
        self.velocity = SPEED_M_S * np.stack([np.sin(heading), np.cos(heading), np.zeros(len(bank))], axis=1)
        self.place = np.cumsum(self.velocity, axis=0) * 0.01 + [0.0, 0.0, HEIGHT_M]

    def at(self, t: float) -> tuple[Array, Array, Array]:
        """R_enu_body, velocity and position."""
        roll, heading = (float(np.interp(t, self.time_s, x)) for x in (self.bank, self.heading))
        v, p = (np.array([np.interp(t, self.time_s, x[:, i]) for i in range(3)]) for x in (self.velocity, self.place))
        return R_ENU_NED @ matrix_from_euler(roll, 0.0, heading), v, p

    def course(self, rng: np.random.Generator, sigma_rad: float, heading_error_rad: float = 0.0) -> Course:
        """What the autopilot says, with white errors from step to step and a compass that is off."""
        times = np.arange(-1.5, 41.5, STEP_NS / 1e9)
        R, v = [], []
        for t in times:
            R_enu_body, velocity, _ = self.at(float(t))
            error = exp_so3(np.array([0.0, 0.0, -heading_error_rad]))
            R.append(error @ exp_so3(sigma_rad * rng.standard_normal(3)) @ R_enu_body @ R_BODY_CAM)
            v.append(velocity)
        start_ns = EPOCH_NS + round(float(times[0]) * 1e9)
        return Course(start_ns, STEP_NS, np.array(R), np.array(v), np.zeros(len(times)))

    def pairs(
        self, rng: np.random.Generator, offset_s: float, mount_rad: Array, wrong: float = 0.0, until_s: float = 40.0
    ) -> list[Pair]:
        """Pictures each half second whose stamps are `offset_s` before their exposures by the autopilot's clock."""
        out = []
        for t in np.arange(1.0, until_s, 0.5):
            (R1, _, C1), (R2, _, C2) = (self.at(float(s)) for s in (t, t + 0.5))
            cam1, cam2 = (R @ R_BODY_CAM @ exp_so3(mount_rad) for R in (R1, R2))
            x1 = np.concatenate([rng.uniform(-0.35, 0.35, (FEATURES, 2)), np.ones((FEATURES, 1))], axis=1)
            d = x1 @ cam1.T
            points = C1 + d * (-(C1[2] - 3.0 * rng.standard_normal(FEATURES)) / d[:, 2])[:, None]
            p2 = (points - C2) @ cam2
            x2 = p2 / p2[:, 2:]
            for x in (x1, x2):
                x[:, :2] += SIGMA_PX / FOCAL_PX * rng.standard_normal((FEATURES, 2))
            bad = rng.uniform(size=FEATURES) < wrong
            x2[bad, :2] += 0.05 * rng.standard_normal((np.count_nonzero(bad), 2))
            seen = (p2[:, 2] > 1.0) & (np.abs(x2[:, :2]).max(axis=1) < 0.5)
            stamps = [EPOCH_NS + round((float(s) - offset_s) * 1e9) for s in (t, t + 0.5)]
            if np.count_nonzero(seen) >= 12:
                out.append(Pair(stamps[0], stamps[1], x1, x2, np.where(seen, FOCAL_PX / SIGMA_PX, 0.0)))
        return out


def estimate(
    offset_s: float,
    seed: int = 0,
    turns: tuple[tuple[float, float], ...] = TURNS,
    wrong: float = 0.03,
    attitude_rad: float = np.radians(0.1),
    until_s: float = 40.0,
) -> Timing | None:
    rng = np.random.default_rng(seed)
    flight = Flight(turns)
    mount_rad = np.radians([2.0, 1.5, -1.0])
    pairs = flight.pairs(rng, offset_s, mount_rad, wrong, until_s)
    course = flight.course(rng, attitude_rad, np.radians(3.0))
    return timing(pairs, course, 0.0, np.zeros(3), SIGMA_RAD)


@pytest.mark.parametrize("offset_s", rest_long([-0.42, 0.35, -0.2, 0.0, 0.07], 2))
def test_an_offset_is_found_in_turns_beside_a_mount_and_a_compass_that_are_off(offset_s: float) -> None:
    found = estimate(offset_s)
    assert found is not None
    assert abs(found.offset_s - offset_s) < 0.012
    assert abs(found.offset_s - offset_s) < 3.0 * found.sigma_s
    assert 0.005 <= found.sigma_s < 0.015
    assert found.end_ns - found.start_ns > 30_000_000_000


def test_a_fifth_of_wrong_tracks_changes_little() -> None:
    found = estimate(-0.2, wrong=0.2)
    assert found is not None
    assert abs(found.offset_s + 0.2) < 0.015


@pytest.mark.parametrize("attitude_deg", rest_long([1.0, 0.0, 0.1, 0.3]))
def test_level_flight_says_nothing_whatever_the_attitudes_noise(attitude_deg: float) -> None:
    for seed in range(4):
        assert estimate(-0.2, seed, turns=(), attitude_rad=np.radians(attitude_deg)) is None


def test_what_one_roll_shows_is_held_against_nothing_and_is_no_estimate() -> None:
    """Errors of attitudes last for longer than one roll."""
    assert estimate(-0.2, turns=((4.0, 40.0),), until_s=5.5) is None


def test_an_offset_out_of_reach_is_no_estimate() -> None:
    found = estimate(0.9)
    assert found is None or found.sigma_s > 0.05


def test_attitudes_that_scatter_more_than_declared_make_the_sigma_larger() -> None:
    """One degree from attitude to attitude where 0.3 is declared; the errors stay within what is claimed."""
    found = [f for f in (estimate(-0.2, seed, attitude_rad=np.radians(1.0)) for seed in range(12)) if f is not None]
    sharp = estimate(-0.2)
    assert sharp is not None
    assert len(found) >= 8
    assert np.median([f.sigma_s for f in found]) > 1.5 * sharp.sigma_s
    errors = np.array([(f.offset_s + 0.2) / f.sigma_s for f in found])
    assert 0.2 < np.mean(errors**2) < 3.0
    assert np.abs(errors).max() < 4.0
