"""Who would have been found: what looks, passes, aircraft, distance and trees make of it; and what was not searched."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from contract.feature_set import FeatureSet
from contract.spot import PERSON_GRID, SpotReport
from ground.seen.area import Woods
from ground.seen.coverage import Coverage, coverage
from ground.seen.detection import Detection, detection, final_probability, searched_for, sector_detection
from ground.seen.picture_cells import pixel_of
from ground.seen.tally import SeenGround
from tests.ground.seen.levels import CAMERA, PLACE, level_set

RING_M = np.array([(-15.0, -15.0), (15.0, -15.0), (15.0, 15.0), (-15.0, 15.0)])  # in every picture below


def report_of(s: FeatureSet, share: float | None, late_ns: int = 0) -> SpotReport:
    named = () if share is None else (share,) * int(np.prod(PERSON_GRID))
    return SpotReport(
        s.session, s.frame, s.capture_unix_ns + late_ns, True, vehicle=s.vehicle, person_found=share, person_named=named
    )


def ring(east_m: float = 0.0) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    corners = PLACE.to_geodetic(np.column_stack([RING_M + (east_m, 0.0), np.zeros(4)]))
    return np.asarray(corners[:, [1, 0]])


def searched(
    sets: Sequence[FeatureSet], reports: Sequence[SpotReport], **options: object
) -> tuple[Coverage, Detection]:
    seen = SeenGround(5.0)
    for s in sets:
        seen.add(s)
    shown = coverage(seen)
    assert shown is not None
    return shown, detection(seen.looks(), shown, reports, **options)


def machine(shares: Sequence[float | None], at_s: Sequence[float] | None = None) -> list[float] | None:
    """Stated, lowest, highest at PLACE after looks by which these shares of people there have been named."""
    sets = [level_set(k, at_s=None if at_s is None else at_s[k]) for k in range(len(shares))]
    shown, by = searched(sets, [report_of(s, share) for s, share in zip(sets, shares, strict=True)])
    if by.machine is None:
        return None
    row, column = shown.cells.at(PLACE.lat_deg, PLACE.lon_deg)
    return [float(p) for p in by.machine[:, int(row) - shown.row0, int(column) - shown.column0]]


@pytest.mark.parametrize(
    ("shares", "stated"),
    [
        ([0.0, 0.0, 0.9], 0.9), ([0.5] * 20, 0.5),
        ([0.4, 0.6, 0.2], 0.2),  # the part that it was last in: of the people in it all looks are known
        ([0.4, 0.6, None], 0.6), ([None, None], None),
    ],
)  # fmt: skip
def test_what_a_pass_states_is_who_was_named_when_it_last_saw_the_place(
    shares: list[float | None], stated: float | None
) -> None:
    assert machine(shares) == (None if stated is None else pytest.approx([stated] * 3))


@pytest.mark.parametrize("tilt_deg", [0.0, 30.0])
def test_the_share_is_that_of_the_part_of_the_picture_that_shows_the_place(tilt_deg: float) -> None:
    """Against the pixels that the sets themselves have for places."""
    rows, columns = PERSON_GRID
    sets = [level_set(k, tilt_deg=tilt_deg, north_m=-120.0 * np.tan(np.radians(tilt_deg))) for k in range(3)]
    parts = tuple(k / 20.0 if k else None for k in range(rows * columns))
    shown, by = searched(sets, [replace(report_of(s, 1.0), person_named=parts) for s in sets])
    assert by.machine is not None
    count = 0
    for east in np.linspace(-40.0, 40.0, 9):
        for north in np.linspace(-30.0, 30.0, 7):
            lat, lon, _ = (float(x) for x in PLACE.to_geodetic((east, north, 0.0)))
            row, column = (int(n) for n in shown.cells.at(lat, lon))
            middle = shown.cells.lat_deg(row + 0.5), shown.cells.lon_deg(column + 0.5)
            uv = pixel_of(sets[0], float(middle[0]), float(middle[1]))
            stated = by.machine[0, row - shown.row0, column - shown.column0]
            if uv is None or not shown.seen[row - shown.row0, column - shown.column0]:
                continue
            part = int((uv[1] + 0.5) / CAMERA.height_px * rows) * columns
            part += int((uv[0] + 0.5) / CAMERA.width_px * columns)
            assert stated == pytest.approx(part / 20.0)
            count += 1
    assert count > 40


def test_passes_raise_what_may_be_and_of_what_is_stated_the_best_counts() -> None:
    passes = machine([0.0, 0.9, 0.0, 0.8], [0.0, 1.0, 300.0, 301.0])
    assert passes == pytest.approx([0.9, 0.9, 1.0 - 0.1 * 0.2])


def test_another_aircraft_is_another_pass_and_a_second_camera_has_no_sets() -> None:
    sets = [level_set(k, vehicle=f"uav-{k}") for k in range(2)]
    _, by = searched(sets, [report_of(s, 0.5) for s in sets])
    assert by.machine.max(axis=(1, 2)) == pytest.approx([0.5, 0.5, 0.75])
    same = [level_set(k) for k in range(3)]
    _, by = searched(same, [report_of(s, 1.0, late_ns=5) for s in same])
    assert by.machine is None and (by.searched, by.strangers) == (0, 3)


def test_half_of_observers_detect_a_person_of_one_line_pair_and_time_is_given_by_their_looks() -> None:
    stated, low, high = final_probability(np.array([0.05, 0.25, 0.4, 2.0]))
    assert stated[1] == pytest.approx(0.5) and high[1] > 0.6 and low[1] < 0.4
    assert np.all(np.diff(stated) < 0.0) and stated[0] > 0.999 and stated[-1] < 1e-2
    assert final_probability(0.25 / 1.25)[1] == pytest.approx(0.5)
    assert searched_for(stated, stated * 1e6) == pytest.approx(stated)
    assert searched_for(np.ones(1), np.array([3.4])) == pytest.approx(1.0 - np.exp(-1.0))


def test_an_operator_needs_time_and_trees_hide_from_both() -> None:
    sets = [level_set(k) for k in range(3)]
    reports = [report_of(s, 1.0) for s in sets]

    def sector(**options: object) -> tuple[float, float]:
        shown, by = searched(sets, reports, **options)
        found = sector_detection("4", [[ring()]], shown, by, 0.5)
        assert found.area_m2 == pytest.approx(900.0, rel=0.1)
        return found.machine[0], found.operator[0]

    hasty, thorough = sector(look_s=0.2), sector(look_s=60.0)
    assert hasty[0] == thorough[0] == 1.0 and hasty[1] < 0.2 and thorough[1] > 0.9
    below_trees = sector(look_s=60.0, woods=[Woods([[ring()]], 0.75), Woods([[ring()]], 0.5)])
    assert below_trees == pytest.approx((0.25, 0.25 * thorough[1]))


def test_what_was_not_seen_counts_in_a_sector_as_not_found() -> None:
    sets = [level_set(k) for k in range(3)]
    seen = SeenGround(1.0)
    for s in sets:
        seen.add(s)
    next_to = ring(1000.0)
    shown = coverage(seen, [[ring()], [next_to]])
    assert shown is not None
    by = detection(seen.looks(), shown, [report_of(s, 1.0) for s in sets])
    whole, half, none = (
        sector_detection("", rings, shown, by, 0.5) for rings in ([[ring()]], [[ring()], [next_to]], [[next_to]])
    )
    assert [s.machine and s.machine[0] for s in (whole, half, none)] == pytest.approx([1.0, 0.5, 0.0], abs=0.02)
    assert [s.below_m2["machine"] for s in (whole, half, none)] == pytest.approx([0.0, 900.0, 900.0], rel=0.05, abs=30)
