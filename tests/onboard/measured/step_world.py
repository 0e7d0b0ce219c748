"""Ground with one flat roof above it, seen from an aircraft: pictures and sets whose truth is simple arithmetic."""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.feature_set import FeatureSet, Status
from contract.geodesy import LocalFrame
from contract.rotations import exp_so3
from onboard.events.kept_pictures import Kept

Array = NDArray[np.float64]

CAMERA = Camera(320, 240, 300.0, 300.0, 159.5, 119.5)
FISHEYE = Camera(320, 240, 150.0, 150.0, 159.5, 119.5, (-0.03, 0.01, -0.005, 0.001), "fisheye")  # 120 degrees wide
PLACE = LocalFrame(-43.38, 172.40, 0.0)
LOOKING_DOWN = np.diag([1.0, -1.0, -1.0])
HEIGHT_M, STEP_M = 100.0, 6.0
EPOCH_NS = 1_795_217_000_000_000_000
TEXEL_M, SIZE = 0.15, 1024
ROOF_M = (6.0, 4.0, 22.0, 20.0)  # west, south, east, north
CLICKED = 4  # the picture in the middle of nine
GRID = np.stack(np.meshgrid(np.arange(320.0), np.arange(240.0)), axis=-1)


@dataclass(frozen=True)
class World:
    """`roof_m` is the roof's height (0: none), `roof_at_m` where it is (as `ROOF_M`), `contrast` of its texture and the
    ground's, `stripe_m` how far the ground repeats itself (0: it does not), `plain_m` how far about the bright roof it
    has no texture. Poses in the sets are off by `pose_sigma`: metres and radians.
    """

    roof_m: float = 0.0
    roof_at_m: tuple[float, float, float, float] = ROOF_M
    contrast: float = 1.0
    stripe_m: float = 0.0
    plain_m: float = 0.0
    tilt_rad: float = 0.0
    feature_sigma: float = 5e-4  # relative, of inverse depth
    pose_sigma: tuple[float, float] = (0.15, 0.001)
    seed: int = 0
    camera: Camera = CAMERA

    def pose(self, number: int) -> tuple[Array, Array]:
        """R_enu_cam and centre (3,), ENU m."""
        rng = np.random.default_rng([self.seed, number])
        R = exp_so3(np.array([self.tilt_rad, 0.0, 0.0])) @ exp_so3(rng.normal(0.0, 0.01, 3)) @ LOOKING_DOWN
        back_m = HEIGHT_M * np.tan(self.tilt_rad)
        return R, np.array([(number - CLICKED) * STEP_M, -back_m, HEIGHT_M + rng.normal(0.0, 0.3)])

    def depths(self, number: int, uv_px: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Along the axis, of pixels (..., 2); the places (..., 3) and whether they are on the roof."""
        R, centre = self.pose(number)
        rays = self.camera.unproject(uv_px)[0] @ R.T
        depth = -centre[2] / rays[..., 2]
        roof = (self.roof_m - centre[2]) / rays[..., 2]
        at = centre + rays * roof[..., None]
        west, south, east, north = self.roof_at_m
        on = (at[..., 0] > west) & (at[..., 0] < east) & (at[..., 1] > south) & (at[..., 1] < north)
        on &= self.roof_m > 0.0
        depth = np.where(on, roof, depth)
        return depth, centre + rays * depth[..., None], on

    def image(self, number: int) -> NDArray[np.uint8]:
        """The picture (240, 320), with a sensor's noise."""
        return kept_image(self, number).copy()

    def draw(self, number: int) -> NDArray[np.uint8]:
        """The same, not kept."""
        _, at, on = self.depths(number, GRID)
        columns, rows = ((at[..., i] / TEXEL_M % (SIZE - 1)).astype(np.float32) for i in (0, 1))
        ground, roof = (
            cv2.remap(texture, columns, rows, cv2.INTER_LINEAR) for texture in textures(self.seed, self.stripe_m)
        )
        if self.plain_m:
            west, south, east, north = self.roof_at_m
            away_m = np.hypot(
                *(np.maximum(np.maximum(low - c, c - high), 0.0)
                  for c, low, high in ((at[..., 0], west, east), (at[..., 1], south, north)))
            )  # fmt: skip
            ground = ground * np.clip(away_m / self.plain_m - 1.0, 0.0, 1.0).astype(np.float32)
            roof = 0.4 * roof + 50.0
        noise = np.random.default_rng([self.seed, 8, number]).normal(0.0, 1.5, on.shape)
        return np.clip(np.rint(110.0 + self.contrast * np.where(on, roof, ground) + noise), 0, 255).astype(np.uint8)

    def kept(self, number: int) -> Kept:
        return Kept(self.image(number), self.its_set(number))

    def its_set(self, number: int) -> FeatureSet:
        """A picture's set: features all over it but on the roof, depths and poses with their errors."""
        rng = np.random.default_rng([self.seed, 9, number])
        uv = np.stack(np.meshgrid(np.linspace(16, 303, 10), np.linspace(16, 223, 8)), axis=-1).reshape(-1, 2).round()
        uv = uv[~self.depths(number, uv)[2]]
        depth, _, _ = self.depths(number, uv)
        w = (1.0 + self.feature_sigma * rng.standard_normal(len(uv))) / depth
        R, centre = self.pose(number)
        if number != CLICKED:
            centre = centre + rng.normal(0.0, self.pose_sigma[0], 3)
            R = exp_so3(rng.normal(0.0, self.pose_sigma[1], 3)) @ R
        lat, lon, height = (float(c) for c in PLACE.to_geodetic(centre))
        xy = self.camera.unproject(uv)[0][:, :2]
        plane = np.linalg.lstsq(np.column_stack([np.ones(len(uv)), xy]), w, rcond=None)[0]
        return FeatureSet(
            "uav-1", 5, number, EPOCH_NS + number * 10**9, Status.OK, self.camera, is_keyframe=number % 3 == 0,
            camera_lat_deg=lat, camera_lon_deg=lon, camera_height_m=height, undulation_m=0.0, R_enu_cam=R,
            common_cov=np.diag([0.5, 0.5, 0.8, 2e-3, 2e-3, 4e-3, 1e-3, 1e-3, 1e-3]) ** 2,
            plane_per_m=plane, plane_sigma_relative=0.02, roughness=0.005, uv_px=uv, inverse_depth_per_m=w,
            sigma_inverse_depth_per_m=np.full(len(uv), self.feature_sigma) * w,
        )  # fmt: skip


@lru_cache(maxsize=4)
def textures(seed: int, stripe_m: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Of the ground and of the roof, the same in all pictures of a world."""
    rng = np.random.default_rng([seed, 7])

    def texture() -> NDArray[np.float32]:
        if stripe_m:
            x = np.arange(SIZE) * TEXEL_M
            return np.asarray(np.tile(40.0 * np.sin(2.0 * np.pi * x / stripe_m), (SIZE, 1)), np.float32)
        noise = rng.normal(0.0, 1.0, (SIZE, SIZE)).astype(np.float32)
        fine, coarse = (cv2.GaussianBlur(noise, (0, 0), s) for s in (2.0, 8.0))
        return np.asarray(20.0 * fine / fine.std() + 15.0 * coarse / coarse.std(), np.float32)

    return texture(), texture()


@lru_cache(maxsize=128)
def kept_image(world: World, number: int) -> NDArray[np.uint8]:
    """A world's picture, kept for the next test."""
    return world.draw(number)


def others(world: World) -> list[Kept]:
    return [world.kept(n) for n in range(2 * CLICKED + 1) if n != CLICKED]
