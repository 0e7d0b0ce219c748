"""An old picture given as new is seen for what it is; a hovering aircraft is not suspected."""

from __future__ import annotations

import numpy as np
import pytest

from contract.rotations import exp_so3
from onboard.navigation import NavState
from onboard.staleness import Staleness

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
