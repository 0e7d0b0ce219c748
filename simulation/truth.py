"""The truth of a flight: the ground point behind any pixel of any picture, and the pixel of any ground point."""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contract.camera import Camera
from contract.errors import InputError
from contract.geodesy import LocalFrame
from contract.rotations import matrix_from_quaternion, quaternion_from_matrix
from simulation.rows import RowsOf
from simulation.terrain import Terrain, TerrainSpec
from simulation.trajectory import Pose, axes_from_local

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

TRUTH_COLUMNS = (
    "file", "unix_time_s", "lat_deg", "lon_deg", "height_amsl_m", "height_ellipsoid_m",
    "q_enu_cam_w", "q_enu_cam_x", "q_enu_cam_y", "q_enu_cam_z",
)  # fmt: skip
CLICK_COLUMNS = ("frame", "u", "v", "lat_deg", "lon_deg", "height_amsl_m")
HORIZON_LIMIT_M = 5000.0


@dataclass(frozen=True, eq=False)
class GroundPoints:
    """Ground points (N,): degrees, metres; `is_valid` is False where a ray meets no ground.

    `enu_m` (N, 3) is about the session's origin.
    """

    enu_m: Array
    lat_deg: Array
    lon_deg: Array
    height_amsl_m: Array
    height_ellipsoid_m: Array
    is_valid: Mask


@dataclass(frozen=True, eq=False)
class Optics:
    """The exposure of rows, and the camera and the moment (s after the epoch) of each picture."""

    rows: RowsOf
    cameras: list[Camera]
    times_s: Array


class Truth:
    """The poses of a session's pictures over its terrain. `frame` counts pictures in capture order from 0.

    `optics`: where rows are exposed one after the other, or the camera is another one in each picture.
    """

    def __init__(
        self,
        camera: Camera,
        terrain: Terrain,
        origin: LocalFrame,
        undulation_m: float,
        poses: list[Pose],
        files: list[str],
        unix_time_s: ArrayLike,
        optics: Optics | None = None,
    ) -> None:
        self.optics = optics
        self.camera, self.terrain, self.origin, self.undulation_m = camera, terrain, origin, undulation_m
        self.poses, self.files = poses, files
        self.unix_time_s = np.asarray(unix_time_s, float)

    def __len__(self) -> int:
        return len(self.poses)

    def ground(self, frame: int, uv_px: ArrayLike) -> GroundPoints:
        """The ground point each pixel (N, 2) of a picture shows."""
        uv = np.asarray(uv_px, float).reshape(-1, 2)
        pose = self.poses[frame]
        if self.optics is None:
            rays, valid = self.camera.unproject(uv)
            centre, directions = pose.centre_m, rays @ pose.R_enu_cam.T
            depth, hit = self.terrain.cast(centre, directions, HORIZON_LIMIT_M)
        else:
            camera, time_s = self.optics.cameras[frame], float(self.optics.times_s[frame])
            _, valid = camera.unproject(uv)
            directions, centre = self.optics.rows.rays(camera, time_s, uv)
            each = [self.terrain.cast(c, d[None], HORIZON_LIMIT_M) for c, d in zip(centre, directions, strict=True)]
            depth, hit = np.array([d[0] for d, _ in each]), np.array([h[0] for _, h in each], bool)
        valid = valid & hit
        enu = centre + directions * np.where(valid, depth, 0.0)[:, None]
        lat, lon, height = self.origin.to_geodetic(enu).T
        return GroundPoints(enu, lat, lon, height - self.undulation_m, height, valid)

    def project(self, frame: int, enu_m: ArrayLike) -> tuple[Array, Mask]:
        """Pixels (N, 2) of ENU points (N, 3) in a picture, and whether each is on it, hidden or not."""
        pose, optics = self.poses[frame], self.optics
        if optics is not None:
            return optics.rows.pixels(optics.cameras[frame], float(optics.times_s[frame]), np.asarray(enu_m, float))
        return self.camera.project((np.asarray(enu_m, float) - pose.centre_m) @ pose.R_enu_cam)

    def sees(self, frame: int, enu_m: ArrayLike, tolerance_m: float = 0.05) -> Mask:
        """Mask (N,) of the ground points (N, 3) that are on a picture and visible, with no hill or wall between."""
        points = np.asarray(enu_m, float)
        _, on_picture = self.project(frame, points)
        rays = points - self.poses[frame].centre_m
        depth, hit = self.terrain.cast(self.poses[frame].centre_m, rays, 2.0)
        short_m = np.abs(np.where(hit, depth, 0.0) - 1.0) * np.linalg.norm(rays, axis=1)
        plain: Mask = on_picture & hit & (short_m < tolerance_m)
        return plain

    def camera_geodetic(self, frame: int) -> tuple[float, float, float]:
        """Latitude, longitude (deg) and ellipsoidal height (m) of the camera."""
        lat, lon, height = self.origin.to_geodetic(self.poses[frame].centre_m)
        return float(lat), float(lon), float(height)

    def R_local_cam(self, frame: int) -> Array:
        """R_enu_cam with the ENU axes at the camera's own latitude and longitude, as a FeatureSet has it."""
        lat, lon, _ = self.camera_geodetic(frame)
        out: Array = axes_from_local(self.origin, lat, lon)[0].T @ self.poses[frame].R_enu_cam
        return out

    def write(self, folder: Path, clicks_per_frame: int, seed: int) -> None:
        """Write truth.csv, truth_clicks.csv and world.json, from which `load` makes this object again."""
        with (folder / "truth.csv").open("w", newline="") as file:
            rows = csv.writer(file, lineterminator="\n")
            rows.writerow(TRUTH_COLUMNS)
            for frame, (name, time) in enumerate(zip(self.files, self.unix_time_s, strict=True)):
                lat, lon, height = self.camera_geodetic(frame)
                q = quaternion_from_matrix(self.R_local_cam(frame))
                place = [f"{lat:.10f}", f"{lon:.10f}", f"{height - self.undulation_m:.5f}", f"{height:.5f}"]
                rows.writerow([name, f"{time:.6f}", *place, *(f"{c:.12f}" for c in q)])
        with (folder / "truth_clicks.csv").open("w", newline="") as file:
            rows = csv.writer(file, lineterminator="\n")
            rows.writerow(CLICK_COLUMNS)
            rng = np.random.default_rng([seed, 606])
            for frame in range(len(self)):
                uv = np.round(rng.uniform(0.0, 1.0, (clicks_per_frame, 2)) * np.subtract(self.camera.size_px, 1), 2)
                points = self.ground(frame, uv)
                for k in np.flatnonzero(points.is_valid):
                    place = [f"{points.lat_deg[k]:.10f}", f"{points.lon_deg[k]:.10f}", f"{points.height_amsl_m[k]:.4f}"]
                    rows.writerow([frame, f"{uv[k, 0]:.2f}", f"{uv[k, 1]:.2f}", *place])
        world = {
            "origin": [self.origin.lat_deg, self.origin.lon_deg, self.origin.height_m],
            "undulation_m": self.undulation_m,
            "terrain": vars(self.terrain.spec),
        }
        if self.optics is not None:
            world["moves"] = True
        (folder / "world.json").write_text(json.dumps(world, indent=1) + "\n")

    @classmethod
    def load(cls, folder: Path | str) -> Truth:
        """Read a session written by `simulation.session.fly`; raises InputError naming the file that is wrong.

        Not one whose rows or optics move, or whose camera file is wrong.
        """
        folder = Path(folder)
        camera = Camera.from_json(folder / "camera.json")
        try:
            world = json.loads((folder / "world.json").read_text())
            with (folder / "truth.csv").open(newline="") as file:
                rows = list(csv.DictReader(file))
            origin = LocalFrame(*world["origin"])
            numbers = np.array([[float(row[column]) for column in TRUTH_COLUMNS[1:]] for row in rows])
            terrain = Terrain(TerrainSpec(**world["terrain"]))
            undulation = float(world["undulation_m"])
            if "moves" in world:
                raise ValueError("rows or optics that move are known to `fly` alone, and to truth_clicks.csv")
        except OSError as error:
            raise InputError(f"simulated session {folder}: {error.filename}: {error.strerror}") from error
        except (ValueError, KeyError, TypeError) as error:
            raise InputError(
                f"simulated session {folder}: truth.csv or world.json is not as written ({error})"
            ) from error
        centres = origin.to_enu(numbers[:, 1], numbers[:, 2], numbers[:, 4])
        R = axes_from_local(origin, numbers[:, 1], numbers[:, 2]) @ matrix_from_quaternion(numbers[:, 5:9])
        poses = [Pose(centre, rotation) for centre, rotation in zip(centres, R, strict=True)]
        return cls(camera, terrain, origin, undulation, poses, [row["file"] for row in rows], numbers[:, 0])
