"""A clicked pixel's patch in other pictures, at any depth and slope of its surface. (29.4)"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.rotations import skew
from onboard.measured.views import Grey, View, by_place, pixels, pixels_by_camera, rays_by_camera

Array = NDArray[np.float64]
Values = NDArray[np.float32]
Mask = NDArray[np.bool_]

HALF_PX = 7  # a patch is a square of 15 pixels about the click
SIDE_PX = 2 * HALF_PX + 1
_GRID = np.arange(-HALF_PX, HALF_PX + 1.0)
OFFSETS = np.stack(np.meshgrid(_GRID, _GRID), axis=-1).reshape(-1, 2)  # (225, 2)
_HOMOGENEOUS = np.ascontiguousarray(np.column_stack([OFFSETS, np.ones(len(OFFSETS))]).T)
_FIVE = np.array([[0.0, 0.0], [HALF_PX, 0.0], [-HALF_PX, 0.0], [0.0, HALF_PX], [0.0, -HALF_PX]])
BORDER_PX = 1.0


@dataclass(frozen=True, eq=False)
class Patch:
    """The pixels about a click: five rays (5, 3) at depth one (its own, right, left, below, above), values (225,), and
    how its own ray moves with the camera's errors (2, 5).
    """

    rays: Array
    values: Values
    by_camera: Array

    @classmethod
    def at(cls, image: Grey, camera: Camera, uv_px: Array) -> Patch | None:
        """None where it would reach over the picture's border, or the lens is not calibrated."""
        rays, valid = camera.unproject(uv_px + _FIVE)
        low, high = uv_px - HALF_PX, uv_px + HALF_PX
        if not valid.all() or low.min() < BORDER_PX or (high > np.array(image.shape[::-1]) - 1.0 - BORDER_PX).any():
            return None
        return cls(rays, _values(image, (uv_px + OFFSETS)[None])[0], rays_by_camera(camera, rays[:1, :2])[0])

    @cached_property
    def by_offset(self) -> Array:
        """x, y (225, 2) of the rays from the click's."""
        by_pixel = np.stack([self.rays[1] - self.rays[2], self.rays[3] - self.rays[4]])[:, :2] / (2.0 * HALF_PX)
        return np.asarray(OFFSETS @ by_pixel, float)


def middles(patch: Patch, view: View, w: Array) -> Array:
    """Pixels (K, 2) of the click in a view if it has inverse depths w (K,). (29.1)"""
    return pixels(view.camera, (patch.rays[0] - w[:, None] * view.centre_m) @ view.R.T)


def places(patch: Patch, view: View, w: Array, slope: Array) -> tuple[Array, Mask]:
    """Return the patch's pixels (K, 225, 2) in a view if its middle has inverse depths w (K,), and which of these
    patches lie within the picture (K,).

    `slope` (2,): of the surface, d ln w / d (x, y). An affine map of the pixels by its five rays. (29.4)
    """
    w5 = w[:, None] * (1.0 + (patch.rays[:, :2] - patch.rays[0, :2]) @ slope)
    five = pixels(view.camera, (patch.rays - w5[..., None] * view.centre_m) @ view.R.T)  # (K, 5, 2)
    A = np.stack([five[:, 1] - five[:, 2], five[:, 3] - five[:, 4]], axis=-1) / (2.0 * HALF_PX)
    size = np.array([view.image.shape[1], view.image.shape[0]])
    reach = np.abs(A).sum(axis=2) * HALF_PX
    inside = (five[:, 0] - reach > BORDER_PX).all(axis=1) & (five[:, 0] + reach < size - 1.0 - BORDER_PX).all(axis=1)
    at = np.concatenate([A, five[:, 0, :, None]], axis=2).reshape(-1, 3) @ _HOMOGENEOUS  # (2 K, 225)
    return at.reshape(len(w), 2, -1).transpose(0, 2, 1), inside


def warped(patch: Patch, view: View, w: Array, slope: Array) -> tuple[Values, Mask]:
    """The view's grey values (K, 225) at `places`, and which of these patches are whole (K,)."""
    at, inside = places(patch, view, w, slope)
    return _values(view.image, at), inside


def shifted(patch: Patch, view: View, w: float, slope: Array) -> tuple[Values, Array]:
    """The view's values (225,) at one depth, and how they change for a pixel that they are taken further right and
    down (225, 2).
    """
    at, _ = places(patch, view, np.array([w]), slope)
    steps = np.array([[0.0, 0.0], [0.5, 0.0], [-0.5, 0.0], [0.0, 0.5], [0.0, -0.5]])
    five = _values(view.image, at + steps[:, None])
    return five[0], np.stack([five[1] - five[2], five[3] - five[4]], axis=1).astype(float)


def by_inverse_depth(patch: Patch, view: View, w: float) -> Array:
    """The derivative (2,) of the click's pixel in a view by its inverse depth. (29.1)"""
    _, by_q = _by_direction(patch, view, w)
    return np.asarray(by_q @ (-view.R @ view.centre_m), float)


def by_view(patch: Patch, view: View, w: float) -> tuple[Array, Array]:
    """Return derivatives of the click's pixel in a view: (2, 6) by the view's pose, (2, 5) by the camera's errors."""
    q, by_q = _by_direction(patch, view, w)
    by_pose = by_q @ np.concatenate([-skew(q), -w * np.eye(3)], axis=1)
    return by_pose, pixels_by_camera(view.R, q[None], patch.by_camera, view.camera)[0]


def _by_direction(patch: Patch, view: View, w: float) -> tuple[Array, Array]:
    """Return the direction q (3,) of the click in a view, and its pixel's derivative (2, 3) by that."""
    q = view.R @ (patch.rays[0] - w * view.centre_m)
    x = q[:2] / q[2]
    return q, by_place(view.camera, x[None])[0] @ np.array([[1.0, 0.0, -x[0]], [0.0, 1.0, -x[1]]]) / q[2]


def _values(image: Grey, at: Array) -> Values:
    """Grey values at pixels (K, N, 2), bilinear; only the part of the picture about them is turned into floats."""
    x, y = np.ascontiguousarray(at[..., 0], np.float32), np.ascontiguousarray(at[..., 1], np.float32)
    (left, columns), (top, rows) = (_reach(c, size) for c, size in ((x, image.shape[1]), (y, image.shape[0])))
    part = image[rows, columns].astype(np.float32)
    return np.asarray(cv2.remap(part, x - np.float32(left), y - np.float32(top), cv2.INTER_LINEAR), np.float32)


def _reach(c: Values, size: int) -> tuple[int, slice]:
    """Return the first of the pixels between which coordinates lie, along an axis of so many, and all of them."""
    first = min(max(int(c.min()), 0), size - 1)
    return first, slice(first, min(max(int(c.max()) + 2, first + 1), size))
