"""A thing is known again over any ground by its own grey, and another thing or the ground alone is not taken for it."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from onboard.tracks.backdrop import Change, Patch
from onboard.tracks.looks import Look, Wanted, cover_of

Image = NDArray[np.float32]
HALF, SIGMA, SPREAD = 6, 2.5, 12.0
ROWS, COLUMNS = np.mgrid[: 2 * HALF + 1, : 2 * HALF + 1]
COVER = cv2.GaussianBlur(
    ((np.abs(ROWS - HALF) <= 2) & (np.abs(COLUMNS - HALF) <= 2)).astype(np.float32), (0, 0), 0.6
)  # five pixels wide


def over(ground: Image, grey: float, rng: np.random.Generator, cover: Image = COVER) -> Image:
    """The picture of a thing of that grey over the ground, with its noise and its own spots."""
    spots = rng.normal(0.0, SPREAD, ground.shape)
    return np.asarray(ground + cover * (grey + spots - ground) + rng.normal(0.0, SIGMA, ground.shape), np.float32)


def ground_of(level: float, rng: np.random.Generator) -> Image:
    return np.asarray(level + cv2.GaussianBlur(rng.normal(0.0, 25.0, COVER.shape), (0, 0), 1.5), np.float32)


def wanted(rng: np.random.Generator) -> Wanted:
    """A thing of grey 150 that was seen over ground of 90; its cover is what differed."""
    ground = ground_of(90.0, rng)
    image = over(ground, 150.0, rng)
    patch = Patch(image, np.zeros(2, np.int64))
    middle = np.array([HALF, HALF], float)
    differs = np.clip((np.abs(image - ground) / SIGMA - 2.5) / 3.5, 0.0, 1.0).astype(np.float32)
    change = Change(patch.corner, differs, ground, np.full_like(ground, SIGMA))
    cover = cover_of(patch, change, None, middle)
    look = Look(0, patch, middle, np.zeros(2), np.eye(2), cover)
    return Wanted.of([look], HALF, 5.0, np.zeros(2), SPREAD)


@pytest.mark.parametrize("level", [60.0, 90.0, 210.0, 240.0])
def test_the_thing_is_likelier_than_another_over_any_ground_that_it_differs_from(level: float) -> None:
    """(24.23), of a hundred draws; the correlation with its look over dark ground is negative over bright."""
    its, anothers, alone, correlated = [], [], [], []
    for seed in range(100):
        rng = np.random.default_rng(seed)
        one, ground = wanted(rng), ground_of(level, rng)
        sigma = np.full_like(ground, SIGMA)
        image = over(ground, 150.0, rng)
        its.append(one.log_ratio(image, ground, sigma))
        anothers.append(one.log_ratio(over(ground, 20.0, rng), ground, sigma))
        alone.append(one.log_ratio(over(ground, 0.0, rng, np.zeros_like(COVER)), ground, sigma))
        wide = np.pad(image, HALF, mode="edge")
        correlated.append(float(one.likeness(wide)[HALF, HALF]))
    assert np.quantile(its, 0.05) > 4.0 and 8.0 < np.median(its) < 22.0
    assert np.quantile(anothers, 0.95) < -50.0  # 20 is no 150
    assert np.quantile(alone, 0.95) < -50.0
    assert np.median(correlated) < -0.5 if level > 150.0 else np.median(correlated) > 0.8


def test_without_a_cover_nothing_is_weighed() -> None:
    rng = np.random.default_rng(0)
    ground = ground_of(90.0, rng)
    patch = Patch(ground, np.zeros(2, np.int64))
    middle = np.array([HALF, HALF], float)
    look = Look(0, patch, middle, np.zeros(2), np.eye(2), cover_of(patch, None, None, middle))
    one = Wanted.of([look], HALF, 5.0, np.zeros(2), SPREAD)
    assert one.log_ratio(ground, ground, np.full_like(ground, SIGMA)) == -np.inf


def test_the_cover_keeps_what_the_ground_hides() -> None:
    """Over ground of its own grey nothing differs: the cover stays, and is learned where thing and ground differ."""
    rng = np.random.default_rng(3)
    one = wanted(rng)
    same = np.full(COVER.shape, 150.0, np.float32)
    patch = Patch(over(same, 150.0, rng), np.zeros(2, np.int64))
    middle = np.array([HALF, HALF], float)
    nothing = Change(patch.corner, np.zeros_like(same), same, np.full_like(same, 12.0))
    kept = cover_of(patch, nothing, one, middle)
    assert float(kept.sum()) == pytest.approx(float(one.cover.sum()), rel=0.05)
    dark = Change(patch.corner, np.zeros_like(same), np.full_like(same, 60.0), np.full_like(same, 2.0))
    gone = cover_of(patch, dark, one, middle)
    assert 0.6 * float(one.cover.sum()) < float(gone.sum()) < 0.8 * float(one.cover.sum())
