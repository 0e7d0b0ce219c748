"""Two or more rays -> points, all points of a window at once, with their parallax. Equation (4.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Triangulated:
    """Points (P, 3) in ENU metres, their parallax (P,) rad, and whether each is ahead of every view that saw it."""

    points_enu_m: Array
    parallax_rad: Array
    is_ahead: Mask


def triangulate(R_cam_enu: Array, centres_enu_m: Array, xy: Array, seen: Mask) -> Triangulated:
    """Least squares intersection of rays: minimises the squared distances to all of a point's rays, (4.3).

    `R_cam_enu` (K, 3, 3), `centres_enu_m` (K, 3), `xy` (K, P, 2) normalised image coordinates, `seen` (K, P). A point
    without parallax comes out somewhere along its rays; its parallax shows it.
    """
    rays = np.concatenate([xy, np.ones((*xy.shape[:2], 1))], axis=-1)
    d = np.einsum("kpi,kij->kpj", rays, R_cam_enu)
    d /= np.linalg.norm(d, axis=-1, keepdims=True)
    w = seen.astype(float)
    count = np.maximum(w.sum(axis=0), 1.0)
    spread = np.einsum("kp,kpi,kpj->pij", w, d, d)
    A = count[:, None, None] * np.eye(3) - spread
    along = np.einsum("kpi,ki->kp", d, centres_enu_m)
    b = np.einsum("kp,ki->pi", w, centres_enu_m) - np.einsum("kp,kp,kpi->pi", w, along, d)
    values, vectors = np.linalg.eigh(A)
    # The smallest eigenvalue over the count is the mean squared sine of the rays about their mean direction.
    parallax = 2.0 * np.sqrt(np.maximum(values[:, 0] / count, 0.0))
    inverse = 1.0 / np.maximum(values, 1e-12 * count[:, None])
    points = np.einsum("pij,pj,pkj,pk->pi", vectors, inverse, vectors, b)
    depth = np.einsum("kj,kpj->kp", R_cam_enu[:, 2], points[None] - centres_enu_m[:, None])
    ahead = np.all((depth > 0.0) | ~seen, axis=0) & (count >= 2.0)
    return Triangulated(points, parallax, ahead)


def on_plane(R: Array, C: Array, xy: Array, seen: Mask, plane: Array) -> Array:
    """Each point where its newest ray meets the plane (height at origin, slopes); far rays at ten clearances."""
    newest = len(seen) - 1 - np.argmax(seen[::-1], axis=0)
    P = np.arange(seen.shape[1])
    rays = np.concatenate([xy[newest, P], np.ones((len(P), 1))], axis=1)
    d = np.einsum("pi,pij->pj", rays, R[newest])
    normal = np.array([-plane[1], -plane[2], 1.0])
    clearance = np.maximum(C[newest] @ normal - plane[0], 1.0)
    down = np.maximum(-(d @ normal), 0.1)
    out: Array = C[newest] + d * (clearance / down)[:, None]
    return out
