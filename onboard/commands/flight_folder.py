"""The pictures of a flight within a folder, and what lies with them: its log, its times, its configuration.

A card has its pictures in DCIM/100MEDIA, a flight's folder has them in frames/, and the log lies next to them, above or
below. What is found is named; where there are several of anything, the user names the one.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path

from contract.errors import InputError
from onboard.camera.picture_files import PICTURE_SUFFIXES
from onboard.telemetry.log_files import logs_among

DEEPEST = 4  # folders below the one that was named


def picture_folder(folder: Path) -> Path:
    """The folder itself if it holds pictures, else the only one below it that does. Raises InputError."""
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder of photographs")
    below = [place for place in _folders(folder) if any(_pictures(place))]
    if folder in below:
        return folder
    if len(below) > 1:
        names = ", ".join(str(place) for place in below[:4])
        raise InputError(f"{folder}: pictures in {len(below)} folders below it: name one of them, {names}")
    return below[0] if below else folder


def log_of(pictures: Path, folder: Path) -> Path | None:
    """The log of a flight: next to its pictures, else above them as far as next to the folder that was named, else
    below that. Raises InputError where there are several in a place.
    """
    own, named = pictures.resolve(), folder.resolve()
    above = list(itertools.takewhile(lambda place: place != named.parent, own.parents))
    near = [pictures, *(above if named in own.parents else []), named.parent]
    for place in dict.fromkeys(place.resolve() for place in near):
        if (found := log_in_folder(place)) is not None:
            return pictures / found.name if place == own else found
    below = [log for place in _folders(folder) if (log := log_in_folder(place)) is not None]
    if len(below) > 1:
        names = ", ".join(str(log) for log in below[:4])
        raise InputError(f"{folder}: several logs below it, {names}: name the one to use")
    return below[0] if below else None


def log_in_folder(folder: Path, stem: str | None = None) -> Path | None:
    """The log of a video (the same name), or the only log in a folder. Raises InputError where there are several.

    By content: a folder also has tables of other things in it, such as our own exports.
    """
    try:
        entries = sorted(folder.iterdir())
    except OSError:
        return None  # of a folder that may not be read nothing is taken
    logs = logs_among([entry for entry in entries if entry.is_file()])
    same = [log for log in logs if stem is not None and log.stem.lower() == stem.lower()]
    found = same or logs
    if len(found) > 1:
        raise InputError(f"{folder}: several logs, {', '.join(log.name for log in found[:4])}: name the one to use")
    return found[0] if found else None


def next_to(pictures: Path, name: str) -> Path | None:
    """A file of that name next to the pictures, or above them: FLIGHT/ of FLIGHT/frames and of FLIGHT/DCIM/100MEDIA."""
    for place in (pictures, *pictures.resolve().parents[:2]):
        if (place / name).is_file():
            return place / name
    return None


def _folders(folder: Path, depth: int = DEEPEST) -> Iterator[Path]:
    """A folder and those below it, without hidden ones."""
    yield folder
    try:
        entries = sorted(folder.iterdir())
    except OSError:
        return
    for entry in entries if depth > 0 else []:
        if entry.is_dir() and not entry.name.startswith("."):
            yield from _folders(entry, depth - 1)


def _pictures(folder: Path) -> Iterator[Path]:
    try:
        entries = list(folder.iterdir())
    except OSError:
        return
    yield from (e for e in entries if e.suffix.lower() in PICTURE_SUFFIXES and e.is_file())
