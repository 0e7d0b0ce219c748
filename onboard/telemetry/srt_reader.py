"""Subtitles (DJI's .SRT, Autel's .ass), written together with a video -> events. Several dialects:

    [latitude: 47.1] [longitude: 8.2] [rel_alt: 30.1 abs_alt: 501.3] [gb_yaw: 12.0 gb_pitch: -90.0 gb_roll: 0.0]
    [latitude : 47.1] [longtitude : 8.2] [altitude: 501.3]                 (the letter too many is DJI's)
    [Drone: Yaw:1.9, Pitch:-3.1, Roll:1.5] [Gimbal: Yaw:10.0, Pitch:-45.0, Roll:0.0]
    GPS(8.2,47.1,14) BAROMETER:30.1                                        (longitude first; 14 satellites)
    GPS(47.1,8.2,0.0M) BAROMETER:30.1M                                     (latitude first: `srt_axis_order`)
    GPS(E: 8.2, N: 47.1, 501.3m)                                           (Autel)
    GPS(E: 8.2, N: 47.1, 14) ReH:30.1                                      (Autel's .ass; 14 is not a height)
    GPS (8.2, 47.1, 14), D 24.1m, H 30.1m, H.S 3.0m/s, F.PRY (-4.0°, 0.3°, 12.1°), G.PRY (-90.0°, 0.0°, 12.3°)
    stream->FrameCnt:1 latitude:N47°6′0.1″, longitude:E8°12′0.0″, rel_alt:501.3, abs_alt:501.3, gb_yaw:-12.0, ...
                                             (SIYI; its rel_alt is abs_alt again, and its gb_yaw counts from the nose)

A subtitle's own time is the video's, so pictures of the same video need no other clock. Dates are the camera's local
time; they are taken as UTC, as the names of files are.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TypeGuard

from contract.errors import InputError
from onboard.events.types import GpsQuality, NavEvent, PositionFix
from onboard.telemetry.contradictions import agreeing, beginning
from onboard.telemetry.own_video import extent_s
from onboard.telemetry.row_events import SIGMA_PRESSURE_HEIGHT_M, SIGMA_UNSPECIFIED_M
from onboard.telemetry.srt_axis_order import (
    MAX_SATELLITES,
    METRES_A_DEGREE,
    WORDS,
    Order,
    UnlabelledPlace,
    axis_order,
)
from onboard.telemetry.telemetry_log import (
    EMPTY_EPOCH_NS,
    NS_PER_S,
    TelemetryLog,
    attitudes,
    gimbal_attitudes,
    vouched,
    with_news,
)

_NUMBER = r"([+-]?\d{1,9}(?!\d)(?:\.\d+)?)"
_INTERVAL = re.compile(r"(?<!\d)(\d+):(\d\d):(\d\d)[,.](\d{1,3})\s*-->\s*\d+:\d\d:\d\d[,.]\d{1,3}")
_DATE = re.compile(
    r"(?<!\d)(\d{4})[-./](\d{1,2})[-./](\d{1,2})[ T_]+(\d{1,2})[:-](\d{2})[:-](\d{2})(?:[.,](\d{3})(?:[.,](\d{3}))?)?"
)
_NAMED = re.compile(rf"([A-Za-z_]+)\s*:\s*{_NUMBER}")
_TRIPLE = r"\s*\(\s*{n}\s*,\s*{n}\s*(?:,\s*({n}\s*M?)\s*)?\)".replace("{n}", _NUMBER)
_GPS, _HOME = (re.compile(rf"(?<![A-Z.])(?:{name}){_TRIPLE}", re.IGNORECASE) for name in ("GPS|RTK", "HOME"))
_LETTERED = re.compile(
    rf"(?<![A-Z.])GPS\s*\(\s*([EWNS]):\s*{_NUMBER}\s*,\s*([EWNS]):\s*{_NUMBER}\s*(?:,\s*{_NUMBER}m)?", re.I
)
_MINUTES = re.compile(r"\b(?:latitude|longitude)\s*:\s*([NSEW])(\d{1,3})°(\d{1,2})[′'](\d{1,2}(?:\.\d+)?)[″\"]")
_FROM_HOME = re.compile(rf"(?<![\w.])D\s*[= ]\s*{_NUMBER}\s*m\b")
_SPEED = re.compile(rf"(?<![\w.])(?:H\.S\s+|Hs:\s*){_NUMBER}")
_DZOOM, _EIS = re.compile(rf"\bDZOOM\s+{_NUMBER}"), re.compile(r"\beis\s*:\s*(\w+)")
_ABOVE_HOME = re.compile(rf"(?:\bHb?[\s:]\s*|\bReH\s*:\s*|BAROMETER\s*[:(]\s*){_NUMBER}")
_ANGLES = re.compile(rf"\b([FG])\.PRY\s*\(\s*{_NUMBER}\D*?,\s*{_NUMBER}\D*?,\s*{_NUMBER}\D*?\)")
_TURNED = re.compile(rf"\b(Drone|Gimbal)\s*:\s*Yaw\s*:\s*{_NUMBER},?\s*Pitch\s*:\s*{_NUMBER},?\s*Roll\s*:\s*{_NUMBER}")
_TAG = re.compile(r"<[^>]*>|\{[^}]*\}|\\[Nnh]")
_DIALOGUE = re.compile(
    r"^Dialogue:[^,\n]*,\s*(\d+):(\d\d):(\d\d)\.(\d{1,3}),(?:[^,\n]*,){7}(.*)$", re.MULTILINE
)  # ten fields, the last of which is the text
EIS_OFF = {"close", "closed", "off", "none", "0"}
MAX_HEIGHT_M = 1e5
SIYI = "stream->FrameCnt"
MINUTES_DECIMALS = 4.56  # of degrees: a tenth of a second of arc
HOURS_DIGITS = 2  # of a video's own time: what has more is damaged
DZOOM_SCALE, MAX_DZOOM = 10_000.0, 100.0  # older models write 10000 for 1.0
MIN_FOCAL_MM, MAX_FOCAL_MM = 10.0, 500.0


@dataclass(frozen=True)
class _Subtitle:
    """The content of one subtitle; `at_ns` on the video's own time."""

    at_ns: int
    taken_ns: int | None
    lat_deg: float | None = None
    lon_deg: float | None = None
    decimals: float = 6
    height_amsl_m: float | None = None
    altitude_m: float | None = None  # above the sea, or above the take-off
    above_home_m: float | None = None
    unlabelled: UnlabelledPlace | None = None
    satellites: int | None = None
    dzoom: float | None = None  # by how much the picture was enlarged digitally
    focal_mm: float | None = None  # equivalent to 35 mm film
    eis: str = ""
    gimbal_deg: tuple[float, float, float] | None = None  # roll, pitch, yaw against north-east-down
    body_deg: tuple[float, float, float] | None = None
    is_from_nose: bool = False  # the gimbal's yaw


def looks_like_subtitles(head: bytes) -> bool:
    return _INTERVAL.search(head.decode("utf-8", "replace")) is not None


def begins_ass(head: bytes) -> bool:
    return b"[Script Info]" in head or b"\nDialogue:" in head


def read_srt(path: Path | str, home_amsl_m: float | None = None, gps_order: Order | None = None) -> TelemetryLog:
    """Read a file of subtitles. `home_amsl_m`: the take-off's height above sea level, for dialects that only state how
    high above it the aircraft was; `gps_order` what `GPS(a, b)` means, for those that do not specify it.

    Raises InputError, without the file's name, for one without positions or heights, or whose order is not known.
    """
    try:
        text = Path(path).read_bytes().decode("utf-8-sig", "replace")
    except OSError as error:
        raise InputError(f"{error.strerror}") from error
    return log_of_subtitles(_parts(text), home_amsl_m, gps_order)


def log_of_subtitles(
    parts: list[tuple[int, str]], home_amsl_m: float | None = None, gps_order: Order | None = None
) -> TelemetryLog:
    """Return the log of subtitles, each its time on the video's own (ns) and its text; otherwise as `read_srt`."""
    found = [_subtitle(at_ns, _TAG.sub(" ", text)) for at_ns, text in parts if "\0" not in text]
    subtitles, notes = _ordered(sorted(found, key=lambda subtitle: subtitle.at_ns), gps_order)
    placed = [s for s in subtitles if s.lat_deg is not None]
    if not placed:
        raise InputError(f"no position in its {len(subtitles)} subtitles: none was written, or there was no fix")
    has_amsl = any(s.height_amsl_m is not None or s.altitude_m is not None for s in placed)
    if not has_amsl and all(s.above_home_m is None for s in placed):
        raise InputError("positions without any height in its subtitles; give another log")
    if home_amsl_m is None and not has_amsl:
        raise InputError("heights above the take-off only; state its height above sea level: --home-amsl-m M")
    epoch_ns, dates = _epoch_ns(subtitles)
    positions, claims = _positions(placed, epoch_ns, home_amsl_m)
    if not positions:
        raise InputError("no height above the take-off in its subtitles; leave --home-amsl-m out")
    agree, contradictions = agreeing(positions)
    positions, claims = [positions[at] for at in agree], [claims[at] for at in agree]
    events = vouched(positions, claims) + _attitudes(subtitles, epoch_ns)
    video_s = extent_s([s.at_ns / NS_PER_S for s in subtitles])
    return replace(
        TelemetryLog.by_stamp(events),
        video_epoch_ns=epoch_ns,
        video_s=video_s,
        # A text does not state which moment of its own time it is of: of one a second, 0.29 s. (32.6)
        position_sigma_s=0.0 if video_s is None else video_s[1] / 12.0**0.5,
        utc_sigma_s=None,
        notes=(*notes, *dates, *contradictions, *_stabilisation_note(subtitles), *_height_note(claims)),
        digital_zoom=_steps((epoch_ns + s.at_ns, s.dzoom) for s in subtitles),
        focal_mm=_steps((epoch_ns + s.at_ns, s.focal_mm) for s in subtitles),
    )


def _parts(text: str) -> list[tuple[int, str]]:
    """The subtitles of a file, each its time (ns) and its text."""
    parts = [(match.groups()[:4], match[5]) for match in _DIALOGUE.finditer(text)]
    found = [] if parts else list(_INTERVAL.finditer(text))
    if found:
        ends = [match.start() for match in found[1:]] + [len(text)]
        parts = [(match.groups(), text[match.end() : end]) for match, end in zip(found, ends, strict=True)]
    if len(parts) > 1 and not text.endswith("\n"):
        del parts[-1]  # it may be cut within a number
    out = []
    for (hours, minutes, seconds, fraction), content in parts:
        if len(hours) <= HOURS_DIGITS:
            whole = (int(hours) * 60 + int(minutes)) * 60 + int(seconds)
            out.append((whole * 1_000_000_000 + int(fraction.ljust(3, "0")) * 1_000_000, content))
    return out


def _subtitle(at_ns: int, text: str) -> _Subtitle:
    named = {name.lower(): value for name, value in _NAMED.findall(text)}
    number = {name: float(value) for name, value in named.items()}
    latitude, longitude = named.get("latitude"), named.get("longitude", named.get("longtitude"))
    altitude = number.get("altitude")
    if latitude is None and (letters := _LETTERED.search(text)) is not None:
        latitude, longitude = _by_letters(letters)
        altitude = None if letters[5] is None else float(letters[5])
    decimals: float = _decimals(latitude, longitude)
    is_siyi = SIYI in text
    if latitude is None and is_siyi:
        (latitude, longitude), decimals = _in_minutes(text), MINUTES_DECIMALS
    unlabelled = _unlabelled(at_ns, text) if latitude is None else None
    above = None if is_siyi else number.get("rel_alt")
    if above is None and (height := _ABOVE_HOME.search(text)) is not None:
        above = float(height[1])
    place = _place(latitude, longitude)
    # A plain search for a word first: a long file has each dialect's patterns looked for 72,000 times.
    angles: dict[str, tuple[float, float, float]] = {}
    if ".PRY" in text:
        angles = {kind: (float(r), float(p), float(y)) for kind, p, r, y in _ANGLES.findall(text)}
    if "Yaw" in text:
        angles |= {kind[0]: (float(r), float(p), float(y)) for kind, y, p, r in _TURNED.findall(text)}
    eis = _EIS.search(text) if "eis" in text else None
    return _Subtitle(
        at_ns,
        _date_ns(text),
        lat_deg=None if place is None else place[0],
        lon_deg=None if place is None else place[1],
        decimals=decimals if unlabelled is None else unlabelled.decimals,
        height_amsl_m=number.get("abs_alt"),
        altitude_m=altitude,
        above_home_m=above,
        unlabelled=unlabelled,
        satellites=None if unlabelled is None else _satellites(unlabelled.third),
        dzoom=_dzoom(number.get("mix_ratio" if is_siyi else "dzoom_ratio"), text),
        focal_mm=_focal_mm(named.get("focal_len")),
        eis="" if eis is None else eis[1].lower(),
        gimbal_deg=_named_angles(number, "gb") or angles.get("G"),
        body_deg=_named_angles(number, "drone") or angles.get("F") or angles.get("D"),
        is_from_nose=is_siyi,
    )


def _by_letters(letters: re.Match[str]) -> tuple[str | None, str | None]:
    """Latitude and longitude of `GPS(E: 8.2, N: 47.1)`."""
    signed = {
        "lat" if letter.upper() in "NS" else "lon": ("-" if letter.upper() in "SW" else "") + number.lstrip("+")
        for letter, number in (letters.group(1, 2), letters.group(3, 4))
        if not (letter.upper() in "SW" and number.startswith("-"))  # is south of south north?
    }
    return signed.get("lat"), signed.get("lon")


def _in_minutes(text: str) -> tuple[str | None, str | None]:
    """Latitude and longitude of `latitude:N47°6′0.1″`, in degrees."""
    signed = {
        "lat" if letter in "NS" else "lon": ("-" if letter in "SW" else "")
        + f"{int(degrees) + int(minutes) / 60.0 + float(seconds) / 3600.0:.7f}"
        for letter, degrees, minutes, seconds in _MINUTES.findall(text)
        if int(minutes) < 60 and float(seconds) < 60.0
    }
    return signed.get("lat"), signed.get("lon")


def _unlabelled(at_ns: int, text: str) -> UnlabelledPlace | None:
    gps = _GPS.search(text)
    if gps is None:
        return None
    home, from_home, speed = _HOME.search(text), _FROM_HOME.search(text), _SPEED.search(text)
    return UnlabelledPlace(
        at_ns,
        float(gps[1]),
        float(gps[2]),
        _decimals(gps[1], gps[2]),
        (gps[3] or "").strip(),
        "BAROMETER(" in text,
        None if home is None else (float(home[1]), float(home[2])),
        None if from_home is None else float(from_home[1]),
        None if speed is None else float(speed[1]),
    )


def _decimals(*numbers: str | None) -> int:
    return min(len((number or "").partition(".")[2]) for number in numbers)


def _satellites(third: str) -> int | None:
    return int(third) if third.isdecimal() and int(third) <= MAX_SATELLITES else None


def _dzoom(ratio: float | None, text: str) -> float | None:
    if ratio is None:
        bare = _DZOOM.search(text) if "DZOOM" in text else None
        ratio = None if bare is None else float(bare[1])
    if ratio is not None and ratio >= 0.1 * DZOOM_SCALE:
        ratio /= DZOOM_SCALE
    return ratio if ratio is not None and 1.0 <= ratio <= MAX_DZOOM else None


def _focal_mm(text: str | None) -> float | None:
    """A focal length, which older models write in tenths of a millimetre."""
    if text is None:
        return None
    focal_mm = float(text) / (1.0 if float(text) < 100.0 or "." in text else 10.0)
    return focal_mm if MIN_FOCAL_MM <= focal_mm <= MAX_FOCAL_MM else None


def _ordered(subtitles: list[_Subtitle], stated: Order | None) -> tuple[list[_Subtitle], list[str]]:
    """Return the subtitles with the places of `GPS(a, b)` in their order, and how that was found."""
    unlabelled = [s.unlabelled for s in subtitles if s.unlabelled is not None]
    unlabelled = [place for place in unlabelled if (place.first, place.second) != (0.0, 0.0)]
    if not unlabelled:
        return subtitles, []
    order, why = axis_order(unlabelled, stated)
    out = []
    for s in subtitles:
        if s.unlabelled is not None:
            pair = str(s.unlabelled.first), str(s.unlabelled.second)
            place = _place(*(pair if order == "lat-lon" else pair[::-1]))
            s = s if place is None else replace(s, lat_deg=place[0], lon_deg=place[1])  # noqa: PLW2901
        out.append(s)
    return out, [f"GPS(a, b) of the subtitles is read as {WORDS[order]}: {why}"]


def _stabilisation_note(subtitles: list[_Subtitle]) -> list[str]:
    on = {s.eis for s in subtitles} - EIS_OFF - {""}
    if not on:
        return []
    return [
        f"electronic stabilisation was on (eis: {', '.join(sorted(on))}): it shifts pictures by what it hides of the "
        "camera's motion, and those are refused as stabilised; switch it off before the next flight"
    ]


def _height_note(claims: list[GpsQuality]) -> list[str]:
    datum_m = max((claim.sigma_datum_m or 0.0 for claim in claims), default=0.0)
    if not datum_m:
        return []
    return [
        f"heights above sea level are +-{datum_m:.0f} m as a whole (barometer); state how high the take-off was: "
        "--home-amsl-m M"
    ]


def _steps(values: Iterable[tuple[int, float | None]]) -> tuple[tuple[int, float], ...]:
    """Return each change of a value: its Unix time, ns, and the new value."""
    out: list[tuple[int, float]] = []
    for stamp_ns, value in values:
        if value is not None and (not out or out[-1][1] != value):
            out.append((stamp_ns, value))
    return tuple(out)


def _place(latitude: str | None, longitude: str | None) -> tuple[float, float] | None:
    """Degrees; None without a fix, which is written as 0, 0."""
    if latitude is None or longitude is None:
        return None
    lat, lon = float(latitude), float(longitude)
    return (lat, lon) if (lat, lon) != (0.0, 0.0) and abs(lat) <= 90.0 and abs(lon) <= 180.0 else None


def _named_angles(number: dict[str, float], who: str) -> tuple[float, float, float] | None:
    values = [number.get(f"{who}_{angle}") for angle in ("roll", "pitch", "yaw")]
    roll, pitch, yaw = values
    return None if roll is None or pitch is None or yaw is None else (roll, pitch, yaw)


def _date_ns(text: str) -> int | None:
    found = _DATE.search(text)
    if found is None:
        return None
    parts = [int(part) for part in found.groups()[:6]]
    try:
        moment = datetime(*parts, tzinfo=UTC)  # type: ignore[misc,arg-type]
    except ValueError:
        return None
    return round(moment.timestamp()) * 1_000_000_000 + int(found[7] or 0) * 1_000_000 + int(found[8] or 0) * 1000


def _epoch_ns(subtitles: list[_Subtitle]) -> tuple[int, list[str]]:
    """Return when the video began, by the dates less the video's time, and a note of dates that contradict it."""
    began_ns = [s.taken_ns - s.at_ns for s in subtitles if s.taken_ns is not None]
    return beginning(began_ns, "the video") if began_ns else (EMPTY_EPOCH_NS, [])


def _positions(
    placed: list[_Subtitle], epoch_ns: int, home_amsl_m: float | None
) -> tuple[list[PositionFix], list[GpsQuality]]:
    positions: list[PositionFix] = []
    claims: list[GpsQuality] = []
    for subtitle in placed:
        stamp_ns = epoch_ns + subtitle.at_ns
        amsl_m, above_m, datum_m = _height(subtitle, home_amsl_m)
        if amsl_m is None or abs(amsl_m) > MAX_HEIGHT_M or subtitle.lat_deg is None or subtitle.lon_deg is None:
            continue
        positions.append(PositionFix(stamp_ns, subtitle.lat_deg, subtitle.lon_deg, amsl_m, None, above_m))
        step_m = METRES_A_DEGREE * 10.0**-subtitle.decimals
        claims.append(GpsQuality(stamp_ns, 3, subtitle.satellites, step_m / 12.0**0.5, sigma_datum_m=datum_m))
    new = with_news(positions)
    return [positions[at] for at in new], [claims[at] for at in new]


def _height(subtitle: _Subtitle, home_amsl_m: float | None) -> tuple[float | None, float | None, float | None]:
    """Above sea level, above the take-off, and one sigma of where the former counts from, if that is not known."""
    above_m = subtitle.above_home_m
    if home_amsl_m is not None:
        above_m = subtitle.altitude_m if above_m is None else above_m
        return (None, None, None) if above_m is None else (home_amsl_m + above_m, above_m, None)
    if subtitle.height_amsl_m is not None:
        # `abs_alt` is a height in the standard atmosphere on many models.
        return subtitle.height_amsl_m, above_m, SIGMA_PRESSURE_HEIGHT_M
    return subtitle.altitude_m, above_m, SIGMA_UNSPECIFIED_M  # from the sea on some models, the take-off on others


def _is_an_attitude(angles_deg: tuple[float, float, float] | None) -> TypeGuard[tuple[float, float, float]]:
    return angles_deg is not None and max(map(abs, angles_deg)) <= 360.0


def _attitudes(subtitles: list[_Subtitle], epoch_ns: int) -> list[NavEvent]:
    of_body = [(epoch_ns + s.at_ns, s.body_deg) for s in subtitles if _is_an_attitude(s.body_deg)]
    by_north = [s for s in subtitles if not s.is_from_nose]
    by_nose = [s for s in subtitles if s.is_from_nose]
    return [
        *attitudes(of_body),
        *gimbal_attitudes(_gimbal_angles(by_north, epoch_ns)),
        *gimbal_attitudes(_gimbal_angles(by_nose, epoch_ns), "vehicle"),
    ]


def _gimbal_angles(subtitles: list[_Subtitle], epoch_ns: int) -> list[tuple[int, tuple[float, float, float]]]:
    return [(epoch_ns + s.at_ns, s.gimbal_deg) for s in subtitles if _is_an_attitude(s.gimbal_deg)]
