"""Spots of many pictures become things: one stays one, two stay two, walkers get a course, ellipses stay true."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from contract.feature_set import Status
from contract.spot import Spot, SpotReport
from ground.spots.found_thing import FoundThing
from ground.spots.merging import MOST_KEPT_SPOTS, SpotMerger
from tests.ground.spots.sampled_spots import (
    ROOT_CHI2,
    START_NS,
    Flight,
    covariance,
    is_inside,
    offset_m,
    place_at,
    spot_at,
)

Things = Callable[[float], Sequence[Sequence[float]]]


def merged(things: Things, pictures: int, *flights: Flight) -> list[FoundThing]:
    merger = SpotMerger()
    for flight in flights:
        for report in flight.reports(things, pictures):
            merger.add(report)
    return merger.things()


def standing(*places: tuple[float, float]) -> Things:
    return lambda _: places


def walking(t: float) -> list[tuple[float, float]]:
    return [(1.4 * t, 0.0)]


def flight(seed: int, **more: Any) -> Flight:
    return Flight(np.random.default_rng(seed), **more)


def test_one_thing_stays_one_and_its_ellipse_does_not_shrink_with_the_number_of_pictures() -> None:
    (once,) = merged(standing((3.0, 4.0)), 1, flight(1))
    (often,) = merged(standing((3.0, 4.0)), 100, flight(1))
    shared = math.sqrt(0.6)
    assert shared < often.place.ellipse.semi_major_m / once.place.ellipse.semi_major_m < 1.1 * shared
    assert often.pictures == 100 and often.is_sure and not once.is_sure
    # With nothing shared it does, as far as the things' extent is no part of it.
    alone = {"picture_share": 0.0, "session_share": 0.0}
    (once,), (often,) = (merged(standing((3.0, 4.0)), n, flight(1, **alone)) for n in (1, 100))
    assert 0.09 < often.place.ellipse.semi_major_m / once.place.ellipse.semi_major_m < 0.11


def test_neighbouring_pictures_share_errors_so_that_ten_of_one_second_say_less_than_ten_of_a_minute() -> None:
    quick, slow = (
        merged(standing((0.0, 0.0)), 10, flight(3, interval_s=interval_s, session_share=0.0, picture_share=0.8))[0]
        for interval_s in (0.1, 6.0)
    )
    assert 1.5 < quick.place.ellipse.semi_major_m / slow.place.ellipse.semi_major_m < 3.0


@pytest.mark.parametrize("sigmas_m", [(1.0, 2.0), (2.0, 1.0)])
def test_of_two_pictures_the_surer_places_a_thing_and_the_other_leads_nowhere_beyond(
    sigmas_m: tuple[float, float],
) -> None:
    """Their ellipses differ as a window's weights do: what is wider is no larger multiple of the same error.

    It was taken for one: two places 2 m apart, one known half as well, were one thing 1.8 m beyond the surer.
    """
    merger = SpotMerger()
    for k, sigma_m in enumerate(sigmas_m):
        spot = spot_at(2.0 * k, 0.0, covariance(sigma_m, sigma_m, 0.0))
        merger.add(SpotReport(1, k, START_NS + k * 10**8, True, (spot,), 0, 1.0, 0.3, "uav-1"))
    (found,) = merger.things()
    east_m, _ = offset_m(found.place, (2.0 * int(np.argmin(sigmas_m)), 0.0))
    assert abs(east_m) < 0.3
    surest_m = ROOT_CHI2 * min(sigmas_m)
    assert 0.8 * surest_m < found.place.ellipse.semi_major_m < 1.1 * surest_m


def test_two_spots_too_far_apart_for_standing_are_one_that_goes_and_it_is_where_it_was_seen_last() -> None:
    """It was placed midway between the two, 3.5 m off, as one that stands."""
    merger = SpotMerger()
    for k, east_m in enumerate((0.0, 7.0)):
        spot = spot_at(east_m, 0.0, covariance(1.6, 1.2, 30.0))
        merger.add(SpotReport(1, k, START_NS + 2 * k * 10**9, True, (spot,), 0, 0.95, 0.9, "uav-1"))
    (found,) = merger.things()
    assert np.hypot(*offset_m(found.place, (7.0, 0.0))) < 0.5 and found.course is None


def test_a_thing_is_where_it_is_wherever_on_earth_the_first_one_was() -> None:
    """Without a fix an autopilot may state a place near 0, 0."""
    merger, spot = SpotMerger(), spot_at(30.0, -40.0, covariance(1.6, 1.2, 30.0))
    assert spot.place is not None
    places = [(0.0, 0.0), (43.5, -7.5), (spot.place.lat_deg, spot.place.lon_deg)]
    for number, (lat_deg, lon_deg) in enumerate(places):
        there = replace(spot, place=replace(spot.place, lat_deg=lat_deg, lon_deg=lon_deg))
        for frame in (2 * number, 2 * number + 1):
            merger.add(SpotReport(1, frame, START_NS + frame * 10**9, True, (there,), 0, 0.8, 0.6, "uav-1"))
        found = merger.things()
        assert [thing.pictures for thing in found] == [2] * (number + 1)
        assert found[-1].place.lat_deg == pytest.approx(lat_deg, abs=1e-7)
        assert found[-1].place.lon_deg == pytest.approx(lon_deg, abs=1e-7)


def test_two_people_5_m_apart_are_two() -> None:
    for seed in range(6):
        found = merged(standing((0.0, 0.0), (5.0, 0.0)), 25, flight(seed))
        assert len(found) == 2 and [thing.pictures for thing in found] == [25, 25]
        # Where they are errs by what all pictures share; how far from each other they are does not.
        apart = offset_m(found[1].place, (0.0, 0.0)) - offset_m(found[0].place, (0.0, 0.0))
        assert np.hypot(*apart) == pytest.approx(5.0, abs=1.0)


def test_in_one_picture_two_spots_are_two_things_however_near() -> None:
    assert len(merged(standing((0.0, 0.0), (0.3, 0.0)), 1, flight(0))) == 2


def test_a_walker_is_one_thing_with_speed_and_course() -> None:
    for seed in range(6):
        (found,) = merged(walking, 21, flight(seed))
        course = found.course
        assert course.is_moving and course.course_deg is not None
        assert course.speed_m_s == pytest.approx(1.4, abs=0.5) and 0.05 < course.sigma_speed_m_s < 0.5
        assert course.course_deg == pytest.approx(90.0, abs=20.0) and 1.0 < (course.sigma_course_deg or 0.0) < 20.0
        assert np.hypot(*offset_m(found.place, (14.0, 0.0))) < 6.0  # it is where it is, not in the middle of its way
    assert "m/s towards" in found.to_text()


def test_one_that_stands_is_at_rest_and_nothing_is_reported_of_a_speed_at_once() -> None:
    (early,) = merged(standing((0.0, 0.0)), 4, flight(2))
    assert early.course is None and "speed not known" in early.to_text()
    (later,) = merged(standing((0.0, 0.0)), 40, flight(2))
    assert not later.course.is_moving and "at rest" in later.to_text()


def test_a_walker_who_stops_is_at_rest_where_he_stopped() -> None:
    (found,) = merged(lambda t: [(1.4 * min(t, 15.0), 0.0)], 90, flight(5))
    assert not found.course.is_moving
    assert np.hypot(*offset_m(found.place, (21.0, 0.0))) < 6.0


def test_another_aircraft_makes_the_place_better_and_another_session_of_the_same_in_its_own_errors_alone() -> None:
    """A restart in flight keeps receiver and mount: as if it shared nothing, two such sessions were inside 74 %."""
    (alone,) = merged(standing((3.0, 4.0)), 30, flight(1))
    others = [({"vehicle": "uav-2"}, math.sqrt(0.5), 0.05), ({"session": 2}, 0.95, 0.05)]
    for other, share, off in others:
        (found,) = merged(standing((3.0, 4.0)), 30, flight(1), flight(2, begin_s=100.0, **other))
        assert found.vehicles == tuple(sorted({"uav-1", other.get("vehicle", "uav-1")})) and found.pictures == 60
        assert found.place.ellipse.semi_major_m / alone.place.ellipse.semi_major_m == pytest.approx(share, rel=off)


def until_30_s(t: float) -> list[tuple[float, float]]:
    """1.3 m/s to the east, then standing."""
    return [(1.3 * min(t, 30.0), 0.0)]


def ellipses_off(things: Things, after_s: float, *flights: tuple[Flight, int]) -> tuple[list[float], int]:
    """The distances, in semi-axes, of each report's thing after a moment from the truth then; and the number of things.

    Of flights and their numbers of pictures, as their reports come.
    """
    reports = [report for flight, pictures in flights for report in flight.reports(things, pictures)]
    merger, off = SpotMerger(), []
    for report in sorted(reports, key=lambda one: one.capture_unix_ns):
        at_s = (report.capture_unix_ns - START_NS) / 1e9
        for found in merger.add(report):
            if at_s >= after_s:
                away_m = float(np.hypot(*offset_m(found.place, things(at_s)[0])))
                off.append(away_m / found.place.ellipse.semi_major_m)
    return off, len(merger.things())


@pytest.mark.parametrize(
    ("things", "begin_s", "other"),
    [
        pytest.param(walking, 20.2, {"vehicle": "uav-2"}, id="both watch"),
        pytest.param(walking, 30.2, {"vehicle": "uav-2"}, id="handed over"),
        pytest.param(until_30_s, 33.2, {"vehicle": "uav-2"}, id="he stands when the second sees him"),
        pytest.param(until_30_s, 31.2, {"session": 2}, id="the first began again"),
    ],
)
def test_a_walker_is_where_the_newest_session_has_him_whoever_saw_him_go(
    things: Things, begin_s: float, other: dict[str, Any]
) -> None:
    """His place was the mean with the middle of his way, as one that had never gone: 7.7 ellipses off, and for good
    where he stood by then.
    """
    for seed in range(4):
        second = flight(seed + 100, begin_s=begin_s, **other)
        off, count = ellipses_off(things, 15.0, (flight(seed), 61), (second, 40))
        assert count == 1 and max(off) < 2.0


def test_who_was_seen_to_walk_once_and_stands_is_one_thing_in_every_later_pass() -> None:
    merger = SpotMerger()
    later = flight(3, vehicle="uav-2", begin_s=60.0, interval_s=25.0)  # longer apart than one is looked for who goes
    for report in [*flight(9).reports(until_30_s, 61), *later.reports(until_30_s, 20)]:
        merger.add(report)
    (found,) = merger.things()
    assert np.hypot(*offset_m(found.place, (39.0, 0.0))) < 6.0 and found.course is not None
    assert not found.course.is_moving


@pytest.mark.parametrize(("interval_s", "pictures"), [(25.0, 24), (5.0, 40)])
def test_one_who_stands_and_is_seen_now_and_then_has_not_moved_and_stays_one_thing(
    interval_s: float, pictures: int
) -> None:
    """A walk that may have been meanwhile explains any place, and was taken for evidence: he became three."""
    for seed in range(5):
        (found,) = merged(standing((3.0, 4.0)), pictures, flight(seed, interval_s=interval_s))
        assert found.pictures == pictures
        # The place is that of all pictures, with what they do not share averaged.
        assert found.place.ellipse.semi_major_m < 0.85 * ROOT_CHI2 * 1.6
        assert found.course is None or not found.course.is_moving


def test_two_sessions_that_contradict_each_other_are_not_averaged() -> None:
    """The other's first picture may agree by chance with a thing from which its others lead away."""
    sure = {"picture_share": 0.3, "session_share": 0.0}
    merger = SpotMerger()
    for report in flight(1, **sure).reports(standing((0.0, 0.0)), 60):
        merger.add(report)
    for report in flight(6, vehicle="uav-2", begin_s=100.0, **sure).reports(standing((5.5, 0.0)), 60):
        merger.add(report)
    newest = merger.things()[-1]
    assert newest.newest.vehicle == "uav-2" and np.hypot(*offset_m(newest.place, (5.5, 0.0))) < 1.0


def test_the_hottest_picture_and_the_best_one_are_kept() -> None:
    merger = SpotMerger()
    cov = covariance(1.0, 1.0, 0.0)
    heats = [(30.0, 8.0, 10.0, False), (36.0, 14.0, 9.0, False), (31.0, 9.0, 20.0, True), (30.0, 8.0, 12.0, False)]
    for k, (temperature_c, above_k, contrast, is_cut) in enumerate(heats):
        words = {"temperature_c": temperature_c, "above_ground_k": above_k, "contrast": contrast, "is_cut": is_cut}
        spot = spot_at(0.0, 0.0, cov, **words)
        merger.add(SpotReport(1, k, START_NS + k * 10**9, True, (spot,), 0, 0.5, 0.3, "uav-1"))
    (found,) = merger.things()
    assert (found.temperature_c, found.above_ground_k, found.contrast, found.best.frame) == (36.0, 14.0, 12.0, 3)
    assert found.first_unix_ns == START_NS and found.last_unix_ns == START_NS + 3 * 10**9
    assert [spot.frame for spot in found.spots] == [0, 3, 1, 2]  # those that were the best once, then the newest
    assert "36.0 degC, +14.0 K" in found.to_text() and '"spot": 1' in found.to_json()


def test_what_has_no_place_is_counted_and_a_report_that_comes_again_changes_nothing() -> None:
    merger = SpotMerger()
    refused = Spot(10.0, 20.0, 9.0, status=Status.NO_GPS)
    placed = spot_at(0.0, 0.0, covariance(1.0, 1.0, 0.0))
    report = SpotReport(1, 5, START_NS, False, (refused, placed), 0, 0.5, 0.3, "a")
    assert len(merger.add(report)) == 1 and merger.unplaced == 1
    assert merger.add(report) == [] and merger.add(replace(report, capture_unix_ns=START_NS - 5)) == []
    assert merger.pictures == 1 and merger.things()[0].pictures == 1


def test_what_is_kept_is_bounded() -> None:
    (found,) = merged(standing((0.0, 0.0)), MOST_KEPT_SPOTS + 30, flight(2))
    assert len(found.spots) <= 2 * MOST_KEPT_SPOTS and 0 in [spot.frame for spot in found.spots]
    assert found.newest.frame == MOST_KEPT_SPOTS + 29 and found.newest in found.spots


def test_an_ellipse_is_its_covariance_again() -> None:
    cov = covariance(3.0, 1.5, 70.0)
    assert place_at(0.0, 0.0, cov).ellipse.covariance_en_m2 == pytest.approx(cov, rel=1e-5, abs=1e-5)


@pytest.mark.long
@pytest.mark.parametrize(("picture_share", "session_share"), [(0.8, 0.6), (0.5, 0.3), (0.3, 0.0)])
def test_of_many_flights_the_truth_is_inside_of_the_merged_ellipse_nine_times_in_ten(
    picture_share: float, session_share: float
) -> None:
    shares = {"picture_share": picture_share, "session_share": session_share}
    inside, alone, moving = 0, 0, 0
    for seed in range(300):
        found = merged(standing((3.0, 4.0)), 30, flight(seed, **shares))
        alone += len(found) == 1
        thing = max(found, key=lambda one: one.pictures)
        inside += is_inside(thing.place, (3.0, 4.0))
        moving += thing.course is not None and thing.course.is_moving
    assert 0.85 * 300 <= inside <= 0.96 * 300
    assert alone >= 0.98 * 300 and moving <= 3


@pytest.mark.long
def test_of_many_walkers_the_place_is_inside_of_the_ellipse_and_the_speed_within_half_a_metre() -> None:
    inside = good = moving = 0
    for seed in range(300):
        found = max(merged(walking, 21, flight(seed)), key=lambda one: one.pictures)
        inside += is_inside(found.place, (14.0, 0.0))
        course = found.course
        if course is not None and course.course_deg is not None:
            moving += 1
            good += abs(course.speed_m_s - 1.4) <= 0.5 and abs(course.course_deg - 90.0) <= 20.0
    assert 0.85 * 300 <= inside <= 0.97 * 300 and moving >= 0.97 * 300 and good >= 0.95 * moving


@pytest.mark.long
@pytest.mark.parametrize("begin_s", [20.2, 30.2, 33.2])
def test_of_many_walkers_whom_two_aircraft_saw_the_place_is_inside_of_the_ellipse(begin_s: float) -> None:
    inside = []
    for seed in range(60):
        first, second = flight(seed), flight(1000 + seed, vehicle="uav-2", begin_s=begin_s)
        merger = SpotMerger()
        reports = [*first.reports(until_30_s, 61), *second.reports(until_30_s, 40)]
        for report in sorted(reports, key=lambda one: one.capture_unix_ns):
            at_s = (report.capture_unix_ns - START_NS) / 1e9
            inside += [is_inside(thing.place, until_30_s(at_s)[0]) for thing in merger.add(report) if at_s >= 15.0]
    assert 0.82 <= np.mean(inside) <= 0.97


@pytest.mark.long
def test_of_two_sessions_with_the_same_slow_error_the_truth_is_inside_of_the_merged_ellipse() -> None:
    root, inside = np.sqrt([1.6**2, 1.2**2]), 0
    for seed in range(150):
        rng = np.random.default_rng(seed)
        merger, common = SpotMerger(), math.sqrt(0.6) * root * rng.normal(size=2)
        cov = np.diag(root**2)
        for session in (1, 2):
            for k in range(15):
                east, north = common + math.sqrt(0.4) * root * rng.normal(size=2)
                stamp_ns = START_NS + (100 * session + k) * 10**9
                spots = (spot_at(float(east), float(north), cov),)
                merger.add(SpotReport(session, k, stamp_ns, True, spots, 0, 0.6, 0.6, "uav-1"))
        inside += is_inside(max(merger.things(), key=lambda one: one.pictures).place, (0.0, 0.0))
    assert 0.82 * 150 <= inside <= 0.96 * 150
