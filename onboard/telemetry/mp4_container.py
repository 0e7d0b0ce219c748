"""MP4 and QuickTime files: when they state that they began, and what tracks they have next to the pictures.

Boxes and tables as ISO 14496-12 has them. Pictures are never read here.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from onboard.telemetry.mp4_edits import Edit, edits_of, late_s, shown_s
from onboard.telemetry.row_events import MAX_UNIX_S, MIN_UNIX_S
from onboard.telemetry.telemetry_log import NS_PER_S

EPOCH_1904_S = -2_082_844_800  # of both formats, as Unix time
MOST_TABLE = 64_000_000  # bytes of one table, and of one track's samples: an hour of telemetry has less
MOST_SAMPLES = 2_000_000
MOST_BOXES = 10_000  # among the same

DAMAGED = (OSError, IndexError, ValueError, struct.error)
Box = tuple[bytes, int, int]  # kind, begin and end of the content


@dataclass(frozen=True, eq=False)
class Track:
    """A track that has no pictures and no sound: its handler and the kind of its samples (four characters each), what
    describes them, and each sample's time (s, as it is shown, since the first picture) and content.
    """

    handler: str
    kind: str
    description: bytes
    times_s: tuple[float, ...]
    samples: tuple[bytes, ...]


def begins_mp4(head: bytes) -> bool:
    return head[4:8] in (b"ftyp", b"moov") or (head[4:8] in (b"wide", b"mdat") and head[:2] == b"\0\0")


class _Movie:
    """The boxes of an open file: what its movie's header holds, and where its tracks are; without a movie nothing."""

    def __init__(self, stream: BinaryIO) -> None:
        self.stream = stream
        moov = _first(stream, 0, os.fstat(stream.fileno()).st_size, b"moov")
        boxes = [] if moov is None else list(_boxes(stream, *moov))
        self.header = next((_read(stream, (begin, end)) for kind, begin, end in boxes if kind == b"mvhd"), b"")
        self.hz = _rate_hz(self.header) if self.header else 0.0
        self.tracks = [(begin, end) for kind, begin, end in boxes if kind == b"trak"]

    def first_picture_s(self) -> float:
        """Return when the first picture is shown, s."""
        found = (_shown_from_s(self.stream, *track, self.hz) for track in self.tracks)
        return next((first_s for first_s in found if first_s is not None), 0.0)


def creation_ns(path: Path) -> int | None:
    """Return when a file states that it began, to the second (Unix ns, taken as UTC); None if it does not."""
    try:
        with path.open("rb") as stream:
            header = _Movie(stream).header
        (created_s,) = struct.unpack_from(">Q" if header[0] else ">I", header, 4)
    except DAMAGED:
        return None
    unix_s = int(created_s) + EPOCH_1904_S
    return unix_s * NS_PER_S if MIN_UNIX_S < unix_s < MAX_UNIX_S else None


def tracks_of(path: Path) -> list[Track]:
    """Return the tracks that are neither pictures nor sound. Damaged ones are left out; of a file that is no such
    container there are none.
    """
    try:
        with path.open("rb") as stream:
            movie = _Movie(stream)
            pictures_s = movie.first_picture_s()
            found = [_track(stream, *track, movie.hz, pictures_s) for track in movie.tracks]
    except DAMAGED:
        return []
    return [track for track in found if track is not None]


def shown_since_first_picture_s(path: Path, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return when samples (N,) of a file's telemetry are shown, s since the first picture, by their times on their own
    track; nan for those that are not. Of a file that is no such container they are as they were.

    Raises ValueError where its tracks of telemetry are shown differently: the times do not state of which they are.
    """
    try:
        with path.open("rb") as stream:
            movie = _Movie(stream)
            edits = [_edits_of_telemetry(stream, *track, movie.hz) for track in movie.tracks]
            pictures_s = movie.first_picture_s()
    except (*DAMAGED, KeyError):
        return times_s
    known = [each for each in edits if each is not None]
    if any(each != known[0] for each in known):
        raise ValueError
    return shown_s(times_s, known[0] if known else []) - pictures_s


def first_picture_s(path: Path) -> float:
    """Return when the first picture of a file is shown on its own time, s: 0, unless an edit list begins with nothing,
    or within a picture, which is then not shown. 0 of a file that is no such container.
    """
    try:
        with path.open("rb") as stream:
            return _Movie(stream).first_picture_s()
    except DAMAGED:
        return 0.0


def _edits_of_telemetry(stream: BinaryIO, start: int, end: int, movie_hz: float) -> list[Edit] | None:
    """The edits of a track that has neither pictures, sound nor time codes; None for one that has."""
    media = dict(_inside(stream, start, end, b"mdia"))
    if _read(stream, media[b"hdlr"])[8:12] in (b"vide", b"soun", b"tmcd"):
        return None
    return _edits(stream, start, end, movie_hz, _rate_hz(_read(stream, media[b"mdhd"])))


def _shown_from_s(stream: BinaryIO, start: int, end: int, movie_hz: float) -> float | None:
    """Return when the first of a track of pictures is shown, s; None for another track."""
    try:
        media = dict(_inside(stream, start, end, b"mdia"))
        if (
            _read(stream, media[b"hdlr"])[8:12] != b"vide"
            or (media_hz := _rate_hz(_read(stream, media[b"mdhd"]))) < 1.0
        ):
            return None
        table = dict(_inside(stream, *media[b"minf"], b"stbl"))
        times_s = _times(_read(stream, table[b"stts"]), media_hz)
        if b"ctts" in table:
            times_s = times_s + _compositions_s(_read(stream, table[b"ctts"]), len(times_s), media_hz)
        edits = _edits(stream, start, end, movie_hz, media_hz)
        shown = shown_s(times_s, edits)
        return float(np.nanmin(shown)) if np.isfinite(shown).any() else late_s(edits)  # its pictures are in fragments
    except (KeyError, ValueError, struct.error):
        return None


def _edits(stream: BinaryIO, start: int, end: int, movie_hz: float, media_hz: float) -> list[Edit]:
    """The edits of a track; without a list it is shown as it is."""
    around = _first(stream, start, end, b"edts")
    found = None if around is None else _first(stream, *around, b"elst")
    return [] if found is None else edits_of(_read(stream, found), movie_hz, media_hz)


def _track(stream: BinaryIO, start: int, end: int, movie_hz: float, pictures_s: float) -> Track | None:
    """A track; `pictures_s`: when the first picture is shown."""
    try:
        media = dict(_inside(stream, start, end, b"mdia"))
        handler = _read(stream, media[b"hdlr"])[8:12]
        if handler in (b"vide", b"soun"):
            return None
        table = dict(_inside(stream, *media[b"minf"], b"stbl"))
        entry = _read(stream, table[b"stsd"])[8:]
        if (media_hz := _rate_hz(_read(stream, media[b"mdhd"]))) < 1.0:
            return None
        times_s = _times(_read(stream, table[b"stts"]), media_hz)
        shown = shown_s(times_s, _edits(stream, start, end, movie_hz, media_hz)) - pictures_s
        sizes = _sizes(_read(stream, table[b"stsz"]))
        chunks = (
            _numbers(_read(stream, table[b"stco"]), 4)
            if b"stco" in table
            else _numbers(_read(stream, table[b"co64"]), 8)
        )
        places = _places(sizes, chunks, _read(stream, table[b"stsc"]))
    except (KeyError, IndexError, ValueError, struct.error):
        return None
    if len(times_s) != len(sizes) or int(sizes.sum()) > MOST_TABLE:
        return None
    is_shown = np.isfinite(shown)
    samples = []
    for at, size in zip(places[is_shown].tolist(), sizes[is_shown].tolist(), strict=True):
        stream.seek(at)
        samples.append(stream.read(size))
    return Track(_text(handler), _text(entry[4:8]), entry, tuple(shown[is_shown].tolist()), tuple(samples))


def _inside(stream: BinaryIO, start: int, end: int, name: bytes) -> Iterator[tuple[bytes, tuple[int, int]]]:
    """The boxes in the first box of that name. Raises KeyError without one."""
    found = _first(stream, start, end, name)
    if found is None:
        raise KeyError(name)
    for kind, *content in _boxes(stream, *found):
        yield kind, (content[0], content[1])


def _first(stream: BinaryIO, start: int, end: int, name: bytes) -> tuple[int, int] | None:
    return next(((begin, stop) for kind, begin, stop in _boxes(stream, start, end) if kind == name), None)


def _boxes(stream: BinaryIO, start: int, end: int) -> Iterator[Box]:
    """The boxes between two places (4.2)."""
    at = start
    for _ in range(MOST_BOXES):
        if at + 8 > end:
            return
        stream.seek(at)
        size, kind = struct.unpack(">I4s", stream.read(8))
        head = 8
        if size == 1:
            (size,) = struct.unpack(">Q", stream.read(8))
            head = 16
        if size == 0:
            size = end - at
        if size < head:
            return
        yield kind, at + head, min(at + size, end)
        at += size


def _read(stream: BinaryIO, content: tuple[int, int]) -> bytes:
    if content[1] - content[0] > MOST_TABLE:
        raise ValueError
    stream.seek(content[0])
    return stream.read(content[1] - content[0])


def _rate_hz(header: bytes) -> float:
    """The time units in a second, of a movie's header (8.2.2) or a track's (8.4.2); 0 where it has none."""
    (units,) = struct.unpack_from(">I", header, 20 if header[0] else 12)
    return float(units)


def _numbers(table: bytes, width: int) -> NDArray[np.int64]:
    """A table of counted numbers, after version and flags."""
    (count,) = struct.unpack_from(">I", table, 4)
    return np.frombuffer(table, f">u{width}", count, 8).astype(np.int64)


def _times(table: bytes, units_hz: float) -> NDArray[np.float64]:
    """Samples' times (8.6.1.2), s."""
    (count,) = struct.unpack_from(">I", table, 4)
    pairs = np.frombuffer(table, ">u4", 2 * count, 8).astype(np.int64).reshape(-1, 2)
    if int(pairs[:, 0].sum()) > MOST_SAMPLES:
        raise ValueError
    apart = np.repeat(pairs[:, 1], pairs[:, 0])
    return np.concatenate([[0], np.cumsum(apart)[:-1]]) / units_hz if len(apart) else np.zeros(0)


def _compositions_s(table: bytes, count: int, units_hz: float) -> NDArray[np.float64]:
    """By how much samples (N,) are shown after they are decoded (8.6.1.3), s; negative ones of version 1 too."""
    (runs,) = struct.unpack_from(">I", table, 4)
    pairs = np.frombuffer(table, ">i4", 2 * runs, 8).astype(np.int64).reshape(-1, 2)
    if int(pairs[:, 0].sum()) != count or (pairs[:, 0] < 0).any():
        raise ValueError
    return np.repeat(pairs[:, 1], pairs[:, 0]) / units_hz


def _sizes(table: bytes) -> NDArray[np.int64]:
    """Samples' sizes (8.7.3.2), bytes."""
    size, count = struct.unpack_from(">II", table, 4)
    if count > MOST_SAMPLES:
        raise ValueError
    return np.full(count, size, np.int64) if size else np.frombuffer(table, ">u4", count, 12).astype(np.int64)


def _places(sizes: NDArray[np.int64], chunks: NDArray[np.int64], table: bytes) -> NDArray[np.int64]:
    """The place of each sample (8.7.4): runs of chunks that have as many samples, one after the other in each."""
    (count,) = struct.unpack_from(">I", table, 4)
    runs = np.frombuffer(table, ">u4", 3 * count, 8).astype(np.int64).reshape(-1, 3)
    apart = np.diff(np.append(runs[:, 0], len(chunks) + 1))
    if (apart < 0).any():
        raise ValueError
    in_chunk = np.repeat(runs[:, 1], apart)
    if len(in_chunk) != len(chunks) or int(in_chunk.sum()) != len(sizes):
        raise ValueError
    before = np.cumsum(sizes) - sizes
    first = np.cumsum(in_chunk) - in_chunk
    whole = in_chunk > 0
    out: NDArray[np.int64] = np.repeat(chunks[whole] - before[first[whole]], in_chunk[whole]) + before
    return out


def _text(four: bytes) -> str:
    return four.decode("latin-1")
