"""A window's first orientations, from rays and positions alone."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from contract.rotations import R_ENU_NED, exp_so3, log_so3, mount_rotation
from onboard.estimation import window_start
from onboard.estimation.window_start import orient
from onboard.geometry.relative_orientation import start_pair
from tests.onboard.scenes import CAMERA


@pytest.mark.parametrize("mount_yaw_deg", [0.0, 180.0, -90.0])
@pytest.mark.parametrize("seed", range(3))
def test_a_climb_and_a_few_metres_of_travel_give_the_travels_heading(
    mount_yaw_deg: float, seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The longest baseline is the climb's, which tells no heading: recorded views of it were turned by 165 degrees."""
    baselines: list[NDArray[np.float64]] = []

    def noted(*given: Any) -> Any:
        baselines.append(given[2])
        return start_pair(*given)

    monkeypatch.setattr(window_start, "start_pair", noted)
    rng = np.random.default_rng(seed)
    R_body_cam = mount_rotation(0.0, -90.0, mount_yaw_deg)
    climbed = [[0.0, 0.0, z] for z in (18.0, 25.0, 40.0, 88.0, 100.0)]
    centres = np.array([*climbed, [0.0, 4.0, 100.0], [0.0, 11.0, 100.0], [0.0, 20.0, 100.0]])
    level = R_ENU_NED @ R_body_cam
    forward = np.zeros((len(centres), 3))
    forward[5:, 0] = np.radians([-8.0, -16.0, -16.0])  # a rotorcraft speeds up nose down: about east, flying north
    shaken = exp_so3(np.radians(2.0) * rng.standard_normal((len(centres), 3)))
    R = (exp_so3(forward) @ level @ shaken).transpose(0, 2, 1)
    points = np.column_stack([rng.uniform(-20.0, 20.0, (300, 2)), rng.normal(0.0, 1.0, 300)])
    p = np.einsum("kij,kpj->kpi", R, points - centres[:, None])
    uv, seen = CAMERA.project(p)
    rays, _ = CAMERA.unproject(uv + 0.3 * rng.standard_normal(uv.shape))
    gps = centres + 1.0 * rng.standard_normal(3) + 0.3 * rng.standard_normal(centres.shape)
    found = orient(rays[..., :2], seen, gps, R_body_cam, 1.5 / CAMERA.focal_px)
    assert np.hypot(*baselines[0][:2]) > abs(baselines[0][2])
    turned_deg = np.degrees(np.linalg.norm(log_so3(found @ R.transpose(0, 2, 1)), axis=1))
    assert 0.0 < turned_deg.max() < 30.0
