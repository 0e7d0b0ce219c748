"""Where other pictures were taken, from the features of the clicked one: (29.1) to (29.3)."""

from dataclasses import replace

import numpy as np
import pytest

from contract.camera import Camera
from contract.rotations import exp_so3
from onboard.estimation.camera_states import corrected
from onboard.measured.views import (
    LEAST_REACH_PX,
    Features,
    linearised,
    pixels,
    pixels_by_camera,
    rays_by_camera,
    reach_px,
    relative_pose,
    resect,
    view_of,
)
from tests.onboard.measured.step_world import CAMERA, CLICKED, FISHEYE, World


def some_features(rng: np.random.Generator, count: int = 60, sigma: float = 1e-3) -> Features:
    rays, _ = CAMERA.unproject(uv := rng.uniform([10.0, 10.0], [310.0, 230.0], (count, 2)))
    by_camera = rays_by_camera(CAMERA, rays[:, :2])
    return Features(uv, rays, 1.0 / rng.uniform(80.0, 120.0, count), np.full(count, sigma), by_camera)


def test_the_derivatives_of_a_view_are_those_of_finite_differences() -> None:
    rng = np.random.default_rng(1)
    features, R, centre = some_features(rng), exp_so3(rng.normal(0.0, 0.1, 3)), np.array([11.0, -4.0, 2.0])

    def seen(step: np.ndarray, scale: float = 1.0) -> np.ndarray:
        turned, moved = exp_so3(step[:3]) @ R, centre + R.T @ step[3:]
        q = (features.rays - scale * features.inverse_depth_per_m[:, None] * moved) @ turned.T
        return 300.0 * q[:, :2] / q[:, 2:]

    _, by_pose, by_depth = linearised(R, centre, features, CAMERA)
    for i in range(6):
        step = np.eye(6)[i] * 1e-6
        np.testing.assert_allclose(by_pose[:, :, i], (seen(step) - seen(-step)) / 2e-6, rtol=1e-5, atol=1e-4)
    np.testing.assert_allclose(
        by_depth, (seen(np.zeros(6), 1.0 + 1e-6) - seen(np.zeros(6), 1.0 - 1e-6)) / 2e-6, rtol=1e-5, atol=1e-4
    )


def test_a_pose_is_as_far_off_as_its_derivatives_by_the_features_state() -> None:
    """Over many draws of pixels and depths, at a point of the picture; outliers are left out."""
    rng = np.random.default_rng(2)
    squares = []
    for _ in range(120):
        features, R, centre = some_features(rng), exp_so3(rng.normal(0.0, 0.05, 3)), np.array([14.0, 3.0, 1.0])
        q = (features.rays - features.inverse_depth_per_m[:, None] * centre) @ R.T
        xy = q[:, :2] / q[:, 2:] + rng.normal(0.0, 0.2 / 300.0, (60, 2))
        xy[:5] += 0.05
        off_by = features.relative_sigma * rng.standard_normal(60)
        wrong = replace(features, inverse_depth_per_m=features.inverse_depth_per_m * (1.0 + off_by))
        start = exp_so3(rng.normal(0.0, 1e-3, 3)) @ R, centre + rng.normal(0.0, 0.2, 3)
        found = resect(*start, wrong, xy, CAMERA)
        assert found is not None
        R_found, centre_found, by_pixel, by_depth, sigma_px, _ = found
        place = np.array([0.2, -0.1, 1.0])
        off = np.diff(
            [pixels(CAMERA, T @ (place - c / 100.0)) for T, c in ((R, centre), (R_found, centre_found))], axis=0
        )[0]
        point = Features(np.zeros((1, 2)), place[None], np.array([0.01]), np.zeros(1), np.zeros((1, 2, 5)))
        A = linearised(R_found, centre_found, point, CAMERA)[1][0]
        cov = A @ (np.einsum("kni,lni->kl", by_pixel, by_pixel) * sigma_px**2 + by_depth @ by_depth.T) @ A.T
        squares.append(float(off @ np.linalg.solve(cov, off)) / 2.0)
        assert sigma_px == pytest.approx(0.2, rel=0.6)
    assert 0.7 < np.mean(squares) < 1.35


def test_a_pose_moves_with_what_the_features_have_in_common_as_it_states() -> None:
    """Features all off by one mode at a time: the pose by finite differences. (29.15)"""
    rng = np.random.default_rng(3)
    features, R, centre = some_features(rng, sigma=1e-4), exp_so3(rng.normal(0.0, 0.05, 3)), np.array([14.0, 3.0, 1.0])
    q = (features.rays - features.inverse_depth_per_m[:, None] * centre) @ R.T
    xy = q[:, :2] / q[:, 2:]
    plain = resect(R, centre, features, xy, CAMERA)
    assert plain is not None
    for mode, step in enumerate(1e-4 * np.eye(3)):
        wrong = replace(features, inverse_depth_per_m=features.inverse_depth_per_m * (1.0 + features.modes @ step))
        found = resect(R, centre, wrong, xy, CAMERA)
        assert found is not None
        turned = found[0] @ plain[0].T
        turn = np.array([turned[2, 1], turned[0, 2], turned[1, 0]])
        moved = np.array([*turn, *(plain[0] @ (found[1] - plain[1]))])
        stated = plain[5].by_log @ features.modes[:, mode] * 1e-4
        assert np.linalg.norm(moved - stated) < 0.05 * np.linalg.norm(stated)


@pytest.mark.parametrize("camera", [CAMERA, replace(CAMERA, distortion=(-0.2, 0.05, 0.001, -0.001, 0.0)), FISHEYE])
def test_pixels_in_a_view_move_with_the_camera_s_errors_as_derived(camera: Camera) -> None:
    """(29.14) by finite differences: pixels of the clicked picture stay, both pictures' camera is another."""
    rng = np.random.default_rng(4)
    uv, w = rng.uniform([40.0, 40.0], [280.0, 200.0], (30, 2)), 1.0 / rng.uniform(80.0, 120.0, 30)
    R, centre = exp_so3(rng.normal(0.0, 0.1, 3)), np.array([11.0, -4.0, 2.0])

    def seen(by: Camera) -> np.ndarray:
        q = (by.unproject(uv)[0] - w[:, None] * centre) @ R.T
        return by.pixels(q[:, :2] / q[:, 2:])

    rays = camera.unproject(uv)[0]
    found = pixels_by_camera(R, (rays - w[:, None] * centre) @ R.T, rays_by_camera(camera, rays[:, :2]), camera)
    for state, step in enumerate(1e-6 * np.eye(5)):
        moved = (seen(corrected(camera, step)) - seen(corrected(camera, -step))) / 2e-6
        np.testing.assert_allclose(found[:, :, state], moved, rtol=1e-3, atol=0.05)


def test_a_pose_moves_with_the_camera_s_errors_as_it_states() -> None:
    """Both pictures' rays by a camera that is off by one error at a time: the pose by finite differences. (29.14)"""
    rng = np.random.default_rng(3)
    features, R, centre = some_features(rng, sigma=1e-4), exp_so3(rng.normal(0.0, 0.05, 3)), np.array([14.0, 3.0, 1.0])
    uv = pixels(CAMERA, (features.rays - features.inverse_depth_per_m[:, None] * centre) @ R.T)
    plain = resect(R, centre, features, CAMERA.unproject(uv)[0][:, :2], CAMERA)
    assert plain is not None
    for state, step in enumerate(1e-4 * np.eye(5)):
        wrong = corrected(CAMERA, step)
        off = replace(features, rays=wrong.unproject(features.uv_px)[0])
        found = resect(R, centre, off, wrong.unproject(uv)[0][:, :2], wrong)
        turned = found[0] @ plain[0].T
        moved = np.array([turned[2, 1], turned[0, 2], turned[1, 0], *(plain[0] @ (found[1] - plain[1]))])
        stated = plain[5].by_camera[:, state] * 1e-4
        assert np.linalg.norm(moved - stated) < 0.05 * np.linalg.norm(stated)


def test_a_view_is_mended_by_the_features_to_a_fraction_of_a_pixel() -> None:
    world = World(seed=3)
    clicked, other = world.kept(CLICKED), world.kept(1)
    start = relative_pose(clicked.its_set, other.its_set)
    view = view_of(clicked.image, Features.of(clicked.its_set), other.image, other.its_set, start)
    assert view is not None
    uv = np.array([[60.0, 60.0], [160.0, 120.0], [280.0, 200.0]])
    _, places, _ = world.depths(CLICKED, uv)
    R, centre = world.pose(1)
    truly = CAMERA.project((places - centre) @ R)[0]
    w = 1.0 / world.depths(CLICKED, uv)[0]
    rays = CAMERA.unproject(uv)[0]

    def off(R_: np.ndarray, centre_m: np.ndarray) -> float:
        return float(np.abs(pixels(CAMERA, (rays - w[:, None] * centre_m) @ R_.T) - truly).max())

    assert off(*start) > 0.5
    assert off(view.R, view.centre_m) < 0.15


def test_a_pose_that_is_far_off_is_mended_as_far_as_the_sets_state_that_it_may_be() -> None:
    """Two pictures of windows whose attitudes differ by two degrees, of which the sets state one each."""
    world = World(seed=3)
    clicked, other = world.kept(CLICKED), world.kept(1)
    R, centre = relative_pose(clicked.its_set, other.its_set)
    off = exp_so3(np.array([0.0, np.radians(2.0), 0.0])) @ R, centre
    features = Features.of(clicked.its_set)
    states = np.diag([0.5, 0.5, 0.8, *np.radians([1.0, 1.0, 1.0]), 1e-3, 1e-3, 1e-3]) ** 2
    sets = [replace(kept.its_set, common_cov=states) for kept in (clicked, other)]
    reach = reach_px(*sets)
    assert 3.0 * 300.0 * np.radians(1.0) * np.sqrt(2.0) * 0.8 < reach <= 0.06 * 320.0 * 1.001
    assert reach_px(clicked.its_set, other.its_set) == LEAST_REACH_PX
    found = view_of(clicked.image, features, other.image, other.its_set, off, reach)
    plain = view_of(clicked.image, features, other.image, other.its_set, (R, centre))
    assert np.abs(found.R - plain.R).max() < 5e-4
    assert view_of(clicked.image, features, other.image, other.its_set, off) is None


def test_what_is_behind_or_beyond_a_lens_s_rays_is_far_off_the_picture() -> None:
    """A fisheye's own equation has a pixel within the picture for every direction ahead."""
    wide = replace(FISHEYE, fx_px=100.0)
    off = np.radians([0.0, 60.0, 79.9, 80.1, 89.9, 95.0])
    seen = pixels(wide, np.stack([np.sin(off), np.zeros(6), np.cos(off)], axis=1))
    assert wide.contains(wide.pixels(np.array([np.tan(off[3]), 0.0])))
    assert np.all(np.diff(seen[:3, 0]) > 0.0) and np.abs(seen[3:]).min() > 1e4


def test_without_features_in_common_there_is_no_view() -> None:
    world = World(seed=4)
    clicked, other = world.kept(CLICKED), world.kept(1)
    start = relative_pose(clicked.its_set, other.its_set)
    features = Features.of(clicked.its_set)
    assert view_of(clicked.image, features, np.full_like(other.image, 90), other.its_set, start) is None
    assert (
        view_of(clicked.image, features, other.image, other.its_set, (start[0], start[1] + [500.0, 0.0, 0.0])) is None
    )
