"""MAVLink messages beyond position and attitude, as events: the filter's doubts, gimbals, range finders."""

import math
import operator
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from contract.rotations import matrix_from_quaternion
from onboard.events.types import FilterStatus, GpsQuality, Home, NavEvent, PositionFix
from onboard.telemetry.mavlink_events import MessageToEvent, Sources, sensor_direction

BOOT_MS = 5000
STAMP = BOOT_MS * 1_000_000 + 7


def events(*messages: Any) -> list[NavEvent]:
    converter = MessageToEvent(Sources())
    return [event for m in messages for event in converter.convert(m, 99, lambda boot_ns: boot_ns + 7)]


def clock() -> Any:
    return mavlink.MAVLink_system_time_message(0, BOOT_MS)


def ekf(flags: int) -> Any:
    return mavlink.MAVLink_ekf_status_report_message(flags, 0.1, 0.1, 0.1, 0.1, 0.1)


def estimator(flags: int) -> Any:
    return mavlink.MAVLink_estimator_status_message(0, flags, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.5, 0.5)


# As recorded from ArduPilot: flying, ten seconds into an outage, seventeen into a jamming, on the ground, starting.
@pytest.mark.parametrize(
    ("message", "has_position", "is_glitching"),
    [
        (ekf(0x33F), True, False),
        (ekf(0x12F), False, False),
        (ekf(0x833F), True, True),
        (ekf(0xA7), False, False),
        (ekf(0x400), False, False),
        (estimator(0x33F), True, False),
        (estimator(0x73F), True, True),
        (estimator(0xBF), False, False),
        (ekf(1023), False, False),  # ArduPilot holds a position for want of any
    ],
)
def test_a_filter_s_flags_say_what_it_believes(message: Any, has_position: bool, is_glitching: bool) -> None:
    assert events(clock(), message) == [FilterStatus(STAMP, has_position, is_glitching)]


def test_px4_standing_on_the_ground_with_gnss_fused_has_a_position() -> None:
    """It holds the position whenever at rest, and says so: all flags but GPS glitch and accelerometer error."""
    assert events(clock(), estimator(1023)) == [FilterStatus(STAMP, True, False, is_at_rest=True)]
    without_velocity = 1023 & ~mavlink.ESTIMATOR_VELOCITY_HORIZ
    assert events(clock(), estimator(without_velocity)) == [FilterStatus(STAMP, False, False)]


def gps_raw(stamp_us: int) -> Any:
    return mavlink.MAVLink_gps_raw_int_message(stamp_us, 3, -430000000, 1720000000, 100000, 100, 100, 500, 0, 12)


def global_position(boot_ms: int) -> Any:
    return mavlink.MAVLink_global_position_int_message(boot_ms, -430000000, 1720000000, 100000, 50000, 500, 0, 0, 0)


def attitude(boot_ms: int) -> Any:
    return mavlink.MAVLink_attitude_message(boot_ms, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("first_us", [1_700_000_000_000_000, 3_000_000])
def test_a_receiver_s_fix_that_is_sent_again_is_no_other_position(first_us: int) -> None:
    """One of 1 Hz that was forwarded at 5 Hz counted as five, each with an error of its own."""
    converter = MessageToEvent(Sources(position="GPS_RAW_INT"))
    found: list[NavEvent] = []
    for k in range(20):
        now_ns = k * 200_000_000
        # Our clock is still learned: what a stamp is on it changes by a little.
        to_host_ns = partial(operator.add, now_ns // 1000)
        found += converter.convert(gps_raw(first_us + 1_000_000 * (k // 5)), now_ns, to_host_ns)
    assert len([e for e in found if isinstance(e, PositionFix)]) == 4
    reports = [e for e in found if isinstance(e, GpsQuality)]
    assert len(reports) == 20 and all(report.has_fix for report in reports)


def test_a_receiver_without_a_stamp_is_taken_as_it_comes() -> None:
    converter = MessageToEvent(Sources(position="GPS_RAW_INT"))
    found = [e for k in range(5) for e in converter.convert(gps_raw(0), k * 200_000_000, lambda boot_ns: boot_ns)]
    assert len([e for e in found if isinstance(e, PositionFix)]) == 5


def test_a_position_or_attitude_that_comes_by_two_ways_is_one() -> None:
    """Its boot stamp is the same, and our clock's map of it is not quite."""
    converter = MessageToEvent(Sources())
    found: list[NavEvent] = []
    for k in range(10):
        for message in (global_position(BOOT_MS + 100 * (k // 2)), attitude(BOOT_MS + 100 * (k // 2))):
            found += converter.convert(message, 0, partial(operator.add, 1000 * k))
    assert [type(e).__name__ for e in found] == ["PositionFix", "Attitude"] * 5


def gimbal(flags: int, q: tuple[float, float, float, float] = (2**-0.5, 0.0, -(2**-0.5), 0.0), failure: int = 0) -> Any:
    return mavlink.MAVLink_gimbal_device_attitude_status_message(
        0, 0, BOOT_MS, flags, list(q), math.nan, math.nan, math.nan, failure
    )


@pytest.mark.parametrize(
    ("flags", "reference"),
    [
        (32, "vehicle"),
        (64, "earth"),
        (16, "earth"),
        (12, "vehicle"),
        (32 | 16, "vehicle"),
        (64 | 16, "earth"),
        (44, "vehicle"),
    ],
)
def test_a_gimbal_s_flags_say_against_what_it_counts_yaw(flags: int, reference: str) -> None:
    (got,) = events(gimbal(flags))
    assert (got.stamp_ns, got.reference) == (STAMP, reference)
    looks = matrix_from_quaternion(got.q_ref_gimbal) @ [1.0, 0.0, 0.0]
    assert looks == pytest.approx([0.0, 0.0, 1.0], abs=1e-6)  # pitched 90 degrees down


@pytest.mark.parametrize(
    "message",
    [
        gimbal(32, (math.nan, 0.0, 0.0, 0.0)),
        gimbal(32, (0.0, 0.0, 0.0, 0.0)),
        gimbal(32, failure=mavlink.GIMBAL_DEVICE_ERROR_FLAGS_ENCODER_ERROR),
    ],
)
def test_a_gimbal_that_does_not_know_is_not_asked(message: Any) -> None:
    assert events(message) == []


def distance(centimetres: int = 4200, orientation: int = 25, covariance: int = 255, **more: Any) -> Any:
    return mavlink.MAVLink_distance_sensor_message(
        BOOT_MS, 20, 12000, centimetres, 0, 1, orientation, covariance, **more
    )


def test_a_distance_has_its_direction_and_its_sigma() -> None:
    (plain,) = events(distance())
    assert (plain.stamp_ns, plain.distance_m, plain.sigma_m) == (STAMP, 42.0, None)
    assert plain.direction_body == pytest.approx((0.0, 0.0, 1.0), abs=1e-9)
    (known,) = events(distance(covariance=144))
    assert known.sigma_m == pytest.approx(0.12)


@pytest.mark.parametrize(
    "message",
    [distance(20), distance(12000), distance(65535), distance(0), distance(signal_quality=1), distance(orientation=99)],
)
def test_a_distance_that_is_none_makes_no_event(message: Any) -> None:
    assert events(message) == []


def test_orientations_point_where_mavlink_says() -> None:
    downwards = math.sqrt(0.5)
    for number, direction in {
        0: (1.0, 0.0, 0.0), 2: (0.0, 1.0, 0.0), 4: (-1.0, 0.0, 0.0), 6: (0.0, -1.0, 0.0),
        24: (0.0, 0.0, -1.0), 25: (0.0, 0.0, 1.0), 1: (downwards, downwards, 0.0),
    }.items():  # fmt: skip
        assert sensor_direction(number) == pytest.approx(direction, abs=1e-9)
    for number in mavlink.enums["MAV_SENSOR_ORIENTATION"]:
        looks = sensor_direction(number)
        assert looks is None or np.linalg.norm(looks) == pytest.approx(1.0)


@given(st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda q: 0.6 < math.hypot(*q) < 1.9))
def test_a_custom_orientation_is_its_quaternion(q: tuple[float, float, float, float]) -> None:
    unit = np.array(q) / math.hypot(*q)
    assert sensor_direction(100, q) == pytest.approx(matrix_from_quaternion(unit) @ [1.0, 0.0, 0.0], abs=1e-9)


def test_a_custom_orientation_without_a_quaternion_is_unknown() -> None:
    assert sensor_direction(100, (0.0, 0.0, 0.0, 0.0)) is None
    assert sensor_direction(100) is None


def home(lat: int = -433_800_000, lon: int = 1_724_000_000) -> Any:
    return mavlink.MAVLink_home_position_message(lat, lon, 100_080, 0.0, 0.0, 0.0, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0)


def test_where_it_was_armed_is_stamped_when_it_comes() -> None:
    assert events(clock(), home()) == [Home(STAMP, -43.38, 172.4, 100.08)]


@pytest.mark.parametrize("message", [home(0, 0), home(lat=910_000_000), home(lon=1_810_000_000)])
def test_a_home_that_is_nowhere_makes_no_event(message: Any) -> None:
    assert events(message) == []


def position(tenths: int, north_cm: int, speed_cm_s: int = 0) -> Any:
    return mavlink.MAVLink_global_position_int_message(
        BOOT_MS + 100 * tenths, -433_800_000 + 9 * north_cm // 10, 1_724_000_000, 200_000, 100_000, speed_cm_s, 0, 0, 0
    )


def test_a_velocity_that_is_always_nothing_is_none() -> None:
    """Betaflight sends zeros: in motion they contradicted every position, and nothing was answered."""
    moving = [event.velocity_ned_m_s for event in events(*(position(k, 100 * k) for k in range(5)))]
    assert moving == [(0.0, 0.0, 0.0), *[None] * 4]
    stops = events(*(position(k, 100 * min(k, 3), 1000 * (k in (1, 2))) for k in range(5)))
    assert [event.velocity_ned_m_s for event in stops] == [
        (0.0, 0.0, 0.0),
        *[(10.0, 0.0, 0.0)] * 2,
        *[(0.0, 0.0, 0.0)] * 2,
    ]


def test_a_receiver_s_position_that_is_passed_on_several_times_is_one() -> None:
    """A receiver of 1 Hz whose position comes ten times a second, each time with a new stamp."""
    passed_on = events(*(position(k, 1500 * (k // 10)) for k in range(30)))
    assert [event.stamp_ns for event in passed_on[10:]] == [STAMP + k * 1_000_000_000 for k in (1, 2)]
    standing = events(*(position(k, 0) for k in range(30)))
    assert [event.velocity_ned_m_s for event in standing] == [(0.0, 0.0, 0.0)] * 30
    assert len(events(*(position(k, 0, 500) for k in range(30)))) == 30
