"""Pixel noise of a fisheye, (30.4): round in what the adjustment weighs, and no wider or narrower than it is."""

import numpy as np
import pytest

from contract.camera import Camera
from onboard.estimation.keyframe import observation
from onboard.estimation.noise_shape import rounded, shape_of
from onboard.estimation.resection import Sighted, resect

FISHEYE = Camera(640, 480, 250.0, 252.0, 322.0, 236.0, (-0.031, 0.012, -0.006, 0.0011), "fisheye")


def test_noise_of_a_pixel_is_round_in_what_is_weighed_and_of_the_stated_size() -> None:
    rng = np.random.default_rng(0)
    uv = rng.uniform([20.0, 20.0], [620.0, 460.0], (300, 2))
    uv = uv[np.hypot(*(uv - [322.0, 236.0]).T) < 330.0]  # 75 degrees
    seen = observation(FISHEYE, np.arange(len(uv)), uv)
    noisy = FISHEYE.unproject(uv[None] + rng.normal(0.0, 0.1, (400, len(uv), 2)))[0][..., :2]
    off = (noisy - seen.xy).transpose(0, 2, 1)
    shape = shape_of(FISHEYE, seen.xy.T[None])
    assert np.abs(shape[0, 0] * shape[0, 1] - shape[0, 2] ** 2 - 1.0).max() < 1e-9
    weighed = np.stack([rounded(shape, each[None])[0] for each in off]) / (0.1 * seen.gain)
    covariance = np.einsum("nip,njp->pij", weighed, weighed) / len(weighed)
    assert np.abs(covariance - np.eye(2)).max() < 0.35
    assert np.abs(covariance.mean(axis=0) - np.eye(2)).max() < 0.02
    plain = np.linalg.eigvalsh(np.einsum("nip,njp->pij", off / seen.gain, off / seen.gain))
    assert np.quantile(plain[:, 1] / plain[:, 0], 0.9) > 5.0  # in the coordinates themselves it is not


def test_a_pinhole_s_noise_is_taken_for_round() -> None:
    assert shape_of(Camera.from_field_of_view(640, 480, 60.0), np.zeros((1, 2, 3))) is None
    assert shape_of(None, np.zeros((1, 2, 3))) is None


@pytest.mark.parametrize("seen_by", [FISHEYE, None])
def test_a_pose_from_a_fisheye_s_pixels_is_as_uncertain_as_it_states(seen_by: Camera | None) -> None:
    """With the noise's shape its normalised errors are those of six numbers, and twice that without."""
    rng, squares, sizes = np.random.default_rng(1), [], []
    wide = np.array([0.5] * 3 + [100.0] * 3)
    for _ in range(60):
        uv = rng.uniform([10.0, 10.0], [630.0, 470.0], (80, 2))
        rays, valid = FISHEYE.unproject(uv)
        valid &= np.hypot(*rays[:, :2].T) < 3.7
        points = (rays * rng.uniform(40.0, 60.0, (80, 1)))[valid]
        seen = observation(FISHEYE, np.arange(valid.sum()), uv[valid] + rng.normal(0.0, 0.3, (valid.sum(), 2)))
        rows = seen.ids
        sighted = Sighted(points[rows], seen.xy, 1.0 / (0.3 * seen.gain), seen_by)
        out = resect(sighted, np.eye(3), np.zeros(3), wide, scale=1e6, steps=12)
        off = np.concatenate([_log(out.R_cam_enu), out.centre_enu_m])
        squares.append(off @ out.information @ off)
        sizes.append(float(np.linalg.norm(out.centre_enu_m)))
    if seen_by is None:
        assert np.mean(squares) > 8.0
    else:
        assert 4.8 < np.mean(squares) < 7.2
        assert 0.02 < np.median(sizes) < 0.06


def _log(R: np.ndarray) -> np.ndarray:
    return 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
