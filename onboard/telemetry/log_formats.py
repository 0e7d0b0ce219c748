"""The table of all formats of logs: choice of reader, refusals, docs/logs.md and the tests of all readers follow it.

A format is recognised by how its file begins, never by its name. The first row that matches counts.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from contract.errors import InputError
from onboard.telemetry import csv_reader, dataflash_reader, flight_tables, srt_reader, ulog_reader
from onboard.telemetry.geo_reader import begins_geo
from onboard.telemetry.gpx_reader import begins_gpx, read_gpx
from onboard.telemetry.mp4_container import begins_mp4
from onboard.telemetry.mrk_reader import begins_mrk, read_mrk_log
from onboard.telemetry.nmea_reader import begins_nmea, read_nmea
from onboard.telemetry.pos_reader import begins_pos, read_pos
from onboard.telemetry.read_options import ReadOptions
from onboard.telemetry.stream_reader import read_stream
from onboard.telemetry.telemetry_log import TelemetryLog
from onboard.telemetry.tlog_reader import read_tlog
from onboard.telemetry.transport_stream import begins_stream
from onboard.telemetry.video_reader import read_video

Reader = Callable[[Path, ReadOptions], TelemetryLog]


@dataclass(frozen=True)
class LogFormat:
    """A format that is recognised, and read or not.

    `name` with its article, as a refusal names it; `suffix` as files of it are usually called; `recognised`, `holds`
    and `needs` in words, the last of what must be stated besides; `begins` tests a file's first bytes. `read` is None
    where it is refused, and `instead` then what to do.
    """

    key: str
    name: str
    suffix: str
    recognised: str
    begins: Callable[[bytes], bool]
    read: Reader | None = None
    holds: str = ""
    needs: str = ""
    instead: str = ""


def is_text(head: bytes) -> bool:
    """Return whether a file that begins with `head` is text, as far as that goes."""
    try:
        text = head.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        text = head[: error.start].decode("utf-8-sig", "replace") if error.start > len(head) - 4 else "\0"
    return "\0" not in text and all(c.isprintable() or c in "\r\n\t" for c in text)


def _starts(*starts: bytes) -> Callable[[bytes], bool]:
    return lambda head: head.startswith(starts)


FORMATS = (
    LogFormat(
        "bin", "an ArduPilot DataFlash log", ".bin", "the bytes A3 95", _starts(dataflash_reader.MAGIC),
        lambda path, o: dataflash_reader.read_dataflash(path, o.clock),
        "position, velocity, attitude, rates, gimbal, receiver, filter, range, shots",
    ),
    LogFormat(
        "ulg", "a PX4 log", ".ulg", "`ULog`", _starts(ulog_reader.MAGIC),
        lambda path, o: ulog_reader.read_ulog(path, o.clock, o.boot_unix_s),
        "position, velocity, attitude, rates, gimbal, receiver, filter, range, shots", "`--time-offset` without UTC",
    ),
    LogFormat(
        "csv", "a table with columns as here", ".csv", "a column `unix_time_s`", csv_reader.looks_like_table,
        lambda path, _: csv_reader.read_csv(path), "all of its columns, below",
    ),
    LogFormat(
        "airdata", "an AirData table", ".csv", "columns `time(millisecond)`, `datetime(utc)`, `latitude`",
        flight_tables.AIRDATA.begins, flight_tables.AIRDATA.read,
        "position; height above take-off and sea +-100 m, metres or feet; attitude, gimbal",
        "`--home-amsl-m` without the latter",
    ),
    LogFormat(
        "dji", "a DJI flight record", ".csv", "columns `OSD.latitude`, `OSD.longitude`",
        flight_tables.DJI_RECORD.begins, flight_tables.DJI_RECORD.read,
        "position; height above take-off and sea +-100 m (`OSD.height`, `OSD.altitude`), metres or feet; attitude, "
        "gimbal; UTC or local time, as its columns state",
        "`--home-amsl-m` without `OSD.altitude`",
    ),
    LogFormat(
        "skydio", "a Skydio table", ".csv", "columns `Timestamp`, `Latitude`, `Longitude`, `Gimbal Pitch`",
        flight_tables.SKYDIO.begins, flight_tables.SKYDIO.read,
        "position; height `MSL` +-40 m, metres or feet; gimbal's pitch, in the nose's direction",
    ),
    LogFormat(
        "gpx", "a GPX track", ".gpx", "an element `gpx`", begins_gpx, read_gpx,
        "position; `ele` +-40 m, +-300 m where it reaches about 0",
    ),
    LogFormat(
        "ass", "an Autel .ass", ".ass", "`[Script Info]`", srt_reader.begins_ass,
        lambda path, o: srt_reader.read_srt(path, o.home_amsl_m, o.gps_order),
        "position, height above take-off (`ReH`), the video's own time", "`--home-amsl-m`",
    ),
    LogFormat(
        "srt", "an .srt", ".srt", "`00:00:00,000 --> 00:00:01,000`", srt_reader.looks_like_subtitles,
        lambda path, o: srt_reader.read_srt(path, o.home_amsl_m, o.gps_order),
        "position, heights, gimbal, attitude, zoom, the video's own time, by dialect",
        "`--home-amsl-m` or `--gps-order` in some dialects",
    ),
    LogFormat(
        "nmea", "a receiver's NMEA log", ".nmea", "`$GPGGA,...*5F`", begins_nmea, lambda path, _: read_nmea(path),
        "position, height above the sea (+-40 m where GGA states no height of the geoid), velocity, receiver; GGA and "
        "RMC or ZDA are needed",
    ),
    LogFormat(
        "pos", "a solution of RTKLIB", ".pos", "a head `% GPST`, `% UTC`", begins_pos, read_pos,
        "position with sigmas; height above the ellipsoid +-40 m", "`gps.undulation_m`",
    ),
    LogFormat(
        "mrk", "a DJI timestamp file", ".MRK", "`1  270245.350537  [2097] ... 24.68,Lat`", begins_mrk, read_mrk_log,
        "position of each photograph with sigmas, when it was taken; height above the ellipsoid +-40 m",
        "`gps.undulation_m`",
    ),
    LogFormat(
        "mp4", "a video", ".mp4", "a box `ftyp`", begins_mp4, read_video,
        "a track of subtitles, as an `.srt` has them; GoPro's GPMF: position, height above the ellipsoid or `MSLV` "
        "+-40 m; Parrot's (Anafi) and AP_CameraGimbal's: position, velocity, attitude, gimbal, field of view; when the "
        "last and GoPro's began, +-0.5 s",
        "`--home-amsl-m` or `--gps-order` in some dialects",
    ),
    LogFormat(
        "ts", "a transport stream", ".ts", "a byte 47 (hex) every 188 or 192", begins_stream, read_stream,
        "MISB ST 0601: position, height above sea or ellipsoid +-40 m, velocity, attitude, the camera's own, field of "
        "view; when the video began +-0.5 s",
        "`gps.undulation_m`",
    ),
    LogFormat(
        "geo", "an OpenDroneMap geo.txt", ".txt", "`EPSG:4326`", begins_geo,
        instead="its positions belong to pictures by their names and have no times: give it to import-photos",
    ),
    LogFormat(
        "log", "a DataFlash log as text", ".log", "`FMT, 128`", _starts(b"FMT, 128"),
        instead="give the .bin that the autopilot wrote",
    ),
    LogFormat(
        "jpeg", "a picture", ".jpg", "the bytes FF D8 FF", _starts(b"\xff\xd8\xff"),
        instead="for the pictures' own positions use --telemetry exif",
    ),
    LogFormat("zip", "a zip archive", ".zip", "`PK`", _starts(b"PK\x03\x04"), instead="unpack it first"),
    LogFormat(
        "gzip", "compressed (gzip)", ".gz", "the bytes 1F 8B", _starts(b"\x1f\x8b"), instead="unpack it first"
    ),
    LogFormat(
        "mcap", "a recorded session", ".mcap", "`MCAP`", _starts(b"\x89MCAP"),
        instead="give it to replay alone, without --telemetry",
    ),
    LogFormat(
        "tlog", "a MAVLink log", ".tlog", "MAVLink packets, in what is no text", lambda head: not is_text(head),
        lambda path, o: read_tlog(path, o.clock, o.gimbal, o.system),
        "position, velocity, attitude, rates, gimbal, zoom, receiver, filter, range, shots",
    ),
)  # fmt: skip
VIDEOS = frozenset({"mp4", "ts"})
READ = tuple(each for each in FORMATS if each.read is not None)
# Of files that lie next to pictures; a video there is another's.
SUFFIXES = tuple(dict.fromkeys(each.suffix.lower() for each in READ if each.key not in VIDEOS))
# A folder of pictures also has tracks of other things in it: these count only where there is no log of an aircraft.
POSITIONS_ALONE = frozenset({".gpx", ".nmea", ".pos", ".mrk"})


def recognised(head: bytes) -> LogFormat | None:
    return next((each for each in FORMATS if each.begins(head)), None)


def read_as(form: LogFormat, path: Path, options: ReadOptions) -> TelemetryLog:
    """Read a file as that format. Raises InputError, one line, that names file and format and what is lacking."""
    if form.read is None:
        raise InputError(f"telemetry {path}: is {form.name}: {form.instead}")
    try:
        return form.read(path, options)
    except InputError as error:
        if str(error).startswith("telemetry "):
            raise
        raise InputError(f"telemetry {path}: {form.name}: {error}") from error


def table() -> str:
    """Return the table of formats that are read, as docs/logs.md has it."""
    rows = [("log", "usually", "recognised by", "holds", "may need"), ("---",) * 5]
    rows += [
        (each.name.partition(" ")[2], f"`{each.suffix}`", each.recognised, each.holds, each.needs)
        for each in READ
    ]  # fmt: skip
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)
