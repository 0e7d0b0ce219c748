"""The seed's method on two views, step by step and in its order (sections 2.2 and 2.3).

Orientation from travel, one small-angle least squares, triangulation, k iterations of bundle adjustment over image and
GPS residuals, levelling. Uses onboard's packages: they are what is being studied.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from contract.rotations import exp_so3
from onboard.estimation.bundle_adjustment import Problem, Solution, solve
from onboard.estimation.factors import Layout, PositionPrior, SharedPrior, State
from onboard.estimation.platform_states import STATES
from onboard.geometry.plane_fit import fit_plane
from onboard.geometry.relative_orientation import small_angle, travel_aligned
from onboard.geometry.triangulation import triangulate
from simulation.study_world import CAMERA, R_BODY_CAM, unit_depth

Array = NDArray[np.float64]

CONVERGED = 300  # iterations; it has stopped long before
# With two views the GPS residuals only fix what the pictures leave open (position, direction and scale: six numbers,
# six measurements), so these weights change the way to the optimum and not the optimum.
WEIGHT_SIGMA_PX = 0.3
WEIGHT_SIGMA_M = 1.0


def start(uv_px: Array, gps_enu_m: Array, steps: int = 1) -> State:
    """Orientation from travel, `steps` small-angle solutions (the seed takes one) and triangulated points.

    `uv_px` (2, P, 2), `gps_enu_m` (2, 3).
    """
    xy = unit_depth(uv_px)
    rays = np.concatenate([xy, np.ones((*xy.shape[:2], 1))], axis=-1)
    first = travel_aligned(gps_enu_m[1] - gps_enu_m[0], R_BODY_CAM)
    t_cam1 = first @ (gps_enu_m[1] - gps_enu_m[0])
    Q = np.eye(3)
    for _ in range(steps):
        Q = exp_so3(small_angle(rays[0], rays[1], Q, t_cam1)) @ Q
    R = np.stack([first, Q @ first])
    points = triangulate(R, gps_enu_m, xy, np.ones(xy.shape[:2], bool)).points_enu_m
    return State(R, gps_enu_m, points, np.zeros(STATES), np.zeros(3))


def problem(uv_px: Array, gps_enu_m: Array) -> Problem:
    """Image and GPS residuals and nothing else; what the layout shares (boresight, plane) is held by its own prior."""
    layout = Layout(2)
    xy = unit_depth(uv_px)
    gps = PositionPrior(
        layout, gps_enu_m, np.zeros((2, 3)), np.broadcast_to(np.eye(2) / WEIGHT_SIGMA_M, (3, 2, 2)), np.zeros(2)
    )
    held = SharedPrior(layout, np.zeros(11), np.eye(11))
    return Problem(layout, xy, np.full(xy.shape[:2], CAMERA.focal_px / WEIGHT_SIGMA_PX), [gps, held])


def levelled(state: State) -> Array:
    """Points (P, 3) after the ground's slope across the flight is turned away about the line through both centres."""
    centres, points = state.centres_enu_m, state.points_enu_m
    travel = centres[1] - centres[0]
    plane, _ = fit_plane(points)
    _, R = level(state.R_cam_enu, centres[0], travel, roll_from_plane(plane, travel))
    out: Array = centres[0] + (points - centres[0]) @ R.T
    return out


def adjusted(uv_px: Array, gps_enu_m: Array, begin: State, iterations: int | None) -> Solution:
    """`begin` after exactly `iterations` of Levenberg-Marquardt, or, with None, after it has converged."""
    if iterations is None:
        return solve(problem(uv_px, gps_enu_m), begin, scale=None, max_iterations=CONVERGED, tolerance=1e-12)
    return solve(problem(uv_px, gps_enu_m), begin, scale=None, max_iterations=iterations, tolerance=0.0)


def errors(uv_px: Array, gps_enu_m: Array, truth_enu_m: Array, iterations: tuple[int | None, ...]) -> list[float]:
    """Mean distance (m) of levelled points from the truth: start (iterations 0), after k, converged (None)."""
    begin = start(uv_px, gps_enu_m)
    out = []
    for count in iterations:
        state = begin if count == 0 else adjusted(uv_px, gps_enu_m, begin, count).state
        out.append(float(np.linalg.norm(levelled(state) - truth_enu_m, axis=1).mean()))
    return out


def roll_from_plane(plane: Array, travel_enu: Array) -> float:
    """The ground's slope across the line of flight, as an angle about it (rad). Equation (8.2)."""
    along = travel_enu[:2] / max(float(np.linalg.norm(travel_enu[:2])), 1e-12)
    return float(np.arctan(plane[1:] @ np.array([-along[1], along[0]])))


def level(R_cam_enu: Array, pivot_enu_m: Array, travel_enu: Array, roll_rad: float) -> tuple[Array, Array]:
    """Turn the scene about the line of flight so that a slope of `roll_rad` across it vanishes. Equation (8.3).

    Returns the turned R_cam_enu (K, 3, 3) and the rotation (3, 3) that takes a point X to pivot + R (X - pivot).
    """
    axis = travel_enu / max(float(np.linalg.norm(travel_enu)), 1e-12)
    R = exp_so3(-roll_rad * axis)
    return R_cam_enu @ R.T, R
