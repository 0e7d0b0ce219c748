"""Other pictures of a clicked one's ground: where their cameras are, seen from the clicked camera. (29.1)

Poses are relative to the clicked picture's: what its set has in common with them cancels. What is measured over its
features has their common scale, and part of the tilts that they have in common; what the camera is off by is the same
in all of them (29.15).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from contract.camera import UNKNOWN_SIGMA, Camera
from contract.feature_set import DepthSource, FeatureSet
from contract.geodesy import LocalFrame
from contract.rotations import exp_so3, skew
from onboard.geometry import camera_errors
from onboard.geometry.plane_homography import fit_homography, move
from onboard.measured.common import COMMON, MODES, POSE, Shown

Array = NDArray[np.float64]
Grey = NDArray[np.uint8]

WINDOW_PX = 15
EDGE_PX = 8.0
# How far a feature found again may be from where the pose that the sets give has it: so many sigmas of both poses, at
# least so many pixels, and at most so much of the picture's width.
REACH, LEAST_REACH_PX, MOST_REACH = 3.0, 12.0, 0.06
LEAST_FEATURES = 12
LEAST_SHARE = 0.4  # of the features found again that a pose must explain
PRIOR_SIGMA_PX = 0.3  # of a feature found again, at first
ROUNDS = 4
CUT = 3.0  # sigmas
LEAST_SIGMA_PX, MOST_SIGMA_PX = 0.05, 1.0  # what is off by more was not found again


@dataclass(frozen=True, eq=False)
class Features:
    """A clicked picture's features (N,): pixels, rays (N, 3) at depth one, inverse depth, one sigma of its log, how the
    rays move with the camera's errors (N, 2, 5), and the covariance (8, 8) of what they have in common: the modes
    (1, x, y) by which these logs are off together, then the camera's errors.
    """

    uv_px: Array
    rays: Array
    inverse_depth_per_m: Array
    relative_sigma: Array
    by_camera: Array
    common_cov: Array = field(default_factory=lambda: np.zeros((COMMON, COMMON)))
    is_adjusted: bool = True  # the depths are by pictures, and not by ground that is known

    @classmethod
    def of(cls, clicked: FeatureSet) -> Features:
        """Return a set's features that lie ahead on calibrated rays."""
        rays, valid = clicked.camera.unproject(clicked.uv_px)
        w = clicked.inverse_depth_per_m
        keep = valid & (w > 0.0)
        sigma = clicked.sigma_inverse_depth_per_m[keep] / w[keep]
        # No set states how well its camera is known: as well as one that is known by its type.
        common_cov = np.diag([0.0] * MODES + [each**2 for each in UNKNOWN_SIGMA])
        common_cov[:MODES, :MODES] = clicked.common_cov[6:9, 6:9]
        by_camera = rays_by_camera(clicked.camera, rays[keep, :2])
        is_adjusted = clicked.depth_source is DepthSource.PARALLAX
        return cls(clicked.uv_px[keep], rays[keep], w[keep], sigma, by_camera, common_cov, is_adjusted)

    @property
    def modes(self) -> Array:
        """H (N, 3), rows (1, x, y)."""
        return np.concatenate([np.ones((len(self.rays), 1)), self.rays[:, :2]], axis=1)

    def only(self, rows: NDArray[np.intp]) -> Features:
        return replace(
            self,
            uv_px=self.uv_px[rows], rays=self.rays[rows], inverse_depth_per_m=self.inverse_depth_per_m[rows],
            relative_sigma=self.relative_sigma[rows], by_camera=self.by_camera[rows],
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class View:
    """Another picture and its camera: `R` (3, 3) turns the clicked camera's axes into its own, `centre_m` (3,) is where
    it is in them.

    With d a ray of the clicked picture at depth one and w its inverse depth, it is seen along R (d - w centre). Of its
    pose (rotation, then position, of the view's own axes): `by_feature` (6, N, 2) how it moves with each feature's
    pixel as it was found, `by_depth` (6, N) with the feature's d ln w; `pixel_sigma_px` is one sigma of the former.
    """

    image: Grey
    camera: Camera
    R: Array
    centre_m: Array
    by_feature: Array
    by_depth: Array
    pixel_sigma_px: float
    shown: Shown


FAR = 1e3  # focal lengths from the middle of the picture

_frame_at = lru_cache(maxsize=512)(LocalFrame)


@lru_cache(maxsize=512)  # each click asks for those of all kept pictures
def relative_pose(clicked: FeatureSet, other: FeatureSet) -> tuple[Array, Array]:
    """R and centre of `View`, as both sets have their poses."""
    place = other.camera_lat_deg, other.camera_lon_deg, other.camera_height_m
    here = _frame_at(clicked.camera_lat_deg, clicked.camera_lon_deg, clicked.camera_height_m)
    there = _frame_at(*place)
    moved_m = here.to_enu(*place)
    R_enu_other = here.R_enu_ecef @ there.R_enu_ecef.T @ other.R_enu_cam
    return R_enu_other.T @ clicked.R_enu_cam, clicked.R_enu_cam.T @ moved_m


def pixels(camera: Camera, directions: Array) -> Array:
    """Pixels (..., 2) of directions (..., 3) in camera axes; far off the picture for what is behind, or beyond what
    the lens describes.
    """
    z = directions[..., 2:]
    ahead = z > 1e-6
    xy = np.where(ahead, directions[..., :2] / np.where(ahead, z, 1.0), FAR)
    seen = np.hypot(xy[..., :1], xy[..., 1:]) <= min(camera.max_radius, FAR)
    return np.where(seen, camera.pixels(np.where(seen, xy, 0.0)), -FAR * camera.focal_px)


def view_of(
    image: Grey,
    features: Features,
    other_image: Grey,
    other: FeatureSet,
    start: tuple[Array, Array],
    reach_px: float = LEAST_REACH_PX,
) -> View | None:
    """Find the features again in another picture, within `reach_px` of where `start` has them, and from them its pose.
    (29.2), None where too few are found.
    """
    camera = other.camera
    found, kept = _found(image, features.uv_px, other_image, pixels(camera, _seen(*start, features)), reach_px)
    rays, valid = camera.unproject(found)
    kept = kept & valid
    if np.count_nonzero(kept) < LEAST_FEATURES:
        return None
    rows = np.flatnonzero(kept)
    solved = resect(*start, features.only(rows), rays[rows, :2], camera)
    if solved is None:
        return None
    R, centre, by_pixel, by_depth, sigma_px, shown = solved
    every = np.zeros((6, len(kept), 2)), np.zeros((6, len(kept)))
    every[0][:, rows], every[1][:, rows] = by_pixel, by_depth
    return View(other_image, camera, R, centre, *every, sigma_px, shown.spread(rows, len(kept)))


def resect(
    R: Array, centre_m: Array, features: Features, xy: Array, camera: Camera
) -> tuple[Array, Array, Array, Array, float, Shown] | None:
    """The pose by which features are seen at `xy` (N, 2), undistorted; its `by_feature` and `by_depth`, the pixels' one
    sigma, and what is shown of what the features have in common. (29.2), (29.3), (29.14)

    What disagrees is left out, None if that is most.
    """
    stated = features.relative_sigma**2
    s2, sigma_px = stated, PRIOR_SIGMA_PX
    for _ in range(ROUNDS):
        q, J, by_depth = linearised(R, centre_m, features, camera)
        predicted = q[:, :2] / q[:, 2:]
        residual = (by_place(camera, predicted) @ (xy - predicted)[..., None])[..., 0]
        size, turned = _along_and_across(by_depth)
        left = (turned @ residual[..., None])[..., 0]
        whiten = turned / _sigmas(size, s2, sigma_px)[..., None]
        white = (whiten @ residual[..., None])[..., 0]
        mahalanobis = np.hypot(*white.T)
        used = mahalanobis < max(CUT, CUT / 1.18 * float(np.median(mahalanobis)))
        if np.count_nonzero(used) < max(LEAST_FEATURES, LEAST_SHARE * len(used)):
            return None
        whiten[~used] = 0.0
        WJ = whiten @ J  # (N, 2, 6)
        flat = WJ.reshape(-1, POSE)
        N = flat.T @ flat
        N[np.diag_indices(POSE)] *= 1.0 + 1e-9
        step = np.linalg.solve(N, flat.T @ (white * used[:, None]).ravel())
        R, centre_m = exp_so3(step[:3]) @ R, centre_m + R.T @ step[3:]
        # Of what is not the features' depth: across the epipolar line nothing of a residual is.
        sigma_px = max(1.483 * float(np.median(np.abs(left[used, 1]))), LEAST_SIGMA_PX)
        # Along it a window that lies on more than one surface is off by more than the features' own depth.
        off = np.abs(left[used, 0]) / _sigmas(size, s2, sigma_px)[used, 0]
        grown = max(1.483 * float(np.median(off)), 1.0)
        s2 = stated + (grown**2 - 1.0) * (stated + (sigma_px / size) ** 2)
    if sigma_px > MOST_SIGMA_PX:
        return None
    gain = np.linalg.solve(N, (WJ.transpose(0, 2, 1) @ whiten).transpose(1, 0, 2).reshape(POSE, -1))
    by_pixel = np.asarray(gain.reshape(POSE, -1, 2), float)
    by_log = -(by_pixel * by_depth).sum(axis=2)
    by_camera = pixels_by_camera(R, q, features.by_camera, camera)
    # Along the line, what is more than the features' own depths, the same in all views, is the view's own.
    alone: Array = turned / _sigmas(size, s2 - stated, sigma_px)[..., None]
    shown = Shown.of((J, by_depth, by_camera), residual, alone, by_pixel)
    return R, centre_m, by_pixel, by_log * np.sqrt(s2), sigma_px, shown


def _along_and_across(by_depth: Array) -> tuple[Array, Array]:
    """Return how many pixels features move by d ln w (N,), and the rotations (N, 2, 2) of pixels to along that line and
    across it. `by_depth` (N, 2).
    """
    size = np.maximum(np.hypot(*by_depth.T), 1e-12)
    x, y = by_depth.T / size
    x = np.where(size > 1e-12, x, 1.0)
    return size, np.array([[x, y], [-y, x]]).transpose(2, 0, 1)


def _sigmas(size: Array, s2: Array, sigma_px: float) -> Array:
    """One sigma of features' pixels (N, 2), px, along their lines and across: depths' errors, variance `s2` of their
    logarithms, are along alone. (29.3)
    """
    return np.stack([np.sqrt(size**2 * s2 + sigma_px**2), np.full(len(size), sigma_px)], axis=1)


def linearised(R: Array, centre_m: Array, features: Features, camera: Camera) -> tuple[Array, Array, Array]:
    """Directions (N, 3) of features in a view, and how their pixels move: (N, 2, 6) by its pose, (N, 2) by d ln w.
    (29.1)
    """
    q = _seen(R, centre_m, features)
    w = features.inverse_depth_per_m
    xy = q[:, :2] / q[:, 2:]
    by_q = np.concatenate([np.broadcast_to(np.eye(2), (len(q), 2, 2)), -xy[:, :, None]], axis=2) / q[:, 2, None, None]
    by_q = by_place(camera, xy) @ by_q
    by_pose = np.concatenate([-skew(q), -w[:, None, None] * np.eye(3)], axis=2)
    by_depth = -w[:, None] * (R @ centre_m)
    return q, by_q @ by_pose, (by_q @ by_depth[..., None])[..., 0]


def rays_by_camera(camera: Camera, xy: Array) -> Array:
    """The derivative (N, 2, 5) of the rays x, y (N, 2) of pixels that stay, by the camera's errors. (15.2)"""
    return np.asarray(camera_errors.by_states(camera, xy[None, :, 0], xy[None, :, 1])[0].transpose(2, 1, 0), float)


def pixels_by_camera(R: Array, q: Array, rays_by: Array, camera: Camera) -> Array:
    """The derivative (N, 2, 5) by the camera's errors of the pixels of directions q (N, 3) in a view, which R turns
    rays into that move by `rays_by` (N, 2, 5) themselves. (29.14)
    """
    xy = q[:, :2] / q[:, 2:]
    by_ray = (R[:2, :2] - xy[:, :, None] * R[2, :2]) / q[:, 2, None, None]
    return np.asarray(by_place(camera, xy) @ (by_ray @ rays_by - rays_by_camera(camera, xy)), float)


def by_place(camera: Camera, xy: Array) -> Array:
    """The derivative (N, 2, 2) of pixels by their undistorted coordinates (N, 2). (2.2), (30.3)"""
    _, along, cross = camera.lens.linearised(xy.T)
    by_undistorted = np.array([[along[0], cross], [cross, along[1]]]).transpose(2, 0, 1)
    out: Array = by_undistorted * np.array([[camera.fx_px], [camera.fy_px]])
    return out


def _seen(R: Array, centre_m: Array, features: Features) -> Array:
    return np.asarray((features.rays - features.inverse_depth_per_m[:, None] * centre_m) @ R.T, float)


def reach_px(clicked: FeatureSet, other: FeatureSet) -> float:
    """Return how far off pixels may be by what both sets state of their poses' errors, as if these had none in common:
    those of one window have most, and then less is looked for in vain.
    """
    w = float(clicked.plane_per_m[0])
    variance = sum(
        np.linalg.norm(s.common_cov[3:6, 3:6], 2) + w * w * np.linalg.norm(s.common_cov[:3, :3], 2)
        for s in (clicked, other)
    )
    reach = REACH * clicked.camera.focal_px * float(np.sqrt(variance))
    return max(LEAST_REACH_PX, min(reach, MOST_REACH * clicked.camera.width_px))


def _found(image: Grey, at: Array, other: Grey, start: Array, reach_px: float) -> tuple[Array, NDArray[np.bool_]]:
    """Return pixels (N, 2) in another picture, and which of them were found near where they were expected.

    The other picture is first taken back by the homography that is expected: LK knows shifts alone.
    """
    size = other.shape[1], other.shape[0]
    inside = np.asarray((start > EDGE_PX).all(axis=1) & (start < np.subtract(size, EDGE_PX + 1.0)).all(axis=1), bool)
    if np.count_nonzero(inside) < LEAST_FEATURES:
        return start, np.zeros(len(at), bool)
    H = fit_homography(at[inside], start[inside], np.ones(np.count_nonzero(inside)))
    back = cv2.warpPerspective(other, H, image.shape[::-1], flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
    expected = np.where(inside[:, None], move(np.asarray(np.linalg.inv(H), float), start), at)
    levels = math.ceil(math.log2(2.0 * reach_px / WINDOW_PX))  # of halved pictures, until the window holds the reach
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 12, 0.01)
    moved, is_found, _ = cv2.calcOpticalFlowPyrLK(
        image, back, at.astype(np.float32).reshape(-1, 1, 2), expected.astype(np.float32).reshape(-1, 1, 2),
        winSize=(WINDOW_PX, WINDOW_PX), maxLevel=levels, criteria=criteria, flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )  # fmt: skip
    near = np.linalg.norm(moved.reshape(-1, 2) - expected, axis=1) < reach_px
    found = move(H, moved.reshape(-1, 2).astype(float))
    inside &= (found > EDGE_PX).all(axis=1) & (found < np.subtract(size, EDGE_PX + 1.0)).all(axis=1)
    return found, inside & near & (is_found.ravel() == 1)
