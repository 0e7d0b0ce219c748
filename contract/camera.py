"""Intrinsics of a pinhole with OpenCV's five-coefficient distortion, or of a fisheye: pixel <-> ray, with validity.

Pixel (0, 0) is the centre of the top-left pixel; the camera looks along +z with x to the right and y down. The models
are those of `contract/lens.py`. A fitted polynomial need not be invertible over the whole picture (it may fold back
before the corner), and a fisheye's rays end 80 degrees off its axis: such pixels have no ray, and `unproject` marks
them invalid.
"""

from __future__ import annotations

import json
from dataclasses import InitVar, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contract.errors import InputError
from contract.lens import FISHEYE, MAX_ANGLE, MODELS, PINHOLE, SMALL_RADIUS, Lens
from contract.stated_values import check_keys, number, numbers, object_of, whole
from contract.zoom_table import ZoomTable

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Sigma = tuple[float, float, float, float, float]

# What a camera file without sigmas may be wrong about: see `Camera.sigma`. A lens of the same type and a data
# sheet give the focal length to some per cent, and k1 and k2 to about this.
UNKNOWN_SIGMA = (0.02, 0.01, 0.01, 0.05, 0.05)
SIGMA_KEYS = ("fx", "cx", "cy", "k1", "k2")  # of a camera file's calibration, in the order of `Camera.sigma`
DISTORTION, FISHEYE_DISTORTION = "distortion_opencv_k1_k2_p1_p2_k3", "distortion_fisheye_k1_k2_k3_k4"
COEFFICIENTS = {PINHOLE: DISTORTION, FISHEYE: FISHEYE_DISTORTION}  # by model
PIXEL_ASPECT = "pixel_aspect"
INTRINSICS = ("size_px", "fx_px", "fy_px", "cx_px", "cy_px")
KEYS = ("model", *INTRINSICS, *COEFFICIENTS.values(), "calibration", "zoom", PIXEL_ASPECT)
# What `calibrate` writes of how good it is; only the sigmas are used.
ABOUT = (
    *("sigma", "verdict", "views", "reprojection_rms_px", "distortion_model", "worst_direction_sigma_px"),
    "from_flight",
)
ALL_SIGMAS = (*SIGMA_KEYS, "fy", "p1", "p2", "k3", "k4")
# Of what a lens without a fisheye's projection can be: 157 to 0.3 degrees wide; pixels up to twice as wide as high.
FOCAL_SHARES = (0.1, 200.0)  # of the picture's longer side
MAX_ASPECT = 2.0
# Of a pixel that is not declared to have another shape: analogue video's are up to 1.1 times as wide as high, or as
# high as wide. More is more often a mistyped number than squeezed pixels.
MAX_UNDECLARED_ASPECT = 1.12
SAME_ASPECT = 0.05
MAX_SIZE_PX = 100_000
MAX_SPREAD = 1.3  # of half of the picture's radii, against a lens's without distortion: a pincushion's are 1.1
MAX_COEFFICIENT = 1e6  # of a long lens, whose picture ends at a hundredth of its focal length
WITHIN_PX = 1e-3  # that a ray's pixel comes back to, (2.4)


@dataclass(frozen=True)
class Camera:
    """Intrinsics in pixels; `distortion` is OpenCV's k1, k2, p1, p2, k3, or of the model `fisheye` k1, k2, k3, k4.

    `sigma`: one sigma of the focal length (relative), of the principal point (x, y, in focal lengths), of k1 and of k2.
    `zoom`: what the lens becomes at other zoom positions. Both are no part of what the camera is: two cameras are equal
    without them, `replace` drops them and the wire does not carry them.
    """

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    distortion: tuple[float, ...] = field(default=(0.0, 0.0, 0.0, 0.0, 0.0))
    model: str = PINHOLE
    stated_sigma: InitVar[Sigma | None] = None  # none: the camera is taken as it is
    stated_zoom: InitVar[ZoomTable | None] = None
    sigma: ClassVar[Sigma] = (0.0, 0.0, 0.0, 0.0, 0.0)
    zoom: ClassVar[ZoomTable | None] = None

    def __post_init__(self, stated_sigma: Sigma | None, stated_zoom: ZoomTable | None) -> None:
        """Keep sigmas and zoom separate from the fields, because they are no part of what the camera is.

        Raises ValueError for coefficients that are not as many as the model has.
        """
        if len(self.distortion) != len(MODELS[self.model].names):
            raise ValueError(f"a {self.model} has {', '.join(MODELS[self.model].names)}, not {self.distortion}")
        if stated_sigma is not None:
            object.__setattr__(self, "sigma", stated_sigma)
        if stated_zoom is not None:
            object.__setattr__(self, "zoom", stated_zoom)

    @classmethod
    def from_field_of_view(cls, width_px: int, height_px: int, hfov_deg: float) -> Camera:
        """An ideal camera with square pixels and its principal point at the picture's middle."""
        focal = 0.5 * width_px / np.tan(np.radians(hfov_deg) / 2.0)
        return cls(width_px, height_px, focal, focal, (width_px - 1) / 2.0, (height_px - 1) / 2.0)

    @classmethod
    def from_json(cls, path: Path | str) -> Camera:
        """Read a camera file; raises InputError naming the file and the key that is wrong."""
        try:
            text = Path(path).read_text()
        except OSError as error:
            raise InputError(f"camera file {path}: {error.strerror}") from error
        except ValueError as error:
            raise InputError(f"camera file {path}: not JSON ({error})") from error
        return cls.from_text(text, f"camera file {path}")

    @classmethod
    def from_text(cls, text: str, what: str) -> Camera:
        """The text of a camera file; `what` names it in an InputError."""
        raw = object_of(text, what)
        check_keys(raw, KEYS, what, needed=INTRINSICS)
        model = _model(raw, what)
        size = raw["size_px"]
        if not isinstance(size, list) or len(size) != 2:
            raise InputError(f"{what}: size_px must be a list of width and height")
        width, height = (whole(n, 16, MAX_SIZE_PX, f"{what}: size_px") for n in size)
        low, high = (share * max(size) for share in FOCAL_SHARES)
        fx, fy = (number(raw[key], low, high, f"{what}: {key}") for key in INTRINSICS[1:3])
        _check_pixel(fx, fy, raw.get(PIXEL_ASPECT), what)
        cx = number(raw["cx_px"], -0.5, width - 0.5, f"{what}: cx_px")
        cy = number(raw["cy_px"], -0.5, height - 0.5, f"{what}: cy_px")
        key, count = COEFFICIENTS[model], len(MODELS[model].names)
        stated = numbers(raw.get(key, [0.0] * count), count, MAX_COEFFICIENT, f"{what}: {key}")
        zoom = None if raw.get("zoom") is None else ZoomTable.from_json(raw["zoom"], what)
        camera = cls(width, height, fx, fy, cx, cy, tuple(stated), model, UNKNOWN_SIGMA, zoom)
        camera.check_use(what)
        sigmas = _stated_sigmas(raw.get("calibration"), f"{what}: calibration")
        if sigmas is None:
            return camera
        f = camera.focal_px
        return replace(
            camera, stated_zoom=zoom, stated_sigma=(sigmas[0] / fx, sigmas[1] / f, sigmas[2] / f, sigmas[3], sigmas[4])
        )

    def check_use(self, what: str) -> None:
        """Raise InputError where half of the picture or more has no ray, or is spread far wider than by any lens: none
        is such, its distortion is wrong. What a fisheye shows beyond the angle at which its rays end does not count.
        """
        grid = np.stack(np.meshgrid(*(np.linspace(0.0, n - 1.0, 9) for n in self.size_px)), axis=-1)
        rays, counted = self.unproject(grid)
        before, after = (np.linalg.norm(xy, axis=-1) for xy in (rays[..., :2], self.distort(rays[..., :2])))
        spread = (after / np.maximum(before, SMALL_RADIUS))[counted]
        if self.model == FISHEYE:
            off_axis = np.hypot(*np.moveaxis((grid - (self.cx_px, self.cy_px)) / (self.fx_px, self.fy_px), -1, 0))
            counted = counted[off_axis <= MAX_ANGLE]
        share = float(np.mean(counted)) if counted.size else 0.0
        doubt = f"are the coefficients {_WHOSE[self.model]} {', '.join(MODELS[self.model].names)}, and for this size?"
        if share < 0.5:
            used = f"only {100.0 * share:.0f} % of the picture can be used"
            raise InputError(f"{what}: by its distortion {used}; {doubt}")
        if np.median(spread) > MAX_SPREAD:
            wide = f"half of the picture is spread more than {np.median(spread):.3g} times as wide as without"
            raise InputError(f"{what}: by its distortion {wide}; {doubt}")

    def to_json(self) -> str:
        """The camera file's text; `from_json` reads it back exactly."""
        return json.dumps(
            {
                "model": self.model,
                "size_px": [self.width_px, self.height_px],
                "fx_px": self.fx_px,
                "fy_px": self.fy_px,
                "cx_px": self.cx_px,
                "cy_px": self.cy_px,
                COEFFICIENTS[self.model]: list(self.distortion),
                "calibration": {"sigma": dict(zip(SIGMA_KEYS, self._sigma_as_written(), strict=True))},
                **({} if is_nearly_square(self.fx_px, self.fy_px) else {PIXEL_ASPECT: self.fy_px / self.fx_px}),
                **({} if self.zoom is None else {"zoom": self.zoom.to_json()}),
            },
            indent=1,
        )

    def _sigma_as_written(self) -> list[float]:
        units = (self.fx_px, self.focal_px, self.focal_px, 1.0, 1.0)
        return [s * unit for s, unit in zip(self.sigma, units, strict=True)]

    def zoomed(self, log_focal: float) -> Camera:
        """The same camera with another focal length (the logarithm of its geometric mean, px), as its zoom has it.

        The sigma of the principal point stays what it is in pixels. Without a zoom table only the focal length changes.
        """
        grown = float(np.exp(log_focal)) / self.focal_px
        cx, cy, k1 = (self.cx_px, self.cy_px, self.distortion[0]) if self.zoom is None else self.zoom.at(log_focal)
        f, x, y, s1, s2 = self.sigma
        return replace(
            self,
            fx_px=self.fx_px * grown,
            fy_px=self.fy_px * grown,
            cx_px=cx,
            cy_px=cy,
            distortion=(k1, *self.distortion[1:]),
            stated_sigma=(f, x / grown, y / grown, s1, s2),
            stated_zoom=self.zoom,
        )

    @property
    def size_px(self) -> tuple[int, int]:
        """Width, height."""
        return self.width_px, self.height_px

    @property
    def focal_px(self) -> float:
        return float(np.sqrt(self.fx_px * self.fy_px))

    @property
    def hfov_deg(self) -> float:
        """The angle from the left to the right border, its distortion left out."""
        across = 0.5 * self.width_px / self.fx_px
        return float(np.degrees(2.0 * (across if self.model == FISHEYE else np.arctan(across))))

    def fx_of_hfov(self, hfov_deg: float) -> float:
        """The fx, px, with which the camera would be so wide: the inverse of `hfov_deg`."""
        across = np.radians(hfov_deg) / 2.0
        return float(0.5 * self.width_px / (across if self.model == FISHEYE else np.tan(across)))

    @cached_property
    def lens(self) -> Lens:
        """The model with its coefficients."""
        return MODELS[self.model](*self.distortion)

    @property
    def max_radius(self) -> float:
        """The largest undistorted radius (normalised) up to which the lens is used. (2.3), (30.2)"""
        return self.lens.max_radius

    def distort(self, xy: ArrayLike) -> Array:
        """Undistorted normalised image coordinates (..., 2) -> distorted ones, (2.1) or (30.1)."""
        xy = np.asarray(xy, float)
        flat = np.ascontiguousarray(xy.reshape(-1, 2).T)
        return (flat + self.lens.displacement(flat)).T.reshape(xy.shape)

    def pixels(self, xy: ArrayLike) -> Array:
        """Undistorted normalised image coordinates (..., 2) -> pixels, wherever these are."""
        return self.distort(xy) * (self.fx_px, self.fy_px) + (self.cx_px, self.cy_px)

    def area_gain(self, xy: Array) -> Array:
        """The factor (N,) by which distortion enlarges a small area at undistorted coordinates (N, 2): the
        determinant of (2.2) or (30.3).
        """
        _, along, cross = self.lens.linearised(xy.T)
        out: Array = along[0] * along[1] - cross * cross
        return out

    def project(self, points_cam_m: ArrayLike) -> tuple[Array, Mask]:
        """Points in camera axes (..., 3) -> pixels (..., 2) and whether each is ahead and inside the picture."""
        points = np.asarray(points_cam_m, float)
        z = points[..., 2]
        ahead = z > 1e-9
        xy = points[..., :2] / np.where(ahead, z, 1.0)[..., None]
        usable = ahead & (np.hypot(xy[..., 0], xy[..., 1]) <= self.max_radius)
        uv = self.pixels(xy)
        return uv, usable & self.contains(uv)

    def rayless(self) -> Mask | None:
        """The pixels (H, W) beyond the angle at which a fisheye's rays end; None where there are none, or a pinhole."""
        if self.model != FISHEYE:
            return None
        end = float(self.distort((self.max_radius, 0.0))[0])
        across = (np.arange(self.width_px) - self.cx_px) / self.fx_px
        down = (np.arange(self.height_px) - self.cy_px) / self.fy_px
        beyond: Mask = np.hypot(across, down[:, None]) > end
        return beyond if beyond.any() else None

    def contains(self, uv_px: ArrayLike) -> Mask:
        """Return a mask (...) of the pixels (..., 2) inside the picture, its half-pixel border included."""
        uv = np.asarray(uv_px, float)
        u, v = uv[..., 0], uv[..., 1]
        return (u >= -0.5) & (v >= -0.5) & (u <= self.width_px - 0.5) & (v <= self.height_px - 0.5)

    def unproject(self, uv_px: ArrayLike, near: Array | None = None) -> tuple[Array, Mask]:
        """Pixels (..., 2) -> rays (x, y, 1), (..., 3), and validity; see (2.4).

        `near` (..., 2): x, y of these rays by nearly the same camera, for Newton to begin at. An invalid pixel (off the
        picture, or where the calibration folds) has a finite but meaningless ray.
        """
        uv = np.asarray(uv_px, float)
        xy = (uv - (self.cx_px, self.cy_px)) / (self.fx_px, self.fy_px)
        valid = self.contains(uv)
        if not self.lens.is_ideal:
            target = np.ascontiguousarray(xy.reshape(-1, 2).T)
            start = None if near is None else np.ascontiguousarray(near.reshape(-1, 2).T)
            found, converged = self.lens.undistorted(target, start, WITHIN_PX / self.focal_px)
            xy = found.T.reshape(uv.shape)
            valid &= converged.reshape(valid.shape)
        rays = np.ones((*uv.shape[:-1], 3))
        rays[..., :2] = np.where(np.isfinite(xy), xy, 0.0)
        return rays, valid


_WHOSE = {PINHOLE: "OpenCV's", FISHEYE: "OpenCV's fisheye's"}


def _model(raw: dict[str, Any], what: str) -> str:
    """Return the model of a camera file, checked: coefficients of the other are refused. Raises InputError."""
    model = raw.get("model", PINHOLE)
    if not isinstance(model, str) or model not in COEFFICIENTS:
        raise InputError(f"{what}: model {model!r} is not known; use {' or '.join(map(repr, COEFFICIENTS))}")
    for other, key in COEFFICIENTS.items():
        if other != model and key in raw:
            raise InputError(f"{what}: {key} is of the model {other!r}, and this camera's is {model!r}")
    return model


def _stated_sigmas(raw: object, what: str) -> list[float] | None:
    """The calibration's sigmas in the order of `SIGMA_KEYS`; None if it states none. Raises InputError."""
    if raw is None:
        return None
    if not isinstance(raw, dict):
        raise InputError(f"{what} must be a JSON object")
    check_keys(raw, ABOUT, what)
    stated = raw.get("sigma")
    if stated is None:
        return None
    if not isinstance(stated, dict):
        raise InputError(f"{what}.sigma must be a JSON object")
    check_keys(stated, ALL_SIGMAS, f"{what}.sigma", needed=SIGMA_KEYS)
    return [number(stated[key], 0.0, 1e6, f"{what}.sigma: {key}") for key in SIGMA_KEYS]


def is_nearly_square(fx_px: float, fy_px: float) -> bool:
    """Return whether pixels have a shape that needs no declaration."""
    return max(fx_px / fy_px, fy_px / fx_px) <= MAX_UNDECLARED_ASPECT


def _check_pixel(fx_px: float, fy_px: float, declared: object, what: str) -> None:
    """Raise InputError unless the pixels are nearly square, or of the shape that the file declares."""
    aspect = fy_px / fx_px
    if not 1.0 / MAX_ASPECT <= aspect <= MAX_ASPECT:
        raise InputError(f"{what}: fx_px is {1.0 / aspect:.3g} times fy_px: no pixel has such a shape")
    if declared is not None:
        stated = number(declared, 1.0 / MAX_ASPECT, MAX_ASPECT, f"{what}: {PIXEL_ASPECT}")
        if abs(stated / aspect - 1.0) > SAME_ASPECT:
            raise InputError(f"{what}: {PIXEL_ASPECT} is {stated:g}, and fy_px is {aspect:.4g} times fx_px")
    elif not is_nearly_square(fx_px, fy_px):
        raise InputError(
            f"{what}: fy_px is {aspect:.4g} times fx_px: one is wrong, or pixels are not square; if so add "
            f'"{PIXEL_ASPECT}": {aspect:.4g}, their width over their height'
        )
