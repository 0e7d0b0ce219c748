"""Pictures of the synthetic ground: one ray a pixel, then the sensor's faults (blur, vignetting, exposure, noise)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.errors import InputError
from contract.lens import MIN_DETERMINANT
from simulation.movers import Movers
from simulation.raster import look_up
from simulation.terrain import Terrain
from simulation.texture import Texture
from simulation.trajectory import Pose

Array = NDArray[np.float64]
Image = NDArray[np.float32]
Grey = NDArray[np.uint8]

LATTICE_PX = 4
MAX_DEPTH_M = 2e4
HAZE_M = 9000.0
# How far the texture of what stands on the ground moves, east and north, with its height: so that roofs have textures
# of their own, and walls one that changes with the height.
BY_LIFT = np.array([1.7, -2.3], np.float32)
SKY = 0.78
SUN_ENU = np.array([-0.45, 0.35, 0.82]) / np.linalg.norm([-0.45, 0.35, 0.82])
MAX_SUB_EXPOSURES = 16
# Rows (N,) of a picture -> where each looks from: R_enu_cam (N, 3, 3) and centres (N, 3).
RowPoses = Callable[[Array], tuple[Array, Array]]


@dataclass(frozen=True)
class SensorSpec:
    """The camera's faults. `noise` is one sigma in grey levels at mid-grey; `vignetting` the corner's loss of light.

    `exposure_swing` is the ratio between the brightest and darkest rendering of one scene as the automatic exposure
    varies slowly (1: constant); `exposure_s` the time the shutter is open.
    """

    noise: float = 1.5
    vignetting: float = 0.15
    exposure_swing: float = 1.15
    exposure_s: float = 0.002

    def __post_init__(self) -> None:
        if self.noise < 0 or not 0 <= self.vignetting < 1 or self.exposure_swing < 1 or not 0 <= self.exposure_s <= 1:
            raise InputError(
                "sensor: noise must not be negative, vignetting lie in 0..1, exposure swing be at least 1 "
                "and exposure time lie in 0..1 s"
            )


class View(NamedTuple):
    """The ground behind each pixel (H, W), float32: `east_m` and `north_m` from the camera, `depth_m` along its axis.

    `distance_m` is along the ray, `footprint_m` the ground's side of one pixel, `shade` how sunlit the ground is.
    """

    east_m: Image
    north_m: Image
    depth_m: Image
    distance_m: Image
    footprint_m: Image
    shade: Image
    is_seen: NDArray[np.bool_]
    lift_m: Image | None = None  # of what stands on the ground, in a world of raster


def _by_distorted(camera: Camera, rays: Array, moved: Array) -> Array:
    """How far rays' undistorted coordinates (..., 2) move where their distorted ones move so far (..., 2)."""
    _, along, cross = camera.lens.linearised(rays[..., :2].reshape(-1, 2).T)
    off = moved.reshape(-1, 2).T
    det = along[0] * along[1] - cross * cross
    det = np.where(np.abs(det) < MIN_DETERMINANT, MIN_DETERMINANT, det)
    out: Array = ((along[::-1] * off - cross * off[::-1]) / det).T.reshape(moved.shape)
    return out


class Renderer:
    """Draws what a camera sees. Keeps the camera's rays; every picture is a function of its pose, time and seed."""

    def __init__(
        self,
        camera: Camera,
        terrain: Terrain,
        texture: Texture,
        sensor: SensorSpec,
        seed: int = 0,
        movers: Movers | None = None,
    ) -> None:
        self.camera, self.terrain, self.texture, self.sensor = camera, terrain, texture, sensor
        self._seed, self._movers = seed, movers
        width, height = camera.size_px
        grid = np.stack(np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float)), axis=-1)
        rays, valid = camera.unproject(grid)
        # Where the calibration folds back there is no ray: the lens hood, black.
        self._dark = None if valid.all() else ~valid
        self._rays_cam = rays[..., :2].astype(np.float32)
        stride = 1 if terrain.has_obstacles else LATTICE_PX
        grown = np.sqrt(np.maximum(np.abs(camera.area_gain(rays[..., :2].reshape(-1, 2))), MIN_DETERMINANT))
        self._pixel = (1.0 / (camera.focal_px * grown.reshape(height, width))).astype(np.float32)  # undistorted side
        self._stride = stride
        columns = np.arange(0, width - 1 + stride, stride, dtype=float)
        rows = np.arange(0, height - 1 + stride, stride, dtype=float)
        lattice = np.stack(np.meshgrid(columns, rows), axis=-1)
        inside = np.minimum(lattice, np.array([width - 1.0, height - 1.0]))
        edge, _ = camera.unproject(inside)
        # Rays of the lattice's last column and row, past the picture, by the slope at its edge.
        edge[..., :2] += _by_distorted(camera, edge, (lattice - inside) / np.array([camera.fx_px, camera.fy_px]))
        self._lattice_cam = edge
        self._lattice_map = (grid / stride).astype(np.float32)
        r2 = np.sum((grid - [(width - 1) / 2, (height - 1) / 2]) ** 2, axis=-1) / (width**2 + height**2) * 4.0
        self._falloff = (1.0 - sensor.vignetting * r2).astype(np.float32)

    def picture(
        self, poses: list[Pose], gain: float, frame: int, time_s: float = 0.0, rows: list[RowPoses] | None = None
    ) -> Grey:
        """One picture (H, W) uint8: the mean over `poses` within the exposure, lit by `gain`, with its own noise.

        `rows`: for each of the poses those of every row, where they are exposed one after the other.
        """
        light = self.radiance(poses[0], time_s, rows[0] if rows else None)
        for i, pose in enumerate(poses[1:], start=1):
            light = light + self.radiance(pose, time_s, rows[i] if rows else None)
        light = light * (self._falloff * np.float32(gain / len(poses)))
        # A camera's tone curve: steep in the dark, gentle in the light.
        grey = np.float32(255.0) * np.sqrt(np.clip(light, 0.0, 1.0))
        rng = np.random.default_rng([self._seed, 303, frame])
        if self.sensor.noise > 0.0:
            grey += np.float32(self.sensor.noise) * rng.standard_normal(grey.shape, dtype=np.float32)
        out: Grey = np.clip(np.rint(grey), 0, 255).astype(np.uint8)
        if self._dark is not None:
            out[self._dark] = 0
        return out

    def radiance(self, pose: Pose, time_s: float = 0.0, rows: RowPoses | None = None) -> Image:
        """Light (H, W), float32, 0 to about 1, reaching an ideal sensor at one instant, or each row from its own pose.

        `pose` is then that of the middle row.
        """
        v = self.view(pose, rows)
        east, north = v.east_m, v.north_m
        if v.lift_m is not None:
            east, north = east + BY_LIFT[0] * v.lift_m, north + BY_LIFT[1] * v.lift_m
        light = self.texture.albedo(pose.centre_m[:2], east, north, v.footprint_m, time_s) * v.shade
        if self._movers is not None:
            self._movers.paint(light, pose, v.east_m, v.north_m, v.footprint_m, time_s)
        if not v.is_seen.all() or float(v.depth_m.max()) > 0.15 * HAZE_M:
            clear = np.exp(-v.distance_m * np.float32(1.0 / HAZE_M)) * v.is_seen
            light = light * clear + np.float32(SKY) * (np.float32(1.0) - clear)
        return light

    def view(self, pose: Pose, rows: RowPoses | None = None) -> View:
        """Find the ground each pixel looks at, from one pose, or each row from its own; `pose`: the middle row's."""
        ground_m, shade, lift = self._surface(pose, rows)
        R, moved = pose.R_enu_cam.astype(np.float32), np.zeros(3, np.float32)
        if rows is not None:
            R_rows, centres = rows(np.arange(self.camera.height_px, dtype=float))
            # (3, 3, H, 1) and (3, H, 1): every row of pixels has its own.
            R = R_rows.transpose(1, 2, 0)[..., None].astype(np.float32)
            moved = (centres - pose.centre_m).T[..., None].astype(np.float32)
        x, y = self._rays_cam[..., 0], self._rays_cam[..., 1]
        down = R[2, 0] * x + R[2, 1] * y + R[2, 2]
        rise = ground_m - np.float32(pose.centre_m[2]) - moved[2]
        seen = (down < -1e-6) & (rise < 0.0)
        depth = np.where(seen, rise / np.where(seen, down, np.float32(-1.0)), np.float32(MAX_DEPTH_M))
        seen &= depth < MAX_DEPTH_M
        np.minimum(depth, np.float32(MAX_DEPTH_M), out=depth)
        east = (R[0, 0] * x + R[0, 1] * y + R[0, 2]) * depth + moved[0]
        north = (R[1, 0] * x + R[1, 1] * y + R[1, 2]) * depth + moved[1]
        length = np.sqrt(x * x + y * y + np.float32(1.0))
        slant = length / np.maximum(-down, np.float32(0.02))
        footprint = depth * self._pixel * slant ** np.float32(0.75)
        return View(east, north, depth, depth * length, footprint, shade, seen, lift)

    def _surface(self, pose: Pose, rows: RowPoses | None) -> tuple[Image, Image, Image | None]:
        """Height of the ground each pixel sees (H, W), m, how sunlit it is, and in a world of raster its lift.

        The height is cast on a lattice and interpolated: unlike depth it is smooth, and on level ground constant.
        """
        if rows is None:
            rays = (self._lattice_cam @ pose.R_enu_cam.T).reshape(-1, 3)
            depth, hit = self.terrain.cast(pose.centre_m, rays, MAX_DEPTH_M)
            points = pose.centre_m + rays * np.where(hit, depth, 0.0)[:, None]
        else:
            R_rows, centres = rows(np.arange(len(self._lattice_cam), dtype=float) * self._stride)
            rays = self._lattice_cam @ R_rows.transpose(0, 2, 1)
            cast = [self.terrain.cast(c, r, MAX_DEPTH_M) for c, r in zip(centres, rays, strict=True)]
            depth, hit = np.stack([d for d, _ in cast]), np.stack([h for _, h in cast]).reshape(-1)
            points = centres[:, None] + rays * np.where(np.isfinite(depth), depth, 0.0)[..., None]
            points = np.where(hit[:, None], points.reshape(-1, 3), np.repeat(centres, rays.shape[1], axis=0))
        height = np.where(hit, points[:, 2], 0.0)
        if hit.any():
            height[~hit] = height[hit].min()
        slope = self.terrain.slope(points[:, 0], points[:, 1])
        shade = self.sunlit(slope)
        # Roofs and tree crowns differ from the ground next to them, each a little from the next.
        lift = self.terrain.obstacle_m(points[:, 0], points[:, 1])
        if self.terrain.raster is None:
            shade = shade * np.where(lift > 0.0, 0.55 + 0.25 * np.modf(lift * 3.7)[0] + 0.05 * lift, 1.0)
        else:
            shade = shade * look_up(self.terrain.raster.paint, points[:, 0], points[:, 1])
        shape = self._lattice_cam.shape[:2]
        height32, shade32 = height.reshape(shape).astype(np.float32), shade.reshape(shape).astype(np.float32)
        if self._stride == 1:
            at = slice(self.camera.height_px), slice(self.camera.width_px)
            is_raster = self.terrain.raster is not None
            return height32[at], shade32[at], lift.reshape(shape).astype(np.float32)[at] if is_raster else None
        u, v = self._lattice_map[..., 0], self._lattice_map[..., 1]
        both = cv2.remap(np.dstack([height32, shade32]), u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(both[..., 0], np.float32), np.asarray(both[..., 1], np.float32), None

    @staticmethod
    def sunlit(slope: Array) -> Array:
        """The light (N,) that falls on slopes (N, 2), as a multiple of what level ground gets."""
        normal = np.concatenate([-slope, np.ones((len(slope), 1))], axis=1)
        out: Array = (normal @ SUN_ENU) / np.linalg.norm(normal, axis=1) / SUN_ENU[2]
        return out
