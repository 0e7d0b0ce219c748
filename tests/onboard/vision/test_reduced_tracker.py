"""Large pictures tracked at a working size: pixels and motions are the full picture's, and more pixels lose nothing."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from onboard.geometry.plane_homography import move
from onboard.vision.klt_tracker import Tracker
from onboard.vision.reduced_tracker import WORKING_PX, ReducedTracker, tracker_for
from tests.rest_long import rest_long

FEATURES = 100


def ground(seed: int, size: int) -> NDArray[np.uint8]:
    rng = np.random.default_rng(seed)
    out = np.zeros((size, size), np.float32)
    for level in range(1, 9):
        small = rng.standard_normal((max(size >> level, 2),) * 2).astype(np.float32)
        out += cv2.resize(small, (size, size), interpolation=cv2.INTER_CUBIC) * 1.3**level
    return np.asarray(np.clip(128.0 + 40.0 * out / out.std(), 0, 255), np.uint8)


def pair(width: int, shift: float, seed: int = 0) -> tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.float64]]:
    """Two pictures `width` wide and the motion between them: moved by a share of the width, turned by 4 degrees."""
    height = 3 * width // 4
    texture = ground(seed, 2 * width)
    turn = cv2.getRotationMatrix2D((width / 2, height / 2), 4.0, 1.0)
    H = np.vstack([turn, [0.0, 0.0, 1.0]])
    H[:2, 2] += shift * width, 0.3 * shift * width
    place = np.array([[1.0, 0.0, -0.5 * width], [0.0, 1.0, -0.5 * height], [0.0, 0.0, 1.0]])
    first, second = (
        cv2.GaussianBlur(cv2.warpPerspective(texture, M, (width, height)), (0, 0), 1.0) for M in (place, H @ place)
    )
    return np.asarray(first, np.uint8), np.asarray(second, np.uint8), H


def followed(tracker: Tracker, first: NDArray[np.uint8], second: NDArray[np.uint8], H: NDArray[np.float64]) -> float:
    """Share of the features that should be in sight which are found again where they are; none may be elsewhere."""
    tracker.promote(tracker.track(first, None))
    ids, uv = tracker.keyframe_features
    tracks = tracker.track(second, None)
    height, width = first.shape
    expected = move(H, uv)
    in_sight = np.all((expected > 40) & (expected < [width - 40, height - 40]), axis=1)
    assert np.all(np.isin(tracks.ids, ids))
    if not len(tracks):
        return 0.0
    miss = np.linalg.norm(tracks.uv_px - move(H, tracks.keyframe_uv_px), axis=1)
    assert np.median(miss) < 0.5 * max(1.0, width / WORKING_PX)
    assert np.abs(tracks.motion - H)[:2, :2].max() < 0.01
    return len(tracks) / max(np.count_nonzero(in_sight), 1)


def test_small_pictures_are_tracked_as_they_are() -> None:
    assert type(tracker_for((1640, 1232), FEATURES)) is Tracker
    assert isinstance(tracker_for((1920, 1080), FEATURES), ReducedTracker)
    assert isinstance(tracker_for((1080, 1920), FEATURES), ReducedTracker)


@pytest.mark.parametrize("width", rest_long([2000, 2400, 4000]))
def test_pixels_and_motions_are_the_full_picture_s(width: int) -> None:
    first, second, H = pair(width, 0.1)
    assert followed(tracker_for((width, 3 * width // 4), FEATURES), first, second, H) > 0.6


def test_a_motion_that_is_predicted_is_predicted_in_full_pixels() -> None:
    first, second, H = pair(2000, 0.35, seed=3)
    tracker = tracker_for((2000, 1500), FEATURES)
    tracker.promote(tracker.track(first, None))
    tracks = tracker.track(second, H)
    assert len(tracks) > 30
    assert np.median(np.linalg.norm(tracks.uv_px - move(H, tracks.keyframe_uv_px), axis=1)) < 0.5


@pytest.mark.long  # short: pixels and motions are the full picture's
@pytest.mark.parametrize("large_px", [2800, 4000])
def test_more_pixels_of_the_same_ground_lose_no_features(large_px: int) -> None:
    """Of a sensor whose pixels are noisy and blurred, as many are found as of the same picture at 1600 px."""
    rng = np.random.default_rng(5)
    shares = []
    first, second, H = pair(large_px, 0.25, seed=7)
    noisy = [np.clip(p + 15.0 * rng.standard_normal(p.shape), 0, 255).astype(np.uint8) for p in (first, second)]
    for width in (1600, large_px):
        scale = width / large_px
        size = width, 3 * width // 4
        pictures = [np.asarray(cv2.resize(p, size, interpolation=cv2.INTER_AREA), np.uint8) for p in noisy]
        shrink = np.array([[scale, 0.0, 0.5 * scale - 0.5], [0.0, scale, 0.5 * scale - 0.5], [0.0, 0.0, 1.0]])
        share = followed(tracker_for(size, FEATURES), *pictures, shrink @ H @ np.linalg.inv(shrink))
        shares.append(share)
    assert min(shares) > 0.6 and shares[1] > shares[0] - 0.1, shares
