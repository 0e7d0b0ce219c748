"""Starting orientation: absolute from the GPS path, relative by the small-angle method. The seed's section 2.2.

Section 3 of docs/mathematics.md. Nothing here has to be accurate, because the bundle adjustment follows. It has to lie
within that adjustment's basin of convergence, and to report when it does not: `start_pair` tries the direction of
travel first, turns about the vertical next and a five-point start last, and keeps what the measured rays support best.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from contract.rotations import R_ENU_NED, exp_so3, matrix_from_euler, skew
from onboard.geometry.robust import cauchy_weight, irls, middle
from onboard.geometry.triangulation import triangulate

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

RANSAC_ROUNDS = 128
ENOUGH = 8  # rays a relative orientation needs


@dataclass(frozen=True, eq=False)
class Pair:
    """Two views: R_cam_enu of both, the inliers (N,), and the median epipolar error (rad)."""

    first: Array
    second: Array
    inliers: Mask
    error_rad: float


def travel_aligned(travel_enu: Array, R_body_cam: Array) -> Array:
    """R_cam_enu of a vehicle that flies where its nose points, roll 0. Equation (3.2)."""
    course = float(np.arctan2(travel_enu[0], travel_enu[1]))
    climb = float(np.arctan2(travel_enu[2], np.hypot(travel_enu[0], travel_enu[1])))
    R_enu_body = R_ENU_NED @ matrix_from_euler(0.0, climb, course)
    return (R_enu_body @ R_body_cam).T


def epipolar_error(rays1: Array, rays2: Array, Q: Array, t_cam1: Array) -> Array:
    """Signed distance (rad, about) of rays2 (N, 3) from their epipolar planes; Q = R_cam2_cam1, t in camera 1. (3.4)

    Sampson's first-order distance: the error shared between both views.
    """
    n2, scale = _normals(rays1, rays2, Q @ skew(t_cam1))
    out: Array = np.einsum("ni,ni->n", rays2, n2) * scale
    return out


def _normals(rays1: Array, rays2: Array, essential: Array) -> tuple[Array, Array]:
    """Normals (N, 3) of the epipolar planes in camera 2, and what makes products with rays2 distances, (N,). (3.4)"""
    n2, n1 = rays1 @ essential.T, rays2 @ essential
    gradient = np.einsum("ni,ni->n", n2[:, :2], n2[:, :2]) + np.einsum("ni,ni->n", n1[:, :2], n1[:, :2])
    return n2, 1.0 / np.maximum(np.sqrt(gradient), 1e-12)


def small_angle(rays1: Array, rays2: Array, Q: Array, t_cam1: Array, weight: Array | None = None) -> Array:
    """One linear small-angle step theta (3,): the new Q is exp(theta) Q. Least squares of (3.5), a row a feature.

    `rays1`, `rays2` (N, 3) normalised image coordinates with a third of 1, `t_cam1` (3,) the baseline in camera 1 axes,
    any length but zero.
    """
    rows, right = _small_angle_rows(rays2, *_normals(rays1, rays2, Q @ skew(t_cam1)))
    w = np.ones(len(rows)) if weight is None else weight
    N = rows.T @ (rows * w[:, None])
    return np.linalg.solve(N + 1e-12 * np.trace(N) * np.eye(3), rows.T @ (w * right))


def _small_angle_rows(rays2: Array, n2: Array, scale: Array) -> tuple[Array, Array]:
    # n2 x rays2, by columns: np.cross takes four times as long, most of it before it multiplies.
    x, y, z = n2.T
    u, v, w = rays2.T
    rows = np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=1)
    return rows * scale[:, None], -np.einsum("ni,ni->n", rays2, n2) * scale


def relative_lsq(rays1: Array, rays2: Array, t_cam1: Array, Q: Array | None = None, steps: int = 5) -> Array:
    """R_cam2_cam1 by repeated small-angle least squares from Q (identity by default)."""
    out = np.eye(3) if Q is None else Q
    for _ in range(steps):
        theta = small_angle(rays1, rays2, out, t_cam1)
        out = exp_so3(theta) @ out
        if float(np.abs(theta).max()) < 1e-9:
            break
    return out


def relative_ransac(
    rays1: Array, rays2: Array, t_cam1: Array, tolerance_rad: float, seed: int = 0, Q: Array | None = None
) -> tuple[Array, Mask]:
    """R_cam2_cam1 by small-angle RANSAC (Fischler and Bolles 1981), refined on its inliers; and the inliers (N,).

    Three rows a hypothesis, all hypotheses at once. `tolerance_rad` is the epipolar distance of an inlier.
    """
    start = np.eye(3) if Q is None else Q
    rows, right = _small_angle_rows(rays2, *_normals(rays1, rays2, start @ skew(t_cam1)))
    rng = np.random.default_rng(seed)
    picks = rng.integers(0, len(rows), (RANSAC_ROUNDS, 3))
    A = rows[picks]
    solvable = np.abs(np.linalg.det(A)) > 1e-12
    A[~solvable] = np.eye(3)
    hypotheses = np.linalg.solve(A, right[picks][..., None])[..., 0]
    hypotheses[~solvable] = 1e3
    close = np.abs(rows @ hypotheses.T - right[:, None]) < tolerance_rad
    inliers = close[:, int(np.argmax(close.sum(axis=0)))]
    best = start
    for _ in range(4):
        if np.count_nonzero(inliers) < ENOUGH:
            break
        best = relative_lsq(rays1[inliers], rays2[inliers], t_cam1, best, steps=3)
        inliers = np.abs(epipolar_error(rays1, rays2, best, t_cam1)) < tolerance_rad
    return best, inliers


def refine_direction(
    rays1: Array, rays2: Array, Q: Array, t_cam1: Array, tolerance_rad: float, steps: int = 15
) -> tuple[Array, Array]:
    """Relative rotation and direction of travel together, Gauss-Newton on (3.4) with Cauchy weights; (3.6).

    Five unknowns: Q <- exp(theta) Q, t <- exp(phi) t with phi across t. Returns Q and t (3,) of the same length.
    """
    length = float(np.linalg.norm(t_cam1))
    t = t_cam1 / length
    across = np.linalg.svd(t[None])[2][1:]  # two axes across t
    for _ in range(steps):
        n2, scale = _normals(rays1, rays2, Q @ skew(t))
        rows, right = _small_angle_rows(rays2, n2, scale)
        # d(x2 . Q (t x x1)) for t <- t + phi x t: the essential matrices of a x t for both axes a
        by_axis = [np.einsum("ni,ni->n", rays2, rays1 @ one.T) * scale for one in Q @ skew(across @ skew(t))]
        J = np.column_stack([rows, *by_axis])
        w = cauchy_weight(right, 2.0 * tolerance_rad)
        N = J.T @ (J * w[:, None])
        step = np.linalg.solve(N + 1e-9 * np.trace(N) * np.eye(5), J.T @ (w * right))
        step *= min(1.0, 0.3 / max(float(np.abs(step).max()), 1e-12))
        turn = exp_so3(step[3:] @ across)
        Q, t, across = exp_so3(step[:3]) @ Q, turn @ t, across @ turn.T
        if float(np.abs(step).max()) < 1e-8:
            break
    return Q, t * length


def absolute_from_direction(t_cam: Array, t_enu: Array, down_cam: Array) -> Array:
    """R_cam_enu that maps the baseline to its direction seen and takes `down_cam` as near to down as it may. (3.7)"""
    x_cam = t_cam / np.linalg.norm(t_cam)
    x_enu = t_enu / np.linalg.norm(t_enu)
    y_cam = np.cross(down_cam, x_cam)
    y_enu = np.cross([0.0, 0.0, -1.0], x_enu)
    y_cam = y_cam / max(float(np.linalg.norm(y_cam)), 1e-12)
    y_enu = y_enu / max(float(np.linalg.norm(y_enu)), 1e-12)
    cam = np.stack([x_cam, y_cam, np.cross(x_cam, y_cam)], axis=1)
    enu = np.stack([x_enu, y_enu, np.cross(x_enu, y_enu)], axis=1)
    out: Array = cam @ enu.T
    return out


def start_pair(
    rays1: Array, rays2: Array, baseline_enu_m: Array, R_body_cam: Array, tolerance_rad: float, seed: int = 0
) -> Pair | None:
    """Both orientations of two views from rays and the GPS baseline alone; None if no start explains the rays.

    The start with the most support is kept: rays near their epipolar planes with points ahead of both views. The
    seed's own start wins ties, because the direction of travel is then known and needs no estimate.
    """
    if len(rays1) < ENOUGH:
        return None
    nominal = travel_aligned(baseline_enu_m, R_body_cam)
    starts: list[tuple[Array, Array]] = []
    t_nominal = nominal @ baseline_enu_m
    Q, _ = relative_ransac(rays1, rays2, t_nominal, tolerance_rad, seed)
    starts.append((Q, t_nominal))
    for turn_deg in (0.0, 30.0, -30.0, 60.0, -60.0, 90.0, -90.0, 135.0, -135.0, 180.0):
        t = t_nominal @ exp_so3(np.radians(turn_deg) * nominal[:, 2]).T
        Q, _ = relative_ransac(rays1, rays2, t, 3.0 * tolerance_rad, seed)
        starts.append(refine_direction(rays1, rays2, Q, t, tolerance_rad))
    starts.extend(_five_point(rays1, rays2, float(np.linalg.norm(baseline_enu_m)), tolerance_rad))
    best: tuple[float, Array, Array, Mask] | None = None
    for order, (Q, t) in enumerate(starts):
        error = np.abs(epipolar_error(rays1, rays2, Q, t))
        inliers = (error < tolerance_rad) & _ahead(rays1, rays2, Q, t)
        # A start may only displace an earlier one, simpler and better known, by clearly more support.
        score = float(np.sum(np.where(inliers, 1.0 - (error / tolerance_rad) ** 2, 0.0))) / (1.0 + 0.002 * order)
        if best is None or score > best[0]:
            best = (score, Q, t, inliers)
    assert best is not None
    _, Q, t, inliers = best
    if np.count_nonzero(inliers) < max(ENOUGH, 0.5 * len(rays1)):
        return None
    down_cam = _ground_normal(rays1[inliers], rays2[inliers], Q, t, nominal[:, 2] * -1.0)
    first = absolute_from_direction(t, baseline_enu_m, down_cam)
    error = epipolar_error(rays1[inliers], rays2[inliers], Q, t)
    return Pair(first, Q @ first, inliers, float(np.median(np.abs(error))))


def _ahead(rays1: Array, rays2: Array, Q: Array, t_cam1: Array) -> Mask:
    """A mask of the pairs of rays that meet in front of both cameras."""
    centres = np.stack([np.zeros(3), t_cam1])
    xy = np.stack([rays1[:, :2], rays2[:, :2]])
    return triangulate(np.stack([np.eye(3), Q]), centres, xy, np.ones(xy.shape[:2], bool)).is_ahead


def _ground_normal(rays1: Array, rays2: Array, Q: Array, t_cam1: Array, nominal_down_cam: Array) -> Array:
    """Downward normal, in camera 1 axes, of the plane through the pair's points: levelling in that frame."""
    centres = np.stack([np.zeros(3), t_cam1])
    xy = np.stack([rays1[:, :2], rays2[:, :2]])
    points = triangulate(np.stack([np.eye(3), Q]), centres, xy, np.ones(xy.shape[:2], bool)).points_enu_m
    # Inverse depth is affine over a plane: 1/z = (n . u) / h. Linear, and its noise is even.
    w = 1.0 / np.maximum(points[:, 2], 1e-6)

    def fit(weight: Array) -> tuple[Array, Array]:
        N = rays1.T @ (rays1 * weight[:, None])
        normal: Array = np.linalg.solve(N + 1e-9 * np.trace(N) * np.eye(3), rays1.T @ (weight * w))
        return normal, np.abs(rays1 @ normal - w)

    normal, _ = irls(fit, np.ones(len(w)), lambda miss: (miss / max(2.0 * float(np.median(miss)), 1e-12)) ** 2)
    length = float(np.linalg.norm(normal))
    if length < 1e-9:
        return nominal_down_cam
    return normal / length


def _five_point(rays1: Array, rays2: Array, length: float, tolerance_rad: float) -> list[tuple[Array, Array]]:
    """Nister's five-point start, refined; empty where it finds nothing.

    OpenCV's USAC with graph-cut local optimisation (Barath and Matas 2018). Compared with its older RANSAC over 1343
    simulated pairs of plane and rough ground with 0 to 40 % outliers: right as often (62 % and 60 %), six times as fast
    (0.9 and 5.5 ms), and no result from points on a line or in one place.
    """
    E, _ = cv2.findEssentialMat(
        np.ascontiguousarray(rays1[:, :2]),
        np.ascontiguousarray(rays2[:, :2]),
        np.eye(3),
        cv2.USAC_ACCURATE,
        0.999,
        tolerance_rad,
    )
    if E is None or E.shape != (3, 3):
        return []
    _, R, t, _ = cv2.recoverPose(E, np.ascontiguousarray(rays1[:, :2]), np.ascontiguousarray(rays2[:, :2]), np.eye(3))
    # OpenCV: x2 = R x1 + t, so the second centre in camera 1 is -R' t.
    direction = -(np.asarray(R).T @ np.asarray(t).ravel())
    return [refine_direction(rays1, rays2, np.asarray(R, float), np.asarray(direction, float) * length, tolerance_rad)]


def rotation_only(rays1: Array, rays2: Array, steps: int = 5) -> Array:
    """R_cam2_cam1 of two views from one place: Kabsch on unit rays with reweighting. Equation (3.8)."""
    a = rays1 / np.linalg.norm(rays1, axis=1, keepdims=True)
    b = rays2 / np.linalg.norm(rays2, axis=1, keepdims=True)

    def fit(weight: Array) -> tuple[Array, Array]:
        U, _, Vt = np.linalg.svd((b * weight[:, None]).T @ a)
        Q: Array = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
        off = b - a @ Q.T
        return Q, np.einsum("ij,ij->i", off, off)

    return irls(fit, np.ones(len(a)), lambda miss2: miss2 / max(4.0 * middle(miss2), 1e-24), steps)[0]
