"""Gaps as something to fly: rows over them, how far apart and how high. docs/mathematics-seen.md, (23.13) and on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.errors import InputError
from contract.geodesy import LocalFrame
from contract.lens import FISHEYE
from ground.seen.coverage import Coverage, Gap
from ground.seen.detection import final_probability, searched_for
from ground.seen.outline import cells_inside
from ground.seen.searched import Searched

Array = NDArray[np.float64]

MOST_POINTS = 700  # that common autopilots hold
FINEST_M, COARSEST_M = 0.001, 10.0  # ground sample distances among which the wanted one is looked for
SPEED_M_S = 10.0  # over the ground
OVERLAP, MOST_OVERLAP = 0.3, 0.9  # of neighbouring rows


@dataclass(frozen=True, eq=False)
class FlightRows:
    """Points to fly (N, 2), latitude and longitude, two for each row, straight down; heights above the ground.

    `left_out` gaps have no rows, as there would be too many points; the largest have.
    """

    points_deg: Array
    height_m: float
    apart_m: float
    left_out: int

    def to_text(self) -> str:
        """A line for people."""
        rows = len(self.points_deg) // 2
        more = f"; {self.left_out} smaller gaps are left out" if self.left_out else ""
        where = f"{self.apart_m:.0f} m apart, {self.height_m:.0f} m above the ground, at {SPEED_M_S:g} m/s"
        return f"to fly: {rows} rows, {where}{more}"


@dataclass(frozen=True)
class Strip:
    """The ground that a camera shows straight down, for each metre of height: half of it `across` the way and `along`
    it, and by how much its edge is `coarser` than f metres a pixel. (23.16)

    Of a fisheye the 45 degrees at most about its axis: farther out the ground grows coarser faster than wider.
    """

    across: float
    along: float
    coarser: float = 1.0

    @classmethod
    def of(cls, camera: Camera) -> Strip:
        """Return a camera's."""
        if camera.model != FISHEYE:
            return cls(0.5 * camera.width_px / camera.fx_px, 0.5 * camera.height_px / camera.fy_px)
        left, top = (-0.5, camera.cy_px), (camera.cx_px, -0.5)
        right, bottom = (camera.width_px - 0.5, camera.cy_px), (camera.cx_px, camera.height_px - 0.5)
        rays, has_ray = camera.unproject((left, right, top, bottom))
        reach = np.where(has_ray, np.minimum(np.hypot(rays[:, 0], rays[:, 1]), 1.0), 1.0)
        across, along = float(reach[:2].min()), float(reach[2:].min())
        _, by_radius, _ = camera.lens.linearised(np.array([[across], [0.0]]))
        return cls(across, along, 1.0 / float(by_radius[0, 0]))

    def height_m(self, camera: Camera, gsd_m: float) -> float:
        """The height from which all of it is as fine as that."""
        return camera.fx_px * gsd_m / self.coarser


def operator_gsd_m(wanted: float, camera: Camera, look_s: float | None) -> float:
    """The coarsest ground sample distance at which an operator reaches a probability, in one look of `look_s`, or while
    a place is in the picture at SPEED_M_S. (23.13)

    Raises InputError for a probability that is not reached.
    """
    gsd_m = np.geomspace(FINEST_M, COARSEST_M, 2000)
    strip = Strip.of(camera)
    passing = 2.0 * strip.along * strip.height_m(camera, 1.0) * gsd_m / SPEED_M_S
    seconds = passing if look_s is None else np.full(len(gsd_m), look_s)
    final = final_probability(gsd_m)[0]
    reaches = searched_for(final, final * seconds) >= wanted
    if not reaches.any():
        raise InputError(f"an operator does not reach {wanted:g} at any height in that time: choose a longer --look")
    return float(gsd_m[reaches].max())


def machine_gsd_m(wanted: float, searched: Sequence[tuple[float, float]]) -> float:
    """The coarsest ground sample distance up to which most pictures (each with its share) find enough. (23.14)

    Raises InputError where none did.
    """
    pictures = np.array(sorted(searched)).reshape(-1, 2)
    is_enough = pictures[:, 1] >= wanted
    most = np.cumsum(is_enough) * 2 > np.arange(1, len(pictures) + 1)
    if not (most & is_enough).any():
        raise InputError(
            f"in most pictures less than {wanted:.0%} of people would stand out, at every height: choose --height"
        )
    return float(pictures[most & is_enough, 0].max())


def rows_over(
    searched: Searched,
    over: Coverage,
    camera: Camera,
    height_m: float | None = None,
    overlap: float = OVERLAP,
    look_s: float | None = None,
) -> FlightRows:
    """Rows over the gaps of what was searched; without a height from as high as its `below` and `who` need.

    `look_s`: an operator's time for a place, else while it is in view. Raises InputError, as the functions below.
    """
    if height_m is None:
        by_machine = searched.who == "machine"
        gsd_m = (
            machine_gsd_m(searched.below, searched.detection.shares)
            if by_machine
            else operator_gsd_m(searched.below, camera, look_s)
        )
        height_m = Strip.of(camera).height_m(camera, gsd_m)
    return flight_rows(searched.gaps, over, camera, height_m, overlap)


def flight_rows(gaps: Sequence[Gap], over: Coverage, camera: Camera, height_m: float, overlap: float) -> FlightRows:
    """Rows over gaps for a camera that looks straight down, its picture's width across the way. (23.15)

    The rows of a gap follow its longer axis; next comes the gap with the nearest end. Raises InputError without a gap.
    """
    if not gaps:
        raise InputError("there is no gap to fly over")
    strip = Strip.of(camera)
    wide_m, beyond_m = 2.0 * strip.across * height_m, strip.along * height_m
    frame = LocalFrame(gaps[0].lat_deg, gaps[0].lon_deg, 0.0)
    each, count = list[Array](), 0
    for gap in gaps:
        rows = _rows(_places(gap, over, frame), wide_m * (1.0 - overlap), wide_m, beyond_m, over.cells.cell_m)
        if count + len(rows) > MOST_POINTS:
            break
        each.append(rows)
        count += len(rows)
    if not each:
        raise InputError(f"the largest gap alone takes more than {MOST_POINTS} points: fly higher, or a part of it")
    way = _joined(each)
    points = frame.to_geodetic(np.column_stack([way, np.zeros(len(way))]))[:, :2]
    return FlightRows(np.asarray(points), height_m, wide_m * (1.0 - overlap), len(gaps) - len(each))


def _places(gap: Gap, over: Coverage, frame: LocalFrame) -> Array:
    """East and north (N, 2) of the middles of a gap's cells."""
    corner = gap.patch.outer.min(axis=0)
    columns, rows = (int(n) for n in gap.patch.outer.max(axis=0) - corner)
    row, column = np.nonzero(
        cells_inside([ring - corner for ring in (gap.patch.outer, *gap.patch.holes)], rows, columns)
    )
    lon_lat = over.lon_lat(np.column_stack([column, row]) + 0.5 + corner)
    return frame.to_enu(lon_lat[:, 1], lon_lat[:, 0], np.zeros(len(row)))[:, :2]


def _rows(places: Array, apart_m: float, wide_m: float, beyond_m: float, cell_m: float) -> Array:
    """Points (2 R, 2) of rows to and fro along the longer axis of places, with so much more at both ends."""
    middle = places.mean(axis=0)
    _, axes = np.linalg.eigh(np.cov((places - middle).T) if len(places) > 1 else np.eye(2))
    along, across = (places - middle) @ axes[:, 1], (places - middle) @ axes[:, 0]
    low, high = across.min() - 0.5 * cell_m, across.max() + 0.5 * cell_m
    # The outer rows' pictures end where the gap does.
    count = max(int(np.ceil((high - low - wide_m) / apart_m)) + 1, 1)
    span = max(high - low - wide_m, 0.0)
    at = 0.5 * (low + high) + (np.linspace(-0.5, 0.5, count) * span if count > 1 else np.zeros(1))
    out = list[Array]()
    for k, offset in enumerate(at):
        below = along[np.abs(across - offset) <= 0.5 * wide_m + cell_m]
        if len(below):
            ends = np.array([below.min() - beyond_m, below.max() + beyond_m])
            out += [middle + end * axes[:, 1] + offset * axes[:, 0] for end in (ends if k % 2 == 0 else ends[::-1])]
    return np.array(out)


def _joined(each: list[Array]) -> Array:
    """One way over all rows: from the first on to the gap whose first or last end is nearest."""
    way, left = [each[0]], each[1:]
    while left:
        ends = np.array([[np.hypot(*(rows[end] - way[-1][-1])) for end in (0, -1)] for rows in left])
        k, end = np.unravel_index(int(np.argmin(ends)), ends.shape)
        rows = left.pop(int(k))
        way.append(rows if end == 0 else rows[::-1])
    return np.concatenate(way)
