"""No position before a fix, in whatever order an autopilot's first messages come, and the reason in words."""

import itertools
from collections.abc import Iterator

import numpy as np
import pytest
from _pytest.mark import ParameterSet
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from contract.feature_set import Status
from contract.geodesy import LocalFrame, rotation_enu_ecef
from contract.rotations import R_ENU_NED
from onboard.config.schema import Config
from onboard.events.types import FilterStatus, GpsQuality, PositionFix
from onboard.navigation.navigator import Navigation, NavState
from onboard.telemetry.mavlink_events import MessageToEvent, Sources
from tests.rest_long import rest_long

HOME = LocalFrame(-43.38, 172.4, 350.0)
T0 = 1_795_217_000_000_000_000
KINDS = ("HEARTBEAT", "GLOBAL_POSITION_INT", "GPS_RAW_INT", "EKF_STATUS_REPORT", "ATTITUDE")
FIX_S, END_S, STEP_S = 4.0, 14.0, 0.2


def message(kind: str, t: float, has_fix: bool) -> mavlink.MAVLink_message:
    """What ArduPlane sends on the ground; without a fix its position is 0.0003 N, 0.0001 W."""
    boot_ms = round((t + 100.0) * 1000)
    lat, lon = (-433800000, 1724000000) if has_fix else (3000, -1000)
    if kind == "HEARTBEAT":
        return mavlink.MAVLink_heartbeat_message(1, 3, 81, 0, 4, 3)
    if kind == "GLOBAL_POSITION_INT":
        return mavlink.MAVLink_global_position_int_message(boot_ms, lat, lon, 100_000, 0, 0, 0, 0, 0)
    if kind == "GPS_RAW_INT":
        fix = (6, lat, lon, 100_000, 100, 100, 0, 0, 12) if has_fix else (1, 0, 0, 0, 9999, 9999, 0, 0, 0)
        return mavlink.MAVLink_gps_raw_int_message(boot_ms * 1000, *fix)
    if kind == "EKF_STATUS_REPORT":
        return mavlink.MAVLink_ekf_status_report_message(0x33F if has_fix else 0xA7, 0.1, 0.1, 0.1, 0.1, 0.1)
    return mavlink.MAVLink_attitude_message(boot_ms, 0.01, 0.02, 0.3, 0.001, 0.001, 0.001)


def started(order: tuple[str, ...], fixed_at: dict[str, float]) -> Iterator[tuple[float, Navigation]]:
    """After every round of messages in an order; each kind knows of the fix from its own moment on."""
    convert, navigation = MessageToEvent(Sources()), Navigation(Config())
    for t in np.arange(0.0, END_S, STEP_S):
        for k, kind in enumerate(order):
            at = float(t) + 0.03 * k
            arrival_ns = T0 + round(at * 1e9)
            found = message(kind, at, at >= fixed_at.get(kind, FIX_S))
            for event in convert.convert(found, arrival_ns, lambda boot_ns: T0 + boot_ns - 100_000_000_000):
                navigation.add(event)
        yield float(t), navigation


def home_is_near(navigation: Navigation) -> bool:
    return float(np.linalg.norm(navigation.frame.to_enu(-43.38, 172.4, 100.0))) < 100.0


def orders() -> list[ParameterSet]:
    """All orders of a round; in `make test` those in which each kind comes first, and before and after each other."""
    turned = [KINDS[k:] + KINDS[:k] for k in range(len(KINDS))]
    short = [*turned, *(order[::-1] for order in turned)]
    rest = [order for order in itertools.permutations(KINDS) if order not in short]
    return rest_long([(order,) for order in (*short, *rest)], len(short))


@pytest.mark.parametrize("order", orders(), ids=lambda o: "-".join(k[0:2] for k in o))
def test_a_start_without_a_fix_believes_nothing_until_there_is_one(order: tuple[str, ...]) -> None:
    for t, navigation in started(order, {}):
        if 0.3 < t < FIX_S:
            assert navigation.frame is None
            assert navigation.state_at(T0 + round(t * 1e9) - 100_000_000) is Status.NO_GPS
            assert navigation.reason in ("no fix yet", "the autopilot's filter has no absolute position")
    assert home_is_near(navigation)
    assert isinstance(navigation.state_at(T0 + round((END_S - 0.5) * 1e9)), NavState)
    assert navigation.reason == ""


@pytest.mark.parametrize("late", list(itertools.permutations(KINDS[1:4])), ids=lambda o: "-".join(k[0:2] for k in o))
@pytest.mark.parametrize("apart_s", [0.05, 0.5, 0.9])
def test_however_the_fix_becomes_known_no_state_is_ever_at_the_place_without_one(
    late: tuple[str, ...], apart_s: float
) -> None:
    """The receiver, the filter's report and its position learn of the fix one after the other.

    A filter that calls its position absolute and gives another place for longer than `gps.recovery_s` contradicts
    itself; nothing can be held against that.
    """
    fixed_at = {kind: FIX_S + apart_s * k for k, kind in enumerate(late)}
    for t, navigation in started(KINDS, fixed_at):
        got = navigation.state_at(T0 + round(t * 1e9) - 300_000_000)
        if isinstance(got, NavState):
            lat, lon, _ = navigation.frame.to_geodetic(got.position_enu_m)
            assert float(lat) == pytest.approx(-43.38, abs=1e-3), (t, late)
            assert float(lon) == pytest.approx(172.4, abs=1e-3)
    assert home_is_near(navigation)
    assert isinstance(navigation.state_at(T0 + round((END_S - 0.5) * 1e9)), NavState)


def fix(t: float, east_m: float = 0.0, speed_m_s: float = 20.0) -> PositionFix:
    lat, lon, height = HOME.to_geodetic(np.array([east_m, 0.0, 0.0]))
    there = rotation_enu_ecef(float(lat), float(lon)) @ HOME.R_enu_ecef.T
    velocity = R_ENU_NED.T @ there @ np.array([speed_m_s, 0.0, 0.0])
    return PositionFix(T0 + round(t * 1e9), float(lat), float(lon), float(height), tuple(velocity.tolist()))


def test_the_frame_moves_along_on_a_long_way_without_a_gap() -> None:
    navigation, speed = Navigation(Config()), 1000.0  # to come far in a test
    frames = set()
    for t in np.arange(0.0, 60.0, 0.2):
        navigation.add(GpsQuality(T0 + round(t * 1e9), 3))
        navigation.add(FilterStatus(T0 + round(t * 1e9), True, False))
        navigation.add(fix(t, speed * t, speed))
        if t > 1.0:
            got = navigation.state_at(T0 + round((t - 0.3) * 1e9))
            assert isinstance(got, NavState), (t, navigation.reason)
            frames.add((got.stretch, navigation.frame))
    assert 3 <= len(frames) <= 4
    assert len({stretch for stretch, _ in frames}) == len(frames)


def test_a_silent_receiver_is_waited_for_and_no_longer() -> None:
    navigation = Navigation(Config())
    for t in np.arange(0.0, 3.0, 0.2):
        navigation.add(fix(t, 20.0 * t))
        assert (navigation.frame is None) == (t < Config().gps.quality_timeout_s), t
    assert isinstance(navigation.state_at(T0 + 1_000_000_000), NavState)  # those that waited are not lost


def reasons(change: dict[str, tuple[float, float]]) -> list[str]:
    """What is said over 40 s, without repetitions, of a flight with faults from and until."""

    def has(name: str, t: float) -> bool:
        start_s, end_s = change.get(name, (np.inf, np.inf))
        return start_s <= t < end_s

    navigation, reported = Navigation(Config()), [""]
    for t in np.arange(0.0, 40.0, 0.2):
        if not has("silent", t):
            navigation.add(GpsQuality(T0 + round(t * 1e9), 1 if has("no fix", t) else 3, sigma_horizontal_m=0.3))
        navigation.add(FilterStatus(T0 + round(t * 1e9), not has("no position", t), has("glitch", t)))
        navigation.add(fix(t, 20.0 * t + (33.0 if has("jump", t) else 0.0)))
        navigation.state_at(T0 + round((t - 0.1) * 1e9))
        if navigation.reason != reported[-1]:
            reported.append(navigation.reason)
    return [r for r in reported if r]


def test_what_keeps_a_position_from_being_believed_is_reported_in_words() -> None:
    assert reasons({}) in ([], ["no position yet"])
    assert "fix lost" in reasons({"no fix": (20.0, 25.0)})
    assert "recovering" in reasons({"no fix": (20.0, 25.0)})
    assert "the autopilot's filter has no absolute position" in reasons({"no position": (20.0, 25.0)})
    assert "the autopilot's filter calls the GPS a glitch" in reasons({"glitch": (20.0, 25.0)})
    assert "the receiver has been silent for more than 2 s" in reasons({"silent": (20.0, 25.0)})
    assert "position jumped 33 m against velocity, settling" in reasons({"jump": (20.0, 41.0)})
