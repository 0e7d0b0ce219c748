"""A terrain model around the aircraft: heights on a regular ENU grid, bilinear between its nodes. No I/O.

Heights are in the datum of the navigation frame (above mean sea level). Where the model has no data the height is nan,
and everything computed from it is nan or infinite.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MARCH_STEPS = 96
REFINE_STEPS = 12


@dataclass(frozen=True, eq=False)
class Terrain:
    """Heights (rows north, columns east) from `west_m`, `south_m` on, `spacing_m` apart; beyond the edge: nan."""

    west_m: float
    south_m: float
    spacing_m: float
    heights_m: Array

    def height_and_slope(self, xy_enu_m: Array) -> tuple[Array, Array]:
        """Heights (P,) and slopes east, north (P, 2) at places (P, 2)."""
        rows, columns = self.heights_m.shape
        x = (xy_enu_m[:, 0] - self.west_m) / self.spacing_m
        y = (xy_enu_m[:, 1] - self.south_m) / self.spacing_m
        inside = (x >= 0.0) & (y >= 0.0) & (x <= columns - 1) & (y <= rows - 1)
        i = np.clip(np.where(inside, y, 0.0).astype(int), 0, rows - 2)
        j = np.clip(np.where(inside, x, 0.0).astype(int), 0, columns - 2)
        a, b = x - j, y - i
        h = self.heights_m
        h00, h01, h10, h11 = h[i, j], h[i, j + 1], h[i + 1, j], h[i + 1, j + 1]
        height = (1 - a) * (1 - b) * h00 + a * (1 - b) * h01 + (1 - a) * b * h10 + a * b * h11
        east = ((1 - b) * (h01 - h00) + b * (h11 - h10)) / self.spacing_m
        north = ((1 - a) * (h10 - h00) + a * (h11 - h01)) / self.spacing_m
        nan = np.where(inside, 0.0, np.nan)
        return height + nan, np.stack([east, north], axis=-1) + nan[:, None]

    def covers(self, xy_enu_m: Array, margin_m: float) -> bool:
        """Return whether a place (2,) lies inside by at least a margin."""
        rows, columns = self.heights_m.shape
        x, y = xy_enu_m[0] - self.west_m, xy_enu_m[1] - self.south_m
        return bool(
            margin_m <= x <= (columns - 1) * self.spacing_m - margin_m
            and margin_m <= y <= (rows - 1) * self.spacing_m - margin_m
        )

    def cast(self, centre_enu_m: Array, rays_enu: Array) -> Array:
        """Depth (N,) at which rays (N, 3) of depth 1 first go under the ground; inf where they never do.

        Marched from the highest to the lowest ground in steps of equal height loss, then bisected.
        """
        top, bottom = float(np.nanmax(self.heights_m)), float(np.nanmin(self.heights_m))
        down = -rays_enu[:, 2]
        ok = down > 0.02 * np.linalg.norm(rays_enu, axis=1)
        fall = np.where(ok, down, 1.0)
        start = np.maximum((centre_enu_m[2] - top - 1.0) / fall, 0.0)
        end = (centre_enu_m[2] - bottom + 1.0) / fall
        share = np.linspace(0.0, 1.0, MARCH_STEPS)
        depth = start[:, None] + (end - start)[:, None] * share
        above = self._clearance(centre_enu_m, rays_enu, depth) > 0.0
        under = ~above
        first = np.argmax(under, axis=1)
        hit = ok & under.any(axis=1) & (first > 0)
        row = np.arange(len(depth))
        near, far = depth[row, np.maximum(first - 1, 0)], depth[row, first]
        for _ in range(REFINE_STEPS):
            middle = 0.5 * (near + far)
            clear = self._clearance(centre_enu_m, rays_enu, middle[:, None])[:, 0] > 0.0
            near, far = np.where(clear, middle, near), np.where(clear, far, middle)
        known = np.isfinite(self._clearance(centre_enu_m, rays_enu, far[:, None])[:, 0])
        # A last secant step makes the result smooth, as finite differences of it need.
        c_near = self._clearance(centre_enu_m, rays_enu, near[:, None])[:, 0]
        c_far = self._clearance(centre_enu_m, rays_enu, far[:, None])[:, 0]
        exact = near + (far - near) * c_near / np.where(c_near - c_far > 1e-12, c_near - c_far, 1.0)
        return np.where(hit & known & np.isfinite(exact), exact, np.inf)

    def _clearance(self, centre_enu_m: Array, rays_enu: Array, depth: Array) -> Array:
        at = centre_enu_m + rays_enu[:, None, :] * depth[..., None]
        height, _ = self.height_and_slope(at.reshape(-1, 3)[:, :2])
        return at[..., 2] - height.reshape(depth.shape)
