"""Each tool's file of one lens, and where that tool's own equations put a direction: independent of the readers.

The files are in tests/data/camera_files, with the lens in each tool's own terms. The projections are written from
the tools' documents (cited in the readers) and return coordinates as the tool counts them: `corner` makes them ours.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
W, H = 4000, 3000
F, FY = 3100.0, 3110.0
CX, CY = 2010.25, 1480.5
FF, FFY = 1500.0, 1504.0
FK1, FK2, FK3, FK4 = -0.031, 0.012, -0.006, 0.0011
K1, K2, K3, P1, P2 = -0.09, 0.03, -0.008, 0.0011, -0.0007


def brown(x: Array, y: Array, p1: float = P1, p2: float = P2) -> tuple[Array, Array]:
    """OpenCV's order of tangential terms."""
    r2 = x**2 + y**2
    d = 1 + K1 * r2 + K2 * r2**2 + K3 * r2**3
    return x * d + 2 * p1 * x * y + p2 * (r2 + 2 * x**2), y * d + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y


def opencv(x: Array, y: Array) -> tuple[Array, Array]:
    a, b = brown(x, y)
    return F * a + CX, FY * b + CY


def square(x: Array, y: Array) -> tuple[Array, Array]:
    a, b = brown(x, y)
    return F * a + CX, F * b + CY


def kalibr(x: Array, y: Array) -> tuple[Array, Array]:
    r2 = x**2 + y**2
    d = 1 + K1 * r2 + K2 * r2**2
    a, b = x * d + 2 * P1 * x * y + P2 * (r2 + 2 * x**2), y * d + P1 * (r2 + 2 * y**2) + 2 * P2 * x * y
    return F * a + CX, FY * b + CY


def metashape(x: Array, y: Array) -> tuple[Array, Array]:
    """The manual's P1 goes with x's square."""
    r2 = x**2 + y**2
    d = 1 + K1 * r2 + K2 * r2**2 + K3 * r2**3
    a = x * d + (P1 * (r2 + 2 * x**2) + 2 * P2 * x * y)
    b = y * d + (P2 * (r2 + 2 * y**2) + 2 * P1 * x * y)
    return W * 0.5 + 10.25 + a * FY + a * (F - FY), H * 0.5 - 19.5 + b * FY


def opensfm(x: Array, y: Array) -> tuple[Array, Array]:
    """Shares of the longer side, from the middle, to pixels by the document's matrix H."""
    a, b = brown(x, y)
    return (0.775 * a + 0.0025) * W + (W - 1) / 2, (0.7775 * b - 0.005) * W + (H - 1) / 2


def fisheye(x: Array, y: Array) -> tuple[Array, Array]:
    """OpenCV's document: the polynomial of the angle."""
    r = np.maximum(np.hypot(x, y), 1e-12)
    a = np.arctan(r)
    d = a * (1 + FK1 * a**2 + FK2 * a**4 + FK3 * a**6 + FK4 * a**8) / r
    return FF * x * d + CX, FFY * y * d + CY


def fisheye_metashape(x: Array, y: Array, p1: float = 0.0, p2: float = 0.0, b2: float = 0.0) -> tuple[Array, Array]:
    """The manual's equidistant fisheye: a frame camera's equations of coordinates as long as the angle."""
    r0 = np.maximum(np.hypot(x, y), 1e-12)
    x, y = x * np.arctan(r0) / r0, y * np.arctan(r0) / r0
    r2 = x**2 + y**2
    d = 1 + FK1 * r2 + FK2 * r2**2 + FK3 * r2**3 + FK4 * r2**4
    a = x * d + (p1 * (r2 + 2 * x**2) + 2 * p2 * x * y)
    b = y * d + (p2 * (r2 + 2 * y**2) + 2 * p1 * x * y)
    return W * 0.5 + 10.75 + a * FFY + a * (FF - FFY) + b * b2, H * 0.5 - 19.0 + b * FFY


def fisheye_opensfm(x: Array, y: Array) -> tuple[Array, Array]:
    """The same, shares of the longer side."""
    a, b = fisheye(x, y)
    return a - CX + 0.0025 * W + (W - 1) / 2, b - CY - 0.005 * W + (H - 1) / 2


def fisheye_two(x: Array, y: Array) -> tuple[Array, Array]:
    """OpenSfM's `fisheye`: one focal length, two coefficients, about the middle."""
    r = np.maximum(np.hypot(x, y), 1e-12)
    a = np.arctan(r)
    d = a * (1 + FK1 * a**2 + FK2 * a**4) / r
    return FF * x * d + (W - 1) / 2, FF * y * d + (H - 1) / 2


@dataclass(frozen=True)
class Written:
    """A file, the projection of its tool, and what that tool's origin is off ours."""

    key: str
    name: str
    project: Callable[[Array, Array], tuple[Array, Array]]
    corner: float = 0.0
    size: tuple[int, int] | None = None

    @property
    def text(self) -> str:
        return sample(self.name)


def sample(name: str) -> str:
    """Return the text of one of the tools' files."""
    return (Path(__file__).parents[2] / "data" / "camera_files" / name).read_text(encoding="utf-8")


ROS = sample("camera.yaml")
OPENCV = sample("out_camera_data.yml")
KALIBR = sample("camchain.yaml")
METASHAPE_FISHEYE = sample("fisheye-calibration.xml")
FISHEYES = (
    Written("ros", "fisheye.yaml", fisheye),
    Written("opencv", "fisheye.yml", fisheye),
    Written("kalibr", "fisheye-camchain.yaml", fisheye),
    Written("opensfm", "fisheye-cameras.json", fisheye_opensfm, 0.0, (W, H)),
    Written("opensfm", "fisheye_models.json", fisheye_two),
    Written("colmap", "fisheye.txt", fisheye, 0.5),
    Written("metashape", "fisheye-calibration.xml", fisheye_metashape, 0.5),
)
FILES = (
    *FISHEYES,
    Written("ros", "camera.yaml", opencv),
    Written("opencv", "out_camera_data.yml", opencv),
    Written("opencv", "out_camera_data.xml", opencv),
    Written("kalibr", "camchain.yaml", kalibr),
    Written("metashape", "calibration.xml", metashape, 0.5),
    Written("metashape", "cameras.xml", metashape, 0.5),
    Written("pix4d", "flight.cam", square, 0.5, (W, H)),
    Written("pix4d", "flight.p4d", square, 0.5),
    Written("opensfm", "cameras.json", opensfm, 0.0, (W, H)),
    Written("opensfm", "camera_models.json", opensfm),
    Written("colmap", "cameras.txt", opencv, 0.5),
)
