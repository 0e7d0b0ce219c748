"""The errors that all features of a clicked picture have in common, and what its views show of them. (29.14)

Common errors are eight: the modes (1, x, y) of the depths' logarithms, and the camera's five errors, which are the same
in all pictures. The set's depths were adjusted with the camera as it is, and so are bent by its errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from onboard.geometry import camera_errors

Array = NDArray[np.float64]

MODES = 3  # of a set's depths: (1, x, y)
COMMON = MODES + camera_errors.COUNT
POSE = 6
GAUGE = 1e-9  # of a pose's information: the views alone do not know the scale
LEAST_FREE = 0.1  # of the measurements, beyond the unknowns that they determine


@dataclass(frozen=True, eq=False)
class Shown:
    """The dependence of one view's pixels of the N features on its pose, on their depths and on the camera's errors.

    `X` (N, 2, 12) are a pixel's derivatives by the pose and the camera, and what is left of it, `z` (N, 2) that by the
    logarithm of its depth, both in sigmas of the pixels' noise; zero for a feature that was not found. The pose that
    was solved moves by `by_log` (6, N) with these logarithms, and by `by_camera` (6, 5).
    """

    X: Array
    z: Array
    by_log: Array
    by_camera: Array

    @classmethod
    def of(cls, by: tuple[Array, Array, Array], left: Array, whiten: Array, gain: Array) -> Shown:
        """Return it from derivatives `by` pose (N, 2, 6), depth (N, 2) and camera (N, 2, 5), what is `left` (N, 2), the
        matrices that take that to sigmas of its noise (N, 2, 2), and the pose's `gain` (6, N, 2) by pixels, zero where
        a feature is left out.
        """
        by_pose, by_depth, by_camera = by
        X = np.concatenate([by_pose, by_camera, left[:, :, None], by_depth[:, :, None]], axis=2)
        white = whiten @ X
        white[~gain.any(axis=(0, 2))] = 0.0
        moved = gain.reshape(POSE, -1) @ by_camera.reshape(-1, camera_errors.COUNT)
        return cls(white[:, :, :-1], white[:, :, -1], -(gain * by_depth).sum(axis=2), -moved)

    def spread(self, rows: NDArray[np.intp], count: int) -> Shown:
        """Return that of `count` features, of which these are the `rows`."""
        X, z, by_log = np.zeros((count, *self.X.shape[1:])), np.zeros((count, 2)), np.zeros((POSE, count))
        X[rows], z[rows], by_log[:, rows] = self.X, self.z, self.by_log
        return Shown(X, z, by_log, self.by_camera)


@dataclass(frozen=True, eq=False)
class Common:
    """The common errors as far as they are known: their estimate (8,), its covariance (8, 8) if the features' errors
    are as stated, and how far each feature moves it (N, 8); and how each view's pose moves with them (V, 6, 8).
    """

    estimate: Array
    covariance: Array
    by_feature: Array
    by_pose: Array

    def variance(self, way: Array) -> float:
        """Return the estimate's variance along a way (8,): the stated one, or more if the features scatter more.
        (29.15)
        """
        stated = float(way @ self.covariance @ way)
        return max(stated, float(((self.by_feature @ way) ** 2).sum()), 0.0)


def in_common(shown: Sequence[Shown], modes: Array, variance: Array, prior: Array, is_adjusted: bool = True) -> Common:
    """Return what views show of the common errors. (29.14)

    `modes` (N, 3): H of the features, `variance` (N,) of the logarithm of each one's depth, the same in all views;
    `prior` (8, 8): the common errors' covariance; depths that are not `is_adjusted` by pictures do not bend.
    """
    X, z = np.stack([each.X for each in shown]), np.stack([each.z for each in shown])
    bend = bent(shown, modes, variance) if is_adjusted else np.zeros((len(modes), camera_errors.COUNT))
    field = np.concatenate([modes, bend], axis=1)
    # A common error n moves a pixel by z (H, bend) n and, of the camera, of itself.
    Z = z[..., None] * field[:, None]
    Z[..., MODES:] += X[..., POSE:-1]
    both = np.concatenate([Z, X[..., -1:]], axis=3)
    N, followed, along, depth = _poses_out(X[..., :POSE], both, z, 1.0 / variance)
    known = np.linalg.solve(np.eye(COMMON) + prior @ N[:-1, :-1], prior)
    known = 0.5 * (known + known.T)
    estimate = -known @ N[:-1, -1]
    to = np.append(estimate, 1.0)
    left = both @ to + (X[..., :POSE] @ (followed @ to)[:, None, :, None])[..., 0]
    left -= z * ((along @ np.append((followed @ to).ravel(), to)) / depth)[:, None]
    # Each feature's score, of all views at once: what it is off by lasts from view to view.
    score = (Z * left[..., None]).sum(axis=(0, 2))
    score += np.einsum("vnik,vni,vkm->nm", X[..., :POSE], left, followed[..., :-1], optimize=True)
    count = 2 * int((z != 0.0).any(axis=2).sum()) - int(_found(z).sum())
    free = max(1.0 - (POSE * len(shown) + COMMON) / max(count, 1), LEAST_FREE)
    by_pose = np.stack(
        [np.concatenate([each.by_log @ modes, each.by_camera + each.by_log @ bend], 1) for each in shown]
    )
    return Common(estimate, known, score @ known / free, by_pose)


def bent(shown: Sequence[Shown], modes: Array, variance: Array) -> Array:
    """Return how the features' logarithms follow the camera's errors beyond the modes (N, 5): as those of an adjustment
    of these views do, in which poses and depths are free. (29.14)
    """
    X, z = np.stack([each.X for each in shown]), np.stack([each.z for each in shown])
    _, followed, along, depth = _poses_out(X[..., :POSE], X[..., POSE:-1], z, np.full(len(modes), 1e-12))
    bend = -(along[:, len(X) * POSE :] + along[:, : len(X) * POSE] @ followed.reshape(len(X) * POSE, -1))
    found = _found(z)
    bend = np.where(found[:, None], bend / depth[:, None], 0.0)
    weighted = modes.T * (found / variance)
    N = weighted @ modes
    fit = np.linalg.solve(N + GAUGE * N.trace() * np.eye(MODES), weighted @ bend)
    return np.where(found[:, None], bend - modes @ fit, 0.0)


def _found(z: Array) -> NDArray[np.bool_]:
    """The mask (N,) of the features that any view has."""
    return np.asarray((z != 0.0).any(axis=(0, 2)), bool)


def _poses_out(by_pose: Array, others: Array, z: Array, known: Array) -> tuple[Array, Array, Array, Array]:
    """The normal matrix (K, K) of `others` (V, N, 2, K) with poses and depths unknown; how the poses follow these
    (V, 6, K), the depths' products with poses and others (N, 6 V + K), and the depths' own information (N,), of which
    `known` (N,) is there before.
    """
    views, poses, K = len(z), POSE * len(z), others.shape[3]
    depth = (z * z).sum(axis=(0, 2)) + known
    along = np.concatenate([
        (by_pose * z[..., None]).sum(axis=2).transpose(1, 0, 2).reshape(len(known), -1),
        (others * z[..., None]).sum(axis=(0, 2)),
    ], axis=1)  # fmt: skip
    N = -along.T @ (along / depth[:, None])
    flat, rest = by_pose.reshape(views, -1, POSE), others.reshape(views, -1, K)
    own, cross = flat.transpose(0, 2, 1) @ flat, flat.transpose(0, 2, 1) @ rest
    for number in range(views):
        rows = slice(POSE * number, POSE * (number + 1))
        N[rows, rows] += own[number]
    N[:poses, poses:] += cross.reshape(poses, K)
    N[poses:, poses:] += (rest.transpose(0, 2, 1) @ rest).sum(axis=0)
    scale = np.sqrt(np.maximum(np.diag(N)[:poses], 1e-300))
    scaled = N[:poses, :poses] / scale[:, None] / scale + GAUGE * np.eye(poses)
    followed = -np.linalg.solve(scaled, N[:poses, poses:] / scale[:, None]) / scale[:, None]
    left = N[poses:, poses:] + N[:poses, poses:].T @ followed
    return left, followed.reshape(views, POSE, K), along, depth
