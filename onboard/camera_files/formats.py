"""The table of all formats of camera files: choice of reader, refusals, docs/calibrate.md and the tests follow it.

A format is recognised by its content, never by its name. The first row that matches counts.
"""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from contract.camera import Camera
from contract.errors import InputError
from onboard.camera_files.colmap import is_colmap, read_colmap
from onboard.camera_files.document import content_of
from onboard.camera_files.kalibr import is_kalibr, read_kalibr
from onboard.camera_files.metashape import is_metashape, read_metashape
from onboard.camera_files.opencv_ros import is_opencv, is_ros, read_opencv, read_ros
from onboard.camera_files.opensfm import is_opensfm, read_opensfm
from onboard.camera_files.pix4d import is_pix4d, read_pix4d
from onboard.camera_files.reduction import reduced
from onboard.camera_files.stated_lens import Size, StatedLens, size_of


@dataclass(frozen=True)
class CameraFormat:
    """Another tool's calibration. `usually` names its files, `recognised` and `pixels` in words for docs and people.

    `read` takes the content, the name of the camera wanted and the picture size asked for, if any.
    """

    key: str
    name: str
    usually: str
    recognised: str
    pixels: str
    recognises: Callable[[object], bool]
    read: Callable[[Any, str | None, Size | None], StatedLens]


FORMATS = (
    CameraFormat(
        "opensfm", "OpenSfM's or OpenDroneMap's cameras", "camera_models.json, cameras.json", "`projection_type`",
        "shares of the longer side, from the picture's middle; `--size` of the same shape scales", is_opensfm,
        read_opensfm,
    ),
    CameraFormat(
        "kalibr", "Kalibr's camchain", "camchain.yaml", "`camera_model`, `intrinsics`", "as ours", is_kalibr,
        read_kalibr,
    ),
    CameraFormat(
        "ros", "a ROS camera_info", "camera.yaml", "`distortion_model`", "as ours; K and D, not P", is_ros, read_ros
    ),
    CameraFormat(
        "opencv", "an OpenCV FileStorage", ".yml, .xml, .json", "`camera_matrix`", "as ours", is_opencv, read_opencv
    ),
    CameraFormat(
        "metashape", "a Metashape calibration", ".xml", "`<calibration>`, `<sensor>`",
        "cx, cy from the middle; P1 and P2 are OpenCV's p2 and p1; sigmas of its covariance", is_metashape,
        read_metashape,
    ),
    CameraFormat(
        "pix4d", "a Pix4D camera", ".cam, .p4d", "`Pix4D camera calibration file`, `<focalLengthmm>`",
        "mm from the corner; a .cam needs `--size`", is_pix4d, read_pix4d,
    ),
    CameraFormat(
        "colmap", "COLMAP's cameras", "cameras.txt", "`1 OPENCV 640 480 ...`", "from the corner, half a pixel off",
        is_colmap, read_colmap,
    ),
)  # fmt: skip


@dataclass(frozen=True)
class CameraFile:
    """A camera file as read: ours (`form` None, all taken), or another tool's, with what it took and left.

    `off_px`: how far the reduction to our terms is off at worst; `had`: the terms that it did without.
    """

    camera: Camera
    form: CameraFormat | None = None
    took: tuple[str, ...] = ()
    left: tuple[str, ...] = ()
    off_px: float = 0.0
    had: tuple[str, ...] = ()
    has_sigmas: bool = True


def load_camera_file(path: Path | str) -> Camera:
    """Return the camera of a file, ours or another tool's. Raises InputError, one line."""
    return read_camera_file(path).camera


def read_camera_file(path: Path | str, size_px: Size | None = None, which: str | None = None) -> CameraFile:
    """Read a camera file; `size_px` and `which` for those that state no picture size, or hold several cameras.

    Raises InputError, one line, that names the file, the format and what is wrong or lacking.
    """
    what = f"camera file {path}"
    try:
        content = content_of(Path(path))
    except InputError as error:
        raise InputError(f"{what}: {error}") from error
    try:
        form = next((each for each in FORMATS if each.recognises(content)), None)
    except InputError as error:
        raise InputError(f"{what}: {error}") from error
    if form is None:
        return CameraFile(_own(content, what, Path(path), size_px))
    try:
        stated = form.read(content, which, size_px)
        camera, off_px = reduced(stated)
    except InputError as error:
        raise InputError(f"{what}: {form.name}: {error}") from error
    return CameraFile(
        camera, form, stated.took, stated.left, off_px, tuple(stated.further.names()), stated.sigma is not None
    )


def _own(content: object, what: str, path: Path, size_px: Size | None) -> Camera:
    is_ours = path.suffix.lower() == ".json" or (isinstance(content, dict) and "size_px" in content)
    if isinstance(content, ET.Element) or not is_ours:
        names = ", ".join(each.name for each in FORMATS)
        raise InputError(f"{what}: not a camera file; read are ours, as `pc-onboard calibrate` writes it, {names}")
    camera = Camera.from_text(json.dumps(content, default=str, skipkeys=True), what)
    try:
        size_of(camera.size_px, size_px)
    except InputError as error:
        raise InputError(f"{what}: {error}") from error
    return camera


def table() -> str:
    """Return the table of formats, as docs/calibrate.md has it."""
    rows = [("of", "usually", "recognised by", "its pixels"), ("---",) * 4]
    rows += [(each.name, each.usually, each.recognised, each.pixels) for each in FORMATS]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)
