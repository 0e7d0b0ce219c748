"""Camera calibration from views of a flat board: which distortion the evidence supports, how well each number is known.

OpenCV finds the optimum; views that contradict the others are dropped; of eight distortion models the one with the best
Bayesian information criterion is kept; covariances are our own, from the Jacobian at the optimum with the boards' poses
eliminated. (11.1) to (11.3) of docs/mathematics-camera.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera

Array = NDArray[np.float64]

LEAST_VIEWS = 4
"""Below this nothing is fitted: with three views every board error looks like optics."""
OUTLIER = 3.0  # times the median view's error
OUTLIER_FLOOR_PX = 0.3  # ... but a view as good as this is never one
MOST_DROPPED = 0.34
UNFOLDED_SHARE = 1.1  # of the best model's error, for the sake of a ray at every pixel
_RADIAL = (cv2.CALIB_FIX_K1, cv2.CALIB_FIX_K2, cv2.CALIB_FIX_K3)
_K_COLUMNS = (4, 5, 8)  # of fx, fy, cx, cy, k1, k2, p1, p2, k3
_P_COLUMNS = (6, 7)
PARAMETERS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
_CRITERIA = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 200, 1e-10)
_GRID = (9, 7)


@dataclass(frozen=True, eq=False)
class View:
    """A picture's corners: their numbers (N,), pixels (N, 2) and places on the board (N, 3), metres."""

    name: str
    numbers: NDArray[np.intp]
    uv_px: Array
    points_m: Array


@dataclass(frozen=True)
class Model:
    """A distortion model: how many radial coefficients, and whether the tangential ones."""

    radial: int
    is_tangential: bool

    @property
    def name(self) -> str:
        """'k1 k2 p1 p2', or 'none'."""
        words = [f"k{i + 1}" for i in range(self.radial)] + ["p1", "p2"] * self.is_tangential
        return " ".join(words) or "none"

    @property
    def flags(self) -> int:
        """OpenCV's calibration flags."""
        flags = sum(_RADIAL[self.radial :])
        return int(flags if self.is_tangential else flags | cv2.CALIB_ZERO_TANGENT_DIST)

    @property
    def columns(self) -> list[int]:
        """Indices of those of `PARAMETERS` that are free."""
        return sorted([0, 1, 2, 3, *_K_COLUMNS[: self.radial], *(_P_COLUMNS if self.is_tangential else ())])


MODELS = tuple(Model(radial, is_tangential) for radial in range(4) for is_tangential in (False, True))
FULLEST = MODELS[-1]


@dataclass(frozen=True, eq=False)
class Fit:
    """One model fitted to some views."""

    model: Model
    camera: Camera
    views: tuple[View, ...]
    R_cam_board: tuple[Array, ...]
    residuals_px: tuple[Array, ...]  # a view each, (N, 2): seen minus predicted
    sigmas: dict[str, float]  # of `PARAMETERS`, one sigma; 0: not in the model
    ray_sigma_px: Array  # (7, 9) over the picture: one sigma of a pixel's direction, a common rotation aside

    @property
    def rms_px(self) -> float:
        """Root mean square of a corner's distance from its prediction."""
        return _rms(np.concatenate(self.residuals_px))

    @property
    def view_rms_px(self) -> Array:
        """The same, a view each."""
        return np.array([_rms(r) for r in self.residuals_px])

    @property
    def bic(self) -> float:
        """Bayesian information criterion, (11.1): the lower the better."""
        count = 2 * sum(len(r) for r in self.residuals_px)
        squares = float(sum(np.sum(r**2) for r in self.residuals_px))
        return float(count * np.log(max(squares, 1e-12) / count) + len(self.model.columns) * np.log(count))

    def tilts_deg(self) -> Array:
        """The lean of each board from facing the camera: about the picture's x and y axes, (N, 2), degrees."""
        normals = np.array([R[:, 2] for R in self.R_cam_board])
        leans: Array = np.degrees(np.arctan2(normals[:, [1, 0]], normals[:, [2]]))
        return leans


def _rms(residuals_px: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(residuals_px**2, axis=-1))))


def calibrate(views: list[View], size_px: tuple[int, int]) -> tuple[Fit, list[View]] | None:
    """The best-supported fit and the views that were dropped; None if nothing sensible can be fitted."""
    kept, dropped = list(views), list[View]()
    while True:
        if len(kept) < LEAST_VIEWS:
            return None
        fullest = fit(kept, size_px, FULLEST)
        if fullest is None:
            return None
        errors = fullest.view_rms_px
        worst = int(np.argmax(errors))
        allowed = max(OUTLIER * float(np.median(errors)), OUTLIER_FLOOR_PX)
        if errors[worst] <= allowed or len(dropped) + 1 > MOST_DROPPED * len(views):
            break
        dropped.append(kept.pop(worst))
    fits = [fitted for model in MODELS[:-1] if (fitted := fit(kept, size_px, model)) is not None] + [fullest]
    best = min(fits, key=lambda fitted: fitted.bic)
    if rayless_share(best.camera) > 0.0:
        # A polynomial may fold where no board was seen; one that does not, and fits as well, is the better guess.
        unfolded = [f for f in fits if rayless_share(f.camera) == 0.0 and f.rms_px <= UNFOLDED_SHARE * best.rms_px]
        best = min(unfolded, key=lambda fitted: fitted.bic, default=best)
    return best, dropped


def rayless_share(camera: Camera) -> float:
    """The share of the picture that has no ray, because the polynomial folds there."""
    width, height = camera.size_px
    u, v = np.meshgrid(np.linspace(0, width - 1, 41), np.linspace(0, height - 1, 31))
    _, is_valid = camera.unproject(np.stack([u, v], axis=-1))
    return float(np.mean(~is_valid))


def fit(views: list[View], size_px: tuple[int, int], model: Model) -> Fit | None:
    """One model by least squares; None where it does not converge to a camera."""
    points = [view.points_m.astype(np.float32) for view in views]
    seen = [view.uv_px.astype(np.float32).reshape(-1, 1, 2) for view in views]
    best: tuple[float, Any, Any, Any, Any] | None = None
    width, height = size_px
    for focal_share in (None, 0.6, 1.2, 2.4):  # OpenCV's own start fails for boards that all face the camera
        start, flags = np.eye(3), model.flags
        if focal_share is not None:
            start[0, 0] = start[1, 1] = focal_share * width
            start[:2, 2] = (width - 1) / 2.0, (height - 1) / 2.0
            flags |= cv2.CALIB_USE_INTRINSIC_GUESS
        try:
            rms, K, d, rvecs, tvecs = cv2.calibrateCamera(
                points, seen, size_px, start, np.zeros(5), flags=flags, criteria=_CRITERIA
            )
        except cv2.error:
            continue
        if not np.all(np.isfinite(K)) or min(K[0, 0], K[1, 1]) <= 0.05 * width:
            continue
        if best is None or rms < 0.98 * best[0]:
            best = (rms, K, d, rvecs, tvecs)
        if rms < 1.0:
            break
    return None if best is None else _assess(views, size_px, model, *best[1:])


def _assess(
    views: list[View],
    size_px: tuple[int, int],
    model: Model,
    K: Array,
    d: Array,
    rvecs: list[Array],
    tvecs: list[Array],
) -> Fit:
    """Residuals and covariance at the optimum."""
    d = d.ravel()[:5]
    k1, k2, p1, p2, k3 = (float(c) for c in d)
    camera = Camera(*size_px, float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]), (k1, k2, p1, p2, k3))
    columns = model.columns
    information = np.zeros((len(columns), len(columns)))
    residuals = []
    for view, rvec, tvec in zip(views, rvecs, tvecs, strict=True):
        predicted, J = cv2.projectPoints(view.points_m, rvec, tvec, K, d)
        residuals.append(view.uv_px - predicted.reshape(-1, 2))
        # Columns of J: rotation, translation, fx, fy, cx, cy, k1, k2, p1, p2, k3. (11.2)
        J_pose, J_camera = J[:, :6], J[:, 6:15][:, columns]
        projected = J_camera - J_pose @ np.linalg.lstsq(J_pose, J_camera, rcond=None)[0]
        information += projected.T @ projected
    count = 2 * sum(len(r) for r in residuals)
    free = max(count - 6 * len(views) - len(columns), 1)
    variance = float(sum(np.sum(r**2) for r in residuals)) / free
    # Scaled before it is inverted: focal lengths are in hundreds, coefficients in hundredths.
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-30))
    inverse = np.asarray(np.linalg.pinv(information * np.outer(scale, scale), rcond=1e-14, hermitian=True), np.float64)
    covariance = variance * inverse * np.outer(scale, scale)
    spread = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    sigmas = dict.fromkeys(PARAMETERS, 0.0) | {PARAMETERS[c]: float(s) for c, s in zip(columns, spread, strict=True)}
    return Fit(
        model,
        camera,
        tuple(views),
        tuple(np.asarray(cv2.Rodrigues(rvec)[0], float) for rvec in rvecs),
        tuple(residuals),
        sigmas,
        _ray_sigma_px(camera, columns, covariance),
    )


def _ray_sigma_px(camera: Camera, columns: list[int], covariance: Array) -> Array:
    """One sigma of where a direction is seen, over a grid of the picture, less what a rotation explains: (11.3)."""
    width, height = camera.size_px
    v, u = np.meshgrid(np.linspace(0, height - 1, _GRID[1]), np.linspace(0, width - 1, _GRID[0]), indexing="ij")
    rays, _ = camera.unproject(np.stack([u.ravel(), v.ravel()], axis=-1))
    K = np.array([[camera.fx_px, 0.0, camera.cx_px], [0.0, camera.fy_px, camera.cy_px], [0.0, 0.0, 1.0]])
    _, J = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), K, np.array(camera.distortion))
    J_rotation, J_camera = J[:, :3], J[:, 6:15][:, columns]
    # The boresight is estimated in flight, so that a rotation common to all pixels does no harm.
    left = J_camera - J_rotation @ np.linalg.lstsq(J_rotation, J_camera, rcond=None)[0]
    variances = np.einsum("ij,jk,ik->i", left, covariance, left).reshape(-1, 2).sum(axis=1)
    sigmas: Array = np.sqrt(np.maximum(variances, 0.0)).reshape(_GRID[1], _GRID[0])
    return sigmas
