"""A surface with edges as a raster of heights: houses with flat and with pitched roofs, trees. Periodic.

The truth at a pixel is the first surface that its ray meets (`Terrain.cast`). Between the raster's points heights are
interpolated, so a wall rises within one cell and a ray always meets it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from contract.errors import InputError

Array = NDArray[np.float64]
Image = NDArray[np.float32]

CELL_M = 0.25
SIZE = 1024  # cells: the surface repeats after 256 m
ROW = 8192  # places that are looked up at once: cv2.remap takes pictures of up to 32767
KINDS = ("town", "forest")
TREES = {"town": 0.35, "forest": 1.0}  # share of what stands there
FULL = {"town": 0.6, "forest": 0.75}  # share of the plots on which anything stands
LEAF_M = 0.35  # one sigma of a crown's surface about its shape
REPEATS = 4  # of the surface in one view
STEP_CELLS = 2.0  # of a ray: what it passes over is only a corner that it barely touches
HALVINGS = 9  # of such a step
RELIEF_M = 40.0  # one sigma of the filter that makes hills


@dataclass(frozen=True, eq=False)
class Raster:
    """Rasters (SIZE + 1, SIZE + 1) of the hills and of what stands on them (m), and how bright its paint is (1: as
    the ground).
    """

    hills_m: Image
    lift_m: Image
    paint: Image

    @cached_property
    def surface_m(self) -> Image:
        """Hills and what stands on them."""
        return np.asarray(self.hills_m + self.lift_m, np.float32)

    @cached_property
    def _wide(self) -> Image:
        """The surface, repeated: places of one view lie within it without a look at where it begins again."""
        return np.tile(self.surface_m[:SIZE, :SIZE], (REPEATS, REPEATS))

    def first_crossing(self, near_m: Array, far_m: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return where ways from points above the surface (N, 3) to points below first meet it, as a share (N,), and
        whether they do. Heights are above level ground, which over such a way is straight.
        """
        corner = np.floor(np.minimum(near_m[:, :2].min(axis=0), far_m[:, :2].min(axis=0)) / (SIZE * CELL_M))
        count, way = len(near_m), far_m - near_m
        at, along = (np.zeros((3, -(-count // ROW), ROW), np.float32) for _ in range(2))
        scale = np.array([CELL_M, CELL_M, 1.0])
        at.reshape(3, -1)[:, :count] = ((near_m - np.array([*corner * SIZE * CELL_M, 0.0])) / scale).T
        along.reshape(3, -1)[:, :count] = (way / scale).T
        if max(float(at[:2].max()), float((at[:2] + along[:2]).max())) > SIZE * REPEATS - 2:
            raise InputError(f"a view of a raster world spans more than {SIZE * CELL_M * (REPEATS - 1):g} m")
        steps = max(int(np.ceil(np.hypot(along[0], along[1]).max() / STEP_CELLS)), 1)
        low, high = np.zeros_like(at[0]), np.ones_like(at[0])
        is_open = np.ones(at[0].shape, bool)
        for k in range(1, steps + 1):
            share = np.float32(k / steps)
            below = self._is_below(at, along, share)
            np.copyto(high, share, where=is_open & below)
            np.copyto(low, np.float32((k - 1) / steps), where=is_open & below)
            is_open &= ~below
            if not is_open.any():
                break
        for _ in range(HALVINGS):
            middle = np.float32(0.5) * (low + high)
            below = self._is_below(at, along, middle)
            np.copyto(high, middle, where=below)
            np.copyto(low, middle, where=~below)
        shares = (np.float32(0.5) * (low + high)).ravel()[:count]
        return np.asarray(shares, np.float64), ~is_open.ravel()[:count]

    def _is_below(self, at: Image, along: Image, share: Image | np.float32) -> NDArray[np.bool_]:
        x, y, z = (at[i] + along[i] * share for i in range(3))
        return np.asarray(z <= cv2.remap(self._wide, x, y, cv2.INTER_LINEAR), bool)

    @classmethod
    def draw(cls, kind: str, relief_m: float, top_m: float, plot_m: float, seed: int) -> Raster:
        """One of KINDS: nothing that stands is higher than `top_m`, one to a square plot of `plot_m`."""
        return _made(kind, relief_m, top_m, plot_m, seed)


def look_up(raster: Image, x_m: Array, y_m: Array) -> Array:
    """The values of a raster at places of one shape, east and north, m."""
    count = x_m.size
    at = np.zeros((2, -(-count // ROW) * ROW), np.float32)
    at[0, :count], at[1, :count] = ((np.ravel(c) / CELL_M) % SIZE for c in (x_m, y_m))
    columns, rows = at.reshape(2, -1, ROW)
    found = cv2.remap(raster, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(found.ravel()[:count], np.float64).reshape(x_m.shape)


@lru_cache(maxsize=2)
def _made(kind: str, relief_m: float, top_m: float, plot_m: float, seed: int) -> Raster:
    rng = np.random.default_rng([seed, 404])
    hills = _periodic_noise(rng, RELIEF_M / CELL_M)
    hills *= np.float32(0.5 * relief_m / float(np.abs(hills).max()))
    leaves = np.float32(LEAF_M) * _periodic_noise(rng, 0.6 / CELL_M)
    lift, paint = np.zeros((SIZE, SIZE), np.float32), np.ones((SIZE, SIZE), np.float32)
    plots = max(int(SIZE * CELL_M / plot_m), 1)
    plot = SIZE / plots
    for row in range(plots):
        for column in range(plots):
            if rng.uniform() > FULL[kind]:
                continue
            centre = (np.array([row, column]) + rng.uniform(0.4, 0.6, 2)) * plot
            if rng.uniform() < TREES[kind]:
                _plant(lift, paint, rng, centre, plot, top_m, leaves)
            else:
                _build(lift, paint, rng, centre, plot, top_m)
    return Raster(*(np.pad(each, ((0, 1), (0, 1)), mode="wrap") for each in (hills, lift, paint)))


def _build(lift: Image, paint: Image, rng: np.random.Generator, centre: Array, plot: float, top_m: float) -> None:
    """A house: turned, with a flat or a pitched roof."""
    half = rng.uniform(0.2, 0.36, 2) * plot
    bearing = rng.uniform(0.0, np.pi)
    rows, columns, along, across = _about(centre, bearing, float(np.hypot(*half)))
    inside = (np.abs(along) <= half[0]) & (np.abs(across) <= half[1])
    eaves_m = rng.uniform(0.3, 0.65) * top_m
    ridge_m = rng.uniform(0.0, 0.35) * top_m * (rng.uniform() < 0.6)
    height = eaves_m + ridge_m * (1.0 - np.abs(across) / half[1])
    block = np.ix_(rows, columns)
    lift[block] = np.where(inside, height, lift[block])
    paint[block] = np.where(inside, rng.uniform(0.6, 1.5), paint[block])


def _plant(
    lift: Image, paint: Image, rng: np.random.Generator, centre: Array, plot: float, top_m: float, leaves: Image
) -> None:
    """A tree: a crown as an ellipsoid on its own shadow, its leaves uneven."""
    radius = rng.uniform(0.2, 0.4) * plot
    rows, columns, along, across = _about(centre, 0.0, radius)
    squared = (along**2 + across**2) / radius**2
    height_m = rng.uniform(0.45, 0.95) * top_m
    block = np.ix_(rows, columns)
    crown = height_m * (0.35 + 0.65 * np.sqrt(np.maximum(1.0 - squared, 0.0))) + leaves[block]
    lift[block] = np.where(squared < 1.0, np.clip(crown, 0.2, top_m), lift[block])
    paint[block] = np.where(squared < 1.0, rng.uniform(0.5, 0.8), paint[block])


def _about(centre: Array, bearing: float, reach: float) -> tuple[NDArray[np.intp], NDArray[np.intp], Array, Array]:
    """Rows and columns about a place (cells, wrapped), and each cell's place along and across a bearing."""
    size = int(np.ceil(reach)) + 1
    first = np.floor(centre).astype(int) - size
    rows, columns = (np.arange(f, f + 2 * size + 1) for f in first)
    dy, dx = np.meshgrid(rows - centre[0], columns - centre[1], indexing="ij")
    cos, sin = np.cos(bearing), np.sin(bearing)
    return rows % SIZE, columns % SIZE, dx * cos + dy * sin, dy * cos - dx * sin


def _periodic_noise(rng: np.random.Generator, sigma_cells: float) -> Image:
    """Noise (SIZE, SIZE) of one sigma about 1, smooth over so many cells, that repeats."""
    frequency = np.fft.fftfreq(SIZE)
    low_pass = np.exp(-2.0 * (np.pi * sigma_cells) ** 2 * (frequency[:, None] ** 2 + frequency**2))
    smooth = np.fft.ifft2(np.fft.fft2(rng.standard_normal((SIZE, SIZE))) * low_pass).real
    return np.asarray(smooth / smooth.std(), np.float32)
