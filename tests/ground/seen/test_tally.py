"""The map of what was seen: every picture once, at its latest revision, in bounded memory; and who saw a place."""

import dataclasses
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from contract.errors import InputError
from contract.feature_set import FeatureSet, Status
from ground.seen import pictures, tally
from ground.seen.cells import Cells
from ground.seen.coverage import gaps
from ground.seen.picture_cells import picture_cells
from ground.seen.tally import SeenGround, round_cell_m
from tests.ground.seen.levels import CAMERA, CAPTURE_NS, PLACE, level_set

START_S = CAPTURE_NS // 10**9
MIDDLE = PLACE.lat_deg, PLACE.lon_deg


def counts(seen: SeenGround) -> int:
    return sum(int(tile["count"].sum()) for _, tile in seen.all_tiles())


def fields_by_cell(seen: SeenGround) -> dict[tuple[int, int], tuple[float, ...]]:
    out = {}
    for (row, column), tile in seen.all_tiles():
        for y, x in np.argwhere(tile["count"] > 0).tolist():
            out[row * 64 + y, column * 64 + x] = tuple(tile[y, x].tolist())
    return out


def test_a_cell_knows_how_often_when_and_how_finely_it_was_seen() -> None:
    seen = SeenGround(2.0)
    for frame, height in ((10, 150.0), (14, 110.0), (12, 130.0)):
        assert seen.add(level_set(frame, height_m=height))
    cell = seen.cell(*MIDDLE)
    assert (cell["count"], cell["first_s"], cell["last_s"]) == (3, START_S + 10, START_S + 14)
    assert cell["gsd_m"] == pytest.approx(110.0 / CAMERA.fx_px, rel=1e-3)
    assert (cell["frame"], seen.sources[cell["by"]]) == (14, ("uav", 1))
    assert [shown.frame for shown in seen.showing(*MIDDLE)] == [10, 12, 14]
    finest = seen.finest(cell)
    assert (finest.frame, finest.capture_unix_ns) == (14, CAPTURE_NS + 14 * 10**9)
    assert seen.showing(*MIDDLE)[1].gsd_m == pytest.approx(130.0 / CAMERA.fx_px, rel=1e-3)
    lat, lon, _ = PLACE.to_geodetic((500.0, 0.0, 0.0))
    assert seen.cell(float(lat), float(lon)) is None and seen.showing(float(lat), float(lon)) == []


def test_a_revision_takes_the_place_of_the_earlier_one_and_a_repetition_changes_nothing() -> None:
    once, again = SeenGround(2.0), SeenGround(2.0)
    better = level_set(1, sigma_m=1.0, revision=3)
    once.add(better)
    again.add(level_set(1, sigma_m=4.0, revision=1))
    few = counts(again)
    again.add(better)
    assert not again.add(level_set(1, sigma_m=0.1, revision=2))
    assert not again.add(better)
    assert counts(once) == counts(again) > few
    # Refused after all: then it has seen nothing.
    again.add(FeatureSet("uav", 1, 1, better.capture_unix_ns, Status.POOR_FIT, CAMERA, revision=4))
    assert counts(again) == 0 and again.cell(*MIDDLE) is None and again.showing(*MIDDLE) == []


def test_what_is_settled_is_not_counted_again_and_nothing_is_lost_by_settling() -> None:
    seen = SeenGround(2.0)
    for frame in range(4):
        seen.add(level_set(frame, east_m=3.0 * frame))
    before, shown = fields_by_cell(seen), [s.frame for s in seen.showing(*MIDDLE)]
    seen.add(level_set(4, east_m=2000.0, at_s=100.0))
    there = {at: cell for at, cell in fields_by_cell(seen).items() if at in before}
    assert there == before and [s.frame for s in seen.showing(*MIDDLE)] == shown
    assert not seen.add(level_set(2, east_m=6.0, revision=9))
    assert seen.pictures == 5


def test_the_order_in_which_sets_come_does_not_matter() -> None:
    sets = [level_set(k, east_m=7.0 * k, height_m=100.0 + 10.0 * (k % 3), at_s=40.0 * k) for k in range(8)]
    maps = []
    for order in (range(8), (3, 0, 7, 5, 1, 2, 6, 4)):
        seen = SeenGround(2.0)
        for k in order:
            seen.add(sets[k])
        maps.append(fields_by_cell(seen))
    assert maps[0] == maps[1] and len(maps[0]) > 1000


def test_the_map_is_the_sum_of_its_pictures() -> None:
    seen, cells = SeenGround(2.0), Cells.about(*MIDDLE, 2.0)
    seen.cells = cells
    expected: dict[tuple[int, int], int] = {}
    for frame, tilt in enumerate((0.0, 15.0, -20.0, 5.0)):
        s = level_set(frame, tilt_deg=tilt, east_m=11.0 * frame)
        seen.add(s)
        found = picture_cells(s, cells)
        for at in zip(found.row.tolist(), found.column.tolist(), strict=True):
            expected[at] = expected.get(at, 0) + 1
    assert {at: int(cell[0]) for at, cell in fields_by_cell(seen).items()} == expected
    for row, column in list(expected)[::97]:
        lat, lon = float(cells.lat_deg(row + 0.5)), float(cells.lon_deg(column + 0.5))
        assert len(seen.showing(lat, lon)) == expected[row, column]


def test_memory_is_bounded_and_what_was_seen_longest_ago_goes_first(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tally, "MOST_TILES", 6)
    monkeypatch.setattr(pictures, "MOST_PICTURES", 5)
    seen = SeenGround(2.0)
    for k in range(30):
        seen.add(level_set(k, east_m=150.0 * k, at_s=100.0 * k))
    assert len(seen._tiles) <= 6 and seen.dropped_tiles > 10
    assert len(seen._pictures) == 5
    assert seen.cell(*MIDDLE) is None and seen.showing(*MIDDLE) == []
    last = seen.showing(seen_lat(29), seen_lon(29))
    assert [shown.frame for shown in last] == [29]
    assert not seen.add(level_set(3, east_m=450.0, at_s=300.0, revision=5))  # dropped, and not counted again
    assert seen.pictures == 30


def seen_lat(k: int) -> float:
    return float(PLACE.to_geodetic((150.0 * k, 0.0, 0.0))[0])


def seen_lon(k: int) -> float:
    return float(PLACE.to_geodetic((150.0 * k, 0.0, 0.0))[1])


def test_runs_that_are_dropped_make_room_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pictures, "MOST_PICTURES", 20)
    held = pictures.Pictures()
    found = picture_cells(level_set(), Cells.about(*MIDDLE, 2.0))
    for k in range(2000):
        held.add(("uav", 1, k), k, found)
    assert len(held._runs) < 10 * 20 * np.ptp(found.row)
    assert [shown.frame for shown in held.showing(int(found.row[0]), int(found.column[0]), 100)] == list(
        range(1980, 2000)
    )


def test_pictures_of_several_aircraft_and_sessions_are_distinguished() -> None:
    seen = SeenGround(2.0)
    for vehicle, session in (("a", 1), ("b", 1), ("a", 2)):
        seen.add(level_set(7, vehicle=vehicle, session=session))
    cell = seen.cell(*MIDDLE)
    assert cell["count"] == 3
    assert {(s.vehicle, s.session) for s in seen.showing(*MIDDLE)} == {("a", 1), ("b", 1), ("a", 2)}


@pytest.mark.parametrize(
    ("wanted", "cell"), [(2.5, 2.0), (1.0, 1.0), (4.99, 2.0), (5.0, 5.0), (0.73, 0.5), (123.0, 100.0), (0.01, 0.05)]
)
def test_a_cell_is_one_two_or_five(wanted: float, cell: float) -> None:
    assert round_cell_m(wanted) == pytest.approx(cell)


def test_cells_hold_the_places_that_they_are_of_also_beyond_the_date_line() -> None:
    cells = Cells.about(-16.8, 179.9999, 5.0)
    lat, lon, _ = dataclasses.replace(PLACE, lat_deg=-16.8, lon_deg=179.9999).to_geodetic(
        np.array([[12.0, 3.0, 0.0], [31.0, -8.0, 0.0]])
    ).T  # fmt: skip
    rows, columns = cells.at(lat, lon)
    west: NDArray[np.float64] = cells.lon_deg(columns)
    assert np.all((lon - west) % 360.0 < cells.step_lon_deg)
    assert abs(int(columns[1] - columns[0])) in (3, 4)
    assert cells.area_m2(rows) == pytest.approx([25.0, 25.0], rel=1e-4)


@pytest.mark.parametrize(("lat", "cell"), [(0.0, 0.001), (0.0, 1e9), (89.9, 5.0), (0.0, float("nan"))])
def test_cells_that_cannot_be_are_refused(lat: float, cell: float) -> None:
    with pytest.raises(InputError):
        Cells.about(lat, 0.0, cell)


def test_a_gap_beyond_the_date_line_is_where_other_programs_look() -> None:
    cells = Cells.about(-16.8, 179.9999, 5.0)
    mask = np.ones((4, 4), bool)
    row, column = (int(index) for index in cells.at(-16.8, -179.999))
    (gap,) = gaps(cells, row, column, mask)
    assert gap.lon_deg == pytest.approx(-179.999, abs=3e-4)


def test_it_needs_nothing_but_numpy() -> None:
    imported = {
        line.split()[1].split(".")[0]
        for file in Path(tally.__file__).parent.glob("*.py")
        for line in file.read_text().splitlines()
        if line.startswith(("import ", "from "))
    }
    assert imported - sys.stdlib_module_names <= {"contract", "ground", "numpy"}
