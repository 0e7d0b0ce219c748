"""Pix4D's .cam text and the `<camera>` of its XML (.p4d).

Pix4D's "How are the internal and external camera parameters defined": R1 R2 R3 (K1 K2 K3 in files) are the radial
coefficients, T1 and T2 the tangential ones, 2 T1 x y + T2 (r^2 + 2 x^2): OpenCV's p1 and p2, as OpenAthena's and
GRAPHOS's converters have them too. Millimetres are of the sensor whose width the file states; the principal point
counts from the top-left corner of the top-left pixel (Pix4D's OPF), so a pixel's middle is half a pixel off. Its y
counts down, though that article draws it upwards: a project's .cam and its calibrated_camera_parameters.txt (both of
them in EasyIDP's documentation) have the same one, and there K [R|-Rt] with a rotation looks ahead along +z, which with
x to the right leaves y downwards.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from typing import Any

from contract.errors import InputError
from onboard.camera_files.stated_lens import (
    Size,
    StatedLens,
    chosen,
    fisheye,
    focal,
    real,
    size_of,
    unknown_model,
    whole_size,
)

HEAD = "Pix4D camera calibration file"
TERMS = ("K1", "K2", "T1", "T2", "K3")
XML_TERMS = ("radialK1", "radialK2", "tangentialT1", "tangentialT2", "radialK3")
HALF = 0.5
MAX_MM = 1000.0
MICRONS = 1000.0
SAME_SHAPE = 0.005
_SENSOR = re.compile(r"sensor width of\s*([0-9.eE+-]+)\s*x\s*([0-9.eE+-]+)\s*mm")


def is_pix4d(content: object) -> bool:
    """Return whether it is a .cam, or XML with Pix4D's cameras."""
    if isinstance(content, str):
        return content.startswith(HEAD)
    return isinstance(content, ET.Element) and content.find(".//camera/focalLengthmm") is not None


def read_pix4d(content: Any, which: str | None, size_px: Size | None) -> StatedLens:
    """Read one camera. Raises InputError."""
    return _of_text(content, which, size_px) if isinstance(content, str) else _of_xml(content, which, size_px)


def _of_text(text: str, which: str | None, asked: Size | None) -> StatedLens:
    parts = [part for part in text.split(HEAD) if part.strip()]
    cameras = {part.split(maxsplit=1)[0]: part for part in parts}
    _, part = chosen(cameras, which)
    sensor = _SENSOR.search(part)
    if sensor is None:
        raise InputError("states no sensor width in mm, which its lengths count in")
    wide_mm, high_mm = (real(each, "sensor width", MAX_MM, 0.1) for each in sensor.groups())
    size = size_of(None, asked)
    pixel_mm = wide_mm / size[0]
    if abs(high_mm / size[1] / pixel_mm - 1.0) > SAME_SHAPE:
        raise InputError(
            f"its sensor is {wide_mm:g} x {high_mm:g} mm, and --size {size[0]}x{size[1]} has another shape"
        )
    pairs = dict(line.split() for line in part.splitlines() if re.fullmatch(r"\s*[A-Z][a-zA-Z0-9]*\s+\S+\s*", line))
    for key in ("F", "Px", "Py", *TERMS):
        if key not in pairs:
            raise InputError(f"line {key!r} is missing")
    k1, k2, p1, p2, k3 = (real(pairs[key], key) for key in TERMS)
    f = focal(pairs["F"], "F") / pixel_mm
    cx, cy = (real(pairs[key], key, MAX_MM) / pixel_mm - HALF for key in ("Px", "Py"))
    used = ("F", "Px", "Py", *TERMS)
    return StatedLens(
        size, f, f, cx, cy, (k1, k2, p1, p2, k3),
        took=(*used, "sensor width"),
        left=tuple(key for key in pairs if key not in used),
    )  # fmt: skip


def _of_xml(root: ET.Element, which: str | None, asked: Size | None) -> StatedLens:
    found = [c for c in root.iter("camera") if c.find("focalLengthmm") is not None]
    _, node = chosen({c.get("cameraId") or str(index): c for index, c in enumerate(found)}, which)
    values = {each.tag: each.get("value", each.text or "") for each in node}
    model = values.get("cameraType", "perspective")
    if model == "fisheye":
        raise fisheye(model)
    if model != "perspective":
        raise unknown_model(model, ("perspective",))
    for key in ("imageWidth", "imageHeight", "pixelSize", "principalPointXmm", "principalPointYmm", *XML_TERMS):
        if key not in values:
            raise InputError(f"element {key!r} is missing")
    size = size_of(whole_size(values["imageWidth"], values["imageHeight"], "imageWidth"), asked)
    pixel_mm = real(values["pixelSize"], "pixelSize", 1000.0, 0.1) / MICRONS
    f = focal(values["focalLengthmm"], "focalLengthmm") / pixel_mm
    cx, cy = (real(values[f"principalPoint{axis}mm"], "principalPoint", MAX_MM) / pixel_mm - HALF for axis in "XY")
    k1, k2, p1, p2, k3 = (real(values[key], key) for key in XML_TERMS)
    used = (
        *("imageWidth", "imageHeight", "pixelSize", "focalLengthmm", "principalPointXmm", "principalPointYmm"),
        *("cameraType", *XML_TERMS),
    )
    return StatedLens(
        size, f, f, cx, cy, (k1, k2, p1, p2, k3),
        took=tuple(each for each in used if each in values),
        left=tuple(each for each in values if each not in used),
    )  # fmt: skip
