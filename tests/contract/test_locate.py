import dataclasses
import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from contract.answer import CHI2_2, Ellipse, Fix, Refusal
from contract.camera import Camera
from contract.feature_set import ClickedPixel, DepthSource, FeatureSet, HeightDatum, Measured, Status
from contract.locate import Locator, locate
from contract.rolling_shutter import RollingShutter
from contract.wire.codec import decode, encode
from tests.contract.sets import feature_sets
from tests.ground.worlds import CAMERA, ORIGIN, Errors, World, build

EXACT = Errors(feature_relative=1e-7, relief_relative=0.0, roughness=0.0, common=False)


def answered(feature_set: FeatureSet, uv: object) -> Fix:
    answer = locate(feature_set, uv)
    assert isinstance(answer, Fix), answer
    return answer


def refused(feature_set: FeatureSet, uv: object) -> Status:
    answer = locate(feature_set, uv)
    assert isinstance(answer, Refusal), answer
    return answer.status


@pytest.mark.parametrize("pitch_deg", [-90.0, -65.0, -40.0])
def test_a_click_on_exact_flat_ground_is_exact(pitch_deg: float) -> None:
    rng = np.random.default_rng(3)
    for _ in range(5):
        world = build(rng, EXACT, pitch_deg=pitch_deg)
        for index, uv in enumerate(world.clicks_px):
            assert np.linalg.norm(world.error(index, answered(world.feature_set, uv))) < 1e-3


def test_a_click_through_the_wire_is_where_it_was_before() -> None:
    """Rounding moves an answer by far less than its own error."""
    world = build(np.random.default_rng(4))
    received = decode(encode(world.feature_set))
    for uv in world.clicks_px:
        here, there = answered(world.feature_set, uv), answered(received, uv)
        assert np.linalg.norm(here.offset_enu_m - there.offset_enu_m) < 0.05 * here.ellipse.semi_major_m
        assert there.ellipse.semi_major_m == pytest.approx(here.ellipse.semi_major_m, rel=0.03)


def test_the_stated_ellipse_holds_ninety_percent_of_true_errors_absolute_and_relative() -> None:
    rng = np.random.default_rng(5)
    absolute, relative, heights = [], [], []
    for _ in range(500):
        world = build(rng, features=60)
        locator = Locator(world.feature_set)
        one, two = (locator.locate(uv) for uv in world.clicks_px)
        assert isinstance(one, Fix) and isinstance(two, Fix)
        for index, fix in enumerate((one, two)):
            e = world.error(index, fix)
            absolute.append(e[:2] @ np.linalg.solve(fix.covariance_enu_m2[:2, :2], e[:2]))
            heights.append(e[2] / fix.sigma_height_m)
        difference = world.error(1, two) - world.error(0, one)
        covariance = locator.difference_covariance(*world.clicks_px)
        relative.append(difference[:2] @ np.linalg.solve(covariance[:2, :2], difference[:2]))
    assert 0.87 < np.mean(np.array(absolute) < CHI2_2) < 0.93
    assert 0.87 < np.mean(np.array(relative) < CHI2_2) < 0.93
    assert 0.93 < np.std(heights) < 1.07


def test_two_clicks_of_one_set_differ_by_less_than_their_absolute_errors_suggest() -> None:
    world = build(np.random.default_rng(6), clicks_px=np.array([[300.0, 240.0], [330.0, 250.0]]))
    locator = Locator(world.feature_set)
    difference = locator.difference_covariance(*world.clicks_px)
    fix = answered(world.feature_set, world.clicks_px[0])
    assert difference is not None
    assert np.trace(difference) < 0.5 * 2.0 * np.trace(fix.covariance_enu_m2)


def test_a_click_differs_from_itself_by_nothing() -> None:
    world = build(np.random.default_rng(7))
    difference = Locator(world.feature_set).difference_covariance(world.clicks_px[0], world.clicks_px[0])
    assert difference is not None
    assert np.abs(difference).max() < 1e-6


def test_beyond_the_features_the_plane_answers_with_a_growing_radius_then_refuses() -> None:
    rng = np.random.default_rng(10)
    world = build(rng, Errors(common=False))
    s = world.feature_set
    kept = (s.uv_px[:, 0] < 320.0) & (s.uv_px[:, 1] < 300.0)
    left = dataclasses.replace(
        s,
        uv_px=s.uv_px[kept],
        inverse_depth_per_m=s.inverse_depth_per_m[kept],
        sigma_inverse_depth_per_m=s.sigma_inverse_depth_per_m[kept],
    )
    radii, methods = [], []
    for u in (250.0, 340.0, 370.0, 400.0):
        fix = answered(left, (u, 150.0))
        radii.append(fix.ellipse.semi_major_m)
        methods.append(fix.method)
    assert methods == ["interpolated", "plane", "plane", "plane"]
    assert radii == sorted(radii) and radii[-1] > 1.1 * radii[0]
    assert refused(left, (600.0, 150.0)) is Status.OUTSIDE


def test_clicks_off_the_picture_are_outside() -> None:
    world = build(np.random.default_rng(11))
    for uv in [(-0.6, 100.0), (639.6, 100.0), (100.0, 1e9), (float("nan"), 5.0), (-3.5, -3.5), (float("inf"), 0.0)]:
        assert refused(world.feature_set, uv) is Status.OUTSIDE


def test_a_pixel_where_the_calibration_folds_is_refused_as_such() -> None:
    camera = Camera(640, 480, 400.0, 400.0, 319.5, 239.5, (-0.6, 0.0, 0.0, 0.0, 0.0))
    s = dataclasses.replace(build(np.random.default_rng(12)).feature_set, camera=camera)
    assert refused(s, (1.0, 1.0)) is Status.OUTSIDE_CALIBRATION


def test_the_sky_is_above_the_horizon() -> None:
    """Camera pitched to the horizon: features below, the click above."""
    world = build(np.random.default_rng(13), Errors(common=False))
    s = world.feature_set
    tilted = np.array([0.002, 0.0, 0.0125])  # zero at y = -0.16, in the picture's upper part
    rays = CAMERA.unproject(s.uv_px)[0]
    plane = tilted[0] + rays[:, :2] @ tilted[1:]
    kept = plane > 5e-4
    s = dataclasses.replace(
        s,
        plane_per_m=tilted,
        uv_px=s.uv_px[kept],
        inverse_depth_per_m=plane[kept],
        sigma_inverse_depth_per_m=plane[kept] * 0.005,
    )
    assert isinstance(locate(s, (320.0, 300.0)), Fix)
    for v in (2.0, 40.0, 90.0):
        assert refused(s, (320.0, v)) is Status.ABOVE_HORIZON


@pytest.mark.parametrize("graze_deg", [12.0, 30.0, 60.0, 90.0])
def test_a_radius_over_three_tenths_of_the_height_is_refused_and_one_just_below_is_answered(graze_deg: float) -> None:
    """Whatever the range: 30 % of the height is an eighth of the range at 12 degrees below the horizon."""
    middle = (np.array(CAMERA.size_px) - 1) / 2.0
    largest = 0.3 * math.sin(math.radians(graze_deg)) ** 2 / math.sqrt(CHI2_2)  # by the linear part of (9.17)
    fix = answered(level_ground_by_attitude(graze_deg, 0.95 * largest), middle)
    height_m = -fix.offset_enu_m[2]
    assert 0.27 * height_m < fix.ellipse.semi_major_m < 0.3 * height_m
    assert refused(level_ground_by_attitude(graze_deg, 1.03 * largest), middle) is Status.UNCERTAIN


@pytest.mark.parametrize("status", [s for s in Status if s is not Status.OK])
def test_a_refused_set_hands_its_reason_on(status: Status) -> None:
    assert refused(FeatureSet("v", 1, 2, 3, status, CAMERA), (320.0, 240.0)) is status


def test_a_set_of_the_plane_alone_answers_with_the_planes_error() -> None:
    world = build(np.random.default_rng(15), Errors(common=False, relief_relative=0.05), features=0)
    s = dataclasses.replace(world.feature_set, depth_source=DepthSource.PLANE)
    fix = answered(s, world.clicks_px[0])
    assert fix.method == "plane"
    sigma = math.sqrt(0.05**2 + 9.0 * 0.05**4)  # (9.17)
    expected = sigma * np.linalg.norm(fix.offset_enu_m)
    assert math.sqrt(np.trace(fix.covariance_enu_m2)) == pytest.approx(expected, rel=1e-6)


def test_a_set_without_plane_or_features_refuses() -> None:
    world = build(np.random.default_rng(16), features=0)
    assert refused(world.feature_set, (320.0, 240.0)) is Status.POOR_FIT
    assert refused(dataclasses.replace(world.feature_set, plane_per_m=np.zeros(3)), (9.0, 9.0)) is Status.POOR_FIT


def test_heights_keep_their_datum_and_the_unknown_stays_unknown() -> None:
    world = build(np.random.default_rng(17))
    uv, s = world.clicks_px[0], world.feature_set
    both = answered(s, uv)
    assert both.height_ellipsoid_m - both.height_amsl_m == pytest.approx(20.0)
    amsl = answered(dataclasses.replace(s, undulation_m=float("nan")), uv)
    assert amsl.height_ellipsoid_m is None
    assert amsl.height_amsl_m == pytest.approx(both.height_amsl_m, abs=2e-3)
    ellipsoidal = dataclasses.replace(
        s, height_datum=HeightDatum.ELLIPSOID, camera_height_m=s.camera_height_m + 20.0, undulation_m=float("nan")
    )
    other = answered(ellipsoidal, uv)
    assert other.height_amsl_m is None
    assert other.height_ellipsoid_m == pytest.approx(both.height_ellipsoid_m, abs=1e-6)
    known = answered(dataclasses.replace(ellipsoidal, undulation_m=20.0), uv)
    assert known.height_amsl_m == pytest.approx(both.height_amsl_m, abs=1e-6)


@given(st.floats(0.1, 50.0), st.floats(0.1, 50.0), st.floats(0.0, 179.99))
def test_an_ellipse_states_its_axes_and_azimuth_clockwise_from_north(a: float, b: float, azimuth_deg: float) -> None:
    major, minor = max(a, b) + 0.1, min(a, b)
    t = math.radians(azimuth_deg)
    along = np.array([math.sin(t), math.cos(t)])
    across = np.array([along[1], -along[0]])
    ellipse = Ellipse.from_covariance(major**2 * np.outer(along, along) + minor**2 * np.outer(across, across))
    assert ellipse.semi_major_m == pytest.approx(2.1460 * major, rel=1e-3)
    assert ellipse.semi_minor_m == pytest.approx(2.1460 * minor, rel=1e-3)
    turn = (ellipse.azimuth_deg - azimuth_deg + 90.0) % 180.0 - 90.0
    assert abs(turn) < 1e-3 * major / (major - minor) + 1e-6
    assert 0.0 <= ellipse.azimuth_deg < 180.0


@given(feature_sets(), st.floats(-10.0, 4100.0), st.floats(-10.0, 3100.0))
def test_any_set_and_any_click_end_in_a_finite_answer_or_a_reason(s: FeatureSet, u: float, v: float) -> None:
    answer = Locator(decode(encode(s))).locate((u, v))
    if isinstance(answer, Fix):
        assert np.all(np.isfinite(answer.offset_enu_m)) and np.all(np.isfinite(answer.covariance_enu_m2))
        assert answer.to_json()
    else:
        assert answer.status is not Status.OK


def test_the_origin_is_where_the_worlds_say() -> None:
    np.testing.assert_allclose(ORIGIN.to_enu(-35.36, 149.16, 600.0), 0.0, atol=1e-6)


def level_ground_by_attitude(graze_deg: float, tilt_rad: float, height_m: float = 100.0) -> FeatureSet:
    """Level ground at a known height, seen at an angle below the horizon by a camera whose tilt alone errs."""
    graze = math.radians(graze_deg)
    ahead = np.array([0.0, math.cos(graze), -math.sin(graze)])
    R = np.stack([[1.0, 0.0, 0.0], np.cross(ahead, [1.0, 0.0, 0.0]), ahead], axis=1)
    # w = -(R ray)_z / height, so that d ln w by a rotation is affine in (x, y) to first order about the click
    at = [np.array([0.0, 0.0, 1.0]), np.array([1e-4, 0.0, 1.0]), np.array([0.0, 1e-4, 1.0])]
    u = np.array([[np.cross(axis, R @ ray)[2] / (R @ ray)[2] for axis in np.eye(3)] for ray in at])
    to_common = np.zeros((9, 3))
    to_common[3:6] = np.eye(3)
    to_common[6] = u[0]
    to_common[7:] = (u[1:] - u[0]) / 1e-4
    common = to_common @ np.diag([tilt_rad**2, tilt_rad**2, 0.0]) @ to_common.T
    return FeatureSet(
        vehicle="v",
        session=1,
        frame=1,
        capture_unix_ns=1,
        status=Status.OK,
        camera=CAMERA,
        R_enu_cam=R,
        common_cov=common,
        depth_source=DepthSource.PLANE,
        plane_per_m=-R[2, [2, 0, 1]] / height_m,
    )


def where_tilted_rays_meet_the_ground(answer: Fix, tilt_rad: float, rng: np.random.Generator, n: int) -> np.ndarray:
    """Horizontal errors (n, 2) of an answer when the camera's tilt errs by sampled angles: exact, by Rodrigues."""
    p = answer.offset_enu_m
    turn = np.column_stack([rng.normal(0.0, tilt_rad, (n, 2)), np.zeros(n)])
    angle = np.linalg.norm(turn, axis=1, keepdims=True)
    axis = turn / angle
    ray = p * np.cos(angle) + np.cross(axis, p) * np.sin(angle) + axis * (axis @ p)[:, None] * (1.0 - np.cos(angle))
    meets = ray[:, 2] < -1e-9 * np.linalg.norm(p)
    scale = np.where(meets, p[2] / np.where(meets, ray[:, 2], 1.0), np.inf)
    return np.where(meets[:, None], ray[:, :2] * np.where(meets, scale, 0.0)[:, None] - p[:2], 1e12)


@pytest.mark.parametrize("graze_deg", [5.0, 12.0, 17.0, 28.0, 32.0, 90.0])
@pytest.mark.parametrize("tilt_deg", [0.3, 0.6, 1.0, 1.5, 2.0])
def test_towards_the_horizon_the_ellipse_holds_what_exact_propagation_gives(graze_deg: float, tilt_deg: float) -> None:
    """Where the answer is not refused for its length."""
    tilt = math.radians(tilt_deg)
    answer = locate(level_ground_by_attitude(graze_deg, tilt), (np.array(CAMERA.size_px) - 1) / 2.0)
    if math.sqrt(CHI2_2) * tilt > 0.3 * math.sin(math.radians(graze_deg)) ** 2:
        assert answer.status is Status.UNCERTAIN
        return
    assert isinstance(answer, Fix), answer
    errors = where_tilted_rays_meet_the_ground(answer, tilt, np.random.default_rng(8), 20_000)
    C = answer.covariance_enu_m2[:2, :2]
    chi2 = np.einsum("ni,ij,nj->n", errors, np.linalg.inv(C), errors)
    assert 0.89 < np.mean(chi2 < CHI2_2) < 0.915
    assert np.mean(chi2 < 2.0 * CHI2_2) > 0.968
    if graze_deg == 90.0:
        down = np.linalg.norm(answer.offset_enu_m)
        assert answer.ellipse.semi_major_m == pytest.approx(math.sqrt(CHI2_2) * tilt * down, rel=0.004)


def test_two_clicks_next_to_each_other_near_the_horizon_still_share_what_widens_them() -> None:
    one, two = (np.array(CAMERA.size_px) - 1) / 2.0 + [[0.0, 0.0], [4.0, 0.0]]
    locator = Locator(level_ground_by_attitude(22.0, math.radians(1.0)))
    fix, difference = locator.locate(one), locator.difference_covariance(one, two)
    assert difference is not None
    assert np.all(np.linalg.eigvalsh(difference) > -1e-9)
    assert np.trace(difference) < 0.01 * np.trace(fix.covariance_enu_m2)


@pytest.mark.parametrize("seed", range(6))
def test_many_pixels_at_once_answer_as_each_by_itself(seed: int) -> None:
    """Position, covariance and what a pixel moves it; and a refusal where that one is refused."""
    rng = np.random.default_rng([seed, 77])
    pitch = (-90.0, -65.0, -40.0, -25.0, -15.0, -60.0)[seed]
    s = build(rng, pitch_deg=pitch, features=(100, 100, 80, 60, 100, 5)[seed]).feature_set
    if seed % 2:
        shutter = RollingShutter(0.03, rng.normal(0.0, 0.3, 3), rng.normal(0.0, 15.0, 3), 0.002)
        s = dataclasses.replace(s, shutter=shutter)
    locator = Locator(s)
    uv = rng.uniform(-20.0, [660.0, 500.0], (150, 2))
    found = locator.answers(uv)
    for k, pixel in enumerate(uv):
        answer, parts = locator.locate(pixel), locator.error_parts(pixel)
        assert found.is_answered[k] == isinstance(answer, Fix)
        if isinstance(answer, Fix) and parts is not None:
            assert found.offset_enu_m[k] == pytest.approx(answer.offset_enu_m, rel=1e-9)
            assert found.covariance_enu_m2[k] == pytest.approx(answer.covariance_enu_m2, rel=1e-6, abs=1e-9)
            assert found.by_pixel_m[k] == pytest.approx(parts.by_pixel_m, rel=1e-9)
    assert 20 < np.count_nonzero(found.is_answered) < 150


@pytest.mark.parametrize("source", [DepthSource.PLANE, DepthSource.TERRAIN])
def test_many_pixels_of_known_ground_answer_as_each_by_itself(source: DepthSource) -> None:
    s = dataclasses.replace(build(np.random.default_rng(3)).feature_set, depth_source=source)
    locator = Locator(s)
    uv = np.random.default_rng(4).uniform(0.0, [640.0, 480.0], (60, 2))
    found = locator.answers(uv)
    for k, pixel in enumerate(uv):
        answer = locator.locate(pixel)
        assert found.is_answered[k]
        assert found.covariance_enu_m2[k] == pytest.approx(answer.covariance_enu_m2, rel=1e-6, abs=1e-9)


def test_a_set_that_refuses_answers_none_of_many_pixels() -> None:
    refused = FeatureSet("v", 1, 1, 1, Status.TURNING, CAMERA)
    found = Locator(refused).answers(np.full((7, 2), 100.0))
    assert not found.is_answered.any() and np.isnan(found.offset_enu_m).all() and found.by_pixel_m.shape == (7, 3, 2)


def measured_at(world: World, index: int, depth_share: float, sigma: float = 1e-3) -> FeatureSet:
    """The world's set with one of its clicks measured, at this share of the distance to the ground there."""
    uv = world.clicks_px[index]
    ground = answered(world.feature_set, uv).offset_enu_m
    w = 1.0 / (depth_share * float((world.feature_set.R_enu_cam.T @ ground)[2]))
    pixel = ClickedPixel(float(np.float32(uv[0])), float(np.float32(uv[1])), Measured.MEASURED, w, sigma * w)
    return dataclasses.replace(world.feature_set, clicked=pixel)


def test_a_measured_pixel_is_where_it_was_measured_and_bends_nothing_next_to_it() -> None:
    world = build(np.random.default_rng(31), EXACT, pitch_deg=-60.0)
    uv = world.clicks_px[0]
    roof, ground = measured_at(world, 0, 0.9), answered(world.feature_set, uv)
    fix = answered(roof, uv)
    assert fix.method == "measured"
    np.testing.assert_allclose(fix.offset_enu_m, 0.9 * ground.offset_enu_m, rtol=1e-6)
    together = Locator(roof).answers(np.array([uv + [12.0, 5.0], uv]))
    np.testing.assert_allclose(together.offset_enu_m[1], fix.offset_enu_m, rtol=1e-12)
    np.testing.assert_allclose(together.covariance_enu_m2[1], fix.covariance_enu_m2, rtol=1e-9)
    for step in ([0.6, 0.0], [0.0, -1.0], [12.0, 5.0]):
        one, other = answered(roof, uv + step), answered(world.feature_set, uv + step)
        assert one.method == "interpolated" and one.to_json() == other.to_json()
    again = answered(decode(encode(roof)), uv)
    assert again.method == "measured"
    np.testing.assert_allclose(again.offset_enu_m, fix.offset_enu_m, atol=0.02)


@pytest.mark.parametrize("pitch_deg", [-90.0, -50.0])
def test_the_height_above_the_ground_is_that_of_the_ground_below(pitch_deg: float) -> None:
    world = build(np.random.default_rng(32), EXACT, pitch_deg=pitch_deg)
    fix = answered(measured_at(world, 0, 0.92), world.clicks_px[0])
    level_m = answered(world.feature_set, world.clicks_px[0]).offset_enu_m[2]  # the world is level
    assert fix.above_ground_m == pytest.approx(fix.offset_enu_m[2] - level_m, abs=0.02)
    assert fix.sigma_above_ground_m < 0.005 * abs(level_m)
    assert '"above_ground_m": ' in fix.to_json() and "above the ground" in fix.to_text()


@pytest.mark.parametrize("measured", [m for m in Measured if m is not Measured.MEASURED])
def test_a_pixel_that_was_not_measured_is_answered_as_ever_with_the_reason(measured: Measured) -> None:
    world = build(np.random.default_rng(34))
    u, v = (float(np.float32(c)) for c in world.clicks_px[0])
    asked = dataclasses.replace(world.feature_set, clicked=ClickedPixel(u, v, measured))
    fix, plain = answered(asked, (u, v)), answered(world.feature_set, (u, v))
    assert fix.unmeasured == measured.value and fix.method == plain.method
    np.testing.assert_array_equal(fix.offset_enu_m, plain.offset_enu_m)
    assert json.loads(fix.to_json())["unmeasured"] == measured.value


def test_the_difference_of_a_measured_and_another_click_leaves_out_what_they_share() -> None:
    world = build(np.random.default_rng(35))
    locator = Locator(measured_at(world, 0, 0.95))
    one, two = (world.clicks_px[i] for i in (0, 1))
    apart = locator.difference_covariance(one, two)
    assert apart is not None
    separate = sum(np.trace(f.covariance_enu_m2) for f in map(locator.locate, (one, two)) if isinstance(f, Fix))
    assert 0.0 < np.trace(apart) < separate
    same = locator.difference_covariance(one, one)
    assert same is not None and np.abs(same).max() < 1e-6
    parts = locator.error_parts(one)
    assert parts.between_features == 0.0 and parts.feature_noise == pytest.approx(1e-3, rel=0.02)
