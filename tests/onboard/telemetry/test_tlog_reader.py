"""Telemetry logs: what is read, whose, on which clock, and what damage costs."""

import math
import random
import struct
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from contract.errors import InputError
from onboard.events.types import Attitude, GpsQuality, PositionFix
from onboard.telemetry.log_files import read_log
from onboard.telemetry.read_options import ReadOptions
from onboard.telemetry.tlog_reader import read_tlog
from tests.onboard.telemetry.log_events import of
from tests.recorded_logs import recorded

T0_US = 1_795_217_000_000_000
BOOT_MS = 60_000


class Log:
    def __init__(self) -> None:
        self.data = b""

    def add(self, seconds: float, message: Any, system: int = 1, component: int = 1, delay_s: float = 0.01) -> None:
        packer = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)
        self.data += struct.pack(">Q", T0_US + round((seconds + delay_s) * 1e6)) + message.pack(packer)

    def save(self, folder: Path) -> Path:
        path = folder / "flight.tlog"
        path.write_bytes(self.data)
        return path


def boot_ms(seconds: float) -> int:
    return BOOT_MS + round(seconds * 1000)


def heartbeat(autopilot: int = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA) -> Any:
    return mavlink.MAVLink_heartbeat_message(1, autopilot, 0, 0, 4, 3)


def position(t: float, lat_e7: int = -433_800_000) -> Any:
    return mavlink.MAVLink_global_position_int_message(
        boot_ms(t), lat_e7, 1_724_000_000, 350_000, 250_000, 1900, -100, 50, 9000
    )


def attitude(t: float, yaw: float = 0.5) -> Any:
    return mavlink.MAVLink_attitude_message(boot_ms(t), 0.1, -0.05, yaw, 0, 0, 0)


def quaternion(t: float) -> Any:
    return mavlink.MAVLink_attitude_quaternion_message(boot_ms(t), 0.9, 0.1, 0.2, 0.3, 0, 0, 0)


def gps(t: float, fix_type: int = 3, moving: bool = True, ellipsoid_mm: int = 360_500, **claims: int) -> Any:
    return mavlink.MAVLink_gps_raw_int_message(
        boot_ms(t if moving else 0.0) * 1000, fix_type, -433_800_000, 1_724_000_000, 350_000, 121, 200, 2000, 9000, 10,
        ellipsoid_mm, claims.get("h_acc", 300), claims.get("v_acc", 400), claims.get("vel_acc", 0), 0, 0,
    )  # fmt: skip


def flight(seconds: float = 10.0) -> Log:
    log = Log()
    for i in range(round(seconds * 10)):
        t = i / 10
        if i % 10 == 0:
            log.add(t, heartbeat())
        log.add(t, attitude(t))
        log.add(t, position(t))
        log.add(t, gps(t))
    return log


def test_messages_become_events_in_si_units_on_the_log_s_clock(tmp_path: Path) -> None:
    log = read_tlog(flight().save(tmp_path))
    fix, q, a = of(log, PositionFix)[10], of(log, GpsQuality)[10], of(log, Attitude)[10]
    stamp = (T0_US + 1_010_000) * 1000  # boot time 1 s in, plus the delay every message had
    assert fix == PositionFix(stamp, -43.38, 172.4, 350.0, (19.0, -1.0, 0.5), 250.0)
    assert q.fix.velocity_ned_m_s == pytest.approx((0.0, 20.0, math.nan), abs=1e-9, nan_ok=True)
    assert q.fix == PositionFix(stamp, -43.38, 172.4, 350.0, q.fix.velocity_ned_m_s)
    assert q == GpsQuality(stamp, 3, 10, 0.3, 0.4, None, 10.5, fix=q.fix)
    assert a.stamp_ns == stamp
    assert a.q_ned_body == pytest.approx((0.966, 0.0546, -0.0119, 0.2482), abs=2e-3)
    assert log.arrival_ns == sorted(log.arrival_ns)
    assert len(log.arrival_ns) == len(log.events) == 300


def test_an_unset_ellipsoidal_height_is_no_undulation(tmp_path: Path) -> None:
    log = flight()
    log.add(10.0, gps(10.0, ellipsoid_mm=0, h_acc=0))
    last = of(read_tlog(log.save(tmp_path)), GpsQuality)[-1]
    assert last.undulation_m is None
    assert last.sigma_horizontal_m is None


def test_arrival_jitter_does_not_reach_the_stamps(tmp_path: Path) -> None:
    log, rng = Log(), random.Random(1)
    for i in range(300):
        log.add(i / 10, position(i / 10), delay_s=0.002 + rng.random() ** 3 * 0.3)
    stamps = [event.stamp_ns for event in of(read_tlog(log.save(tmp_path)), PositionFix)]
    worst_ms = max(abs(stamp / 1e6 - T0_US / 1e3 - 100 * i) for i, stamp in enumerate(stamps))
    assert 0.0 < worst_ms < 5.0


def test_other_vehicles_and_ground_stations_are_ignored(tmp_path: Path) -> None:
    log = flight()
    for i in range(100):
        log.add(i / 10, heartbeat(mavlink.MAV_AUTOPILOT_INVALID), system=255, component=190)
        log.add(i / 10, position(i / 10, lat_e7=10), system=7)
        log.add(i / 10, position(i / 10, lat_e7=20), system=1, component=100)
    log.add(9.9, heartbeat(), system=7)
    read = read_tlog(log.save(tmp_path))
    assert read.system == 1
    assert {fix.lat_deg for fix in of(read, PositionFix)} == {-43.38}


def test_of_two_vehicles_in_a_log_none_is_read_until_one_is_chosen(tmp_path: Path) -> None:
    log = flight()
    for i in range(10):
        log.add(float(i), heartbeat(mavlink.MAV_AUTOPILOT_PX4), system=7)
        log.add(float(i), position(float(i), lat_e7=10), system=7)
    path = log.save(tmp_path)
    with pytest.raises(
        InputError, match=r"several vehicles in it \(1 ArduPilot fixed wing, 7 PX4 fixed wing\): set telemetry.system"
    ):
        read_log(path)
    assert {fix.lat_deg for fix in of(read_log(path, ReadOptions(system=1)), PositionFix)} == {-43.38}
    assert {fix.lat_deg for fix in of(read_log(path, ReadOptions(system=7)), PositionFix)} == {1e-6}
    with pytest.raises(InputError, match=r"no messages of system 3 \(but of 1, 7\)"):
        read_log(path, ReadOptions(system=3))


def test_the_attitude_message_with_the_higher_rate_serves_alone(tmp_path: Path) -> None:
    log = flight()
    for i in range(500):
        log.add(i / 50, quaternion(i / 50))
    attitudes = of(read_tlog(log.save(tmp_path)), Attitude)
    assert len(attitudes) == 500
    assert sum(part * part for part in attitudes[0].q_ned_body) == pytest.approx(1.0)


def test_without_filter_positions_the_receiver_s_serve(tmp_path: Path) -> None:
    log = Log()
    for i in range(50):
        log.add(i / 5, attitude(i / 5))
        log.add(i / 5, gps(i / 5))
    log.add(10.0, gps(10.0, fix_type=1))
    fixes = of(read_tlog(log.save(tmp_path)), PositionFix)
    assert len(fixes) == 50
    north, east, down = fixes[0].velocity_ned_m_s
    assert (north, east) == pytest.approx((0.0, 20.0))
    assert math.isnan(down)


def test_a_frozen_receiver_is_reported_as_having_no_fix(tmp_path: Path) -> None:
    log = flight()
    for i in range(100, 160):
        log.add(i / 10, position(i / 10))
        log.add(i / 10, gps(i / 10, moving=False))
    fixes = [(q.stamp_ns / 1e9 - T0_US / 1e6, q.fix_type) for q in of(read_tlog(log.save(tmp_path)), GpsQuality)]
    assert all(kind == 3 for t, kind in fixes if t < 11.9)
    assert all(kind == 0 for t, kind in fixes if t > 12.2)


def test_a_reboot_is_followed(tmp_path: Path) -> None:
    log = flight()
    for i in range(100):
        t = 30.0 + i / 10
        log.add(t, position(i / 10 - 50.0))
    read = read_tlog(log.save(tmp_path))
    assert read.boot_segments == 2
    assert of(read, PositionFix)[-1].stamp_ns / 1e9 - T0_US / 1e6 == pytest.approx(39.91, abs=0.005)


def test_positions_before_the_filter_has_an_origin_are_dropped(tmp_path: Path) -> None:
    log = Log()
    log.add(0.0, mavlink.MAVLink_global_position_int_message(boot_ms(0), 0, 0, 0, 0, 0, 0, 0, 0))
    log.add(0.5, position(0.5))
    assert len(of(read_tlog(log.save(tmp_path)), PositionFix)) == 1


@given(
    cut=st.integers(1, 20_000),
    noise=st.lists(st.tuples(st.integers(0, 20_000), st.binary(min_size=1, max_size=80)), max_size=4),
    overwrite=st.booleans(),
)
def test_damage_costs_only_what_it_touches(
    tmp_path_factory: pytest.TempPathFactory, cut: int, noise: list[tuple[int, bytes]], overwrite: bool
) -> None:
    whole = bytearray(CLEAN.data)
    for place, junk in noise:
        start = place % len(whole)
        whole[start : start + (len(junk) if overwrite else 0)] = junk
    path = tmp_path_factory.mktemp("damage") / "flight.tlog"
    path.write_bytes(bytes(whole[: max(len(whole) - cut % 200, 1)]))
    read = read_tlog(path)
    good = [event for event in of(read, PositionFix) if event.lat_deg == -43.38]
    assert len(good) == len(of(read, PositionFix))
    assert len(good) >= 100 - 3 * sum(2 + len(junk) // 40 for _, junk in noise) - 4


CLEAN = flight()


def test_a_wrong_arrival_stamp_loses_one_message(tmp_path: Path) -> None:
    log = flight(5.0)
    log.add(1e9, position(5.0))
    for i in range(51, 100):
        log.add(i / 10, position(i / 10))
    read = read_tlog(log.save(tmp_path))
    assert read.boot_segments == 1
    assert len(of(read, PositionFix)) == 99


def test_a_log_without_positions_is_refused(tmp_path: Path) -> None:
    log = Log()
    log.add(0.0, heartbeat())
    log.add(0.1, attitude(0.1))
    with pytest.raises(InputError, match="sends no position"):
        read_tlog(log.save(tmp_path))


@pytest.mark.xdist_group("recorded logs")
@pytest.mark.parametrize(
    ("name", "positions", "attitudes"),
    [
        pytest.param("sitl/plane_clean.tlog", (4700, 4729), (23600, 23624), marks=pytest.mark.long),
        ("cmac_2018/telemetry.tlog", (670, 676), (600, 604)),
    ],
)
def test_recorded_logs_are_read_whole(
    shared_data: Path, name: str, positions: tuple[int, int], attitudes: tuple[int, int]
) -> None:
    log = recorded(shared_data / name)
    assert positions[0] <= len(of(log, PositionFix)) <= positions[1]
    assert attitudes[0] <= len(of(log, Attitude)) <= attitudes[1]
    assert log.boot_segments == 1
    late = [arrival - event.stamp_ns for event, arrival in zip(log.events, log.arrival_ns, strict=True)]
    assert 0 <= min(late) < 5e6
