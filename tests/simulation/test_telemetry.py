"""The log that described flights write: readable, on one clock, with the errors asked for and no others."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pymavlink import mavutil

from contract.geodesy import LocalFrame
from contract.rotations import R_ENU_NED, log_so3, matrix_from_euler, matrix_from_quaternion
from simulation.flight import least_delay_s
from simulation.paths import PathSpec, fly_path
from simulation.telemetry import TelemetrySpec, write_tlog
from simulation.trajectory import Trajectory

pytestmark = pytest.mark.xdist_group("telemetry")  # one worker: what they share is made once

ORIGIN = LocalFrame(-43.38, 172.4, 111.0)
UNDULATION_M = 11.0
PERFECT = TelemetrySpec(
    white_horizontal_m=0.0,
    white_vertical_m=0.0,
    slow_horizontal_m=0.0,
    slow_vertical_m=0.0,
    velocity_m_s=0.0,
    white_attitude_deg=0.0,
    slow_attitude_deg=0.0,
    gps_age_s=0.0,
    attitude_message="both",
)


@pytest.fixture(scope="module")
def turning() -> Trajectory:
    return fly_path(PathSpec("turns", leg_m=150.0, crab_deg=12.0), 30.0, seed=2)


def _read(log: bytes, folder: Path, kind: str) -> list:
    path = folder / "log.tlog"
    path.write_bytes(log)
    reader = mavutil.mavlink_connection(str(path))
    messages = []
    while (message := reader.recv_match(type=kind)) is not None:
        messages.append(message)
    return messages


def test_positions_without_errors_are_the_truth_at_their_stamps(turning: Trajectory, tmp_path: Path) -> None:
    log, epoch = write_tlog(turning, ORIGIN, UNDULATION_M, PERFECT, seed=1)
    offset = least_delay_s(log) - epoch
    messages = _read(log, tmp_path, "GLOBAL_POSITION_INT")
    time = np.array([m.time_boot_ms * 1e-3 for m in messages]) + offset
    enu = ORIGIN.to_enu(
        [m.lat * 1e-7 for m in messages],
        [m.lon * 1e-7 for m in messages],
        [m.alt * 1e-3 + UNDULATION_M for m in messages],
    )
    assert 10.0 * 40.0 * 0.98 < len(messages) < 10.0 * 40.0 * 1.02
    assert np.abs(enu - turning.position_enu_m(time)).max() < 0.02
    velocity = np.array([(m.vy, m.vx, -m.vz) for m in messages]) * 0.01
    assert np.abs(velocity - turning.velocity_enu_m_s(time)).max() < 0.02
    assert np.abs([m.relative_alt * 1e-3 - e for m, e in zip(messages, enu[:, 2], strict=True)]).max() < 0.1


def test_both_attitude_messages_tell_the_true_attitude(turning: Trajectory, tmp_path: Path) -> None:
    log, epoch = write_tlog(turning, ORIGIN, UNDULATION_M, PERFECT, seed=1)
    offset = least_delay_s(log) - epoch
    for kind in ("ATTITUDE", "ATTITUDE_QUATERNION"):
        messages = _read(log, tmp_path, kind)
        if kind == "ATTITUDE":
            R = matrix_from_euler(*np.array([(m.roll, m.pitch, m.yaw) for m in messages]).T)
        else:
            R = matrix_from_quaternion([(m.q1, m.q2, m.q3, m.q4) for m in messages])
        time = np.array([m.time_boot_ms * 1e-3 for m in messages]) + offset
        wrong = log_so3(turning.R_enu_body(time).swapaxes(1, 2) @ R_ENU_NED @ R)
        # Axes at the vehicle turn against the origin's by 0.01 degree a kilometre.
        assert np.degrees(np.linalg.norm(wrong, axis=1)).max() < 0.02


def test_gps_carries_both_heights_and_its_own_accuracy(turning: Trajectory, tmp_path: Path) -> None:
    spec = replace(PERFECT, slow_horizontal_m=1.5, slow_vertical_m=2.5)
    log, _ = write_tlog(turning, ORIGIN, UNDULATION_M, spec, seed=1)
    for message in _read(log, tmp_path, "GPS_RAW_INT"):
        assert message.alt_ellipsoid - message.alt == pytest.approx(1e3 * UNDULATION_M, abs=1)
        assert (message.h_acc, message.v_acc, message.fix_type) == (1500, 2500, 3)


def test_position_errors_have_the_size_and_the_memory_asked_for(tmp_path: Path) -> None:
    path = fly_path(PathSpec("straight"), 900.0, seed=1)
    spec = replace(PERFECT, slow_horizontal_m=2.0, slow_time_constant_s=10.0, white_horizontal_m=0.3, attitude_hz=0.0)
    log, epoch = write_tlog(path, ORIGIN, UNDULATION_M, spec, seed=4)
    messages = _read(log, tmp_path, "GLOBAL_POSITION_INT")
    time = np.array([m.time_boot_ms * 1e-3 for m in messages]) + least_delay_s(log) - epoch
    enu = ORIGIN.to_enu(
        [m.lat * 1e-7 for m in messages],
        [m.lon * 1e-7 for m in messages],
        [m.alt * 1e-3 + UNDULATION_M for m in messages],
    )
    error = (enu - path.position_enu_m(time))[:, :2]
    assert 1.5 < error.std() < 2.6
    assert 0.27 < np.diff(error, axis=0).std() / np.sqrt(2.0) < 0.45
    later = np.mean(error[100:] * error[:-100]) / error.var()
    assert 0.15 < later < 0.6  # exp(-1) after one time constant


def test_an_aged_position_is_where_the_vehicle_was(turning: Trajectory, tmp_path: Path) -> None:
    log, epoch = write_tlog(turning, ORIGIN, UNDULATION_M, replace(PERFECT, position_age_s=0.2), seed=1)
    message = _read(log, tmp_path, "GLOBAL_POSITION_INT")[150]
    time = message.time_boot_ms * 1e-3 + least_delay_s(log) - epoch
    reported = ORIGIN.to_enu(message.lat * 1e-7, message.lon * 1e-7, message.alt * 1e-3 + UNDULATION_M)
    assert np.linalg.norm(reported - turning.position_enu_m(time - 0.2)) < 0.02
    assert 3.5 < np.linalg.norm(reported - turning.position_enu_m(time)) < 4.5


def test_packets_arrive_in_order_and_never_before_they_were_sent(turning: Trajectory, tmp_path: Path) -> None:
    spec = replace(PERFECT, latency_s=0.05, jitter_s=0.1)
    log, _ = write_tlog(turning, ORIGIN, UNDULATION_M, spec, seed=1)
    offset = least_delay_s(log)
    messages = _read(log, tmp_path, "ATTITUDE")
    arrival = np.array([m._timestamp for m in messages])
    delay = arrival - offset - np.array([m.time_boot_ms * 1e-3 for m in messages])
    assert np.all(np.diff(arrival) >= 0.0)
    assert delay.min() > -1e-6
    assert 0.05 < delay.mean() < 1.0


def test_the_same_seed_writes_the_same_bytes_and_another_does_not(turning: Trajectory) -> None:
    first, again, other = (write_tlog(turning, ORIGIN, 11.0, TelemetrySpec(), seed)[0] for seed in (1, 1, 2))
    assert first == again
    assert first != other
