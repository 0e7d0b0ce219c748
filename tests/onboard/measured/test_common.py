"""The errors that a set's features have in common, by what its views show: (29.14) to (29.16)."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from contract.camera import UNKNOWN_SIGMA
from contract.rotations import exp_so3
from onboard.estimation.camera_states import corrected
from onboard.measured.common import COMMON, MODES, POSE, Shown, bent, in_common
from onboard.measured.views import Features, pixels, rays_by_camera, resect
from tests.onboard.measured.step_world import CAMERA

Array = NDArray[np.float64]
SIGMA = 1e-3  # of the logarithm of a feature's depth
PRIOR = np.diag([1e-2, 1e-2, 1e-2, *UNKNOWN_SIGMA]) ** 2


def scene(seed: int, count: int = 70) -> tuple[Features, list[tuple[Array, Array]]]:
    """Features of a clicked picture, and where six others were taken from."""
    rng = np.random.default_rng([seed, 1])
    uv = rng.uniform([10.0, 10.0], [310.0, 230.0], (count, 2))
    rays = CAMERA.unproject(uv)[0]
    by_camera = rays_by_camera(CAMERA, rays[:, :2])
    features = Features(uv, rays, 1.0 / rng.uniform(90.0, 110.0, count), np.full(count, SIGMA), by_camera)
    poses = [
        (exp_so3(rng.normal(0.0, 0.05, 3)), np.array([along, rng.normal(0.0, 2.0), rng.normal(0.0, 2.0)]))
        for along in (-24.0, -16.0, -8.0, 8.0, 16.0, 24.0)
    ]
    return features, poses


def seen(features: Features, R: Array, centre_m: Array) -> Array:
    return pixels(CAMERA, (features.rays - features.inverse_depth_per_m[:, None] * centre_m) @ R.T)


def shown_by(features: Features, poses: list[tuple[Array, Array]], noise_px: Array) -> list[Shown]:
    """The share of each view in what is shown of features whose pixels are off by `noise_px` (V, N, 2)."""
    out = []
    for (R, centre), noise in zip(poses, noise_px, strict=True):
        found = resect(R, centre, features, CAMERA.unproject(seen(features, R, centre) + noise)[0][:, :2], CAMERA)
        assert found is not None
        out.append(found[5])
    return out


def adjusted_log(features: Features, poses: list[tuple[Array, Array]], step: Array) -> Array:
    """The change of the logarithms of inverse depths (N,) in an adjustment of all pictures by a camera which is off by
    `step` (5,), every pose being free, but for the scale.
    """
    wrong = corrected(CAMERA, step)
    uv = [seen(features, *pose) for pose in poses]
    rays, count = wrong.unproject(features.uv_px)[0], len(features.rays)

    def off(x: Array) -> Array:
        w = features.inverse_depth_per_m * np.exp(x[:count])
        out = [1e-3 * np.mean(x[:count], keepdims=True)]
        for (R, centre), there, pose in zip(poses, uv, x[count:].reshape(-1, 6), strict=True):
            q = (rays - w[:, None] * (centre + 100.0 * pose[3:])) @ (exp_so3(pose[:3]) @ R).T
            out.append((wrong.pixels(q[:, :2] / q[:, 2:]) - there).ravel())
        return np.concatenate(out)

    return np.asarray(least_squares(off, np.zeros(count + 6 * len(poses)), x_scale="jac").x[:count], float)


def test_depths_bend_with_the_camera_s_errors_as_those_of_an_adjustment_do() -> None:
    """The focal length's error and k1's, by adjustments of all views, beyond the three modes."""
    features, poses = scene(0, 40)
    bend = bent(shown_by(features, poses, np.zeros((6, 40, 2))), features.modes, features.relative_sigma**2)
    for state, size in ((0, 1e-3), (3, 1e-3)):
        found = adjusted_log(features, poses, size * np.eye(5)[state]) / size
        found -= features.modes @ np.linalg.lstsq(features.modes, found, rcond=None)[0]
        assert np.linalg.norm(bend[:, state] - found) < 0.05 * np.linalg.norm(found)
    assert np.ptp(bend[:, 3]) > 0.05  # a thousandth of k1 bends the ground by 5 cm at a hundred metres and more


def sampled(seed: int, sliding: float) -> tuple[Array, Array, Array, Array]:
    """Errors (8,) of what views show of common errors, in a random scene; their stated covariance (8, 8); the error of
    the combination that bends most, in sigmas, as stated and as the features' own scatter has it. `sliding`: the share
    of features that slide by 0.5 px, one sigma, in the farthest views, less in nearer ones: corners of two depths.
    """
    rng = np.random.default_rng([seed, 2])
    features, poses = scene(seed)
    count, noise_px = len(features.rays), rng.normal(0.0, 0.1, (6, 70, 2))
    far = np.array([centre[0] for _, centre in poses])[:, None, None] / 24.0
    slides = rng.normal(0.0, 0.5, (count, 2)) * (rng.uniform(size=(count, 1)) < sliding)
    shown = shown_by(features, poses, noise_px + slides * far**2)
    scale = np.array([1.0] * MODES + [0.1] * 5)
    n = scale * rng.multivariate_normal(np.zeros(COMMON), PRIOR)
    field = np.concatenate([features.modes, bent(shown, features.modes, features.relative_sigma**2)], axis=1)
    logs = field @ n + SIGMA * rng.standard_normal(count)
    off = []
    for each in shown:
        X = each.X.copy()
        X[..., -1] -= each.z * logs[:, None] + X[..., POSE:-1] @ n[MODES:]
        off.append(replace(each, X=X))
    common = in_common(off, features.modes, features.relative_sigma**2, PRIOR * np.outer(scale, scale))
    way = np.concatenate([np.zeros(MODES), field[np.abs(field[:, -2]).argmax(), MODES:]])
    error = common.estimate - n
    variances = np.array([way @ common.covariance @ way, common.variance(way)])
    return error, common.covariance, *(float(way @ error) / np.sqrt(variances))


def test_common_errors_are_shown_within_what_is_stated_of_them() -> None:
    draws = [sampled(seed, 0.0) for seed in range(24)]
    squares = [off @ np.linalg.solve(covariance, off) / COMMON for off, covariance, *_ in draws]
    assert 0.75 < np.mean(squares) < 1.35
    assert 0.6 < np.sqrt(np.mean([z**2 for *_, z in draws])) < 1.35


def test_corners_that_slide_make_common_errors_as_unsure_as_they_do() -> None:
    draws = [sampled(seed, 0.5) for seed in range(24)]
    stated, scattered = (np.sqrt(np.mean([each[k] ** 2 for each in draws])) for k in (2, 3))
    assert 0.6 < scattered < 1.35 and stated > 1.08 * scattered


def test_depths_of_known_ground_do_not_bend() -> None:
    features, poses = scene(3)
    shown = shown_by(features, poses, np.random.default_rng(5).normal(0.0, 0.1, (6, 70, 2)))
    known = in_common(shown, features.modes, features.relative_sigma**2, PRIOR, is_adjusted=False)
    free = in_common(shown, features.modes, features.relative_sigma**2, PRIOR)
    assert known.covariance[6, 6] < free.covariance[6, 6]
    np.testing.assert_allclose(known.by_pose[:, :, MODES:], [each.by_camera for each in shown])
