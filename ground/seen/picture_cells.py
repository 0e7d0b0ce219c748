"""The cells of the ground that one picture has surely seen, by its set alone. docs/mathematics-seen.md.

On a lattice of pixels the set answers where the ground is and with which error. A cell's pixel follows from the camera
and the height that these answers give there; the error, mapped into the picture, determines how far inside of it the
cell must be to have been in view with 90 % certainty.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.feature_set import FeatureSet
from contract.locate import Answers, Locator, pixels_of
from ground.seen.cells import Cells

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

LATTICE = (17, 13)  # pixels that are asked, along u and v
KNOTS = 25  # places along each side of a picture's ground; between them height and errors are interpolated
CERTAINTY = 0.9  # that a cell was in view
HEIGHT_STEPS = 3  # of a place's height by the pixel that shows it: each divides the error by the ground's steepness
SETTLED = 0.5  # of a cell, by which the last step may still have moved the ground that is in the picture
MOST_CELLS = 1_000_000  # of one picture


@dataclass(frozen=True, eq=False)
class PictureView:
    """A camera over the level ground of its set's plane: where in the picture a cell is, without the relief."""

    camera: Camera
    first: tuple[int, int]  # the row and the column that are counted from
    to_ray: Array  # (3, 3): of a cell's (column, row, 1), the way to its middle in the camera's axes

    def places(self, row: Index, column: Index) -> Array:
        """Places (N, 2) of cells in the picture, in shares of its width and its height, kept within it."""
        ways = np.column_stack([column - self.first[1], row - self.first[0], np.ones(len(row))]) @ self.to_ray.T
        xy = ways[:, :2] / np.maximum(ways[:, 2:], 1e-9)
        # Beyond where the lens is known only relief can have put a cell: it is at the picture's edge.
        xy *= np.minimum(1.0, self.camera.max_radius / np.maximum(np.hypot(*xy.T), 1e-9))[:, None]
        share = (self.camera.pixels(xy) + 0.5) / (self.camera.width_px, self.camera.height_px)
        return np.asarray(np.clip(share, 0.0, np.nextafter(1.0, 0.0)), np.float64)


@dataclass(frozen=True, eq=False)
class PictureCells:
    """Cells (N,) in the order of rows and columns, each with its ground sample distance in metres.

    `view` is what they were seen with; None only of no cells.
    """

    row: Index
    column: Index
    gsd_m: Array
    view: PictureView | None = None

    def __len__(self) -> int:
        return len(self.row)


NO_CELLS = PictureCells(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0))


class TooManyCells(Exception):
    """A picture covers more cells than are counted; the cells must be larger."""


def picture_cells(s: FeatureSet, cells: Cells) -> PictureCells:
    """Find the cells that a picture has seen. Raises TooManyCells."""
    if not s.is_ok:
        return NO_CELLS
    locator = Locator(s)
    answers = locator.answers(_lattice(s))
    plane = GroundPlane.of(s)
    if plane is None or not np.any(answers.is_answered):
        return NO_CELLS
    rows, columns = _box(locator, answers, cells)
    down, across = _knots(rows), _knots(columns)
    lat, lon = np.meshgrid(cells.lat_deg(down + 0.5), cells.lon_deg(across + 0.5), indexing="ij")
    east_north = locator.frame.to_enu(lat.ravel(), lon.ravel(), _height_m(locator, answers))[:, :2]
    at_knots = _ground(s, plane, answers, east_north, cells.cell_m).reshape(-1, len(down), len(across))
    fine = (_tent(rows, down) @ at_knots @ _tent(columns, across).T).reshape(len(at_knots), -1)
    uv, usable = pixels_of(s, fine[:3].T)
    seen = np.flatnonzero(usable & (fine[8] < 1e-9) & _is_seen(uv, s, fine[3:7]))
    row, column = np.divmod(seen, len(columns))
    return PictureCells(rows[row], columns[column], fine[7, seen], _view(locator, plane, cells, rows, columns))


def _view(locator: Locator, plane: GroundPlane, cells: Cells, rows: Index, columns: Index) -> PictureView:
    """The view of a picture over its box of rows and columns, in which places on the ground are linear."""
    s, n = locator.feature_set, max(len(rows), len(columns))
    row, column = int(rows[0]) + np.array([0, 0, n]), int(columns[0]) + np.array([0, n, 0])
    at = cells.lat_deg(row + 0.5), cells.lon_deg(column + 0.5)
    corners = plane.raised(
        locator.frame.to_enu(*at, locator.frame.height_m - 1.0 / plane.steepness)[:, :2], np.zeros(3)
    )
    ways = corners @ np.asarray(s.R_enu_cam, float)
    to_ray = np.column_stack([(ways[1] - ways[0]) / n, (ways[2] - ways[0]) / n, ways[0]])
    return PictureView(_kept(s.camera), (int(rows[0]), int(columns[0])), to_ray)


@lru_cache(maxsize=64)
def _kept(camera: Camera) -> Camera:
    """The first camera that equals this one: each set comes with its own, and views are kept by the ten thousand."""
    return camera


def pixel_of(s: FeatureSet, lat_deg: float, lon_deg: float) -> tuple[float, float] | None:
    """The pixel of a set's picture that shows a place on the ground, at the height that the set has there.

    None where it is not in the picture.
    """
    plane = GroundPlane.of(s) if s.is_ok else None
    if plane is None:
        return None
    locator = Locator(s)
    east_north = locator.frame.to_enu(lat_deg, lon_deg, locator.frame.height_m - 1.0 / plane.steepness)[None, :2]
    up = np.zeros(1)
    for _ in range(HEIGHT_STEPS + 1):
        uv, usable = pixels_of(s, plane.raised(east_north, up))
        if not (usable[0] and s.camera.contains(uv[0])):
            return None
        rise = plane.rise(locator.answers(uv).offset_enu_m)
        up = np.where(np.isfinite(rise), rise, up)
    return float(uv[0, 0]), float(uv[0, 1])


@dataclass(frozen=True, eq=False)
class GroundPlane:
    """A set's ground plane: the places X (m from the camera, ENU) with normal . X = 1."""

    normal: Array

    @classmethod
    def of(cls, s: FeatureSet) -> GroundPlane | None:
        """None of a plane that stands upright or is nowhere."""
        normal = np.asarray(s.R_enu_cam, float) @ s.plane_per_m[[1, 2, 0]]
        return None if abs(normal[2]) <= 1e-6 * float(np.linalg.norm(normal)) else cls(normal)

    @property
    def steepness(self) -> float:
        """1 over the camera's height above the plane, straight down, 1/m."""
        return float(abs(self.normal[2]))

    def raised(self, east_north_m: Array, rise_m: Array) -> Array:
        """Places (N, 3) so high above the plane."""
        return np.column_stack([east_north_m, (1.0 - east_north_m @ self.normal[:2]) / self.normal[2] + rise_m])

    def rise(self, offset_enu_m: Array) -> Array:
        """Heights (N,) of places (N, 3) above the plane."""
        out: Array = offset_enu_m[:, 2] - (1.0 - offset_enu_m[:, :2] @ self.normal[:2]) / self.normal[2]
        return out


def _ground(s: FeatureSet, plane: GroundPlane, answers: Answers, east_north_m: Array, cell_m: float) -> Array:
    """Return nine rows (9, N) for places (N, 2): east, north, up of the ground; a cell's sizes in the picture (4);
    ground sample distance; and 1 where none of this is known, as the set does not answer or no height settles (a hill
    is before the place).
    """
    fields = np.stack([plane.rise(answers.offset_enu_m), *_sizes_px(answers, cell_m), _gsd(answers)])
    fields = fields.reshape(-1, LATTICE[1], LATTICE[0])
    up = np.zeros(len(east_north_m))
    for _ in range(HEIGHT_STEPS):
        before = up
        uv, usable = pixels_of(s, plane.raised(east_north_m, before))
        values = _between(fields, uv, s)
        up = np.where(np.isfinite(values[0]), values[0], 0.0)
    with np.errstate(invalid="ignore"):  # no comparison with nan holds
        is_settled = (np.abs(values[0] - before) <= SETTLED * cell_m) | ~s.camera.contains(uv)
    is_known = usable & is_settled & np.all(np.isfinite(values), axis=0)
    values = np.where(is_known, values, 0.0)
    return np.concatenate([plane.raised(east_north_m, values[0]).T, values[1:], ~is_known[None]])


def _box(locator: Locator, answers: Answers, cells: Cells) -> tuple[Index, Index]:
    """The rows and the columns about the ground that a picture answers for."""
    lat, lon, _ = locator.frame.to_geodetic(answers.offset_enu_m[answers.is_answered]).T
    rows, columns = cells.at(lat, lon)
    size = (int(np.ptp(rows)) + 1) * (int(np.ptp(columns)) + 1)
    if size > MOST_CELLS:
        raise TooManyCells(
            f"a picture reaches over {size} cells of {cells.cell_m:g} m; at most {MOST_CELLS} are counted"
        )
    return np.arange(rows.min(), rows.max() + 1), np.arange(columns.min(), columns.max() + 1)


def _height_m(locator: Locator, answers: Answers) -> float:
    """The ground's rough height in the locator's axes: what a place east and north of the camera needs."""
    return locator.frame.height_m + float(np.median(answers.offset_enu_m[answers.is_answered, 2]))


def _knots(index: Index) -> Array:
    """The rows or columns at which the ground is looked up: at most KNOTS places, both ends among them."""
    return np.linspace(index[0], index[-1], min(len(index), KNOTS))


def _tent(index: Index, knots: Array) -> Array:
    """Weights (N, K) of linear interpolation from knots, evenly apart, to rows or columns."""
    apart = float(knots[1] - knots[0]) if len(knots) > 1 else 1.0
    return np.maximum(1.0 - np.abs(index[:, None] - knots) / apart, 0.0)


def _lattice(s: FeatureSet) -> Array:
    """Pixels (M, 2) from border to border of the picture, row by row."""
    u = np.linspace(-0.5, s.camera.width_px - 0.5, LATTICE[0])
    v = np.linspace(-0.5, s.camera.height_px - 0.5, LATTICE[1])
    return np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)


def _sizes_px(answers: Answers, cell_m: float) -> Array:
    """Sizes (4, M) of a cell at each pixel asked: one sigma of its place in u and in v, half its extent in u and in v.
    (23.1)
    """
    to_px = _inverse(answers.by_pixel_m[:, :2])
    covariance = to_px @ answers.covariance_enu_m2[:, :2, :2] @ to_px.transpose(0, 2, 1)
    sigma = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 0.0))
    half = 0.5 * cell_m * np.abs(to_px).sum(axis=2)
    return np.concatenate([sigma, half], axis=1).T


def _is_seen(uv_px: Array, s: FeatureSet, sizes_px: Array) -> Mask:
    """Mask (N,) of the cells, their middles at pixels (N, 2), that are in the picture as a whole by the pose as it is
    stated, and with their middles with CERTAINTY by the pose as it may be. (23.2), (23.3)
    """
    is_whole, certainty = np.ones(len(uv_px), bool), np.ones(len(uv_px))
    for k, size in enumerate((s.camera.width_px, s.camera.height_px)):
        sigma, half = np.maximum(sizes_px[k], 1e-6), sizes_px[2 + k]
        low, high = uv_px[:, k] + 0.5, size - 0.5 - uv_px[:, k]
        is_whole &= np.minimum(low, high) >= half
        certainty *= np.maximum(_normal(low / sigma) + _normal(high / sigma) - 1.0, 0.0)
    return is_whole & (certainty >= CERTAINTY)


def _normal(x: Array) -> Array:
    """The normal distribution function, to 1e-7. Abramowitz and Stegun 26.2.17."""
    t = 1.0 / (1.0 + 0.2316419 * np.abs(x))
    tail = t * (0.319381530 + t * (-0.356563782 + t * (1.781477937 + t * (-1.821255978 + t * 1.330274429))))
    tail = tail * np.exp(-0.5 * x * x) / np.sqrt(2.0 * np.pi)
    out: Array = np.where(x >= 0.0, 1.0 - tail, tail)
    return out


def _gsd(answers: Answers) -> Array:
    """Metres on the ground from pixel to pixel, in the direction in which they are farthest apart. (23.4)"""
    J = answers.by_pixel_m[:, :2]
    a, b, c = (J[:, 0] ** 2).sum(axis=1), (J[:, 0] * J[:, 1]).sum(axis=1), (J[:, 1] ** 2).sum(axis=1)
    return np.asarray(np.sqrt(0.5 * (a + c) + np.sqrt(0.25 * (a - c) ** 2 + b**2)), np.float64)


def _inverse(matrix: Array) -> Array:
    """The inverse of each of (M, 2, 2); nan where there is none."""
    (a, b), (c, d) = matrix[:, 0].T, matrix[:, 1].T
    det = a * d - b * c
    flat = np.stack([d, -b, -c, a], axis=-1) / np.where(np.abs(det) > 1e-12, det, np.nan)[:, None]
    return flat.reshape(-1, 2, 2)


def _between(fields: Array, uv_px: Array, s: FeatureSet) -> Array:
    """Values (K, N) at pixels (N, 2) of fields (K, V, U) on the lattice, bilinear; outside, those of its border."""
    size = np.array([s.camera.width_px, s.camera.height_px])
    at = np.clip((uv_px + 0.5) / size, 0.0, 1.0) * (np.array(LATTICE) - 1)
    first = np.minimum(at.astype(np.int64), np.array(LATTICE) - 2)
    (u, v), (du, dv) = first.T, (at - first).T
    low = fields[:, v, u] * (1.0 - du) + fields[:, v, u + 1] * du
    high = fields[:, v + 1, u] * (1.0 - du) + fields[:, v + 1, u + 1] * du
    out: Array = low * (1.0 - dv) + high * dv
    return out
