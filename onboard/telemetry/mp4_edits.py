"""Edit lists of MP4 and QuickTime (ISO 14496-12, 8.6.6): which parts of a track are shown, and when.

Programs that cut a video without touching its pictures write one: what is cut off stays in the file, and times in it
count from the old beginning.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

EMPTY = -1  # of where an edit begins in the track: nothing is shown
MOST_EDITS = 1000
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Edit:
    """A part that is shown for `lasts_s` (0: to the track's end), from `media_s` of the track on; None: nothing is."""

    lasts_s: float
    media_s: float | None


def edits_of(table: bytes, movie_hz: float, media_hz: float) -> list[Edit]:
    """Return the edits of a table `elst`, by the time units in a second of the movie and of the track. Raises
    ValueError or struct.error for a damaged one.
    """
    (version, count) = struct.unpack_from(">B3xI", table)
    one = struct.Struct(">Qq4x" if version else ">Ii4x")
    if count > MOST_EDITS or movie_hz <= 0.0:
        raise ValueError
    found = [one.unpack_from(table, 8 + k * one.size) for k in range(count)]
    return [Edit(lasts / movie_hz, None if media == EMPTY else media / media_hz) for lasts, media in found]


def late_s(edits: list[Edit]) -> float:
    """Return after how much time the first of a track is shown, s."""
    out = 0.0
    for edit in edits:
        if edit.media_s is not None:
            break
        out += edit.lasts_s
    return out


def shown_s(times_s: Array, edits: list[Edit]) -> Array:
    """Return when the samples of a track (N,), s on its own time, are shown; nan for those that are not."""
    if not edits:
        return times_s
    out, begin_s = np.full(len(times_s), np.nan), 0.0
    for edit in edits:
        if edit.media_s is not None:
            into_s = times_s - edit.media_s
            is_in = (into_s >= 0.0) & ((into_s < edit.lasts_s) | (edit.lasts_s == 0.0)) & np.isnan(out)
            out[is_in] = begin_s + into_s[is_in]
        begin_s += edit.lasts_s
    return out
