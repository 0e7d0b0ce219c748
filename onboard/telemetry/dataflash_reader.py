"""ArduPilot's own log (DataFlash, .bin) -> events. Its filter's outputs serve as the same autopilot's MAVLink messages
do: POS as GLOBAL_POSITION_INT (its velocity from XKF1 or NKF1), ATT as ATTITUDE, GPS and GPA as GPS_RAW_INT, XKF4 as
EKF_STATUS_REPORT, MNT as the gimbal's attitude, RFND as DISTANCE_SENSOR, CAM or TRIG as
CAMERA_FEEDBACK. Logs from before `TimeUS` (2014 to spring
2015) have milliseconds, the first filter (EKF1, EKF4) and often no POS.

A simulator's log also holds the truth (SIM, SIM2): never read here.
"""

from __future__ import annotations

import contextlib
import io
import math
import tempfile
from collections import defaultdict
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pymavlink import DFReader

from contract.errors import InputError
from onboard.clocks.boot_clock import Mode
from onboard.events.types import (
    Attitude,
    FilterStatus,
    GimbalAttitude,
    GpsQuality,
    Home,
    NavEvent,
    PositionFix,
    RangeFinder,
)
from onboard.telemetry.gps_time import LAG_S, METRES_A_DEGREE, GpsClock, receiver_lag_s, unix_ns_of_gps
from onboard.telemetry.mavlink_events import FROZEN_GPS_NS, sensor_direction
from onboard.telemetry.telemetry_log import TelemetryLog, interpolated, quaternions

Array = NDArray[np.float64]

MAGIC = b"\xa3\x95"
FIELDS = {
    "GPS": ("Status", "GMS", "GWk", "NSats", "Lat", "Lng", "Alt", "Spd", "GCrs", "VZ"),
    "GPA": ("HAcc", "VAcc", "SAcc", "AEl"),
    "POS": ("Lat", "Lng", "Alt", "RelHomeAlt"),
    "ATT": ("Roll", "Pitch", "Yaw"),
    "IMU": ("GyrX", "GyrY", "GyrZ"),
    "KF1": ("VN", "VE", "VD", "GX", "GY", "GZ", "PN", "PE", "PD"),
    "KF4": ("SS",),
    "RFND": ("Dist", "Orient", "Stat"),
    "MNT": ("Roll", "Pitch", "YawB"),
    "CAM": ("GWk",),
    "TRIG": ("GWk",),
    "ORGN": ("Type", "Lat", "Lng", "Alt"),
}
# The earlier names of a field, in the order in which they are looked for.
FORMERLY = {"GMS": ("GPSTimeMS", "TimeMS"), "GWk": ("Week",), "RelHomeAlt": ("RelAlt",)}
UNUSED = "GPS of the first receiver, not in use"
FAST, FAST_US = {"IMU", "KF1", "KF4"}, 3000  # may be logged at a loop's rate, of which no more than this is used
FAR_US = 5_000_000  # a stamp this far from its neighbours' is damaged
MAX_ORIGIN_M = 15.0  # that the receiver's track may lie about the first filter's, where that one stands for POS
REPORT_US = 200_000  # the filter's flags come at its own rate: passed on when they change, and this often
MOST_DAMAGED, PADDING = (
    100,
    528,
)  # headers that are mended in one log; bytes after its last message that may be anything
GOOD_RANGE = 4  # RFND.Stat
HOME = 1  # ORGN.Type; 0 is the filter's origin
WITHOUT_FIX = 3  # GPS.Status below this one
# nav_filter_status, the bits of XKF4.SS.
POSITION_ABSOLUTE, POSITION_HELD, GLITCHING, INITIALISED = 1 << 4, 1 << 7, 1 << 14, 1 << 16


@dataclass(frozen=True, eq=False)
class _Table:
    """The messages of one kind: boot time (N,), us, and the fields of `FIELDS` (N, F); nan where a field is missing."""

    boot_us: NDArray[np.int64]
    values: Array

    def __len__(self) -> int:
        return len(self.boot_us)

    def at(self, boot_us: NDArray[np.int64], columns: slice) -> Array:
        """Columns interpolated at other times (M,); nan past the ends and within gaps."""
        return interpolated(self.boot_us, self.values[:, columns], boot_us)


def read_dataflash(path: Path | str, clock: Mode = "auto") -> TelemetryLog:
    """Read a whole log, stamped on Unix time by GPS time. Damaged stretches and a cut end are passed over.

    Raises InputError, one line, for a file that is no log, or has no GPS time or no position.
    """
    tables = _tables(path)
    gps = tables["GPS"]
    gps_clock = GpsClock(clock)
    fixed = [
        (int(us) * 1000, unix_ns_of_gps(int(row[2]), int(row[1])))
        for us, row in zip(gps.boot_us, gps.values, strict=True)
        if row[0] >= WITHOUT_FIX and row[2] > 0 and np.isfinite(row[1])
    ]
    for boot_ns, unix_ns in fixed:
        gps_clock.add(boot_ns, unix_ns)
    if not gps_clock.is_set:
        raise InputError(f"telemetry {path}: {_why_no_time(gps)}")
    if not len(tables["POS"]):
        tables["POS"] = _first_filter_positions(tables["KF1"], gps)
    gps_clock.lag_s = _lag_s(gps, tables["POS"], gps_clock)
    events: list[NavEvent] = [
        *_positions(tables, gps_clock),
        *_attitudes(tables, gps_clock),
        *_qualities(gps, tables["GPA"], gps_clock),
        *_filter_statuses(tables["KF4"], gps_clock),
        *_gimbal(tables["MNT"], gps_clock),
        *_ranges(tables["RFND"], gps_clock),
        *_homes(tables["ORGN"], gps_clock),
    ]
    if not any(isinstance(event, PositionFix) for event in events):
        raise InputError(f"telemetry {path}: no position in it (POS, or GPS with a 3D fix)")
    # CAM is the camera's own report where it gives one; TRIG is then what asked for it.
    shots = tables["CAM"] if len(tables["CAM"]) else tables["TRIG"]
    shots_ns = tuple(gps_clock.to_unix_ns(us * 1000) for us in shots.boot_us.tolist())
    return replace(TelemetryLog.by_stamp(events, gps_clock.segments), shots_ns=shots_ns)


def _tables(path: Path | str) -> dict[str, _Table]:
    rows: dict[str, list[tuple[float, ...]]] = defaultdict(list)
    # The library prints messages about damage; for unknown files it raises errors of many kinds.
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        try:
            with _opened(path) as log:
                filter_name = _filter_of(log)
                kinds = {name: name for name in FIELDS if not name.startswith("KF")}
                kinds |= {f"{filter_name}{name[2:]}": name for name in FIELDS if name.startswith("KF")}
                kinds |= {f"{name}2": name for name in ("GPS", "GPA")}  # of a second receiver, before it was `I`
                primary, receiver = 0, 0
                while (message := log.recv_match(type=list(kinds))) is not None:
                    name = kinds.get(message.get_type())
                    if name == "KF4":
                        primary = getattr(message, "PI", primary)
                    if name == "GPS" and bool(getattr(message, "U", False)):
                        receiver = _receiver(message)
                    key = name if name is not None and _is_used(message, name, primary, receiver) else None
                    if key is None and name == "GPS" and _receiver(message) == 0:
                        key = UNUSED
                    if name is not None and key is not None:
                        held = rows[key]
                        boot_us = _boot_us(message)
                        if name not in FAST or not held or not 0.0 <= boot_us - held[-1][0] < FAST_US:
                            held.append((boot_us, *(_number(message, field) for field in FIELDS[name])))
        except Exception as error:
            why = " ".join(str(error).split()) or type(error).__name__
            raise InputError(f"telemetry {path}: not a DataFlash log that can be read ({why})") from error
    if not rows["GPS"]:
        rows["GPS"] = rows[UNUSED]  # a blend of several, of which none counts as the one in use
    return {name: _table(rows[name], len(fields)) for name, fields in FIELDS.items()}


def _opened(path: Path | str) -> Any:
    """The log as the library reads it, which ends at the first kind of message that the log does not describe.

    A damaged byte makes one: in a copy it is no header any more, and what comes after it is read too.
    """
    log, data = DFReader.DFReader_binary(str(path)), bytearray()
    for _ in range(MOST_DAMAGED):
        end = _end_of(log)
        if log.data_len - end <= PADDING or log.data_map[end : end + len(MAGIC)] != MAGIC:
            break
        data = data or bytearray(log.data_map[:])
        data[end] = 0
        log.close()
        with tempfile.NamedTemporaryFile() as mended:  # what is mapped stays readable without its name
            mended.write(data)
            mended.flush()
            log = DFReader.DFReader_binary(mended.name)
    return log


def _end_of(log: Any) -> int:
    """The end of the last message that the library knows of, bytes from the beginning."""
    ends = ((int(held[-1]), kind) for kind, held in enumerate(log.offsets) if len(held))
    last, kind = max(ends, default=(0, -1))
    return last + int(log.formats[kind].len) if kind in log.formats else last


def _filter_of(log: Any) -> str:
    """The navigation filter that flew: "XKF" (the third), "NKF" (the second) or "EKF" (the first)."""
    first = log.recv_match(type="ATT")
    log.rewind()
    names = log.name_to_id
    if "EKF1" in names and "XKF1" not in names and "NKF1" not in names:
        return "EKF"
    if getattr(first, "AEKF", 0) == 2 or "XKF1" not in names:
        return "NKF"
    return "XKF"


def _receiver(message: Any) -> int:
    return int(message.I) if hasattr(message, "I") else int(message.get_type().endswith("2"))


def _is_used(message: Any, name: str, primary: int, receiver: int) -> bool:
    """Return whether a message is used.

    Of filter cores it is the primary one, of receivers the one in use, of range finders each, of others the first.
    """
    if name in ("KF1", "KF4"):
        return bool(getattr(message, "C", primary) == primary)
    if name == "GPS":
        return bool(message.U) if hasattr(message, "U") else _receiver(message) == 0
    if name == "GPA":
        return _receiver(message) == receiver
    return name == "RFND" or getattr(message, "I", 0) == 0


def _boot_us(message: Any) -> float:
    """Time since the start. Before `TimeUS` it was `TimeMS`, but in GPS, whose `TimeMS` was GPS time, `T`."""
    boot_ms = _number(message, "T" if message.get_type() == "GPS" and hasattr(message, "T") else "TimeMS")
    return _number(message, "TimeUS") if hasattr(message, "TimeUS") else 1000.0 * boot_ms


def _number(message: Any, field: str) -> float:
    names = (field, *FORMERLY.get(field, ()))
    value = next((getattr(message, name) for name in names if hasattr(message, name)), math.nan)
    return float(value) if isinstance(value, int | float) else math.nan


def _why_no_time(gps: _Table) -> str:
    if not len(gps):
        return (
            "no GPS message with a time in it: logs from before 2014 have none, and without a receiver none is written"
        )
    if not np.any(gps.values[:, 0] >= WITHOUT_FIX):
        return "its receiver never had a 3D fix, so its times cannot be determined; give the log of a flight with one"
    return "its GPS messages have a fix but no GPS week, so its times cannot be determined; give the flight's .tlog"


def _first_filter_positions(filtered: _Table, gps: _Table) -> _Table:
    """POS out of the first filter's metres from its origin, which the receiver's track gives; empty if it does not.

    The heights above home count from that origin, which is set where the vehicle is armed.
    """
    none = _Table(np.zeros(0, np.int64), np.zeros((0, 4)))
    fixed = gps.values[:, 0] >= WITHOUT_FIX
    moved = filtered.at(gps.boot_us[fixed] - round(1e6 * LAG_S), slice(6, 9))
    known = np.isfinite(moved).all(axis=1)
    if known.sum() < 10:
        return none
    fixes, moved = gps.values[fixed][known, 4:7], moved[known]
    metres = METRES_A_DEGREE * np.array([1.0, math.cos(math.radians(float(fixes[0, 0])))])
    origins = np.column_stack([fixes[:, :2] - moved[:, :2] / metres, fixes[:, 2] + moved[:, 2]])
    origin = np.median(origins, axis=0)
    off_m = np.abs((origins - origin) * np.append(metres, 1.0))
    if np.median(off_m.max(axis=1)) > MAX_ORIGIN_M:
        return none
    ned = filtered.values[:, 6:9]
    places = np.column_stack([origin[:2] + ned[:, :2] / metres, origin[2] - ned[:, 2], -ned[:, 2]])
    return _Table(filtered.boot_us, places)


def _table(rows: list[tuple[float, ...]], width: int) -> _Table:
    values = np.array(rows, float).reshape(-1, width + 1)
    values = values[np.isfinite(values[:, 0])]
    if len(values) >= 5:
        padded = np.pad(values[:, 0], 2, mode="edge")
        around = np.median(np.lib.stride_tricks.sliding_window_view(padded, 5), axis=1)
        values = values[np.abs(values[:, 0] - around) < FAR_US]
    values = values[np.argsort(values[:, 0], kind="stable")]
    return _Table(values[:, 0].astype(np.int64), values[:, 1:])


def _lag_s(gps: _Table, filtered: _Table, clock: GpsClock) -> float:
    """The receiver's delay, by its track against the filter's (POS), with the least delayed report as time so far."""
    good = (gps.values[:, 0] >= WITHOUT_FIX) & (gps.values[:, 2] > 0)
    fixes = gps.values[good]
    unix_ns = [unix_ns_of_gps(int(week), int(ms)) for ms, week in fixes[:, 1:3].tolist()]
    return receiver_lag_s(clock, gps.boot_us[good], unix_ns, fixes[:, 4:6], (filtered.boot_us, filtered.values[:, :2]))


def _known(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _is_place(lat_deg: float, lon_deg: float, height_m: float) -> bool:
    return (lat_deg, lon_deg) != (0.0, 0.0) and abs(lat_deg) <= 90 and abs(lon_deg) <= 180 and abs(height_m) < 1e5


def _positions(tables: dict[str, _Table], clock: GpsClock) -> list[NavEvent]:
    pos = tables["POS"]
    out: list[NavEvent] = []
    velocities = tables["KF1"].at(pos.boot_us, slice(0, 3))
    for us, row, v in zip(pos.boot_us.tolist(), pos.values.tolist(), velocities.tolist(), strict=True):
        if _is_place(*row[:3]):
            velocity = (v[0], v[1], v[2]) if math.isfinite(sum(v)) else None
            out.append(PositionFix(clock.to_unix_ns(us * 1000), row[0], row[1], row[2], velocity, _known(row[3])))
    if out:
        return out
    gps = tables["GPS"]
    for us, row in zip(gps.boot_us.tolist(), gps.values.tolist(), strict=True):
        fix = _receiver_position(us, row, clock)
        if fix is not None:
            out.append(fix)
    return out


def _receiver_position(us: int, row: list[float], clock: GpsClock) -> PositionFix | None:
    """The position and velocity of a GPS row."""
    if not (row[0] >= WITHOUT_FIX and _is_place(*row[4:7])):
        return None
    course = math.radians(row[8])
    north, east, down = row[7] * math.cos(course), row[7] * math.sin(course), row[9]
    velocity = (north, east, down) if math.isfinite(north) else None
    stamp_ns = clock.to_unix_ns(us * 1000) - round(clock.lag_s * 1e9)
    return PositionFix(stamp_ns, row[4], row[5], row[6], velocity)


def _attitudes(tables: dict[str, _Table], clock: GpsClock) -> list[NavEvent]:
    """Rates are the gyros', less the filter's estimate of their bias, as ATTITUDE has them."""
    att = tables["ATT"]
    rates = tables["IMU"].at(att.boot_us, slice(0, 3))
    rates = rates - np.radians(np.nan_to_num(tables["KF1"].at(att.boot_us, slice(3, 6))))
    out: list[NavEvent] = []
    for us, (w, x, y, z), rate in zip(
        att.boot_us.tolist(), quaternions(att.values).tolist(), rates.tolist(), strict=True
    ):
        if math.isfinite(w + x + y + z):
            body = (rate[0], rate[1], rate[2]) if math.isfinite(sum(rate)) else None
            out.append(Attitude(clock.to_unix_ns(us * 1000), (w, x, y, z), body))
    return out


def _qualities(gps: _Table, gpa: _Table, clock: GpsClock) -> list[NavEvent]:
    out: list[NavEvent] = []
    moved_us, last_ms = 0, math.nan
    for us, row in zip(gps.boot_us.tolist(), gps.values.tolist(), strict=True):
        is_new = row[1] != last_ms
        if is_new:
            moved_us, last_ms = us, row[1]
        fix_type = int(row[0]) if math.isfinite(row[0]) and us - moved_us <= FROZEN_GPS_NS // 1000 else 0
        claim = [math.nan] * 4
        nearest = int(np.searchsorted(gpa.boot_us, us))
        if nearest < len(gpa) and gpa.boot_us[nearest] - us < FAR_US // 10:
            claim = gpa.values[nearest].tolist()
        undulation = claim[3] - row[6]
        known = fix_type >= WITHOUT_FIX and abs(undulation) < 150.0  # unknown is the least integer
        sigmas = [_known(value) or None for value in claim[:3]]
        satellites = int(row[3]) if math.isfinite(row[3]) else None
        fix = _receiver_position(us, row, clock) if is_new else None
        stamp_ns = clock.to_unix_ns(us * 1000)
        quality = GpsQuality(stamp_ns, fix_type, satellites, sigmas[0], sigmas[1], sigmas[2], fix=fix)
        out.append(replace(quality, undulation_m=undulation) if known else quality)
    return out


def _filter_statuses(table: _Table, clock: GpsClock) -> list[NavEvent]:
    out: list[NavEvent] = []
    # Older filters have no bit for being initialised.
    has_bit = bool(np.any(table.values[:, 0] >= INITIALISED))
    reported: tuple[bool, bool] | None = None
    reported_us = 0
    for us, value in zip(table.boot_us.tolist(), table.values[:, 0].tolist(), strict=True):
        if not 0 <= value < 2**32:
            continue
        flags = int(value)
        has_position = bool(flags & POSITION_ABSOLUTE) and not flags & POSITION_HELD
        has_position &= bool(flags & INITIALISED) or not has_bit
        state = has_position, bool(flags & GLITCHING)
        if state != reported or us - reported_us >= REPORT_US:
            reported, reported_us = state, us
            out.append(FilterStatus(clock.to_unix_ns(us * 1000), *state))
    return out


def _gimbal(table: _Table, clock: GpsClock) -> list[NavEvent]:
    return [
        GimbalAttitude(clock.to_unix_ns(us * 1000), (w, x, y, z), "vehicle")
        for us, (w, x, y, z) in zip(table.boot_us.tolist(), quaternions(table.values).tolist(), strict=True)
        if math.isfinite(w + x + y + z)
    ]


def _ranges(table: _Table, clock: GpsClock) -> list[NavEvent]:
    out: list[NavEvent] = []
    for us, (distance_m, orientation, state) in zip(table.boot_us.tolist(), table.values.tolist(), strict=True):
        direction = sensor_direction(int(orientation)) if math.isfinite(orientation) else None
        if direction is not None and state == GOOD_RANGE and distance_m > 0.0:
            out.append(RangeFinder(clock.to_unix_ns(us * 1000), distance_m, direction))
    return out


def _homes(table: _Table, clock: GpsClock) -> list[NavEvent]:
    return [
        Home(clock.to_unix_ns(us * 1000), lat_deg, lon_deg, height_m)
        for us, (kind, lat_deg, lon_deg, height_m) in zip(table.boot_us.tolist(), table.values.tolist(), strict=True)
        if kind == HOME and math.isfinite(lat_deg + lon_deg + height_m) and (lat_deg, lon_deg) != (0.0, 0.0)
    ]
