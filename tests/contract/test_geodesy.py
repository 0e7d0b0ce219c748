import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from contract.geodesy import (
    LocalFrame,
    distance_m,
    ecef_to_geodetic,
    geodetic_to_ecef,
    metres_per_degree,
    rotation_enu_ecef,
)

latitudes = st.floats(-90.0, 90.0)
longitudes = st.floats(-180.0, 180.0)
heights = st.floats(-500.0, 50_000.0)


@given(latitudes, longitudes, heights)
def test_geodetic_survives_ecef_and_back(lat: float, lon: float, height: float) -> None:
    xyz = geodetic_to_ecef(lat, lon, height)
    back = ecef_to_geodetic(xyz)
    assert back[0] == pytest.approx(lat, abs=1e-11)
    assert back[2] == pytest.approx(height, abs=1e-6)
    np.testing.assert_allclose(geodetic_to_ecef(*back), xyz, atol=2e-6)  # longitude has no meaning at a pole


@given(latitudes, longitudes, heights)
def test_it_agrees_with_pyproj(lat: float, lon: float, height: float) -> None:
    from pyproj import Transformer  # noqa: PLC0415

    expected = Transformer.from_crs(4979, 4978, always_xy=True).transform(lon, lat, height)
    np.testing.assert_allclose(geodetic_to_ecef(lat, lon, height), expected, atol=1e-6)


@given(latitudes, longitudes)
def test_the_local_axes_are_a_rotation_with_up_along_the_normal(lat: float, lon: float) -> None:
    R = rotation_enu_ecef(lat, lon)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0)
    raised = geodetic_to_ecef(lat, lon, 100.0) - geodetic_to_ecef(lat, lon, 0.0)
    np.testing.assert_allclose(R @ raised, [0.0, 0.0, 100.0], atol=1e-7)


@given(st.floats(-89.0, 89.0), longitudes, heights, st.tuples(*[st.floats(-5000.0, 5000.0)] * 3))
def test_local_coordinates_survive_the_round_trip(
    lat: float, lon: float, height: float, enu: tuple[float, float, float]
) -> None:
    frame = LocalFrame(lat, lon, height)
    np.testing.assert_allclose(frame.to_enu(*frame.to_geodetic(enu)), enu, atol=1e-5)
    np.testing.assert_allclose(frame.to_enu(lat, lon, height), 0.0, atol=1e-7)


def test_east_and_north_point_the_right_way() -> None:
    frame = LocalFrame(-35.0, 149.0, 0.0)
    east, north, up = frame.to_enu(-35.0, 149.001, 0.0)
    assert east == pytest.approx(91.29, abs=0.05) and abs(north) < 0.01 and abs(up) < 0.01
    east, north, _ = frame.to_enu(-34.999, 149.0, 0.0)
    assert north == pytest.approx(110.94, abs=0.05) and abs(east) < 0.01


def test_arrays_of_many_keep_their_shape() -> None:
    frame = LocalFrame(10.0, 20.0, 30.0)
    points = np.zeros((4, 5, 3))
    assert frame.to_geodetic(points).shape == (4, 5, 3)
    np.testing.assert_allclose(frame.to_geodetic(points)[2, 3], [10.0, 20.0, 30.0], atol=1e-8)


@given(st.floats(-89.9, 89.9))
def test_a_degree_is_as_long_as_the_ellipsoid_makes_it(lat: float) -> None:
    step = 1e-3
    north = geodetic_to_ecef([lat - step, lat + step], [0.0, 0.0], [0.0, 0.0])
    east = geodetic_to_ecef([lat, lat], [-step, step], [0.0, 0.0])
    lengths_m = [np.linalg.norm(ends[1] - ends[0]) / (2.0 * step) for ends in (north, east)]
    assert metres_per_degree(lat) == pytest.approx(lengths_m, rel=1e-8, abs=1e-5)


@pytest.mark.parametrize("lon_deg", [172.4, 179.99, -180.0])
def test_a_distance_is_the_plane_s_within_some_kilometres_and_over_the_180th_meridian(lon_deg: float) -> None:
    lat, lon, _ = LocalFrame(-43.4, lon_deg, 0.0).to_geodetic([1200.0, -900.0, 0.0])
    assert distance_m((-43.4, lon_deg), (float(lat), float(lon))) == pytest.approx(1500.0, rel=1e-3)
