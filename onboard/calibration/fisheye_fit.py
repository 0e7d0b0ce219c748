"""Least squares of a fisheye and its boards' poses: OpenCV's own fails where a view shows a part of the board only."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.lens import FISHEYE

Array = NDArray[np.float64]
Board = tuple[Array, Array]  # a view's pixels (N, 2) and places on the board (N, 3), m
Pose = tuple[Array, Array]  # rotation vector and place (3,) of the board in camera axes, m

WIDTHS_RAD = (1.2, 1.9, 2.6)  # that a picture's width is taken for, to begin with
LEAST_CORNERS = 6
ROUNDS = 60
SETTLED = 1e-9  # relative gain of a round


def project(camera: Camera, points_m: Array, pose: Pose) -> tuple[Array, Array, Array]:
    """Pixels (N, 2) of places on a board, and their derivatives by the pose (2N, 6) and by fx, fy, cx, cy and the
    coefficients (2N, 8).
    """
    K = np.array([[camera.fx_px, 0.0, camera.cx_px], [0.0, camera.fy_px, camera.cy_px], [0.0, 0.0, 1.0]])
    uv, J = cv2.fisheye.projectPoints(points_m[None], *pose, K, np.array(camera.distortion))
    by_all = np.asarray(J, np.float64)
    return np.asarray(uv[0], np.float64), by_all[:, 8:14], by_all[:, :8]


def start(size_px: tuple[int, int], wide_rad: float) -> Camera:
    """An ideal fisheye so wide."""
    width, height = size_px
    f = width / wide_rad
    return Camera(width, height, f, f, (width - 1) / 2.0, (height - 1) / 2.0, (0.0,) * 4, FISHEYE)


def pose_of(camera: Camera, board: Board) -> Pose | None:
    """Where a board is, by its corners that have rays; None with too few of them."""
    rays, valid = camera.unproject(board[0])
    if np.count_nonzero(valid) < LEAST_CORNERS:
        return None
    try:
        _, rotation, place = cv2.solvePnP(board[1][valid], rays[valid, :2].copy(), np.eye(3), np.zeros(0))
    except cv2.error:
        return None
    found = np.asarray(rotation, float).ravel(), np.asarray(place, float).ravel()
    return found if np.all(np.isfinite(np.concatenate(found))) and found[1][2] > 0.0 else None


def refined(
    camera: Camera, boards: Sequence[Board], poses: Sequence[Pose], columns: Sequence[int]
) -> tuple[Camera, list[Pose], float]:
    """Levenberg's least squares by these of the camera's eight numbers and all poses, and the sum of squares, px^2."""
    cost, damping, best = _cost(camera, boards, poses), 1e-3, list(poses)
    for _ in range(ROUNDS):
        N, b = _normal_equations(camera, boards, best, columns)
        while damping < 1e8:
            step = np.asarray(np.linalg.solve(N + damping * np.diag(np.diag(N) + 1e-12), b), np.float64)
            moved, there = _stepped(camera, best, columns, step)
            reached = _cost(moved, boards, there)
            if reached <= cost:
                break
            damping *= 10.0
        else:
            break
        gained, camera, best, cost = (cost - reached) / max(cost, 1e-12), moved, there, reached
        damping = max(damping * 0.1, 1e-9)
        if gained < SETTLED:
            break
    return camera, best, cost


def _cost(camera: Camera, boards: Sequence[Board], poses: Sequence[Pose]) -> float:
    off = [uv - project(camera, points, pose)[0] for (uv, points), pose in zip(boards, poses, strict=True)]
    found = float(sum(np.sum(each**2) for each in off))
    return found if np.isfinite(found) else np.inf


def _normal_equations(
    camera: Camera, boards: Sequence[Board], poses: Sequence[Pose], columns: Sequence[int]
) -> tuple[Array, Array]:
    n = len(columns)
    N, b = np.zeros((n + 6 * len(boards),) * 2), np.zeros(n + 6 * len(boards))
    for k, ((uv, points), pose) in enumerate(zip(boards, poses, strict=True)):
        predicted, by_pose, by_camera = project(camera, points, pose)
        J, at = np.concatenate([by_camera[:, columns], by_pose], axis=1), np.r_[:n, n + 6 * k : n + 6 * k + 6]
        N[np.ix_(at, at)] += J.T @ J
        b[at] += J.T @ (uv - predicted).ravel()
    return N, b


def _stepped(camera: Camera, poses: Sequence[Pose], columns: Sequence[int], step: Array) -> tuple[Camera, list[Pose]]:
    numbers = np.array([camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px, *camera.distortion])
    numbers[list(columns)] += step[: len(columns)]
    fx, fy, cx, cy, *terms = numbers.tolist()
    by_pose = step[len(columns) :].reshape(-1, 6)
    there = [(turn + s[:3], place + s[3:]) for (turn, place), s in zip(poses, by_pose, strict=True)]
    return Camera(*camera.size_px, fx, fy, cx, cy, tuple(terms), FISHEYE), there
