"""Areas of things that the lens has blurred are those of the things, from some two pixels across on."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from onboard.spots.blurred_area import LEAST, unblurred
from onboard.spots.contrast import contrast
from onboard.spots.regions import LENS_PX, about_peak, peaks, region_of

FINER = 8
PIXEL_M = 0.15


def blurred_disc(diameter_px: float, blur_px: float, middle: tuple[float, float]) -> NDArray[np.float32]:
    """A disc of height 1 in a picture (96, 128), each pixel the mean of its parts."""
    rows, columns = ((np.arange(size * FINER) + 0.5) / FINER - 0.5 for size in (96, 128))
    away = np.hypot(columns[None] - middle[0], rows[:, None] - middle[1])
    fine = cv2.GaussianBlur((away < 0.5 * diameter_px).astype(np.float32), (0, 0), blur_px * FINER)
    return np.asarray(cv2.resize(fine, (128, 96), interpolation=cv2.INTER_AREA), np.float32)


@pytest.mark.parametrize("radius", [0.75, 1.0, 2.0, 4.0, 8.0])
def test_the_area_at_half_height_of_a_blurred_disc_gives_the_disc_back(radius: float) -> None:
    blur_px = min(12.0, 32.0 / radius)
    sampled = blurred_disc(2.0 * radius * blur_px, blur_px, (64.0, 48.0))
    seen = float(np.count_nonzero(sampled > 0.5 * sampled.max()))
    assert unblurred(seen, blur_px) == pytest.approx(np.pi * (blur_px * radius) ** 2, rel=0.15)


def test_without_blur_nothing_changes_far_above_it_little_and_below_it_little_is_left() -> None:
    assert unblurred(2.0, 0.0) == 2.0 and 500.0 < unblurred(500.0, 1.0) < 505.0
    assert unblurred(1.0, 1.0) == pytest.approx(LEAST * np.pi)
    seen = np.linspace(0.1, 600.0, 500)
    assert np.all(np.diff([unblurred(float(a), 1.0) for a in seen]) >= 0.0)


@pytest.mark.parametrize("across_px", [2.5, 3.4, 4.5, 7.0])
def test_the_outline_of_a_thing_in_a_picture_gives_its_area_on_both_sides_of_the_truth(across_px: float) -> None:
    rng, found = np.random.default_rng(1), []
    for _ in range(10):
        u, v = np.array([64.0, 48.0]) + rng.uniform(-0.5, 0.5, 2)
        ground = 290.0 + 0.05 * rng.standard_normal((96, 128))
        values = (ground + 8.0 * blurred_disc(across_px, LENS_PX, (u, v))).astype(np.float32)
        c = contrast(values, np.ones((24, 32), bool), across_px * PIXEL_M, PIXEL_M)
        part = about_peak(c.excess, tuple(peaks(c, 10.0, 1)[0]), 8, 1.0)
        assert part is not None
        region = region_of(c, part, 10.0)
        x, y = region.outline_px.T
        seen = 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))
        found.append(unblurred(seen, region.blur_px) / (0.25 * np.pi * across_px**2))
    assert 0.8 < np.median(found) < 1.25 and np.std(found) < 0.3
