"""One picture's observations and where it was taken: the window's raw material."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.lens import MIN_DETERMINANT
from contract.rolling_shutter import row_share
from onboard.estimation.rolling_shutter import Moving
from onboard.navigation.navigator import NavState
from onboard.navigation.position_interpolation import Displacement

Array = NDArray[np.float64]
Ids = NDArray[np.int64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Observation:
    """One picture's features: ids (N,), pixels, and by `camera` normalised image coordinates `xy` (N, 2) and `gain`
    (N,) of xy per px.

    `xy` is where they were when the middle row was exposed, over the ground that was assumed; `raw_xy` where they were
    seen, each by its own row, at these shares (N,) of the readout. Both are the same of a global shutter.
    """

    camera: Camera
    ids: Ids
    uv_px: Array
    xy: Array
    gain: Array
    raw_xy: Array
    share: Array
    moving: Moving | None = None


@dataclass(frozen=True, eq=False)
class Keyframe:
    """An observation with the vehicle's state and the current estimate of the camera's pose."""

    frame: int
    observation: Observation
    nav: NavState
    body_rate_rad_s: Array
    nav_offset_s: float  # camera-to-autopilot offset at which `nav` was taken
    nav_delay_s: float  # and the position's delay
    displacement: Displacement | None  # since the keyframe before
    R_cam_enu: Array
    centre_enu_m: Array
    flow_disagreement_xy: Array | None = None  # (2,) normalised; `coarse_flow`, since the keyframe before
    is_oriented: bool = True  # False: nothing has given an orientation yet, and `R_cam_enu` holds the mount's alone


def observation(
    camera: Camera, ids: Ids, uv_px: Array, moving: Moving | None = None, near: Array | None = None
) -> Observation:
    """Undistort pixels once, beginning at `near` (N, 2); those without a ray are left out. (18.3)"""
    rays, valid = camera.unproject(uv_px, near)
    ids, uv_px, xy = ids[valid], uv_px[valid], rays[valid, :2]
    gain = 1.0 / (camera.focal_px * np.sqrt(np.maximum(np.abs(camera.area_gain(xy)), MIN_DETERMINANT)))
    if moving is None:
        return Observation(camera, ids, uv_px, xy, gain, xy, np.zeros(len(xy)))
    share = np.asarray(row_share(uv_px[:, 1], camera.height_px))
    at_once = xy - moving.readout_s * moving.by_readout(xy, share)
    return Observation(camera, ids, uv_px, at_once, gain, xy, share, moving)


def seen_with(camera: Camera, seen: Observation, readout_s: float = 0.0) -> Observation:
    """The same features by another calibration, which is nearly that they were seen with, and another readout."""
    moving = None if seen.moving is None else replace(seen.moving, readout_s=readout_s)
    if camera == seen.camera and (seen.moving is None or seen.moving.readout_s == readout_s):
        return seen
    return observation(camera, seen.ids, seen.uv_px, moving, seen.raw_xy)


def swept(keyframes: Sequence[Keyframe], rates_cam_rad_s: Array, readout_s: float) -> tuple[Keyframe, ...]:
    """The keyframes with these angular rates (K, 3) while they were read in this time."""
    out = []
    for k, rate in zip(keyframes, rates_cam_rad_s, strict=True):
        seen, moving = k.observation, k.observation.moving
        if moving is not None:
            moving = replace(moving, rate_cam_rad_s=rate, readout_s=readout_s)
            xy = seen.raw_xy - moving.readout_s * moving.by_readout(seen.raw_xy, seen.share)
            seen = replace(seen, xy=xy, moving=moving)
        out.append(replace(k, observation=seen))
    return tuple(out)


def stamp_sigma_s(keyframes: Sequence[Keyframe]) -> float:
    """One sigma of what their stamps are off by for a while, which is no property of the platform; 0 if by nothing."""
    return max((k.nav.stamp_sigma_s for k in keyframes), default=0.0)


def have_attitude(keyframes: Sequence[Keyframe]) -> bool:
    """Return whether the autopilot gave an attitude to every one."""
    return bool(with_attitude(keyframes).all())


def with_attitude(keyframes: Sequence[Keyframe]) -> Mask:
    """Return which of them (K,) have an attitude of the autopilot."""
    return np.array([k.nav.R_enu_body is not None for k in keyframes], bool)


def turned(keyframes: Sequence[Keyframe], R_cam_enu: Iterable[Array]) -> tuple[Keyframe, ...]:
    """The keyframes with these orientations, at the positions that GPS gives."""
    return tuple(
        replace(k, R_cam_enu=R, centre_enu_m=k.nav.position_enu_m, is_oriented=True)
        for k, R in zip(keyframes, R_cam_enu, strict=True)
    )
