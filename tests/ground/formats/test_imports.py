"""Files of other programs as pins: tables as spreadsheets write them, Cursor on Target from TAK."""

import contextlib
import gc
import io
import zipfile
from pathlib import Path

import pytest

from contract.errors import InputError
from ground.formats import cot, table
from ground.formats.documents import IMPORTED, read_pins, read_pins_of
from ground.formats.imported import Imported
from ground.formats.mark import Mark
from ground.pins.fusion import fuse
from tests.ground.formats.test_formats import NOW_NS, marks


def places(found: Imported) -> list[tuple[str, float, float]]:
    return [(pin.name, pin.clicks[0].lat_deg, pin.clicks[0].lon_deg) for pin in found.pins]


ROW = "Hütte,-43.38,172.40\r\n"


@pytest.mark.parametrize(
    "data",
    [
        ("name,lat,lon\r\n" + ROW).encode(),
        ("Name,Latitude,Longitude\n" + ROW).encode("utf-8-sig"),
        ("name,latitude,longitude\n" + ROW).encode("latin-1"),
        ("name;lat;lon\nHütte;-43,38;172,40\n").encode("cp1252"),
        ("name;lat;lon\nHütte;-43.38;172.40\n;;\n").encode(),
        ("name\tlat_deg\tlon_deg\nHütte\t-43.38\t172.40\n").encode("utf-16"),
        ("title;LON;LAT\nHütte;172°24'0\"E;43°22'48\"S\n").encode(),
        ('label,lng,lat\n"Hütte",172.4,-43.38\n').encode(),
        ("lat,lon,name,lat_deg,lon_deg\n1,2,Hütte,-43.38,172.40\n").encode(),
    ],
)
def test_a_table_of_any_usual_kind_gives_the_same_place(data: bytes) -> None:
    ((name, lat, lon),) = places(table.read(data))
    assert (name, lat, lon) == ("Hütte", pytest.approx(-43.38), pytest.approx(172.40))


def test_our_own_events_come_back_with_name_place_and_accuracy(tmp_path: Path) -> None:
    given = [mark for mark in marks("zelt & =1", "by the barn") if mark.is_placed]
    path = tmp_path / "pins.cot"
    path.write_text("".join(f"{cot.event(mark, NOW_NS, 60.0)}\n" for mark in given), encoding="utf-8")
    found = read_pins(path)
    assert found.left_out == 0 and len(found.pins) == len(given) == 2
    for pin, mark in zip(found.pins, given, strict=True):
        back = Mark.of_pin(pin, fuse(pin.clicks))
        assert (pin.name, pin.note, pin.category.value) == ("zelt & =1", "by the barn", mark.category)
        assert (back.lat_deg, back.lon_deg) == pytest.approx((mark.lat_deg, mark.lon_deg), abs=2e-9)
        assert (back.ce90_m is None) == (mark.ce90_m is None)
        if mark.ce90_m is not None:
            assert back.ce90_m == pytest.approx(mark.ce90_m, abs=0.01)
            assert back.height_ellipsoid_m == pytest.approx(mark.height_ellipsoid_m, abs=0.01)


TAK = """<?xml version="1.0" encoding="UTF-8" standalone="yes"?>
<event version="2.0" uid="a1" type="a-u-G" time="2026-01-02T03:04:05Z" start="2026-01-02T03:04:05Z" how="h-g-i-g-o">
<point lat="-43.38" lon="172.40" hae="9999999.0" ce="9999999.0" le="9999999.0"/>
<detail><contact callsign="U.2.030405"/><remarks>tracks here</remarks></detail></event>"""


def test_a_marker_of_tak_is_a_pin_and_aircraft_and_chat_are_not() -> None:
    others = "".join(
        TAK.replace('type="a-u-G"', f'type="{kind}"') for kind in ("a-f-A-M-F-Q", "b-t-f", "u-d-f", "t-x-c-t")
    )
    found = read_pins_of("from atak.xml", (TAK + others).encode("utf-8-sig"), who="ann")
    (pin,) = found.pins
    assert found.left_out == 4 and (pin.name, pin.note, pin.who) == ("U.2.030405", "tracks here", "ann")
    place = Mark.of_pin(pin, fuse(pin.clicks))
    assert (place.lat_deg, place.lon_deg, place.ce90_m, place.height_ellipsoid_m) == (-43.38, 172.40, None, None)
    assert place.time_text.startswith("2026-01-02T03:04:05")


def test_a_browser_s_file_is_read_by_its_name_or_the_kind_that_was_chosen() -> None:
    data = ("name,lat,lon\n" + ROW).encode()
    assert places(read_pins_of("places.csv", data)) == places(read_pins_of("places.txt", data, "csv"))
    assert set(IMPORTED) == {"geojson", "kml", "gpx", "csv", "cot"}
    with pytest.raises(InputError, match=r"places\.txt"):
        read_pins_of("places.txt", data)


def test_a_document_leaves_the_collector_of_garbage_as_it_was() -> None:
    assert gc.isenabled()
    for content in (b"<kml/>", b"<kml>"):
        with contextlib.suppress(InputError):
            read_pins_of("a.kml", content)
        assert gc.isenabled()
    gc.disable()
    try:
        read_pins_of("a.kml", b"<kml/>")
        assert not gc.isenabled()
    finally:
        gc.enable()


KMZ_TEXT = (
    '<kml xmlns="http://www.opengis.net/kml/2.2"><Document>{}<Placemark><name>B</name><Point><coordinates>8.6,47.3'
    "</coordinates></Point></Placemark></Document></kml>"
)
BAD_PLACE = "<Placemark><name>bad</name><Point><coordinates>{}</coordinates></Point></Placemark>"


def kmz(text: str, name: str = "doc.kml") -> bytes:
    """Return a KMZ archive of ``text`` whose bytes do not depend on the time: they are part of a test's name."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for member, content in (("files/a.png", "x"), (name, text)):
            archive.writestr(zipfile.ZipInfo(member), content, zipfile.ZIP_DEFLATED)
    return out.getvalue()


def of_features(*coordinates: str) -> bytes:
    features = ",".join(
        f'{{"type":"Feature","geometry":{{"type":"Point","coordinates":{c}}},"properties":{{"title":"B"}}}}'
        for c in coordinates
    )
    return f'{{"type":"FeatureCollection","features":[{features}]}}'.encode()


@pytest.mark.parametrize(
    ("name", "data", "bad"),
    [
        ("a.kml", KMZ_TEXT.format(BAD_PLACE.format("")).encode(), "placemark 'bad': no coordinates"),
        ("a.kml", KMZ_TEXT.format(BAD_PLACE.format("8.5")).encode(), "placemark 'bad': no coordinates"),
        ("a.kml", KMZ_TEXT.format(BAD_PLACE.format("x,y")).encode(), "placemark 'bad'"),
        ("a.kml", KMZ_TEXT.format(BAD_PLACE.format("8,1e999")).encode(), "placemark 'bad'"),
        ("a.kml", KMZ_TEXT.format(BAD_PLACE.format("8,5,47,3")).encode(), "placemark 'bad': its coordinates are not"),
        ("a.kml", KMZ_TEXT.format(BAD_PLACE.format("8,47,9 8,48,9")).encode(), "placemark 'bad': its coordinates are"),
        ("a.kmz", kmz(KMZ_TEXT.format(BAD_PLACE.format(""))), "placemark 'bad': no coordinates"),
        ("a.gpx", b'<gpx><wpt lat="nan" lon="8"><name>bad</name></wpt><wpt lat="47.3" lon="8.6"><name>B</name></wpt>'
         b"</gpx>", "waypoint 'bad': lat_deg = "),
        ("a.geojson", of_features("[8.6,47.3]", f"[{10**400},47]"), "feature 1: metres"),
        ("a.geojson", of_features("[8.6,47.3]", f"[8,47,{10**400}]"), "feature 1"),
        ("a.geojson", of_features("[8.6,47.3]", "[1e999,47]"), "feature 1"),
        ("a.geojson", of_features("[8.6,47.3]", "[true,null]"), "feature 1: coordinates are longitude"),
        ("a.csv", b"name,lat,lon\nB,47.3,8.6\nbad,x,y\n", "CSV, line 3"),
        ("a.csv", b"name,lat,lon\nB,47.3,8.6,,\nbad,47,3,8,6\n", "CSV, line 3: more cells than the first line names"),
        ("a.cot", (TAK.replace("-43.38", "47.3").replace("172.40", "8.6").replace("U.2.030405", "B")
         + TAK.replace("-43.38", "91").replace("a1", "bad")).encode(), "event 'bad'"),
    ],
)  # fmt: skip
def test_one_bad_place_is_listed_and_the_others_are_taken(name: str, data: bytes, bad: str) -> None:
    found = read_pins_of(name, data)
    assert places(found) == [("B", 47.3, 8.6)]
    (line,) = found.bad
    assert line.startswith(bad) and len(line) < 300


def test_a_kmz_is_its_document_and_another_archive_is_a_line() -> None:
    for name in ("doc.kml", "other/Places.KML"):
        assert places(read_pins_of("a.kmz", kmz(KMZ_TEXT.format(""), name))) == [("B", 47.3, 8.6)]
    for data in (kmz("x", "a.txt"), kmz(KMZ_TEXT.format(""))[:-30], b"PK", b"PK\x03\x04" + bytes(100)):
        with pytest.raises(InputError, match=r"a\.kmz: .*not KMZ"):
            read_pins_of("a.kmz", data)


def test_a_height_of_exactly_zero_is_not_known() -> None:
    """CalTopo writes 0 for a height that it does not know."""
    gpx = b'<gpx><wpt lat="47.3" lon="8.6"><ele>0</ele></wpt></gpx>'
    for name, data in (("a.geojson", of_features("[8.6,47.3,0,1789000000000]")), ("a.gpx", gpx)):
        (pin,) = read_pins_of(name, data).pins
        assert (pin.clicks[0].height_ellipsoid_m, pin.clicks[0].height_amsl_m) == (None, None)
    (pin,) = read_pins_of("a.geojson", of_features("[8.6,47.3,430.5]")).pins
    assert pin.clicks[0].height_ellipsoid_m == 430.5


def test_coordinates_of_another_system_are_named() -> None:
    swiss = of_features("[2683000,1247000]")

    def named(crs: str, data: bytes) -> bytes:
        return data.replace(b'"features"', f'"crs":{{"properties":{{"name":"{crs}"}}}},"features"'.encode())

    with pytest.raises(InputError, match="are of urn:ogc:def:crs:EPSG::2056, and WGS84 is needed"):
        read_pins_of("a.geojson", named("urn:ogc:def:crs:EPSG::2056", swiss))
    with pytest.raises(InputError, match="metres rather than degrees"):
        read_pins_of("a.geojson", swiss)
    ours = named("urn:ogc:def:crs:OGC:1.3:CRS84", of_features("[8.6,47.3]"))
    assert places(read_pins_of("a.geojson", ours)) == [("B", 47.3, 8.6)]


def test_the_samples_of_what_people_bring_are_read(shared_data: Path) -> None:
    folder = shared_data / "people_bring"
    counts = {name: read_pins(folder / name) for name in ("a.kmz", "caltopo.geojson", "one_empty.kml", "onebad.gpx")}
    assert {name: (len(found.pins), len(found.bad)) for name, found in counts.items()} == {
        "a.kmz": (1, 0), "caltopo.geojson": (1, 0), "one_empty.kml": (1, 1), "onebad.gpx": (1, 1),
    }  # fmt: skip


@pytest.mark.parametrize(
    ("table_text", "expected"),
    [
        ("lat,ns,lon,ew\n43.38,S,72.40,W\n", (-43.38, -72.40)),
        ("lat,lat_dir,lon,lon_dir\n-43.38,S,72.40,West\n", (-43.38, -72.40)),
        ("latitude,N/S,longitude,E/W\n43.38,n,72.40,e\n", (43.38, 72.40)),
        ("lat,lat_min,lat_sec,NS,lon,lon_min,lon_sec,EW\n43,22,48,S,172,24,0,E\n", (-43.38, 172.40)),
        ("lat;min;sec;ns;lon;min;sec;ew\n43;22;48,0;S;172;24;0;E\n", (-43.38, 172.40)),
        ("lat_deg,lat_min,lon_deg,lon_min\n-43,22.8,172,24\n", (-43.38, 172.40)),
        ("lat_deg,lat_min,lon_deg,lon_min\n-43.38,,172.40,\n", (-43.38, 172.40)),
        ("lat,lon,datum\n-43.38,172.40,WGS 84\n", (-43.38, 172.40)),
        ("lat,lon,crs\n-43.38,172.40,urn:ogc:def:crs:OGC:1.3:CRS84\n", (-43.38, 172.40)),
        ("lat,lon,crs,x,y\n-43.38,172.40,EPSG:2193,1,2\n", (-43.38, 172.40)),
        ("lat,lon,checked,minutes\n-43.38,172.40,N,12\n", (-43.38, 172.40)),
        ("lat,lon,ns,ew\n43.38,172.40,S,E\n", (-43.38, 172.40)),
        ("lat,lon,direction\n-43.38,172.40,270\n", (-43.38, 172.40)),
        ("lat,lon,ref\n-43.38,172.40,W7\n", (-43.38, 172.40)),
        ("lat,ref,lon,ref\n43.38,S1,172.40,W2\n", (43.38, 172.40)),
        ("sep=;\r\nlat;lon\r\n-43,38;172,40\r\n", (-43.38, 172.40)),
        ("lat,lon,latitude,longitude\n-43.38,172.40,-43.380,172.4\n", (-43.38, 172.40)),
        ("lat,lon,latitude,longitude\n,,-43.38,172.40\n", (-43.38, 172.40)),
    ],
)
def test_columns_next_to_the_degrees_are_part_of_a_place(table_text: str, expected: tuple[float, float]) -> None:
    (pin,) = read_pins_of("a.csv", table_text.encode()).pins
    assert (pin.clicks[0].lat_deg, pin.clicks[0].lon_deg) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    ("table_text", "words"),
    [
        ("lat,longitude,latitude,lon\n-43.0,172.4,-43.38,171\n", "two latitudes that differ"),
        ("latitude,longitude,lat,lon\n-43.38,172.4,-43.38,171\n", "two longitudes that differ"),
        ("lat_deg,longitude,lat,lon\n-43.38,172.4,-44,171\n", "two latitudes that differ"),
        ("lat,ns,lon,ew\n43,S1,172,E\n", "'S1' is no hemisphere"),
    ],
)
def test_a_table_whose_columns_disagree_is_refused(table_text: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        read_pins_of("a.csv", table_text.encode())


def test_every_point_of_a_file_becomes_a_pin() -> None:
    kml = "<kml><Document>{}</Document></kml>"
    point = "<Point><coordinates>{},47</coordinates></Point>"
    place = "<Placemark><name>A</name>{}</Placemark>"
    several = place.format(f"<MultiGeometry>{point.format(8)}{point.format(9)}</MultiGeometry>")
    link = "<NetworkLink><name>more</name><Link><href>{}</href></Link></NetworkLink>"
    found = read_pins_of("a.kml", kml.format(several + link.format("https://example.org/b.kml")).encode())
    assert [lon for _, _, lon in places(found)] == [8.0, 9.0]
    assert found.bad == ["link 'more': its places are in 'https://example.org/b.kml': import that"]

    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        archive.writestr("more/b.kml", kml.format(place.format(point.format(9))))
        archive.writestr("doc.kml", kml.format(place.format(point.format(8)) + link.format("more/b.kml")))
    found = read_pins_of("a.kmz", packed.getvalue())
    assert ([lon for _, _, lon in places(found)], found.bad) == ([8.0, 9.0], [])

    several_json = b'{"type":"Feature","geometry":{"type":"MultiPoint","coordinates":[[8,47],[9,47]]}}'
    assert [lon for _, _, lon in places(read_pins_of("a.geojson", several_json))] == [8.0, 9.0]


def test_longitudes_that_a_map_counted_on_are_brought_back() -> None:
    """Maps in browsers count on beyond the date line."""
    found = read_pins_of("a.geojson", of_features("[-187.5,-16.8]"))
    assert places(found) == [("B", -16.8, 172.5)]


def test_a_feature_may_name_its_own_system() -> None:
    crs = '"crs":{"type":"name","properties":{"name":"EPSG:4230"}}'
    for text in (
        f'{{"type":"Feature",{crs},"geometry":{{"type":"Point","coordinates":[5,52]}}}}',
        f'{{"type":"Feature","geometry":{{"type":"Point",{crs},"coordinates":[5,52]}}}}',
    ):
        with pytest.raises(InputError, match="are of EPSG:4230"):
            read_pins_of("a.geojson", text.encode())


def test_of_a_marker_that_was_sent_again_the_newest_event_counts() -> None:
    """A log of a network holds a marker that is sent again every ten seconds a hundred times, and where it was once."""

    def event(uid: str, kind: str, second: int, lat_deg: float, more: str = "") -> str:
        return (
            f'<event version="2.0" uid="{uid}" type="{kind}" time="2026-11-30T00:00:{second:02d}Z">'
            f'<point lat="{lat_deg}" lon="172" hae="9999999" ce="10" le="9999999"/><detail>{more}</detail></event>'
        )

    sent = [event("a", "b-m-p-s-m", 20, -43.2), *(event("a", "b-m-p-s-m", s, -43.1) for s in (1, 2, 3))]
    sent += [event("b", "b-m-p-s-m", 4, -44.0), event("x", "t-x-d-d", 5, 0.0, '<link uid="b"/>')]
    sent += [event("uav.SPI1", "b-m-p-s-p-i", 6, -45.0)]  # where a camera looks
    found = read_pins_of("a.cot", "".join(sent).encode())
    assert [lat for _, lat, _ in places(found)] == [-43.2]
    assert found.left_out == 1


def names_and_notes(name: str, text: str) -> list[tuple[str, str]]:
    return [(pin.name, pin.note) for pin in read_pins_of(name, text.encode()).pins]


GPX_POINT = (
    '<gpx xmlns="http://www.topografix.com/GPX/1/1" xmlns:x="https://osmand.net"><wpt lat="47.3" lon="8.6">'
    "<name>B</name>{}<extensions><x:name>other</x:name><x:ce90_m>3</x:ce90_m></extensions></wpt></gpx>"
)
KML_POINT = "<kml><Placemark>{}<Point><coordinates>8.6,47.3</coordinates></Point></Placemark></kml>"


def test_the_name_and_note_of_another_program_s_place_are_its_own() -> None:
    """Extensions and data of others hid them: Garmin's and OsmAnd's waypoints, and QGIS's placemarks, had no name."""
    assert names_and_notes("a.gpx", GPX_POINT.format("<desc>seen</desc>")) == [("B", "seen")]
    assert names_and_notes("a.gpx", GPX_POINT.format("<cmt>seen</cmt>")) == [("B", "seen")]
    data = '<ExtendedData><Data name="color"><value>red</value></Data></ExtendedData>'
    text = KML_POINT.format(f"<name>B</name><description>seen</description>{data}")
    assert names_and_notes("a.kml", text) == [("B", "seen")]
    schema = '<SchemaData><SimpleData name="Name">B</SimpleData><SimpleData name="NOTES">seen</SimpleData></SchemaData>'
    assert names_and_notes("a.kml", KML_POINT.format(f"<ExtendedData>{schema}</ExtendedData>")) == [("B", "seen")]
    feature = '{{"type":"Feature","geometry":{{"type":"Point","coordinates":[8.6,47.3]}},"properties":{}}}'
    for about, expected in (
        ('{"Name":"B","Description":"seen"}', ("B", "seen")),
        ('{"name":null,"title":"B","note":""}', ("B", "")),
        ('{"name":12,"note":true}', ("12", "")),
    ):
        assert names_and_notes("a.geojson", feature.format(about)) == [expected]
    (pin,) = read_pins_of("a.gpx", GPX_POINT.format("").encode()).pins
    assert pin.clicks[0].covariance_enu_m2 is None  # the figure is another's, of a kind that is not known


def test_the_points_of_a_collection_are_pins() -> None:
    parts = '{"type":"Point","coordinates":[8.6,47.3]},{"type":"LineString","coordinates":[[1,2],[3,4]]}'
    text = f'{{"type":"Feature","geometry":{{"type":"GeometryCollection","geometries":[{parts}]}}}}'
    assert places(read_pins_of("a.geojson", text.encode())) == [("", 47.3, 8.6)]


def test_a_point_within_the_detail_of_an_event_is_not_its_place() -> None:
    more = '<shape><point lat="1" lon="2" hae="0"/><contact callsign="x"/><remarks>y</remarks></shape></detail>'
    (pin,) = read_pins_of("a.cot", TAK.replace("</detail>", more).encode()).pins
    assert (pin.name, pin.note) == ("U.2.030405", "tracks here")
    assert (pin.clicks[0].lat_deg, pin.clicks[0].lon_deg) == (-43.38, 172.40)


@pytest.mark.parametrize("unknown", ["999999", "999999.0", "99999", "9999999.0"])
def test_every_row_of_nines_is_unknown(unknown: str) -> None:
    (pin,) = read_pins_of("a.cot", TAK.replace("9999999.0", unknown).encode()).pins
    assert pin.clicks[0].height_ellipsoid_m is None and pin.clicks[0].covariance_enu_m2 is None


@pytest.mark.parametrize(
    ("when", "is_moment"),
    [("2026-09-21", False), ("20260921", False), ("2026-W10", False), ("2026-09-21T14:14:00Z", True),
     ("2026-09-21 14:14", True), ("20260921T141400Z", True)],
)  # fmt: skip
def test_a_day_alone_is_no_moment(when: str, is_moment: bool) -> None:
    """Taken for midnight, a person was seen hours before anybody looked."""
    (pin,) = read_pins_of("a.csv", f"lat,lon,time\n47.3,8.6,{when}\n".encode()).pins
    assert (pin.seen_unix_ns is not None) == is_moment


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.cot", TAK.replace('ce="9999999.0" le="9999999.0"', 'ce="-1" le="-1"')),
        ("a.cot", TAK.replace("9999999.0", "NaN")),
        ("a.csv", "lat,lon,height_amsl_m,ce90_m,le90_m\n-43.38,172.40,nan,0,0\n"),
        ("a.gpx", '<gpx><wpt lat="-43.38" lon="172.40"><ele>NaN</ele></wpt></gpx>'),
    ],
)
def test_a_height_or_an_accuracy_that_is_none_does_not_cost_the_place(name: str, text: str) -> None:
    (pin,) = read_pins_of(name, text.encode()).pins
    click = pin.clicks[0]
    assert (click.lat_deg, click.lon_deg, click.covariance_enu_m2) == (-43.38, 172.40, None)
    assert click.height_amsl_m is None and click.height_ellipsoid_m is None


def test_a_change_of_a_placemark_is_no_place() -> None:
    change = (
        '<Update><Change><Placemark targetId="a"><Point><coordinates>1,2</coordinates></Point></Placemark></Change>'
    )
    text = KML_POINT.format("<name>B</name>").replace("<kml>", f"<kml>{change}</Update>")
    assert places(read_pins_of("a.kml", text.encode())) == [("B", 47.3, 8.6)]
