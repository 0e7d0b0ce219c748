"""Commands to look at a place and to circle, through both libraries: done, refused, lost, or never sent."""

import math
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from onboard.events.pointing import (
    ACCEPTED,
    NO_AUTOPILOT,
    NO_CIRCLE,
    NOT_ACKNOWLEDGED,
    ON_GROUND,
    CircleAbout,
    LookAhead,
    LookAt,
)
from onboard.events.source import State
from onboard.telemetry.pointing import MOST_SENT, Pointing
from simulation.autopilot.fake import FakeAutopilot, Faults
from simulation.autopilot.flight import Flight
from tests.onboard.link.ports import free_udp_port
from tests.onboard.telemetry.listening import FLIGHT, Listening, config_for, listening
from tests.waiting import PATIENCE_S, eventually

HILL = LookAt(-35.3632621, 149.1652374, 584.25)
BOTH = pytest.mark.parametrize("backend", ["pymavlink", "mavsdk"])


@contextmanager
def flying(
    backend: str = "pymavlink", limit_s: float = PATIENCE_S, flight: Flight = FLIGHT, **about: Any
) -> Iterator[tuple[FakeAutopilot, Pointing, Listening]]:
    pointing = Pointing(191, limit_s)
    url = f"udpout:127.0.0.1:{free_udp_port()}"
    with (
        FakeAutopilot(flight, url, loop=True, **about) as autopilot,
        listening(config_for(autopilot.url, backend=backend), pointing) as received,
    ):
        received.wait(State.OK)
        yield autopilot, pointing, received


def commands(autopilot: FakeAutopilot) -> list[Any]:
    return autopilot.received_of("COMMAND_INT")


@BOTH
@pytest.mark.parametrize("style", ["ardupilot", "px4"])
def test_it_looks_at_the_place_and_ahead_again(backend: str, style: str) -> None:
    with flying(backend, style=style) as (autopilot, pointing, _):
        assert commands(autopilot) == []
        assert pointing.command(HILL) == ACCEPTED
        lat, lon, height_m = autopilot.roi or (0.0, 0.0, 0.0)
        assert abs(lat - HILL.lat_deg) < 1e-7 and abs(lon - HILL.lon_deg) < 1e-7 and height_m == HILL.height_amsl_m
        (sent, *_) = commands(autopilot)
        assert (sent.command, sent.frame) == (mavlink.MAV_CMD_DO_SET_ROI_LOCATION, mavlink.MAV_FRAME_GLOBAL_INT)
        assert (sent.target_system, sent.target_component) == (autopilot.system, 1)
        assert (sent.get_srcSystem(), sent.get_srcComponent()) == (autopilot.system, 191)
        assert pointing.command(LookAhead()) == ACCEPTED
        assert autopilot.roi is None
        assert commands(autopilot)[-1].command == mavlink.MAV_CMD_DO_SET_ROI_NONE


ABOUT_HILL = CircleAbout(HILL.lat_deg, HILL.lon_deg, 700.0, 120.0)


@pytest.mark.parametrize(
    ("style", "kind", "number", "backend"),
    [
        ("ardupilot", mavlink.MAV_TYPE_FIXED_WING, mavlink.MAV_CMD_DO_REPOSITION, "pymavlink"),
        ("px4", mavlink.MAV_TYPE_FIXED_WING, mavlink.MAV_CMD_DO_REPOSITION, "mavsdk"),
        ("px4", mavlink.MAV_TYPE_HEXAROTOR, mavlink.MAV_CMD_DO_ORBIT, "pymavlink"),
        ("px4", mavlink.MAV_TYPE_HEXAROTOR, mavlink.MAV_CMD_DO_ORBIT, "mavsdk"),
    ],
)
def test_a_plane_and_a_multicopter_circle_about_the_place_at_the_height_and_radius(
    style: str, kind: int, number: int, backend: str
) -> None:
    with flying(backend, flight=replace(FLIGHT, vehicle_type=kind), style=style) as (autopilot, pointing, _):
        assert eventually(lambda: pointing.command(ABOUT_HILL) == ACCEPTED)
        lat, lon, height_m, radius_m = autopilot.circle or (0.0, 0.0, 0.0, 0.0)
        assert abs(lat - HILL.lat_deg) < 1e-7 and abs(lon - HILL.lon_deg) < 1e-7
        assert (height_m, radius_m) == (700.0, 120.0) and autopilot.roi is None
        sent = commands(autopilot)[-1]
        assert (sent.command, sent.frame) == (number, mavlink.MAV_FRAME_GLOBAL_INT)
        if number == mavlink.MAV_CMD_DO_REPOSITION:  # its own speed, the guided mode, clockwise
            assert (sent.param1, sent.param2, sent.param4) == (-1.0, 1.0, 0.0)
        else:  # speed, heading and turns of its own: 0 would be a standstill
            assert all(math.isnan(value) for value in (sent.param2, sent.param3, sent.param4))


@pytest.mark.parametrize(
    ("style", "kind", "sent", "word"),
    [
        ("ardupilot", mavlink.MAV_TYPE_QUADROTOR, 1, "unsupported"),
        ("ardupilot", mavlink.MAV_TYPE_VTOL_TILTROTOR, 0, NO_CIRCLE),
    ],
)
def test_what_cannot_circle_is_refused_and_sent_nowhere_instead(style: str, kind: int, sent: int, word: str) -> None:
    with flying(flight=replace(FLIGHT, vehicle_type=kind), style=style) as (autopilot, pointing, _):
        words: list[str] = []
        assert eventually(lambda: words.append(pointing.command(ABOUT_HILL)) or words[-1] != NO_AUTOPILOT)
        assert words[-1] == word
        assert len(commands(autopilot)) == sent and autopilot.circle is None


@pytest.mark.parametrize(
    ("backend", "state", "word"),
    [
        ("pymavlink", (mavlink.MAV_VTOL_STATE_FW, mavlink.MAV_LANDED_STATE_IN_AIR), NO_CIRCLE),
        ("mavsdk", (mavlink.MAV_VTOL_STATE_MC, mavlink.MAV_LANDED_STATE_IN_AIR), NO_CIRCLE),
        ("pymavlink", None, NO_CIRCLE),
        ("pymavlink", (mavlink.MAV_VTOL_STATE_UNDEFINED, mavlink.MAV_LANDED_STATE_ON_GROUND), ON_GROUND),
    ],
)
def test_a_vtol_that_calls_itself_a_plane_as_ardupilots_do_is_sent_nowhere_nor_is_one_that_stands_or_does_not_report(
    backend: str, state: tuple[int, int] | None, word: str
) -> None:
    with flying(backend, limit_s=1.0, flight=replace(FLIGHT, vehicle_type=mavlink.MAV_TYPE_FIXED_WING)) as (
        autopilot, pointing, _,
    ):  # fmt: skip
        flies, autopilot.extended_state = autopilot.extended_state, state
        words: list[str] = []
        assert eventually(lambda: words.append(pointing.command(ABOUT_HILL)) or words[-1] != NO_AUTOPILOT)
        assert words[-1] == word and commands(autopilot) == [] and autopilot.circle is None
        assert pointing.command(HILL) == ACCEPTED  # its camera may be turned all the same
        autopilot.extended_state = flies
        assert pointing.command(ABOUT_HILL) == ACCEPTED  # asked again for each


def test_the_height_is_the_autopilots_own_of_now() -> None:
    now_s = [100.0]
    pointing = Pointing(191, monotonic_s=lambda: now_s[0])
    assert pointing.height_amsl_m() is None
    for system, component, height_mm in ((7, 1, 712_300), (8, 1, 5_000), (7, 100, 6_000)):
        message = mavlink.MAVLink_global_position_int_message(1000, 1, 2, height_mm, 4, 5, 6, 7, 8)
        (message,) = mavlink.MAVLink(None).parse_buffer(message.pack(mavlink.MAVLink(None, system, component)))
        pointing.receive(message, 7)
    assert pointing.height_amsl_m() == 712.3
    now_s[0] += 2.1
    assert pointing.height_amsl_m() is None


@pytest.mark.parametrize(
    ("result", "word"),
    [
        (mavlink.MAV_RESULT_DENIED, "denied"),
        (mavlink.MAV_RESULT_UNSUPPORTED, "unsupported"),
        (mavlink.MAV_RESULT_TEMPORARILY_REJECTED, "temporarily_rejected"),
        (mavlink.MAV_RESULT_FAILED, "failed"),
        (9, "command_unsupported_mav_frame"),
        (99, "result 99"),
    ],
)
def test_a_refusal_has_the_autopilots_word(result: int, word: str) -> None:
    with flying() as (autopilot, pointing, _):
        autopilot.roi_results.append(result)
        assert pointing.command(HILL) == word
        assert autopilot.roi is None and len(commands(autopilot)) == 1


def test_what_is_lost_is_sent_again_and_not_for_ever() -> None:
    with flying() as (autopilot, pointing, _):
        autopilot.roi_results.extend([None, int(mavlink.MAV_RESULT_ACCEPTED)])
        assert pointing.command(HILL) == ACCEPTED
        assert len(commands(autopilot)) == 2
    with flying(limit_s=3.0) as (autopilot, pointing, _):
        autopilot.roi_results.extend([None] * 20)
        assert pointing.command(HILL) == NOT_ACKNOWLEDGED
        assert 1 <= len(commands(autopilot)) <= MOST_SENT


def test_over_a_line_that_loses_a_third_of_all_packets_it_is_never_sent_more_than_thrice() -> None:
    with flying(limit_s=4.0, faults=Faults(loss=0.3), seed=3) as (autopilot, pointing, received):
        words = []
        for _ in range(4):
            received.wait(State.OK)
            before = len(commands(autopilot))
            words.append(pointing.command(HILL))
            assert len(commands(autopilot)) - before <= MOST_SENT
        assert ACCEPTED in words and set(words) <= {ACCEPTED, NOT_ACKNOWLEDGED}


def test_an_autopilot_that_is_at_it_is_waited_for_and_not_asked_again() -> None:
    with flying() as (autopilot, pointing, _):
        autopilot.roi_results.append(int(mavlink.MAV_RESULT_IN_PROGRESS))
        words: list[str] = []

        def is_sent() -> bool:
            return bool(commands(autopilot))

        asking = threading.Thread(target=lambda: words.append(pointing.command(HILL)))
        asking.start()
        assert eventually(is_sent)
        done = mavlink.MAVLink_command_ack_message(
            mavlink.MAV_CMD_DO_SET_ROI_LOCATION, mavlink.MAV_RESULT_ACCEPTED, 0, 0, autopilot.system, 191
        )
        autopilot.send_bytes(bytes(done.pack(mavlink.MAVLink(None, autopilot.system, 1))))
        asking.join(PATIENCE_S)
        assert words == [ACCEPTED] and len(commands(autopilot)) == 1


def acknowledgement(command: int, system: int, component: int, to: tuple[int, int]) -> Any:
    message = mavlink.MAVLink_command_ack_message(command, mavlink.MAV_RESULT_ACCEPTED, 0, 0, *to)
    (found,) = mavlink.MAVLink(None).parse_buffer(message.pack(mavlink.MAVLink(None, system, component)))
    return found


def test_only_the_autopilots_own_acknowledgement_of_our_own_command_counts() -> None:
    """As a ground station has the same camera look elsewhere, and another vehicle is on the line."""
    pointing = Pointing(191, 0.3)
    location, none = mavlink.MAV_CMD_DO_SET_ROI_LOCATION, mavlink.MAV_CMD_DO_SET_ROI_NONE
    words: list[str] = []
    asking = threading.Thread(target=lambda: words.append(pointing.command(HILL)))
    asking.start()
    assert eventually(lambda: pointing.due(10**9, 7))
    for foreign in (
        acknowledgement(location, 8, 1, (7, 191)),
        acknowledgement(location, 7, 154, (7, 191)),
        acknowledgement(location, 7, 1, (255, 190)),
        acknowledgement(none, 7, 1, (7, 191)),
    ):
        pointing.receive(foreign, 7)
    asking.join(PATIENCE_S)
    assert words == [NOT_ACKNOWLEDGED]
    assert pointing.due(10**10, 7) == []  # what no one waits for any more is not sent


def test_nothing_is_sent_to_an_autopilot_that_is_silent() -> None:
    with flying(limit_s=0.5) as (autopilot, pointing, received):
        autopilot.mute(PATIENCE_S)
        received.wait(State.LOST)
        before = len(commands(autopilot))
        assert pointing.command(HILL) == NO_AUTOPILOT
        assert len(commands(autopilot)) == before == 0


def test_by_default_nothing_is_ever_sent_that_moves_anything() -> None:
    with FakeAutopilot(FLIGHT, f"udpout:127.0.0.1:{free_udp_port()}", loop=True) as autopilot:
        with listening(config_for(autopilot.url)) as received:
            received.wait(State.OK)
        kinds = {message.get_type() for message in list(autopilot.received)}
        asked = {message.command for message in autopilot.received_of("COMMAND_LONG")}
        assert "COMMAND_INT" not in kinds
        assert asked <= {mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAV_CMD_REQUEST_MESSAGE}
