"""The tracks' own error is estimated from their neighbours; hills, roofs and few tracks do not bias it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from onboard.geometry.plane_homography import move
from onboard.vision.track_consistency import MAX_DISPERSION_PX, are_inconsistent, dispersion_px

Array = NDArray[np.float64]

MOTION = np.array([[1.01, 0.03, 22.0], [-0.02, 0.99, -14.0], [1e-5, -2e-5, 1.0]])


def tracks(sigma_px: float, seed: int = 0, count: int = 90) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    at = rng.uniform([10.0, 10.0], [630.0, 470.0], (count, 2))
    return at, move(MOTION, at) + sigma_px * rng.standard_normal(at.shape)


@given(st.floats(0.05, 5.0), st.integers(0, 1000))
def test_the_scatter_is_the_tracks_own_error(sigma_px: float, seed: int) -> None:
    assert 0.45 * sigma_px < dispersion_px(MOTION, *tracks(sigma_px, seed)) < 1.25 * sigma_px


def test_hills_are_not_scatter() -> None:
    """They move tracks by pixels, but neighbours alike."""
    at, to = tracks(0.1)
    to[:, 0] += 3.0 * np.sin(at[:, 0] / 100.0) * np.cos(at[:, 1] / 80.0)
    assert dispersion_px(MOTION, at, to) < 0.3


@pytest.mark.parametrize("angle_rad", [0.0, 0.6, 1.9])
def test_roofs_next_to_streets_are_not_scatter(angle_rad: float) -> None:
    """Neighbours differ by many pixels, all along the travel."""
    at, to = tracks(0.1)
    roofs = np.random.default_rng(1).random(len(at)) < 0.5
    to[roofs] += 12.0 * np.array([np.cos(angle_rad), np.sin(angle_rad)])
    assert not are_inconsistent(MOTION, at, to, 1.0, 640)
    assert dispersion_px(MOTION, at, to) < 1.3


def test_tracks_that_are_pixels_off_each_other_are_not_accepted() -> None:
    assert are_inconsistent(MOTION, *tracks(2.0 * MAX_DISPERSION_PX), 1.0, 640)
    assert not are_inconsistent(MOTION, *tracks(2.0 * MAX_DISPERSION_PX), 1.0, 1920)
    assert not are_inconsistent(MOTION, *tracks(0.5 * MAX_DISPERSION_PX), 1.0, 640)


def test_where_most_features_were_lost_the_rest_must_agree_better() -> None:
    half_lost = tracks(0.6 * MAX_DISPERSION_PX, count=40)
    assert not are_inconsistent(MOTION, *half_lost, 1.0, 640)
    assert are_inconsistent(MOTION, *half_lost, 0.4, 640)
    assert not are_inconsistent(MOTION, *tracks(0.05, count=40), 0.4, 640)
