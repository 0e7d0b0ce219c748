"""GoPro's GPMF, a track of a video -> positions. Keys, lengths and values as GoPro's gpmf-parser documents them.

Every sample of the track holds about a second. GPS9 (Hero 11, 13) has a time with each position; before it there are
five numbers (GPS5), evenly within the sample, and one time (GPSU), fix and dilution for all of them. Single times are
up to two seconds stale, so that of GPS5 the video's own times count, from where most of its times have it begin.
"""

from __future__ import annotations

import itertools
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime

from onboard.telemetry.mp4_container import Track
from onboard.telemetry.nmea_source import dilution_sigmas_m
from onboard.telemetry.row_events import ABOVE_ELLIPSOID, LIMITS, NO_FIX, SIGMAS, Row, Rows
from onboard.telemetry.telemetry_log import NS_PER_S

KIND = "gpmd"
DEEPEST = 4
EPOCH_2000_S = 946_684_800
MOST_STALE_NS = 10 * NS_PER_S  # of a receiver's time against the sample's own; another is damaged
GPS5, GPS9 = struct.Struct(">5i"), struct.Struct(">7i2H")
SCALES = {"l": "i", "L": "I", "s": "h", "S": "H"}


@dataclass
class _Stream:
    """The content of a stream of positions in one sample of the track."""

    scales: list[float] = field(default_factory=list)
    five: list[tuple[float, ...]] = field(default_factory=list)
    nine: list[tuple[float, ...]] = field(default_factory=list)
    utc_ns: int | None = None
    fix: int | None = None
    dilution: float | None = None
    height: str = ABOVE_ELLIPSOID  # or above the sea, where it states so

    def first_ns(self) -> int | None:
        """Return the time that it states first, Unix ns; None without a fix."""
        if self.nine:
            return next((stamp_ns for stamp_ns, _ in _nine(self)), None)
        return self.utc_ns if (self.fix or 0) >= 3 else None


def positions_of(track: Track) -> tuple[Rows, int | None, int]:
    """Return positions at UTC, when the video began by the receiver (Unix ns, None without a time), and how many
    positions there are.
    """
    ends_s = [*track.times_s[1:], track.times_s[-1] + _usual_s(track.times_s)] if track.times_s else []
    spans = zip(track.samples, track.times_s, ends_s, strict=True)
    found = [(start_s, end_s, stream) for sample, start_s, end_s in spans for stream in _streams(sample)]
    began = sorted(
        moment_ns - round(start_s * NS_PER_S)
        for start_s, _, stream in found
        if (moment_ns := stream.first_ns()) is not None
    )
    written = sum(len(stream.nine or stream.five) for _, _, stream in found)
    if not began:
        return [], None, written
    began_ns = began[len(began) // 2]
    rows: Rows = []
    for start_s, end_s, stream in found:
        start_ns, lasts_ns = began_ns + round(start_s * NS_PER_S), round((end_s - start_s) * NS_PER_S)
        if stream.nine:
            rows += [(t, row) for t, row in _nine(stream) if abs(t - start_ns) < MOST_STALE_NS]
        else:
            rows += _five(stream, start_ns, lasts_ns)
    return rows, began_ns, written


def _usual_s(times_s: Sequence[float]) -> float:
    apart = sorted(b - a for a, b in itertools.pairwise(times_s))
    return apart[len(apart) // 2] if apart else 1.0


def _streams(sample: bytes) -> Iterator[_Stream]:
    """The streams with positions; of a camera that writes both kinds only the one with times."""
    found = [stream for stream in _found(sample, 0, len(sample), 0) if stream.five or stream.nine]
    timed = [stream for stream in found if stream.nine]
    yield from timed or found


def _found(data: bytes, start: int, end: int, depth: int) -> Iterator[_Stream]:
    for key, kind, size, count, at in _entries(data, start, end):
        if kind == "\0" and depth < DEEPEST:
            if key == b"STRM":
                yield _stream(data, at, at + size * count)
            else:
                yield from _found(data, at, at + size * count, depth + 1)


def _entries(data: bytes, start: int, end: int) -> Iterator[tuple[bytes, str, int, int, int]]:
    """Key, type, size of one and number of values, and where they begin; each entry is padded to four bytes."""
    at = start
    while at + 8 <= end:
        key, kind, size, count = struct.unpack_from(">4scBH", data, at)
        if key == b"\0\0\0\0" or at + 8 + size * count > end:
            return
        yield key, kind.decode("latin-1"), size, count, at + 8
        at += 8 + (size * count + 3) // 4 * 4


def _stream(data: bytes, start: int, end: int) -> _Stream:
    out = _Stream()
    for key, kind, size, count, at in _entries(data, start, end):
        value = data[at : at + size * count]
        if key == b"SCAL" and kind in SCALES:
            out.scales = [float(x) for (x,) in struct.iter_unpack(f">{SCALES[kind]}", value)]
        elif key == b"GPSU":
            out.utc_ns = _utc(value)
        elif key == b"GPSF" and len(value) == 4:
            (out.fix,) = struct.unpack(">I", value)
        elif key == b"GPSP" and len(value) == 2:
            out.dilution = struct.unpack(">H", value)[0] / 100.0
        elif key == b"GPSA":
            out.height = "height_amsl_m" if value == b"MSLV" else ABOVE_ELLIPSOID
        elif key == b"GPS5" and size == GPS5.size:
            out.five = [tuple(map(float, one)) for one in GPS5.iter_unpack(value)]
        elif key == b"GPS9" and size == GPS9.size:
            out.nine = [tuple(map(float, one)) for one in GPS9.iter_unpack(value)]
    return out


def _five(stream: _Stream, start_ns: int, lasts_ns: int) -> Rows:
    if (stream.fix or 0) < 3:
        return []
    rows = [_row(values, stream, stream.dilution) for values in stream.five]
    return [(start_ns + k * lasts_ns // len(rows), row) for k, row in enumerate(rows) if row is not None]


def _nine(stream: _Stream) -> Rows:
    if len(stream.scales) != 9 or 0.0 in stream.scales:
        return []
    out: Rows = []
    for values in stream.nine:
        days, seconds, dilution, fix = (v / s for v, s in zip(values[5:], stream.scales[5:], strict=True))
        row = _row(values, stream, dilution)
        if row is not None and fix >= 3.0:
            out.append((round((EPOCH_2000_S + 86_400 * days + seconds) * 1000) * 1_000_000, row))
    return out


def _row(values: Sequence[float], stream: _Stream, dilution: float | None) -> Row | None:
    """Latitude, longitude, height and the dilution's sigmas; None for no position."""
    scales = stream.scales
    if len(scales) < 3 or 0.0 in scales[:3]:
        return None
    lat_deg, lon_deg, height_m = (value / scale for value, scale in zip(values[:3], scales[:3], strict=True))
    row = {"lat_deg": lat_deg, "lon_deg": lon_deg, stream.height: height_m}
    if (lat_deg, lon_deg) == NO_FIX or any(abs(value) > LIMITS[name] for name, value in row.items()):
        return None
    if (sigmas_m := dilution_sigmas_m(dilution)) is not None:
        row |= dict(zip(SIGMAS[:2], sigmas_m, strict=True))
    return row


def _utc(value: bytes) -> int | None:
    """`yymmddhhmmss.sss`."""
    text = value.decode("ascii", "replace").strip("\0 ")
    try:
        moment = datetime.strptime(text[:12], "%y%m%d%H%M%S").replace(tzinfo=UTC)
        return round(moment.timestamp()) * NS_PER_S + round(float("0" + (text[12:] or ".0")) * 1000) * 1_000_000
    except ValueError:
        return None
