"""What passes through the autopilot, to whom, and which ground stations the autopilot has."""

from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from contract.errors import ConfigError
from contract.wire.click_code import MAX_ANSWER_BYTES, TUNNEL_TYPE
from onboard.config.schema import parse_config
from onboard.events.session_clock import SessionClock
from onboard.events.tunnel import Peer
from onboard.telemetry.factory import open_telemetry
from onboard.telemetry.ground_stations import MAX_TRIES
from onboard.telemetry.mavlink_passage import Passage, tunnelled

SYSTEM, COMPONENT = 7, 191
SECOND_NS = 1_000_000_000


class Tunnel:
    def __init__(self) -> None:
        self.received: list[tuple[Peer, bytes]] = []
        self.ready: list[tuple[Peer, bytes]] = []
        self.ground_stations = (255, 255)
        self.free_percent = -1

    def receive(self, ground: Peer, payload: bytes) -> None:
        self.received.append((ground, payload))

    def due(self) -> list[tuple[Peer, bytes]]:
        out, self.ready = self.ready, []
        return out

    def know_ground_stations(self, low: int, high: int) -> None:
        self.ground_stations = low, high

    def note_radio(self, free_percent: int) -> None:
        self.free_percent = free_percent


@pytest.fixture
def tunnel() -> Tunnel:
    return Tunnel()


@pytest.fixture
def passage(tunnel: Tunnel) -> Passage:
    return Passage(parse_config("[telemetry]\ncomponent = 191\n"), tunnel)


def received(message: Any, system: int = 245, component: int = 25) -> Any:
    """A message as it comes over the wire, from such a sender."""
    packet = message.pack(mavlink.MAVLink(None, system, component))
    (found,) = mavlink.MAVLink(None).parse_buffer(packet)
    return found


def parameter(name: str, value: float) -> Any:
    return received(mavlink.MAVLink_param_value_message(name.encode(), value, 9, 1, 0), SYSTEM, 1)


@pytest.mark.parametrize("payload", [b"\x11click", b"\x00", bytes(24), b"x" * 128])
def test_a_packet_for_us_is_passed_on_whole_with_its_sender(passage: Passage, tunnel: Tunnel, payload: bytes) -> None:
    passage.receive(received(tunnelled(SYSTEM, COMPONENT, payload)), SYSTEM)
    assert tunnel.received == [(Peer(245, 25), payload)]


def test_what_a_radio_on_the_line_reports_of_its_buffer_is_noted(passage: Passage, tunnel: Tunnel) -> None:
    passage.receive(received(mavlink.MAVLink_radio_status_message(180, 170, 12, 60, 61, 3, 0), 51, 68), SYSTEM)
    assert tunnel.free_percent == 12


def test_what_is_for_others_or_of_another_kind_is_passed_over(passage: Passage, tunnel: Tunnel) -> None:
    other_kind = mavlink.MAVLink_tunnel_message(SYSTEM, COMPONENT, TUNNEL_TYPE + 1, 1, [1] + [0] * 127)
    others = [tunnelled(SYSTEM, 1, b"x"), tunnelled(8, COMPONENT, b"x"), tunnelled(0, 0, b"x"), other_kind]
    for message in others:
        passage.receive(received(message), SYSTEM)
    passage.receive(received(tunnelled(SYSTEM, COMPONENT, b"x")), None)
    assert tunnel.received == []


def test_what_is_sent_is_addressed_to_one_ground_and_short_on_the_wire(passage: Passage, tunnel: Tunnel) -> None:
    tunnel.ready = [(Peer(245, 25), b"y" * MAX_ANSWER_BYTES)]
    (sent,) = [m for m in passage.due(0, SYSTEM) if m.get_type() == "TUNNEL"]
    packet = sent.pack(mavlink.MAVLink(None, SYSTEM, COMPONENT))
    assert (sent.target_system, sent.target_component, len(packet)) == (245, 25, MAX_ANSWER_BYTES + 17)


def beat(passage: Passage, autopilot: int = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA) -> None:
    passage.receive(received(mavlink.MAVLink_heartbeat_message(2, autopilot, 0, 0, 4, 3), SYSTEM, 1), SYSTEM)


def asked(passage: Passage, at_s: int) -> list[str]:
    return [m.param_id for m in passage.due(at_s * SECOND_NS, SYSTEM)]


def test_the_ground_stations_numbers_are_asked_of_the_autopilot_until_they_are_known(
    passage: Passage, tunnel: Tunnel
) -> None:
    assert asked(passage, 0) == []  # not before it is known to be an ArduPilot
    beat(passage)
    assert asked(passage, 0) == ["MAV_GCS_SYSID", "MAV_GCS_SYSID_HI"]
    assert asked(passage, 1) == []
    passage.receive(parameter("MAV_GCS_SYSID", 240.0), SYSTEM)
    assert tunnel.ground_stations == (240, 240)
    assert asked(passage, 3) == ["MAV_GCS_SYSID_HI"]
    passage.receive(parameter("MAV_GCS_SYSID_HI", 250.0), SYSTEM)
    assert tunnel.ground_stations == (240, 250)
    assert asked(passage, 60) == []


def test_nothing_of_a_ground_s_is_taken_while_its_number_may_be_a_ground_station_s(
    passage: Passage, tunnel: Tunnel
) -> None:
    question = received(tunnelled(SYSTEM, COMPONENT, b"x"))
    beat(passage)
    passage.receive(question, SYSTEM)
    passage.receive(parameter("MAV_GCS_SYSID", 240.0), SYSTEM)
    passage.receive(question, SYSTEM)
    assert tunnel.received == []
    passage.receive(parameter("MAV_GCS_SYSID_HI", 250.0), SYSTEM)
    passage.receive(question, SYSTEM)
    assert tunnel.received == [(Peer(245, 25), b"x")]


def test_an_autopilot_that_reports_no_range_has_the_usual_one(passage: Passage, tunnel: Tunnel) -> None:
    beat(passage)
    for at_s in range(20):
        passage.receive(received(tunnelled(SYSTEM, COMPONENT, bytes([at_s]))), SYSTEM)
        passage.due(at_s * SECOND_NS, SYSTEM)
    taken_s = [payload[0] for _, payload in tunnel.received]
    assert taken_s == list(range(taken_s[0], 20)) and 8 <= taken_s[0] <= 12


def test_an_older_autopilot_is_asked_by_the_older_name_and_none_for_ever(passage: Passage, tunnel: Tunnel) -> None:
    beat(passage)
    found = [names for at_s in range(100) if (names := asked(passage, at_s))]
    assert len(found) == MAX_TRIES
    assert all("SYSID_MYGCS" not in names for names in found[:2]) and all("SYSID_MYGCS" in names for names in found[2:])
    passage.receive(parameter("SYSID_MYGCS", 252.0), SYSTEM)
    assert tunnel.ground_stations == (252, 252)
    passage.receive(parameter("SYSID_MYGCS", 1.0), SYSTEM + 1)  # not our vehicle's
    assert tunnel.ground_stations == (252, 252)


def test_px4_is_asked_for_no_parameter_it_would_report_to_its_pilot(passage: Passage) -> None:
    beat(passage, mavlink.MAV_AUTOPILOT_PX4)
    assert [asked(passage, at_s) for at_s in range(100)] == [[]] * 100


@pytest.mark.parametrize("text", ['url = "nmea:/dev/ttyUSB0:9600"', 'backend = "mavsdk"'])
def test_without_an_autopilot_to_pass_through_it_is_reported(tunnel: Tunnel, text: str) -> None:
    with pytest.raises(ConfigError, match=r"link\.mavlink needs a live autopilot"):
        open_telemetry(parse_config(f"[telemetry]\n{text}\n"), SessionClock.start(), tunnel)
