"""`pc-ground seen` as its user calls it."""

import json
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from pymavlink import mavwp

from contract.camera import Camera
from contract.feature_set import FeatureSet, Status
from ground.__main__ import main
from ground.seen.area import read_sectors
from ground.seen.coverage import coverage
from ground.seen.flight_rows import Strip
from ground.seen.tally import SeenGround
from onboard.storage.mcap_writer import SessionRecorder
from tests.ground.seen.levels import CAMERA, CAPTURE_NS, HEIGHT_M, PLACE, level_set, record_search

WIDE_M, HIGH_M = HEIGHT_M * 640 / CAMERA.fx_px, HEIGHT_M * 480 / CAMERA.fx_px
APART_M = 130.0


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three pictures side by side, with a gap between each two, and the first once more."""
    path = tmp_path_factory.mktemp("seen") / "session.mcap"
    with SessionRecorder(path, "uav") as out:
        for frame, east in enumerate((0.0, APART_M, 2.0 * APART_M, 0.0)):
            out.write_set(level_set(frame, east_m=east))
    return path


def printed(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    assert main(["seen", *map(str, words)]) == 0
    return capsys.readouterr().out


def by_kind(path: Path) -> dict[str, list[dict[str, Any]]]:
    out: dict[str, list[dict[str, Any]]] = {}
    for feature in json.loads(path.read_text())["features"]:
        out.setdefault(feature["properties"]["kind"], []).append(feature)
    return out


def test_geojson_has_what_was_seen_the_area_and_its_gaps(session: Path, tmp_path: Path) -> None:
    to = tmp_path / "seen.geojson"
    assert main(["seen", "--from", str(session), "--cell", "1", "--out", str(to)]) == 0
    found = by_kind(to)
    (seen,), (searched,) = found["seen"], found["searched"]
    assert len(seen["geometry"]["coordinates"]) == 3
    assert seen["properties"]["area_m2"] == pytest.approx(3.0 * WIDE_M * HIGH_M, rel=0.05)
    assert searched["properties"]["is_hull"]
    assert [gap["properties"]["number"] for gap in found["gap"]] == [1, 2]
    total = seen["properties"]["area_m2"] + sum(gap["properties"]["area_m2"] for gap in found["gap"])
    assert total == pytest.approx(searched["properties"]["area_m2"], rel=1e-6)
    ring = np.array(found["gap"][0]["geometry"]["coordinates"][0][0])
    assert np.array_equal(ring[0], ring[-1])
    enu = PLACE.to_enu(ring[:, 1], ring[:, 0], np.zeros(len(ring)))
    middle = 0.5 * (enu.min(axis=0) + enu.max(axis=0))[:2]
    assert min(abs(middle[0] - APART_M / 2), abs(middle[0] - 1.5 * APART_M)) < 1.0 and abs(middle[1]) < 1.0


def test_geotiff_has_counts_times_and_distances_where_gis_expect_them(session: Path, tmp_path: Path) -> None:
    to = tmp_path / "seen.tif"
    assert main(["seen", "--from", str(session), "--cell", "1", "--out", str(to)]) == 0
    with rasterio.open(to) as raster:
        assert raster.crs.to_epsg() == 4326 and raster.count == 4 and np.isnan(raster.nodata)
        places = PLACE.to_geodetic(
            [(0.0, 0.0, 0.0), (APART_M, 20.0, 0.0), (APART_M / 2, 0.0, 0.0), (-300.0, 0.0, 0.0), (0.0, -30.0, 0.0)]
        )
        twice, once, gap, beyond, south = (v.tolist() for v in raster.sample(places[:, [1, 0]].tolist()))
    start = CAPTURE_NS // 10**9
    assert twice[:3] == [2.0, start, start + 3] and twice[3] == pytest.approx(HEIGHT_M / CAMERA.fx_px, rel=1e-3)
    assert once[:3] == [1.0, start + 1, start + 1]
    assert gap[0] == 0.0 and np.isnan(gap[1:]).all()
    assert np.isnan(beyond).all()
    assert south[0] == 2.0


def test_the_searched_area_is_the_polygon_that_is_given(
    session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    corners = PLACE.to_geodetic([(-20.0, -20.0, 0.0), (20.0, -20.0, 0.0), (20.0, 80.0, 0.0), (-20.0, 80.0, 0.0)])
    ring = corners[[0, 1, 2, 3, 0]][:, [1, 0]].tolist()
    area = tmp_path / "area.geojson"
    feature = {"type": "Feature", "properties": {}, "geometry": {"type": "Polygon", "coordinates": [ring]}}
    area.write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    reported_lines = printed(capsys, "--from", session, "--cell", 0.5, "--polygon", area)
    assert "searched area (as given): 4000 m2" in reported_lines.replace("0.40 ha", "4000 m2")
    share = 100.0 * (20.0 + HIGH_M / 2) / 100.0
    assert f"seen {share:.0f}"[:6] in reported_lines and "1 gap" in reported_lines


def test_an_area_whose_lists_have_no_end_is_one_line(
    session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Other texts that are none: tests/transcripts/pc-ground-seen.txt."""
    (tmp_path / "area.geojson").write_text("[" * 100_000)
    assert main(["seen", "--from", str(session), "--polygon", str(tmp_path / "area.geojson")]) == 2
    complaint = capsys.readouterr().err
    assert complaint.count("\n") == 1 and "not GeoJSON" in complaint


@pytest.fixture(scope="module")
def sectors(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The ground of the first pictures as sector "A & B", and as much of it next to it, which no picture shows."""
    folder = tmp_path_factory.mktemp("sectors")
    features, marks = [], []
    for name, east in (("A & B", 0.0), (4, -80.0)):
        corners = [
            (east - 20.0, -20.0, 0.0),
            (east + 20.0, -20.0, 0.0),
            (east + 20.0, 20.0, 0.0),
            (east - 20.0, 20.0, 0.0),
        ]
        ring = PLACE.to_geodetic(corners)[[0, 1, 2, 3, 0]][:, [1, 0]].tolist()
        geometry = {"type": "Polygon", "coordinates": [ring]}
        features.append({"type": "Feature", "properties": {"name": name, "canopy": 0.5}, "geometry": geometry})
        places = " ".join(f"{lon},{lat},0" for lon, lat in ring)
        ring_text = f"<LinearRing><coordinates>{places}</coordinates></LinearRing>"
        polygon = f"<Polygon><outerBoundaryIs>{ring_text}</outerBoundaryIs></Polygon>"
        marks.append(f"<Placemark><name>{str(name).replace('&', '&amp;')}</name>{polygon}</Placemark>")
    (folder / "s.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    kml = f'<kml xmlns="http://www.opengis.net/kml/2.2"><Document>{"".join(marks)}</Document></kml>'
    (folder / "s.kml").write_text(kml)
    return {kind: folder / f"s.{kind}" for kind in ("geojson", "kml")}


@pytest.fixture(scope="module")
def thermal(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four looks at one place, by each of which 0.8 of the people there have been named."""
    return record_search(tmp_path_factory.mktemp("thermal") / "session.mcap", 4, (0.8,) * 20)


@pytest.mark.parametrize("kind", ["geojson", "kml"])
def test_each_sector_has_its_probability_of_detection(
    thermal: Path, sectors: dict[str, Path], kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("--from", thermal, "--cell", 1, "--polygon", sectors[kind], "--pod", "--look", 60)
    lines = printed(capsys, *words).splitlines()
    assert "4 of 4 pictures" in lines[-6]
    assert lines[-5] == "POD 0.79 (0.79 to 0.79) by machine in sector A & B, 0 m2 left below 0.5"
    assert lines[-3].startswith("POD 0.00 (0.00 to 0.00) by machine in sector 4, 0.1")
    content = json.loads(printed(capsys, *words, "--json", "--below", 0.9, "--by", "operator"))["detection"]
    seen, unseen = content["sectors"]
    assert (content["by"], content["below"], content["searched_pictures"]) == ("operator", 0.9, 4)
    assert seen["machine"]["pod"] == pytest.approx(0.786, abs=0.01) and unseen["operator"]["high"] == 0.0
    assert seen["below_m2"] == {"machine": pytest.approx(1600.0, rel=0.05), "operator": 0.0}
    assert sum(gap["area_m2"] for gap in content["gaps"]) == pytest.approx(1600.0, rel=0.05)


def test_gaps_of_detection_are_exported_and_trees_make_more_of_them(
    thermal: Path, sectors: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    to = [tmp_path / f"gaps.{kind}" for kind in ("geojson", "kml", "tif")]
    outs = [word for path in to for word in ("--out", path)]
    words = ("--from", thermal, "--cell", 1, "--polygon", sectors["kml"], "--pod")
    printed(capsys, *words, *outs)
    (gap,) = by_kind(to[0])["undetected"]
    assert gap["properties"]["by"] == "machine" and gap["properties"]["area_m2"] == pytest.approx(1600.0, rel=0.05)
    (again,) = read_sectors(to[1])
    assert again.name == "gap 1"
    assert again.rings[0] == pytest.approx(np.array(gap["geometry"]["coordinates"][0][0][:-1]), abs=1e-7)
    with rasterio.open(to[2]) as raster:
        seen, gap_there = raster.sample(PLACE.to_geodetic([(0.0, 0.0, 0.0), (-80.0, 0.0, 0.0)])[:, [1, 0]].tolist())
        assert raster.count == 6 and seen[4] == pytest.approx(0.786, abs=0.01) and 0.0 < seen[5] < 1.0
        assert gap_there[4:].tolist() == [0.0, 0.0]
    lines = printed(capsys, *words, "--woods", sectors["geojson"])
    assert "POD 0.39 (0.39 to 0.39) by machine in sector A & B" in lines and "0.16 ha left" in lines


def test_a_refused_picture_ends_the_time_for_the_one_before_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Before, an operator looked at an answered picture until the next answered one."""
    found = []
    for step in (1, 5):  # pictures are a second apart: of the others, nothing is sent, or a refusal
        path = tmp_path / f"{step}.mcap"
        with SessionRecorder(path, "uav") as out:
            out.write_set(level_set(0))
            for frame in range(step, 6, step):
                s = level_set(frame)
                out.write_set(FeatureSet("uav", s.session, frame, s.capture_unix_ns, Status.TURNING, CAMERA))
        pod = json.loads(printed(capsys, "--from", path, "--pod", "--json"))["detection"]["sectors"][0]["operator"]
        found.append(pod["pod"] if isinstance(pod, dict) else pod[0])
    one_s, five_s = found
    assert 0.0 < one_s < 0.7 * five_s


def test_rows_over_the_gaps_close_them_and_others_read_their_files(
    session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = {kind: tmp_path / f"gaps.{kind}" for kind in ("plan", "waypoints", "kml")}
    words = ("--from", session, "--cell", 1, "--pod", "--look", 60, "--height", HEIGHT_M)
    lines = printed(capsys, *words, *(word for path in files.values() for word in ("--fly", path)))
    assert "to fly: 2 rows, 61 m apart, 120 m above the ground, at 10 m/s\n" in lines
    plan = json.loads(files["plan"].read_text())
    assert (plan["fileType"], plan["version"], plan["mission"]["version"]) == ("Plan", 1, 2)
    items = plan["mission"]["items"]
    assert [item["doJumpId"] for item in items] == [1, 2, 3, 4]
    assert all((item["command"], item["frame"], item["params"][:4]) == (16, 3, [0, 0, 0, None]) for item in items)
    points = np.array([item["params"][4:] for item in items])
    assert np.all(points[:, 2] == HEIGHT_M)
    loader = mavwp.MAVWPLoader()
    assert loader.load(str(files["waypoints"])) == 5
    read = [loader.wp(k) for k in range(5)]
    assert [(w.seq, w.current, w.frame, w.command, w.autocontinue) for w in read] == [
        (0, 1, 0, 16, 1), *((k, 0, 3, 16, 1) for k in range(1, 5))
    ]  # fmt: skip
    assert np.array([(w.x, w.y, w.z) for w in read[1:]]) == pytest.approx(points, abs=1e-7)
    line = ET.parse(files["kml"]).find(".//{*}LineString/{*}coordinates")
    corners = np.array([[float(number) for number in corner.split(",")] for corner in line.text.split()])
    assert corners == pytest.approx(points[:, [1, 0, 2]], abs=1e-7)
    seen = SeenGround(1.0)
    for frame, east in enumerate((0.0, APART_M, 2.0 * APART_M)):
        seen.add(level_set(frame, east_m=east))
    before = coverage(seen)
    ends = PLACE.to_enu(points[:, 0], points[:, 1], np.zeros(4))[:, :2].reshape(2, 2, 2)
    looks = [start + step * (end - start) for start, end in ends for step in np.linspace(0.0, 1.0, 6)]
    for frame, (east, north) in enumerate(looks, 10):
        seen.add(level_set(frame, east_m=float(east), north_m=float(north)))
    after = coverage(seen, [[before.lon_lat(gap.patch.outer)] for gap in before.gaps]) if before else None
    assert after.seen_of_searched_m2 > 0.98 * after.searched_m2


@pytest.mark.parametrize(
    ("words", "at_m", "complaint"),
    [
        (["--below", "0.75"], HEIGHT_M, ""),  # looked at from there it was enough
        (["--below", "0.9"], None, "choose --height"),
        (["--by", "operator", "--below", "0.9", "--look", "60"], (40.0, 160.0), ""),
        (["--by", "operator", "--below", "0.99", "--look", "1"], None, "longer --look"),
        (["--below", "0.8", "--height", "50", "--overlap", "0.6"], 50.0, ""),
    ],
)
def test_the_height_is_what_the_wanted_probability_needs(
    thermal: Path, sectors: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str],
    words: list[str], at_m: float | tuple[float, float] | None, complaint: str,
) -> None:  # fmt: skip
    to = tmp_path / "gaps.plan"
    command = ["seen", "--from", str(thermal), "--polygon", str(sectors["kml"]), "--pod", "--fly", str(to), *words]
    assert main(command) == (2 if complaint else 0)
    assert complaint in capsys.readouterr().err
    if at_m is not None:
        low, high = at_m if isinstance(at_m, tuple) else (at_m - 0.1, at_m + 0.1)
        heights = {item["Altitude"] for item in json.loads(to.read_text())["mission"]["items"]}
        assert len(heights) == 1 and low <= heights.pop() <= high


@pytest.mark.parametrize(
    ("camera", "half_deg"),
    [
        (CAMERA, 0.0),
        (Camera(640, 480, 210.0, 210.0, 319.5, 239.5, (0.02, -0.01, 0.0, 0.0), "fisheye"), 45.0),
        (Camera(640, 480, 600.0, 600.0, 319.5, 239.5, (0.0, 0.0, 0.0, 0.0), "fisheye"), 30.6),
    ],
    ids=["pinhole", "wide fisheye", "narrow fisheye"],
)
def test_all_of_the_strip_of_a_row_is_as_fine_as_wanted(camera: Camera, half_deg: float) -> None:
    """A fisheye's rows were as wide as its angle, from a height at which only their middle was fine enough. (23.16)"""
    strip = Strip.of(camera)
    height_m = strip.height_m(camera, 0.1)
    edge = camera.pixels((strip.across, 0.0))
    across_m = [camera.unproject(edge - (px, 0.0))[0][0] * height_m for px in (0.0, 1.0)]
    assert 0.985 < (across_m[0] - across_m[1]) / 0.1 < 1.001
    assert half_deg in (0.0, pytest.approx(np.degrees(np.arctan(strip.across)), abs=0.1))
    if half_deg == 0.0:
        assert (strip.across, strip.along) == (320.0 / camera.fx_px, 240.0 / camera.fy_px)
