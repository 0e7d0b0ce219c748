"""OpenSfM's camera_models.json and reconstruction.json, OpenDroneMap's cameras.json.

OpenSfM's "Geometric models": lengths count in the picture's longer side; the origin is the picture's middle, which is
pixel ((w - 1) / 2, (h - 1) / 2) with pixel (0, 0) the middle of the top-left one. So a size of the same shape serves as
well, and OpenDroneMap writes that of its reduced pictures. `brown` is OpenCV's with k3;
`fisheye` and `fisheye_opencv` are OpenCV's fisheye with k1 and k2, and with all four.
"""

from __future__ import annotations

from typing import Any

from contract.errors import InputError
from contract.lens import FISHEYE, PINHOLE
from onboard.camera_files.stated_lens import (
    Size,
    StatedLens,
    chosen,
    fisheye,
    focal,
    mapping,
    needed,
    real,
    size_of,
    unknown_model,
    whole_size,
    word,
)

MODELS = {
    "perspective": ("k1", "k2"),
    "simple_radial": ("k1",),
    "radial": ("k1", "k2"),
    "brown": ("k1", "k2", "p1", "p2", "k3"),
}
FISHEYES = {"fisheye": ("k1", "k2"), "fisheye_opencv": ("k1", "k2", "k3", "k4")}
WIDE = ("fisheye62", "fisheye624", "dual")  # with terms, or a mixture, of their own
SAME_SHAPE = 0.005  # of pictures made smaller, whose sizes are rounded


def is_opensfm(content: object) -> bool:
    """Return whether it is a file of OpenSfM's or OpenDroneMap's cameras."""
    return bool(_cameras(content))


def _cameras(content: object) -> dict[str, Any]:
    if isinstance(content, list):
        content = content[0] if content else None
    if isinstance(content, dict) and isinstance(content.get("cameras"), dict):
        content = content["cameras"]
    if not isinstance(content, dict):
        return {}
    return {str(name): c for name, c in content.items() if isinstance(c, dict) and "projection_type" in c}


def read_opensfm(content: Any, which: str | None, size_px: Size | None) -> StatedLens:
    """Read one camera. Raises InputError."""
    name, found = chosen(_cameras(content), which)
    raw = mapping(found, name)
    model = word(raw["projection_type"], "projection_type")
    if model in WIDE:
        raise fisheye(model)
    known = MODELS | FISHEYES
    if model not in known:
        raise unknown_model(model, known)
    has_one = "focal_x" not in raw and model in ("perspective", "fisheye")
    fx, fy = ("focal", "focal") if has_one else ("focal_x", "focal_y")
    size = _size(raw, size_px)
    longer = max(size)
    if model in FISHEYES and any(real(raw.get(k, 0.0), k) for k in ("p1", "p2")):
        raise InputError("a fisheye with p1 and p2 is not read")
    orders = FISHEYES["fisheye_opencv"] if model in FISHEYES else MODELS["brown"]
    terms = tuple(real(raw.get(k, 0.0) if k in known[model] else 0.0, k) for k in orders)
    used = ("projection_type", "width", "height", fx, fy, "c_x", "c_y", *known[model])
    return StatedLens(
        size,
        longer * focal(needed(raw, fx), fx),
        longer * focal(needed(raw, fy), fy),
        longer * real(raw.get("c_x", 0.0), "c_x", 1.0) + 0.5 * (size[0] - 1),
        longer * real(raw.get("c_y", 0.0), "c_y", 1.0) + 0.5 * (size[1] - 1),
        terms,
        took=tuple(dict.fromkeys(each for each in used if each in raw)),
        left=tuple(each for each in raw if each not in used),
        model=FISHEYE if model in FISHEYES else PINHOLE,
    )


def _size(raw: dict[str, Any], asked: Size | None) -> Size:
    if "width" not in raw and "height" not in raw:
        return size_of(None, asked)
    stated = whole_size(needed(raw, "width"), needed(raw, "height"), "width and height")
    if asked is None:
        return stated
    if abs(asked[0] * stated[1] / (asked[1] * stated[0]) - 1.0) > SAME_SHAPE:
        raise InputError(f"is for {stated[0]}x{stated[1]}, and --size {asked[0]}x{asked[1]} has another shape")
    return asked
