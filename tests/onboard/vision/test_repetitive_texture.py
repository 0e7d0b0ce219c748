"""Self-likeness: pictures that repeat themselves are found to, others are not, and the tracker then asks telemetry."""

import cv2
import numpy as np
import pytest

from onboard.vision.contrast_normalisation import Picture, prepare
from onboard.vision.klt_tracker import Tracker, Tracks, is_nearest
from onboard.vision.repetitive_texture import repetition_px

SIZE = (320, 240)


def rows(period_px: float, shift_px: float = 0.0, crossed: bool = True, noise: float = 2.0) -> Picture:
    """Crop rows along a slant, crossed by weaker ones, under the sensor's noise."""
    u, v = np.meshgrid(np.arange(SIZE[0], dtype=float), np.arange(SIZE[1], dtype=float))
    along, across = 0.94 * (u - shift_px) + 0.34 * v, 0.94 * v - 0.34 * (u - shift_px)
    picture = np.sign(np.sin(2 * np.pi * along / period_px))
    if crossed:
        picture = picture + 0.6 * np.sign(np.sin(2 * np.pi * across / period_px))
    smooth = cv2.GaussianBlur(120.0 + 30.0 * picture, (0, 0), 0.8)
    smooth += noise * np.random.default_rng(1).standard_normal(smooth.shape)
    return np.asarray(np.clip(smooth, 0, 255), np.uint8)


def wild(seed: int) -> Picture:
    rng = np.random.default_rng(seed)
    layers = [cv2.GaussianBlur(rng.standard_normal(SIZE[::-1]), (0, 0), s) * s for s in (1.0, 2.0, 4.0, 8.0)]
    return np.asarray(np.clip(120.0 + 60.0 * sum(layers), 0, 255), np.uint8)


def features(picture: Picture) -> np.ndarray:
    tracker = Tracker(SIZE, 100)
    tracker.track(picture, None)
    return tracker.promote(tracker.nothing())[1]


@pytest.mark.parametrize("period_px", [12.0, 20.0, 32.0])
def test_rows_repeat_at_their_spacing(period_px: float) -> None:
    found = repetition_px(prepare(rows(period_px)), features(rows(period_px)))
    # The near edge of the twin's peak is taken, so a little less than the period.
    assert 0.6 * period_px < found < 1.1 * period_px


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_ground_without_twins_does_not_repeat(seed: int) -> None:
    assert repetition_px(prepare(wild(seed)), features(wild(seed))) is None


def test_too_few_features_say_nothing() -> None:
    picture = prepare(rows(20.0))
    assert repetition_px(picture, np.zeros((0, 2))) is None
    assert repetition_px(picture, np.full((3, 2), 120.0)) is None


def shifted(shift_px: float) -> np.ndarray:
    return np.array([[1.0, 0.0, shift_px], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])


def on_rows(
    period_px: float, moved_px: float, predicted_px: float | None, sigma_px: float | None
) -> tuple[Tracker, Tracks]:
    tracker = Tracker(SIZE, 100)
    tracker.track(rows(period_px), None)
    tracker.promote(tracker.nothing())
    predicted = None if predicted_px is None else shifted(predicted_px)
    return tracker, tracker.track(rows(period_px, moved_px), predicted, sigma_px)


@pytest.mark.parametrize(
    ("predicted_px", "sigma_px", "followed"),
    [(7.0, 3.0, True), (10.0, 3.0, True), (7.0, 6.0, False), (7.0, None, False), (None, None, False)],
)
def test_rows_are_followed_as_far_as_telemetry_tells_them_apart(
    predicted_px: float | None, sigma_px: float | None, followed: bool
) -> None:
    """The picture has moved by 7 px; rows are 20 px apart."""
    tracker, tracks = on_rows(20.0, 7.0, predicted_px, sigma_px)
    assert (len(tracks) > 30) is followed
    assert tracker.is_ambiguous is not followed  # which is not the same as too little texture
    if followed:
        assert np.median(tracks.uv_px[:, 0] - tracks.keyframe_uv_px[:, 0]) == pytest.approx(7.0, abs=0.3)


@pytest.mark.parametrize(("miss_px", "sigma_px"), [(0.0, 1.0), (2.0, 1.5), (0.0, 3.6)])
def test_of_a_thousand_sure_rows_none_is_the_next(miss_px: float, sigma_px: float) -> None:
    """Sampled errors of the prediction: of those whose nearest row is as far off, the share that is wrong."""
    spacing_px = 14.0
    error = np.random.default_rng(3).normal(0.0, sigma_px, 4_000_000)
    nearest = (error + 0.5 * spacing_px) % spacing_px - 0.5 * spacing_px
    equal = np.abs(np.abs(nearest) - miss_px) < 0.25
    wrong = np.mean(np.abs(error[equal] - nearest[equal]) > 1.0)
    assert is_nearest(spacing_px, miss_px, sigma_px) is bool(wrong < 1e-3)
    assert not is_nearest(spacing_px, 0.5 * spacing_px, sigma_px)


def test_a_step_that_telemetry_cannot_tell_to_half_a_row_is_not_followed() -> None:
    """60 px predicted to 9 px, rows 12 px apart; the same step over ground without twins is followed."""
    tracker, tracks = on_rows(12.0, 60.0, 60.0, 9.0)
    assert len(tracks) == 0 and tracker.is_ambiguous
    assert len(tracker.track(np.full(SIZE[::-1], 90, np.uint8), shifted(60.0), 9.0)) == 0
    other = Tracker(SIZE, 100)
    other.track(wild(4), None)
    other.promote(other.nothing())
    moved = np.asarray(cv2.warpAffine(wild(4), shifted(60.0)[:2], SIZE), np.uint8)
    assert len(other.track(moved, shifted(60.0))) > 30 and not other.is_ambiguous
