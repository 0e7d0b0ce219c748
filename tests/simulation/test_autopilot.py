"""The fake autopilot against plain pymavlink: that it plays, keeps time, grants and refuses as the real ones do."""

from __future__ import annotations

import itertools
import os
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from simulation.autopilot.fake import FakeAutopilot, Faults
from simulation.autopilot.flight import Flight

pytestmark = pytest.mark.wall_clock

TLOG = Path(__file__).resolve().parents[1] / "data" / "plane_turn.tlog"


@pytest.fixture(scope="module")
def flight() -> Flight:
    return Flight.read(TLOG)


class Station:
    """The other end of a UDP link, without anything of ours: collects what it hears, sends what it is given."""

    def __init__(self) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(0.02)
        self.url = f"udpout:127.0.0.1:{self.socket.getsockname()[1]}"
        self.peer: Any = None
        self.parser = mavlink.MAVLink(None, 1, 191)
        self.parser.robust_parsing = True
        self.heard: list[Any] = []

    def send(self, message: Any) -> None:
        self.socket.sendto(message.pack(self.parser), self.peer)

    def listen(self, seconds: float) -> list[Any]:
        new: list[Any] = []
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            try:
                data, self.peer = self.socket.recvfrom(4096)
            except TimeoutError:
                continue
            new += [m for m in self.parser.parse_buffer(data) or [] if m.get_type() != "BAD_DATA"]
        self.heard += new
        return new

    def ask(self, message_id: int, rate_hz: float) -> int:
        """SET_MESSAGE_INTERVAL; returns the result of its acknowledgement."""
        command = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
        self.send(mavlink.MAVLink_command_long_message(1, 1, command, 0, message_id, 1e6 / rate_hz, 0, 0, 0, 0, 0))
        acks = [m for m in self.listen(0.3) if m.get_type() == "COMMAND_ACK"]
        assert [ack.command for ack in acks] == [command]
        assert (acks[0].target_system, acks[0].target_component) == (1, 191)
        return int(acks[0].result)


@pytest.fixture
def station() -> Iterator[Station]:
    end = Station()
    yield end
    end.socket.close()


def named(messages: list[Any], name: str) -> list[Any]:
    return [m for m in messages if m.get_type() == name]


def test_ardupilot_denies_fifty_and_gives_what_it_grants(flight: Flight, station: Station) -> None:
    with FakeAutopilot(flight, station.url):
        before = named(station.listen(1.0), "ATTITUDE")
        assert 2 <= len(before) <= 6  # unasked
        assert station.ask(mavlink.MAVLINK_MSG_ID_ATTITUDE, 50.0) == mavlink.MAV_RESULT_DENIED
        assert station.ask(mavlink.MAVLINK_MSG_ID_ATTITUDE, 20.0) == mavlink.MAV_RESULT_ACCEPTED
        assert 15 <= len(named(station.listen(1.0), "ATTITUDE")) <= 23
        assert station.ask(mavlink.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS, 5.0) == mavlink.MAV_RESULT_FAILED


def test_px4_grants_fifty_and_reports_its_filter_its_own_way(flight: Flight, station: Station) -> None:
    with FakeAutopilot(flight, station.url, style="px4"):
        station.listen(0.2)
        assert station.ask(mavlink.MAVLINK_MSG_ID_ATTITUDE, 50.0) == mavlink.MAV_RESULT_ACCEPTED
        heard = station.listen(1.5)
        assert len(named(heard, "ATTITUDE")) >= 30
        assert not named(station.heard, "EKF_STATUS_REPORT")
        assert {m.autopilot for m in named(station.heard, "HEARTBEAT")} == {mavlink.MAV_AUTOPILOT_PX4}


def test_an_old_autopilot_knows_streams_only(flight: Flight, station: Station) -> None:
    with FakeAutopilot(flight, station.url, style="old"):
        assert {m.get_type() for m in station.listen(0.5)} <= {"HEARTBEAT", "TIMESYNC"}
        assert station.ask(mavlink.MAVLINK_MSG_ID_ATTITUDE, 10.0) == mavlink.MAV_RESULT_UNSUPPORTED
        station.send(mavlink.MAVLink_request_data_stream_message(1, 1, mavlink.MAV_DATA_STREAM_EXTRA1, 10, 1))
        assert 7 <= len(named(station.listen(1.0), "ATTITUDE")) <= 13


def test_its_boot_clock_drifts_as_told_and_answers_timesync(flight: Flight, station: Station) -> None:
    with FakeAutopilot(flight, station.url, drift=0.02) as autopilot:
        station.listen(0.2)
        readings = []
        for _ in range(2):
            station.send(mavlink.MAVLink_timesync_message(0, time.monotonic_ns()))
            answer = next(m for m in station.listen(0.1) if m.get_type() == "TIMESYNC" and m.tc1)
            readings.append((answer.ts1, answer.tc1))
            assert abs(autopilot.monotonic_ns(answer.tc1) - answer.ts1) < 50_000_000
            station.listen(1.0)
        (sent_a, boot_a), (sent_b, boot_b) = readings
        assert (boot_b - boot_a) / (sent_b - sent_a) == pytest.approx(1.02, abs=0.015)


def test_a_reboot_starts_the_boot_clock_again_and_forgets_rates(flight: Flight, station: Station) -> None:
    with FakeAutopilot(flight, station.url) as autopilot:
        station.listen(0.2)
        station.ask(mavlink.MAVLINK_MSG_ID_ATTITUDE, 25.0)
        stamps = [m.time_boot_ms for m in named(station.listen(0.5), "ATTITUDE")]
        assert len(stamps) >= 8 and min(stamps) > 200_000
        autopilot.reboot(0.5)
        fresh = [m.time_boot_ms for m in named(station.listen(2.0), "ATTITUDE") if m.time_boot_ms < 100_000]
        assert 3 <= len(fresh) <= 9
        assert 1400 <= fresh[0] <= 2000
        assert autopilot.boots == 2


def test_it_loses_and_corrupts_about_as_told(flight: Flight, station: Station) -> None:
    with FakeAutopilot(flight, station.url, everything=True, faults=Faults(loss=0.3, corrupt=0.2)) as autopilot:
        heard = station.listen(2.5)
    assert 0.35 < len(heard) / autopilot.counts.total() < 0.75


def test_delay_is_kept_both_ways(flight: Flight, station: Station) -> None:
    with FakeAutopilot(flight, station.url, faults=Faults(delay_s=0.1)):
        station.listen(0.5)
        sent = time.monotonic()
        station.send(mavlink.MAVLink_timesync_message(0, 123))
        while not any(m.get_type() == "TIMESYNC" and m.tc1 for m in station.listen(0.02)):
            assert time.monotonic() - sent < 1.0
        assert 0.19 < time.monotonic() - sent < 0.5


@pytest.mark.parametrize("url", ["tcpin:127.0.0.1:0", "udpin:127.0.0.1:0", "pty"])
def test_every_wire_carries_packets_both_ways(flight: Flight, url: str) -> None:
    with FakeAutopilot(flight, url, everything=True) as autopilot:
        scheme, address = autopilot.url.split(":", 1)
        hello = mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3).pack(mavlink.MAVLink(None, 1, 191))
        end: Any = None
        read: Callable[[], bytes]
        if scheme == "serial":
            end = os.open(address.rpartition(":")[0], os.O_RDWR | os.O_NOCTTY)
            os.write(end, hello)
            read = lambda: os.read(end, 4096)  # noqa: E731
        else:
            host, _, port = address.rpartition(":")
            kind = socket.SOCK_STREAM if scheme == "tcp" else socket.SOCK_DGRAM
            end = socket.socket(socket.AF_INET, kind)
            end.settimeout(1.0)
            end.connect((host, int(port)))
            end.send(hello)
            read = lambda: end.recv(4096)  # noqa: E731
        parser, names = mavlink.MAVLink(None), set()
        parser.robust_parsing = True
        deadline = time.monotonic() + 3.0
        while time.monotonic() < deadline and not {"ATTITUDE", "HEARTBEAT", "GLOBAL_POSITION_INT"} <= names:
            names |= {m.get_type() for m in parser.parse_buffer(read()) or []}
        assert {"ATTITUDE", "HEARTBEAT", "GLOBAL_POSITION_INT"} <= names
        assert autopilot.heard_of("HEARTBEAT")[0].type == 18
        if scheme == "serial":
            os.close(end)
        else:
            end.close()


def test_a_recording_in_a_loop_never_turns_its_clock_back(flight: Flight, station: Station) -> None:
    short = Flight(flight.due_ns[:40], flight.messages[:40], flight.log_offset_ns, 1, 1)
    with FakeAutopilot(short, station.url, everything=True, loop=True) as autopilot:
        stamps = [m.time_boot_ms for m in named(station.listen(2.5), "ATTITUDE")]
    assert not autopilot.is_over
    assert stamps == sorted(stamps)
    assert 1800 < stamps[-1] - stamps[0] < 2800


def test_rates_hold_from_one_round_of_a_loop_to_the_next(flight: Flight, station: Station) -> None:
    short = Flight(flight.due_ns[:40], flight.messages[:40], flight.log_offset_ns, 1, 1)
    with FakeAutopilot(short, station.url, loop=True) as autopilot:
        heard = named(station.listen(3.0), "ATTITUDE")
    assert 9 <= len(heard) <= 14  # four a second, unasked
    assert autopilot.counts["ATTITUDE"] >= len(heard)


def test_silence_over_the_end_of_a_loop_is_not_made_up_for(flight: Flight, station: Station) -> None:
    """What was due meanwhile came all at once, which fills a serial line that nobody empties as fast."""
    short = Flight(flight.due_ns[:40], flight.messages[:40], flight.log_offset_ns, 1, 1)
    with FakeAutopilot(short, station.url, everything=True, loop=True) as autopilot:
        before = named(station.listen(0.4), "ATTITUDE")
        autopilot.mute(3.0)  # three rounds and a half
        after = named(station.listen(4.0), "ATTITUDE")
    silent = [m for m in after if 300 < m.time_boot_ms - before[-1].time_boot_ms < 2900]
    assert not silent
    assert 10 <= len(after) <= 40  # a second at 25 Hz
    stamps = [m.time_boot_ms for m in after]
    assert stamps == sorted(stamps)


class TenTimes:
    """A clock that runs ten times as fast as the host's."""

    def now_ns(self) -> int:
        return 10 * time.monotonic_ns()

    def wall_s(self, ns: int) -> float:
        return ns / 1e10


def test_by_another_clock_it_lives_as_fast_as_that(flight: Flight, station: Station) -> None:
    with FakeAutopilot(flight, station.url, everything=True, clock=TenTimes()):
        stamps = [m.time_boot_ms for m in named(station.listen(1.0), "ATTITUDE")]
    assert 7500 < stamps[-1] - stamps[0] < 11500
    assert max(b - a for a, b in itertools.pairwise(stamps)) < 400


def test_what_is_spoilt_is_sent_as_it_is_left(flight: Flight, station: Station) -> None:
    def spoil(now_ns: int, message: Any) -> Any:
        if message.get_type() == "GLOBAL_POSITION_INT":
            message.relative_alt = 7
        return None if message.get_type() == "ATTITUDE" else message

    with FakeAutopilot(flight, station.url, everything=True, spoil=spoil):
        heard = station.listen(1.0)
    assert {m.relative_alt for m in named(heard, "GLOBAL_POSITION_INT")} == {7}
    assert not named(heard, "ATTITUDE")
    assert all(m.relative_alt != 7 for m in flight.messages if m.get_type() == "GLOBAL_POSITION_INT")
