"""A set for a picture of the second camera, from the first camera's sets, and how far its pixels may be off.

The second camera is one more bundle of rays from a pose that is known with an error. Section 27.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.feature_set import COMMON_STATES, FeatureSet, Status
from contract.geodesy import LocalFrame
from contract.locate import pixels_of
from contract.rotations import R_GIMBAL_CAM, euler_from_matrix, exp_so3, matrix_from_euler, skew
from onboard.config.second_camera import SecondCamera
from onboard.spots.bracketed import Bracketed, motion, seconds

Array = NDArray[np.float64]

STATES = 4  # the second camera's angles about its own axes x, y, z (rad), and how late its stamps are taken to be (s)
STEP = 1e-4  # of image coordinates, by which the lens is differentiated
BEHIND = 1e-6


@dataclass(frozen=True, eq=False)
class Mount:
    """The pose of the second camera against the first, with its error.

    R_first_second (3, 3); by how many seconds its pictures were taken later than their stamps; and of both the
    covariance (4, 4): R <- R exp([angles]).
    """

    R_first_second: Array
    late_s: float
    covariance: Array

    @classmethod
    def stated(cls, config: SecondCamera) -> Mount:
        """Return the mount that the configuration has."""
        angles = np.radians([config.roll_deg, config.pitch_deg, config.yaw_deg])
        sigmas = np.array([*3 * [np.radians(config.sigma_deg)], config.sigma_latency_s])
        return cls(R_GIMBAL_CAM.T @ matrix_from_euler(*angles) @ R_GIMBAL_CAM, 0.0, np.diag(sigmas**2))

    def __str__(self) -> str:
        """Return the mount in the terms of the configuration's keys."""
        angles = np.degrees(euler_from_matrix(R_GIMBAL_CAM @ self.R_first_second @ R_GIMBAL_CAM.T))
        sigmas = np.sqrt(np.diag(self.covariance))
        named = (f"{name}_deg {angle:.2f}" for name, angle in zip(("roll", "pitch", "yaw"), angles, strict=True))
        worst = np.degrees(sigmas[:3].max())
        return f"{', '.join(named)} (+-{worst:.2f}), stamps {self.late_s:+.3f} s (+-{sigmas[3]:.3f})"


@dataclass(frozen=True, eq=False)
class Pointing:
    """The effect of the second camera's errors at a pixel of its picture."""

    camera: Camera
    plane: Array  # (3,), in the second camera's axes: inverse depth of a ray
    speed_m_s: Array  # (3,) and
    turn_rad_s: Array  # (3,) of the second camera, in its axes
    covariance: Array  # (4, 4) of the mount
    turn_sigma_rad: float  # of the pose between two pictures

    def by_state(self, uv_px: Array) -> Array:
        """Return (2, 4): by how many pixels a pixel (2,) is off for each radian and second of the mount's errors.

        (27.4), (27.5)
        """
        ray, _ = self.camera.unproject(uv_px)
        to_picture = np.hstack([np.eye(2), -ray[:2, None]])
        turned = -to_picture @ skew(ray)
        moving = to_picture @ (np.cross(self.turn_rad_s, ray) + float(self.plane @ ray) * self.speed_m_s)
        return self._lens(ray[:2]) @ np.column_stack([turned, moving])

    def root(self, uv_px: Array) -> Array:
        """(2, 7): a root of a pixel's covariance, the mount's four columns first. (27.6)"""
        by_state = self.by_state(uv_px)
        values, vectors = np.linalg.eigh(self.covariance)
        by_mount = by_state @ (vectors * np.sqrt(np.maximum(values, 0.0)))
        return np.hstack([by_mount, by_state[:, :3] * self.turn_sigma_rad])

    def _lens(self, xy: Array) -> Array:
        """d pixel / d image coordinates, (2, 2)."""
        steps = STEP * np.array([[0.5, 0.0], [-0.5, 0.0], [0.0, 0.5], [0.0, -0.5]])
        at = self.camera.distort(xy + steps) * (self.camera.fx_px, self.camera.fy_px)
        return np.column_stack([at[0] - at[1], at[2] - at[3]]) / STEP


def set_of_second(look: Bracketed, camera: Camera, mount: Mount, lost_s: float) -> tuple[FeatureSet, Pointing | None]:
    """The set of a second camera's picture, with the number of the first camera's nearest, and how its pixels err.

    Refused as the sets next to it are, and where these are more than `lost_s` apart.
    """
    near = look.nearest
    stamp_ns = look.frame.stamp_ns + round(1e9 * mount.late_s)
    status = _status(look, lost_s)
    if status is not Status.OK or look.after is None:
        return FeatureSet(near.vehicle, near.session, near.frame, stamp_ns, status, camera), None
    span_s = seconds(look.before, look.after)
    far = look.after if near is look.before else look.before
    share = (stamp_ns - near.capture_unix_ns) / (far.capture_unix_ns - near.capture_unix_ns)
    way, turn = motion(near, far)
    toward_s = span_s if far is look.after else -span_s
    R_near_now = exp_so3(share * turn)
    R = near.R_enu_cam @ R_near_now @ mount.R_first_second
    between_s2 = 0.5 * share * (1.0 - share) * span_s**2
    angular, linear = (abs(between_s2) * a for a in look.accelerations)
    s = _moved(near, camera, share * way, R, linear)
    pointing = Pointing(
        camera, _normal(s), R.T @ way / toward_s, mount.R_first_second.T @ turn / toward_s, mount.covariance, angular
    )
    return replace(s, capture_unix_ns=stamp_ns), pointing


def pixel_of_first(look: Bracketed, its_set: FeatureSet, mount: Mount, uv_px: Array) -> Array:
    """Return the pixel (2,) of the first camera's nearest picture that shows what `uv_px` (2,) of the second does."""
    near = look.nearest
    ray, _ = its_set.camera.unproject(uv_px)
    in_first = mount.R_first_second @ ray
    if its_set.is_ok:
        frame = LocalFrame(near.camera_lat_deg, near.camera_lon_deg, near.camera_height_m)
        way = frame.to_enu(its_set.camera_lat_deg, its_set.camera_lon_deg, its_set.camera_height_m)
        depth = 1.0 / max(float(_normal(its_set) @ ray), BEHIND)
        in_first = near.R_enu_cam.T @ (way + its_set.R_enu_cam @ ray * depth)
    uv, _ = pixels_of(replace(near, R_enu_cam=np.eye(3), shutter=None), in_first[None])
    out: Array = uv[0]
    return out


def _status(look: Bracketed, lost_s: float) -> Status:
    if look.after is None or seconds(look.before, look.after) > lost_s:
        return Status.CAMERA_LOST
    return next((s.status for s in (look.before, look.after) if not s.is_ok), Status.OK)


def _normal(s: FeatureSet) -> Array:
    """The plane (3,) in the camera's axes: its product with a ray of unit depth is the inverse depth."""
    return np.array([s.plane_per_m[1], s.plane_per_m[2], s.plane_per_m[0]])


def _moved(s: FeatureSet, camera: Camera, way_m: Array, R_enu_cam: Array, sigma_m: float) -> FeatureSet:
    """A set as another camera has it, `way_m` (3,) away: the same ground and the same errors. (27.1), (27.2)"""
    lat, lon, height = (
        float(c) for c in LocalFrame(s.camera_lat_deg, s.camera_lon_deg, s.camera_height_m).to_geodetic(way_m)
    )
    normal = s.R_enu_cam @ _normal(s)
    p = R_enu_cam.T @ normal / (1.0 - float(normal @ way_m))
    rays, valid = s.camera.unproject(s.uv_px)
    X = rays / np.where(valid, s.inverse_depth_per_m, 1.0)[:, None] @ s.R_enu_cam.T - way_m
    T = _transport(s.R_enu_cam.T @ R_enu_cam, way_m)
    common = T @ s.common_cov @ T.T
    common[:3, :3] += sigma_m**2 * np.eye(3)
    out = replace(
        s, camera=camera, camera_lat_deg=lat, camera_lon_deg=lon, camera_height_m=height, R_enu_cam=R_enu_cam,
        common_cov=common, shared=replace(s.shared, by_nuisance=T @ s.shared.by_nuisance),
        plane_per_m=np.array([p[2], p[0], p[1]]), shutter=None, revision=0, is_keyframe=False,
    )  # fmt: skip
    uv, ahead = pixels_of(out, X)
    kept = valid & ahead
    depth = (X @ R_enu_cam)[kept, 2]
    relative = (s.sigma_inverse_depth_per_m / np.where(valid, s.inverse_depth_per_m, 1.0))[kept]
    return replace(out, uv_px=uv[kept], inverse_depth_per_m=1.0 / depth, sigma_inverse_depth_per_m=relative / depth)


def _transport(R_here_there: Array, way_m: Array) -> Array:
    """Return a camera's common states as seen from another (9, 9), by its rays about its optical axis. (27.2)"""
    R = R_here_there
    x, y = R[0, 2] / R[2, 2], R[1, 2] / R[2, 2]
    turned = (R[:2, :2] - np.outer([x, y], R[2, :2])) / R[2, 2]
    T = np.eye(COMMON_STATES)
    T[6, 7:] = x, y
    T[7:, 7:] = turned.T
    T[:3, 3:6] = -skew(way_m)
    T[:3, 6:] = -np.outer(way_m, T[6, 6:])
    return T
