"""An old picture given as new is seen for what it is; a hovering aircraft is not suspected."""

import numpy as np
import pytest
from numpy.typing import NDArray

from contract.feature_set import Status
from contract.rotations import exp_so3
from onboard.geometry.plane_homography import move
from onboard.navigation.limits import PATIENCE_NS
from onboard.navigation.navigator import NavState
from onboard.pipeline.frozen_frames import Staleness, Stillness
from onboard.vision.klt_tracker import Tracks

PICTURE = np.random.default_rng(3).integers(0, 255, (48, 64), np.uint8)


def at(east_m: float = 0.0, yaw_rad: float | None = 0.0) -> NavState:
    R = None if yaw_rad is None else exp_so3(np.array([0.0, 0.0, yaw_rad]))
    return NavState(0, np.array([east_m, 0.0, 100.0]), None, R, 1.0, 2.0, 0.3, 0.0, None)


@pytest.mark.parametrize(
    ("there", "stale"),
    [(at(0.4), False), (at(0.6), True), (at(0.0, 0.008), False), (at(0.0, 0.012), True), (at(0.6, None), True),
     (at(0.4, None), False)],
)  # fmt: skip
def test_the_same_picture_from_elsewhere_is_stale(there: NavState, stale: bool) -> None:
    staleness = Staleness()
    assert not staleness.is_stale(PICTURE, at())
    assert staleness.is_stale(PICTURE.copy(), there) is stale


def test_it_stays_stale_however_long_it_is_repeated_and_a_new_one_ends_it() -> None:
    staleness = Staleness()
    staleness.is_stale(PICTURE, at())
    assert all(staleness.is_stale(PICTURE, at(float(metres))) for metres in range(1, 10))
    changed = PICTURE.copy()
    changed[20, 30] ^= 1
    assert not staleness.is_stale(changed, at(10.0))
    assert staleness.is_stale(changed, at(11.0))


def test_a_time_offset_learned_since_moves_nothing() -> None:
    """The older state is looked up anew, with the offset that the newer one has: 2 m/s, learned 0.4 s."""
    staleness = Staleness()
    staleness.is_stale(PICTURE, at(0.0))
    assert not staleness.is_stale(PICTURE.copy(), at(0.8), lambda stamp_ns: at(0.8))
    assert staleness.is_stale(PICTURE.copy(), at(1.6), lambda stamp_ns: at(0.8))
    assert staleness.is_stale(PICTURE.copy(), at(0.8), lambda stamp_ns: Status.UNSYNCHRONISED)


IDS = np.arange(40)
FEATURES = np.random.default_rng(4).uniform([10.0, 10.0], [630.0, 470.0], (40, 2))


def shifted(x_px: float) -> NDArray[np.float64]:
    return np.array([[1.0, 0.0, x_px], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])


def seen(x_px: float, seed: int = 0) -> Tracks:
    """Features found again `x_px` aside, to the tenth of a pixel that another encoding of a picture costs."""
    noise = 0.1 * np.random.default_rng(seed).standard_normal(FEATURES.shape)
    return Tracks(IDS, move(shifted(x_px), FEATURES) + noise, FEATURES, len(IDS), shifted(x_px))


def stillness() -> Stillness:
    out = Stillness(640)
    out.begin(IDS, FEATURES, 0)
    return out


@pytest.mark.parametrize(("predicted_px", "old"), [(5.0, False), (8.0, False), (9.0, True), (60.0, True)])
def test_a_picture_encoded_anew_is_old_once_telemetry_is_sure(predicted_px: float, old: bool) -> None:
    """Sure is two sigmas: 3 px and a share of 0.15, so 8.6 px."""
    assert stillness().is_old(seen(0.0), shifted(predicted_px), 1) is old


def test_steps_too_small_for_one_picture_add_up() -> None:
    """At 30 Hz nothing moves far between two pictures."""
    still = stillness()
    assert not still.is_old(seen(20.0), shifted(22.0), 0)
    verdicts = [still.is_old(seen(20.0, seed=k), shifted(22.0 + 2.4 * k), 33_000_000 * k) for k in range(1, 8)]
    assert verdicts == [False] * 3 + [True] * 4


def test_ground_that_moves_as_predicted_or_otherwise_is_new() -> None:
    still = stillness()
    assert not any(still.is_old(seen(12.0 * k), shifted(12.0 * k), k) for k in range(1, 6))
    assert not any(still.is_old(seen(60.0 + 1.0 * k), shifted(60.0 + 12.0 * k), k) for k in range(1, 6))


def test_a_drift_of_telemetry_over_a_still_picture_is_not_held_against_it() -> None:
    """On the ground, or hovering: 6 px in five seconds, a minute long."""
    still = stillness()
    assert not any(still.is_old(seen(0.0, k), shifted(1.2 * k), k * (PATIENCE_NS // 5 + 1)) for k in range(1, 60))


def test_it_stays_old_however_long() -> None:
    still = stillness()
    assert all(still.is_old(seen(0.0, k), shifted(12.0 * k), k * PATIENCE_NS // 4) for k in range(1, 40))
