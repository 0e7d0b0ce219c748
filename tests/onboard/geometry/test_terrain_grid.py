"""Terrain in memory and from files: heights between nodes, where rays meet it, nothing invented where there is none."""

from pathlib import Path

import numpy as np
import pytest
import rasterio
from hypothesis import given
from hypothesis import strategies as st
from rasterio import warp

from contract.errors import InputError
from contract.geodesy import LocalFrame
from onboard.geometry.terrain_grid import Terrain
from onboard.storage.elevation_files import TerrainFiles

FRAME = LocalFrame(-43.5, 172.5, 120.0)
CENTRE = np.zeros(3)


def hills(spacing_m: float = 10.0, n: int = 81) -> Terrain:
    axis = (np.arange(n) - n // 2) * spacing_m
    east, north = np.meshgrid(axis, axis)
    return Terrain(axis[0], axis[0], spacing_m, 12.0 * np.sin(east / 60.0) + 9.0 * np.cos(north / 45.0) + 0.02 * east)


@given(st.floats(-400.0, 400.0), st.floats(-400.0, 400.0))
def test_a_plane_is_interpolated_exactly(x: float, y: float) -> None:
    axis = np.arange(-400.0, 401.0, 20.0)
    east, north = np.meshgrid(axis, axis)
    terrain = Terrain(-400.0, -400.0, 20.0, 3.0 + 0.1 * east - 0.2 * north)
    height, slope = terrain.height_and_slope(np.array([[x, y]]))
    assert height[0] == pytest.approx(3.0 + 0.1 * x - 0.2 * y, abs=1e-9)
    assert slope[0] == pytest.approx([0.1, -0.2], abs=1e-9)


def test_nodes_are_kept_and_slopes_are_the_derivatives() -> None:
    terrain = hills()
    rows, columns = np.array([5, 40, 60]), np.array([70, 3, 41])
    at = np.stack([terrain.west_m + 10.0 * columns, terrain.south_m + 10.0 * rows], axis=1)
    assert terrain.height_and_slope(at)[0] == pytest.approx(terrain.heights_m[rows, columns])
    places = np.random.default_rng(0).uniform(-390.0, 390.0, (50, 2))
    places = np.floor(places / 10.0) * 10.0 + 3.0 + (places % 4.0)  # away from the nodes, where slopes jump
    _, slope = terrain.height_and_slope(places)
    for axis in range(2):
        step = 1e-4 * np.eye(2)[axis]
        ahead, behind = (terrain.height_and_slope(places + s * step)[0] for s in (1.0, -1.0))
        assert (ahead - behind) / 2e-4 == pytest.approx(slope[:, axis], abs=1e-6)


def test_outside_and_over_voids_there_is_no_height() -> None:
    terrain = hills()
    terrain.heights_m[40, 40] = np.nan
    height, slope = terrain.height_and_slope(np.array([[401.0, 0.0], [0.0, -400.1], [3.0, 3.0], [50.0, 50.0]]))
    assert np.isnan(height).tolist() == [True, True, True, False]
    assert np.isnan(slope).any(axis=1).tolist() == [True, True, True, False]
    assert terrain.covers(np.zeros(2), 399.0)
    assert not terrain.covers(np.zeros(2), 401.0)


def test_rays_meet_the_ground_where_a_fine_march_says() -> None:
    terrain, rng = hills(), np.random.default_rng(1)
    centre = np.array([20.0, -30.0, 150.0])
    rays = np.column_stack([rng.uniform(-0.8, 0.8, (60, 2)), np.full(60, -1.0)])
    depth = terrain.cast(centre, rays)
    fine = np.arange(100.0, 190.0, 0.01)
    for ray, z in zip(rays, depth, strict=True):
        height, _ = terrain.height_and_slope((centre + fine[:, None] * ray)[:, :2])
        below = centre[2] - fine < height
        assert z == pytest.approx(fine[np.argmax(below)], abs=0.02)


def test_rays_at_the_sky_from_below_or_off_the_map_meet_nothing() -> None:
    terrain = hills()
    rays = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [5.0, 0.0, -1.0]])
    assert np.all(np.isinf(terrain.cast(np.array([0.0, 0.0, 150.0]), rays)))
    assert np.all(np.isinf(terrain.cast(np.array([0.0, 0.0, -100.0]), np.array([[0.0, 0.0, -1.0]]))))
    assert np.isinf(terrain.cast(np.array([900.0, 0.0, 150.0]), np.array([[0.0, 0.0, -1.0]])))[0]


def slope_amsl(lat: np.ndarray, lon: np.ndarray) -> np.ndarray:
    return 100.0 + 4000.0 * (lat + 43.5) + 3000.0 * (lon - 172.5)


def write_tif(path: Path, crs: str, west: float, north: float, step: float, n: int, values: np.ndarray) -> Path:
    with rasterio.open(
        path, "w", driver="GTiff", width=n, height=n, count=1, dtype="float32", crs=crs, nodata=-9999.0,
        transform=rasterio.Affine(step, 0.0, west, 0.0, -step, north),
    ) as file:  # fmt: skip
        file.write(values.astype(np.float32), 1)
    return path


@pytest.fixture
def geographic(tmp_path: Path) -> Path:
    """EPSG:4326, 0.0005 degrees, pixels' centres half a step from its edge."""
    n, step = 200, 0.0005
    lat = -43.45 - (np.arange(n) + 0.5) * step
    lon = 172.45 + (np.arange(n) + 0.5) * step
    return write_tif(tmp_path / "country.tif", "EPSG:4326", 172.45, -43.45, step, n, slope_amsl(lat[:, None], lon))


@pytest.fixture
def utm(tmp_path: Path) -> Path:
    """The same country in UTM 59 S, 30 m."""
    n, step = 240, 30.0
    (east,), (north,) = warp.transform("EPSG:4326", "EPSG:32759", [172.5], [-43.5])
    west, top = east - 0.5 * n * step, north + 0.5 * n * step
    x, y = np.meshgrid(west + (np.arange(n) + 0.5) * step, top - (np.arange(n) + 0.5) * step)
    lon, lat = warp.transform("EPSG:32759", "EPSG:4326", x.ravel().tolist(), y.ravel().tolist())
    values = slope_amsl(np.array(lat), np.array(lon)).reshape(n, n)
    return write_tif(tmp_path / "country_utm.tif", "EPSG:32759", west, top, step, n, values)


@pytest.fixture
def srtm(tmp_path: Path) -> Path:
    """A whole three-second tile, S44E172.hgt, in whole metres, with a void."""
    lat, lon = -43.0 - np.arange(1201) / 1200.0, 172.0 + np.arange(1201) / 1200.0
    heights = np.rint(slope_amsl(lat[:, None], lon)).astype(">i2")
    heights[600:605, 620:625] = -32768
    path = tmp_path / "S44E172.hgt"
    path.write_bytes(heights.tobytes())
    return path


@pytest.mark.parametrize(("name", "tolerance_m"), [("geographic", 0.05), ("utm", 0.05), ("srtm", 0.8)])
def test_a_file_gives_its_heights_in_the_frames_axes(
    name: str, tolerance_m: float, request: pytest.FixtureRequest
) -> None:
    terrain = TerrainFiles(request.getfixturevalue(name)).around(FRAME, CENTRE, 800.0, 40.0, 11.0)
    places = np.random.default_rng(2).uniform(-700.0, 400.0, (200, 2))
    height, _ = terrain.height_and_slope(places)
    known = np.isfinite(height)
    assert known.mean() > 0.8
    points = np.column_stack([places, height])[known]
    lat, lon, amsl = FRAME.to_geodetic(points).T
    assert np.abs(amsl - slope_amsl(lat, lon)).max() < tolerance_m


def test_a_void_has_no_height(srtm: Path) -> None:
    terrain = TerrainFiles(srtm).around(FRAME, CENTRE, 3000.0, 30.0, 11.0)
    void = FRAME.to_enu(-43.0 - 602.0 / 1200.0, 172.0 + 622.0 / 1200.0, 0.0)[:2]
    beside = FRAME.to_enu(-43.0 - 590.0 / 1200.0, 172.0 + 622.0 / 1200.0, 0.0)[:2]
    height, _ = terrain.height_and_slope(np.stack([void, beside]))
    assert np.isnan(height).tolist() == [True, False]


def test_ellipsoidal_heights_come_down_by_the_undulation(geographic: Path) -> None:
    sea = TerrainFiles(geographic).around(FRAME, CENTRE, 400.0, 40.0, 11.0)
    ellipsoid = TerrainFiles(geographic, "ellipsoid").around(FRAME, CENTRE, 400.0, 40.0, 11.0)
    assert sea.heights_m - ellipsoid.heights_m == pytest.approx(np.full_like(sea.heights_m, 11.0))
    assert TerrainFiles(geographic, "ellipsoid").around(FRAME, CENTRE, 400.0, 40.0, float("nan")) is None


def test_far_from_every_tile_there_is_no_terrain(geographic: Path) -> None:
    assert TerrainFiles(geographic).around(LocalFrame(10.0, 20.0, 0.0), CENTRE, 400.0, 40.0, 11.0) is None


def counting(path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[TerrainFiles, list[int]]:
    """Elevation files, and a list that grows by one whenever a tile is looked at."""
    files, looks = TerrainFiles(path), []
    sample = files._sample
    monkeypatch.setattr(files, "_sample", lambda *a: (looks.append(1), sample(*a))[1])
    return files, looks


def test_a_miss_is_remembered_while_the_aircraft_stays_near(geographic: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files, looks = counting(geographic, monkeypatch)
    away = LocalFrame(-44.5, 172.5, 120.0)
    for step in range(100):
        assert files.around(away, np.array([2.0 * step, 0.0, 80.0]), 900.0, 90.0, 11.0) is None
    assert len(looks) == 1
    assert files.around(away, np.array([301.0, 0.0, 80.0]), 900.0, 90.0, 11.0) is None
    assert len(looks) == 2
    # Nothing of it holds for more than was looked at, nor elsewhere.
    assert files.around(away, np.array([301.0, 0.0, 80.0]), 1000.0, 90.0, 11.0) is None
    assert len(looks) == 3
    assert files.around(FRAME, np.array([301.0, 0.0, 80.0]), 900.0, 90.0, 11.0) is not None


def test_terrain_is_found_again_before_the_aircraft_is_over_it(
    geographic: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Flown north from 10 km south of the model: found when its edge is 2/3 of the radius to the whole radius away."""
    files, looks = counting(geographic, monkeypatch)
    edge_m = FRAME.to_enu(-43.55, 172.5, 0.0)[1]
    for gap_m in np.arange(10_000.0, 0.0, -20.0):
        if files.around(FRAME, np.array([0.0, edge_m - gap_m, 80.0]), 900.0, 90.0, 11.0) is not None:
            break
    assert 600.0 - 20.0 <= gap_m <= 900.0 + 20.0
    assert 28 <= len(looks) <= 33  # every 300 m of 9.1 to 9.4 km, not each of 460 steps


def test_a_folder_of_tiles_is_one_terrain(geographic: Path, utm: Path) -> None:
    both = TerrainFiles(geographic.parent).around(FRAME, CENTRE, 3000.0, 100.0, 11.0)
    one = TerrainFiles(geographic).around(FRAME, CENTRE, 3000.0, 100.0, 11.0)
    assert np.isfinite(both.heights_m).sum() >= np.isfinite(one.heights_m).sum()


def test_files_that_are_no_terrain_are_refused_by_name(tmp_path: Path) -> None:
    text = tmp_path / "notes.tif"
    text.write_text("not a picture")
    for path in (tmp_path / "absent.tif", text):
        with pytest.raises(InputError, match=path.name):
            TerrainFiles(path)
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(InputError, match="empty"):
        TerrainFiles(empty)
    nowhere = write_tif(tmp_path / "nowhere.tif", "", 0.0, 0.0, 1.0, 4, np.zeros((4, 4)))
    with pytest.raises(InputError, match="nowhere"):
        TerrainFiles(nowhere)
