"""Names inside a session's MCAP files, and of the files, for writer and readers. docs/wire-format.md, section 9."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

from contract.errors import InputError

METADATA_NAME = "pointclick"


class CameraChannels(NamedTuple):
    """The channels of a camera: its frames, each after its picture and, of a thermal camera, its counts."""

    frames: str
    pictures: str
    counts: str


FRAMES = "pc/{vehicle}/frames"
PICTURES = "pc/{vehicle}/pictures"
FIRST_CAMERA = CameraChannels(FRAMES, PICTURES, "pc/{vehicle}/counts")
SECOND_CAMERA = CameraChannels(
    "pc/{vehicle}/thermal/frames", "pc/{vehicle}/thermal/pictures", "pc/{vehicle}/thermal/counts"
)
POSITIONS = "pc/{vehicle}/position"
GPS_QUALITY = "pc/{vehicle}/gps_quality"
ATTITUDES = "pc/{vehicle}/attitude"
FILTERS = "pc/{vehicle}/filter"
GIMBALS = "pc/{vehicle}/gimbal"
RANGES = "pc/{vehicle}/range"
ZOOMS = "pc/{vehicle}/zoom"
HOMES = "pc/{vehicle}/home"
GAPS = "pc/{vehicle}/gaps"
# For viewers alone, as schemas that Foxglove supports.
VIEW_VEHICLE = "pc/{vehicle}/view/vehicle"
VIEW_CAMERA = "pc/{vehicle}/view/camera"
VIEW_FEATURES = "pc/{vehicle}/view/features"

SUFFIX = ".mcap"
_PART = re.compile(r"^(.+)\.(\d{3,6})\.mcap$")


def part_name(session: str, part: int) -> str:
    """File of a live session's part, from 1: `NAME.001.mcap`, `NAME.002.mcap`, ..."""
    return f"{session}.{part:03d}{SUFFIX}"


def split_part(name: str) -> tuple[str, int] | None:
    """Session and part of a file's name, part 0 for a file that is a session by itself; None for no recording."""
    found = _PART.match(name)
    if found is not None and part_name(found[1], int(found[2])) == name:
        return found[1], int(found[2])
    return (name.removesuffix(SUFFIX), 0) if name.endswith(SUFFIX) and not name.startswith(".") else None


def session_parts(names: list[str], one: str) -> list[str]:
    """Select the `names` that are parts of the session of `one`, in order; `one` alone if it is a session itself."""
    this = split_part(one)
    if this is None or this[1] == 0 or one not in names:
        return [one]
    found = [(split[1], name) for name in names if (split := split_part(name)) and split[0] == this[0] and split[1]]
    return [name for _, name in sorted(found)]


def session_files(path: Path) -> list[Path]:
    """All files of the session that a file belongs to, or of the one session in a folder, in order.

    Raises InputError for a folder without a session, or with several. A file that is not there is returned: opening
    the message gives the reason.
    """
    if not path.is_dir():
        try:
            siblings = [file.name for file in path.parent.iterdir()]
        except OSError:
            return [path]
        return [path.with_name(name) for name in session_parts(siblings, path.name)]
    found = sorted(file.name for file in path.iterdir() if split_part(file.name))
    sessions = sorted({split[0] for name in found if (split := split_part(name))})
    if not sessions:
        raise InputError(f"recording {path}: is a directory without a recording in it")
    if len(sessions) > 1:
        some = ", ".join(sessions[:3]) + (", ..." if len(sessions) > 3 else "")
        raise InputError(f"recording {path}: is a directory of {len(sessions)} sessions ({some}); name one")
    return [path / name for name in session_parts(found, found[0])]
