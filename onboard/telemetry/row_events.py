"""Rows of numbers by the name of their column -> the events of a log: once for every table and list of positions.

A reader only finds out which column of its format is which of ours, and in what unit.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

from contract.errors import InputError
from contract.geodesy import within_180
from onboard.events.types import GpsQuality, NavEvent, PositionFix, RangeFinder
from onboard.telemetry.contradictions import LEAST_SHARE, agreeing
from onboard.telemetry.srt_axis_order import METRES_A_DEGREE
from onboard.telemetry.telemetry_log import TelemetryLog, attitudes, gimbal_attitudes, vouched, with_news

POSITION = ("lat_deg", "lon_deg", "height_amsl_m")
VELOCITY = ("velocity_north_m_s", "velocity_east_m_s", "velocity_down_m_s")
ATTITUDE = ("roll_deg", "pitch_deg", "yaw_deg")
RATE = ("rate_x_rad_s", "rate_y_rad_s", "rate_z_rad_s")
GIMBAL = ("gimbal_roll_deg", "gimbal_pitch_deg", "gimbal_yaw_deg")
SIGMAS = ("sigma_horizontal_m", "sigma_vertical_m", "sigma_velocity_m_s", "sigma_datum_m")
ABOVE_HOME, ABOVE_ELLIPSOID = "height_above_home_m", "height_ellipsoid_m"  # the latter becomes `height_amsl_m`
# Between 2000 and 2100: outside of it a time has another unit.
MIN_UNIX_S, MAX_UNIX_S = 946_684_800, 4_102_444_800
LIMITS = {"lat_deg": 90.0, "lon_deg": 360.0, "height_amsl_m": 1e5, ABOVE_HOME: 1e5, ABOVE_ELLIPSOID: 1e5}
DOWN = (0.0, 0.0, 1.0)
NO_FIX = (0.0, 0.0)  # as receivers write it: latitude and longitude
# One sigma of where heights count from: a receiver's own from an unnamed geoid, or from the ellipsoid, which lies
# within tens of metres of the sea in most places; a barometer's from 1013 hPa, which differs from the day's by 12 hPa
# (8.3 m each); and where nothing specifies whether it is the sea or the take-off.
SIGMA_GEOID_M, SIGMA_PRESSURE_HEIGHT_M, SIGMA_UNSPECIFIED_M = 40.0, 100.0, 300.0

Row = dict[str, float]
Rows = list[tuple[int, Row]]


def log_of_rows(
    rows: Rows, notes: Sequence[str] = (), utc_sigma_s: float | None = 0.0, is_repeated: bool = False
) -> TelemetryLog:
    """Return the log of rows, each with its stamp (ns). `utc_sigma_s`: see `TelemetryLog`; `is_repeated`: a position is
    written again in every row until the receiver has a new one.

    Raises InputError, without a file's name, for rows without a position, or whose positions contradict one another.
    """
    ordered = sorted(rows, key=lambda item: item[0])
    placed = [
        (stamp_ns, row)
        for stamp_ns, row in ordered
        if all(name in row for name in POSITION) and (row["lat_deg"], row["lon_deg"]) != NO_FIX
    ]
    if not placed:
        raise InputError(f"no position in it ({', '.join(POSITION)} all in one line)")
    positions = [_position(stamp_ns, row) for stamp_ns, row in placed]
    claims = [_claim(stamp_ns, row) for stamp_ns, row in placed]
    if is_repeated:
        new = with_news(positions)
        positions, claims = [positions[at] for at in new], [claims[at] for at in new]
    else:
        _check_stamps(positions)
    agree, contradictions = agreeing(positions)
    events = vouched([positions[at] for at in agree], [claims[at] for at in agree]) + _others(ordered)
    return replace(TelemetryLog.by_stamp(events), notes=(*notes, *contradictions), utc_sigma_s=utc_sigma_s)


def _check_stamps(positions: list[PositionFix]) -> None:
    """Raise InputError for times that were cut off, as spreadsheets do: many positions then have that of another."""
    pairs = itertools.pairwise(positions)
    same = sum(a.stamp_ns == b.stamp_ns and (a.lat_deg, a.lon_deg) != (b.lat_deg, b.lon_deg) for a, b in pairs)
    if same > (1.0 - LEAST_SHARE) * len(positions):
        raise InputError(f"{same} of its {len(positions)} positions have the time of another: its times were cut off")


def with_heights(
    rows: Rows, home_amsl_m: float | None, undulation_m: float | None, sigma_datum_m: float | None
) -> tuple[Rows, list[str]]:
    """Return the rows with heights above sea level, and notes on them.

    They are what `home_amsl_m` (the take-off's, m above sea level) gives with a height above the take-off; else the
    rows' own above sea level, whose origin is off by `sigma_datum_m`; else those above the ellipsoid less
    `undulation_m`. A height above the take-off alone is never taken for one above the sea: InputError states what is
    lacking.
    """
    placed = [row for _, row in rows if "lat_deg" in row]
    if not placed:
        raise InputError(
            "no position in it: the receiver had no fix, or latitude and longitude are not decimal degrees"
        )
    if home_amsl_m is not None:
        if not any(ABOVE_HOME in row for row in placed):
            raise InputError("no height above the take-off in it; leave --home-amsl-m out")
        # A row without one does not fall back on its height above the sea, which another sensor has measured.
        out = [(t, _with(row, home_amsl_m + row[ABOVE_HOME] if ABOVE_HOME in row else math.nan)) for t, row in rows]
        return out, []
    if any("height_amsl_m" in row for row in placed):
        if not sigma_datum_m:
            return rows, []
        out = [(t, row | {"sigma_datum_m": sigma_datum_m}) for t, row in rows]
        how = "; state how high the take-off was: --home-amsl-m M" if any(ABOVE_HOME in row for row in placed) else ""
        return out, [f"heights above sea level are +-{sigma_datum_m:.0f} m as a whole{how}"]
    if any(ABOVE_ELLIPSOID in row for row in placed):
        claim = {"sigma_datum_m": SIGMA_GEOID_M} if undulation_m is None else {"undulation_m": undulation_m}
        out = [
            (t, _with(row, row[ABOVE_ELLIPSOID] - (undulation_m or 0.0)) | claim if ABOVE_ELLIPSOID in row else row)
            for t, row in rows
        ]
        note = f"heights count from the ellipsoid, +-{SIGMA_GEOID_M:.0f} m as a whole: set gps.undulation_m"
        return out, [note] if undulation_m is None else []
    if any(ABOVE_HOME in row for row in placed):
        raise InputError("heights above the take-off only; state its height above sea level: --home-amsl-m M")
    raise InputError("positions without any height")


def with_steps(rows: Rows, decimals: int) -> Rows:
    """Return the rows with what rounding degrees to so many decimals does to a position, where they state no sigma."""
    sigma_m = METRES_A_DEGREE * 10.0**-decimals / 12.0**0.5
    return [(t, {"sigma_horizontal_m": sigma_m} | row) for t, row in rows]


def _with(row: Row, height_amsl_m: float) -> Row:
    """The row with that height above the sea in place of its others; without any for nan."""
    others = {name: value for name, value in row.items() if name not in (ABOVE_ELLIPSOID, "height_amsl_m")}
    return others if math.isnan(height_amsl_m) else others | {"height_amsl_m": height_amsl_m}


def _position(stamp_ns: int, row: Row) -> PositionFix:
    velocity = None
    if VELOCITY[0] in row and VELOCITY[1] in row:
        velocity = row[VELOCITY[0]], row[VELOCITY[1]], row.get(VELOCITY[2], math.nan)
    lon_deg = within_180(row["lon_deg"])
    return PositionFix(stamp_ns, row["lat_deg"], lon_deg, row["height_amsl_m"], velocity, row.get(ABOVE_HOME))


def _claim(stamp_ns: int, row: Row) -> GpsQuality:
    satellites = row.get("satellites")
    horizontal_m, vertical_m, velocity_m_s, datum_m = (row.get(name) or None for name in SIGMAS)
    return GpsQuality(
        stamp_ns,
        int(row.get("fix_type", 3)),
        None if satellites is None else int(satellites),
        horizontal_m,
        vertical_m,
        velocity_m_s,
        row.get("undulation_m"),
        datum_m,
    )


def _others(rows: Rows) -> list[NavEvent]:
    turned = [(stamp_ns, row) for stamp_ns, row in rows if all(name in row for name in ATTITUDE)]
    rates = [_three(row, RATE) if RATE[0] in row else None for _, row in turned]
    out = attitudes([(stamp_ns, _three(row, ATTITUDE)) for stamp_ns, row in turned], rates)
    out += gimbal_attitudes([(t, _three(row, GIMBAL)) for t, row in rows if all(name in row for name in GIMBAL)])
    ranged = [(stamp_ns, row["range_down_m"]) for stamp_ns, row in rows if row.get("range_down_m", 0.0) > 0.0]
    return out + [RangeFinder(stamp_ns, distance_m, DOWN) for stamp_ns, distance_m in ranged]


def _three(row: Row, names: tuple[str, str, str]) -> tuple[float, float, float]:
    return row[names[0]], row[names[1]], row[names[2]]
