"""Each tool's file of one lens, and where that tool's own equations put a direction: independent of the readers.

The lens is written in each tool's own terms; `PROJECTIONS` are written from the tools' documents (cited in the readers)
and return coordinates as the tool counts them, which `corner` turns into ours.
"""

from collections.abc import Callable
from dataclasses import dataclass

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
    text: str
    project: Callable[[Array, Array], tuple[Array, Array]]
    corner: float = 0.0
    size: tuple[int, int] | None = None


ROS = f"""image_width: {W}
image_height: {H}
camera_name: belly
camera_matrix:
  rows: 3
  cols: 3
  data: [{F}, 0., {CX}, 0., {FY}, {CY}, 0., 0., 1.]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [{K1}, {K2}, {P1}, {P2}, {K3}]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1., 0., 0., 0., 1., 0., 0., 0., 1.]
"""
OPENCV = f"""%YAML:1.0
---
calibration_time: "Fri 12 Jun 2026"
image_width: {W}
image_height: {H}
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ {F}, 0., {CX}, 0., {FY}, {CY}, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ {K1}, {K2}, {P1}, {P2},
       {K3} ]
avg_reprojection_error: 2.1e-01
"""
OPENCV_XML = f"""<?xml version="1.0"?>
<opencv_storage>
<image_Width>{W}</image_Width>
<image_Height>{H}</image_Height>
<Camera_Matrix type_id="opencv-matrix">
  <rows>3</rows><cols>3</cols><dt>d</dt>
  <data>{F} 0. {CX} 0. {FY} {CY} 0. 0. 1.</data></Camera_Matrix>
<Distortion_Coefficients type_id="opencv-matrix">
  <rows>5</rows><cols>1</cols><dt>d</dt>
  <data>{K1} {K2} {P1} {P2} {K3}</data></Distortion_Coefficients>
</opencv_storage>
"""
KALIBR = f"""cam0:
  cam_overlaps: []
  camera_model: pinhole
  distortion_coeffs: [{K1}, {K2}, {P1}, {P2}]
  distortion_model: radtan
  intrinsics: [{F}, {FY}, {CX}, {CY}]
  resolution: [{W}, {H}]
  rostopic: /cam0/image_raw
  T_cam_imu:
  - [1.0, 0.0, 0.0, 1e-05]
  - [0.0, 1.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 0.0, 0.0, 1.0]
"""
TERMS = f"""<f>{FY}</f><cx>10.25</cx><cy>-19.5</cy><b1>{F - FY}</b1><k1>{K1}</k1><k2>{K2}</k2><k3>{K3}</k3>
<p1>{P1}</p1><p2>{P2}</p2>"""
METASHAPE = f"""<?xml version="1.0" encoding="UTF-8"?>
<calibration><projection>frame</projection><width>{W}</width><height>{H}</height>
{TERMS}<date>2026-06-12T10:15:23Z</date></calibration>
"""
METASHAPE_PROJECT = f"""<?xml version="1.0" encoding="UTF-8"?>
<document version="2.0.0"><chunk label="Chunk 1"><sensors next_id="1"><sensor id="0" label="M3M" type="frame">
<resolution width="{W}" height="{H}"/>
<calibration type="frame" class="initial"><resolution width="{W}" height="{H}"/><f>3000</f></calibration>
<calibration type="frame" class="adjusted"><resolution width="{W}" height="{H}"/>
{TERMS}</calibration>
<covariance><params>f cx cy b1 k1</params><coeffs>16 0 0 3 0  0 4 0 0 0  0 0 9 0 0  3 0 0 2 0  0 0 0 0 1e-6</coeffs>
</covariance></sensor></sensors></chunk></document>
"""
PIX4D = f"""Pix4D camera calibration file 0
#Focal Length mm assuming a sensor width of {W * 0.0024}x{H * 0.0024}mm
F {F * 0.0024}
#Principal Point mm
Px {CX * 0.0024}
Py {CY * 0.0024}
#Symmetrical Lens Distortion Coeffs
K1 {K1}
K2 {K2}
K3 {K3}
#Tangential Lens Distortion Coeffs
T1 {P1}
T2 {P2}
"""
P4D = f"""<?xml version="1.0"?>
<pix4d><inputs><camera cameraId="M3M" id=""><imageWidth value="{W}"/><imageHeight value="{H}"/>
<pixelSize value="2.4"/><principalPointXmm value="{CX * 0.0024}"/><principalPointYmm value="{CY * 0.0024}"/>
<cameraType value="perspective"/><focalLengthmm value="{F * 0.0024}"/><radialK1 value="{K1}"/><radialK2 value="{K2}"/>
<radialK3 value="{K3}"/><tangentialT1 value="{P1}"/><tangentialT2 value="{P2}"/></camera></inputs></pix4d>
"""
ODM = f"""{{"v2 dji fc6310r 4000 3000 brown 0.775": {{"projection_type": "brown", "width": {W // 4}, "height": {H // 4},
"focal_x": 0.775, "focal_y": 0.7775, "c_x": 0.0025, "c_y": -0.005,
"k1": {K1}, "k2": {K2}, "p1": {P1}, "p2": {P2}, "k3": {K3}}}}}
"""
OPENSFM = ODM.replace(f"{W // 4}", f"{W}").replace(f"{H // 4}", f"{H}")
COLMAP = f"""# Camera list with one line of data per camera:
#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]
# Number of cameras: 1
1 FULL_OPENCV {W} {H} {F} {FY} {CX} {CY} {K1} {K2} {P1} {P2} {K3} 0 0 0
"""
PINHOLE_D, FISHEYE_D = f"[{K1}, {K2}, {P1}, {P2}, {K3}]", f"[{FK1}, {FK2}, {FK3}, {FK4}]"
ROS_FISHEYE = (
    ROS.replace(f"{F}", f"{FF}").replace(f"{FY}", f"{FFY}").replace("plumb_bob", "equidistant")
    .replace("cols: 5", "cols: 4").replace(PINHOLE_D, FISHEYE_D)
)  # fmt: skip
OPENCV_FISHEYE = (
    OPENCV.replace(f"{F}", f"{FF}").replace(f"{FY}", f"{FFY}").replace("rows: 5", "rows: 4")
    .replace(f"{K1}, {K2}, {P1}, {P2},\n       {K3} ", f"{FK1}, {FK2}, {FK3}, {FK4} ") + "fisheye_model: 1\n"
)  # fmt: skip
KALIBR_FISHEYE = (
    KALIBR.replace(f"{F}", f"{FF}").replace(f"{FY}", f"{FFY}").replace("radtan", "equidistant")
    .replace(f"[{K1}, {K2}, {P1}, {P2}]", FISHEYE_D)
)  # fmt: skip
ODM_FISHEYE = f"""{{"v2 gopro hero9 4000 3000 fisheye_opencv 0.375": {{"projection_type": "fisheye_opencv",
"width": {W // 4}, "height": {H // 4}, "focal_x": {FF / W}, "focal_y": {FFY / W}, "c_x": 0.0025, "c_y": -0.005,
"k1": {FK1}, "k2": {FK2}, "k3": {FK3}, "k4": {FK4}}}}}
"""
OPENSFM_FISHEYE = f"""{{"v2 gopro": {{"projection_type": "fisheye", "width": {W}, "height": {H}, "focal": {FF / W},
"k1": {FK1}, "k2": {FK2}}}}}
"""
COLMAP_FISHEYE = f"1 OPENCV_FISHEYE {W} {H} {FF} {FFY} {CX} {CY} {FK1} {FK2} {FK3} {FK4}\n"
FISHEYES = (
    Written("ros", "fisheye.yaml", ROS_FISHEYE, fisheye),
    Written("opencv", "fisheye.yml", OPENCV_FISHEYE, fisheye),
    Written("kalibr", "fisheye-camchain.yaml", KALIBR_FISHEYE, fisheye),
    Written("opensfm", "fisheye-cameras.json", ODM_FISHEYE, fisheye_opensfm, 0.0, (W, H)),
    Written("opensfm", "fisheye_models.json", OPENSFM_FISHEYE, fisheye_two),
    Written("colmap", "fisheye.txt", COLMAP_FISHEYE, fisheye, 0.5),
)
FILES = (
    *FISHEYES,
    Written("ros", "camera.yaml", ROS, opencv),
    Written("opencv", "out_camera_data.yml", OPENCV, opencv),
    Written("opencv", "out_camera_data.xml", OPENCV_XML, opencv),
    Written("kalibr", "camchain.yaml", KALIBR, kalibr),
    Written("metashape", "calibration.xml", METASHAPE, metashape, 0.5),
    Written("metashape", "cameras.xml", METASHAPE_PROJECT, metashape, 0.5),
    Written("pix4d", "flight.cam", PIX4D, square, 0.5, (W, H)),
    Written("pix4d", "flight.p4d", P4D, square, 0.5),
    Written("opensfm", "cameras.json", ODM, opensfm, 0.0, (W, H)),
    Written("opensfm", "camera_models.json", OPENSFM, opensfm),
    Written("colmap", "cameras.txt", COLMAP, opencv, 0.5),
)
