"""The second camera's angles and stamps, learned from things that are seen from several sides."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from contract.answer import Fix
from contract.locate import Locator
from contract.rotations import exp_so3
from onboard.config.second_camera import SecondCamera
from onboard.spots.bracketed import Bracketed
from onboard.spots.mount_estimate import MountEstimate, Sighting
from onboard.spots.second_camera import STATES, Mount, set_of_second
from simulation.trajectory import Pose
from tests.onboard.spots.scenes import BOSON, DOWN, ORIGIN
from tests.onboard.spots.two_cameras import Turn, thermal_frame
from tests.rest_long import rest_long

Array = NDArray[np.float64]

STATED = Mount.stated(SecondCamera(file="thermal.json"))
LEG_S, LEG_M_S = 12.0, 10.0
HEADINGS = np.radians([0.0, 180.0, 90.0, 270.0])
SIDES_M = -12.0, 9.0, 15.0, -8.0


class Legs(Turn):
    """Straight over the middle again and again: to and fro, then across, each leg a little aside."""

    def pose(self, time_s: float) -> Pose:
        leg = int(time_s // LEG_S)
        heading, side = HEADINGS[leg % 4], SIDES_M[(leg + leg // 4) % 4]
        ahead = np.array([np.sin(heading), np.cos(heading)])
        place = ahead * LEG_M_S * (time_s - LEG_S * (leg + 0.5)) + side * np.array([ahead[1], -ahead[0]])
        turned = exp_so3([0.0, 0.0, -heading]) @ DOWN @ exp_so3([np.radians(self.tilt_deg), 0.0, 0.0])
        return Pose(np.array([*place, self.height_m]), turned)


LEGS = Legs(tilt_deg=0.0)
ORBIT = Turn(speed_m_s=6.0, turn_rad_s=0.2, tilt_deg=0.0)  # 31 s round 30 m
TRUTH = np.array([np.radians(2.0), np.radians(-1.5), np.radians(1.0), 0.04])
THINGS = [np.array([*place, 0.0]) for place in ((-20.0, 5.0), (12.0, -18.0), (2.0, 22.0), (25.0, 10.0), (-2.0, -24.0))]
PATCHY_S = 60.0  # correlation time of the position's error


@dataclass
class Errors:
    """Of the first camera's position: one sigma each axis, slow; and of a spot's own middle."""

    rng: np.random.Generator
    sigma_m: float = 0.5
    own_m: float = 0.1

    def __post_init__(self) -> None:
        self.now = self.sigma_m * self.rng.standard_normal(2)

    def step(self, span_s: float) -> None:
        kept = np.exp(-span_s / PATCHY_S)
        self.now = kept * self.now + self.sigma_m * np.sqrt(1.0 - kept**2) * self.rng.standard_normal(2)


def truly(state: Array) -> Mount:
    return replace(STATED, R_first_second=STATED.R_first_second @ exp_so3(state[:3]), late_s=float(state[3]))


def seen(turn: Turn, time_s: float, truth: Mount, used: Mount, places: list[Array], errors: Errors) -> list[Sighting]:
    """Things as the mount that is used has them, seen by the true one; those that the picture shows."""
    number = int(time_s * turn.rate_hz)
    looked = Bracketed(thermal_frame(time_s), turn.first_set(number), turn.first_set(number + 1), (0.0, 0.0))
    s, pointing = set_of_second(looked, BOSON, used, 1.5)
    assert pointing is not None
    locator, found = Locator(s), []
    for place in places:
        uv = turn.pixel(time_s + truth.late_s, truth.R_first_second, place)
        fix, parts = locator.locate(uv), locator.error_parts(uv)
        if not isinstance(fix, Fix) or parts is None:
            continue  # outside of the picture
        en = ORIGIN.to_enu(fix.lat_deg, fix.lon_deg, ORIGIN.height_m)[:2]
        own = errors.own_m * errors.rng.standard_normal(2)
        total = errors.sigma_m**2 + errors.own_m**2
        by_mount = parts.by_pixel_m[:2] @ pointing.by_state(uv)
        found.append(Sighting(en + errors.now + own, by_mount, total * np.eye(2), errors.own_m**2 / total))
    return found


@dataclass
class Flight:
    """What was learned, and how far each spot of the last leg was from the truth: squared, in its covariance."""

    estimate: MountEstimate
    off: list[float] = field(default_factory=list)

    @property
    def inside(self) -> list[bool]:
        return [d2 < 4.605 for d2 in self.off]


def simulated(
    rng: np.random.Generator, state: Array, seconds: float, turn: Turn = LEGS, walk_m_s: float = 0.0
) -> Flight:
    """Looks twice a second; the first thing walks."""
    flight, truth, errors = Flight(MountEstimate(STATED)), truly(state), Errors(rng)
    for k in range(round(2.0 * seconds)):
        time_s, mount = 0.47 + 0.5 * k, flight.estimate.mount
        errors.step(0.5)
        if isinstance(turn, Legs) and not 0.6 < time_s % LEG_S < LEG_S - 0.6:
            continue  # from one leg to the next
        places = [THINGS[0] + [walk_m_s * time_s, 0.0, 0.0], *THINGS[1:]]
        found = seen(turn, time_s, truth, mount, places, errors)
        if time_s > seconds - LEG_S:
            for one in found:
                off = one.place_m - min((p[:2] for p in places), key=lambda p, z=one.place_m: np.hypot(*(p - z)))
                cov = one.covariance + one.by_mount @ mount.covariance @ one.by_mount.T
                flight.off.append(float(off @ np.linalg.solve(cov, off)))
        flight.estimate.add(time_s, found)
    return flight


def left(estimate: MountEstimate, state: Array) -> Array:
    """What is left of the errors: angles (rad) and time (s)."""
    truth = truly(state)
    turned = estimate.mount.R_first_second.T @ truth.R_first_second
    angles = np.array([turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]]) / 2.0
    return np.array([*angles, truth.late_s - estimate.mount.late_s])


def spot_errors(off: Array, covariance: Array) -> tuple[float, float]:
    """Of a spot in the picture's middle, 90 m below at LEG_M_S: how far off it is, m, and one sigma of that (each axis
    pooled).
    """
    by = np.array([[0.0, 90.0, 0.0, 0.0], [-90.0, 0.0, 0.0, -LEG_M_S]])
    return float(np.linalg.norm(by @ off)), float(np.sqrt(np.trace(by @ covariance @ by.T)))


def misfit(estimate: MountEstimate, state: Array) -> float:
    """What is left in its covariance, squared: chi-square of four degrees of freedom."""
    off = left(estimate, state)
    return float(off @ np.linalg.solve(estimate.mount.covariance, off))


def test_eight_legs_recover_what_the_camera_is_turned_by() -> None:
    estimate = simulated(np.random.default_rng(1), TRUTH, 8 * LEG_S).estimate
    before, after = spot_errors(TRUTH, STATED.covariance), spot_errors(left(estimate, TRUTH), estimate.mount.covariance)
    assert estimate.things_used >= 3
    assert before[0] > 4.0 and after[0] < 0.4
    assert 0.05 < after[1] < 0.05 * before[1]
    assert abs(left(estimate, TRUTH)[2]) < np.radians(0.5)  # about the optical axis
    assert misfit(estimate, TRUTH) < 13.3  # 99 %


def test_on_one_straight_leg_nothing_is_learned_and_nothing_is_claimed() -> None:
    estimate = simulated(np.random.default_rng(2), TRUTH, LEG_S).estimate
    assert estimate.things_used == 0
    np.testing.assert_array_equal(estimate.mount.covariance, STATED.covariance)
    np.testing.assert_array_equal(estimate.mount.R_first_second, STATED.R_first_second)


@pytest.mark.parametrize("turn", rest_long([LEGS, ORBIT]))
def test_one_that_walks_is_left_out(turn: Turn) -> None:
    estimate = simulated(np.random.default_rng(1), TRUTH, 72.0, turn, walk_m_s=1.4).estimate
    assert 2 <= estimate.things_used <= 4
    assert misfit(estimate, TRUTH) < 13.3


@pytest.mark.long
def test_what_is_left_is_as_large_as_it_says_and_spots_are_inside_their_ellipse() -> None:
    rng, off, inside, learned = np.random.default_rng(3), [], [], 0
    for _ in range(24):
        state = np.linalg.cholesky(STATED.covariance) @ rng.standard_normal(STATES)
        flight = simulated(rng, state, 6 * LEG_S)
        off.append(misfit(flight.estimate, state))
        inside += flight.inside
        learned += flight.estimate.things_used >= 2
    assert learned >= 17
    assert 1.5 < np.mean(off) < 6.0 and max(off) < 18.5  # 4 expected; 1 of 1000 is above 18.5
    assert len(inside) > 500 and 0.84 < np.mean(inside) < 0.98
