"""Photographs of a calibration board, rendered through a known camera with its distortion."""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from onboard.calibration.board import Board

Array = NDArray[np.float64]
_SQUARE_PX = 60
_FINE = 2  # rays across each pixel


@dataclass(frozen=True)
class Pose:
    """The board's middle at (x, y, z) metres before the camera, turned by a rotation vector."""

    turn_rad: tuple[float, float, float]
    middle_cam_m: tuple[float, float, float]


@lru_cache(maxsize=2)
def _rays(camera: Camera) -> Array:
    """Of every fine pixel; a second of work for a lens with distortion."""
    width, height = camera.size_px
    offsets = (np.arange(_FINE) + 0.5) / _FINE - 0.5
    u = (np.arange(width)[:, None] + offsets).ravel()
    v = (np.arange(height)[:, None] + offsets).ravel()
    return camera.unproject(np.stack(np.meshgrid(u, v), axis=-1))[0]


class Photographer:
    """Renders one board through one camera."""

    def __init__(self, camera: Camera, board: Board, seed: int = 0) -> None:
        self.camera, self.board = camera, board
        self.rng = np.random.default_rng(seed)
        self._texture = np.pad(board.picture(_SQUARE_PX), _SQUARE_PX, constant_values=235)
        self._rays = _rays(camera)

    def photograph(self, pose: Pose, noise: float = 2.0) -> NDArray[np.uint8]:
        """One picture (H, W)."""
        R_cam_board = np.asarray(cv2.Rodrigues(np.array(pose.turn_rad))[0])
        square = self.board.square_m
        middle_board_m = np.array([self.board.columns, self.board.rows, 0.0]) * square / 2.0
        corner_cam_m = np.array(pose.middle_cam_m) - R_cam_board @ middle_board_m
        # A ray meets the board where R^T (s ray - corner) has no depth.
        normal = R_cam_board[:, 2]
        along = (normal @ corner_cam_m) / (self._rays @ normal)
        xy_m = (along[..., None] * self._rays - corner_cam_m) @ R_cam_board[:, :2]
        at_px = (xy_m / square * _SQUARE_PX - 0.5 + _SQUARE_PX).astype(np.float32)
        fine = cv2.remap(self._texture, at_px[..., 0], at_px[..., 1], cv2.INTER_LINEAR, borderValue=120)
        height, width = self.camera.height_px, self.camera.width_px
        grey = fine.reshape(height, _FINE, width, _FINE).mean(axis=(1, 3))
        shaded = 20.0 + 0.8 * grey + self.rng.normal(0.0, noise, grey.shape)
        return np.rint(shaded).clip(0, 255).astype(np.uint8)


def poses_all_over(count: int, seed: int, tilt_rad: float = 0.6, distance_m: float = 0.33) -> list[Pose]:
    """Boards all over the picture and beyond its edges, leaning in every direction."""
    rng = np.random.default_rng(seed)
    poses = []
    for number in range(count):
        column, row = number % 3 - 1, number // 3 % 3 - 1
        z = distance_m * rng.uniform(0.85, 1.25)
        x, y = 0.24 * z * column + rng.normal(0, 0.01), 0.18 * z * row + rng.normal(0, 0.01)
        angle = rng.uniform(0, 2 * np.pi)
        lean = tilt_rad * rng.uniform(0.4, 1.0)
        turn = (lean * np.cos(angle), lean * np.sin(angle), rng.uniform(-0.3, 0.3))
        poses.append(Pose(turn, (x, y, z)))
    return poses
