"""Camera calibration from views of a flat board: which distortion the evidence supports, how well each number is known.

OpenCV finds a pinhole's optimum, `fisheye_fit` a fisheye's; views that contradict the others are dropped; of eight
models of distortion, or of a fisheye's four, the one with the best Bayesian information criterion is kept. Which of
the two lenses it is, where the picture is wide, views show that neither was fitted to. Covariances are our own, from
the Jacobian at the optimum with the boards' poses eliminated. (11.1) to (11.4) of docs/mathematics-camera.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.lens import FISHEYE, MAX_ANGLE, PINHOLE
from contract.lens import MODELS as LENSES
from onboard.calibration import fisheye_fit

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
WIDE_RAD = np.radians(90.0)  # from corner to corner: within less either lens's polynomial fits the other
FOLDS = 3
BETTER = 0.8  # times a pinhole's error in views that were held out, below which a fisheye is the lens
_CRITERIA = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 200, 1e-10)
_GRID = (9, 7)
POSE_ROUNDS = 10


@dataclass(frozen=True, eq=False)
class View:
    """A picture's corners: their numbers (N,), pixels (N, 2) and places on the board (N, 3), metres."""

    name: str
    numbers: NDArray[np.intp]
    uv_px: Array
    points_m: Array


@dataclass(frozen=True)
class Model:
    """A distortion model: how many radial coefficients, whether the tangential ones, and of which lens."""

    radial: int
    is_tangential: bool
    lens: str = PINHOLE

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
    def parameters(self) -> tuple[str, ...]:
        return ("fx", "fy", "cx", "cy", *LENSES[self.lens].names)

    @property
    def columns(self) -> list[int]:
        """Indices of those of `parameters` that are free."""
        if self.lens == FISHEYE:
            return list(range(4 + self.radial))
        return sorted([0, 1, 2, 3, *_K_COLUMNS[: self.radial], *(_P_COLUMNS if self.is_tangential else ())])


MODELS = tuple(Model(radial, is_tangential) for radial in range(4) for is_tangential in (False, True))
FISHEYES = tuple(Model(radial, is_tangential=False, lens=FISHEYE) for radial in (0, 1, 2, 4))


@dataclass(frozen=True, eq=False)
class Fit:
    """One model fitted to some views."""

    model: Model
    camera: Camera
    views: tuple[View, ...]
    R_cam_board: tuple[Array, ...]
    residuals_px: tuple[Array, ...]  # a view each, (N, 2): seen minus predicted
    sigmas: dict[str, float]  # of `Model.parameters`, one sigma; 0: not in the model
    ray_sigma_px: Array  # (7, 9) over the picture: one sigma of a pixel's direction, a common rotation aside
    why: str = ""  # this lens and not the other, where both were tried

    @property
    def rms_px(self) -> float:
        """Root mean square of a corner's distance from its prediction."""
        return _rms(np.concatenate(self.residuals_px))

    @property
    def view_rms_px(self) -> Array:
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
    pinhole = _best(views, size_px, MODELS)
    if pinhole is not None and _corner_to_corner_rad(pinhole[0].camera) < WIDE_RAD:
        return pinhole
    fisheye = _best(views, size_px, FISHEYES)
    if pinhole is None or fisheye is None:
        return pinhole or fisheye
    used = [v for v in views if v not in pinhole[1] or v not in fisheye[1]]
    off_px, fisheye_off_px = (held_out_px(used, size_px, each[0].model) for each in (pinhole, fisheye))
    if fisheye_off_px < BETTER * off_px:
        chosen, name = fisheye, "fisheye"
    else:
        chosen, name = pinhole, "pinhole"
    why = f"{name}: views held out are {fisheye_off_px:.2f} px off a fisheye's fit and {off_px:.2f} off a pinhole's"
    return replace(chosen[0], why=why), chosen[1]


def held_out_px(views: list[View], size_px: tuple[int, int], model: Model) -> float:
    """The median error of views in fits to the others, each with its own pose; infinite where there is none. (11.4)"""
    errors = []
    for fold in range(FOLDS):
        fitted = fit([v for k, v in enumerate(views) if k % FOLDS != fold], size_px, model)
        if fitted is None:
            return float("inf")
        for view in views[fold::FOLDS]:
            off = _off_px(fitted.camera, view)
            errors.append(float("inf") if off is None else _rms(off))
    return float(np.median(errors))


def _off_px(camera: Camera, view: View) -> Array | None:
    """How far a view's corners (N, 2) are off where a camera sees them from the best pose; None without one."""
    pose = fisheye_fit.pose_of(camera, (view.uv_px, view.points_m))
    if pose is None:
        return None
    for _ in range(POSE_ROUNDS):
        predicted, by_pose, _ = _projected(camera, view.points_m, *pose)
        step = np.linalg.lstsq(by_pose, (view.uv_px - predicted).ravel(), rcond=None)[0]
        pose = pose[0] + step[:3], pose[1] + step[3:]
    return view.uv_px - _projected(camera, view.points_m, *pose)[0]


def _corner_to_corner_rad(camera: Camera) -> float:
    across = float(np.hypot(camera.width_px / camera.fx_px, camera.height_px / camera.fy_px))
    return 2.0 * float(np.arctan(0.5 * across))


def _best(views: list[View], size_px: tuple[int, int], models: tuple[Model, ...]) -> tuple[Fit, list[View]] | None:
    """Of models of one lens, the last of which has all of its terms."""
    kept, dropped = list(views), list[View]()
    while True:
        if len(kept) < LEAST_VIEWS:
            return None
        fullest = fit(kept, size_px, models[-1])
        if fullest is None:
            return None
        errors = fullest.view_rms_px
        worst = int(np.argmax(errors))
        allowed = max(OUTLIER * float(np.median(errors)), OUTLIER_FLOOR_PX)
        if errors[worst] <= allowed or len(dropped) + 1 > MOST_DROPPED * len(views):
            break
        dropped.append(kept.pop(worst))
    fits = [fitted for model in models[:-1] if (fitted := fit(kept, size_px, model)) is not None] + [fullest]
    best = min(fits, key=lambda fitted: fitted.bic)
    if rayless_share(best.camera) > 0.0:
        # A polynomial may fold where no board was seen; one that does not, and fits as well, is the better guess.
        unfolded = [f for f in fits if rayless_share(f.camera) == 0.0 and f.rms_px <= UNFOLDED_SHARE * best.rms_px]
        best = min(unfolded, key=lambda fitted: fitted.bic, default=best)
    return best, dropped


def rayless_share(camera: Camera) -> float:
    """The share of the picture that has no ray, because the polynomial folds there; none where a fisheye's goes on to
    the angle at which its rays end.
    """
    if camera.model == FISHEYE and camera.max_radius > 0.999 * np.tan(MAX_ANGLE):
        return 0.0
    width, height = camera.size_px
    u, v = np.meshgrid(np.linspace(0, width - 1, 41), np.linspace(0, height - 1, 31))
    _, is_valid = camera.unproject(np.stack([u, v], axis=-1))
    return float(np.mean(~is_valid))


def fit(views: list[View], size_px: tuple[int, int], model: Model) -> Fit | None:
    """One model by least squares; None where it does not converge to a camera."""
    if model.lens == FISHEYE:
        return _fisheye(views, size_px, model)
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
    if best is None:
        return None
    _, K, d, rvecs, tvecs = best
    terms = tuple(float(c) for c in np.ravel(d)[:5])
    camera = Camera(*size_px, float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]), terms)
    return _assess(views, model, camera, rvecs, tvecs)


def _fisheye(views: list[View], size_px: tuple[int, int], model: Model) -> Fit | None:
    """A fisheye, from the best of several starts."""
    boards = [(view.uv_px, view.points_m) for view in views]
    best: tuple[float, Camera, list[fisheye_fit.Pose]] | None = None
    for wide_rad in fisheye_fit.WIDTHS_RAD:
        camera = fisheye_fit.start(size_px, wide_rad)
        poses = [pose for board in boards if (pose := fisheye_fit.pose_of(camera, board)) is not None]
        if len(poses) < len(boards):
            continue
        for columns in ([0, 1], model.columns):  # at first nothing but how wide it is
            camera, poses, cost = fisheye_fit.refined(camera, boards, poses, columns)
        if min(camera.fx_px, camera.fy_px) > 0.05 * size_px[0] and (best is None or cost < best[0]):
            best = cost, camera, poses
    if best is None:
        return None
    return _assess(views, model, best[1], [turn for turn, _ in best[2]], [place for _, place in best[2]])


def _projected(camera: Camera, points_m: Array, rvec: Array, tvec: Array) -> tuple[Array, Array, Array]:
    """Pixels (N, 2), and their derivatives by the pose (2N, 6) and by all of the camera's parameters (2N, P)."""
    if camera.model == FISHEYE:
        return fisheye_fit.project(camera, points_m, (rvec, tvec))
    K = np.array([[camera.fx_px, 0.0, camera.cx_px], [0.0, camera.fy_px, camera.cy_px], [0.0, 0.0, 1.0]])
    predicted, J = cv2.projectPoints(points_m, rvec, tvec, K, np.array(camera.distortion))
    by_all = np.asarray(J, np.float64)
    return np.asarray(predicted, np.float64).reshape(-1, 2), by_all[:, :6], by_all[:, 6:15]


def _assess(views: list[View], model: Model, camera: Camera, rvecs: list[Array], tvecs: list[Array]) -> Fit:
    """Residuals and covariance at the optimum."""
    columns, names = model.columns, model.parameters
    information = np.zeros((len(columns), len(columns)))
    residuals = []
    for view, rvec, tvec in zip(views, rvecs, tvecs, strict=True):
        predicted, J_pose, J_camera = _projected(camera, view.points_m, rvec, tvec)
        residuals.append(view.uv_px - predicted)
        J_camera = J_camera[:, columns]  # (11.2)
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
    sigmas = dict.fromkeys(names, 0.0) | {names[c]: float(s) for c, s in zip(columns, spread, strict=True)}
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
    rays, valid = camera.unproject(np.stack([u.ravel(), v.ravel()], axis=-1))
    _, J_pose, J_camera = _projected(camera, rays, np.zeros(3), np.zeros(3))
    J_rotation, J_camera = J_pose[:, :3], J_camera[:, columns]
    if camera.model == FISHEYE:  # what has no ray is not seen in any direction
        J_rotation, J_camera = (J * np.repeat(valid, 2)[:, None] for J in (J_rotation, J_camera))
    # The boresight is estimated in flight, so that a rotation common to all pixels does no harm.
    left = J_camera - J_rotation @ np.linalg.lstsq(J_rotation, J_camera, rcond=None)[0]
    variances = np.einsum("ij,jk,ik->i", left, covariance, left).reshape(-1, 2).sum(axis=1)
    sigmas: Array = np.sqrt(np.maximum(variances, 0.0)).reshape(_GRID[1], _GRID[0])
    return sigmas
