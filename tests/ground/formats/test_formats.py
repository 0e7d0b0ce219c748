"""Formats as others read them: GDAL, gpxpy, mgrs, pyproj, takproto; back again without loss; hostile texts."""

import argparse
import csv
import dataclasses
import io
import json
import math
import struct
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import gpxpy
import mgrs
import numpy as np
import pyogrio
import pyproj
import pytest
import takproto

from contract.answer import Ellipse, Refusal
from contract.errors import InputError
from contract.feature_set import Status
from ground.commands.grids import grid_of
from ground.formats import cot, geojson, gpx, kml, table
from ground.formats.coordinates import LocalGrid, Projection, latlon_text, mgrs_text, utm_text
from ground.formats.documents import FORMATS, json_line, read_pins, text_line
from ground.formats.mark import Mark
from ground.pins.fusion import fuse
from ground.pins.model import Category, Pin, PinClick
from tests.ground.pins.flights import sightings
from tests.ground.pins.test_fusion import TARGET
from tests.ground.seen.levels import PLACE, level_set

HOSTILE = "<script>alert(1)</script> & \"q\" 'a' ]]> \x00\x1b[31m\u202e\U0001f525 ../../x"
NOW_NS = 1_790_000_000_123_456_789


def pin_of(clicks: list[PinClick], number: int = 1, name: str = "tent", note: str = "by the barn") -> Pin:
    return Pin(f"id{number}", number, name, note, Category.PERSON, "ann", NOW_NS, NOW_NS, "ann", tuple(clicks))


def seen(seed: int = 1) -> PinClick:
    return sightings(np.random.default_rng(seed), np.zeros(1), TARGET[None])[0]


def marks(name: str = "tent", note: str = "by the barn") -> list[Mark]:
    """A pin that was clicked, one of unknown accuracy, and one whose clicks contradict each other."""
    rng = np.random.default_rng(2)
    apart = sightings(rng, np.array([0.0, 5.0]), np.array([TARGET, TARGET + [90.0, 0.0, 0.0]]))
    pins = [
        pin_of([seen()], 1, name, note),
        pin_of([PinClick.entered(-35.5, 149.5, clicked_unix_ns=NOW_NS)], 2, name, note),
        pin_of(apart, 3, name, note),
    ]
    return [Mark.of_pin(pin, fuse(pin.clicks)) for pin in pins]


def read_with_gdal(path: Path, layer: str) -> list[dict[str, Any]]:
    meta, _, geometry, columns = pyogrio.raw.read(path, layer=layer)
    rows = [dict(zip(meta["fields"], values, strict=True)) for values in zip(*columns, strict=True)]
    return [{**row, "wkb": g} for row, g in zip(rows, geometry, strict=True)]


def point(wkb: bytes) -> tuple[float, ...]:
    """Longitude, latitude and perhaps height of a WKB point."""
    kind = struct.unpack("<I", wkb[1:5])[0]
    has_height = bool(kind & 0x80000000) or kind > 1000
    assert kind & 0xFF == 1 or kind == 1001
    return struct.unpack("<3d" if has_height else "<2d", wkb[5 : 29 if has_height else 21])


@pytest.mark.parametrize("name", ["geojson", "kml", "gpx"])
def test_gdal_reads_what_we_write(tmp_path: Path, name: str) -> None:
    given = marks()
    path = tmp_path / f"pins{FORMATS[name].suffix}"
    path.write_text(FORMATS[name].write(given, None), encoding="utf-8")
    rows = read_with_gdal(path, {"geojson": "pins", "kml": "pins", "gpx": "waypoints"}[name])
    placed = [row for row in rows if row["wkb"] is not None]
    assert len(rows) == (2 if name == "gpx" else 3) and len(placed) == 2
    for row, mark in zip(placed, given, strict=False):
        assert mark.lat_deg is not None and mark.lon_deg is not None
        lon, lat, *height = point(row["wkb"])
        assert (lat, lon) == pytest.approx((mark.lat_deg, mark.lon_deg), abs=1e-8)
        if name == "geojson" and mark.height_ellipsoid_m is not None:
            assert height == pytest.approx([mark.height_ellipsoid_m], abs=1e-3)
        if name == "kml" and mark.height_amsl_m is not None:
            assert height == pytest.approx([mark.height_amsl_m], abs=1e-3)
    first = placed[0]
    ce90 = {"geojson": "ce90_m", "kml": "ce90_m", "gpx": "pc_ce90_m"}[name]
    assert float(first[ce90]) == pytest.approx(given[0].ce90_m, abs=1e-3)
    assert first[{"geojson": "name", "kml": "Name", "gpx": "name"}[name]] == ("tent" if name == "geojson" else "1 tent")
    if name == "kml":
        ellipses = read_with_gdal(path, "90 % ellipses")
        assert len(ellipses) == 1


def test_gpxpy_reads_waypoints_with_the_accuracy_in_words_and_never_in_hdop() -> None:
    text = gpx.write(marks())
    points = gpxpy.parse(text).waypoints
    assert [p.name for p in points] == ["1 tent", "2 tent"]
    assert "m (CE90)" in points[0].description and "by the barn" in points[0].description
    assert all(p.horizontal_dilution is None for p in points) and "hdop" not in text
    assert points[0].elevation == pytest.approx(marks()[0].height_amsl_m, abs=1e-3)
    assert points[0].time.year == 2023
    ours = {node.tag.rpartition("}")[2]: node.text for node in points[0].extensions}
    assert float(ours["ce90_m"]) == pytest.approx(marks()[0].ce90_m, abs=1e-3)
    assert "contradict" in gpxpy.parse(text).description


def test_geojson_is_as_the_rfc_has_it() -> None:
    content = json.loads(geojson.write(marks()))
    first, second, third = content["features"]
    lon, lat, height = first["geometry"]["coordinates"]
    assert (lat, lon) == pytest.approx((-35.36, 149.16), abs=0.01) and 500.0 < height < 700.0
    p = first["properties"]
    assert p["ce90_m"] > 3.0 and p["le90_m"] > 3.0 and p["time"] == "2023-11-14T22:13:20.000000Z"
    assert set(p["ellipse"]) == {"confidence", "semi_major_m", "semi_minor_m", "azimuth_deg"}
    assert second["properties"]["ce90_m"] is None and len(second["geometry"]["coordinates"]) == 2
    assert third["geometry"] is None and third["properties"]["status"] == "contradicting"
    assert "crs" not in content  # RFC 7946 has no other


def test_geojson_comes_back_without_loss(tmp_path: Path) -> None:
    given = marks(HOSTILE.replace("\x00", ""), HOSTILE)
    crops = {given[0].pin.clicks[0].id: bytes(range(256))}
    path = tmp_path / "pins.geojson"
    path.write_text(geojson.write(given, None, crops.get), encoding="utf-8")
    found = read_pins(path)
    assert [json.dumps(pin.to_dict()) for pin in found.pins] == [
        json.dumps(mark.pin.to_dict()) for mark in given if mark.pin is not None
    ]
    assert found.crops == crops and found.left_out == 0


@pytest.mark.parametrize("name", ["kml", "gpx", "csv"])
@pytest.mark.parametrize("word", ["tent", "=1+1", "'=1", "-5", "<b>&amp;</b>", "Zelt ä \U0001f525", 'a,b\n"c"'])
def test_other_formats_come_back_with_place_name_and_accuracy(tmp_path: Path, name: str, word: str) -> None:
    given = marks(word, word)
    path = tmp_path / f"pins.{name}"
    path.write_bytes(FORMATS[name].write(given, None).encode())
    found = read_pins(path, who="bob")
    assert len(found.pins) == 2
    for pin, mark in zip(found.pins, given, strict=False):
        back = Mark.of_pin(pin, fuse(pin.clicks))
        assert (pin.name, pin.note, pin.category.value, pin.who) == (word, word, mark.category, "bob")
        assert (back.lat_deg, back.lon_deg) == pytest.approx((mark.lat_deg, mark.lon_deg), abs=2e-9)
        assert (back.ce90_m is None) == (mark.ce90_m is None)
        if mark.ce90_m is not None:
            assert back.ce90_m == pytest.approx(mark.ce90_m, abs=2e-3)
            assert back.le90_m == pytest.approx(mark.le90_m, abs=2e-3)
            assert back.height_amsl_m == pytest.approx(mark.height_amsl_m, abs=2e-3)
        assert (back.time_unix_ns is None) == (mark.time_unix_ns is None)
        if back.time_unix_ns is None or mark.time_unix_ns is None:
            continue  # one that was typed: no one said when it was seen
        assert abs(back.time_unix_ns - mark.time_unix_ns) < 1000


def test_hostile_texts_stay_texts_everywhere() -> None:
    given = marks(HOSTILE, HOSTILE)
    for text in (kml.write(given), gpx.write(given), *(cot.event(m, NOW_NS, 60.0) or "<none/>" for m in given)):
        root = ET.fromstring(text)
        assert not [node for node in root.iter() if node.tag.rpartition("}")[2] == "script"]
        assert "\x00" not in text and "\x1b" not in text
    description = ET.fromstring(kml.write(given)).find(".//{*}Placemark/{*}description")
    assert "<script>" not in (description.text or "")  # shown as HTML: escaped once more
    assert "\x1b" not in text_line(given[0]) and "\n" not in text_line(given[0])
    assert json.loads(json_line(given[0]))["name"] == HOSTILE


@pytest.mark.parametrize(
    "text",
    ["=1+1", "+1", "-1", "@SUM(A1)", "\t=1", "\r=1", " =1", "\u00a0=1", "\uff1d1", "\ufeff=1", "'=1", '=cmd|"/c x"!A'],
)
def test_no_cell_is_a_formula(text: str) -> None:
    (first, *_) = marks(text, text)
    rows = list(csv.DictReader(io.StringIO(table.write([first]), newline="")))
    assert rows[0]["name"] == f"'{text}" and rows[0]["note"] == f"'{text}"
    assert float(rows[0]["lat_deg"]) < 0.0  # a number stays one
    assert table.read(table.write([first]).encode()).pins[0].name == text


@pytest.mark.parametrize(
    ("lat", "lon"), [(-43.38, 172.4), (60.2, 5.1), (78.2, 15.6), (0.0001, -179.9999), (51.5, -0.1)]
)
def test_mgrs_and_utm_are_as_others_read_them(lat: float, lon: float) -> None:
    square = mgrs_text(lat, lon)
    back = mgrs.MGRS().toLatLon(square)
    to = pyproj.Geod(ellps="WGS84")
    assert to.inv(lon, lat, back[1], back[0])[2] < 1.5
    zone, east, north = utm_text(lat, lon).split()
    assert zone == square[:-12].lstrip("0")
    code = (32600 if lat >= 0.0 else 32700) + int(zone[:-1])
    x, y = pyproj.Transformer.from_crs(4326, code, always_xy=True).transform(lon, lat)
    assert (float(east), float(north)) == pytest.approx((x, y), abs=0.06)


def test_at_the_poles_there_are_squares_but_no_utm() -> None:
    assert mgrs_text(85.0, 10.0).startswith("Z") and mgrs_text(-85.0, 180.0).startswith(("A", "B"))
    with pytest.raises(InputError, match="UTM ends"):
        utm_text(85.0, 10.0)


def test_a_pin_beyond_utm_costs_no_other_its_line() -> None:
    """One at 85 N, and no list was written at all."""
    three = [
        Mark("m", f"pin {k}", "ok", lat_deg=lat, lon_deg=10.0, number=k) for k, lat in enumerate((47.0, 85.0, -47.0))
    ]
    first, polar, last = FORMATS["utm"].write(three, None).splitlines()
    assert first.startswith("32T ")
    assert polar.startswith("85.0000000 10.0000000 (degrees: no UTM beyond 80 S and 84 N)") and last.startswith("32G ")


def test_degrees_minutes_seconds() -> None:
    assert latlon_text(-43.38, 172.4, "minutes") == "43°22.80000'S 172°24.00000'E"
    assert latlon_text(-43.38, 172.4, "seconds") == "43°22'48.000\"S 172°24'00.000\"E"
    assert latlon_text(0.99999999999, -0.5, "seconds") == "01°00'00.000\"N 000°30'00.000\"W"
    assert latlon_text(59.999999999, 5.0, "minutes") == "60°00.00000'N 005°00.00000'E"
    rng = np.random.default_rng(0)
    for lat, lon in rng.uniform([-90, -180], [90, 180], (200, 2)):
        degrees, rest = latlon_text(lat, lon, "minutes").split()[0].split("°")
        assert float(degrees) + float(rest[:-2]) / 60.0 == pytest.approx(abs(lat), abs=1e-7)


def test_any_epsg_system_with_its_own_names_and_accuracy() -> None:
    mark = Mark("m", "m", "ok", lat_deg=-43.38, lon_deg=172.4)
    p = Projection("EPSG:2193").of(mark)
    x, y = pyproj.Transformer.from_crs(4326, 2193, always_xy=True).transform(172.4, -43.38)
    assert (p.x, p.y, p.x_name, p.y_name) == (pytest.approx(x), pytest.approx(y), "E", "N")
    swiss = Projection("EPSG:21781").of(Mark("m", "m", "ok", lat_deg=47.0, lon_deg=8.0))
    assert (swiss.x_name, swiss.y_name) == ("Y", "X") and swiss.accuracy_m > 0.5
    for code, reported in (("EPSG:99999999", "EPSG:2193"), ("EPSG:4978", "two horizontal"), ("'; DROP", "EPSG:2193")):
        with pytest.raises(InputError, match=reported):
            Projection(code)
    with pytest.raises(InputError, match="does not reach"):
        Projection("EPSG:27700").of(mark)


def test_a_pin_that_a_system_does_not_reach_does_not_cost_the_others_theirs(capsys: pytest.CaptureFixture[str]) -> None:
    here = Mark("a", "gate", "ok", lat_deg=-43.38, lon_deg=172.4)
    there = Mark("b", "London", "ok", lat_deg=51.5, lon_deg=-0.1)
    options = argparse.Namespace(local=None, crs="EPSG:2193")
    grid = grid_of(options, of_several=True)
    easting = str(int(Projection("EPSG:2193").of(here).x))
    for name in ("text", "json", "geojson", "kml", "gpx", "csv"):
        text = FORMATS[name].write([here, there], grid)
        assert text.count(easting) == 1 and "51.5" in text, name
    assert capsys.readouterr().err.count("London, in degrees: EPSG:2193") == 1
    with pytest.raises(InputError, match="does not reach"):
        text_line(there, grid_of(options))


def test_degrees_of_another_system_are_as_precise_in_every_file() -> None:
    """KML and GPX had six decimals, which are 0.1 m."""
    mark = Mark("m", "m", "ok", lat_deg=-43.380123456, lon_deg=172.400123456)
    assert all(write([mark], Projection("EPSG:4167")).count("172.4001234") == 2 for write in (kml.write, gpx.write))


@pytest.mark.parametrize(
    ("code", "lat_deg", "lon_deg"),
    [
        ("EPSG:4267", 61.0, -150.0),  # NAD27 in Alaska, where the way for Canada is 48 m off
        ("EPSG:4267", 18.0, -66.0),
        ("EPSG:26711", 36.0, -117.0),
        ("EPSG:4230", 40.0, -4.0),  # ED50 in Spain: 10 m
        ("EPSG:23030", 40.0, -4.0),
        ("EPSG:4265", 40.0, 9.0),  # Monte Mario in Sardinia: 7 m
        ("EPSG:3004", 38.0, 14.0),
        ("EPSG:5514", 50.0, 15.0),
        ("EPSG:4209", -15.0, 28.0),
    ],
)
def test_the_change_of_datum_is_that_of_the_place(code: str, lat_deg: float, lon_deg: float) -> None:
    """Systems that reach over many countries have a change of datum for each: PROJ itself chooses by the place."""
    p = Projection(code).project(lat_deg, lon_deg)
    x, y = pyproj.Transformer.from_crs(4326, code, always_xy=True).transform(lon_deg, lat_deg)
    metres = 111e3 if p.is_degrees else 1.0
    assert np.hypot(p.x - x, p.y - y) * metres < 0.5


def test_a_change_of_datum_that_is_not_known_is_stated_with_the_coordinate() -> None:
    unknown = Projection("EPSG:31700").project(46.0, 25.0)
    assert unknown.accuracy_m is None and "may be hundreds of metres off" in unknown.text
    poor = Projection("EPSG:4267").project(61.0, -150.0)
    assert poor.accuracy_m is not None and poor.accuracy_m > 1.0 and "m by the change of datum" in poor.text
    for code, lat_deg, lon_deg in (("EPSG:2193", -43.38, 172.4), ("EPSG:32759", -43.38, 172.4)):
        assert Projection(code).project(lat_deg, lon_deg).doubt == ""


def test_metres_from_an_origin() -> None:
    geod = pyproj.Geod(ellps="WGS84")
    lon, lat, _ = geod.fwd(172.4, -43.4, 30.0, 1000.0)
    p = LocalGrid(-43.4, 172.4).of(Mark("m", "m", "ok", lat_deg=lat, lon_deg=lon))
    assert (p.x, p.y) == pytest.approx((500.0, 866.0254), abs=0.1)


def test_a_tak_library_reads_our_events() -> None:
    mark = marks()[0]
    xml = cot.event(mark, NOW_NS, 60.0)
    assert xml is not None
    message = takproto.parse_proto(bytearray(takproto.xml2proto(xml, takproto.TAKProtoVer.STREAM)))
    e = message.cotEvent
    assert (e.type, e.uid, e.detail.contact.callsign) == ("b-m-p-s-m", "pointclick.id1", "1 tent")
    assert (e.lat, e.lon) == pytest.approx((mark.lat_deg, mark.lon_deg), abs=1e-8)
    assert (e.ce, e.le, e.hae) == pytest.approx((mark.ce90_m, mark.le90_m, mark.height_ellipsoid_m), abs=0.006)
    assert e.staleTime - e.sendTime == 60_000
    assert "CE90" in e.detail.xmlDetail


@pytest.mark.parametrize(("tilt_deg", "elevation", "range_m"), [(0.0, -90.0, 100.0), (30.0, -60.0, 115.47)])
def test_an_aircraft_states_where_its_camera_looks_and_the_point_is_linked_to_it(
    tilt_deg: float, elevation: float, range_m: float
) -> None:
    seen = level_set(tilt_deg=tilt_deg, height_m=100.0)
    aircraft, interest = (ET.fromstring(xml) for xml in cot.aircraft_events(seen, NOW_NS, 60.0))
    sensor, link, at = aircraft.find("detail/sensor"), interest.find("detail/link"), interest.find("point")
    assert link is not None and at is not None
    assert float(sensor.get("elevation", "")) == pytest.approx(elevation, abs=0.01)
    off_north_deg = (float(sensor.get("azimuth", "")) + 180.0) % 360.0 - 180.0
    assert off_north_deg == pytest.approx(0.0, abs=0.01)
    assert float(sensor.get("range", "")) == pytest.approx(range_m, rel=0.02)
    across, upright = (
        2.0 * math.degrees(math.atan(0.5 * size / focal))
        for size, focal in zip(seen.camera.size_px, (seen.camera.fx_px, seen.camera.fy_px), strict=True)
    )
    assert float(sensor.get("fov", "")) == pytest.approx(across, abs=0.1)
    assert float(sensor.get("vfov", "")) == pytest.approx(upright, abs=0.1)
    assert interest.get("type") == "b-m-p-s-p-i" and interest.get("uid") != aircraft.get("uid")
    assert (link.get("uid"), link.get("type")) == (aircraft.get("uid"), aircraft.get("type"))
    assert link.get("relation") == "p-p"
    north_m = PLACE.to_enu(float(at.get("lat", "")), float(at.get("lon", "")), 0.0)[1]
    assert north_m == pytest.approx(100.0 * math.tan(math.radians(tilt_deg)), abs=1.0)
    assert 0.0 < float(at.get("ce", "")) < 50.0
    for xml in cot.aircraft_events(seen, NOW_NS, 60.0):  # TAK's own library reads both
        takproto.parse_proto(bytearray(takproto.xml2proto(xml, takproto.TAKProtoVer.STREAM)))


def test_a_camera_that_looks_at_the_sky_has_a_view_and_no_point() -> None:
    events = cot.aircraft_events(level_set(tilt_deg=120.0), NOW_NS, 60.0)
    (aircraft,) = (ET.fromstring(xml) for xml in events)
    sensor = aircraft.find("detail/sensor")
    assert sensor.get("range") is None
    refused = dataclasses.replace(level_set(), status=Status.TURNING)
    assert not cot.aircraft_events(refused, NOW_NS, 60.0)


def test_what_is_not_known_is_9999999_and_a_refusal_is_no_event() -> None:
    _, unknown, contradicting = marks()
    root = ET.fromstring(cot.event(unknown, NOW_NS, 60.0) or "")
    at = root.find("point")
    assert at is not None
    assert [float(at.get(k, "0")) for k in ("hae", "ce", "le")] == [9999999.0] * 3
    assert cot.event(contradicting, NOW_NS, 60.0) is None
    refusal = Mark.of_answer(Refusal(Status.TURNING, 3, NOW_NS, "uav"), (1.0, 2.0))
    assert cot.event(refusal, NOW_NS, 60.0) is None
    assert FORMATS["cot"].write([refusal, contradicting], None) == ""
    absurd = dataclasses.replace(marks()[0], ce90_m=math.inf, le90_m=math.nan)
    assert 'ce="9999999.0" le="9999999.0"' in (cot.event(absurd, NOW_NS, 60.0) or "")


def test_a_refusal_is_no_point_in_any_format() -> None:
    refusal = Mark.of_answer(Refusal(Status.TURNING, 3, NOW_NS, "uav"), (1.0, 2.0))
    assert json.loads(geojson.write([refusal]))["features"][0]["geometry"] is None
    assert not gpxpy.parse(gpx.write([refusal])).waypoints
    assert ET.fromstring(kml.write([refusal])).find(".//{*}Point") is None
    row = next(csv.DictReader(io.StringIO(table.write([refusal]), newline="")))
    assert (row["status"], row["lat_deg"]) == ("turning", "")
    for name in ("mgrs", "utm", "dms", "dm"):
        assert FORMATS[name].write([refusal], None) == ""


LATE = "<!--" + 200_000 * "-x" + "-->"
BOMB = '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa">]><kml><Document><name>&a;</name></Document></kml>'


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.kml", BOMB.encode()), ("a.gpx", BOMB.encode("utf-16")), ("a.kml", f"{LATE}{BOMB}".encode()),
        ("a.geojson", b"[" * 100_000),
    ],
)  # fmt: skip
def test_a_file_that_is_made_to_break_its_reader_is_reported_in_a_line(
    tmp_path: Path, name: str, content: bytes
) -> None:
    """What else cannot be read: tests/transcripts/pc-ground-pins.txt."""
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=name) as caught:
        read_pins(tmp_path / name)
    assert len(str(caught.value).splitlines()) == 1


def test_others_files_are_read_too(tmp_path: Path) -> None:
    path = tmp_path / "x.geojson"
    path.write_text(
        json.dumps(
            {
                "type": "FeatureCollection",
                "features": [
                    {
                        "type": "Feature",
                        "geometry": {"type": "Point", "coordinates": [172.4, -43.4, 12.0]},
                        "properties": {"title": "hut", "ce90_m": 4.0, "time": "2024-01-01T00:00:00Z"},
                    },
                    {
                        "type": "Feature",
                        "geometry": {"type": "LineString", "coordinates": [[0, 0], [1, 1]]},
                        "properties": None,
                    },
                ],
            }
        )
    )
    found = read_pins(path)
    (pin,) = found.pins
    place = Mark.of_pin(pin, fuse(pin.clicks))
    assert (pin.name, found.left_out, place.height_ellipsoid_m) == ("hut", 1, 12.0)
    assert place.ce90_m == pytest.approx(4.0) and place.le90_m is None


def test_a_mark_says_its_ellipse_for_people() -> None:
    mark = Mark("m", "m", "ok", lat_deg=1.0, lon_deg=2.0, ce90_m=5.04, ellipse=Ellipse(6.0, 3.0, 44.6))
    assert mark.accuracy_text == "+-5.1 m (CE90), 90 % ellipse 6.0 x 3.0 m, long axis at 45 deg"
