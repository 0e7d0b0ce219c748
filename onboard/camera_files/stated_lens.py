"""A lens as other tools state it: more terms than our camera has, in our pixels; and values out of their files."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from contract.camera import MAX_COEFFICIENT, MAX_SIZE_PX, Sigma
from contract.errors import InputError
from contract.lens import FISHEYE, PINHOLE
from contract.near_word import near_word
from contract.stated_values import number, whole

Array = NDArray[np.float64]
Size = tuple[int, int]
Thing = TypeVar("Thing")
MAX_PX = 1e7


@dataclass(frozen=True)
class Further:
    """Terms that our camera does not have. All zero: it is one of ours.

    `eighth`: the radial polynomial's r^8 (Metashape's K4). `below`: r^2, r^4 and r^6 of the polynomial that divides it,
    `prism`: s1 to s4 (OpenCV). `growth`: r^2 and r^4 of the factor of the tangential part (Metashape's P3, P4).
    `skew_px`: how far y moves u (Metashape's B2; the matrix's upper middle). `tangential`: p1 and p2 of a fisheye.
    """

    eighth: float = 0.0
    below: tuple[float, float, float] = (0.0, 0.0, 0.0)
    prism: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    growth: tuple[float, float] = (0.0, 0.0)
    skew_px: float = 0.0
    tangential: tuple[float, float] = (0.0, 0.0)

    def names(self) -> list[str]:
        """Return what is not zero, in words."""
        named = {
            "r^8": (self.eighth,),
            "the rational k4 k5 k6": self.below,
            "the thin prism's s1 to s4": self.prism,
            "the tangential P3 P4": self.growth,
            "the skew": (self.skew_px,),
            "the tangential P1 P2": self.tangential,
        }
        return [name for name, values in named.items() if any(values)]


@dataclass(frozen=True)
class StatedLens:
    """The content of a file, its principal point counted from the middle of the top-left pixel. Lengths in pixels.

    `sigma`: of a camera, where the file states it. `took` and `left`: what of the file went into it and what did not,
    as the file calls it.
    """

    size_px: Size
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    further: Further = field(default_factory=Further)
    sigma: Sigma | None = None
    took: tuple[str, ...] = ()
    left: tuple[str, ...] = ()
    model: str = PINHOLE  # of a fisheye `distortion` is k1 to k4

    def project(self, xy: Array) -> Array:
        """Undistorted coordinates (N, 2) -> pixels (N, 2). Of a pinhole they are normalised, of a fisheye as far from
        the middle as the angle off the axis, rad.

        OpenCV's calib3d documents polynomial, denominator and prism; Metashape's manual, appendix "Camera models", K4,
        P3, P4, the skew, which acts on distorted coordinates as OpenCV's matrix does, and its equidistant
        fisheye.
        """
        x, y = xy[:, 0], xy[:, 1]
        if self.model == FISHEYE:
            (k1, k2, k3, eighth), (p1, p2) = self.distortion, self.further.tangential
        else:
            (k1, k2, p1, p2, k3), eighth = self.distortion, self.further.eighth
        k4, k5, k6 = self.further.below
        s1, s2, s3, s4 = self.further.prism
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * (k3 + r2 * eighth)))
        radial = radial / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        grown = 1.0 + r2 * (self.further.growth[0] + r2 * self.further.growth[1])
        x2 = x * radial + grown * (2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)) + r2 * (s1 + r2 * s2)
        y2 = y * radial + grown * (p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y) + r2 * (s3 + r2 * s4)
        u = self.fx_px * x2 + self.further.skew_px * y2 + self.cx_px
        return np.stack([u, self.fy_px * y2 + self.cy_px], axis=1)


def real(value: object, what: str, most: float = MAX_COEFFICIENT, least: float | None = None) -> float:
    """Return a number, also one written as text (YAML has 1e-05 so). Raises InputError, which begins with `what`."""
    if isinstance(value, str):
        with contextlib.suppress(ValueError):
            value = float(value)
    return number(value, -most if least is None else least, most, what)


def focal(value: object, what: str) -> float:
    """Return a focal length in pixels or millimetres, above zero. Raises InputError."""
    return real(value, what, MAX_PX, 1e-6)


def list_of(value: object, what: str, counts: Iterable[int]) -> list[float]:
    """Return a list of so many numbers. Raises InputError."""
    allowed = sorted(counts)
    if not isinstance(value, list) or len(value) not in allowed:
        many = " or ".join(map(str, allowed))
        have = f"{len(value)} values" if isinstance(value, list) else "no list"
        raise InputError(f"{what}: {have}: must be a list of {many} numbers")
    return [real(each, what, MAX_PX) for each in value]


def needed(content: Mapping[str, Any], key: str) -> Any:
    """Return the value of a key. Raises InputError for one that is missing, with one that may be meant."""
    if key in content:
        return content[key]
    near = near_word(key, [str(each) for each in content])
    raise InputError(f"key {key!r} is missing" + ("" if near is None else f"; is {near!r} meant for it?"))


def mapping(value: object, what: str) -> dict[str, Any]:
    """Return a mapping whose keys are text. Raises InputError."""
    if not isinstance(value, dict):
        raise InputError(f"{what}: must be a mapping of keys")
    return {str(key): each for key, each in value.items()}


def word(value: object, what: str) -> str:
    """Return a text, as a model's name is. Raises InputError."""
    if not isinstance(value, str):
        raise InputError(f"{what}: must be a word")
    return value


def whole_size(width: object, height: object, what: str) -> Size:
    """Return a picture size. Raises InputError."""
    wide, high = real(width, what, MAX_SIZE_PX, 16.0), real(height, what, MAX_SIZE_PX, 16.0)
    return whole(wide, 16, MAX_SIZE_PX, what), whole(high, 16, MAX_SIZE_PX, what)


def size_of(stated: Size | None, asked: Size | None) -> Size:
    """Return the picture's size as the file states it, else as asked for. Raises InputError without, or for two."""
    if stated is None and asked is None:
        raise InputError("states no picture size, and its pixels count for one only: give it, --size WxH")
    if stated is not None and asked not in (None, stated):
        raise InputError(f"is for {stated[0]}x{stated[1]}, which another --size does not change: leave --size out")
    return stated or asked or (0, 0)


def chosen(cameras: Mapping[str, Thing], which: str | None) -> tuple[str, Thing]:
    """Return the camera of that name, or the only one. Raises InputError for none, or for a choice between several."""
    if not cameras:
        raise InputError("holds no camera")
    listed = ", ".join(repr(name[:40]) for name in list(cameras)[:8]) + (", ..." if len(cameras) > 8 else "")
    if which is None:
        if len(cameras) > 1:
            raise InputError(f"holds {len(cameras)} cameras, {listed}: choose, pc-onboard camera FILE --which NAME")
        return next(iter(cameras.items()))
    if which not in cameras:
        raise InputError(f"holds no camera {which[:40]!r}; it has {listed}")
    return which, cameras[which]


def fisheye(model: str) -> InputError:
    """Return the refusal of a wide lens's model that is not the fisheye of ours."""
    return InputError(
        f"{model[:40]!r} is a fisheye's model that is not read: ours has k1 to k4 of the angle off the axis (OpenCV's "
        "fisheye, Kalibr's equidistant, COLMAP's OPENCV_FISHEYE); export it as one of these, or fly with pictures "
        "that are undistorted to a pinhole's, and their camera"
    )


def unknown_model(model: str, known: Iterable[str]) -> InputError:
    """Return the refusal of a model that is not known, with the one that may be meant."""
    names = list(known)
    near = near_word(model, names)
    hint = f"read are {', '.join(names)}" if near is None else f"did you mean {near!r}?"
    return InputError(f"model {model[:40]!r} is not read; {hint}")
