"""The shape of the ground, in ENU metres about the session's origin: height z(x, y), and where rays meet it.

Level ground is level: it falls away from the origin's tangent plane as the Earth curves, so that "flat at 100 m" stays
100 m everywhere. Hills are a few plane waves, smooth and exact at every point; obstacles stand one to a cell of a
periodic grid, so that finding the one at a point takes one table look-up. A town or a forest is a raster of heights
(simulation/raster.py), its hills too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contract.errors import InputError
from contract.geodesy import EARTH_RADIUS_M, level_ground_m
from simulation.raster import KINDS, Raster, look_up

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

WAVES = 7
CELLS = 128  # the obstacle grid repeats after this many cells
EDGE_M = 0.4  # a wall rises over this distance, so that a ray always meets the surface
MAX_MARCH_STEPS = 160
HIT_TOLERANCE_M = 1e-6
OBSTACLES = ("none", "boxes", "bumps", *KINDS)


@dataclass(frozen=True)
class TerrainSpec:
    """`relief_m`: highest hill over deepest valley. `obstacles`: "none", "boxes" (houses), "bumps" (tree crowns), or
    one of a raster of heights, "town" (houses and trees) and "forest".
    """

    relief_m: float = 0.0
    wavelength_m: float = 250.0
    obstacles: str = "none"
    obstacle_height_m: float = 8.0
    obstacle_cell_m: float = 40.0
    seed: int = 0

    def __post_init__(self) -> None:
        if self.obstacles not in OBSTACLES:
            raise InputError(f"obstacles {self.obstacles!r} is not known; use one of {', '.join(OBSTACLES)}")
        if self.relief_m < 0 or self.wavelength_m < 20 or self.obstacle_height_m < 0 or self.obstacle_cell_m < 8:
            raise InputError(
                "terrain: relief and obstacle height must not be negative, the wavelength at least 20 m, "
                "the obstacle cell at least 8 m"
            )


class Terrain:
    """Height of the ground and the first point where a ray meets it."""

    def __init__(self, spec: TerrainSpec) -> None:
        self.spec = spec
        rng = np.random.default_rng([spec.seed, 101])
        bearing = rng.uniform(0.0, 2.0 * np.pi, WAVES)
        length_m = spec.wavelength_m * np.linspace(0.75, 2.2, WAVES)
        self._wave = 2.0 * np.pi / length_m[:, None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
        self._phase = rng.uniform(0.0, 2.0 * np.pi, WAVES)
        weight = length_m / length_m.sum()
        axis = np.linspace(-6.0, 6.0, 121) * spec.wavelength_m
        sample = self._waves(*np.meshgrid(axis, axis), weight)
        low, high = float(sample.min()), float(sample.max())
        self._weight = weight * spec.relief_m / (high - low)
        self._base_m = -0.5 * (low + high) * spec.relief_m / (high - low)
        self._cells = self._draw_cells(rng)
        self.raster = (
            Raster.draw(spec.obstacles, spec.relief_m, spec.obstacle_height_m, spec.obstacle_cell_m, spec.seed)
            if spec.obstacles in KINDS
            else None
        )
        # The waves may exceed the sampled range a little elsewhere: the sum of weights can not be exceeded anywhere.
        reach = float(np.abs(self._weight).sum())
        top_m = spec.obstacle_height_m if self.has_obstacles else 0.0
        self.lowest_m, self.highest_m = self._base_m - reach, self._base_m + reach + top_m
        if self.raster is not None:
            self.lowest_m, self.highest_m = (float(of(self.raster.surface_m)) for of in (np.min, np.max))

    @property
    def has_obstacles(self) -> bool:
        """True if the surface has walls, so that neighbouring pixels may see very different depths."""
        return self.spec.obstacles != "none"

    @property
    def is_flat(self) -> bool:
        """True if the ground is level everywhere."""
        return not self.has_obstacles and self.spec.relief_m == 0.0

    def _draw_cells(self, rng: np.random.Generator) -> Array:
        """(CELLS, CELLS, 5): centre and half size within the cell (m), height (m); 0 height where a cell is empty."""
        cell_m = self.spec.obstacle_cell_m
        half = rng.uniform(0.1, 0.24, (CELLS, CELLS, 2)) * cell_m
        if self.spec.obstacles == "bumps":
            half[..., 1] = half[..., 0]
        centre = half + rng.uniform(0.0, 1.0, (CELLS, CELLS, 2)) * (cell_m - 2.0 * half)
        height = rng.uniform(0.4, 1.0, (CELLS, CELLS)) * self.spec.obstacle_height_m
        height *= rng.uniform(size=(CELLS, CELLS)) < 0.45
        return np.concatenate([centre, half, height[..., None]], axis=-1)

    def _waves(self, x: Array, y: Array, weight: Array) -> Array:
        total = np.zeros(np.broadcast(x, y).shape)
        for (kx, ky), phase, share in zip(self._wave, self._phase, weight, strict=True):
            total += share * np.sin(kx * x + ky * y + phase)
        return total

    def height_m(self, x_m: ArrayLike, y_m: ArrayLike) -> Array:
        """Height of the surface in the origin's ENU axes at east `x_m`, north `y_m` (any shape, metres)."""
        x, y = np.asarray(x_m, float), np.asarray(y_m, float)
        z = level_ground_m(x, y)
        if self.raster is not None:
            return np.asarray(z + look_up(self.raster.surface_m, *np.broadcast_arrays(x, y)), float)
        if self.spec.relief_m > 0.0:
            z = z + self._base_m + self._waves(x, y, self._weight)
        if self.has_obstacles:
            z = z + self.obstacle_m(x, y)
        return z

    def obstacle_m(self, x_m: ArrayLike, y_m: ArrayLike) -> Array:
        """Height of the obstacle above the hills at a place, metres; 0 outside obstacles."""
        x, y = np.asarray(x_m, float), np.asarray(y_m, float)
        if not self.has_obstacles:
            return np.zeros(np.broadcast(x, y).shape)
        if self.raster is not None:
            return look_up(self.raster.lift_m, *np.broadcast_arrays(x, y))
        cell_m = self.spec.obstacle_cell_m
        column, row = np.floor(x / cell_m), np.floor(y / cell_m)
        cell = self._cells[row.astype(np.int64) % CELLS, column.astype(np.int64) % CELLS]
        dx = np.abs(x - column * cell_m - cell[..., 0])
        dy = np.abs(y - row * cell_m - cell[..., 1])
        if self.spec.obstacles == "boxes":
            inside = np.minimum(cell[..., 2] - dx, cell[..., 3] - dy)
            profile = np.clip(inside / EDGE_M, 0.0, 1.0)
        else:
            profile = np.clip(1.0 - (dx**2 + dy**2) / cell[..., 2] ** 2, 0.0, 1.0)
        return cell[..., 4] * profile

    def slope(self, x_m: ArrayLike, y_m: ArrayLike) -> Array:
        """Gradient dz/dx, dz/dy of the hills (obstacles left out), shape (..., 2)."""
        x, y = np.asarray(x_m, float), np.asarray(y_m, float)
        out = np.zeros((*np.broadcast(x, y).shape, 2))
        if self.raster is not None:
            return out  # its hills are gentle
        if self.spec.relief_m > 0.0:
            for k, phase, share in zip(self._wave, self._phase, self._weight, strict=True):
                out += (share * np.cos(k[0] * x + k[1] * y + phase))[..., None] * k
        return out

    def cast(self, centre_m: ArrayLike, rays: ArrayLike, max_depth: float = 2e4) -> tuple[Array, Mask]:
        """Find where rays from one centre (3,) first meet the ground.

        `rays` (N, 3) in ENU axes, any length. Returns the multiple of each ray (N,) that reaches the surface and
        whether it does within `max_depth` multiples (a ray at the sky, or from below the ground, does not).
        """
        centre = np.asarray(centre_m, float)
        rays = np.asarray(rays, float)
        if self.is_flat:
            depth, hit = self._cross_level(centre, rays, 0.0)
            return depth, hit & (depth < max_depth)
        # A little below the lowest ground, so that rounding leaves the far end under it.
        depth, hit = self._cross_level(centre, rays, self.lowest_m - 0.01)
        hit &= depth < max_depth
        if not hit.any():
            return depth, hit
        hit &= centre[2] > self.height_m(centre[0], centre[1])
        ceiling_m = self.highest_m + 0.01
        near, _ = self._cross_level(centre, rays, ceiling_m)
        near = np.where(centre[2] > ceiling_m, near, 0.0)
        index = np.flatnonzero(hit)
        if self.raster is not None:
            ends = [centre + d[index, None] * rays[index] for d in (near, depth)]
            for end in ends:
                end[:, 2] -= level_ground_m(end[:, 0], end[:, 1])
            share, found = self.raster.first_crossing(*ends)
            depth[index] = near[index] + share * (depth[index] - near[index])
            hit[index] &= found
            return depth, hit
        depth[index], found = self._first_crossing(centre, rays[index], near[index], depth[index])
        hit[index] &= found
        return depth, hit

    @staticmethod
    def _cross_level(centre: Array, rays: Array, level_m: float) -> tuple[Array, Mask]:
        """Intersect rays with level ground at `level_m`: the smaller root of a quadratic, for the Earth is round."""
        x, y, z = centre
        dx, dy, dz = np.moveaxis(rays, -1, 0)
        a = (dx * dx + dy * dy) / (2.0 * EARTH_RADIUS_M)
        b = dz + (x * dx + y * dy) / EARTH_RADIUS_M
        c = z - level_m + (x * x + y * y) / (2.0 * EARTH_RADIUS_M)
        disc = b * b - 4.0 * a * c
        down = (b < 0.0) & (disc > 0.0) & (c > 0.0)
        # Written with the product of the roots: the difference form loses every digit when a is this small.
        depth = np.where(down, 2.0 * c / (-np.where(down, b, -1.0) + np.sqrt(np.where(down, disc, 0.0))), np.inf)
        return depth, down

    def _first_crossing(self, centre: Array, rays: Array, near: Array, far: Array) -> tuple[Array, Mask]:
        """March from `near` to `far` until the ray is below ground, then close in by the Illinois rule."""

        def above(s: Array, which: NDArray[np.int64]) -> Array:
            p = centre + s[:, None] * rays[which]
            return p[:, 2] - self.height_m(p[:, 0], p[:, 1])

        # A third of the narrowest obstacle, a twelfth of a hill: what a step misses is only a corner that the ray
        # barely touches.
        step_m = 0.07 * self.spec.obstacle_cell_m if self.has_obstacles else self.spec.wavelength_m / 12.0
        travel_m = (far - near) * np.hypot(rays[:, 0], rays[:, 1])
        steps = int(np.clip(np.ceil(np.max(travel_m, initial=0.0) / step_m), 1, MAX_MARCH_STEPS))
        low, high = near.copy(), far.copy()
        everyone = np.arange(len(rays))
        above_low, above_high = above(low, everyone), above(high, everyone)
        active = everyone
        for k in range(1, steps):
            s = near[active] + (far[active] - near[active]) * (k / steps)
            g = above(s, active)
            below = g <= 0.0
            done, on = active[below], active[~below]
            high[done], above_high[done] = s[below], g[below]
            low[on], above_low[on] = s[~below], g[~below]
            active = on
            if not active.size:
                break
        found = (above_low >= 0.0) & (above_high <= 0.0)
        s = high.copy()
        active = np.flatnonzero(found & (above_high < -HIT_TOLERANCE_M))
        for _ in range(60):
            if not active.size:
                break
            g_low, g_high = above_low[active], above_high[active]
            s_new = (low[active] * g_high - high[active] * g_low) / (g_high - g_low)
            g = above(s_new, active)
            s[active] = s_new
            above_now = g > 0.0
            up, under = active[above_now], active[~above_now]
            low[up], above_low[up] = s_new[above_now], g[above_now]
            high[under], above_high[under] = s_new[~above_now], g[~above_now]
            # Illinois: the end that stays is halved, else one end never moves on a curved surface.
            above_high[up] *= 0.5
            above_low[under] *= 0.5
            active = active[np.abs(g) > HIT_TOLERANCE_M]
        return s, found
