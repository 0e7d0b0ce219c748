"""Features found again in rendered pictures whose motion is known, and not found where they are not."""

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from contract.camera import Camera
from contract.rotations import R_ENU_NED, matrix_from_euler, mount_rotation
from onboard.geometry import plane_homography
from onboard.geometry.plane_homography import fit_homography
from onboard.vision.contrast_normalisation import Picture, prepare
from onboard.vision.klt_tracker import Tracker, Tracks
from simulation.renderer import Renderer, SensorSpec
from simulation.terrain import Terrain, TerrainSpec
from simulation.texture import Texture, TextureSpec
from simulation.trajectory import Pose

Array = NDArray[np.float64]

CAMERA = Camera.from_field_of_view(640, 480, 40.0)
FEATURES = 100
LEVEL = np.zeros(3)


@dataclass(frozen=True, eq=False)
class World:
    renderer: Renderer

    def picture(self, pose: Pose, frame: int, gain: float = 1.0) -> Picture:
        return self.renderer.picture([pose], gain, frame)


@pytest.fixture(scope="module")
def world() -> World:
    return World(Renderer(CAMERA, Terrain(TerrainSpec()), Texture(TextureSpec()), SensorSpec(), seed=1))


def pose(
    east: float = 0.0, north: float = 0.0, up: float = 250.0, roll: float = 0.0, pitch: float = 0.0, yaw: float = 30.0
) -> Pose:
    R_enu_body = R_ENU_NED @ matrix_from_euler(*np.radians([roll, pitch, yaw]))
    return Pose(np.array([east, north, up]), R_enu_body @ mount_rotation(0.0, -90.0, 0.0))


def between(first: Pose, second: Pose) -> Array:
    a, b = (plane_homography.Pose(p.R_enu_cam.T, p.centre_m) for p in (first, second))
    H = plane_homography.predict_homography(CAMERA, a, b, LEVEL)
    assert H is not None
    return H


def started(picture: Picture) -> Tracker:
    tracker = Tracker(CAMERA.size_px, FEATURES)
    assert len(tracker.track(picture, None)) == 0
    assert not tracker.has_keyframe
    tracker.promote(tracker.nothing())
    return tracker


def error_px(tracks: Tracks, H: Array) -> Array:
    return np.linalg.norm(tracks.uv_px - plane_homography.move(H, tracks.keyframe_uv_px), axis=1)


START = pose()
MOVES = {
    "a step": pose(4.0, 7.0),
    "a third of the picture": pose(20.0, 35.0),
    "shaken": pose(5.0, 8.0, roll=2.5, pitch=-2.0, yaw=33.0),
    "closer": pose(3.0, 3.0, up=225.0),
    "turned by ten degrees": pose(5.0, 9.0, yaw=40.0),
    "rolled by ten degrees": pose(4.0, 6.0, roll=10.0),
}


@pytest.mark.parametrize("name", MOVES)
def test_tracks_are_a_tenth_of_a_pixel_from_truth(world: World, name: str) -> None:
    """With what telemetry predicts, off by a degree and two metres as it may be."""
    there = MOVES[name]
    off = pose(0.0, 0.0)
    wrong = Pose(there.centre_m + [1.5, -1.5, 0.0], there.R_enu_cam @ off.R_enu_cam.T @ pose(yaw=31.0).R_enu_cam)
    tracker = started(world.picture(START, 0))
    tracks = tracker.track(world.picture(there, 1), between(START, wrong))
    error = error_px(tracks, between(START, there))
    assert 0.0 < np.median(error) < 0.1
    assert np.quantile(error, 0.95) < 1.0
    visible = plane_homography.move(between(START, there), tracker.keyframe_features[1])
    expected = np.count_nonzero(np.all((visible > 12) & (visible < [627, 467]), axis=1))
    assert len(tracks) > 0.8 * expected


@pytest.mark.parametrize("gain", [3.5, 1 / 3.5])
def test_a_change_of_brightness_by_three_and_a_half_times_costs_little(world: World, gain: float) -> None:
    """As the exposure of the real flight swings: half of it up, half of it down, and an offset on top."""
    there = pose(4.0, 7.0)
    first = world.picture(START, 0, gain=1.0 / np.sqrt(gain))
    second = world.picture(there, 1, gain=np.sqrt(gain))
    lifted = np.clip(second.astype(int) + 12, 0, 255).astype(np.uint8)
    tracks = started(first).track(lifted, None)
    assert len(tracks) > 60
    assert 0.0 < np.median(error_px(tracks, between(START, there))) < 0.15


@pytest.mark.parametrize(
    ("east", "north", "yaw_deg", "least", "error"),
    [(12.0, 20.0, 0.0, 50, 0.1), *((8.0, 6.0, turn, 30, 0.25) for turn in (75.0, 150.0, -110.0))],
)
def test_without_a_prediction_a_shift_and_a_turn_by_any_angle_are_found(
    world: World, east: float, north: float, yaw_deg: float, least: int, error: float
) -> None:
    """Where correlation of thumbnails sees nothing, descriptors do."""
    there = pose(east, north, yaw=30.0 + yaw_deg)
    tracks = started(world.picture(START, 0)).track(world.picture(there, 1), None)
    assert len(tracks) > least
    assert 0.0 < np.median(error_px(tracks, between(START, there))) < error


def test_a_dark_photograph_of_the_real_flight_is_found_against_a_bright_one(shared_data: Path) -> None:
    """The third against the first, 144 px and three and a half times less light away, with no telemetry to tell."""
    files = sorted((shared_data / "cmac_2018" / "frames").glob("*.jpg"))
    pictures = [np.asarray(cv2.imread(str(files[k]), cv2.IMREAD_GRAYSCALE), np.uint8) for k in (0, 2)]
    assert pictures[0].mean() > 3.0 * pictures[1].mean()
    tracker = Tracker((pictures[0].shape[1], pictures[0].shape[0]), FEATURES)
    tracker.track(pictures[0], None)
    tracker.promote(tracker.nothing())
    tracks = tracker.track(pictures[1], None)
    assert len(tracks) > 20
    shift = np.median(tracks.uv_px - tracks.keyframe_uv_px, axis=0)
    assert np.abs(shift - [-40.0, 138.0]).max() < 40.0  # as SIFT says of the picture's middle; it turns a little too


def test_a_prediction_that_is_wrong_gives_right_tracks_or_none(world: World) -> None:
    """Twenty degrees and forty metres off: what is accepted afterwards must be the pictures' own motion."""
    there = pose(4.0, 7.0)
    wrong = between(START, pose(-30.0, 30.0, yaw=50.0))
    tracks = started(world.picture(START, 0)).track(world.picture(there, 1), wrong)
    truth = between(START, there)
    assert len(tracks) == 0 or np.quantile(error_px(tracks, truth), 0.9) < 1.0


def test_another_place_gives_no_tracks(world: World) -> None:
    tracks = started(world.picture(START, 0)).track(world.picture(pose(900.0, 700.0), 1), None)
    assert len(tracks) == 0


def test_a_black_picture_gives_no_tracks_and_is_passed_over(world: World) -> None:
    there = pose(8.0, 14.0)
    tracker = started(world.picture(START, 0))
    assert len(tracker.track(np.zeros((480, 640), np.uint8), None)) == 0
    tracks = tracker.track(world.picture(there, 2), between(START, there))
    assert len(tracks) > 60
    assert np.median(error_px(tracks, between(START, there))) < 0.1


def test_a_picture_without_texture_has_no_features() -> None:
    noise = np.random.default_rng(0).normal(90.0, 1.5, (480, 640)).clip(0, 255).astype(np.uint8)
    tracker = started(np.full((480, 640), 90, np.uint8))
    assert len(tracker.keyframe_features[0]) == 0
    # Noise has corners, but they are not found again in other noise.
    other = np.random.default_rng(1).normal(90.0, 1.5, (480, 640)).clip(0, 255).astype(np.uint8)
    assert len(started(noise).track(other, None)) == 0


def test_the_number_of_features_is_constant_and_spread_over_the_picture(world: World) -> None:
    tracker = started(world.picture(START, 0))
    for step in range(1, 5):
        tracks = tracker.track(world.picture(pose(6.0 * step, 10.4 * step), step), None)
        ids, uv = tracker.promote(tracks)
        assert len(ids) == len(np.unique(ids)) == FEATURES
        assert 0 < len(tracks) < FEATURES
        cell = (uv / [640 / 4, 480 / 3]).astype(int) @ [1, 4]
        share = np.bincount(cell, minlength=12)
        assert share.min() >= 3
        assert share.max() <= 20
        gap = np.linalg.norm(uv[:, None] - uv[None], axis=-1)[np.triu_indices(FEATURES, 1)]
        assert gap.min() > 3.0


def test_a_climb_leaves_features_all_over_the_picture(world: World) -> None:
    """What is followed converges to the middle: before, all hundred lay in a sixth of the width after five times the
    height, and clicks on the rest were refused as outside.
    """
    heights_m = 100.0 * 1.22 ** np.arange(9)
    tracker = started(world.picture(pose(up=heights_m[0]), 0))
    for step, height_m in enumerate(heights_m[1:], 1):
        tracks = tracker.track(world.picture(pose(up=float(height_m)), step), None)
        assert len(tracks) > 0.8 * tracks.offered
        assert tracks.shown_before(CAMERA.size_px) == pytest.approx(1.0 / 1.22**2, abs=0.1)
        ids, uv = tracker.promote(tracks)
        assert len(ids) > 0.95 * FEATURES
        assert np.all(np.quantile(uv, 0.9, axis=0) - np.quantile(uv, 0.1, axis=0) > 0.4 * np.array(CAMERA.size_px))
    share = np.bincount((uv / [640 / 4, 480 / 3]).astype(int) @ [1, 4], minlength=12)
    assert share.min() >= 3
    assert share.max() < 25


@pytest.mark.parametrize("scale", [0.5, 0.8, 1.0, 1.3])
def test_the_share_that_the_keyframe_showed_is_that_of_the_areas(scale: float) -> None:
    about = np.diag([scale, scale, 1.0])
    about[:2, 2] = (1.0 - scale) * (np.array(CAMERA.size_px) - 1.0) / 2.0
    nothing = Tracker(CAMERA.size_px, FEATURES).nothing()
    shown = replace(nothing, motion=about).shown_before(CAMERA.size_px)
    assert shown == pytest.approx(min(scale, 1.0) ** 2, abs=1e-3)


def test_of_tracks_that_are_crowded_the_older_ones_stay() -> None:
    uv = np.array([[100.0, 100.0], [105.0, 100.0], [130.0, 100.0], [112.0, 100.0]])
    tracks = Tracks(np.array([4, 5, 7, 9]), uv, uv + 1.0, 4, np.eye(3))
    assert tracks.thinned(10.0).ids.tolist() == [4, 7, 9]
    assert np.array_equal(tracks.thinned(10.0).keyframe_uv_px, uv[[0, 2, 3]] + 1.0)
    assert tracks.thinned(3.0).ids.tolist() == [4, 5, 7, 9]
    assert len(tracks.thinned(1e3)) == 1
    assert len(Tracker((640, 480), 100).nothing().thinned(10.0)) == 0


def test_a_feature_keeps_its_name_from_keyframe_to_keyframe(world: World) -> None:
    """An id stands for one point of the ground as long as it lives, and is never given again."""
    places = [pose(6.0 * step, 10.4 * step) for step in range(5)]
    tracker = started(world.picture(places[0], 0))
    where = dict(zip(*map(list, tracker.keyframe_features), strict=True))
    ground: dict[int, Array] = {
        i: plane_homography.move(between(places[0], START), uv[None])[0] for i, uv in where.items()
    }
    for step in range(1, 5):
        tracks = tracker.track(world.picture(places[step], step), None)
        back = between(places[step], START)
        for i, uv in zip(tracks.ids, tracks.uv_px, strict=True):
            assert int(i) in ground
            assert np.linalg.norm(plane_homography.move(back, uv[None])[0] - ground[int(i)]) < 2.5
        known = set(tracks.ids.tolist())
        for i, uv in zip(*tracker.promote(tracks), strict=True):
            if int(i) not in known:
                assert int(i) not in ground
                ground[int(i)] = plane_homography.move(back, uv[None])[0]
    assert len(ground) > FEATURES


def test_forgetting_starts_again_with_new_names(world: World) -> None:
    tracker = started(world.picture(START, 0))
    old = set(tracker.keyframe_features[0].tolist())
    tracker.forget()
    assert not tracker.has_keyframe
    tracker.track(world.picture(START, 1), None)
    ids, _ = tracker.promote(tracker.nothing())
    assert not old & set(ids.tolist())


def test_promoting_before_a_picture_is_misuse() -> None:
    tracker = Tracker(CAMERA.size_px, FEATURES)
    with pytest.raises(RuntimeError, match="track"):
        tracker.promote(tracker.nothing())


def test_the_same_pictures_give_the_same_tracks(world: World) -> None:
    pictures = world.picture(START, 0), world.picture(pose(4.0, 7.0), 1)
    one, two = (started(pictures[0]).track(pictures[1], None) for _ in range(2))
    assert np.array_equal(one.uv_px, two.uv_px)
    assert np.array_equal(one.ids, two.ids)


def test_a_prepared_picture_does_not_know_its_brightness(world: World) -> None:
    picture = world.picture(START, 0)
    dim = cv2.convertScaleAbs(picture, alpha=0.4, beta=20)
    a, b = prepare(picture).astype(float), prepare(np.asarray(dim, np.uint8)).astype(float)
    assert np.corrcoef(a.ravel(), b.ravel())[0, 1] > 0.95
    assert abs(a.mean() - 128.0) < 6.0
    assert abs(b.mean() - 128.0) < 6.0


def test_the_homography_fit_is_exact_on_exact_points() -> None:
    rng = np.random.default_rng(0)
    H = np.array([[1.02, 0.1, 12.0], [-0.09, 0.98, -7.0], [2e-5, -1e-5, 1.0]])
    at = rng.uniform([0, 0], [640, 480], (12, 2))
    assert fit_homography(at, plane_homography.move(H, at), np.ones(12)) == pytest.approx(H, abs=1e-4)
