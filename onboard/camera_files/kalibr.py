"""Kalibr's camchain YAML, and a camera of EuRoC's sensor.yaml, which has the same keys at its top.

Kalibr's wiki, "Yaml formats" and "Supported models": pinhole [fu fv pu pv]; `radtan` [k1 k2 p1 p2] is Brown's in
OpenCV's order, `equidistant` [k1 k2 k3 k4] OpenCV's fisheye. Corners are OpenCV's, so a pixel's middle is whole.
"""

from __future__ import annotations

from typing import Any

from contract.errors import InputError
from contract.lens import FISHEYE, PINHOLE
from onboard.camera_files.opencv_ros import opencv_terms
from onboard.camera_files.stated_lens import (
    Size,
    StatedLens,
    chosen,
    fisheye,
    focal,
    list_of,
    mapping,
    needed,
    size_of,
    unknown_model,
    whole_size,
    word,
)

PLAIN = ("radtan", "radial-tangential", "none")
FISHEYES = ("equidistant", "equi")
WIDE = ("omni", "ds", "eucm", "fov")  # projections of their own
LENS = ("camera_model", "intrinsics")


def is_kalibr(content: object) -> bool:
    return bool(_cameras(content))


def _cameras(content: object) -> dict[str, Any]:
    if not isinstance(content, dict):
        return {}
    if any(key in content for key in LENS):
        return {"camera": content}
    return {str(name): c for name, c in content.items() if isinstance(c, dict) and any(key in c for key in LENS)}


def read_kalibr(content: Any, which: str | None, size_px: Size | None) -> StatedLens:
    """Read one camera of a camchain. Raises InputError."""
    name, found = chosen(_cameras(content), which)
    raw = mapping(found, name)
    model, distortion = (word(needed(raw, key), key) for key in ("camera_model", "distortion_model"))
    if model in WIDE:
        raise fisheye(model)
    if model != "pinhole":
        raise unknown_model(model, ("pinhole",))
    if distortion in WIDE:
        raise fisheye(distortion)
    if distortion not in PLAIN + FISHEYES:
        raise unknown_model(distortion, PLAIN + FISHEYES)
    fx, fy, cx, cy = list_of(needed(raw, "intrinsics"), "intrinsics", (4,))
    key = "distortion_coefficients" if "distortion_coefficients" in raw else "distortion_coeffs"
    values = raw.get(key, []) if distortion == "none" else needed(raw, key)
    if isinstance(values, dict):  # of a sensor.yaml that OpenCV wrote
        values = values.get("data")
    four = list_of(values, key, (0, 4) if distortion == "none" else (4,))
    is_fisheye = distortion in FISHEYES
    terms = tuple(four) if is_fisheye else opencv_terms(four, key)[0]
    if distortion == "none" and any(terms):
        raise InputError(f"distortion_model is 'none', and {key} is not zero")
    size = None
    if "resolution" in raw:
        wide, high = list_of(raw["resolution"], "resolution", (2,))
        size = whole_size(wide, high, "resolution")
    used = ("camera_model", "intrinsics", "distortion_model", key, "resolution")
    return StatedLens(
        size_of(size, size_px), focal(fx, "intrinsics' fu"), focal(fy, "intrinsics' fv"), cx, cy, terms,
        took=tuple(each for each in used if each in raw), left=tuple(each for each in raw if each not in used),
        model=FISHEYE if is_fisheye else PINHOLE,
    )  # fmt: skip
