"""Clicks on pictures whose rows were exposed one after the other, against the exact geometry of every row."""

import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray

from contract.answer import Fix
from contract.camera import Camera
from contract.feature_set import COMMON_STATES, DepthSource, FeatureSet, Status
from contract.geodesy import LocalFrame
from contract.locate import Locator
from contract.rolling_shutter import RollingShutter, row_share
from contract.rotations import exp_so3
from contract.wire.codec import decode, encode
from ground.web.view import placed_in

Array = NDArray[np.float64]

CAMERA = Camera(640, 480, 879.2, 879.2, 319.5, 239.5, (-0.2, 0.05, 0.0, 0.0, 0.0))
HEIGHT_M = 100.0
DOWN = np.diag([1.0, -1.0, -1.0])  # R_enu_cam of a camera that looks straight down
R_ENU_CAM = DOWN @ exp_so3(np.array([0.3, 0.05, 0.0]))
RATE, VELOCITY_ENU = np.array([0.35, -0.1, 0.2]), np.array([15.0, -13.0, 1.0])
PLACE = LocalFrame(-35.0, 149.0, 600.0)


def a_set(readout_s: float, sigma_readout_s: float = 0.0) -> FeatureSet:
    """Over level ground 100 m below, errors of a metre in height alone; the set as the ground receives it."""
    normal = R_ENU_CAM.T @ np.array([0.0, 0.0, -1.0]) / HEIGHT_M
    common = np.zeros((COMMON_STATES, COMMON_STATES))
    common[:3, :3] = np.diag([0.01, 0.01, 0.01])
    grid = np.stack(np.meshgrid(np.linspace(5, 634, 9), np.linspace(5, 474, 8)), axis=-1).reshape(-1, 2)
    w = normal[2] + CAMERA.unproject(grid)[0][:, :2] @ normal[:2]
    return decode(
        encode(
            FeatureSet(
                "uav", 1, 2, 3_000_000_000, Status.OK, CAMERA,
                camera_lat_deg=PLACE.lat_deg, camera_lon_deg=PLACE.lon_deg, camera_height_m=PLACE.height_m,
                undulation_m=0.0, R_enu_cam=R_ENU_CAM, common_cov=common, depth_source=DepthSource.PARALLAX,
                plane_per_m=normal[[2, 0, 1]], plane_sigma_relative=0.001, roughness=0.0001,
                uv_px=grid, inverse_depth_per_m=w, sigma_inverse_depth_per_m=1e-4 * w,
                shutter=RollingShutter(readout_s, RATE, R_ENU_CAM.T @ VELOCITY_ENU, sigma_readout_s),
            )
        )
    )  # fmt: skip


def shown_by(uv: Array, readout_s: float) -> Array:
    """The ground (3,) that a pixel's own row saw, about the middle row's camera."""
    late_s = readout_s * float(row_share(uv[1], CAMERA.height_px))
    ray = R_ENU_CAM @ exp_so3(late_s * RATE) @ CAMERA.unproject(uv)[0]
    centre = late_s * VELOCITY_ENU
    return np.asarray(centre - ray * (HEIGHT_M + centre[2]) / ray[2])


def located(feature_set: FeatureSet, uv: Array) -> tuple[Array, Fix]:
    answer = Locator(feature_set).locate(uv)
    assert answer.offset_enu_m is not None
    return answer.offset_enu_m, answer


@pytest.mark.parametrize("readout_s", [0.03, -0.03])
def test_a_click_on_any_row_finds_what_that_row_saw(readout_s: float) -> None:
    feature_set = a_set(readout_s)
    at_once = dataclasses.replace(feature_set, shutter=None)
    for v_px in (3.0, 120.0, 239.5, 400.0, 476.0):
        for u_px in (20.0, 320.0, 610.0):
            uv = np.array([u_px, v_px])
            truth = shown_by(uv, readout_s)
            missed_m = float(np.linalg.norm(located(feature_set, uv)[0] - truth))
            ignored_m = float(np.linalg.norm(located(at_once, uv)[0] - truth))
            assert missed_m < 0.02
            if v_px != 239.5:
                assert ignored_m > 20.0 * missed_m
            else:
                assert ignored_m == pytest.approx(missed_m, abs=1e-9)
    assert ignored_m > 0.2, "this motion would not matter"


def test_the_readouts_sigma_widens_answers_of_outer_rows_by_what_it_moves_them() -> None:
    sigma_s, step_s = 0.01, 0.001
    sure, unsure = a_set(0.03), a_set(0.03, sigma_s)
    for uv in (np.array([320.0, 5.0]), np.array([100.0, 470.0])):
        _, answer = located(unsure, uv)
        _, before = located(sure, uv)
        moved = (located(a_set(0.03 + step_s), uv)[0] - located(a_set(0.03 - step_s), uv)[0]) / (2.0 * step_s)
        added = answer.covariance_enu_m2 - before.covariance_enu_m2
        np.testing.assert_allclose(added, sigma_s**2 * np.outer(moved, moved), rtol=0.05, atol=1e-4)
        assert np.trace(added) > 0.01
    middle = np.array([320.0, 239.5])
    np.testing.assert_allclose(
        located(unsure, middle)[1].covariance_enu_m2, located(sure, middle)[1].covariance_enu_m2, atol=1e-12
    )


def test_the_vector_between_clicks_of_one_set_knows_the_readout_errs_for_both() -> None:
    sure, unsure = Locator(a_set(0.03)), Locator(a_set(0.03, 0.01))
    top, near, bottom = np.array([300.0, 5.0]), np.array([340.0, 5.0]), np.array([300.0, 475.0])

    def added(one: Array, two: Array) -> float:
        before, after = sure.difference_covariance(one, two), unsure.difference_covariance(one, two)
        return float(np.trace(after - before))

    assert added(top, bottom) > 20.0 * added(top, near) > 0.0


def test_a_place_is_shown_where_the_row_that_saw_it_has_it() -> None:
    """What a page draws of a pin: the pixel that was clicked."""
    feature_set = a_set(0.03)
    for uv in (np.array([320.0, 5.0]), np.array([100.0, 470.0]), np.array([500.0, 239.5])):
        _, answer = located(feature_set, uv)
        assert answer.height_ellipsoid_m is not None
        sampled = placed_in(feature_set, answer.lat_deg, answer.lon_deg, answer.height_ellipsoid_m)
        assert sampled is not None
        np.testing.assert_allclose(sampled, uv, atol=0.2)
