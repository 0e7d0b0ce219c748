"""ROS's camera_info YAML and OpenCV's FileStorage (YAML, XML, JSON): the same lens under two sets of names.

OpenCV's calib3d: coefficients in the order k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4 [tau_x tau_y]]]], pixel (0, 0) the
middle of the top-left one. ROS's sensor_msgs/distortion_models names `plumb_bob`, `rational_polynomial` (image_geometry
hands both to OpenCV as they are) and the fisheyes `equidistant` and `fisheye`, OpenCV's with its k1 to k4, which a
FileStorage has with `fisheye_model` 1. A projection_matrix is of the rectified
picture.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from typing import Any

from contract.errors import InputError
from contract.lens import FISHEYE, PINHOLE
from contract.stated_values import each_once
from onboard.camera_files.stated_lens import (
    Further,
    Size,
    StatedLens,
    focal,
    list_of,
    mapping,
    needed,
    real,
    size_of,
    unknown_model,
    whole_size,
    word,
)

COUNTS, FISHEYE_COUNTS = (4, 5, 8, 12, 14), (4,)
MATRICES = ("camera_matrix", "Camera_Matrix", "cameraMatrix", "CameraMatrix", "intrinsic_matrix", "K", "k", "mtx")
COEFFICIENTS = (
    *("distortion_coefficients", "Distortion_Coefficients", "distortionCoefficients", "dist_coeffs", "dist_coeff"),
    *("distCoeffs", "DistCoeffs", "D", "d", "dist"),
)
SIZES = (("image_width", "image_height"), ("image_Width", "image_Height"), ("width", "height"))
ROS_MODELS = ("plumb_bob", "rational_polynomial")
ROS_FISHEYES = ("equidistant", "fisheye", "kannala_brandt")


def is_ros(content: object) -> bool:
    return isinstance(content, dict) and "distortion_model" in content and "camera_model" not in content


def is_opencv(content: object) -> bool:
    """Return whether it is a calibration in OpenCV's FileStorage."""
    if isinstance(content, ET.Element):
        return bool(content.tag == "opencv_storage")
    return isinstance(content, dict) and any(key in content for key in (*MATRICES, *COEFFICIENTS))


def read_ros(content: Any, which: str | None, size_px: Size | None) -> StatedLens:
    """Read a camera_info. Raises InputError."""
    raw = mapping(content, "camera_info")
    _only(which, raw)
    model = word(raw["distortion_model"], "distortion_model")
    is_fisheye = model.lower() in ROS_FISHEYES
    if model not in ROS_MODELS and not is_fisheye:
        raise unknown_model(model, ROS_MODELS + ROS_FISHEYES)
    for key in ("binning_x", "binning_y"):
        if real(raw.get(key, 0), key, 64.0, 0.0) > 1.0:
            raise InputError(
                f"{key} is {raw[key]}: its pixels are not those of the matrix; give the calibration itself"
            )
    roi = mapping(raw.get("roi") or {}, "roi")
    if any(real(roi.get(key, 0), f"roi's {key}") != 0.0 for key in ("x_offset", "y_offset")):
        raise InputError("roi cuts the picture, whose pixels are not those of the matrix; give the calibration itself")
    coefficients = _first(raw, COEFFICIENTS) or COEFFICIENTS[0]
    counts = FISHEYE_COUNTS if is_fisheye else (0, *COUNTS)
    return _lens(raw, needed(raw, coefficients), coefficients, counts, size_px)


def read_opencv(content: Any, which: str | None, size_px: Size | None) -> StatedLens:
    """Read OpenCV's FileStorage. Raises InputError, also for four coefficients that may be a fisheye's."""
    raw = _of_xml(content) if isinstance(content, ET.Element) else mapping(content, "FileStorage")
    _only(which, raw)
    is_fisheye = real(raw.get("fisheye_model", 0), "fisheye_model", 1.0, 0.0) != 0.0
    coefficients = _first(raw, COEFFICIENTS) or COEFFICIENTS[0]
    stated = needed(raw, coefficients)
    if len(_flat(stated, coefficients)) == 4 and "fisheye_model" not in raw:
        raise InputError(
            f"{coefficients} has 4 coefficients: k1 k2 p1 p2, or a fisheye's k1 to k4, which it does not state; add "
            "a line fisheye_model: 0 for the former, 1 for the latter (in XML <fisheye_model>0</fisheye_model>)"
        )
    return _lens(raw, stated, coefficients, FISHEYE_COUNTS if is_fisheye else COUNTS, size_px)


def _only(which: str | None, raw: dict[str, Any]) -> None:
    if which not in (None, raw.get("camera_name")):
        raise InputError(f"holds one camera, and none of the name {which!r}: leave --which out")


def _first(raw: dict[str, Any], names: tuple[str, ...]) -> str | None:
    return next((name for name in names if name in raw), None)


def _lens(raw: dict[str, Any], stated: object, name: str, counts: tuple[int, ...], asked: Size | None) -> StatedLens:
    key = _first(raw, MATRICES) or MATRICES[0]
    k = list_of(_flat(needed(raw, key), key), key, (9,))
    if [k[3], k[6], k[7], k[8]] != [0.0, 0.0, 0.0, 1.0]:
        raise InputError(f"{key} is not [fx s cx; 0 fy cy; 0 0 1]")
    values, is_fisheye = list_of(_flat(stated, name), name, counts), counts is FISHEYE_COUNTS
    terms, further = (tuple(values), Further()) if is_fisheye else opencv_terms(values, name)
    sizes = next((pair for pair in SIZES if pair[0] in raw and pair[1] in raw), None)
    size = None if sizes is None else whole_size(raw[sizes[0]], raw[sizes[1]], sizes[0])
    used = [key, name, *(sizes or ()), *(each for each in ("distortion_model", "fisheye_model") if each in raw)]
    return StatedLens(
        size_of(size, asked),
        *(focal(k[0], f"{key}'s fx"), focal(k[4], f"{key}'s fy"), k[2], k[5]),
        terms,
        Further(further.eighth, further.below, further.prism, further.growth, k[1]),
        took=tuple(used),
        left=tuple(each for each in raw if each not in used),
        model=FISHEYE if is_fisheye else PINHOLE,
    )


def opencv_terms(values: list[float], what: str) -> tuple[tuple[float, float, float, float, float], Further]:
    """Return k1 k2 p1 p2 k3, and the rest, of 0 to 14 coefficients in OpenCV's order. Raises InputError for a tilt."""
    k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, tau_x, tau_y = [*values, *[0.0] * (14 - len(values))]
    if (tau_x, tau_y) != (0.0, 0.0):
        raise InputError(f"{what}: a tilted sensor (tau_x, tau_y) is not read: calibrate without it")
    for value in (k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4):
        real(value, what)
    return (k1, k2, p1, p2, k3), Further(below=(k4, k5, k6), prism=(s1, s2, s3, s4))


def _flat(value: object, what: str) -> list[Any]:
    """Return the values of a matrix: rows, cols and data, rows in a list, or a list."""
    if isinstance(value, dict):
        value = needed(value, "data")
    if value is None:
        return []
    if not isinstance(value, list):
        raise InputError(f"{what}: must be a matrix")
    return [each for row in value for each in (row if isinstance(row, list) else [row])]


def _of_xml(root: ET.Element) -> dict[str, Any]:
    def value(node: ET.Element) -> str | list[str]:
        data = node.find("data")
        return (node.text or "").strip() if data is None else (data.text or "").split()

    try:
        return each_once((node.tag, value(node)) for node in root)
    except ValueError as error:
        raise InputError(str(error)) from error
