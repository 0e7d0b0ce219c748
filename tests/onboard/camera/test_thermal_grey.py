"""Counts to the grey that is tracked: spread steadily, the sensor's own pattern off, a shutter event waited out."""

import cv2
import numpy as np
import pytest

from onboard.camera.thermal_grey import GAIN_STEP, SMOOTHED_PX, ThermalGrey

SIZE = (120, 160)
GROUND_K = cv2.GaussianBlur(np.random.default_rng(1).standard_normal((900, 900)), (0, 0), 2.5)
GROUND_K *= 0.8 / GROUND_K.std()


def ground(step: int, step_px: int = 7) -> np.ndarray:
    at = 5 + step * step_px
    return GROUND_K[at : at + SIZE[0], at : at + SIZE[1]] + 288.0


def counts(kelvin: np.ndarray, noise: int, netd_k: float = 0.05, pattern: np.ndarray | float = 0.0) -> np.ndarray:
    own = netd_k * np.random.default_rng([7, noise]).standard_normal(SIZE) + pattern
    return np.rint(100.0 * (kelvin + own)).astype(np.uint16)


def pattern(seed: int, sigma_k: float = 0.2) -> np.ndarray:
    rng = np.random.default_rng([9, seed])
    return sigma_k * np.asarray(rng.standard_normal(SIZE) + rng.standard_normal(SIZE[1])) / np.sqrt(2.0)


def own_share(grey: np.ndarray, own: np.ndarray) -> float:
    """Correlation of a picture's finest detail with a pattern's, as smoothed as the picture is."""
    smooth = cv2.GaussianBlur(own, (0, 0), SMOOTHED_PX)
    fine = [a.astype(float) - cv2.blur(a.astype(float), (5, 5)) for a in (grey, smooth)]
    return float(np.corrcoef(fine[0].ravel(), fine[1].ravel())[0, 1])


def test_a_kelvin_of_ground_fills_the_scale_and_a_fire_does_not_take_it() -> None:
    plain, burning = ThermalGrey(), ThermalGrey()
    scene = ground(0)
    fire = scene.copy()
    fire[40:60, 50:80] = 600.0
    a, b = plain.picture(counts(scene, 0))[0], burning.picture(counts(fire, 0))[0]
    outside = np.ones(SIZE, bool)
    outside[40:60, 50:80] = False
    assert 20.0 < a.std() < 60.0
    assert np.abs(a[outside].astype(int) - b[outside]).mean() < 6.0 and (b[~outside] == 255).all()


def test_counts_are_handed_on_as_they_are() -> None:
    raw = counts(ground(0), 0)
    np.testing.assert_array_equal(ThermalGrey().picture(raw)[1], raw)
    luma = ((raw - raw.min()) // 3).clip(0, 255).astype(np.uint8)
    image, own = ThermalGrey().picture(luma)
    assert image.dtype == np.uint8 and np.corrcoef(image.ravel(), luma.ravel())[0, 1] > 0.95
    assert own.dtype == np.uint16 and np.array_equal(own, luma)


def test_the_stretch_changes_slowly_and_not_with_the_offset() -> None:
    thermal = ThermalGrey()
    first = thermal.picture(counts(ground(0), 0, 0.0))[0]
    warmer = thermal.picture(counts(ground(0) + 3.0, 0, 0.0))[0]
    assert np.abs(first.astype(int) - warmer).max() <= 1
    contrasty = thermal.picture(counts(288.0 + 4.0 * (ground(0) - 288.0), 0, 0.0))[0]
    middle = (np.abs(first.astype(int) - 128) < 25) & (np.abs(first.astype(int) - 128) > 10)
    ratio = np.median((contrasty[middle].astype(float) - 128.0) / (first[middle].astype(float) - 128.0))
    assert 4.0 * (1.0 - 2.0 * GAIN_STEP) < ratio < 4.0 * (1.0 + GAIN_STEP)


def test_noise_from_pixel_to_pixel_is_smoothed_and_ground_is_not() -> None:
    noise = np.std(
        [ThermalGrey().picture(counts(ground(0), k, 0.2))[0].astype(float) for k in range(12)], axis=0
    ).mean()
    plain = ThermalGrey().picture(counts(ground(0), 0, 0.0))[0]
    levels = 40.0 / (1.349 * 0.8)  # a kelvin
    assert 0.2 * 0.35 * levels < noise < 0.2 * 0.55 * levels
    assert plain.std() == pytest.approx(0.8 * levels, rel=0.15)


def test_the_same_counts_again_are_the_same_picture() -> None:
    thermal = ThermalGrey()
    for step in range(12):
        last = thermal.picture(counts(ground(step), step))[0]
    np.testing.assert_array_equal(thermal.picture(counts(ground(11), 11))[0], last)


@pytest.mark.parametrize("sigma_k", [0.1, 0.3])
def test_a_fixed_pattern_is_taken_off_while_the_ground_moves(sigma_k: float) -> None:
    thermal, own = ThermalGrey(), pattern(1, sigma_k)
    pictures = [thermal.picture(counts(ground(step), step, 0.05, own))[0] for step in range(60)]
    first, last = own_share(pictures[0], own), own_share(pictures[-1], own)
    assert first > 1.5 * sigma_k and abs(last) < 0.3 * first


def test_without_a_pattern_nothing_is_taken_off_that_would_be_seen() -> None:
    thermal, plain = ThermalGrey(), ThermalGrey()
    for step in range(60):
        raw = counts(ground(step), step)
        seen = thermal.picture(raw)[0]
    alone = plain.picture(raw)[0]
    assert np.std(seen.astype(float) - alone) < 0.25 * np.std(alone.astype(float))


def test_after_a_shutter_event_the_new_pattern_is_learned() -> None:
    thermal, before, after = ThermalGrey(), pattern(1), pattern(2)
    for step in range(40):
        thermal.picture(counts(ground(step), step, 0.05, before))
    closed = counts(ground(39), 39, 0.05, before)
    for _ in range(4):
        thermal.picture(closed)
    jumped = thermal.picture(counts(ground(40), 40, 0.05, after + 1.5))[0]
    assert abs(own_share(jumped, before)) < 0.1  # the old one is not taken off the new picture
    for step in range(41, 90):
        last = thermal.picture(counts(ground(step), step, 0.05, after + 1.5))[0]
    assert abs(own_share(last, after)) < 0.25


def test_ground_that_stands_still_is_not_taken_for_the_sensors_own() -> None:
    thermal, plain = ThermalGrey(), ThermalGrey()
    sharp = ground(0) + np.where(np.random.default_rng(3).uniform(size=SIZE) < 0.05, 1.0, 0.0)  # stones, in a hover
    for step in range(80):
        seen = thermal.picture(counts(sharp, step))[0]
    alone = plain.picture(counts(sharp, 79))[0]
    assert np.abs(seen.astype(int) - alone).max() <= 1
