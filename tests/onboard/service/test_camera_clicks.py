"""Clicks of a camera component next to the pipeline: what is clicked is followed, with the click's own uncertainty."""

import math

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from contract.answer import Fix
from contract.feature_set import Status
from contract.mavlink_camera.clicks import MAX_ASKED, WAIT_S, CameraClicks
from contract.mavlink_camera.end import Clicked, VideoClick, View, ViewQuestion
from contract.mavlink_camera.messages import CameraFacts
from contract.track import TrackState
from onboard.config.schema import parse_config
from onboard.service.track_thread import TrackThread
from tests.onboard.tracks.flat_world import CAMERA, EPOCH_NS, PLACE, RATE_HZ, Thing, World, at

DELAY_S, SIGMA_S, CAR_M_S = 0.5, 0.1, 4.0
CONFIG = parse_config('[vehicle]\nid = "uav-1"\n')
FACTS = CameraFacts(mavlink, "uav-1", CAMERA, RATE_HZ, None, 0)
CAR = Thing(at(-10.0, 0.0, (CAR_M_S, 0.0)), 2.0)


class Flight:
    """Pictures, sets, tracks and clicks by hand: a clock goes on by a tenth of a second a picture."""

    def __init__(self, world: World | None = None, *, follows: bool = True) -> None:
        self.world, self.number = world or World((CAR,)), 0
        self.clicks = CameraClicks("uav-1", DELAY_S, SIGMA_S, self.now_s)
        self.tracks = TrackThread(CONFIG, [self.clicks.tracks], self.now_s)
        if follows:
            self.clicks.follow = self.tracks.answer

    def now_s(self) -> float:
        return self.number / RATE_HZ

    def fly(self, pictures: int) -> None:
        for _ in range(pictures):
            self.tracks.event(0, self.world.frame(self.number))
            its_set = self.world.its_set(self.number)
            self.tracks.feature_set(its_set)
            self.clicks.feature_set(its_set)
            self.number += 1
            self.tracks.work()
            self.clicks.work()

    def click(self, number: int = 1, share: tuple[float, float] | None = None) -> bool:
        """On the car as the video shows it, `DELAY_S` late, at the newest picture's moment."""
        newest = self.number - 1
        if share is None:
            u, v = self.world.pixel(self.world.things[0], newest - round(DELAY_S * RATE_HZ))
            share = float((u + 0.5) / CAMERA.width_px), float((v + 0.5) / CAMERA.height_px)
        return self.clicks.ask(VideoClick(number, share, EPOCH_NS + round(newest / RATE_HZ * 1e9)))

    def answer(self) -> Clicked:
        (found,) = self.clicks.answers()
        assert isinstance(found, Clicked)
        return found


def test_a_car_that_is_clicked_in_the_late_video_is_followed_from_there_on() -> None:
    flight = Flight()
    flight.fly(20)
    assert flight.click()
    flight.fly(1)
    assert flight.answer().is_followed and flight.clicks.is_following
    flight.fly(30)
    report = flight.clicks.followed()
    assert report.state is TrackState.FOLLOWED
    picture = FACTS.image_status(report)
    assert (picture.tracking_status, picture.tracking_mode, picture.target_data) == (1, 1, 4)
    u, v = flight.world.pixel(CAR, report.frame)
    assert abs(picture.point_x * CAMERA.width_px - u) < 3.0 and abs(picture.point_y * CAMERA.height_px - v) < 3.0
    assert 0.3 * 10.0 < picture.radius * CAMERA.width_px < 30.0 and math.isnan(picture.rec_top_x)
    geo = FACTS.geo_of_track(report)
    assert geo.tracking_status == 1
    east_m, north_m, _ = PLACE.to_enu(geo.lat * 1e-7, geo.lon * 1e-7, geo.alt)
    error_m = np.array([east_m, north_m]) - CAR.place((report.capture_unix_ns - EPOCH_NS) / 1e9)
    assert np.linalg.norm(error_m) < geo.h_acc < 4.0
    assert abs(geo.vel_e - CAR_M_S) < 0.4 and abs(geo.vel_n) < 0.4 and math.isnan(geo.vel_d) and geo.vel_acc < 1.0
    flight.clicks.stop()
    flight.clicks.work()
    assert flight.clicks.followed() is None and flight.tracks.answer("") == (b'{"tracks":[]}', False)


def test_of_what_is_followed_from_a_moving_camera_the_ellipse_keeps_the_clicks_own_uncertainty() -> None:
    speed_m_s = 8.0
    widths_m = []
    for sigma_s in (0.0, 0.3):
        flight = Flight(World((Thing(at(12.0, 0.0), 2.0),), camera=lambda t: (speed_m_s * t, 0.0)))
        flight.clicks._sigma_s = sigma_s
        flight.fly(16)
        flight.click()
        flight.fly(16)
        report = flight.clicks.followed()
        widths_m.append(report.place.ellipse.semi_major_m)
    added_m = math.sqrt(widths_m[1] ** 2 - widths_m[0] ** 2)
    assert 0.9 < added_m / (2.146 * speed_m_s * 0.3) < 1.1


def test_a_stop_ends_a_click_that_waits_and_one_that_is_being_answered() -> None:
    flight = Flight()
    flight.fly(20)
    flight.click()
    flight.clicks.stop()
    flight.fly(2)
    assert not flight.clicks.answers() and flight.tracks.answer("") == (b'{"tracks":[]}', False)
    follow = flight.tracks.answer

    def stopped_meanwhile(parameters: str) -> tuple[bytes, bool]:
        answer = follow(parameters)
        if "u=" in parameters:
            flight.clicks.stop()
        return answer

    flight.clicks.follow = stopped_meanwhile
    flight.click(2)
    flight.fly(3)
    assert not flight.answer().is_followed and not flight.clicks.is_following
    assert flight.tracks.answer("") == (b'{"tracks":[]}', False)


def test_a_click_waits_for_the_pictures_of_its_moment_and_not_for_ever() -> None:
    flight = Flight()
    flight.fly(20)
    newest_ns = EPOCH_NS + round(1.9e9)
    flight.clicks.ask(VideoClick(1, (0.5, 0.5), newest_ns + round(0.6e9)))  # its moment is 0.1 s ahead
    flight.clicks.work()
    assert not flight.clicks.answers()
    flight.fly(2)
    assert isinstance(flight.answer().answer, Fix)
    flight.clicks.ask(VideoClick(2, (0.5, 0.5), newest_ns + round(60e9)))
    for _ in range(round(WAIT_S * RATE_HZ)):
        flight.clicks.work()
        assert not flight.clicks.answers()
        flight.number += 1
    flight.clicks.work()
    answer = flight.answer().answer
    assert answer.status is Status.STALE


def test_many_at_once_are_turned_away_and_the_last_is_what_is_followed() -> None:
    flight = Flight()
    flight.fly(20)
    taken = [flight.click(number, (0.3 + 0.02 * number, 0.5)) for number in range(10)]
    assert taken == [True] * MAX_ASKED + [False] * 6
    flight.fly(2)
    found = flight.clicks.answers()
    assert [answer.number for answer in found] == list(range(MAX_ASKED))
    assert flight.tracks.answer("")[0].count(b",") == 0  # one track is left of the four


@pytest.mark.parametrize(
    ("follows", "share", "why"), [(False, (0.5, 0.5), ""), (True, (0.01, 0.5), "edge")], ids=["nothing follows", "edge"]
)
def test_a_place_is_given_also_where_nothing_can_be_followed(
    follows: bool, share: tuple[float, float], why: str
) -> None:
    flight = Flight(follows=follows)
    flight.fly(20)
    flight.click(1, share)
    flight.fly(1)
    found = flight.answer()
    assert isinstance(found.answer, Fix) and not found.is_followed and why in found.unfollowed
    assert not flight.clicks.is_following and flight.clicks.followed() is None


def test_what_no_report_comes_of_is_not_followed_any_more() -> None:
    flight = Flight()
    flight.fly(20)
    flight.click()
    flight.fly(1)
    assert flight.clicks.is_following
    flight.number += 31
    assert not flight.clicks.is_following


def test_what_was_reported_a_while_ago_is_where_it_may_be_by_now() -> None:
    """The standard's message has no time: a report of before, sent as it was, was 4 m off in a second, 3 m stated."""
    flight = Flight()
    flight.fly(20)
    flight.click()
    flight.fly(25)
    fresh = flight.clicks.followed()
    flight.number += 15  # no report comes
    report = flight.clicks.followed()
    assert report.state is TrackState.COASTING
    off_m = np.array(PLACE.to_enu(report.place.lat_deg, report.place.lon_deg, 100.0)[:2]) - CAR.place(flight.now_s())
    assert np.linalg.norm(off_m) < report.place.ellipse.semi_major_m < 12.0
    assert report.place.ellipse.semi_major_m > fresh.place.ellipse.semi_major_m + 1.0
    flight.clicks.stamped_ago_s = lambda unix_ns: 4.0  # on its way as well
    report = flight.clicks.followed()
    assert report.place.ellipse.semi_major_m > 15.0
    flight.number += 10
    report = flight.clicks.followed()
    assert report.place is None and FACTS.geo_of_track(report) is None


def test_who_answers_without_a_track_follows_nothing() -> None:
    flight = Flight()
    flight.clicks.follow = lambda parameters: (b"{}", False)
    flight.fly(20)
    flight.click()
    flight.fly(1)
    assert not flight.answer().is_followed and not flight.clicks.is_following


def test_the_view_is_the_newest_picture_that_has_a_pose() -> None:
    flight = Flight()
    flight.clicks.ask(ViewQuestion(1))
    flight.clicks.work()
    (nothing,) = flight.clicks.answers()
    assert isinstance(nothing, View) and nothing.feature_set is None
    flight.fly(3)
    flight.clicks.ask(ViewQuestion(2))
    flight.clicks.work()
    (view,) = flight.clicks.answers()
    assert isinstance(view, View) and view.feature_set.frame == 2
    assert isinstance(view.middle, Fix) and 0.0 <= view.age_s < 0.2
    flight.number += 31  # no picture comes any more: where it looks now is not known
    flight.clicks.ask(ViewQuestion(3))
    flight.clicks.work()
    (view,) = flight.clicks.answers()
    assert isinstance(view, View) and view.feature_set is None
