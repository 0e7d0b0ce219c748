"""One short flight as logs of every kind that is read, written from the formats' documentation.

North at 20 m/s with a gentle roll, 100 m above a home at 350 m above sea level. Boot time begins at BOOT_S, and the
flight at T0_S of Unix time.
"""

import functools
import io
import itertools
import math
import operator
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from pyulog import ULog

from contract.rotations import euler_from_matrix, matrix_from_euler, quaternion_from_matrix

T0_S = 1_795_217_000.0
BOOT_S = 60.0
SECONDS = 12.0
LAT, LON, HOME_M, ABOVE_M = -43.38, 172.4, 350.0, 100.0
SPEED = 20.0
METRES_A_DEGREE = 111_132.0
SHUTTER_S, UTC_BEHIND_S = 0.1, 3.0  # after what asked for it; of a .tlog's UTC, behind the clock that stamped it
FOOT_M, LOCAL_AHEAD_S = 0.3048, 13 * 3600.0
GPS_LAG_S = 0.12  # what readers assume where a straight flight shows none


@dataclass(frozen=True)
class Moment:
    """Where the flight is, `t` seconds after its beginning."""

    t: float

    @property
    def lat(self) -> float:
        return LAT + SPEED * self.t / METRES_A_DEGREE

    @property
    def euler_deg(self) -> tuple[float, float, float]:
        return 6.0 * math.sin(0.8 * self.t), 3.0, 10.0

    @property
    def roll_rate(self) -> float:
        return math.radians(4.8 * math.cos(0.8 * self.t))

    @property
    def q(self) -> tuple[float, ...]:
        return tuple(quaternion_from_matrix(matrix_from_euler(*np.radians(self.euler_deg))).tolist())


def moments(rate_hz: float) -> Iterator[Moment]:
    for i in range(round(SECONDS * rate_hz)):
        yield Moment(i / rate_hz)


# ---------------------------------------------------------------- MAVLink


def tlog() -> bytes:
    packer, out = mavlink.MAVLink(None, srcSystem=1, srcComponent=1), []

    def send(t: float, message: mavlink.MAVLink_message) -> None:
        out.append((t, struct.pack(">Q", round((T0_S + t) * 1e6)) + message.pack(packer)))

    boot = {m.t: round((BOOT_S + m.t) * 1000) for m in moments(50)}
    for m in moments(50):
        roll, pitch, yaw = np.radians(m.euler_deg)
        send(m.t, mavlink.MAVLink_attitude_message(boot[m.t], roll, pitch, yaw, m.roll_rate, 1e-9, 1e-9))
    for m in moments(10):
        place = round(m.lat * 1e7), round(LON * 1e7), round((HOME_M + ABOVE_M) * 1e3), round(ABOVE_M * 1e3)
        send(m.t, mavlink.MAVLink_global_position_int_message(boot[m.t], *place, round(SPEED * 100), 0, 0, 0))
    for m in moments(5):
        send(m.t, mavlink.MAVLink_gps_raw_int_message(
            boot[m.t] * 1000, 3, round(m.lat * 1e7), round(LON * 1e7), 450_000, 100, 100, 2000, 0, 12, 461_000, 400,
            600, 0, 0, 0))  # fmt: skip
        send(m.t, mavlink.MAVLink_heartbeat_message(1, 3, 0, 0, 4, 3))
        send(m.t, mavlink.MAVLink_ekf_status_report_message(0b1100111111, 0, 0, 0, 0, 0))
    for m in moments(1):
        # By UTC, from which this log's own clock differs.
        boot_ms, unix_us = round((BOOT_S + m.t) * 1000), round((T0_S - UTC_BEHIND_S + m.t) * 1e6)
        send(m.t, mavlink.MAVLink_system_time_message(unix_us, boot_ms))
        shot = (unix_us + round(SHUTTER_S * 1e6), 1, 0, 7, 0, 0, 0, 0, 0, 0, 0, 0, 0)
        send(m.t + 0.3, mavlink.MAVLink_camera_feedback_message(*shot))
    return b"".join(data for _, data in sorted(out, key=lambda item: item[0]))


# ---------------------------------------------------------------- DataFlash

PACK = {
    "Q": "Q",
    "f": "f",
    "d": "d",
    "L": "i",
    "B": "B",
    "I": "I",
    "H": "H",
    "h": "h",
    "N": "16s",
    "n": "4s",
    "Z": "64s",
}
KINDS = {  # name: format, columns
    "GPS": ("QBBIHBffff", "TimeUS,I,Status,GMS,GWk,NSats,Alt,Spd,GCrs,VZ"),
    "GPSL": ("QLL", "TimeUS,Lat,Lng"),
    "GPA": ("QBfffff", "TimeUS,I,VDop,HAcc,VAcc,SAcc,AEl"),
    "POS": ("QLLff", "TimeUS,Lat,Lng,Alt,RelHomeAlt"),
    "ATT": ("QfffB", "TimeUS,Roll,Pitch,Yaw,AEKF"),
    "IMU": ("QBfff", "TimeUS,I,GyrX,GyrY,GyrZ"),
    "XKF1": ("QBffffffff", "TimeUS,C,VN,VE,VD,PN,PE,GX,GY,GZ"),
    "XKF4": ("QBIB", "TimeUS,C,SS,PI"),
    "SIM": ("QLL", "TimeUS,Lat,Lng"),
    "RFND": ("QBfBB", "TimeUS,Instance,Dist,Stat,Orient"),
    "MNT": ("QBfff", "TimeUS,I,Roll,Pitch,YawB"),
    "CAM": ("QBH", "TimeUS,I,Img"),
    "TRIG": ("QBH", "TimeUS,I,Img"),
    "ORGN": ("QBLLf", "TimeUS,Type,Lat,Lng,Alt"),
}
KINDS["GPS"] = ("QBBIHBLLffff", "TimeUS,I,Status,GMS,GWk,NSats,Lat,Lng,Alt,Spd,GCrs,VZ")
del KINDS["GPSL"]


class Dataflash:
    def __init__(self) -> None:
        self.data = b""
        self.rows: list[tuple[int, bytes]] = []
        self._types = {name: 130 + i for i, name in enumerate(KINDS)}
        self._format(128, 89, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")
        for name, (form, columns) in KINDS.items():
            length = 3 + struct.calcsize("<" + "".join(PACK[c] for c in form))
            self._format(self._types[name], length, name, form, columns)

    def _format(self, kind: int, length: int, name: str, form: str, columns: str) -> None:
        body = struct.pack("<BB4s16s64s", kind, length, name.encode(), form.encode(), columns.encode())
        self.data += b"\xa3\x95\x80" + body

    def add(self, name: str, t: float, *values: float) -> None:
        form = KINDS[name][0]
        scaled = [round(v * 1e7) if c == "L" else v for c, v in zip(form[1:], values, strict=True)]
        boot_us = round((BOOT_S + t) * 1e6)
        packed = struct.pack("<Q" + "".join(PACK[c] for c in form[1:]), boot_us, *scaled)
        self.rows.append((boot_us, bytes([0xA3, 0x95, self._types[name]]) + packed))

    def bytes(self) -> bytes:
        return self.data + b"".join(row for _, row in sorted(self.rows, key=lambda row: row[0]))


def gps_time(unix_s: float) -> tuple[int, int]:
    """Week and milliseconds, 18 leap seconds ahead of UTC."""
    ms = round((unix_s - 315_964_800 + 18) * 1000)
    return ms // 604_800_000, ms % 604_800_000


def dataflash_log(gimbal: bool = False) -> Dataflash:
    log = Dataflash()
    for m in moments(50):
        log.add("IMU", m.t, 0, m.roll_rate + math.radians(0.5), 0.0, 0.0)
        log.add("XKF1", m.t, 0, SPEED, 0.0, 0.0, SPEED * m.t, 0.0, 0.5, 0.0, 0.0)
        log.add("XKF1", m.t, 1, 99.0, 99.0, 9.0, 0.0, 0.0, 0.0, 0.0, 0.0)  # another core, not the primary
        log.add("XKF4", m.t, 0, 0b1_1000_0011_0011_1111, 0)
        log.add("ATT", m.t, *m.euler_deg, 3)
    for m in moments(10):
        log.add("POS", m.t, m.lat, LON, HOME_M + ABOVE_M, ABOVE_M)
        log.add("SIM", m.t, 1.0, 2.0)
        log.add("RFND", m.t, 0, ABOVE_M, 4, 25)
        if gimbal:
            log.add("MNT", m.t, 0, 0.0, -90.0, 5.0)
    for m in moments(5):
        week, ms = gps_time(T0_S + m.t)
        late = m.t + GPS_LAG_S
        log.add("GPS", late, 0, 3, ms, week, 12, m.lat, LON, HOME_M + ABOVE_M, SPEED, 0.0, 0.0)
        log.add("GPA", late, 0, 1.0, 0.4, 0.6, 0.1, HOME_M + ABOVE_M + 11.0)
    for m in moments(1):
        log.add("TRIG", m.t, 0, 7)
        log.add("CAM", m.t + SHUTTER_S, 0, 7)
    log.add("ORGN", 0.0, 0, LAT + 0.001, LON, HOME_M + 1.0)  # the filter's own origin
    log.add("ORGN", 0.0, 1, LAT, LON, HOME_M)
    return log


def dataflash() -> bytes:
    return dataflash_log().bytes()


# ---------------------------------------------------------------- ULog

NUMPY = {"uint64_t": "<u8", "double": "<f8", "float": "<f4", "uint8_t": "u1", "int32_t": "<i4", "uint16_t": "<u2"}
TOPICS: dict[str, tuple[tuple[str, str], ...]] = {
    "vehicle_global_position": (("double", "lat"), ("double", "lon"), ("float", "alt")),
    "vehicle_local_position": (("float", "vx"), ("float", "vy"), ("float", "vz")),
    "vehicle_attitude": (("float[4]", "q"),),
    "vehicle_angular_velocity": (("float[3]", "xyz"),),
    "vehicle_gps_position": (
        ("double", "latitude_deg"), ("double", "longitude_deg"), ("double", "altitude_msl_m"),
        ("double", "altitude_ellipsoid_m"), ("uint64_t", "time_utc_usec"), ("float", "eph"), ("float", "epv"),
        ("float", "s_variance_m_s"), ("uint8_t", "fix_type"), ("uint8_t", "satellites_used"),
    ),
    "estimator_status": (("uint16_t", "solution_status_flags"),),
    "camera_capture": (("uint64_t", "timestamp_utc"), ("uint8_t", "result")),
    "home_position": (
        ("double", "lat"), ("double", "lon"), ("float", "alt"), ("uint8_t", "valid_alt"), ("uint8_t", "valid_hpos"),
    ),
    "gimbal_device_attitude_status": (("float[4]", "q"), ("uint16_t", "device_flags")),
}  # fmt: skip


def _ulog_rows(gimbal: bool, has_utc: bool) -> Iterator[tuple[float, str, tuple[float, ...]]]:
    for m in moments(50):
        yield m.t, "vehicle_attitude", m.q
        yield m.t, "vehicle_angular_velocity", (m.roll_rate, 0.0, 0.0)
        yield m.t, "vehicle_local_position", (SPEED, 0.0, 0.0)
    for m in moments(10):
        yield m.t, "vehicle_global_position", (m.lat, LON, HOME_M + ABOVE_M)
        if gimbal:
            yield m.t, "gimbal_device_attitude_status", (*_quaternion(0.0, -90.0, 40.0), 64)  # yaw against north
    for m in moments(1):
        utc_us = round((T0_S + m.t + SHUTTER_S) * 1e6)
        yield m.t + SHUTTER_S, "camera_capture", (utc_us, 1)
        yield m.t + 2.0 * SHUTTER_S, "camera_capture", (utc_us, 0)  # one that failed
    for m in moments(5):
        height, utc = HOME_M + ABOVE_M, round((T0_S + m.t) * 1e6) if has_utc else 0
        gps = m.lat, LON, height, height + 11.0, utc, 0.4, 0.6, 0.1, 3, 12
        yield m.t + GPS_LAG_S, "vehicle_gps_position", gps
        yield m.t, "estimator_status", (0b11_0011_1111,)
    yield 0.0, "home_position", (LAT, LON, HOME_M, 1, 1)
    yield 0.1, "home_position", (LAT, LON, HOME_M, 1, 0)  # its place is not known


def _quaternion(*euler_deg: float) -> tuple[float, ...]:
    return tuple(quaternion_from_matrix(matrix_from_euler(*np.radians(euler_deg))).tolist())


def ulog(gimbal: bool = False, has_utc: bool = True) -> bytes:
    """Put together from the file format's documentation, and written by pyulog's own writer."""
    rows = sorted(_ulog_rows(gimbal, has_utc), key=lambda row: row[0])
    used = [name for name in TOPICS if any(row[1] == name for row in rows)]

    def message(kind: str, body: bytes) -> bytes:
        return struct.pack("<HB", len(body), ord(kind)) + body

    out = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", round(BOOT_S * 1e6)) + message("B", bytes(40))
    for name in used:
        fields = ";".join(f"{kind} {field}" for kind, field in (("uint64_t", "timestamp"), *TOPICS[name]))
        out += message("F", f"{name}:{fields};".encode())
    for number, name in enumerate(used):
        out += message("A", struct.pack("<BH", 0, number) + name.encode())
    for t, name, values in rows:
        left, body = list(values), struct.pack("<HQ", used.index(name), round((BOOT_S + t) * 1e6))
        for kind, _ in TOPICS[name]:
            base, _, count = kind.partition("[")
            for _ in range(int(count.rstrip("]") or 1)):
                body += np.array(left.pop(0), NUMPY[base]).tobytes()
        out += message("D", body)
    again = io.BytesIO()
    ULog(io.BytesIO(out)).write_ulog(again)
    return again.getvalue()


# ---------------------------------------------------------------- text


def srt() -> bytes:
    """As a Mavic 3 writes it: an entry a frame at 30 Hz, positions new ten times a second."""
    out = []
    for i, m in enumerate(moments(30)):
        seen = Moment(math.floor(m.t * 10 + 1e-9) / 10)
        stamp = datetime.fromtimestamp(T0_S + m.t, UTC)
        roll, pitch, yaw = m.euler_deg
        out.append(
            f"{i + 1}\n{_clock(m.t)} --> {_clock(m.t + 1 / 30)}\n"
            f'<font size="28">FrameCnt: {i + 1}, DiffTime: 33ms\n'
            f"{stamp:%Y-%m-%d %H:%M:%S}.{stamp.microsecond // 1000:03d}\n"
            f"[iso: 100] [shutter: 1/640.0] [fnum: 2.8] [ev: 0] [focal_len: 24.00] [latitude: {seen.lat:.6f}] "
            f"[longitude: {LON:.6f}] [rel_alt: {ABOVE_M:.3f} abs_alt: {HOME_M + ABOVE_M:.3f}] [ct: 5200] "
            f"[drone_yaw: {yaw:.1f} drone_pitch: {pitch:.1f} drone_roll: {roll:.1f}] "
            f"[gb_yaw: 10.0 gb_pitch: -90.0 gb_roll: 0.0] </font>\n"
        )
    return "\n".join(out).encode()


def _clock(t: float) -> str:
    ms = round(t * 1000)
    return f"{ms // 3_600_000:02d}:{ms // 60_000 % 60:02d}:{ms // 1000 % 60:02d},{ms % 1000:03d}"


def table() -> bytes:
    rows = ["unix_time_s,lat_deg,lon_deg,height_amsl_m,height_above_home_m,velocity_north_m_s,velocity_east_m_s,"
            "velocity_down_m_s,roll_deg,pitch_deg,yaw_deg,rate_x_rad_s,rate_y_rad_s,rate_z_rad_s,sigma_horizontal_m,"
            "sigma_vertical_m,satellites,undulation_m"]  # fmt: skip
    for i, m in enumerate(moments(50)):
        place = f"{m.lat:.9f},{LON},{HOME_M + ABOVE_M},{ABOVE_M},{SPEED},0,0" if i % 5 == 0 else ",,,,,,"
        roll, pitch, yaw = m.euler_deg
        claim = "0.4,0.6,12,11" if i % 5 == 0 else ",,,"
        rows.append(f"{T0_S + m.t:.3f},{place},{roll:.6f},{pitch},{yaw},{m.roll_rate:.9f},0,0,{claim}")
    return "\n".join(rows).encode()


def airdata() -> bytes:
    """In feet, with the spaces that it has in its heads, and dates cut to the second."""
    rows = ["time(millisecond),datetime(utc),latitude,longitude,height_above_takeoff(feet),"
            "altitude_above_seaLevel(feet),satellites, compass_heading(degrees), pitch(degrees), roll(degrees),isVideo,"
            "gimbal_heading(degrees),gimbal_pitch(degrees),altitude(feet),message"]  # fmt: skip
    for m in moments(10):
        roll, pitch, yaw = m.euler_deg
        rows.append(
            f"{round(1000 * m.t)},{datetime.fromtimestamp(T0_S + m.t, UTC):%Y-%m-%d %H:%M:%S},{m.lat:.7f},{LON:.7f},"
            f"{ABOVE_M / FOOT_M:.4f},{(HOME_M + ABOVE_M) / FOOT_M:.4f},12,{yaw:.2f}, {pitch:.2f}, {roll:.2f},1,"
            f"10.0,-90.0,{ABOVE_M / FOOT_M:.4f},"
        )
    return "\n".join([*rows, ""]).encode()


def dji_record() -> bytes:
    """The record as Flight Reader writes it where commas are decimal: a line for spreadsheets, times of 12 hours."""
    rows = ["sep=;", "CUSTOM.date [local];CUSTOM.updateTime [local];OSD.flyTime;OSD.latitude;OSD.longitude;"
            "OSD.height [m];OSD.altitude [m];OSD.pitch;OSD.roll;OSD.yaw [360];OSD.gpsNum;GIMBAL.pitch;GIMBAL.roll;"
            "GIMBAL.yaw"]  # fmt: skip
    for m in moments(10):
        at = datetime.fromtimestamp(T0_S + m.t + LOCAL_AHEAD_S, UTC)
        roll, pitch, yaw = m.euler_deg
        numbers = f"{m.lat:.8f};{LON:.8f};{ABOVE_M};{HOME_M + ABOVE_M};{pitch};{roll:.3f};{yaw};12;-90.0;0.0;10.0"
        rows.append(
            f"{at.month}/{at.day}/{at.year};{at.hour % 12 or 12}:{at:%M:%S}.{at.microsecond // 10_000:02d} "
            f"{at:%p};0m 1s;{numbers.replace('.', ',')}"
        )
    return "\r\n".join([*rows, ""]).encode()


def skydio() -> bytes:
    rows = ["Timestamp,Latitude,Longitude,Altitude (ft MSL),Gimbal Pitch,Heading"]
    for m in moments(10):
        at = datetime.fromtimestamp(T0_S + m.t, UTC)
        rows.append(f"{at:%Y-%m-%dT%H:%M:%S}.{at.microsecond // 1000:03d}Z,{m.lat:.7f},{LON},"
                    f"{(HOME_M + ABOVE_M) / FOOT_M:.4f},-90,10")  # fmt: skip
    return "\n".join([*rows, ""]).encode()


def gpx() -> bytes:
    """With a place, a route and heights and times of other things, none of which are the track's."""
    head = ('<?xml version="1.0"?>\n<gpx version="1.1" xmlns="http://www.topografix.com/GPX/1/1"><metadata><time>'
            "2020-01-01T00:00:00Z</time></metadata><wpt lat='1' lon='2'><ele>3</ele></wpt><trk><trkseg>\n")  # fmt: skip
    points = [
        f'<trkpt lat="{m.lat:.8f}" lon="{LON}"><ele>{HOME_M + ABOVE_M}</ele><time>{_utc(m.t)}Z</time>'
        "<extensions><ele>7</ele><time>2001-01-01T00:00:00Z</time></extensions></trkpt>\n"
        for m in moments(10)
    ]
    return (head + "".join(points) + "</trkseg></trk></gpx>\n").encode()


def ass() -> bytes:
    """The subtitles as Autel writes them; the third number of GPS is no height."""
    rows = ["[Script Info]", "ScriptType: v4.00+", "", "[Events]",
            "Format: Layer, Start, End, Style, Name, MarginL, MarginR, MarginV, Effect, Text"]  # fmt: skip
    for m in moments(10):
        at = datetime.fromtimestamp(T0_S + m.t, UTC)
        begin, end = (_clock(t)[1:-1].replace(",", ".") for t in (m.t, m.t + 0.1))
        rows.append(
            f"Dialogue: 0,{begin},{end},Default,,0,0,0,,HOME(E: {LON:.4f}, S: {-LAT:.4f}) "
            f"{at.year}.{at.month}.{at.day} {at:%H:%M:%S}\\N"
            f"GPS(E: {LON:.7f}, S: {-m.lat:.7f}, 120) ReH:{ABOVE_M}\\NISO:100 SHUTTER:1000 EV:0 F-NUM:2.8"
        )
    return "\n".join([*rows, ""]).encode()


def nmea() -> bytes:
    out = []
    for m in moments(10):
        at = datetime.fromtimestamp(T0_S + m.t, UTC)
        time = f"{at:%H%M%S}.{at.microsecond // 10_000:02d}"
        south = f"{int(-m.lat)}{60 * (-m.lat % 1):09.6f}"
        east = f"{int(LON):03d}{60 * (LON % 1):09.6f}"
        for text in (
            f"GPRMC,{time},A,{south},S,{east},E,{SPEED / 0.514444444:.4f},0.0,{at:%d%m%y},,,A",
            f"GPGGA,{time},{south},S,{east},E,1,12,0.8,{HOME_M + ABOVE_M:.1f},M,11.0,M,,",
            f"GPGST,{time},1.0,,,,0.4,0.4,0.6",
        ):
            out.append(f"${text}*{functools.reduce(operator.xor, text.encode()):02X}\r\n")
    return "".join(out).encode()


def pos() -> bytes:
    rows = [
        "% program   : RTKPOST ver.2.4.3",
        "% (lat/lon/height=WGS84/ellipsoidal,Q=1:fix,2:float,5:single)",
        "%  GPST              latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)   sdu(m)",
    ]
    for m in moments(10):
        week, ms = gps_time(T0_S + m.t)
        at = datetime(1980, 1, 6, tzinfo=UTC) + timedelta(weeks=week, milliseconds=ms)
        rows.append(f"{at:%Y/%m/%d %H:%M:%S}.{at.microsecond // 1000:03d}  {m.lat:.9f}  {LON:.9f}  "
                    f"{HOME_M + ABOVE_M + 11.0:.4f}   5  12   0.4000   0.4000   0.6000")  # fmt: skip
    return "\n".join([*rows, ""]).encode()


def mrk() -> bytes:
    rows = []
    for i, m in enumerate(moments(10)):
        week, ms = gps_time(T0_S + m.t)
        rows.append(f"{i + 1}\t{ms / 1000:.6f}\t[{week}]\t   -9,N\t    12,E\t   193,V\t{m.lat:.8f},Lat\t{LON:.8f},Lon\t"
                    f"{HOME_M + ABOVE_M + 11.0:.3f},Ellh\t0.400, 0.400, 0.600\t16,Q")  # fmt: skip
    return "\n".join([*rows, ""]).encode()


def box(name: bytes, *content: bytes) -> bytes:
    return struct.pack(">I4s", 8 + len(b"".join(content)), name) + b"".join(content)


def track(
    handler: bytes, kind: bytes, samples: list[bytes], starts_s: list[float], begin: int, about: bytes,
    edits: bytes = b"", later_s: Sequence[float] = (),
) -> bytes:  # fmt: skip
    """A track whose samples lie one after the other from `begin` on; `about` describes them; `later_s` is by how
    much each is shown after it is decoded.
    """
    apart = [round(1000 * (b - a)) for a, b in itertools.pairwise([*starts_s, starts_s[-1] + 1.0])][: len(samples)]
    places = list(itertools.accumulate(map(len, samples), initial=begin))[: len(samples)]
    table = box(
        b"stbl", box(b"stsd", struct.pack(">4xI", 1), struct.pack(">I4s8x", 16 + len(about), kind) + about),
        box(b"stts", struct.pack(f">4xI{2 * len(apart)}I", len(apart), *(n for each in apart for n in (1, each)))),
        box(b"stsc", struct.pack(">4xI3I", 1, 1, 1, 1)),
        box(b"stsz", struct.pack(f">4xII{len(samples)}I", 0, len(samples), *map(len, samples))),
        box(b"stco", struct.pack(f">4xI{len(places)}I", len(places), *places)),
        box(b"ctts", struct.pack(">4xI", len(later_s)), *(struct.pack(">Ii", 1, round(1000 * t)) for t in later_s))
        if later_s else b"",
    )  # fmt: skip
    media = box(b"mdhd", struct.pack(">12xIIxxxx", 1000, 0)), box(b"hdlr", b"\0" * 8, handler, b"\0" * 13)
    return box(b"trak", edits, box(b"mdia", *media, box(b"minf", table)))


def mp4(
    kind: bytes, samples: list[bytes], starts_s: list[float], handler: bytes = b"meta", about: bytes = b"",
    of_video: bytes = b"", of_track: bytes = b"",
) -> bytes:  # fmt: skip
    """A container with one track besides a video's empty one; what describes it stands before the content."""

    def head(begin: int) -> bytes:
        more = track(handler, kind, samples, starts_s, begin, about, of_track)
        movie = box(b"mvhd", struct.pack(">12xI84x", 1000)), track(b"vide", b"avc1", [], [0.0], 0, b"", of_video)
        return box(b"ftyp", b"mp42\0\0\0\0") + box(b"moov", *movie, more)

    return head(len(head(0)) + 8) + box(b"mdat", *samples)


def with_track(video: Path, kind: bytes, samples: list[bytes], starts_s: list[float], about: bytes = b"") -> None:
    """Into a video of OpenCV's, whose tables stand last, another track."""
    data = video.read_bytes()
    at = data.rindex(b"moov") - 4
    length = len(track(b"meta", kind, samples, starts_s, 0, about))
    more = track(b"meta", kind, samples, starts_s, len(data) + length + 8, about)
    video.write_bytes(data[:at] + box(b"moov", data[at + 8 :], more) + box(b"mdat", *samples))


def gpmf(key: bytes, kind: bytes, size: int, content: bytes) -> bytes:
    count = len(content) // size
    return struct.pack(">4scBH", key, kind, size, count) + content + bytes(-len(content) % 4)


def gopro_seconds() -> tuple[list[bytes], list[float]]:
    """The samples as a Hero 13 writes them: ten positions a second, each with its time; and when each second begins."""
    samples, starts_s, every = [], [], list(moments(10))
    for second in (every[k : k + 10] for k in range(0, len(every), 10)):
        nine = b"".join(
            struct.pack(
                ">7i2H", round(m.lat * 1e7), round(LON * 1e7), round(1000 * (HOME_M + ABOVE_M + 11.0)), 20_000, 2000,
                *divmod(round(1000 * (T0_S + m.t - 946_684_800)), 86_400_000), 100, 3,
            )
            for m in second
        )  # fmt: skip
        scales = struct.pack(">9i", 10**7, 10**7, 1000, 1000, 100, 1, 1000, 100, 1)
        stream = gpmf(b"SCAL", b"l", 4, scales) + gpmf(b"TYPE", b"c", 1, b"lllllllSS") + gpmf(b"GPS9", b"?", 32, nine)
        samples.append(gpmf(b"DEVC", b"\0", 1, gpmf(b"DVID", b"L", 4, bytes(4)) + gpmf(b"STRM", b"\0", 1, stream)))
        starts_s.append(second[0].t)
    return samples, starts_s


def gopro() -> bytes:
    return mp4(b"gpmd", *gopro_seconds())


# ---------------------------------------------------------------- MISB ST 0601 in a transport stream

MISB_KEY = bytes.fromhex("060e2b34020b01010e01030101000000")
VIDEO_PID, METADATA_PID, MAP_PID = 0x100, 0x101, 0x1000


def mapped(value: float, low: float, high: float, size: int) -> bytes:
    """A value on the range of an integer of so many bytes; of a symmetric one the integer is signed."""
    if low == -high:
        return round(value / high * ((1 << 8 * size - 1) - 1)).to_bytes(size, "big", signed=True)
    return round((value - low) / (high - low) * ((1 << 8 * size) - 1)).to_bytes(size, "big")


def misb_set(items: dict[int, bytes]) -> bytes:
    """A set with its checksum; items above 127 have numbers of two bytes."""
    numbers = {item: bytes([item]) if item < 128 else bytes([0x80 | item >> 7, item & 0x7F]) for item in items}
    body = b"".join(numbers[item] + bytes([len(value)]) + value for item, value in items.items()) + b"\x01\x02"
    whole = MISB_KEY + bytes([0x81, len(body) + 2]) + body
    return whole + (sum(byte << 8 * ((k + 1) % 2) for k, byte in enumerate(whole)) % 0x10000).to_bytes(2, "big")


def misb_items(m: Moment, gimbal_deg: tuple[float, float, float] = (0.0, -90.0, 10.0)) -> dict[int, bytes]:
    """Where the flight is, how it is turned, and the camera against it."""
    roll, pitch, heading = m.euler_deg
    R = matrix_from_euler(*np.radians(m.euler_deg)).T @ matrix_from_euler(*np.radians(gimbal_deg))
    turn, elevation, azimuth = np.degrees(euler_from_matrix(R)).tolist()
    return {
        2: round((T0_S + m.t) * 1e6).to_bytes(8, "big"),
        5: mapped(heading, 0.0, 360.0, 2), 13: mapped(m.lat, -90.0, 90.0, 4), 14: mapped(LON, -180.0, 180.0, 4),
        15: mapped(HOME_M + ABOVE_M, -900.0, 19000.0, 2), 16: mapped(60.0, 0.0, 180.0, 2),
        18: mapped(azimuth % 360.0, 0.0, 360.0, 4), 19: mapped(elevation, -180.0, 180.0, 4),
        20: mapped(turn % 360.0, 0.0, 360.0, 4), 79: mapped(SPEED, -327.0, 327.0, 2), 80: mapped(0.0, -327.0, 327.0, 2),
        90: mapped(pitch, -90.0, 90.0, 4), 91: mapped(roll, -90.0, 90.0, 4), 136: b"\x00",
    }  # fmt: skip


def ticks(pts: int) -> bytes:
    """A time of a packet, in its 5 bytes."""
    return bytes([0x21 | pts >> 29 & 0xE, pts >> 22 & 0xFF, pts >> 14 & 0xFE | 1, pts >> 7 & 0xFF, pts << 1 & 0xFE | 1])


def own_packet(stream: int, content: bytes, time_s: float | None) -> bytes:
    """A packet of one stream (PES), with its time or without."""
    head = b"\x80\x00\x00" if time_s is None else b"\x80\x80\x05" + ticks(round((time_s + 1.4) * 90_000) % 2**33)
    return b"\x00\x00\x01" + struct.pack(">BH", stream, len(head) + len(content)) + head + content


def in_packets(pid: int, content: bytes) -> bytes:
    """Packets of a transport stream, the last of them filled up by its adaptation field."""
    out = b""
    for at in range(0, len(content), 184):
        part = content[at : at + 184]
        spare = 184 - len(part)
        field = b"" if not spare else bytes([spare - 1]) + (b"\x00" + b"\xff" * (spare - 2) if spare > 1 else b"")
        out += struct.pack(">BHB", 0x47, 0x4000 * (not at) | pid, 0x30 if spare else 0x10) + field + part
    return out


def in_table(pid: int, section: bytes) -> bytes:
    """A table in one packet; its checksum as ISO 13818-1 has it."""
    crc = 0xFFFFFFFF
    for byte in section:
        crc ^= byte << 24
        for _ in range(8):
            crc = (crc << 1 ^ (0x04C11DB7 if crc >> 31 else 0)) & 0xFFFFFFFF
    whole = b"\x00" + section + struct.pack(">I", crc)
    return struct.pack(">BHB", 0x47, 0x4000 | pid, 0x10) + whole.ljust(184, b"\xff")


def map_of_streams(video_kind: int, kind: int = 0x15) -> bytes:
    """The packet that states the streams of the programme: the pictures and the metadata."""
    described = b"\x05\x04KLVA" if kind == 0x06 else b""
    rows = struct.pack(">BHH", video_kind, 0xE000 | VIDEO_PID, 0xF000)
    rows += struct.pack(">BHH", kind, 0xE000 | METADATA_PID, 0xF000 | len(described)) + described
    section = struct.pack(">HBBBHH", 1, 0xC1, 0, 0, 0xE000 | VIDEO_PID, 0xF000) + rows
    return in_table(MAP_PID, struct.pack(">BH", 2, 0xB000 | len(section) + 4) + section)


PROGRAMMES = in_table(0, struct.pack(">BHHBBBHH", 0, 0xB00D, 1, 0xC1, 0, 0, 1, 0xE000 | MAP_PID))


def metadata_packets(content: bytes, time_s: float | None) -> bytes:
    """A set as its stream has it: with a time in a cell of its own, or bare."""
    cell = b"" if time_s is None else struct.pack(">BBBH", 0, 0, 0xDF, len(content))
    return in_packets(METADATA_PID, own_packet(0xBD if time_s is None else 0xFC, cell + content, time_s))


def misb() -> bytes:
    """Ten sets a second between pictures that are nothing but their times."""
    out = PROGRAMMES + map_of_streams(0x1B)
    for m in moments(10):
        out += in_packets(VIDEO_PID, own_packet(0xE0, bytes(300), m.t))
        out += metadata_packets(misb_set(misb_items(m)), m.t)
    return out


def _utc(t: float) -> str:
    at = datetime.fromtimestamp(T0_S + t, UTC)
    return f"{at:%Y-%m-%dT%H:%M:%S}.{at.microsecond // 1000:03d}"


WRITERS: dict[str, Callable[[], bytes]] = {
    "tlog": tlog, "bin": dataflash, "ulg": ulog, "srt": srt, "csv": table, "airdata": airdata, "dji": dji_record,
    "skydio": skydio, "gpx": gpx, "ass": ass, "nmea": nmea, "pos": pos, "mrk": mrk, "mp4": gopro,
    "ts": misb,
}  # fmt: skip


def written(folder: Path, kind: str, name: str | None = None) -> Path:
    path = folder / (name or f"flight.{kind}")
    path.write_bytes(WRITERS[kind]())
    return path
