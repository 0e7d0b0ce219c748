"""Tracks of the GPS exchange format (.gpx) -> events: positions with times; a waypoint or a route has none.

Read as a stream: of a file that is cut, what stands before the cut is used.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

from contract.errors import InputError
from contract.stated_values import number_or_nan
from onboard.telemetry.civil_time import moment_ns
from onboard.telemetry.flight_tables import NO_ZONE
from onboard.telemetry.nmea_source import dilution_sigmas_m
from onboard.telemetry.read_options import ReadOptions
from onboard.telemetry.row_events import (
    LIMITS,
    NO_FIX,
    SIGMA_GEOID_M,
    SIGMA_UNSPECIFIED_M,
    SIGMAS,
    Row,
    Rows,
    log_of_rows,
    with_heights,
    with_steps,
)
from onboard.telemetry.telemetry_log import TelemetryLog

CHUNK = 65_536
NUMBERS = {"ele": "height_amsl_m", "sat": "satellites", "geoidheight": "undulation_m"}
LEVEL_M = 5.0  # of the lowest height, which may be the sea's or one above the take-off
MAX_TEXT = 200


def begins_gpx(head: bytes) -> bool:
    return b"<gpx" in head


def read_gpx(path: Path, options: ReadOptions) -> TelemetryLog:
    """Read all tracks. Raises InputError, without the file's name, for one without times or heights."""
    track = _Track()
    notes = track.read(path)
    if not track.points:
        raise InputError("no track point (trkpt) in it: waypoints and routes have no times")
    if not track.rows:
        raise InputError("no time or no fix in its track points: a track that was planned, or exported without times")
    if not any("height_amsl_m" in row for _, row in track.rows):
        raise InputError("no height (ele) in its track points")
    if track.are_at_once():
        raise InputError("several of its tracks (trk) are of the same time: leave the aircraft's alone in it")
    if track.points > len(track.rows):
        notes.append(
            f"{track.points - len(track.rows)} of {track.points} track points have no time or no fix and are not used"
        )
    heights_m = [row["height_amsl_m"] for _, row in track.rows if "height_amsl_m" in row]
    lowest_m = min(heights_m[0], *heights_m, key=abs)
    datum_m = SIGMA_UNSPECIFIED_M if abs(lowest_m) < LEVEL_M else SIGMA_GEOID_M
    rows, of_heights = with_heights(with_steps(track.rows, track.decimals), None, options.undulation_m, datum_m)
    if datum_m == SIGMA_UNSPECIFIED_M:
        of_heights = [f"{of_heights[0]}: they reach {lowest_m:.1f} m, which may be the take-off's"]
    zone: tuple[float | None, list[str]] = (0.0, []) if track.has_zone else (None, [NO_ZONE])
    return log_of_rows(rows, [*notes, *of_heights, *zone[1]], zone[0], is_repeated=True)


@dataclass
class _Track:
    """The state of a document being read: its open elements, and the track point under way."""

    rows: Rows = field(default_factory=list)
    points: int = 0
    decimals: int = 0
    has_zone: bool = True
    spans_ns: dict[int, tuple[int, int]] = field(default_factory=dict)  # from when to when each track lasts
    _tracks: int = 0
    _open: list[str] = field(default_factory=list)
    _row: Row = field(default_factory=dict)
    _time: str = ""
    _text: str = ""

    def read(self, path: Path) -> list[str]:
        """Read a file; returns a note where it is cut. Raises InputError for a document type: entities may be in it."""
        parser = expat.ParserCreate()
        parser.StartElementHandler = self._start
        parser.EndElementHandler = self._end
        parser.CharacterDataHandler = self._characters
        parser.StartDoctypeDeclHandler = _refuse
        try:
            with path.open("rb") as stream:
                while data := stream.read(CHUNK):
                    parser.Parse(data, False)
            parser.Parse(b"", True)
        except (expat.ExpatError, ValueError, LookupError) as error:
            if not self.rows:
                raise InputError(f"not XML ({error})") from error
            return [f"it is cut or damaged ({error}): what stands before is read"]
        return []

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        name = tag.rpartition(":")[2]
        self._open.append(name)
        self._text = ""
        self._tracks += name == "trk"
        if name == "trkpt":
            texts = attributes.get("lat", ""), attributes.get("lon", "")
            lat_deg, lon_deg = (number_or_nan(text) for text in texts)
            self._row, self._time = {}, ""
            if abs(lat_deg) <= LIMITS["lat_deg"] and abs(lon_deg) <= LIMITS["lon_deg"]:
                self._row = {"lat_deg": lat_deg, "lon_deg": lon_deg}
                self.decimals = max(self.decimals, *(min(len(text.partition(".")[2]), 9) for text in texts))

    def _characters(self, data: str) -> None:
        if len(self._text) < MAX_TEXT:
            self._text += data

    def _end(self, tag: str) -> None:
        name = self._open.pop()
        if name == "trkpt":
            self._finish()
        elif self._open and self._open[-1] == "trkpt":  # of the point itself, not of an extension in it
            if name == "time":
                self._time = self._text
            elif name in NUMBERS and math.isfinite(value := number_or_nan(self._text)):
                self._row[NUMBERS[name]] = value
            elif name == "hdop" and (sigmas_m := dilution_sigmas_m(number_or_nan(self._text))) is not None:
                self._row |= dict(zip(SIGMAS[:2], sigmas_m, strict=True))
            elif name == "fix" and self._text.strip() in ("none", "2d"):
                self._row.pop("lat_deg", None)  # of two dimensions: its height is none

    def _finish(self) -> None:
        self.points += 1
        moment = moment_ns(self._time)
        is_usable = "lat_deg" in self._row and (self._row["lat_deg"], self._row["lon_deg"]) != NO_FIX
        is_usable &= abs(self._row.get("height_amsl_m", 0.0)) <= LIMITS["height_amsl_m"]
        if moment is not None and is_usable:
            self.has_zone &= moment[1]
            self.rows.append((moment[0], self._row))
            first_ns, last_ns = self.spans_ns.get(self._tracks, (moment[0], moment[0]))
            self.spans_ns[self._tracks] = min(first_ns, moment[0]), max(last_ns, moment[0])

    def are_at_once(self) -> bool:
        """Return whether two tracks overlap in time: of two aircraft, of one and its pilot, or of one twice."""
        spans = sorted(self.spans_ns.values())
        return any(later[0] < earlier[1] for earlier, later in itertools.pairwise(spans))


def _refuse(*_: object) -> None:
    raise InputError("it declares a document type, which a track does not need: it is not read")
