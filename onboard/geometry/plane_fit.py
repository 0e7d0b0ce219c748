"""The ground plane under the points. Seed, section 2.3."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from onboard.geometry.robust import irls

Array = NDArray[np.float64]


def fit_plane(points_enu_m: Array, weight: Array | None = None) -> tuple[Array, float]:
    """Plane z = h + se x + sn y through points (P, 3): (h, se, sn) and the robust spread (m) about it. Equation (8.1).

    Least squares with four rounds of reweighting, so that a mast or a wrong point does not tilt it. With fewer than
    three points or all of them in a line the plane is level at their mean height.
    """
    base = np.ones(len(points_enu_m)) if weight is None else weight
    A = np.concatenate([np.ones((len(points_enu_m), 1)), points_enu_m[:, :2]], axis=1)
    centre = points_enu_m[:, :2].mean(axis=0)
    A[:, 1:] -= centre
    scale = max(float(np.abs(A[:, 1:]).max(initial=0.0)), 1e-9)
    A[:, 1:] /= scale
    height = points_enu_m[:, 2]

    def fit(w: Array) -> tuple[Array, Array]:
        N = A.T @ (A * w[:, None])
        damped = N + 1e-6 * max(float(N[0, 0]), 1e-12) * np.eye(3)
        plane = np.asarray(np.linalg.solve(damped, A.T @ (w * height)), float)
        return plane, np.abs(height - A @ plane)

    def spread(miss: Array) -> float:
        return 1.4826 * float(np.median(miss))

    plane, miss = irls(fit, base, lambda miss: (miss / max(2.0 * spread(miss), 1e-9)) ** 2)
    slope = plane[1:] / scale
    return np.array([plane[0] - slope @ centre, *slope]), spread(miss)
