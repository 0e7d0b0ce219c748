"""Answers over a ground known beforehand: right where the pose is, and as wide as pose and ground deserve."""

from dataclasses import replace

import numpy as np
import pytest

from contract.answer import CHI2_2, Fix
from contract.camera import Camera
from contract.feature_set import ATTITUDE, NUISANCES, POSITION, DepthSource, FeatureSet, SharedErrors, Status
from contract.geodesy import LocalFrame
from contract.locate import Locator
from contract.rotations import R_ENU_NED, exp_so3, matrix_from_euler, mount_rotation
from onboard.estimation.shared_errors import SensorPose
from onboard.geometry.terrain_grid import Terrain
from onboard.georeferencing.feature_sets import Origin, Picture
from onboard.georeferencing.surface_sets import Surface, level_cast, over_surface

CAMERA = Camera.from_field_of_view(640, 480, 40.0)
FRAME = LocalFrame(-43.4, 172.4, 100.0)
PICTURE = Picture(CAMERA, Origin("uav", 1, 0, 1_795_217_000_000_000_000, 0, False), FRAME, 0.0)
SIGMAS = np.array([1.5, 1.5, 2.5, *np.radians([1.0, 1.0, 2.0]), 4.0])
HEIGHT_M = 120.0


def pose(pitch_deg: float = -90.0, **angles: float) -> SensorPose:
    body = R_ENU_NED @ matrix_from_euler(angles.get("roll", 0.0), 0.0, 0.5)
    R_enu_cam = body @ mount_rotation(0.0, pitch_deg, 0.0)
    centre = np.array([3.0, -4.0, HEIGHT_M])
    by_nuisance = np.zeros((7, NUISANCES))
    by_nuisance[:3, POSITION], by_nuisance[3:6, ATTITUDE] = np.diag(SIGMAS[:3]), np.diag(SIGMAS[3:6])
    sensor_pose = SensorPose(R_enu_cam.T, centre, np.zeros((7, 7)), SharedErrors(by_nuisance, 60.0, 20.0))
    return sensor_pose.over_ground(SIGMAS[6])


def level_set(sensor_pose: SensorPose, height_m: float = 0.0) -> FeatureSet | Status:
    return over_surface(PICTURE, sensor_pose, Surface(level_cast(height_m), 0.0, DepthSource.PLANE))


def hills() -> Terrain:
    axis = np.arange(-900.0, 901.0, 15.0)
    east, north = np.meshgrid(axis, axis)
    return Terrain(-900.0, -900.0, 15.0, 6.0 * np.sin(east / 70.0) + 6.0 * np.cos(north / 80.0))


@pytest.mark.parametrize("pitch_deg", [-90.0, -60.0, -45.0])
def test_with_the_true_pose_over_level_ground_a_click_is_exact(pitch_deg: float) -> None:
    sensor_pose = pose(pitch_deg)
    s = level_set(sensor_pose)
    assert isinstance(s, FeatureSet)
    assert s.depth_source is DepthSource.PLANE
    for uv in ((320.0, 240.0), (60.0, 400.0), (600.0, 100.0)):
        answer = Locator(s).locate(uv)
        assert answer.method == "plane"
        ray, _ = CAMERA.unproject(np.array(uv))
        d = sensor_pose.R_cam_enu.T @ ray
        truth = sensor_pose.centre_enu_m - d * (HEIGHT_M / d[2])
        got = FRAME.to_enu(answer.lat_deg, answer.lon_deg, answer.height_amsl_m)
        assert got == pytest.approx(truth, abs=0.02)


def draw(rng: np.random.Generator, sensor_pose: SensorPose, terrain: Terrain | None) -> tuple[FeatureSet, np.ndarray]:
    """A set from a pose with errors over a ground with errors, and the true points of CLICKS."""
    e = SIGMAS * rng.standard_normal(7)
    wrong = replace(
        sensor_pose,
        R_cam_enu=(exp_so3(e[3:6]) @ sensor_pose.R_cam_enu.T).T,
        centre_enu_m=sensor_pose.centre_enu_m + e[:3],
    )
    rays, _ = CAMERA.unproject(CLICKS)
    if terrain is None:
        cast, believed_cast, source = level_cast(0.0), level_cast(e[6]), DepthSource.PLANE
    else:
        known = replace(terrain, heights_m=terrain.heights_m + e[6])
        cast, believed_cast, source = terrain.cast, known.cast, DepthSource.TERRAIN
    d = rays @ sensor_pose.R_cam_enu
    truth = sensor_pose.centre_enu_m + d * cast(sensor_pose.centre_enu_m, d)[:, None]
    s = over_surface(PICTURE, wrong, Surface(believed_cast, 0.5 if terrain else 0.0, source))
    assert isinstance(s, FeatureSet)
    return s, truth


CLICKS = np.array([[320.0, 240.0], [80.0, 80.0], [560.0, 400.0], [500.0, 120.0]])


@pytest.mark.parametrize("pitch_deg", [-90.0, -60.0])
@pytest.mark.parametrize(
    "terrain", [pytest.param(None, id="level"), pytest.param(hills(), id="hills", marks=pytest.mark.long)]
)
def test_nine_clicks_of_ten_lie_inside_the_ellipse(pitch_deg: float, terrain: Terrain | None) -> None:
    rng = np.random.default_rng(4)
    absolute, between = [], []
    for _ in range(150):
        s, truth = draw(rng, pose(pitch_deg), terrain)
        locator = Locator(s)
        errors = []
        for uv, point in zip(CLICKS, truth, strict=True):
            answer = locator.locate(uv)
            error = (FRAME.to_enu(answer.lat_deg, answer.lon_deg, answer.height_amsl_m) - point)[:2]
            absolute.append(error @ np.linalg.solve(answer.covariance_enu_m2[:2, :2], error) < CHI2_2)
            errors.append(error)
        pair = locator.difference_covariance(CLICKS[0], CLICKS[1])
        error = errors[0] - errors[1]
        between.append(error @ np.linalg.solve(pair[:2, :2], error) < CHI2_2)
    assert 0.84 < np.mean(absolute) < 0.96
    assert 0.80 < np.mean(between) <= 1.0


def test_a_less_certain_ground_widens_the_ellipse_of_an_oblique_view() -> None:
    semi = []
    for ground_sigma_m in (1.0, 10.0):
        s = level_set(pose(-45.0).over_ground(ground_sigma_m))
        assert isinstance(s, FeatureSet)
        answer = Locator(s).locate((320.0, 240.0))
        semi.append(answer.ellipse.semi_major_m)
    assert semi[1] > semi[0] + 10.0


def test_a_view_of_the_sky_is_above_the_horizon() -> None:
    assert level_set(pose(20.0)) is Status.ABOVE_HORIZON


def test_ground_above_the_aircraft_gives_no_set() -> None:
    assert level_set(pose(), height_m=HEIGHT_M + 10.0) is Status.ABOVE_HORIZON


def test_a_view_across_the_horizon_answers_below_it_only() -> None:
    s = level_set(pose(-15.0))
    assert isinstance(s, FeatureSet)
    assert 0 < len(s) < 63
    assert not isinstance(Locator(s).locate((320.0, 2.0)), Fix)
    assert np.all(s.sigma_inverse_depth_per_m > 0.0)


def test_a_ranged_ground_errs_as_the_camera_does_and_the_ellipse_knows() -> None:
    """Camera 2.5 m off in height, range 0.8 m: a click's height errs by both, its place only by the range's share."""
    sigma_m = 0.8
    sensor_pose = pose()
    known = sensor_pose.over_ranged_ground(sigma_m)
    s = level_set(known)
    assert isinstance(s, FeatureSet)
    answer = Locator(s).locate((600.0, 440.0))
    assert answer.sigma_height_m == pytest.approx(np.hypot(SIGMAS[2], sigma_m), rel=0.05)
    loose = Locator(level_set(sensor_pose.over_ground(10.0))).locate((600.0, 440.0))
    assert answer.ellipse.semi_major_m < loose.ellipse.semi_major_m
    rng = np.random.default_rng(3)
    inside = []
    for _ in range(400):
        error = SIGMAS * rng.standard_normal(7)
        centre = sensor_pose.centre_enu_m + error[:3]
        ground = error[2] + sigma_m * rng.standard_normal()  # the truth, where the range is off by so much
        R_enu_cam = exp_so3(error[3:6]) @ sensor_pose.R_cam_enu.T
        ray, _ = CAMERA.unproject(np.array([600.0, 440.0]))
        d = R_enu_cam @ ray
        truth = centre + d * ((ground - centre[2]) / d[2])
        lat, lon, height = answer.lat_deg, answer.lon_deg, answer.height_amsl_m
        assert height is not None
        miss = (FRAME.to_enu(lat, lon, height) - truth)[:2]
        inside.append(miss @ np.linalg.solve(answer.covariance_enu_m2[:2, :2], miss) < CHI2_2)
    assert 0.86 < np.mean(inside) < 0.94
