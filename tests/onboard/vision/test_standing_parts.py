"""What stands still while the ground moves is found: all of it, nothing of the ground, and forgotten when it goes."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from onboard.vision.reduced_tracker import tracker_for
from onboard.vision.standing_parts import MOST_SHARE, WORKING_PX, StandingParts, _halved
from tests.on_screen_display import Picture, display_parts, displayed
from tests.rest_long import rest_long

SIZE_PX = 640, 480
STEP_PX = 20.0
RATE_HZ = 5.0


def cloudy(seed: int, size_px: tuple[int, int], contrast: float = 25.0) -> NDArray[np.float32]:
    rng, (width, height) = np.random.default_rng(seed), size_px
    ground = np.zeros((height, width), np.float32)
    for sigma in (1.5, 4.0, 12.0):
        layer = cv2.GaussianBlur(rng.normal(0.0, 1.0, (height, width)).astype(np.float32), (0, 0), sigma)
        ground += layer / layer.std()
    return np.asarray(120.0 + contrast * ground / ground.std(), np.float32)


def passing(ground: NDArray[np.float32], step_px: Sequence[float], count: int, seed: int = 1) -> Iterator[Picture]:
    """Pictures of a ground that moves by `step_px` each, back and forth where it ends, each with its own noise."""
    rng, (width, height) = np.random.default_rng(seed), SIZE_PX
    room = np.array([ground.shape[1] - width, ground.shape[0] - height], float)
    at, step = 0.5 * room, np.array(step_px, float)
    for _ in range(count):
        shift = np.array([[1.0, 0.0, -at[0]], [0.0, 1.0, -at[1]]])
        seen = cv2.warpAffine(ground, shift, SIZE_PX) + 2.0 * rng.standard_normal((height, width), np.float32)
        yield np.clip(seen, 0, 255).astype(np.uint8)
        outside = (at + step < 0.0) | (at + step > room)
        step[outside] *= -1.0
        at = at + step


def motions(
    pictures: Sequence[Picture], step_px: Sequence[float], ground_px: Sequence[int]
) -> list[NDArray[np.float64]]:
    """The motion (3, 3) of each of `passing`'s pictures since the first."""
    room = np.array([ground_px[0] - SIZE_PX[0], ground_px[1] - SIZE_PX[1]], float)
    at, step, out = 0.5 * room, np.array(step_px, float), []
    for _ in pictures:
        H = np.eye(3)
        H[:2, 2] = 0.5 * room - at
        out.append(H)
        outside = (at + step < 0.0) | (at + step > room)
        step[outside] *= -1.0
        at = at + step
    return out


def watched(pictures: Sequence[Picture], stated: Sequence[NDArray[np.float64] | None]) -> StandingParts:
    parts = StandingParts((pictures[0].shape[1], pictures[0].shape[0]))
    for picture, H in zip(pictures, stated, strict=True):
        parts.see(picture, (H, None))
    return parts


def over(
    ground: NDArray[np.float32], count: int, step_px: Sequence[float] = (STEP_PX, 6.0)
) -> tuple[list[Picture], list[NDArray[np.float64]]]:
    pictures = list(passing(ground, step_px, count))
    return pictures, motions(pictures, step_px, (ground.shape[1], ground.shape[0]))


def shares(parts: StandingParts, seconds: float) -> tuple[float, float]:
    """Shares of the display that is masked, and of what is further from it than 24 px."""
    truth = display_parts(SIZE_PX, seconds)
    near = np.asarray(cv2.dilate(truth.astype(np.uint8), np.ones((49, 49), np.uint8))) > 0
    return float(parts.mask[truth].mean()), float(parts.mask[~near].mean())


@pytest.mark.parametrize(("opacity", "count"), rest_long([(1.0, 60), (0.5, 120)]))
def test_a_display_is_found_with_its_changing_numbers_and_nothing_next_to_it(opacity: float, count: int) -> None:
    pictures, stated = over(cloudy(1, (1600, 1000)), count)
    shown = [displayed(picture, k / RATE_HZ, opacity) for k, picture in enumerate(pictures)]
    parts = watched(shown, stated)
    found, false = shares(parts, (count - 1) / RATE_HZ)
    assert found > 0.95 and false < 0.002
    assert 0.05 < parts.share < 0.15


@pytest.mark.parametrize("seed", rest_long(range(3)))
def test_ground_is_never_called_whichever_way_it_moves(seed: int) -> None:
    rng = np.random.default_rng(seed)
    angle = rng.uniform(0.0, 2.0 * np.pi)
    step_px = (STEP_PX * np.cos(angle), STEP_PX * np.sin(angle))
    assert watched(*over(cloudy(seed + 10, (1600, 1200)), 120, step_px)).share == 0.0


@pytest.mark.long
def test_edges_along_the_flight_and_rows_across_it_stand_still_only_to_the_eye() -> None:
    """A road that the aircraft follows, and a field whose rows are as far apart as the ground moves."""
    road = cloudy(5, (1600, 600), 4.0)
    road[300:340] += 70.0
    assert watched(*over(road, 120, (STEP_PX, 0.0))).share == 0.0
    rows = cloudy(6, (1600, 600), 4.0) + 40.0 * np.sin(2.0 * np.pi * np.arange(1600) / STEP_PX)
    assert watched(*over(np.asarray(rows, np.float32), 120, (STEP_PX, 0.0))).share == 0.0


@pytest.mark.parametrize("size_px", [(640, 480), (636, 480), (1640, 1232), (1920, 1080), (100, 80)])
def test_a_picture_halved_first_is_reduced_to_the_same_one(size_px: tuple[int, int]) -> None:
    picture = np.clip(cloudy(3, size_px), 0, 255).astype(np.uint8)
    share = min(1.0, WORKING_PX / max(size_px))
    small_px = round(share * size_px[0]), round(share * size_px[1])
    halved = _halved(picture, small_px)
    assert halved.shape[1] % 2 or halved.shape[0] % 2 or halved.shape[1] < 4 * small_px[0]
    once, twice = (cv2.resize(some, small_px, interpolation=cv2.INTER_AREA) for some in (picture, halved))
    off = once.astype(float) - twice
    assert off.std() < 0.08 * picture.std() and abs(off.mean()) < 0.5  # pixels at a cell's edge count by halves


def test_sky_and_water_have_nothing_to_be_called_and_a_display_before_them_has() -> None:
    ground = cloudy(7, (1600, 1000))
    pictures, stated = over(ground, 60)
    rng, shading = np.random.default_rng(2), np.linspace(200.0, 230.0, SIZE_PX[0])
    for picture in pictures:  # the upper half is sky, brighter towards the sun, with the sensor's own noise
        picture[:240] = np.clip(shading + rng.normal(0.0, 2.0, (240, SIZE_PX[0])), 0, 255).astype(np.uint8)
    assert watched(pictures, stated).mask[:200].mean() == 0.0
    parts = watched([displayed(picture, k / RATE_HZ) for k, picture in enumerate(pictures)], stated)
    assert parts.mask[display_parts(SIZE_PX, 59 / RATE_HZ)].mean() > 0.95


def test_in_a_hover_at_rest_or_frozen_nothing_is_learned() -> None:
    (picture,) = passing(cloudy(8, (1600, 1000)), (0.0, 0.0), 1)
    rng = np.random.default_rng(3)
    hovering = [np.clip(picture + rng.normal(0.0, 2.0, picture.shape), 0, 255).astype(np.uint8) for _ in range(60)]
    assert watched(hovering, [np.eye(3)] * 60).share == 0.0
    _, stated = over(cloudy(8, (1600, 1000)), 60)
    assert watched(hovering, stated).share == 0.0  # telemetry says that it moves, and nothing does


def test_a_display_that_is_switched_off_is_forgotten() -> None:
    pictures, stated = over(cloudy(9, (1600, 1000)), 120)
    parts = StandingParts(SIZE_PX)
    shares_then = []
    for k, (picture, H) in enumerate(zip(pictures, stated, strict=True)):
        parts.see(displayed(picture, k / RATE_HZ) if k < 60 else picture, (H, None))
        shares_then.append(parts.share)
    assert shares_then[59] > 0.05 and shares_then[-1] == 0.0


def test_what_covers_nearly_all_is_not_what_is_left_out() -> None:
    pictures, stated = over(cloudy(11, (1600, 1000)), 60)
    cover = cloudy(12, SIZE_PX).astype(np.uint8)
    for picture in pictures:
        picture[: round(480 * (MOST_SHARE + 0.1))] = cover[: round(480 * (MOST_SHARE + 0.1))]
    assert watched(pictures, stated).share == 0.0


def followed(pictures: Sequence[Picture]) -> tuple[list[float], list[float]]:
    """A tracker without telemetry: of each picture the share that stands, and the motion (px) since the one before."""
    tracker = tracker_for(SIZE_PX, 100)
    standing, moved = [], []
    last = np.eye(3)
    for picture in pictures:
        tracks = tracker.track(picture, None)
        standing.append(tracker.left_out_shares[1])
        moved.append(float(np.linalg.norm((tracks.motion @ np.linalg.inv(last))[:2, 2])) if len(tracks) else np.nan)
        last = tracks.motion
        shift = np.linalg.norm(tracks.motion[:2, 2])
        if not len(tracks) or shift > 60.0:
            tracker.promote(tracks)
            last = np.eye(3)
    return standing, moved


@pytest.mark.long
def test_a_tracker_that_the_display_has_blinded_finds_the_ground() -> None:
    """Rows of letters before a ground of little contrast; no one tells where the aircraft moves."""
    pictures = list(passing(cloudy(4, (1600, 1000), 9.0), (STEP_PX, 6.0), 70))
    for picture in pictures:
        for row in range(60, SIZE_PX[1], 60):
            cv2.putText(picture, "ALT 123 SPD 17 HDG 271 BAT 15.2", (10, row), cv2.FONT_HERSHEY_SIMPLEX, 1.0, 250.0, 3)
    standing, moved = followed(pictures)
    assert np.isnan(moved[:20]).all()
    assert MOST_SHARE > standing[-1] > 0.3
    assert np.median(moved[-15:]) == pytest.approx(float(np.hypot(STEP_PX, 6.0)), abs=0.5)


def real_windows(path: Path, count: int) -> Iterator[Picture]:
    """A window that passes over a photograph, with a sensor's noise."""
    ground = np.asarray(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), np.float32)
    yield from passing(ground, (17.0, 10.0), count)


@pytest.mark.parametrize("number", rest_long([0, 20, 40]))
def test_real_ground_is_never_called_and_a_display_over_it_is_found(shared_data: Path, number: int) -> None:
    photographs = sorted((shared_data / "caliterra" / "frames").iterdir())
    assert len(photographs) == 50
    pictures = list(real_windows(photographs[number], 50))
    assert followed(pictures)[0][-1] == 0.0
    assert followed([displayed(picture, k / RATE_HZ) for k, picture in enumerate(pictures)])[0][-1] > 0.05
