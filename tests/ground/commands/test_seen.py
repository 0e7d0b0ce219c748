"""`pc-ground seen` as its user calls it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio

from ground.__main__ import main
from onboard.storage.mcap_writer import SessionRecorder
from tests.ground.seen.levels import CAMERA, CAPTURE_NS, HEIGHT_M, PLACE, level_set

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


def test_it_says_how_much_was_seen_and_where_the_gaps_are(session: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = printed(capsys, "--from", session, "--cell", 1).splitlines()
    assert lines[0].startswith("seen: 1.65 ha in 4 pictures of uav, 2023-11-14T22:13:20Z to 2023-11-14T22:13:23Z")
    assert lines[1] == "seen in one picture only: 66.7 %"
    assert "0.136 to 0.136 m" in lines[2]
    assert "convex hull" in lines[3] and "2 gaps" in lines[3]
    assert len(lines) == 6 and all(line.startswith("gap") for line in lines[4:])
    gap_m2 = (APART_M - WIDE_M) * HIGH_M
    assert float(lines[4].split()[2]) == pytest.approx(gap_m2 / 1e4, rel=0.05)


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


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("{", "not GeoJSON"), ("[]", "an object is needed"), ('{"type": "Point", "coordinates": [1, 2]}', "no Polygon"),
        ('{"type": "Polygon", "coordinates": [[[1, 2], [3, 4]]]}', "three corners"),
        ('{"type": "Polygon", "coordinates": [[[1, 2], ["a", 4], [5, 6]]]}', "longitude and latitude"),
        ('{"type": "Polygon", "coordinates": [[[1, 2], [3, 91], [5, 6]]]}', "longitude and latitude"),
        ('{"type": "Polygon", "coordinates": 7}', "must be a list"), ("[" * 100_000, "not GeoJSON"),
        ('{"type": "Polygon", "coordinates": [[[0, 0], [170, 0], [0, 80]]]}', "larger cells"),
    ],
)  # fmt: skip
def test_an_area_that_is_none_is_one_line(
    session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], content: str, words: str
) -> None:
    area = tmp_path / "area.geojson"
    area.write_text(content)
    assert main(["seen", "--from", str(session), "--polygon", str(area), "--out", str(tmp_path / "out.geojson")]) == 2
    complaint = capsys.readouterr().err
    assert complaint.count("\n") == 1 and words in complaint
    assert not (tmp_path / "out.geojson").exists()


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--out", "x.png"], "must end in"), (["--out", "/nowhere/x.tif"], "no folder"),
        (["--cell", "0.001"], "--cell"),
        (["--polygon", "/nowhere.geojson"], "No such file"), (["--vehicle", "kite"], "no vehicle"),
        (["--seconds", "3"], "live"),
    ],
)  # fmt: skip
def test_wrong_usage_is_one_line(
    session: Path, capsys: pytest.CaptureFixture[str], words: list[str], complaint: str
) -> None:
    assert main(["seen", "--from", str(session), *words]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and complaint in err


def test_a_session_that_answers_nowhere_has_seen_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with SessionRecorder(tmp_path / "unsure.mcap", "uav") as out:
        out.write_set(level_set(sigma_m=90.0))
    assert main(["seen", "--from", str(tmp_path / "unsure.mcap")]) == 3
    assert "nothing was surely seen" in capsys.readouterr().out
