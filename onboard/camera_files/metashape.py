"""Metashape's calibration XML, and the sensors of its exported cameras.

Metashape's manual, appendix "Camera models", frame cameras: the middle of the top-left pixel is (0.5, 0.5); cx, cy are
offsets from the picture's middle; u = w/2 + cx + x' f + x' B1 + y' B2, v = h/2 + cy + y' f; P1 goes with r^2 + 2 x^2,
so P1 and P2 are OpenCV's p2 and p1. An equidistant fisheye, which was called `fisheye` before 2.3, has the same
polynomials of coordinates that are as long as the angle off the axis. PhotoScan before 1.2 wrote fx, fy and P in
OpenCV's order, and is not read.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from typing import Any

import numpy as np

from contract.camera import Sigma
from contract.errors import InputError
from contract.lens import FISHEYE, PINHOLE
from onboard.camera_files.stated_lens import (
    MAX_PX,
    Further,
    Size,
    StatedLens,
    chosen,
    fisheye,
    focal,
    list_of,
    real,
    size_of,
    unknown_model,
    whole_size,
)

OFFSETS = ("cx", "cy", "b1", "b2")
COEFFICIENTS = ("k1", "k2", "k3", "k4", "p1", "p2", "p3", "p4")
FISHEYES = ("fisheye", "equidistant_fisheye")
EQUISOLID = "equisolid_fisheye"
HALF = 0.5


def is_metashape(content: object) -> bool:
    """Return whether it is a calibration, or has sensors with one."""
    if not isinstance(content, ET.Element):
        return False
    return content.tag == "calibration" or content.find(".//sensor") is not None


def read_metashape(content: Any, which: str | None, size_px: Size | None) -> StatedLens:
    """Read one calibration. Raises InputError."""
    if content.tag == "calibration":
        if which is not None:
            raise InputError("holds one camera without a name: leave --which out")
        return _lens(content, None, size_px)
    sensors: dict[str, ET.Element] = {}
    for sensor in content.iter("sensor"):
        label, number = sensor.get("label") or "sensor", sensor.get("id") or str(len(sensors))
        sensors[f"{label} {number}" if label in sensors else label] = sensor
    adjusted = {name: c for name, s in sensors.items() if (c := _adjusted(s)) is not None}
    if not adjusted:
        raise InputError("has no adjusted calibration, only a first guess: align and optimise, and export again")
    name, calibration = chosen(adjusted, which)
    return _lens(calibration, sensors[name], size_px)


def _adjusted(sensor: ET.Element) -> ET.Element | None:
    return next((c for c in sensor.iter("calibration") if c.get("class") != "initial"), None)


def _lens(node: ET.Element, sensor: ET.Element | None, asked: Size | None) -> StatedLens:
    model = node.get("type") or (node.findtext("projection") or "").strip()
    if model == EQUISOLID:
        raise fisheye(model)
    is_fisheye = model in FISHEYES
    if model != "frame" and not is_fisheye:
        raise unknown_model(model, ("frame", *FISHEYES))
    if node.find("fx") is not None:
        raise InputError("has fx and fy: PhotoScan before 1.2 wrote it, with other meanings; export from a newer")
    f = focal(_text(node, "f"), "f")
    v = {tag: real(node.findtext(tag, "0"), tag, MAX_PX if tag in OFFSETS else 1e6) for tag in OFFSETS + COEFFICIENTS}
    size = size_of(_size(node, sensor), asked)
    fx = focal(f + v["b1"], "f + b1")
    sigma = None if sensor is None else _sigma(sensor.find("covariance"), fx, f)
    used = ["f", *(tag for tag in OFFSETS + COEFFICIENTS if node.find(tag) is not None), "resolution"]
    left = [each.tag for each in (*node, *(() if sensor is None else sensor)) if each.tag not in used]
    return StatedLens(
        size, fx, f, 0.5 * size[0] + v["cx"] - HALF, 0.5 * size[1] + v["cy"] - HALF,
        tuple(v[k] for k in ("k1", "k2", *(("k3", "k4") if is_fisheye else ("p2", "p1", "k3")))),
        Further(
            0.0 if is_fisheye else v["k4"], growth=(v["p3"], v["p4"]), skew_px=v["b2"],
            tangential=(v["p2"], v["p1"]) if is_fisheye else (0.0, 0.0),
        ),
        sigma, took=(*used, *(() if sigma is None else ("covariance",))), model=FISHEYE if is_fisheye else PINHOLE,
        left=tuple(
            tag for tag in dict.fromkeys(left)
            if tag not in {"projection", "width", "height", "calibration"} and (tag != "covariance" or sigma is None)
        ),
    )  # fmt: skip


def _text(node: ET.Element, tag: str) -> str:
    text = node.findtext(tag)
    if text is None:
        raise InputError(f"element {tag!r} is missing")
    return text


def _size(node: ET.Element, sensor: ET.Element | None) -> Size | None:
    if node.find("width") is not None:
        return whole_size(_text(node, "width"), _text(node, "height"), "width and height")
    for place in (node, sensor):
        found = None if place is None else place.find("resolution")
        if found is not None:
            return whole_size(found.get("width"), found.get("height"), "resolution")
    return None


def _sigma(node: ET.Element | None, fx_px: float, fy_px: float) -> Sigma | None:
    """Return what the covariance of the adjustment states, in a camera's units; None without one.

    The focal length's is that of fx = f + b1. None either where one of f, cx, cy and k1 was not adjusted: how well
    that is known is not stated. A k2 that was not is one that the pictures did not need.
    """
    if node is None:
        return None
    names = (node.findtext("params") or "").split()
    count = len(names)
    texts = (node.findtext("coeffs") or "").split()
    square = np.array(list_of(texts, "covariance", (count * count,))).reshape(count, count)
    if not {"f", "cx", "cy", "k1"} <= set(names):
        return None
    jacobian = np.array([[n in {"f", "b1"}, n == "cx", n == "cy", n == "k1", n == "k2"] for n in names])
    variances = np.diagonal(jacobian.T.astype(float) @ square @ jacobian.astype(float))
    if not np.all(variances >= 0.0) or not np.all(variances[:3] > 0.0):
        raise InputError("its covariance is none: a variance is not above zero")
    f, x, y, k1, k2 = np.sqrt(variances)
    length = float(np.sqrt(fx_px * fy_px))
    return float(f) / fx_px, float(x) / length, float(y) / length, float(k1), float(k2)
