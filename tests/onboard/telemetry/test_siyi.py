"""SIYI's protocol, by its manual's own examples, and a gimbal that speaks it over loopback."""

import math
import socket
import struct
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from contract.errors import ConfigError
from contract.rotations import matrix_from_euler, matrix_from_quaternion
from onboard.config.schema import parse_config
from onboard.events.session_clock import SessionClock
from onboard.events.source import SourceStatus, State
from onboard.events.types import GimbalAttitude, Zoom
from onboard.telemetry.factory import open_telemetry
from onboard.telemetry.siyi_protocol import ATTITUDE, ZOOM, Packet, PacketReader, attitude_deg, encode, zoom_times
from onboard.telemetry.siyi_source import SiyiAnswers, SiyiGimbal, WithGimbal, siyi_address
from tests.onboard.link.ports import free_udp_port
from tests.onboard.telemetry.listening import Listening

MS = 1_000_000
# The manual's examples, checksum and all: request of the attitude, of the firmware, of the zoom; centre the gimbal.
EXAMPLES = {
    "556601000000000de805": Packet(0x0D),
    "556601000000000164c4": Packet(0x01),
    "55660100000000187c47": Packet(0x18),
    "556601010000000801d112": Packet(0x08, b"\x01"),
}
packets = st.builds(Packet, st.integers(0, 255), st.binary(max_size=40), st.integers(0, 65535), st.integers(0, 255))


@pytest.mark.parametrize("text", EXAMPLES)
def test_the_manual_s_examples_are_written_and_read(text: str) -> None:
    data = bytes.fromhex(text)
    assert encode(EXAMPLES[text]) == data
    assert list(PacketReader().feed(data)) == [EXAMPLES[text]]


@given(st.lists(packets, max_size=5), st.integers(1, 7))
def test_packets_come_back_in_whatever_pieces(sent: list[Packet], size: int) -> None:
    data, reader = b"".join(encode(p) for p in sent), PacketReader()
    got = [p for at in range(0, len(data), size) for p in reader.feed(data[at : at + size])]
    assert got == sent and reader.garbage == 0 and reader.damaged == 0


@given(st.binary(max_size=60), packets, st.integers(0, 400))
def test_garbage_before_a_packet_and_a_flipped_bit_cost_no_more_than_themselves(
    garbage: bytes, packet: Packet, bit: int
) -> None:
    whole = encode(packet)
    bad = bytearray(whole)
    bad[(bit // 8) % len(bad)] ^= 1 << bit % 8
    reader = PacketReader()
    got = list(reader.feed(garbage.replace(b"U", b"V") + bytes(bad) + whole + b"\0" * 300))
    assert got.count(packet) >= 1 and packet == got[-1]
    assert len(got) <= 2


def angles(yaw: float, pitch: float, roll: float) -> bytes:
    return struct.pack("<6h", *(round(10 * a) for a in (yaw, pitch, roll)), 1, -2, 3)


def test_an_attitude_is_in_tenths_of_a_degree_and_its_yaw_counts_the_other_way_round() -> None:
    assert attitude_deg(Packet(ATTITUDE, bytes.fromhex("0000f2fe0000000000000000"))) == (0.0, -27.0, -0.0)
    assert attitude_deg(Packet(ATTITUDE, angles(-12.5, -90.0, 1.5))) == (1.5, -90.0, 12.5)


@pytest.mark.parametrize(
    "packet",
    [
        Packet(ATTITUDE, angles(0, -30, 0)[:-1]),
        Packet(0x0E, angles(0, -30, 0)),
        Packet(ATTITUDE, angles(0, -200, 0)),
        Packet(ATTITUDE, angles(700, 0, 0)),
    ],
)
def test_what_is_no_attitude_is_none(packet: Packet) -> None:
    assert attitude_deg(packet) is None


@pytest.mark.parametrize(
    ("data", "times"), [("0400", 4.0), ("1e05", 30.5), ("0000", None), ("010a", None), ("01", None), ("", None)]
)
def test_a_zoom_is_a_whole_number_and_tenths(data: str, times: float | None) -> None:
    assert zoom_times(Packet(ZOOM, bytes.fromhex(data))) == times


def test_an_answer_counts_for_the_middle_of_its_round_trip() -> None:
    answers = SiyiAnswers()
    asked = [p for request in answers.due(1000 * MS) for p in PacketReader().feed(request)]
    assert [p.command for p in asked] == [ATTITUDE, ZOOM]
    assert not answers.due(1100 * MS)  # both are open
    got = answers.take(encode(Packet(ATTITUDE, angles(0, -45, 0), 0, 2)) + encode(Packet(ZOOM, b"\x02\x05")), 1030 * MS)
    assert [(type(e), e.stamp_ns) for e in got] == [(GimbalAttitude, 1015 * MS), (Zoom, 1015 * MS)]
    assert got[1] == Zoom(1015 * MS, 2.5, "times", 0.1)
    # One that no one asked for, and one that comes after it was asked for again, say nothing of when.
    assert not answers.take(encode(Packet(ATTITUDE, angles(0, -45, 0))), 1035 * MS)
    assert answers.due(1041 * MS) and not answers.take(encode(Packet(ATTITUDE, angles(0, -45, 0))), 1300 * MS)
    assert answers.due(1301 * MS)


def test_a_lost_answer_is_asked_for_again() -> None:
    answers = SiyiAnswers()
    answers.due(0)
    assert not answers.due(200 * MS) and len(answers.due(251 * MS)) == 2


class FakeGimbal:
    def __init__(self) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(0.05)
        self.port = self.socket.getsockname()[1]
        self.is_silent = self.is_damaging = False
        self.stop = threading.Event()

    def run(self) -> None:
        data = {ATTITUDE: angles(-30.0, -60.0, 0.0), ZOOM: b"\x03\x02"}
        while not self.stop.is_set():
            try:
                request, peer = self.socket.recvfrom(100)
            except TimeoutError:
                continue
            for packet in PacketReader().feed(request):
                out = bytearray(encode(Packet(packet.command, data[packet.command], packet.sequence, 2)))
                out[9] ^= 16 if self.is_damaging else 0
                if not self.is_silent:
                    self.socket.sendto(bytes(out), peer)


@contextmanager
def simulated() -> Iterator[tuple[FakeGimbal, Listening]]:
    gimbal = FakeGimbal()
    config = parse_config(
        f"[mount]\ngimbal_url = 'siyi:127.0.0.1:{gimbal.port}'\n[telemetry]\nurl = 'udpin:127.0.0.1:0'\n"
        "lost_after_s = 0.4".replace("127.0.0.1:0'", f"127.0.0.1:{free_udp_port()}'")
    )
    clock = SessionClock.start()
    received = Listening(open_telemetry(config, clock), clock)
    threads = [threading.Thread(target=run, daemon=True) for run in (gimbal.run, received.run)]
    for thread in threads:
        thread.start()
    try:
        yield gimbal, received
    finally:
        gimbal.stop.set()
        received.stop.set()
        for thread in threads:
            thread.join(10.0)
        gimbal.socket.close()
        assert not any(t.is_alive() for t in threads) and not received.faults


@pytest.mark.wall_clock(waits=True)
def test_a_gimbal_next_to_the_autopilot_is_asked_and_its_silence_and_damage_are_survived() -> None:
    with simulated() as (gimbal, received):
        received.until(lambda: len(received.of(GimbalAttitude)) > 10 and received.of(Zoom))
        event = received.of(GimbalAttitude)[-1]
        R = matrix_from_euler(0.0, math.radians(-60.0), math.radians(30.0))
        assert event.reference == "vehicle" and np.allclose(matrix_from_quaternion(event.q_ref_gimbal), R)
        assert received.of(Zoom)[-1].value == 3.2 and received.of(Zoom)[-1].unit == "times"
        assert received.source.health().figures["gimbal_round_trip_ms"] < 100.0
        gimbal.is_damaging = True
        received.until(lambda: received.source.health().figures["gimbal_damaged"] > 2)
        gimbal.is_damaging, gimbal.is_silent = False, True
        count = len(received.of(GimbalAttitude))
        gimbal.is_silent = False
        received.until(lambda: len(received.of(GimbalAttitude)) > count + 5)


def test_a_silent_gimbal_degrades_telemetry_that_is_well() -> None:
    class Well:
        def health(self) -> SourceStatus:
            return SourceStatus(State.OK, "", {"position_hz": 10.0})

    gimbal = SiyiGimbal(SessionClock.start(), siyi_address("siyi:127.0.0.1:9"), 0.4)
    health = WithGimbal(Well(), gimbal).health()
    assert health.state is State.DEGRADED and health.detail == "the gimbal has not answered yet"
    assert health.figures["position_hz"] == 10.0 and health.figures["gimbal_damaged"] == 0.0


@pytest.mark.parametrize("url", ["siyi:192.168.144.25", "viewpro:1.2.3.4:5", "siyi::1", "siyi:host:70000"])
def test_a_gimbal_s_url_that_can_never_work_is_one_line(url: str) -> None:
    config = parse_config(f"[mount]\ngimbal_url = '{url}'")
    with pytest.raises(ConfigError, match=r"mount\.gimbal_url"):
        open_telemetry(config, SessionClock.start())
