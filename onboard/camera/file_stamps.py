"""The times of pictures: from a CSV of stamps, EXIF, or a UTC time in the file name. All become Unix nanoseconds."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from decimal import Decimal, InvalidOperation
from pathlib import Path

from PIL import ExifTags, Image

from contract.errors import InputError

# Between 2000 and 2100: outside of it a number in a file name is a counter, and a stamp in a CSV a wrong unit.
MIN_UNIX_S, MAX_UNIX_S = 946_684_800, 4_102_444_800
MOST_DIGITS = 9  # of the index of a frame

# 20180805_010052_380 may end in milliseconds or microseconds; a shorter tail after '_' or '-' is a burst counter.
_TAIL = r"(?:[.,](?P<point>\d{1,9})|[-_](?P<tail>\d{3}|\d{6}|\d{9})(?!\d))?"
_COMPACT = re.compile(
    r"(?<!\d)(?P<date>\d{8})[T_ -]?(?P<time>\d{6})(?:(?P<digits>\d{1,9})(?!\d)|(?!\d)" + _TAIL + r")Z?(?!\d)"
)
_DASHED = re.compile(
    r"(?<!\d)(?P<date>\d{4}[-_.]\d{2}[-_.]\d{2})[T_ -](?P<time>\d{2}[-_:.h]\d{2}[-_:.m]\d{2})(?!\d)" + _TAIL
)
_UNIX = re.compile(r"(?<![\d.])(?P<seconds>\d{9,10}(?:[._]\d{1,9})?)(?!\d)")


def _to_ns(moment: datetime, fraction: str) -> int:
    """A whole-second UTC moment and decimal digits of a second -> Unix ns."""
    since = moment - datetime(1970, 1, 1, tzinfo=UTC)
    return (since.days * 86400 + since.seconds) * 1_000_000_000 + int(fraction[:9].ljust(9, "0"))


def stamp_from_name(name: str) -> int | None:
    """A UTC time in a file's name -> Unix ns, or None.

    Known are YYYYMMDDhhmmss and YYYYMMDDThhmmss with any decimals behind, directly or after a point (2018080501005238Z
    is 52.38 s), YYYY-MM-DD_hh-mm-ss-mmm and its like, and Unix seconds with or without decimals.
    """
    stem = Path(name).stem
    for pattern in (_COMPACT, _DASHED):
        for match in pattern.finditer(stem):
            digits = re.sub(r"\D", "", match["date"] + match["time"])
            try:
                moment = datetime.strptime(digits, "%Y%m%d%H%M%S").replace(tzinfo=UTC)
            except ValueError:
                continue
            parts = match.groupdict()
            return _to_ns(moment, parts.get("digits") or parts["point"] or parts["tail"] or "0")
    for match in _UNIX.finditer(stem):
        seconds = Decimal(match["seconds"].replace("_", "."))
        if MIN_UNIX_S <= seconds <= MAX_UNIX_S:
            return int(seconds * 1_000_000_000)
    return None


def stamp_from_exif(image: Image.Image, whole_seconds: bool = False) -> int | None:
    """DateTimeOriginal with SubSecTimeOriginal -> Unix ns, or None.

    OffsetTimeOriginal is used; without it the time is taken as UTC. Whole seconds alone are no capture time unless
    `whole_seconds` specifies that they may be: at 20 m/s they are up to 20 m wrong.
    """
    stamp_ns, is_whole = exif_moment(dict(image.getexif().get_ifd(ExifTags.IFD.Exif)))
    return None if is_whole and not whole_seconds else stamp_ns


def exif_moment(details: Mapping[int, object]) -> tuple[int | None, bool]:
    """The Exif directory's capture time (Unix ns) and whether it is cut to the second."""
    text, fraction, offset = (
        str(details.get(tag, "")).strip(" \0")
        for tag in (
            ExifTags.Base.DateTimeOriginal,
            ExifTags.Base.SubsecTimeOriginal,
            ExifTags.Base.OffsetTimeOriginal,
        )
    )
    try:
        moment = datetime.strptime(text, "%Y:%m:%d %H:%M:%S").replace(tzinfo=UTC)
    except ValueError:
        return None, False
    if zone := re.fullmatch(r"([+-])(\d{2}):?(\d{2})", offset):
        ahead = timedelta(hours=int(zone[2]), minutes=int(zone[3]))
        moment += -ahead if zone[1] == "+" else ahead
    is_whole = re.fullmatch(r"\d{1,9}", fraction) is None
    return _to_ns(moment, "0" if is_whole else fraction), is_whole


def spread_within_seconds(stamps_ns: list[int]) -> list[int]:
    """Times cut to the second, in order of capture -> times that differ: pictures of one second evenly within it."""
    out, start = [], 0
    while start < len(stamps_ns):
        end = start
        while end < len(stamps_ns) and stamps_ns[end] == stamps_ns[start]:
            end += 1
        out += [stamps_ns[start] + i * 1_000_000_000 // (end - start) for i in range(end - start)]
        start = end
    return out


def read_stamps(path: Path | str, key: str) -> dict[str, int]:
    """A CSV with the columns `key` ("file" or "index") and unix_time_s -> Unix ns by key, in the file's order.

    Raises InputError, one line with its line number, for a missing column, a bad or doubled entry.
    """
    try:
        text = Path(path).read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise InputError(f"stamps {path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"stamps {path}: not UTF-8 text (byte {error.start})") from error
    rows = csv.DictReader(io.StringIO(text), skipinitialspace=True)
    header = [name.strip() for name in rows.fieldnames or []]
    rows.fieldnames = header
    if key not in header or "unix_time_s" not in header:
        raise InputError(f"stamps {path}: line 1 must be the header '{key},unix_time_s', not '{','.join(header)}'")
    stamps: dict[str, int] = {}
    try:
        for row in rows:
            name, number = (row[key] or "").strip(), (row["unix_time_s"] or "").strip()
            where = f"stamps {path}, line {rows.line_num}"
            try:
                seconds = Decimal(number)
                usable = MIN_UNIX_S <= seconds <= MAX_UNIX_S
            except InvalidOperation:
                usable = False
            if not usable:
                raise InputError(f"{where}: '{number}' is not a Unix time in seconds between 2000 and 2100")
            if not name or name in stamps:
                raise InputError(f"{where}: " + (f"'{name}' has a stamp already" if name else f"no {key}"))
            stamps[name] = int(seconds * 1_000_000_000)
    except csv.Error as error:
        raise InputError(f"stamps {path}, line {rows.line_num}: {error}") from error
    if not stamps:
        raise InputError(f"stamps {path}: no stamp below the header")
    return stamps


def stamps_of_frames(path: Path | str, count: int, video: str) -> list[int]:
    """Return the time (Unix ns) of each of a video's `count` frames, by a CSV with the columns index and unix_time_s.

    Raises InputError, one line, as `read_stamps` does, and where a frame has none, or there is no such frame.
    """
    found: list[int | None] = [None] * count
    for key, stamp in read_stamps(path, "index").items():
        if not key.isdecimal() or len(key) > MOST_DIGITS or int(key) >= count:
            raise InputError(f"stamps {path}: index '{key}' is not 0 to {count - 1}, the frames of {video}")
        found[int(key)] = stamp
    if None in found:
        raise InputError(f"stamps {path}: no stamp for index {found.index(None)} of {count} frames")
    return [stamp for stamp in found if stamp is not None]
