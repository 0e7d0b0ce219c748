"""The profile over time offsets: rejects one that is far off, never the right one, and is wide where nothing shows."""

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from contract.rotations import R_ENU_NED, exp_so3, matrix_from_euler, mount_rotation
from onboard.estimation.clock_profile import STEP_S, ClockProfile, _upon, clock_profile, offsets_about
from tests.rest_long import rest_long

Array = NDArray[np.float64]

R_BODY_CAM = mount_rotation(0.0, -90.0, 0.0)  # looks down
SPEED_M_S, G = 20.0, 9.81
SIGMA_RAD = np.radians([0.5, 3.0, 3.0])  # as declared
TURNS = tuple((1.0 + 6.0 * k, (-1) ** k * 40.0) for k in range(3))  # begins at, bank in degrees
MOUNT_DEG, COMPASS_DEG = (2.0, 1.5, -1.0), 3.0  # off by
ROLL_S, HELD_S = 1.2, 3.0
STEP_OF_TURNS_S = 0.01


def attitude(t: float, turns: tuple[tuple[float, float], ...], wobble_deg: float = 0.0) -> Array:
    """R_enu_body in coordinated turns: rolls in, holds the bank, rolls out; or wobbles at 2 Hz."""
    bank, heading = turned(turns)
    last = int(np.ceil((t + 2.0) / STEP_OF_TURNS_S)) - 1
    wobble = np.radians(wobble_deg) * np.sin(4.0 * np.pi * t)
    return R_ENU_NED @ matrix_from_euler(float(bank[last]) + wobble, 0.0, float(heading[last]))


@cache
def turned(turns: tuple[tuple[float, float], ...]) -> tuple[Array, Array]:
    """Bank and heading (rad) at every hundredth of a second from -2 s on."""
    times = np.arange(-2.0, 40.0, STEP_OF_TURNS_S)
    bank = np.zeros(len(times))
    for begin, degrees in turns:
        rise, fall = (np.clip((times - s) / ROLL_S, 0.0, 1.0) for s in (begin, begin + HELD_S))
        bank += np.radians(degrees) * (rise**2 * (3 - 2 * rise) - fall**2 * (3 - 2 * fall))
    return bank, np.cumsum(G * np.tan(bank) / SPEED_M_S) * STEP_OF_TURNS_S


def profile(
    offset_s: float,
    used_s: float = 0.0,
    seed: int = 0,
    turns: tuple[tuple[float, float], ...] = TURNS,
    noise_deg: float = 0.3,
    wobble_deg: float = 0.0,
    pictures: int = 10,
    wrong: int = 0,
    known: tuple[float, float] = (0.0, 0.1),
) -> ClockProfile | None:
    """Of pictures 0.9 s apart whose stamps are `offset_s` before their exposures by the autopilot's clock.

    `noise_deg`: of each attitude that is looked up; `wrong`: pictures whose attitudes are 30 degrees off. `known`: mean
    and sigma of the offset before (s).
    """
    rng = np.random.default_rng(seed)
    mount = exp_so3(np.radians(MOUNT_DEG))
    exposures = 0.9 * np.arange(pictures) + rng.uniform(0.0, 1.0)
    own = np.stack([(attitude(float(t), turns, wobble_deg) @ R_BODY_CAM @ mount).T for t in exposures])
    offsets_s = offsets_about(used_s, known[1])
    compass = exp_so3(np.array([0.0, 0.0, -np.radians(COMPASS_DEG)]))
    noise = exp_so3(np.radians(noise_deg) * rng.standard_normal((pictures, 3)))  # lasts as long as offsets differ
    noise[:wrong] = exp_so3(np.radians([30.0, 0.0, 0.0]))
    looked_up = [
        [
            compass @ n @ attitude(float(t - offset_s + tau), turns, wobble_deg) @ R_BODY_CAM
            for t, n in zip(exposures, noise, strict=True)
        ]
        for tau in offsets_s
    ]
    return clock_profile(own, np.array(looked_up), offsets_s, (known[0], known[1] ** 2), SIGMA_RAD)


@pytest.mark.parametrize("offset_s", rest_long([-0.42, 0.35, -0.2, 0.15], 2))
def test_an_offset_that_is_far_off_is_rejected_and_the_right_one_found(offset_s: float) -> None:
    for seed in range(4):
        found = profile(offset_s, seed=seed)
        assert found.rejects(0.0)
        assert not found.rejects(offset_s)
        assert abs(found.best_s - offset_s) < 1.5 * STEP_S
        assert not found.is_wide, "the derivative holds about it"


@pytest.mark.parametrize("noise_deg", [0.1, 1.0])
def test_the_right_offset_is_never_rejected(noise_deg: float) -> None:
    """Whatever the attitudes' noise, and where the one used is a step off."""
    for seed in range(12):
        found = profile(0.03, seed=seed, noise_deg=noise_deg)
        assert not found.rejects(0.0)
        assert not found.rejects(0.03)


@pytest.mark.parametrize("noise_deg", [0.3, 2.0])
def test_level_flight_and_a_wobble_below_the_noise_show_nothing(noise_deg: float) -> None:
    for seed in range(4):
        for wobble_deg in (0.0, 0.2 * noise_deg):
            found = profile(-0.3, seed=seed, turns=(), noise_deg=noise_deg, wobble_deg=wobble_deg)
            assert not found.rejects(0.0)
            assert found.is_wide
            assert found.precision < 0.2**-2


def test_one_wrong_attitude_changes_nothing() -> None:
    found = profile(-0.3, wrong=1)
    assert abs(found.best_s + 0.3) < 1.5 * STEP_S
    assert found.rejects(0.0)


def test_an_offset_beyond_reach_is_not_guessed_at() -> None:
    """The best within reach is at its end, or its neighbours fit as well; nothing is then known to be better."""
    found = profile(1.0)
    assert found.kept_s is None


def test_of_an_offset_that_was_not_compared_nothing_is_reported() -> None:
    """What was learned may lie farther from the offset used than the profile reaches."""
    found = profile(0.2, used_s=0.1)
    assert found.rejects(-0.2)
    assert found.rejects(0.55)
    assert not found.rejects(-0.45)
    assert not found.rejects(0.65)


def test_three_pictures_are_too_few() -> None:
    assert profile(-0.3, pictures=3) is None


@pytest.mark.parametrize("known", [(0.0, 0.29), (0.4, 0.2), (0.0, 0.005)])
def test_that_the_offsets_compared_end_adds_nothing(known: tuple[float, float]) -> None:
    """Level flight without noise: every offset fits equally well, whatever was known and wherever the used one lies."""
    for used_s in (0.0, 0.45):
        found = profile(0.45, used_s, turns=(), noise_deg=0.0, known=known)
        assert found.mean_s == pytest.approx(known[0], abs=0.1 * known[1])
        assert found.variance > 0.99 * known[1] ** 2


@pytest.mark.parametrize("sigma_s", [0.1, 0.02])
def test_what_a_profile_knows_is_as_sure_as_it_is_off(sigma_s: float) -> None:
    """A wobble as large as the attitudes' noise shows some of the offset, whether much or little was known before."""
    sigmas, off = [], []
    for seed in range(30):
        right_s = sigma_s * float(np.random.default_rng(seed).standard_normal())
        found = profile(right_s, seed=seed, turns=(), noise_deg=0.5, wobble_deg=0.7, known=(0.0, sigma_s))
        assert 1.0 / found.variance == pytest.approx(sigma_s**-2 + found.precision)
        sigmas.append(np.sqrt(found.variance))
        off.append((found.mean_s - right_s) / sigmas[-1])
    assert 0.2 * sigma_s < np.median(sigmas) < 0.97 * sigma_s
    assert 0.5 < np.sqrt(np.mean(np.square(off))) < 1.5


def test_what_was_known_may_lie_far_from_the_offsets_compared() -> None:
    """Those are about the offset used, which is right here; the prior's mean is at their end."""
    found = profile(0.45, 0.45, known=(0.0, 0.29))
    assert abs(found.mean_s - 0.45) < 3.0 * np.sqrt(found.variance) < 0.1


def test_a_profile_and_what_was_known_are_combined_as_two_measurements() -> None:
    offsets_s = offsets_about(0.0, 1.0)
    narrow = np.square((offsets_s - 0.3) / 0.2)  # 0.3 s off what was known, +-0.2
    assert _upon(narrow, offsets_s, 0.0, 0.2**2) == pytest.approx((25.0, 0.15, 0.02))
    assert _upon(np.zeros_like(offsets_s), offsets_s, 0.1, 0.04) == pytest.approx((0.0, 0.1, 0.04))
