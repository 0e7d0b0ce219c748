"""The area of a fire: as large as it is, inside of its band, and as fast as it spreads."""

import json
import math
import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from contract.answer import Ellipse, time_utc
from contract.feature_set import FeatureSet
from contract.geodesy import LocalFrame
from contract.spot import Spot, SpotReport
from contract.topics import FEATURES, SPOTS
from contract.wire.codec import encode
from contract.wire.spot_code import decode_spots, encode_spots
from ground.__main__ import main
from ground.formats import fire_area
from ground.link_recorder import LinkRecorder
from ground.spots.fire import MOST_PICTURES, Fire, FireGround
from tests.contract.sets import plain_set
from tests.ground.spots.sampled_spots import HOME, START_NS, Array, covariance, spot_at

COV = covariance(1.5, 1.0, 30.0)
Ring = tuple[tuple[float, float], ...]


def circle(radius_m: float, points: int = 40) -> Ring:
    angles = np.linspace(0.0, 2.0 * np.pi, points, endpoint=False)
    return tuple((float(radius_m * np.cos(a)), float(radius_m * np.sin(a))) for a in angles)


def burning(ring: Ring, east_m: float = 0.0, north_m: float = 0.0, **more: object) -> Spot:
    return replace(spot_at(east_m, north_m, COV, temperature_c=300.0, area_m2=500.0), outline_en_m=ring, **more)


def report(k: int, at_s: float, *spots: Spot, session: int = 1) -> SpotReport:
    return SpotReport(session, k, START_NS + round(at_s * 1e9), True, spots, 0, 0.8, 0.6, "uav-1")


def spreading(seed: int, rate_m_s: float, seconds: float = 240.0, every_s: float = 10.0) -> tuple[Fire, float]:
    """A round fire of 20 m that grows, as erring pictures see it; and its radius at the end."""
    rng = np.random.default_rng(seed)
    ground, common = FireGround(), rng.multivariate_normal((0.0, 0.0), 0.6 * COV)
    for k in range(int(seconds / every_s) + 1):
        east, north = common + rng.multivariate_normal((0.0, 0.0), 0.4 * COV)
        ground.add(report(k, k * every_s, burning(circle(20.0 + rate_m_s * k * every_s), float(east), float(north))))
    fire = ground.fire(10.0)
    assert fire is not None
    return fire, 20.0 + rate_m_s * seconds


def test_a_fire_is_as_large_as_it_is_and_its_edge_is_between_surely_and_perhaps() -> None:
    for seed in range(3):
        fire, radius_m = spreading(seed, 0.1)
        true_m2 = math.pi * radius_m**2
        assert fire.burned.area_m2 == pytest.approx(true_m2, rel=0.04)
        assert fire.surely.area_m2 < true_m2 < fire.perhaps.area_m2 < 1.35 * true_m2
        assert fire.surely.area_m2 > 0.75 * true_m2
        assert fire.burned.perimeter_m == pytest.approx(2.0 * math.pi * radius_m, rel=0.05)
        assert fire.pictures == 25


def test_what_surely_burned_of_a_fire_that_stands_is_within_it_however_many_pictures_err() -> None:
    beyond, left = [], []
    for seed in range(3):
        rng, ground = np.random.default_rng([seed, 26]), FireGround()
        for k in range(24):
            east, north = rng.multivariate_normal((0.0, 0.0), COV)
            ground.add(report(k, 0.4 * k, burning(circle(12.0), float(east), float(north))))
        surely = ground.fire(10.0).surely
        away = [math.hypot(*HOME.to_enu(lat, lon, 0.0)[:2]) for ring in surely.polygons[0] for lon, lat in ring]
        beyond.append(max(away) > 12.1)
        left.append(surely.area_m2 / (math.pi * 144.0))
    assert not any(beyond) and 0.4 < np.mean(left) < 0.8


PASSES_S = np.concatenate([30.0 * k + np.arange(0.0, 5.0, 0.5) for k in range(4)])
EVENLY_S = np.arange(0.0, 120.0, 2.0)


SHAPES = ("round", "wind", "line", "fan")


def outline_m(shape: str, radius_m: float, gone_m: float) -> Array:
    """Corners (48, 2) of a fire that has gone so far at its fastest: on all sides, with a back and flanks that stand,
    as a line's both sides, or less the more a part of it looks away from the wind.
    """
    angles = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
    out = np.column_stack([np.cos(angles), np.sin(angles)])
    if shape == "wind":
        return radius_m * out + np.outer(out[:, 0] > 0.0, (gone_m, 0.0))
    if shape == "line":
        return (radius_m + gone_m) * out + np.outer(np.sign(out[:, 0]), (8.0, 0.0))
    share = np.maximum(0.3 + 0.7 * out[:, 0], 0.0) if shape == "fan" else 1.0
    return np.reshape(radius_m + gone_m * share, (-1, 1)) * out


def area_of(ring: Array) -> float:
    x, y = ring.T
    return 0.5 * float(abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)))


def erring(
    seed: int, shape: str, radius_m: float, rate_m_s: float, times_s: Array, errors: float = 1.0, scale: float = 0.0
) -> tuple[Fire, float]:
    """A fire whose outlines err as stated, 2 m^2 of the receiver's for a minute, the rest not; and its area at the end.

    `errors`: what the errors are of those stated; `scale`: one sigma of what areas are off by, most of it a session's.
    """
    rng = np.random.default_rng([seed, 951])
    root, ground = errors * np.linalg.cholesky(COV), FireGround()
    parts, shares, lasts_s = rng.normal(size=(2, 2)), (0.6, 0.2), (60.0, 10.0)
    common = rng.normal()
    for k, at_s in enumerate(times_s):
        if k:
            keep = np.exp(-(at_s - times_s[k - 1]) / np.array(lasts_s))[:, None]
            parts = keep * parts + np.sqrt(1.0 - keep**2) * rng.normal(size=(2, 2))
        east, north = root @ (np.sqrt(shares) @ parts + np.sqrt(0.2) * rng.normal(size=2))
        ring = outline_m(shape, radius_m, rate_m_s * at_s)
        larger = 1.0 + 0.5 * scale * (math.sqrt(0.8) * common + math.sqrt(0.2) * rng.normal())
        stated = {"area_m2": area_of(ring), "sigma_area_m2": scale * area_of(ring)}
        corners = tuple((float(x), float(y)) for x, y in larger * ring)
        sent = report(k, float(at_s), replace(burning(corners, float(east), float(north)), **stated))
        ground.add(decode_spots(encode_spots(sent), "uav-1"))
    fire = ground.fire(10.0)
    assert fire is not None
    return fire, area_of(ring)


def drifting(seed: int, rate_m_s: float, times_s: Array, errors: float = 1.0, shape: str = "round") -> Array:
    """Rate and sigma of such a fire of 5 m."""
    fire, _ = erring(seed, shape, 5.0, rate_m_s, times_s, errors)
    assert fire.spread_m_s is not None and fire.sigma_spread_m_s is not None
    return np.array([fire.spread_m_s, fire.sigma_spread_m_s])


@pytest.mark.parametrize("pictures", [1, 2, 10, 50])
def test_a_fire_that_stands_is_as_large_as_it_is_in_however_many_pictures(pictures: int) -> None:
    """The union of all outlines is 1.2 times as large in 10 pictures, 1.4 times in 50."""
    fire, true_m2 = erring(1, "round", 12.0, 0.0, 2.0 * np.arange(pictures))
    assert fire.burned.area_m2 == pytest.approx(true_m2, rel=0.03)
    assert fire.surely.area_m2 < true_m2 < fire.perhaps.area_m2 and fire.sigma_area_m2 < 0.05 * true_m2


def test_a_fire_that_grew_a_little_and_one_that_ran_are_as_large_as_they_became() -> None:
    for shape, rate_m_s, times_s in (("round", 0.02, 2.0 * np.arange(50)), ("wind", 1.0, 0.5 * np.arange(30))):
        fire, true_m2 = erring(2, shape, 10.0, rate_m_s, times_s)
        assert fire.burned.area_m2 == pytest.approx(true_m2, rel=0.04)


def test_outlines_without_an_error_are_as_they_are() -> None:
    ground = FireGround()
    for k in range(12):
        spot = burning(circle(8.0))
        assert spot.place is not None
        exact = replace(spot, place=replace(spot.place, ellipse=Ellipse(0.0, 0.0, 0.0)))
        ground.add(report(k, 2.0 * k, exact))
    fire = ground.fire(10.0)
    assert fire is not None and fire.burned.area_m2 == pytest.approx(math.pi * 64.0, rel=0.02)
    assert fire.spread_m_s == pytest.approx(0.0, abs=0.01)


def test_what_burned_out_or_drove_on_was_there() -> None:
    """It is no error of the pictures that the far side of what moves recedes."""
    ground = FireGround()
    for k in range(40):
        ground.add(report(k, float(k), burning(circle(6.0), 0.6 * k)))
    fire = ground.fire(10.0)
    assert fire is not None and fire.burned.area_m2 == pytest.approx(math.pi * 36.0 + 12.0 * 0.6 * 39.0, rel=0.06)
    assert fire.spread_m_s == pytest.approx(0.6, abs=1.65 * fire.sigma_spread_m_s)


@pytest.mark.long
@pytest.mark.parametrize("pictures", [1, 10, 50, 100])
def test_areas_are_right_in_the_mean_and_their_sigma_holds_nine_of_ten(pictures: int) -> None:
    times_s = np.linspace(0.0, min(2.0 * (pictures - 1), 120.0), pictures)
    rendered = [
        (*erring(100 * seed + pictures, shape, radius_m, rate_m_s, times_s, scale=0.03),)
        for seed in range(6)
        for shape, radius_m, rate_m_s in (
            ("round", 12.0, 0.0),
            ("line", 5.0, 0.0),
            ("wind", 10.0, 0.2),
            ("fan", 8.0, 0.3),
        )
    ]
    ratio = np.array([fire.burned.area_m2 / true_m2 for fire, true_m2 in rendered])
    off = np.array([(fire.burned.area_m2 - true_m2) / fire.sigma_area_m2 for fire, true_m2 in rendered])
    assert 0.95 < ratio.mean() < 1.05
    assert np.mean(np.abs(off) < 1.645) > 0.75 and 0.3 < np.mean(off**2) < 1.7


def test_a_fire_that_is_passed_now_and_then_spreads_as_fast_as_it_does() -> None:
    """The edge of what several pictures saw is that of the last of them, not of their mean time."""
    rate, sigma = drifting(0, 0.5, PASSES_S, errors=0.0)
    assert rate == pytest.approx(0.5, abs=1.5 * sigma) and sigma < 0.03


@pytest.mark.long  # short: one that is passed now and then, above, and one that stands, below
@pytest.mark.parametrize(("rate_m_s", "times_s"), [(0.3, PASSES_S), (0.5, EVENLY_S), (0.0, EVENLY_S)])
def test_nine_rates_of_spread_of_ten_are_within_their_bounds_and_these_are_no_wider_than_needed(
    rate_m_s: float, times_s: Array
) -> None:
    known = np.array([drifting(seed, rate_m_s, times_s, shape=SHAPES[seed % 4]) for seed in range(32)])
    off = (known[:, 0] - rate_m_s) / known[:, 1]
    assert np.mean(np.abs(off) < 1.645) > 0.75 and 0.4 < np.mean(off**2) < 1.7 and abs(np.mean(off)) < 0.6
    assert np.median(known[:, 1]) < 0.03


def test_flying_on_over_a_large_fire_that_stands_is_no_spread() -> None:
    """Each picture shows the part that is in it: what comes into view has not caught fire just now."""
    ground = FireGround()
    for k in range(50):
        north = -120.0 + 5.0 * k
        ring = clipped(60.0, 40.0, north - 35.0, north + 35.0)
        if ring:
            ground.add(decode_spots(encode_spots(report(k, 0.5 * k, burning(ring, is_cut=True))), "uav-1"))
    fire = ground.fire(10.0)
    assert fire is not None
    assert fire.spread_m_s is None or fire.spread_m_s < 3.0 * fire.sigma_spread_m_s < 0.5


def clipped(radius_m: float, aside_m: float, south_m: float, north_m: float) -> Ring:
    """The part of a disc in a picture: what is nearer than `aside_m` to the middle and between south and north."""
    picture = np.zeros((600, 600), np.uint8)
    cv2.circle(picture, (300, 300), round(4.0 * radius_m), 1, -1)
    x, y = (np.mgrid[:600, :600][::-1] - 300.0) / 4.0
    picture[(np.abs(x) > aside_m) | (y < south_m) | (y > north_m)] = 0
    found, _ = cv2.findContours(picture, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not found:
        return ()
    return tuple(((u - 300.0) / 4.0, (v - 300.0) / 4.0) for u, v in max(found, key=len)[::2, 0].tolist())


def test_one_outline_is_widened_and_narrowed_by_its_ellipse() -> None:
    ground = FireGround()
    ground.add(report(0, 0.0, burning(circle(20.0, 200))))
    fire = ground.fire(5.0)
    assert fire.spread_m_s is None
    a, b = (math.sqrt(4.605) * sigma for sigma in (1.5, 1.0))
    # The area of a circle's sum with an ellipse: both areas, and the circle's radius times the ellipse's perimeter.
    around = math.pi * (3.0 * (a + b) - math.sqrt((3.0 * a + b) * (a + 3.0 * b)))
    assert fire.perhaps.area_m2 == pytest.approx(math.pi * (400.0 + a * b) + 20.0 * around, rel=0.03)
    assert fire.surely.area_m2 == pytest.approx(math.pi * (400.0 + a * b) - 20.0 * around, rel=0.05)


def test_of_a_line_that_burns_nothing_is_sure_where_it_is_thinner_than_its_error() -> None:
    ground = FireGround()
    ground.add(report(0, 0.0, burning(((-30.0, -0.5), (30.0, -0.5), (30.0, 0.5), (-30.0, 0.5)))))
    fire = ground.fire(5.0)
    assert fire.surely.area_m2 == 0.0 and fire.surely.polygons == []
    assert fire.burned.area_m2 == pytest.approx(60.0, rel=0.25) and fire.perhaps.area_m2 > 200.0


def test_a_hole_that_does_not_burn_stays_one_and_two_fires_are_two_polygons() -> None:
    ground = FireGround()
    sides = [
        (-20.0, -20.0, 20.0, -12.0),
        (-20.0, 12.0, 20.0, 20.0),
        (-20.0, -20.0, -12.0, 20.0),
        (12.0, -20.0, 20.0, 20.0),
    ]
    spots = [burning(((w, s), (e, s), (e, n), (w, n))) for w, s, e, n in sides]
    ground.add(report(0, 0.0, *spots, burning(circle(5.0), 60.0, 0.0)))
    fire = ground.fire(5.0)
    assert sorted(len(polygon) for polygon in fire.burned.polygons) == [1, 2]
    assert fire.burned.area_m2 == pytest.approx(1600.0 - 576.0 + math.pi * 25.0, rel=0.05)


@pytest.mark.parametrize("lon_deg", [HOME.lon_deg, 179.9999])
def test_fires_far_apart_are_where_they_are_and_as_large_wherever_the_first_one_was(lon_deg: float) -> None:
    ground, here = FireGround(), LocalFrame(HOME.lat_deg, lon_deg, 0.0)
    for k, (east_m, north_m) in enumerate([(0.0, 0.0), (5000.0, 0.0)]):
        lat, lon, _ = here.to_geodetic([east_m, north_m, 0.0])
        antipode, fire_there = burning(circle(5.0)), burning(circle(5.0))
        assert antipode.place is not None and fire_there.place is not None
        antipode = replace(antipode, place=replace(antipode.place, lat_deg=43.5, lon_deg=-7.5))
        fire_there = replace(fire_there, place=replace(fire_there.place, lat_deg=float(lat), lon_deg=float(lon)))
        ground.add(report(2 * k, 0.0, antipode))
        ground.add(report(2 * k + 1, 400.0, fire_there))
    fire = ground.fire(5.0)
    assert fire is not None and fire.burned.area_m2 == pytest.approx(2.0 * math.pi * 25.0, rel=0.03)
    assert (
        0.1 < fire.surely.area_m2 / fire.burned.area_m2 < 0.4 and 2.0 < fire.perhaps.area_m2 / fire.burned.area_m2 < 3
    )
    for polygon, east_m in zip(fire.burned.polygons, (0.0, 5000.0), strict=True):
        lons = [lon for lon, _ in polygon[0]]
        assert np.ptp(lons) < 2e-4  # also where it lies across the 180th meridian
        for lon, lat in polygon[0]:
            east, north, _ = here.to_enu(lat, lon, 0.0)
            assert math.hypot(east - east_m, north) == pytest.approx(5.0, abs=0.4)
    written = re.findall(r"<coordinates>([-0-9.]+),", fire_area.write(fire, "a.kml"))
    assert all(-180.0 <= float(lon) < 180.0 for lon in written)


def test_only_what_is_hot_enough_large_enough_and_of_the_last_minutes_burns() -> None:
    ground = FireGround()
    ground.add(report(0, 0.0, burning(circle(10.0), -100.0)))
    ground.add(report(1, 400.0, replace(burning(circle(10.0)), temperature_c=40.0), burning((), 5.0)))
    assert ground.fire(5.0) is not None  # the newest that burned
    ground.add(report(2, 410.0, burning(circle(10.0))))
    fire = ground.fire(5.0)
    assert fire.pictures == 1 and fire.first_unix_ns == START_NS + 410 * 10**9
    unknown = FireGround()
    small = replace(burning(circle(0.5)), temperature_c=None, above_ground_k=None, area_m2=0.8)
    unknown.add(report(0, 0.0, small, replace(small, area_m2=50.0, contrast=-9.0)))
    assert unknown.fire(5.0) is None
    unknown.add(report(1, 1.0, replace(small, area_m2=50.0, outline_en_m=circle(4.0))))
    doubtful = unknown.fire(5.0)
    assert doubtful is not None and "sun has warmed" in doubtful.to_text() and "sun" not in fire.to_text()
    assert fire.to_text().endswith(f"last at {time_utc(START_NS + 410 * 10**9)}")  # and not of now


def test_of_very_many_pictures_some_are_taken_evenly_and_with_the_newest() -> None:
    ground = FireGround()
    for k in range(3 * MOST_PICTURES):
        ground.add(report(k, float(k), burning(circle(3.0), 0.05 * k)))
    fire = ground.fire(60.0)
    assert MOST_PICTURES / 2 <= fire.pictures <= MOST_PICTURES
    assert fire.last_unix_ns == START_NS + (3 * MOST_PICTURES - 1) * 10**9 and fire.first_unix_ns < START_NS + 4 * 10**9


def test_polygons_are_where_it_burns_in_geojson_and_kml() -> None:
    ground = FireGround()
    ground.add(report(0, 0.0, burning(circle(20.0, 100), 1000.0, -500.0)))
    fire = ground.fire(5.0)
    assert fire is not None
    made = json.loads(fire_area.write(fire, "a.geojson"))["features"]
    assert [f["properties"]["kind"] for f in made] == ["perhaps", "burned", "surely"]
    (ring,) = made[1]["geometry"]["coordinates"][0]
    assert ring[0] == ring[-1]
    for lon, lat in ring:
        east, north, _ = (float(c) for c in HOME.to_enu(lat, lon, 0.0))
        assert math.hypot(east - 1000.0, north + 500.0) == pytest.approx(20.0, abs=0.5)
    root = ET.fromstring(fire_area.write(fire, "A.KML"))
    assert sum(node.tag.endswith("}Polygon") for node in root.iter()) == 3


def recorded(folder: Path) -> Path:
    there: FeatureSet = replace(plain_set(5), vehicle="uav-1", capture_unix_ns=START_NS)
    with LinkRecorder(folder) as recorder:
        recorder.take(FEATURES.key("uav-1"), encode(there))
        for k in range(12):
            ring = circle(10.0 + 0.5 * k, 24)
            sent = report(k, 10.0 * k, burning(ring), session=there.session)
            recorder.take(SPOTS.key("uav-1"), encode_spots(sent))
    return folder


def test_the_command_says_area_perimeter_and_spread_and_writes_the_polygons(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flight = str(recorded(tmp_path / "flight"))
    assert main(["spots", "--fire", "--from", flight, "--minutes", "30", "--out", str(tmp_path / "fire.kml")]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith("fire of 7") and "in 12 pictures" in printed
    rate, sigma = map(float, re.search(r"spreads with ([0-9.]+) \+-([0-9.]+) m/s", printed).groups())
    assert rate == pytest.approx(0.05, abs=1.65 * sigma) and sigma < 0.03
    assert (tmp_path / "fire.kml").read_text().count("<Polygon>") == 3
    assert main(["spots", "--fire", "--from", flight, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["features"][1]["properties"]["area_m2"] > 600.0
    assert main(["spots", "--fire", "--from", flight, "--above", "500"]) == 3
    for words in (["--minutes", "3"], ["--fire", "--out", "a.csv"], ["--fire", "--seconds", "1"]):
        assert main(["spots", "--from", flight, *words]) == 2
