"""ArduPilot's logs from before `TimeUS` (2014 to spring 2015): milliseconds, GPS week in GPS, the first filter, no POS.

Formats as DataFlash.h of that time has them.
"""

import math
import struct
from pathlib import Path

import numpy as np
import pytest

from contract.errors import InputError
from contract.rotations import matrix_from_quaternion
from onboard.events.types import Attitude, FilterStatus, GpsQuality, PositionFix
from onboard.telemetry.log_files import read_log
from tests.onboard.telemetry.log_events import of
from tests.onboard.telemetry.log_writers import (
    ABOVE_M,
    BOOT_S,
    GPS_LAG_S,
    HOME_M,
    LAT,
    LON,
    METRES_A_DEGREE,
    SPEED,
    Moment,
    moments,
)  # fmt: skip

T0_S = 1_412_000_000.0  # 2014-09-29, 16 leap seconds
SCALE = {"c": 100, "C": 100, "e": 100, "E": 100, "L": 10_000_000}
PACK = {"B": "B", "I": "I", "H": "H", "h": "h", "b": "b", "f": "f", "c": "h", "C": "H", "e": "i", "E": "I", "L": "i"}
COPTER_32 = {
    "GPS": ("BIHBcLLeeEefI", "Status,TimeMS,Week,NSats,HDop,Lat,Lng,RelAlt,Alt,Spd,GCrs,VZ,T"),
    "IMU": ("IffffffII", "TimeMS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,ErrG,ErrA"),
    "ATT": ("IccccCCCC", "TimeMS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,ErrRP,ErrYaw"),
    "EKF1": ("IccCffffffccc", "TimeMS,Roll,Pitch,Yaw,VN,VE,VD,PN,PE,PD,GX,GY,GZ"),
    "EKF4": ("IcccccccbbBBH", "TimeMS,SV,SP,SH,SMX,SMY,SMZ,SVT,OFN,EFE,FS,TS,SS"),
    "AHR2": ("IccCfLL", "TimeMS,Roll,Pitch,Yaw,Alt,Lat,Lng"),
}
PLANE_30 = COPTER_32 | {"ATT": ("IccCCC", "TimeMS,Roll,Pitch,Yaw,ErrorRP,ErrorYaw")}


class Log:
    def __init__(self, kinds: dict[str, tuple[str, str]]) -> None:
        self._kinds, self._rows = kinds, list[tuple[float, bytes]]()
        self._types = {name: 130 + i for i, name in enumerate(kinds)}
        self._head = self._format(128, 89, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")
        for name, (form, columns) in kinds.items():
            length = 3 + struct.calcsize("<" + "".join(PACK[c] for c in form))
            self._head += self._format(self._types[name], length, name, form, columns)

    @staticmethod
    def _format(kind: int, length: int, name: str, form: str, columns: str) -> bytes:
        body = struct.pack("<BB4s16s64s", kind, length, name.encode(), form.encode(), columns.encode())
        return b"\xa3\x95\x80" + body

    def add(self, name: str, t: float, **values: float) -> None:
        """A message logged `t` seconds into the flight; fields that are not given are 0."""
        form, columns = self._kinds[name]
        stamp = "T" if name == "GPS" else "TimeMS"
        values = {stamp: round((BOOT_S + t) * 1000)} | values
        fields = [values.get(column, 0) for column in columns.split(",")]
        scaled = [v if c == "f" else round(v * SCALE.get(c, 1)) for c, v in zip(form, fields, strict=True)]
        packed = struct.pack("<" + "".join(PACK[c] for c in form), *scaled)
        self._rows.append((t, bytes([0xA3, 0x95, self._types[name]]) + packed))

    def write(self, path: Path) -> Path:
        path.write_bytes(self._head + b"".join(row for _, row in sorted(self._rows, key=lambda row: row[0])))
        return path


def simulated(kinds: dict[str, tuple[str, str]], has_filter: bool = True, status: int = 3, week: bool = True) -> Log:
    log = Log(kinds)
    for m in moments(50):
        roll, pitch, yaw = m.euler_deg
        log.add("IMU", m.t, GyrX=m.roll_rate + math.radians(0.5))
        log.add("ATT", m.t, Roll=roll, Pitch=pitch, Yaw=yaw, DesRoll=50.0, DesPitch=50.0, DesYaw=50.0)
        log.add("AHR2", m.t, Roll=roll + 4.0, Pitch=pitch, Yaw=yaw, Alt=99.0, Lat=LAT + 1.0, Lng=LON)  # the second best
        if has_filter:
            log.add("EKF1", m.t, VN=SPEED, PN=SPEED * m.t, PD=-ABOVE_M, GX=0.5)
            log.add("EKF4", m.t, SS=0b0010_0011_0011_1111)
    for m in moments(5):
        ms = round((T0_S + m.t - 315_964_800 + 16) * 1000)
        where = {"Lat": m.lat, "Lng": LON, "Alt": HOME_M + ABOVE_M, "RelAlt": ABOVE_M, "Spd": SPEED, "NSats": 11}
        when = {"Week": ms // 604_800_000 if week else 0, "TimeMS": ms % 604_800_000}
        log.add("GPS", m.t + GPS_LAG_S, Status=status, **where, **when)
    return log


@pytest.mark.parametrize("kinds", [COPTER_32, PLANE_30], ids=["copter 3.2", "plane 3.0"])
@pytest.mark.parametrize("has_filter", [True, False])
def test_a_log_of_2014_is_read_with_true_moments_places_and_attitudes(
    tmp_path: Path, kinds: dict[str, tuple[str, str]], has_filter: bool
) -> None:
    log = read_log(simulated(kinds, has_filter).write(tmp_path / "17.BIN"))
    fixes = of(log, PositionFix)
    assert len(fixes) >= (500 if has_filter else 55)
    for fix in fixes:
        t = fix.stamp_ns / 1e9 - T0_S
        assert abs((fix.lat_deg - Moment(t).lat) * METRES_A_DEGREE) < 0.5
        assert fix.lon_deg == pytest.approx(LON, abs=1e-6)
        assert fix.height_amsl_m == pytest.approx(HOME_M + ABOVE_M, abs=0.05)
        assert fix.velocity_ned_m_s == pytest.approx((SPEED, 0.0, 0.0), abs=0.05)
        assert fix.height_above_home_m == (pytest.approx(ABOVE_M, abs=0.05) if has_filter else None)
    attitudes = of(log, Attitude)
    assert len(attitudes) > 500
    for attitude in attitudes[5:-5]:
        truth = matrix_from_quaternion(Moment(attitude.stamp_ns / 1e9 - T0_S).q)
        R = matrix_from_quaternion(attitude.q_ned_body)
        assert np.degrees(np.arccos(np.clip((np.trace(R.T @ truth) - 1.0) / 2.0, -1.0, 1.0))) < 0.1
        assert attitude.rate_body_rad_s is not None
    assert all(quality.fix_type == 3 and quality.satellites == 11 for quality in of(log, GpsQuality))
    assert all(status.has_position and not status.is_glitching for status in of(log, FilterStatus))


def test_a_first_filter_that_leaves_the_receiver_is_not_taken_for_the_position(tmp_path: Path) -> None:
    log = simulated(COPTER_32, has_filter=False)
    for m in moments(50):
        log.add("EKF1", m.t, VN=SPEED, PN=-8.0 * SPEED * m.t, PD=-ABOVE_M)
    fixes = of(read_log(log.write(tmp_path / "17.BIN")), PositionFix)
    assert len(fixes) < 70  # the receiver's own
    assert all(abs((f.lat_deg - Moment(f.stamp_ns / 1e9 - T0_S).lat) * METRES_A_DEGREE) < 0.5 for f in fixes)


@pytest.mark.parametrize(
    ("status", "week", "reported"), [(1, True, "never had a 3D fix"), (3, False, "no GPS week"), (None, True, "2014")]
)
def test_a_log_that_cannot_be_timed_says_why(tmp_path: Path, status: int | None, week: bool, reported: str) -> None:
    kinds = COPTER_32
    log = simulated(kinds, status=status or 3, week=week)
    if status is None:
        log = Log(kinds)
        log.add("ATT", 1.0)
        log.add("IMU", 1.0)
    with pytest.raises(InputError, match=reported) as caught:
        read_log(log.write(tmp_path / "17.BIN"))
    assert "\n" not in str(caught.value)
