"""Names inside a session's MCAP files, and of the files, for writer and readers. docs/wire-format.md, section 9."""

from __future__ import annotations

import re

SET_ENCODING = "pointclick"
METADATA_NAME = "pointclick"

FRAMES = "pc/{vehicle}/frames"
PICTURES = "pc/{vehicle}/pictures"
POSITIONS = "pc/{vehicle}/position"
GPS_QUALITY = "pc/{vehicle}/gps_quality"
ATTITUDES = "pc/{vehicle}/attitude"
FILTERS = "pc/{vehicle}/filter"
GIMBALS = "pc/{vehicle}/gimbal"
RANGES = "pc/{vehicle}/range"
# For viewers alone, as schemas that Foxglove knows.
VIEW_VEHICLE = "pc/{vehicle}/view/vehicle"
VIEW_CAMERA = "pc/{vehicle}/view/camera"
VIEW_FEATURES = "pc/{vehicle}/view/features"

SUFFIX = ".mcap"
_PART = re.compile(r"^(.+?)(?:\.(\d{3,6}))?\.mcap$")


def part_name(session: str, part: int) -> str:
    """File of a session's part, from 1: `NAME.mcap`, `NAME.002.mcap`, ..."""
    return f"{session}{SUFFIX}" if part == 1 else f"{session}.{part:03d}{SUFFIX}"


def split_part(name: str) -> tuple[str, int] | None:
    """Session and part of a file's name; None if it is no recording's."""
    found = _PART.match(name)
    if found is None:
        return None
    part = int(found[2] or 1)
    return (found[1], part) if part_name(found[1], part) == name else (name[: -len(SUFFIX)], 1)


def session_parts(names: list[str], one: str) -> list[str]:
    """Those of `names` that are parts of the same session as `one`, in order; `one` alone if it is none of them."""
    session = split_part(one)
    if session is None or one not in names:
        return [one]
    parts = [(split[1], name) for name in names if (split := split_part(name)) and split[0] == session[0]]
    return [name for _, name in sorted(parts)]
