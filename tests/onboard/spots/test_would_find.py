"""Where a person would be found: as people who are put into the picture one at a time are found there."""

import cv2
import numpy as np
import pytest

from contract.spot import PERSON_GRID, PERSON_K, PERSON_M2
from onboard.spots.contrast import Contrast, Image, contrast
from onboard.spots.regions import LENS_PX, about_peak, peaks, size_limits
from onboard.spots.would_find import found_by_part

PIXEL_M = 0.4
SIZES_M = (0.32, 0.63, 1.26)
EVERYWHERE = np.ones((4, 4), bool)


def contrasts_of(kelvin: Image) -> list[Contrast]:
    return [contrast(kelvin, EVERYWHERE, side_m, PIXEL_M) for side_m in SIZES_M]


@pytest.fixture(scope="module")
def kelvin() -> Image:
    """A picture (120, 160) of ground that varies over two pixels, five times less in its left half."""
    rng = np.random.default_rng(1)
    ground = cv2.GaussianBlur(rng.standard_normal((120, 160)), (0, 0), 1.0)
    ground *= np.where(np.arange(160) < 80, 0.4, 2.0) / ground.std()
    return np.asarray(290.0 + ground + 0.05 * rng.standard_normal(ground.shape), np.float32)


def with_person(kelvin: Image, u: float, v: float) -> Image:
    """Half a metre across with its middle at a pixel (u, v), through the lens."""
    half = 0.5 * np.sqrt(PERSON_M2) / PIXEL_M
    cover = [
        np.clip(np.minimum(np.arange(n) + 0.5, m + half) - np.maximum(np.arange(n) - 0.5, m - half), 0.0, 1.0)
        for n, m in zip(kelvin.shape, (v, u), strict=True)
    ]
    person = cv2.GaussianBlur(np.outer(*cover).astype(np.float32), (0, 0), LENS_PX)
    return np.asarray(kelvin + np.float32(PERSON_K) * person, np.float32)


def is_found(kelvin: Image, u: float, v: float, thresholds: dict[float, float]) -> bool:
    """As the search finds it: a local maximum over the threshold, of the thing's size."""
    for c in contrasts_of(with_person(kelvin, u, v)):
        reach_px, least_px = size_limits(c, PIXEL_M)
        for row, column in peaks(c, thresholds[c.side_m], 400).tolist():
            at = (np.array([column, row]) + 0.5) * c.times - 0.5
            is_it = float(np.hypot(*(at - (u, v)))) < 2.0 * c.times
            if is_it and about_peak(c.excess, (row, column), reach_px, least_px) is not None:
                return True
    return False


@pytest.mark.parametrize("thresholds", [(2.6, 1e9, 1e9), (1e9, 5.0, 1e9), (1e9, 1e9, 5.0), (3.0, 5.5, 6.0)])
def test_the_share_of_a_part_is_that_of_people_who_are_put_there_and_found(
    kelvin: Image, thresholds: tuple[float, ...]
) -> None:
    by_size = dict(zip(SIZES_M, thresholds, strict=True))
    stated = np.array(found_by_part(kelvin, contrasts_of(kelvin), by_size, PIXEL_M), float).reshape(PERSON_GRID)
    columns = np.array([stated[:, :2].mean(), stated[:, 3:].mean()])
    rng, found = np.random.default_rng(4), np.zeros((2, 100), bool)
    for side, k in np.ndindex(found.shape):
        found[side, k] = is_found(kelvin, 96.0 * side + rng.uniform(3.0, 60.0), rng.uniform(3.0, 116.0), by_size)
    assert np.abs(columns - found.mean(axis=1)).max() < 0.12  # 2.4 sigmas of 100 people, at half
    assert np.any((columns > 0.1) & (columns < 0.98))
