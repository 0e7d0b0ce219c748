"""How closely a window's points are held to the ground: as declared, as seen, or as terrain says."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from onboard.config.schema import Config
from onboard.estimation.bundle_adjustment import Problem, Solution
from onboard.estimation.factors import ground_plane
from onboard.estimation.ground_roughness import effective_sigma_m
from onboard.estimation.window_request import Request
from onboard.geometry.terrain_grid import Terrain

Array = NDArray[np.float64]

MIN_STRAY_M = 0.3


def weight_and_terrain(request: Request, points: Array) -> tuple[Array, Terrain | None]:
    """1 / sigma of the ground under each point (P,), and the terrain if it is known under all of them."""
    if request.terrain is not None:
        height, _ = request.terrain.height_and_slope(points[:, :2])
        if np.all(np.isfinite(height)):
            return np.full(len(points), 1.0 / request.config.terrain.sigma_m), request.terrain
    return np.full(len(points), as_declared(request.config)), None


def as_declared(config: Config) -> float:
    """1 / sigma (1/m) of ground of which nothing is known but its roughness."""
    return 1.0 / max(config.solve.ground_roughness_sigma_m, 1e-3)


def correlated(problem: Problem, first: Solution, ground_weight: Array) -> Array:
    """1 / sigma (P,) of the ground under each point, for correlated deviations: no more than `ground_weight`. (5.13)"""
    s = first.state
    height, _, _ = ground_plane(s.points_enu_m, problem.reference_enu_m, s.plane, problem.terrain)
    seen = np.isfinite(height) & (np.count_nonzero(problem.weight > 0, axis=0) >= 2)
    offset = (s.points_enu_m - problem.reference_enu_m)[seen, :2]
    clearance_m = float((s.centres_enu_m[:, 2]).mean() - np.median(s.points_enu_m[seen, 2]))
    sigma_m = effective_sigma_m(offset, height[seen], first.point_covariance[seen, 2, 2], clearance_m)
    return np.minimum(ground_weight, 1.0 / max(sigma_m, 1e-3))


def strays_m(request: Request, offset: Array, plane: Array, terrain: Terrain | None) -> float:
    """One sigma (m) of the ground about the plane, by the points themselves, or as declared of the terrain."""
    if terrain is not None:
        return request.config.terrain.sigma_m
    above = offset[:, 2] - plane[0] - offset[:, :2] @ plane[1:]
    measured = 1.4826 * float(np.median(np.abs(above - np.median(above))))
    return min(max(measured, MIN_STRAY_M), max(request.config.solve.ground_roughness_sigma_m, MIN_STRAY_M))
