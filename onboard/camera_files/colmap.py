"""COLMAP's cameras.txt: CAMERA_ID MODEL WIDTH HEIGHT PARAMS[].

colmap's sensor/models.h: the models' parameters in these orders, of OpenCV's projections; the picture's corner is
(0, 0), the middle of the top-left pixel (0.5, 0.5).
"""

from __future__ import annotations

import re
from typing import Any

from contract.errors import InputError
from contract.lens import FISHEYE, PINHOLE
from contract.stated_values import each_once
from onboard.camera_files.stated_lens import (
    MAX_PX,
    Further,
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

MODELS = {
    "SIMPLE_PINHOLE": "f cx cy",
    "PINHOLE": "fx fy cx cy",
    "SIMPLE_RADIAL": "f cx cy k1",
    "RADIAL": "f cx cy k1 k2",
    "OPENCV": "fx fy cx cy k1 k2 p1 p2",
    "FULL_OPENCV": "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6",
}
FISHEYES = {
    "SIMPLE_FISHEYE": "f cx cy",
    "FISHEYE": "fx fy cx cy",
    "SIMPLE_RADIAL_FISHEYE": "f cx cy k1",
    "RADIAL_FISHEYE": "f cx cy k1 k2",
    "OPENCV_FISHEYE": "fx fy cx cy k1 k2 k3 k4",
}
WIDE = ("THIN_PRISM_FISHEYE", "RAD_TAN_THIN_PRISM_FISHEYE", "FOV", "EUCM")  # projections of their own
HALF = 0.5
_LINE = re.compile(r"(\d+)\s+([A-Z][A-Z_0-9]+)\s+(\S.*)")


def is_colmap(content: object) -> bool:
    """Return whether its first line that is no remark is one of COLMAP's cameras."""
    return isinstance(content, str) and bool(_cameras(content))


def _cameras(text: str) -> dict[str, tuple[str, list[str]]]:
    lines = [line.strip() for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    found = [_LINE.fullmatch(line) for line in lines]
    if not found or found[0] is None:
        return {}
    if None in found:
        raise InputError(f"line {lines[found.index(None)][:40]!r} is not CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]")
    try:
        return each_once((one[1], (one[2], one[3].split())) for one in found if one is not None)
    except ValueError as error:
        raise InputError(f"camera {error}") from error


def read_colmap(content: Any, which: str | None, size_px: Size | None) -> StatedLens:
    """Read one camera. Raises InputError."""
    _, (model, texts) = chosen(_cameras(content), which)
    if model in WIDE:
        raise fisheye(model)
    known = MODELS | FISHEYES
    if model not in known:
        raise unknown_model(model, known)
    names = known[model].split()
    if len(texts) != 2 + len(names):
        raise InputError(f"{model} has {len(texts)} values and not {2 + len(names)}: width, height, {known[model]}")
    size = whole_size(texts[0], texts[1], "width and height")
    v = {name: real(text, name, MAX_PX) for name, text in zip(names, texts[2:], strict=True)}
    fx, fy = (focal(v.get(name, v.get("f")), name) for name in ("fx", "fy"))
    k1, k2, p1, p2, k3, *below = (v.get(name, 0.0) for name in ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"))
    is_fisheye, took = model in FISHEYES, (f"{model} {known[model]}", "width", "height")
    return StatedLens(
        size_of(size, size_px), fx, fy, v["cx"] - HALF, v["cy"] - HALF,
        (k1, k2, k3, below[0]) if is_fisheye else (k1, k2, p1, p2, k3),
        Further() if is_fisheye else Further(below=(below[0], below[1], below[2])),
        took=took, model=FISHEYE if is_fisheye else PINHOLE,
    )  # fmt: skip
