"""A thermal camera next to the first one: its rays, whose pose is known with an error, on the first one's ground."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from contract.answer import Fix
from contract.feature_set import FeatureSet, Status
from contract.geodesy import LocalFrame
from contract.locate import Locator
from contract.rotations import exp_so3
from ground.two_sets import position_jacobian
from onboard.config.second_camera import SecondCamera
from onboard.spots.bracketed import Bracketed, BracketedPictures
from onboard.spots.second_camera import STATES, Mount, Pointing, _transport, pixel_of_first, set_of_second
from tests.onboard.spots.scenes import BOSON, ORIGIN
from tests.onboard.spots.two_cameras import VISIBLE, Turn, thermal_frame

Array = NDArray[np.float64]

LOST_S = 1.5
TURN = Turn()
STATED = SecondCamera(file="thermal.json", roll_deg=1.0, pitch_deg=-6.0, yaw_deg=3.0)
NOW_S = 2.07  # between pictures 10 and 11
PLACES = [np.array([float(east), float(north), 0.0]) for east in (-3, 12, 24) for north in (20, 36, 52)]


def look(time_s: float = NOW_S, turn: Turn = TURN) -> Bracketed:
    number = int(time_s * turn.rate_hz)
    return Bracketed(thermal_frame(time_s), turn.first_set(number), turn.first_set(number + 1), (0.0, 0.0))


def second(mount: Mount, found: Bracketed | None = None) -> tuple[FeatureSet, Pointing]:
    s, pointing = set_of_second(found or look(), BOSON, mount, LOST_S)
    assert s.is_ok and pointing is not None
    return s, pointing


def fix_of(s: FeatureSet, uv_px: Array, root: Array | None = None) -> Fix:
    answer = Locator(s).locate(uv_px, root)
    assert isinstance(answer, Fix), answer
    return answer


def place_m(s: FeatureSet, fix: Fix) -> Array:
    return ORIGIN.to_enu(fix.lat_deg, fix.lon_deg, float(fix.height_amsl_m or 0.0))


def turned(mount: Mount, state: Array) -> Mount:
    return replace(mount, R_first_second=mount.R_first_second @ exp_so3(state[:3]), late_s=mount.late_s + state[3])


@pytest.mark.parametrize("place", PLACES)
def test_a_spot_falls_where_it_is_in_a_turn_between_two_pictures(place: Array) -> None:
    mount = Mount.stated(STATED)
    uv = TURN.pixel(NOW_S, mount.R_first_second, place)
    if not BOSON.contains(uv):
        pytest.fail("the place is not in the picture")
    s, _ = second(mount)
    # a fifth of a second of a turn of 0.15 rad/s is taken as straight: 1/8 (0.2 s)^2 v omega = 10 mm
    assert np.linalg.norm(place_m(s, fix_of(s, uv)) - place) < 0.03
    assert s.frame == 10 and s.capture_unix_ns == look().frame.stamp_ns


def test_seen_with_the_first_cameras_own_eyes_it_answers_as_the_first_camera_does() -> None:
    mount = Mount(np.eye(3), 0.0, np.zeros((STATES, STATES)))
    found = look(2.0)
    s, _ = set_of_second(found, VISIBLE, mount, LOST_S)
    for uv in ((200.0, 300.0), (640.0, 480.0), (1100.0, 800.0)):
        mine, theirs = fix_of(s, np.array(uv)), fix_of(found.before, np.array(uv))
        np.testing.assert_allclose(mine.offset_enu_m, theirs.offset_enu_m, atol=1e-3)
        np.testing.assert_allclose(mine.covariance_enu_m2, theirs.covariance_enu_m2, rtol=1e-3, atol=1e-5)


@pytest.mark.parametrize("place", PLACES[::2])
def test_how_the_mount_moves_a_spot_is_what_finite_differences_say(place: Array) -> None:
    mount = Mount.stated(STATED)
    s, pointing = second(mount)
    uv = TURN.pixel(NOW_S, mount.R_first_second, place)
    parts = Locator(s).error_parts(uv)
    stated = parts.by_pixel_m @ pointing.by_state(uv)
    for k, step in enumerate((1e-3, 1e-3, 1e-3, 1e-2)):
        state = np.eye(STATES)[k] * step
        ahead, behind = (second(turned(mount, sign * state))[0] for sign in (1.0, -1.0))
        moved = (place_m(ahead, fix_of(ahead, uv)) - place_m(behind, fix_of(behind, uv))) / (2.0 * step)
        assert np.linalg.norm(stated[:, k] - moved) < 0.02 * np.linalg.norm(moved), (k, stated[:, k], moved)


def test_the_first_cameras_errors_act_on_a_spot_as_on_its_own_clicks() -> None:
    way, R12 = np.array([1.5, 2.0, 0.2]), exp_so3([0.12, -0.05, 0.03])
    one = TURN.first_set(10)
    two = replace(one, R_enu_cam=one.R_enu_cam @ R12)
    T = _transport(R12, way)
    for xy in ((0.0, 0.0), (0.2, -0.1), (-0.3, 0.3)):
        p = two.R_enu_cam @ np.array([*xy, 1.0]) * 95.0
        here, there = position_jacobian(one, p + way), position_jacobian(two, p) @ T
        off = np.linalg.norm(here - there, axis=0)
        assert np.all(off[:6] < 1e-9)
        assert np.all(off[6:] < 0.05 * np.linalg.norm(p))  # to first order in the way and the rotation
        assert off[6] < (1e-9 if xy == (0.0, 0.0) else 1.0)


def sampled(rng: np.random.Generator, stated: Mount) -> tuple[float, float]:
    """One spot of a flight with errors: squared distance from the truth in its covariance, and semi-major axis, m."""
    state = np.linalg.cholesky(stated.covariance) @ rng.standard_normal(STATES)
    truth = turned(stated, state)
    place, error = PLACES[rng.integers(len(PLACES))], rng.standard_normal(9)
    uv = TURN.pixel(NOW_S + state[3], truth.R_first_second, place)
    sets = []
    for number in (10, 11):  # a pose's error is the same in both
        s = TURN.first_set(number)
        e = np.sqrt(np.diag(s.common_cov)) * error
        lat, lon, height = LocalFrame(s.camera_lat_deg, s.camera_lon_deg, s.camera_height_m).to_geodetic(e[:3])
        wrong = replace(
            s, camera_lat_deg=float(lat), camera_lon_deg=float(lon), camera_height_m=float(height),
            R_enu_cam=exp_so3(e[3:6]) @ s.R_enu_cam, inverse_depth_per_m=s.inverse_depth_per_m * (1.0 + e[6]),
            plane_per_m=s.plane_per_m * (1.0 + e[6]),
        )  # fmt: skip
        sets.append(wrong)
    s, pointing = second(stated, Bracketed(thermal_frame(NOW_S), sets[0], sets[1], (0.0, 0.0)))
    fix = fix_of(s, uv, pointing.root(uv))
    off, cov = (place_m(s, fix) - place)[:2], fix.covariance_enu_m2[:2, :2]
    return float(off @ np.linalg.solve(cov, off)), fix.ellipse.semi_major_m


def test_spots_are_inside_their_ellipse_and_without_the_mounts_error_they_would_not_be() -> None:
    rng, stated = np.random.default_rng(11), Mount.stated(STATED)
    found = np.array([sampled(rng, stated) for _ in range(400)])
    inside = float(np.mean(found[:, 0] < 4.605))
    assert 0.86 < inside < 0.94
    surer = replace(stated, covariance=1e-4 * stated.covariance)
    s, pointing = second(surer)
    uv = TURN.pixel(NOW_S, stated.R_first_second, PLACES[4])
    assert fix_of(s, uv, pointing.root(uv)).ellipse.semi_major_m < 0.8 * float(np.median(found[:, 1]))


def test_a_spot_is_shown_where_the_first_cameras_picture_has_it() -> None:
    mount = Mount.stated(STATED)
    s, _ = second(mount)
    for place in PLACES:
        uv = TURN.pixel(NOW_S, mount.R_first_second, place)
        shown = pixel_of_first(look(), s, mount, uv)
        assert np.linalg.norm(shown - TURN.pixel(2.0, np.eye(3), place, VISIBLE)) < 1.0
    lost = FeatureSet("uav-1", 7, 10, 0, Status.TURNING, BOSON)
    middle = pixel_of_first(look(), lost, Mount.stated(SecondCamera(file="x")), np.array([319.5, 255.5]))
    np.testing.assert_allclose(middle, (639.5, 479.5))


@pytest.mark.parametrize(("before", "after", "status"), [
    (Status.OK, Status.TURNING, Status.TURNING),
    (Status.FEATURELESS, Status.OK, Status.FEATURELESS),
    (Status.OK, None, Status.CAMERA_LOST),
])  # fmt: skip
def test_what_refuses_the_first_camera_refuses_the_second(before: Status, after: Status | None, status: Status) -> None:
    late = None if after is None else TURN.first_set(11, after)
    found = Bracketed(thermal_frame(NOW_S), TURN.first_set(10, before), late)
    s, pointing = set_of_second(found, BOSON, Mount.stated(STATED), LOST_S)
    assert (s.status, s.camera, s.frame, pointing) == (status, BOSON, 10 if after is None else s.frame, None)


def test_pictures_too_far_apart_are_a_camera_that_was_lost() -> None:
    found = Bracketed(thermal_frame(NOW_S), TURN.first_set(5), TURN.first_set(14))
    assert set_of_second(found, BOSON, Mount.stated(STATED), LOST_S)[0].status is Status.CAMERA_LOST


def test_pictures_wait_for_the_set_after_them_and_each_is_given_once() -> None:
    pictures = BracketedPictures(rate_hz=2.0, late_s=2.0)
    assert not pictures.picture(thermal_frame(-0.5))  # before any set: there is no session yet
    given = []
    for k in range(40):
        given += pictures.picture(thermal_frame(0.05 + 0.1 * k, k))
        if k % 2 == 0:
            given += pictures.feature_set(TURN.first_set(k // 2))
            assert not pictures.feature_set(TURN.first_set(k // 2))
    times = [(one.frame.stamp_ns - thermal_frame(0.0).stamp_ns) / 1e9 for one in given]
    assert len(times) == 8 and all(0.45 < b - a < 0.65 for a, b in pairwise(times))
    for one in given:
        assert one.after.frame == one.before.frame + 1
        assert one.before.capture_unix_ns <= one.frame.stamp_ns < one.after.capture_unix_ns
    assert len({one.nearest.frame for one in given}) == len(given)


def test_when_the_first_camera_stops_pictures_are_given_up_after_a_while_and_reported_to_have_no_place() -> None:
    pictures = BracketedPictures(rate_hz=2.0, late_s=2.0)
    for k in range(10):
        pictures.feature_set(TURN.first_set(k))
    given = [one for k in range(60) for one in pictures.picture(thermal_frame(2.0 + 0.1 * k, k))]
    # one picture of the first camera is the nearest of all of them: said once, not again and again
    assert len(given) == 1 and given[0].after is None and given[0].before.frame == 9


def test_how_evenly_the_camera_moves_is_judged_by_its_own_poses() -> None:
    def accelerations(turn: Turn) -> tuple[float, float]:
        pictures = BracketedPictures(rate_hz=2.0, late_s=2.0)
        for k in range(80):
            pictures.feature_set(turn.first_set(k))
        (one,) = pictures.picture(thermal_frame(15.7)) or pictures.feature_set(turn.first_set(80))
        return one.accelerations

    assert max(accelerations(Turn(turn_rad_s=0.0))) < 1e-3
    angular, linear = accelerations(TURN)
    assert angular < 1e-2
    assert linear == pytest.approx(14.0 * 0.15 / np.sqrt(3.0), rel=0.05)
