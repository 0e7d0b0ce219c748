"""Gimbals on a MAVLink line: whose attitude counts, on which clock, and what becomes of silence and damage."""

import math
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from contract.rotations import matrix_from_euler, matrix_from_quaternion, quaternion_from_matrix
from onboard.config.schema import parse_config
from onboard.events.source import State
from onboard.events.types import GimbalAttitude, Zoom
from onboard.telemetry.mavlink_framing import Framer, SequenceGaps
from onboard.telemetry.mavlink_session import Autopilot
from onboard.telemetry.tlog_reader import read_tlog
from tests.onboard.telemetry.test_tlog_reader import flight as logged_flight

S, MS = 1_000_000_000, 1_000_000
EPOCH = 1_795_217_000 * S
DOWN = (2**-0.5, 0.0, -(2**-0.5), 0.0)
# As they cross the wire, of system 1, 90 degrees down at 70 s of boot time; the second turned 40 degrees to the right.
STATUS_154 = "fd25000000019a1d010070110100f304353f00000000f30435bf000000000000c07f0000c07f0000c07f0000000020602f"
ORIENTATION_154 = "fd10000000019a09010070110100000000000000b4c2000020428290"


class Line:
    """An autopilot with an ATTITUDE and a position ten times a second, and gimbals next to it, in virtual time."""

    def __init__(self, config: str = "") -> None:
        self.autopilot = Autopilot(parse_config(f"[telemetry]\nsystem = 1\n{config}"))
        self.now_s = 0.0

    def receive(self, message: Any, component: int = 154, late_s: float = 0.004) -> list[Any]:
        message._header = mavlink.MAVLink_header(message.id, srcSystem=1, srcComponent=component)
        return self.autopilot.receive(message, EPOCH + round((self.now_s + late_s) * S))

    def run(self, seconds: float, each: Any = None) -> list[GimbalAttitude]:
        """`each` is called every 40 ms, and gives what gimbals send then: (component, message)."""
        out: list[Any] = []
        for k in range(round(seconds * 25)):
            boot_ms = 60_000 + round(self.now_s * 1000)
            if k % 25 == 0:
                self.receive(mavlink.MAVLink_heartbeat_message(1, 3, 0, 0, 4, 3), 1)
            if k % 2 == 0:
                self.receive(mavlink.MAVLink_attitude_message(boot_ms, 0.1, 0.0, 0.0, 0.0, 0.0, 0.1), 1)
                place = mavlink.MAVLink_global_position_int_message(boot_ms, 4 * 10**8, 10**8, 0, 0, 0, 0, 0, 0)
                self.receive(place, 1)
            for component, message in each(self.now_s) if each else ():
                out += self.receive(message, component)
            self.now_s += 0.04
        return out

    @property
    def detail(self) -> str:
        return self.autopilot.health(EPOCH + round(self.now_s * S)).detail


def status(boot_ms: int, q: tuple[float, ...] = DOWN, flags: int = 32, failure: int = 0) -> Any:
    nan = math.nan
    return mavlink.MAVLink_gimbal_device_attitude_status_message(0, 0, boot_ms, flags, list(q), nan, nan, nan, failure)


def orientation(boot_ms: int, yaw: float = 40.0, absolute: float = 0.0, pitch: float = -90.0) -> Any:
    return mavlink.MAVLink_mount_orientation_message(boot_ms, 0.0, pitch, yaw, absolute)


def pitches(events: list[GimbalAttitude]) -> set[float]:
    return {round(2.0 * math.asin(e.q_ref_gimbal[2]), 3) for e in events}


def own(now_s: float, drift: float = 0.0) -> int:
    """The gimbal's boot clock, which has nothing to do with the autopilot's (60 s at our beginning)."""
    return 5_000 + round(now_s * 1000 * (1.0 + drift))


def test_a_gimbal_s_own_component_is_received_on_a_clock_of_its_own() -> None:
    line = Line()
    got = line.run(20.0, lambda t: [(154, status(own(t, 2e-4)))])
    assert len(got) > 400
    # Each was true when it was sent: 4 ms before it came, which nothing on this line can tell.
    truth = [EPOCH + round((e.stamp_ns - EPOCH) / S / 0.04) * 0.04 * S for e in got]
    assert max(abs(e.stamp_ns - t) for e, t in zip(got, truth, strict=True)) < 6 * MS
    figures = line.autopilot.health(EPOCH + round(line.now_s * S)).figures
    assert figures["gimbal_component"] == 154 and 0.0 < figures["gimbal_clock_sigma_ms"] < 10.0


@pytest.mark.parametrize("component", [154, 171, 175])
def test_every_gimbal_component_is_received_and_no_other(component: int) -> None:
    assert len(Line().run(3.0, lambda t: [(component, status(own(t)))])) > 40
    assert not Line().run(3.0, lambda t: [(component - 1 if component != 175 else 176, status(own(t)))])


def test_timesync_is_answered_by_autopilot_and_gimbal_each_for_itself() -> None:
    line = Line()

    def each(t: float) -> list[tuple[int, Any]]:
        now_ns = EPOCH + round(t * S)
        out: list[tuple[int, Any]] = [(154, status(own(t)))]
        for asked in line.autopilot.due(now_ns):
            if asked.get_type() == "TIMESYNC" and asked.tc1 == 0:
                out.append((1, mavlink.MAVLink_timesync_message(60 * S + round(t * S) + 2 * MS, asked.ts1)))
                out.append((154, mavlink.MAVLink_timesync_message(5 * S + round(t * S) + 2 * MS, asked.ts1)))
        return out

    got = line.run(8.0, each)
    late = [(e.stamp_ns - EPOCH) / S - round((e.stamp_ns - EPOCH) / S / 0.04) * 0.04 for e in got[50:]]
    assert max(abs(x) for x in late) < 0.0015  # by exchanges, not by arrival: that would be 4 ms late
    assert abs(line.autopilot.clock.to_host_ns(60 * S) - EPOCH) < 1.5 * MS


def test_the_gimbal_s_own_goes_before_the_autopilot_s_until_it_is_silent() -> None:
    other = tuple(quaternion_from_matrix(matrix_from_euler(0.0, -0.5, 0.0)).tolist())

    def each(t: float) -> list[tuple[int, Any]]:
        passed_on = (1, status(60_000 + round(t * 1000), other))
        return [passed_on] + ([(171, status(own(t)))] if 4.0 <= t < 8.0 else [])

    line = Line()
    first, second, third = line.run(4.0, each), line.run(5.0, each), line.run(6.0, each)
    assert pitches(first) == {-0.5}
    middle = [e for e in second if e.stamp_ns > EPOCH + 5.2 * S]
    assert middle and pitches(middle) == {-1.571}
    assert pitches(third[-50:]) == {-0.5}


def test_of_several_gimbals_the_configured_one_counts() -> None:
    other = tuple(quaternion_from_matrix(matrix_from_euler(0.0, -0.5, 0.0)).tolist())

    def each(t: float) -> list[tuple[int, Any]]:
        return [(154, status(own(t))), (172, status(own(t) + 999, other))]

    for config, expected in (("", -1.571), ("[mount]\ngimbal_component = 172", -0.5)):
        got = Line(config).run(5.0, each)
        assert len(got) > 80 and pitches(got) == {expected}
    assert not Line("[mount]\ngimbal_component = 1").run(3.0, each)


@pytest.mark.parametrize(("words", "yaw"), [(STATUS_154, 0.0), (ORIENTATION_154, math.radians(40.0))])
def test_bytes_off_the_wire_become_the_attitude_that_they_hold(words: str, yaw: float) -> None:
    line, framer = Line(), Framer(mavlink.MAVLink(None), SequenceGaps())
    line.run(2.0)
    (message,) = framer.feed(bytes.fromhex(words))
    assert message.time_boot_ms == 70_000
    assert not line.autopilot.receive(message, EPOCH + 2 * S)  # its clock is not known yet
    (event,) = line.autopilot.receive(message, EPOCH + 4 * S)
    assert (event.stamp_ns, event.reference) == (EPOCH + 2 * S, "vehicle")  # the least delayed arrival of its stamp
    R = matrix_from_euler(0.0, -math.pi / 2, yaw)
    assert np.allclose(matrix_from_quaternion(event.q_ref_gimbal), R, atol=1e-6)
    spoilt = bytearray.fromhex(words)
    spoilt[20] ^= 4
    assert not framer.feed(bytes(spoilt))


@pytest.mark.parametrize(
    ("message", "reference", "yaw_deg"),
    [
        (orientation(5_000, 40.0, pitch=-30.0), "vehicle", 40.0),
        (orientation(5_000, math.nan, -110.0, -30.0), "earth", -110.0),
    ],
)
def test_mount_orientation_counts_yaw_from_the_nose_or_else_from_north(
    message: Any, reference: str, yaw_deg: float
) -> None:
    line = Line()
    line.run(3.0, lambda t: [(154, orientation(own(t)))])
    message.time_boot_ms = own(line.now_s)
    (event,) = line.receive(message)
    assert event.reference == reference
    R = matrix_from_euler(0.0, math.radians(-30.0), math.radians(yaw_deg))
    assert np.allclose(matrix_from_quaternion(event.q_ref_gimbal), R, atol=1e-6)


def test_the_newer_message_goes_before_mount_orientation() -> None:
    got = Line().run(5.0, lambda t: [(154, orientation(own(t), pitch=-30.0)), (154, status(own(t) + 1))])
    late = [e for e in got if e.stamp_ns > EPOCH + 3 * S]
    assert late and all(e.q_ref_gimbal[2] == pytest.approx(DOWN[2], abs=1e-6) for e in late)


def test_yaw_flags_that_change_change_the_frame_of_the_event() -> None:
    got = Line().run(6.0, lambda t: [(154, status(own(t), flags=32 if t < 3.0 else 64))])
    assert [e.reference for e in got[:10]] == ["vehicle"] * 10 and [e.reference for e in got[-10:]] == ["earth"] * 10


def test_silence_is_reported_and_what_is_damaged_is_silence() -> None:
    line = Line()
    line.run(4.0, lambda t: [(154, status(own(t)))])
    assert "gimbal" not in line.detail
    assert not line.run(3.0, lambda t: [(154, status(own(t), (math.nan,) * 4))])
    assert "the gimbal (component 154) is silent for 3 s" in line.detail
    assert line.autopilot.health(EPOCH + round(line.now_s * S)).state is State.DEGRADED
    assert not line.run(1.0, lambda t: [(154, status(own(t), failure=8))])
    assert line.run(1.0, lambda t: [(154, status(own(t)))]) and "silent" not in line.detail


def test_a_boot_stamp_that_stands_still_is_no_new_attitude_and_one_left_at_0_counts_at_its_arrival() -> None:
    line = Line()
    line.run(3.0, lambda t: [(154, status(own(t)))])
    assert len(line.run(2.0, lambda t: [(154, status(own(3.0)))])) <= 1
    got = Line().run(2.0, lambda t: [(154, status(0))])
    assert len(got) > 40 and got[-1].stamp_ns == EPOCH + round((49 * 0.04 + 0.004) * S)


def test_a_gimbal_that_reboots_is_followed_again() -> None:
    line = Line()
    line.run(5.0, lambda t: [(154, status(own(t)))])
    got = line.run(4.0, lambda t: [(154, status(round((t - 5.0) * 1000) + 100))])
    assert len(got) > 60
    assert abs(got[-1].stamp_ns - (EPOCH + round((line.now_s - 0.04) * S))) < 6 * MS


def test_a_log_s_gimbal_has_its_own_clock_too(tmp_path: Path) -> None:
    log = logged_flight(10.0)
    for k in range(100):
        log.add(0.1 * k, status(own(0.1 * k)), component=154)
        log.add(0.1 * k, status(own(0.1 * k), (1.0, 0.0, 0.0, 0.0)), component=173)
        log.add(0.1 * k, status(0), system=9, component=154)
    # In a log everything stands in order of arrival.
    records = _records(log.data)
    log.data = b"".join(sorted(records, key=lambda r: struct.unpack(">Q", r[:8])[0]))
    read = read_tlog(log.save(tmp_path))
    gimbals = [e for e in read.events if isinstance(e, GimbalAttitude)]
    assert len(gimbals) == 100 and pitches(gimbals) == {-1.571}
    expected = [1_795_217_000 * S + round((0.1 * k + 0.01) * S) for k in range(100)]
    assert max(abs(e.stamp_ns - t) for e, t in zip(gimbals, expected, strict=True)) < 2 * MS
    assert read.arrival_ns == sorted(read.arrival_ns)
    chosen = read_tlog(log.save(tmp_path), gimbal=173)
    assert pitches([e for e in chosen.events if isinstance(e, GimbalAttitude)]) == {0.0}


def _records(data: bytes) -> list[bytes]:
    out, at = [], 0
    while at < len(data):
        end = at + 8 + data[at + 9] + 12
        out.append(data[at:end])
        at = end
    return out


def settings(boot_ms: int, zoom: float) -> Any:
    return mavlink.MAVLink_camera_settings_message(boot_ms, 0, zoom, math.nan)


def fov(boot_ms: int, hfov_deg: float) -> Any:
    return mavlink.MAVLink_camera_fov_status_message(
        boot_ms, 0, 0, 0, 0, 0, 0, [1.0, 0.0, 0.0, 0.0], hfov_deg, math.nan
    )


@pytest.mark.parametrize("component", [1, 100, 105, 154])
def test_a_camera_s_zoom_is_received_on_its_own_clock_and_nan_is_none(component: int) -> None:
    boot = (lambda t: 60_000 + round(t * 1000)) if component == 1 else own
    got = Line().run(
        6.0, lambda t: [(component, settings(boot(t), 40.0 if t < 5.0 else math.nan)), (component, fov(boot(t), 31.5))]
    )
    stated = {(e.value, e.unit) for e in got if isinstance(e, Zoom)}
    assert stated == {(40.0, "percent"), (31.5, "hfov_deg")}
    for unit, last_s in (("percent", 4.96), ("hfov_deg", 5.96)):
        newest = max(e.stamp_ns for e in got if isinstance(e, Zoom) and e.unit == unit)
        assert abs(newest - (EPOCH + round(last_s * S))) < 6 * MS


def test_a_log_s_zoom_is_read_too(tmp_path: Path) -> None:
    log = logged_flight(4.0)
    log.data += b"".join(_camera_record(0.5 * k) for k in range(8))
    log.data = b"".join(sorted(_records(log.data), key=lambda r: struct.unpack(">Q", r[:8])[0]))
    zooms = [e for e in read_tlog(log.save(tmp_path)).events if isinstance(e, Zoom)]
    assert [e.value for e in zooms] == [25.0] * 8


def _camera_record(moment_s: float) -> bytes:
    packer = mavlink.MAVLink(None, srcSystem=1, srcComponent=100)
    stamp_us = 1_795_217_000_000_000 + round((moment_s + 0.01) * 1e6)
    return struct.pack(">Q", stamp_us) + settings(own(moment_s), 25.0).pack(packer)
