"""Spots of a flight over rendered ground: found, placed, seen again, and said why not."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest

from contract.feature_set import Status
from contract.geodesy import LocalFrame
from contract.spot import SpotReport, ThingKind
from contract.wire.spot_code import decode_spots, encode_spots
from onboard.config.schema import SpotsConfig, ThermalConfig
from onboard.spots.spot_book import SpotBook
from onboard.spots.thing_book import ThingBook
from onboard.spots.thing_net import Peak
from simulation.heat_sources import Fire, HeatSource
from simulation.thermal import ThermalSpec
from tests.onboard.spots.scenes import LEPTON, ORIGIN, Scene, place_of
from tests.rest_long import rest_long

CALIBRATED, PLAIN = ThermalConfig(enabled=True, scale=0.01), ThermalConfig(enabled=True)
PEOPLE = ((-12.0, 14.0), (9.0, -4.0))
CALM = ThermalSpec(contrast=0.3, sources=tuple(HeatSource.person(place) for place in PEOPLE))


def simulated(scene: Scene, frames: Iterable[int], thermal: ThermalConfig = CALIBRATED) -> list[SpotReport]:
    book = SpotBook("uav-1", SpotsConfig(), thermal)
    found = [book.picture(*scene.picture(k)) for k in frames]
    return [report for report in found if report is not None]


def off_m(report: SpotReport, place: tuple[float, float]) -> float:
    lat, lon = place_of(*place)
    frame = LocalFrame(lat, lon, ORIGIN.height_m)
    far = [np.hypot(*frame.to_enu(s.place.lat_deg, s.place.lon_deg, 600.0)[:2]) for s in report.spots if s.place]
    return float(min(far, default=np.inf))


def test_people_are_found_where_they_are_and_as_large_as_they_are() -> None:
    reports = simulated(Scene(CALM), range(4))
    assert [len(report.spots) for report in reports] == [0, 2, 2, 2]  # seen twice before it is said
    last = reports[-1]
    assert last.is_calibrated and (last.session, last.frame, last.vehicle) == (7, 3, "uav-1")
    for place in PEOPLE:
        assert off_m(last, place) < 0.3
    for spot in last.spots:
        assert spot.status is Status.OK and spot.place is not None and not spot.is_cut
        assert 0.12 < spot.area_m2 < 0.45 and abs(spot.area_m2 - 0.25) < 2.0 * spot.sigma_area_m2
        assert spot.above_ground_k == pytest.approx(8.0, abs=2.0) and spot.temperature_c is not None
        assert len(spot.outline_en_m) >= 8 and np.abs(spot.outline_en_m).max() < 0.7
    assert 0.9 < last.picture_share <= 1.0 and 0.2 < last.session_share < 0.6
    assert len(encode_spots(last)) <= 200 and len(decode_spots(encode_spots(last)).spots) == 2
    # One who is cut off by the border is not found in that picture.
    assert all(0.9 < (report.person_found or 0.0) <= 1.0 for report in reports)
    assert [max(report.person_named) for report in reports] == [0.0, 0.0, 1.0, 1.0]  # in two reports


def test_a_car_that_leaves_the_picture_is_one_thing_as_long_as_it_is_seen_whole() -> None:
    leaving = Scene(ThermalSpec(contrast=0.3, sources=(HeatSource.car((-12.0, 0.0)),)), step_m=1.0)
    reports = simulated(leaving, range(32, 40))
    # Its corners were things of 0.4 m2, seen whole, when only they were in the picture.
    assert [len(report.spots) for report in reports] == [0, 1, 1, 0, 0, 0, 0, 0]
    assert all(off_m(report, (-12.0, 0.0)) < 0.8 and not report.spots[0].is_cut for report in reports[1:3])


def test_a_camera_with_its_own_gain_which_cuts_them_off_finds_one_and_states_no_temperature() -> None:
    people = ((-12.0, 124.0), (9.0, 108.0))
    spec = replace(CALM, output="agc", sources=tuple(HeatSource.person(place) for place in people))
    last = simulated(Scene(spec, step_m=20.0), range(7), PLAIN)[-1]
    assert not last.is_calibrated and len(last.spots) >= 1
    assert all(spot.temperature_c is None and spot.above_ground_k is None for spot in last.spots)
    assert min(off_m(last, place) for place in people) < 0.3


@pytest.mark.parametrize("output", rest_long(["radiometric", "agc"]))
def test_a_fire_wider_than_its_surroundings_is_found_with_its_outline(output: str) -> None:
    fire = Fire(((-8.0, 0.0), (8.0, 6.0)), rate_m_s=0.2, first_m=6.0, ember_k=600.0, cooling_s=600.0)
    thermal = CALIBRATED if output == "radiometric" else PLAIN
    last = simulated(Scene(ThermalSpec(fires=(fire,), output=output)), range(3), thermal)[-1]
    largest = max(last.spots, key=lambda spot: spot.area_m2)
    assert largest.area_m2 == pytest.approx(fire.area_m2(1.0), rel=0.1)
    kept = max(decode_spots(encode_spots(last)).spots, key=lambda spot: spot.area_m2)
    assert len(kept.outline_en_m) >= 12 and kept.area_m2 == pytest.approx(fire.area_m2(1.0), rel=0.15)
    if output == "radiometric":
        assert largest.temperature_c == pytest.approx(700.0 - 273.15, rel=0.15)


def test_a_fire_of_which_a_part_has_no_place_is_cut() -> None:
    """Its outline ends where the answers do, as at the picture's edge: there is more of it."""
    fire = Fire(((-4.0, 0.0), (4.0, 0.0)), rate_m_s=0.2, first_m=30.0, ember_k=600.0, cooling_s=600.0)
    scene = Scene(ThermalSpec(fires=(fire,)), step_m=0.0)
    frames = [scene.picture(k) for k in range(2)]
    cut = []
    for horizon in (np.inf, 0.25):  # the ground falls off to the picture's top, or there is none beyond a part of it
        book = SpotBook("u", SpotsConfig(), CALIBRATED)
        for frame, its_set in frames:
            near = its_set.plane_per_m[0]
            report = book.picture(frame, replace(its_set, plane_per_m=np.array([near, 0.0, near / horizon])))
        cut.append([spot.is_cut for spot in report.spots if spot.outline_en_m])
    assert cut == [[False], [True]]


def test_a_pixels_fault_stays_on_the_picture_and_is_no_spot() -> None:
    scene, book = Scene(replace(CALM, sources=())), SpotBook("uav-1", SpotsConfig(), CALIBRATED)
    for k in range(5):
        frame, its_set = scene.picture(k)
        counts = frame.counts.copy()
        counts[200:204, 300:304] += 2000  # where the ground passes by, 5 m from picture to picture
        report = book.picture(replace(frame, counts=counts), its_set)
        assert not report.spots


def test_what_is_in_one_picture_alone_is_not_reported() -> None:
    people, empty = Scene(CALM), Scene(replace(CALM, sources=()))
    book = SpotBook("uav-1", SpotsConfig(), CALIBRATED)
    for k in range(8):
        report = book.picture(*(people if k % 4 == 2 else empty).picture(k))
        assert not report.spots


def test_a_team_at_take_off_hides_no_one_farther_on() -> None:
    """Nine people within 4 ha, then one 180 m on: all are found."""
    rng = np.random.default_rng(4)
    team = [(float(east), float(north)) for east, north in rng.uniform((-25.0, -15.0), (25.0, 45.0), (9, 2))]
    scene = Scene(
        replace(CALM, sources=tuple(HeatSource.person(place) for place in [*team, (5.0, 180.0)])), step_m=20.0
    )
    reports = simulated(scene, range(12))
    found = [min(off_m(report, place) for report in reports) < 1.0 for place in [*team, (5.0, 180.0)]]
    assert sum(found[:-1]) >= 7 and found[-1]


def test_without_a_place_a_spot_says_why_in_the_words_of_a_click() -> None:
    scene, book = Scene(CALM), SpotBook("uav-1", SpotsConfig(), CALIBRATED)
    for k in range(3):
        book.picture(*scene.picture(k))
    report = book.picture(*scene.picture(3, Status.TURNING))
    assert len(report.spots) == 2
    assert all(s.place is None and s.status is Status.TURNING and not s.outline_en_m for s in report.spots)
    assert (report.picture_share, report.session_share) == (0.0, 0.0)


def test_a_small_camera_finds_a_car() -> None:
    car = HeatSource.car((3.0, 8.0))
    last = simulated(Scene(replace(CALM, sources=(car,)), camera=LEPTON), range(4))[-1]
    assert off_m(last, (3.0, 8.0)) < 1.0
    largest = max(last.spots, key=lambda spot: spot.area_m2)
    assert 4.0 < largest.area_m2 < 15.0 and abs(largest.area_m2 - 7.2) < 2.0 * largest.sigma_area_m2


def test_a_car_from_near_is_one_thing_as_large_as_it_is_and_two_people_next_to_each_other_are_two() -> None:
    """Each corner of it alone stands out more than it does as a whole."""
    near, people = replace(CALM, sources=(HeatSource.car((3.0, 8.0)),)), ((3.0, 8.0), (3.0, 10.0))
    reports = simulated(Scene(near, height_m=60.0, step_m=2.0), range(4))
    spot = max(reports[-1].spots, key=lambda s: s.contrast)
    assert [len(report.spots) for report in reports[1:]] == [1, 1, 1]
    assert 5.0 < spot.area_m2 < 10.0
    two = replace(CALM, sources=tuple(HeatSource.person(place) for place in people))
    last = simulated(Scene(two, height_m=60.0, step_m=2.0), range(4))[-1]
    assert len(last.spots) == 2 and max(off_m(last, place) for place in people) < 0.3
    by_it = replace(CALM, sources=(HeatSource.car((3.0, 8.0)), HeatSource.person((4.6, 10.4))))
    last = simulated(Scene(by_it, height_m=60.0, step_m=2.0), range(4))[-1]
    assert len(last.spots) == 2 and off_m(last, (4.6, 10.4)) < 0.4


def test_another_session_begins_again_and_pictures_without_counts_are_passed_over() -> None:
    scene, book = Scene(CALM), SpotBook("uav-1", SpotsConfig(), CALIBRATED)
    for k in range(2):
        book.picture(*scene.picture(k))
    assert all(np.isfinite(threshold) for threshold in list(book.thresholds.values())[:2])
    frame, its_set = scene.picture(2)
    assert book.picture(replace(frame, counts=None), its_set) is None
    report = book.picture(frame, replace(its_set, session=8))
    assert not report.spots  # once in this session


class _Net:
    def __init__(self, *peaks: Peak) -> None:
        self.found = list(peaks)

    def peaks(self, values: np.ndarray) -> list[Peak]:
        return self.found


def with_net(scene: Scene, net: _Net, count: int) -> list[SpotReport]:
    """Reports of pictures of which all that the net finds is named."""
    book = SpotBook("uav-1", SpotsConfig(things=True), CALIBRATED)
    book.picture(*scene.picture(0, Status.TURNING))  # its session has begun
    book._things = ThingBook(1e9, 1.0, net=net)
    reports = [book.picture(*scene.picture(k)) for k in range(count)]
    return [report for report in reports if report is not None]


@pytest.mark.long
def test_a_fire_in_which_a_net_sees_a_person_stays_a_fire() -> None:
    fire = Fire(((-8.0, 0.0), (8.0, 6.0)), rate_m_s=0.2, first_m=6.0, ember_k=600.0, cooling_s=600.0)
    scene = Scene(ThermalSpec(fires=(fire,)), step_m=0.0)
    alone = simulated(scene, range(2))[-1].spots[0]
    person = Peak(ThingKind.PERSON, 0.9, alone.u_px + 5.0, alone.v_px + 5.0, 10.0, 10.0)
    last = with_net(scene, _Net(person), 2)[-1]
    assert last.spots[0].kind is ThingKind.PERSON
    assert max(spot.area_m2 for spot in last.spots if spot.kind is None) == pytest.approx(alone.area_m2, rel=0.01)


def test_of_more_things_than_a_packet_holds_all_are_sent_in_turn() -> None:
    """Fourteen vehicles, likelier than the person between them."""
    parked = [Peak(ThingKind.VEHICLE, 0.9, 60.0 + 40.0 * k, 150.0, 20.0, 20.0) for k in range(14)]
    net = _Net(*parked, Peak(ThingKind.PERSON, 0.5, 311.0, 300.0, 10.0, 10.0))
    sent = [decode_spots(encode_spots(r)).spots for r in with_net(Scene(replace(CALM, sources=()), step_m=0.0), net, 3)]
    assert all(len(spots) == 6 for spots in sent)
    assert any(spot.kind is ThingKind.PERSON for spots in sent for spot in spots)
    assert len({round(spot.u_px) for spots in sent for spot in spots}) == 15
