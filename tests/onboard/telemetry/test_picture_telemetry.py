"""The telemetry that ArduPilot's camera application has in each picture of a video."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from contract.errors import InputError
from contract.rotations import euler_from_matrix, matrix_from_quaternion
from onboard.events.types import Attitude, GimbalAttitude, PositionFix
from onboard.telemetry.log_files import read_log
from onboard.telemetry.telemetry_log import TelemetryLog
from onboard.telemetry.video_reader import has_telemetry
from tests.onboard.telemetry.log_events import of
from tests.onboard.telemetry.log_writers import ABOVE_M, HOME_M, METRES_A_DEGREE, SPEED, T0_S, Moment
from tests.onboard.telemetry.picture_messages import FROM_NOSE_DEG, POSITION_HZ, RATE_HZ, SECONDS, snapshot, video


def read(tmp_path: Path, *contents: Any) -> TelemetryLog:
    (tmp_path / "rec_A.mp4").write_bytes(video(*contents))
    return read_log(tmp_path / "rec_A.mp4")


def moments() -> list[float]:
    return [k / RATE_HZ for k in range(RATE_HZ * SECONDS)]


def test_each_value_counts_once_and_at_its_own_moment(tmp_path: Path) -> None:
    log = read(tmp_path, *map(snapshot, moments()))
    assert has_telemetry(tmp_path / "rec_A.mp4")
    fixes, attitudes = of(log, PositionFix), of(log, Attitude)
    for found in (fixes, attitudes):
        assert POSITION_HZ * SECONDS - 1 <= len(found) <= POSITION_HZ * SECONDS + 1
    for fix in fixes:
        t = fix.stamp_ns / 1e9 - T0_S
        assert abs(fix.lat_deg - Moment(t).lat) * METRES_A_DEGREE < 0.03
        assert (fix.height_amsl_m, fix.height_above_home_m) == (HOME_M + ABOVE_M, ABOVE_M)
        assert fix.velocity_ned_m_s == (SPEED, 0.0, 0.5)
    for attitude in attitudes:
        t = attitude.stamp_ns / 1e9 - T0_S
        angles = np.degrees(euler_from_matrix(matrix_from_quaternion(attitude.q_ned_body)))
        assert angles == pytest.approx(Moment(t).euler_deg, abs=0.01)
    assert log.utc_sigma_s == 1.0 and [mm for _, mm in log.focal_mm] == pytest.approx(
        [18.0 / math.tan(math.pi / 6)], rel=1e-3
    )


def test_the_camera_looks_by_the_horizon_and_the_aircraft_s_nose(tmp_path: Path) -> None:
    gimbal = of(read(tmp_path, *map(snapshot, moments())), GimbalAttitude)
    assert len(gimbal) == RATE_HZ * SECONDS
    for each in gimbal:
        assert each.is_of_camera and each.reference == "earth"
        roll, pitch, yaw = np.degrees(euler_from_matrix(matrix_from_quaternion(each.q_ref_gimbal)))
        assert [roll, pitch, yaw] == pytest.approx([0.0, math.degrees(-1.2), 10.0 + FROM_NOSE_DEG], abs=0.01)


def test_between_two_looks_at_the_compass_the_nose_turns_on(tmp_path: Path) -> None:
    content = snapshot(1.0)
    content["vehicle_attitude"] |= {"yaw_rate_rad_s": 0.5, "age_ms": 200}
    (gimbal,) = of(read(tmp_path, content), GimbalAttitude)
    yaw = np.degrees(euler_from_matrix(matrix_from_quaternion(gimbal.q_ref_gimbal)))[2]
    assert yaw == pytest.approx(10.0 + FROM_NOSE_DEG + math.degrees(0.1), abs=0.01)


def test_who_hovers_still_has_an_attitude_all_the_time(tmp_path: Path) -> None:
    still = [snapshot(t) | {name: snapshot(0.5)[name] | {"age_ms": 10} for name in ("position", "vehicle_attitude")}
             for t in moments()]  # fmt: skip
    log = read(tmp_path, *still)
    assert np.diff([event.stamp_ns for event in of(log, Attitude)]).max() <= 40_000_001
    assert np.diff([event.stamp_ns for event in of(log, PositionFix)]).max() <= 1_040_000_000


@pytest.mark.parametrize("first", [0, 123_456, 2**32 - 90_000])
def test_the_video_begins_with_its_first_picture_wherever_its_times_count_from(tmp_path: Path, first: int) -> None:
    """Of a recorded stream they count from anywhere and begin again after 2^32 ticks."""
    log = read(tmp_path, *(snapshot(t, (first + round(90_000 * t)) % 2**32) for t in moments()))
    assert log.video_began is not None
    assert abs(log.video_began[0] - round(T0_S * 1e9)) < 2e6 and log.video_began[1] == 0.5


@pytest.mark.parametrize(
    "damage",
    [
        {"position": None}, {"position": {"lat_e7": True, "lon_e7": 0, "alt_amsl_m": 1.0, "age_ms": 1}},
        {"position": snapshot(0.0)["position"] | {"lat_e7": 10**12}},
        {"position": snapshot(0.0)["position"] | {"age_ms": -5}}, {"position": [1, 2]},
        {"utc_us": 12}, {"utc_us": None}, {"schema": "apcg.thermal.v1"},
    ],
)  # fmt: skip
def test_what_cannot_be_is_left_out(tmp_path: Path, damage: dict[str, Any]) -> None:
    log = read(tmp_path, snapshot(0.0), snapshot(1.0) | damage, snapshot(2.0))
    assert [round((fix.stamp_ns / 1e9 - T0_S), 1) for fix in of(log, PositionFix)] == [-0.1, 1.9]


@pytest.mark.parametrize("damage", [b"{", b'{"utc_us":1e400}', b"[" * 4000, b"\xff\xfe", b"", b"NaN", b'"x"'])
def test_a_damaged_message_costs_only_itself(tmp_path: Path, damage: bytes) -> None:
    log = read(tmp_path, snapshot(0.0), damage, snapshot(2.0))
    assert len(of(log, PositionFix)) == 2


def test_without_an_autopilot_it_is_refused_in_a_line(tmp_path: Path) -> None:
    nothing = snapshot(0.0) | {"position": None, "vehicle_attitude": None}
    with pytest.raises(InputError, match=r"rec_A\.mp4: a video: none of its 2 messages \(SEI\) has a position"):
        read(tmp_path, nothing, nothing)
