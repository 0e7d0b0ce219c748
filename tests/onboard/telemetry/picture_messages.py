"""Videos with the messages of ArduPilot's camera application in each picture, as its documentation has them."""

import json
import math
from typing import Any

from onboard.telemetry.picture_telemetry import MARK
from tests.onboard.telemetry.log_writers import ABOVE_M, HOME_M, LON, SPEED, T0_S, Moment, box

RATE_HZ, SECONDS = 25, 4
POSITION_HZ, AGE_S = 10, 0.03  # of the autopilot's messages, and how old the newest of them is at least
FROM_NOSE_DEG = 25.0


def snapshot(t: float, ticks: int | None = None) -> dict[str, Any]:
    """The message of the picture at `t`: the newest values, each with its age."""
    at = math.floor((t - AGE_S) * POSITION_HZ) / POSITION_HZ
    age_ms, m = round(1000 * (t - at)), Moment(at)
    roll, pitch, yaw = (math.radians(angle) for angle in m.euler_deg)
    return {
        "schema": "apcg.telemetry.v1", "pts90k": round(90_000 * t) if ticks is None else ticks,
        "utc_us": round((T0_S + t) * 1e6),
        "position": {
            "lat_e7": round(m.lat * 1e7), "lon_e7": round(LON * 1e7), "alt_amsl_m": HOME_M + ABOVE_M,
            "alt_relative_m": ABOVE_M, "age_ms": age_ms,
        },
        "velocity": {"vn_m_s": SPEED, "ve_m_s": 0.0, "vd_m_s": 0.5, "age_ms": age_ms},
        "vehicle_attitude": {"roll_rad": roll, "pitch_rad": pitch, "yaw_rad": yaw, "age_ms": age_ms},
        "gimbal_attitude": {
            "roll_rad": 0.0, "pitch_rad": -1.2, "yaw_rad": math.radians(FROM_NOSE_DEG), "age_ms": 0,
        },
        "heading_rad": yaw, "zoom": 1.0, "hfov_deg": 60.0,
    }  # fmt: skip


def message(content: Any) -> bytes:
    text = content if isinstance(content, bytes) else json.dumps(content, separators=(",", ":")).encode()
    return b"\0\0\0\x01\x06\x05\xff\xff" + MARK + text + b"\x80" + bytes(100)


def video(*contents: Any) -> bytes:
    return box(b"ftyp", b"isom\0\0\0\0") + b"".join(
        box(b"moof", bytes(8)) + box(b"mdat", message(content)) for content in contents
    )
