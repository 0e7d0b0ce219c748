"""What one picture counts as seen: all of what is surely in view, and nothing else."""

import dataclasses
from statistics import NormalDist

import numpy as np
import pytest
from numpy.typing import NDArray

from contract.camera import Camera
from contract.feature_set import FeatureSet, Status
from contract.rolling_shutter import RollingShutter
from ground.seen import picture_cells as module
from ground.seen.cells import Cells
from ground.seen.picture_cells import PictureCells, TooManyCells, picture_cells, pixel_of
from tests.contract.sets import DISTORTION
from tests.ground import worlds
from tests.ground.seen.levels import CAMERA, HEIGHT_M, PLACE, level_set
from tests.rest_long import rest_long

CELLS = Cells.about(PLACE.lat_deg, PLACE.lon_deg, 1.0)
WIDE_M = HEIGHT_M * 640 / CAMERA.fx_px
HIGH_M = HEIGHT_M * 480 / CAMERA.fx_px


def sides_m(found: PictureCells) -> tuple[float, float]:
    """How wide and how high the cells are together."""
    return float(np.ptp(found.column)) + 1.0, float(np.ptp(found.row)) + 1.0


def middles(found: PictureCells) -> NDArray[np.float64]:
    lat, lon = CELLS.lat_deg(found.row + 0.5), CELLS.lon_deg(found.column + 0.5)
    return np.asarray(PLACE.to_enu(lat, lon, 0.0)[:, :2])


def test_of_a_sure_pose_all_whole_cells_of_the_picture_are_counted() -> None:
    found = picture_cells(level_set(), CELLS)
    wide, high = sides_m(found)
    assert WIDE_M - 2.2 < wide <= WIDE_M
    assert HIGH_M - 2.2 < high <= HIGH_M
    assert len(found) == wide * high


@pytest.mark.parametrize("sigma_m", [1.0, 3.0, 6.0])
def test_an_unsure_pose_leaves_out_what_ninety_percent_of_its_error_may_take_away(sigma_m: float) -> None:
    margin_m = NormalDist().inv_cdf(0.9) * sigma_m
    wide, high = sides_m(picture_cells(level_set(sigma_m=sigma_m), CELLS))
    assert WIDE_M - 2.0 * margin_m - 1.4 < wide <= WIDE_M - 2.0 * margin_m + 1.1
    assert HIGH_M - 2.0 * margin_m - 1.4 < high <= HIGH_M - 2.0 * margin_m + 1.1


def test_in_a_corner_both_errors_count() -> None:
    found = middles(picture_cells(level_set(sigma_m=3.0), CELLS))
    inside = 0.5 * np.array([WIDE_M, HIGH_M]) - np.abs(found)
    # At the corner of what is counted neither distance alone would be enough.
    most = inside[np.argmin(inside.sum(axis=1))]
    normal = NormalDist(0.0, 3.0)
    assert normal.cdf(most[0]) * normal.cdf(most[1]) == pytest.approx(0.9, abs=0.02)
    assert min(most) > 1.2 * NormalDist().inv_cdf(0.9) * 3.0


def test_the_ground_sample_distance_is_that_of_the_coarser_direction() -> None:
    down = picture_cells(level_set(), CELLS)
    assert down.gsd_m == pytest.approx(np.full(len(down), HEIGHT_M / CAMERA.fx_px), rel=1e-3)
    tilt = np.radians(30.0)
    oblique = picture_cells(level_set(tilt_deg=30.0), CELLS)
    at = np.argmin(np.abs(middles(oblique) - (0.0, HEIGHT_M * np.tan(tilt))).sum(axis=1))
    # Along the line of sight a pixel is seen twice aslant: from afar, and on ground that lies oblique to it.
    assert oblique.gsd_m[at] == pytest.approx(HEIGHT_M / CAMERA.fx_px / np.cos(tilt) ** 2, rel=0.03)


def in_view(s: FeatureSet, found: PictureCells) -> NDArray[np.float64]:
    """Pixels (N, 2) of the cells' middles on level ground, by the camera alone."""
    east_north = middles(found)
    own = PLACE.to_enu(s.camera_lat_deg, s.camera_lon_deg, s.camera_height_m)
    X = np.column_stack([east_north - own[:2], np.full(len(found), -own[2])])
    return np.asarray(s.camera.project(X @ s.R_enu_cam)[0])


def test_obliquely_and_through_a_bent_lens_the_counted_cells_are_those_in_the_picture() -> None:
    bent = Camera(640, 480, 879.2, 879.2, 319.5, 239.5, DISTORTION)
    for s in (level_set(tilt_deg=25.0), dataclasses.replace(level_set(tilt_deg=10.0), camera=bent)):
        found = picture_cells(s, CELLS)
        uv = in_view(s, found)
        assert np.all(s.camera.contains(uv))
        # And nearly all of those: the area in the picture that the cells take.
        density = 1.0 / found.gsd_m.min() ** 2
        assert len(found) * density > 0.5 * 640 * 480
        for edge in (uv[:, 0], 639 - uv[:, 0], uv[:, 1], 479 - uv[:, 1]):
            assert edge.min() < 1.6 / found.gsd_m.min()


def test_a_sensor_read_by_rows_shows_the_ground_that_each_row_has_seen() -> None:
    whole = level_set()
    rows = dataclasses.replace(
        whole, shutter=RollingShutter(0.05, velocity_cam_m_s=np.array([0.0, -40.0, 0.0]))
    )  # north: the last row is read 2 m farther on than the first
    _, high = sides_m(picture_cells(whole, CELLS))
    _, slanted = sides_m(picture_cells(rows, CELLS))
    assert slanted == pytest.approx(high - 2.0, abs=1.01)


def test_what_answers_nothing_has_seen_nothing() -> None:
    refused = FeatureSet("uav", 1, 0, 1, Status.TURNING, CAMERA)
    assert len(picture_cells(refused, CELLS)) == 0
    unsure = level_set(sigma_m=HEIGHT_M)
    assert len(picture_cells(unsure, CELLS)) == 0
    upright = dataclasses.replace(level_set(), plane_per_m=np.array([0.0, 0.0, 0.0]))
    assert len(picture_cells(upright, CELLS)) == 0


def test_a_picture_of_the_far_horizon_does_not_ask_for_all_memory() -> None:
    with pytest.raises(TooManyCells):
        picture_cells(level_set(height_m=9000.0), CELLS)


def test_a_place_is_found_again_in_the_picture() -> None:
    s = level_set(tilt_deg=20.0, east_m=5.0)
    found = picture_cells(s, CELLS)
    expected = in_view(s, found)
    for k in (0, len(found) // 2, len(found) - 1):
        lat, lon = float(CELLS.lat_deg(found.row[k] + 0.5)), float(CELLS.lon_deg(found.column[k] + 0.5))
        assert pixel_of(s, lat, lon) == pytest.approx(tuple(expected[k]), abs=0.05)
    lat, lon, _ = PLACE.to_geodetic((0.0, -400.0, 0.0))
    assert pixel_of(s, float(lat), float(lon)) is None


def test_the_normal_distribution_is_that_of_the_standard_library() -> None:
    x = np.linspace(-6.0, 6.0, 241)
    assert module._normal(x) == pytest.approx([NormalDist().cdf(v) for v in x], abs=1e-7)


@pytest.mark.parametrize("sets", rest_long([20, 60]))
def test_ninety_percent_of_counted_border_cells_are_in_view_where_poses_err_as_they_say(sets: int) -> None:
    """Sets sampled with exactly the errors that they declare, the cells at the border of what is
    counted were truly in view nine times in ten or oftener, and most of what was in view is counted.
    """
    border, kept = [], []
    errors = worlds.Errors(relief_relative=0.0, roughness=0.0)
    cells = Cells.about(worlds.ORIGIN.lat_deg, worlds.ORIGIN.lon_deg, 0.5)
    for seed in range(sets):
        rng = np.random.default_rng([seed, 31])
        made = worlds.build(rng, errors, clicks_px=edge_pixels(), yaw_rad=0.3 * seed, pitch_deg=-75.0)
        found = picture_cells(made.feature_set, cells)
        outline = made.truth_enu_m[:, :2]  # of the true picture on the ground, corner to corner
        counted = worlds.ORIGIN.to_enu(cells.lat_deg(found.row + 0.5), cells.lon_deg(found.column + 0.5), 0.0)[:, :2]
        inside = is_inside(outline, counted)
        taken = np.zeros(np.array([np.ptp(found.row), np.ptp(found.column)]) + 3, bool)
        at = found.row - found.row.min() + 1, found.column - found.column.min() + 1
        taken[at] = True
        deep = taken[:-2, 1:-1] & taken[2:, 1:-1] & taken[1:-1, :-2] & taken[1:-1, 2:]
        border.append(float(np.mean(inside[~deep[at[0] - 1, at[1] - 1]])))
        kept.append(len(found) * 0.25 * float(np.mean(inside)) / polygon_area(outline))
    assert 0.88 < np.mean(border) < 0.97
    assert 0.85 < np.mean(kept) < 0.98


def edge_pixels() -> NDArray[np.float64]:
    corners = np.array([[-0.5, -0.5], [639.5, -0.5], [639.5, 479.5], [-0.5, 479.5]])
    t = np.linspace(0.0, 1.0, 8, endpoint=False)[:, None]
    sides = zip(corners, np.roll(corners, -1, axis=0), strict=True)
    return np.clip(np.concatenate([a + t * (b - a) for a, b in sides]), -0.499, [639.499, 479.499])


def is_inside(ring: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.bool_]:
    out = np.zeros(len(points), bool)
    for (x0, y0), (x1, y1) in zip(ring, np.roll(ring, -1, axis=0), strict=True):
        crosses = (y0 > points[:, 1]) != (y1 > points[:, 1])
        out ^= crosses & (points[:, 0] < x0 + (points[:, 1] - y0) * (x1 - x0) / (y1 - y0 or 1.0))
    return out


def polygon_area(ring: NDArray[np.float64]) -> float:
    x, y = ring.T
    return 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))
