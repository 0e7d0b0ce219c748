"""A flight whose camera hangs in a gimbal that speaks for itself: from component 154, on a boot clock of its own."""

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from benchmarks.ablation_scenes import SURVEY, GimbalFlight
from benchmarks.sampled_flight import EPOCH_NS, SampledSpec
from contract.feature_set import Status
from contract.rotations import matrix_from_euler, matrix_from_quaternion, quaternion_from_matrix
from onboard.config.schema import Config, parse_config
from onboard.events.types import Attitude, Event, Frame, GimbalAttitude, GpsQuality, PositionFix
from onboard.navigation.gimbal import MountHypothesis
from onboard.telemetry.mavlink_session import Autopilot
from onboard.telemetry.vehicle_choice import LISTEN_NS
from tests.scenarios.test_moved_optics import Simulated, simulated

S = 1_000_000_000
SECONDS = 30.0
LATE_S = {1: 0.006, 154: 0.012}  # of the link, by component
BOOT_S = {1: 100.0, 154: 7.5}  # what the clocks read when the first picture is taken
RATE = {1: 1.0 + 20e-6, 154: 1.0 - 150e-6}


def survey(config: str = "", seed: int = 3, seconds: float = SECONDS) -> GimbalFlight:
    spec = SampledSpec(parse_config(config), replace(SURVEY, kind="turns", leg_m=150.0), seconds, 2.0, offset_s=0.0)
    return GimbalFlight(spec, seed)


def as_message(event: Event, boot_ms: int) -> Any:
    """What an autopilot or a gimbal sends of an event."""
    match event:
        case Attitude():
            return mavlink.MAVLink_attitude_quaternion_message(boot_ms, *event.q_ned_body, 0.0, 0.0, 0.0)
        case GimbalAttitude():
            nan, flags = math.nan, 32 if event.reference == "vehicle" else 64
            q = list(event.q_ref_gimbal)
            return mavlink.MAVLink_gimbal_device_attitude_status_message(0, 0, boot_ms, flags, q, nan, nan, nan, 0)
        case PositionFix():
            assert event.velocity_ned_m_s is not None
            return mavlink.MAVLink_global_position_int_message(
                boot_ms, round(event.lat_deg * 1e7), round(event.lon_deg * 1e7), round(event.height_amsl_m * 1e3),
                round((event.height_above_home_m or 0.0) * 1e3), *(round(v * 100) for v in event.velocity_ned_m_s), 0,
            )  # fmt: skip
        case GpsQuality():
            # A place of its own, which this flight's receiver has not, would contradict the autopilot's.
            return mavlink.MAVLink_gps_raw_int_message(boot_ms * 1000, 4, 0, 0, 1000, 100, 100, 0, 0, 12)
    raise AssertionError(event)


def over_the_line(flight: GimbalFlight, config: Config, component: int = 154) -> Iterator[Event]:
    """Telemetry as it is received off a line, on our clock again; pictures as they are."""
    autopilot = Autopilot(config)
    arriving = []
    for event in flight.events():
        sender = component if isinstance(event, GimbalAttitude) else 1
        boot_s = BOOT_S[sender] + (event.stamp_ns - EPOCH_NS) / S * RATE[sender]
        late_s = 0.0 if isinstance(event, Frame) else LATE_S[sender]
        arriving.append((event.stamp_ns + round(late_s * S), sender, round(boot_s * 1000), event))
    heartbeat = mavlink.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3)
    heartbeat._header = mavlink.MAVLink_header(heartbeat.id, srcSystem=1, srcComponent=1)
    for before_ns in (LISTEN_NS, 0):  # by the second it is known to be the only one on the line
        autopilot.receive(heartbeat, arriving[0][0] - before_ns)
    for arrival_ns, sender, boot_ms, event in sorted(arriving, key=lambda each: each[0]):
        if isinstance(event, Frame):
            yield event
            continue
        message = as_message(event, boot_ms)
        message._header = mavlink.MAVLink_header(message.id, srcSystem=1, srcComponent=sender)
        yield from autopilot.receive(message, arrival_ns)


def answered(found: Simulated, seconds: float = SECONDS) -> tuple[float, list[float]]:
    pictures, errors = found.pictures_in(3.0, seconds), found.errors_in(3.0, seconds)
    return pictures[Status.OK] / pictures.total(), errors


@pytest.mark.long  # short: that "auto" answers by it, below
def test_a_gimbal_on_a_clock_of_its_own_serves_like_one_that_the_autopilot_passes_on() -> None:
    """Both clocks begin at other times and drift apart."""
    config = parse_config("[mount]\ngimbal = 'always'")
    share, errors = answered(simulated(survey(), events=over_the_line(survey(), config)))
    passed_on, theirs = answered(simulated(survey(), events=over_the_line(survey(), config, 1)))
    assert share > 0.8 and share > passed_on - 0.1, (share, passed_on)
    assert max(errors) < 2.0 and np.median(errors) < 1.3 * np.median(theirs) + 0.1, (errors, theirs)


def test_auto_finds_that_it_carries_the_camera() -> None:
    flight = survey(seconds=16.0)
    found = simulated(flight, events=over_the_line(flight, parse_config("")))
    assert found.pipeline.mount_selection.verdict is MountHypothesis.GIMBAL
    share, errors = answered(found, 16.0)
    assert share > 0.7 and max(errors) < 2.0, (share, max(errors))


def powered_up(events: Iterator[Event], until_s: float) -> Iterator[Event]:
    """A gimbal that first reports its power-up attitude, level and ahead, whatever it really is."""
    for event in events:
        if isinstance(event, GimbalAttitude) and event.stamp_ns < EPOCH_NS + until_s * S:
            event = replace(event, q_ref_gimbal=(1.0, 0.0, 0.0, 0.0))  # noqa: PLW2901
        yield event


@pytest.mark.long
def test_a_gimbal_that_first_reports_its_power_up_attitude_is_found_afterwards() -> None:
    """After 8 s of it the camera was on a fixed mount for the whole flight, whatever pictures showed later."""
    flight = survey(seconds=18.0)
    found = simulated(flight, events=powered_up(flight.events(), 8.0))
    assert found.pipeline.mount_selection.verdict is MountHypothesis.GIMBAL
    late, errors = found.pictures_in(14.5, 18.0), found.errors_in(14.5, 18.0)
    assert late[Status.OK] == late.total() > 0 and max(errors) < 2.0, (late, errors)


def with_yaw_zero(events: Iterator[Event], zero_deg: float, drift_deg_s: float) -> Iterator[Event]:
    """A gimbal whose yaw counts from elsewhere than the nose, and wanders."""
    for event in events:
        if isinstance(event, GimbalAttitude):
            yaw = math.radians(zero_deg + drift_deg_s * (event.stamp_ns - EPOCH_NS) / S)
            R = matrix_from_euler(0.0, 0.0, yaw) @ matrix_from_quaternion(event.q_ref_gimbal)
            w, x, y, z = quaternion_from_matrix(R).tolist()
            event = replace(event, q_ref_gimbal=(w, x, y, z))  # noqa: PLW2901
        yield event


@pytest.mark.long
@pytest.mark.parametrize(("zero_deg", "drift_deg_s", "sigma_deg"), [(-45.0, 0.5, 45.0), (12.0, 0.0, 15.0)])
def test_a_yaw_whose_zero_is_off_and_drifts_is_found_by_each_window(
    zero_deg: float, drift_deg_s: float, sigma_deg: float
) -> None:
    declared = survey(f"[mount]\ngimbal = 'always'\ngimbal_yaw_sigma_deg = {sigma_deg}")
    share, errors = answered(simulated(declared, events=with_yaw_zero(declared.events(), zero_deg, drift_deg_s)))
    assert share > 0.8, share
    assert max(errors) < 1.5 and np.mean(np.array(errors) <= 1.0) > 0.85, sorted(errors)[-5:]
    true, exact = answered(simulated(declared, events=declared.events()))
    assert share >= true - 0.1 and np.median(errors) < 1.5 * np.median(exact) + 0.1, (share, true)


@pytest.mark.long
@pytest.mark.parametrize("seconds", [9.0, SECONDS])
def test_an_undeclared_yaw_zero_of_45_degrees_is_refused(seconds: float) -> None:
    silent = survey("[mount]\ngimbal = 'always'", seconds=seconds)
    share, errors = answered(simulated(silent, events=with_yaw_zero(silent.events(), 45.0, 0.0)))
    assert share < 0.1 and not errors, (share, errors)
