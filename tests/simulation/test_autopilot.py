"""The fake autopilot against plain pymavlink: that it plays, keeps time, grants and refuses as the real ones do."""

import itertools
import os
import socket
import statistics
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from simulation.autopilot.fake import FakeAutopilot, Faults
from simulation.autopilot.flight import Flight
from tests.waiting import PATIENCE_S

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
        self.came: list[Any] = []

    def send(self, message: Any) -> None:
        self.socket.sendto(message.pack(self.parser), self.peer)

    def listen(self, seconds: float) -> list[Any]:
        new: list[Any] = []
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            new += self.receive()
        return new

    def receive(self) -> list[Any]:
        """What one datagram held, if one comes in a moment."""
        try:
            data, self.peer = self.socket.recvfrom(4096)
        except TimeoutError:
            return []
        new = [m for m in self.parser.parse_buffer(data) or [] if m.get_type() != "BAD_DATA"]
        self.came += new
        return new

    def until(self, is_enough: Callable[[list[Any]], object]) -> list[Any]:
        """Listen until what was received meanwhile is enough; this is what was received."""
        new: list[Any] = []
        end = time.monotonic() + PATIENCE_S
        while not is_enough(new):
            assert time.monotonic() < end, [m.get_type() for m in new]
            new += self.receive()
        return new

    def next_of(self, name: str, count: int) -> list[Any]:
        """The next `count` messages of this name, and those that came with the last of them."""
        return named(self.until(lambda new: len(named(new, name)) >= count), name)

    def exchange(self) -> tuple[int, int, int]:
        """A TIMESYNC and its answer: when it was sent, the boot clock's reading, when the answer was there."""
        sent_ns = time.monotonic_ns()
        self.send(mavlink.MAVLink_timesync_message(0, sent_ns))
        answers: list[Any] = []
        while not answers:
            new = self.until(lambda new: named(new, "TIMESYNC"))
            answers = [m for m in named(new, "TIMESYNC") if m.tc1 and m.ts1 == sent_ns]
        return sent_ns, answers[0].tc1, time.monotonic_ns()

    def ask(self, message_id: int, rate_hz: float) -> int:
        """SET_MESSAGE_INTERVAL; returns the result of its acknowledgement."""
        command = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
        self.send(mavlink.MAVLink_command_long_message(1, 1, command, 0, message_id, 1e6 / rate_hz, 0, 0, 0, 0, 0))
        acks = self.next_of("COMMAND_ACK", 1)
        assert [ack.command for ack in acks] == [command]
        assert (acks[0].target_system, acks[0].target_component) == (1, 191)
        return int(acks[0].result)


@pytest.fixture
def station() -> Iterator[Station]:
    end = Station()
    yield end
    end.socket.close()


def rate_hz(messages: list[Any]) -> float:
    """By their own stamps: when a busy machine got to read them does not matter, nor a while in which none was sent."""
    gaps_ms = [b.time_boot_ms - a.time_boot_ms for a, b in itertools.pairwise(messages)]
    usual_ms = statistics.median(gaps_ms)
    return 1e3 / statistics.mean(gap_ms for gap_ms in gaps_ms if gap_ms <= 4.0 * usual_ms)


def span_ms(messages: list[Any]) -> float:
    return messages[-1].time_boot_ms - messages[0].time_boot_ms if messages else 0.0


def named(messages: list[Any], name: str) -> list[Any]:
    return [m for m in messages if m.get_type() == name]


def test_ardupilot_denies_fifty_and_gives_what_it_grants(flight: Flight, station: Station) -> None:
    with FakeAutopilot(flight, station.url):
        assert 3.0 <= rate_hz(station.next_of("ATTITUDE", 5)) <= 5.0  # unasked
        assert station.ask(mavlink.MAVLINK_MSG_ID_ATTITUDE, 50.0) == mavlink.MAV_RESULT_DENIED
        assert station.ask(mavlink.MAVLINK_MSG_ID_ATTITUDE, 20.0) == mavlink.MAV_RESULT_ACCEPTED
        assert 15.0 <= rate_hz(station.next_of("ATTITUDE", 20)) <= 23.0
        assert station.ask(mavlink.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS, 5.0) == mavlink.MAV_RESULT_FAILED


def test_px4_grants_fifty_and_reports_its_filter_its_own_way(flight: Flight, station: Station) -> None:
    with FakeAutopilot(flight, station.url, style="px4"):
        station.next_of("HEARTBEAT", 1)
        assert station.ask(mavlink.MAVLINK_MSG_ID_ATTITUDE, 50.0) == mavlink.MAV_RESULT_ACCEPTED
        assert 20.0 <= rate_hz(station.next_of("ATTITUDE", 30)) <= 55.0
        assert not named(station.came, "EKF_STATUS_REPORT")
        assert {m.autopilot for m in named(station.came, "HEARTBEAT")} == {mavlink.MAV_AUTOPILOT_PX4}


def test_an_old_autopilot_knows_streams_only(flight: Flight, station: Station) -> None:
    with FakeAutopilot(flight, station.url, style="old"):
        station.next_of("HEARTBEAT", 1)
        station.listen(0.5)
        assert {m.get_type() for m in station.came} <= {"HEARTBEAT", "TIMESYNC"}
        assert station.ask(mavlink.MAVLINK_MSG_ID_ATTITUDE, 10.0) == mavlink.MAV_RESULT_UNSUPPORTED
        station.send(mavlink.MAVLink_request_data_stream_message(1, 1, mavlink.MAV_DATA_STREAM_EXTRA1, 10, 1))
        assert 7.0 <= rate_hz(station.next_of("ATTITUDE", 10)) <= 13.0


def test_its_boot_clock_drifts_as_specified_and_answers_timesync(flight: Flight, station: Station) -> None:
    with FakeAutopilot(flight, station.url, drift=0.02) as autopilot:
        station.next_of("HEARTBEAT", 1)
        readings = []
        for _ in range(2):
            exchanges = [station.exchange() for _ in range(10)]
            for sent_ns, boot_ns, back_ns in exchanges:
                assert sent_ns - 1_000_000 <= autopilot.monotonic_ns(boot_ns) <= back_ns + 1_000_000
            # The quickest of them, which nothing held up.
            sent_ns, boot_ns, _ = min(exchanges, key=lambda exchange: exchange[2] - exchange[0])
            readings.append((sent_ns, boot_ns))
            time.sleep(1.0)
        (sent_a, boot_a), (sent_b, boot_b) = readings
        assert (boot_b - boot_a) / (sent_b - sent_a) == pytest.approx(1.02, abs=0.015)


def test_a_reboot_starts_the_boot_clock_again_and_forgets_rates(flight: Flight, station: Station) -> None:
    with FakeAutopilot(flight, station.url) as autopilot:
        station.next_of("HEARTBEAT", 1)
        station.ask(mavlink.MAVLINK_MSG_ID_ATTITUDE, 25.0)
        before = station.next_of("ATTITUDE", 9)
        assert rate_hz(before) > 15.0 and before[0].time_boot_ms > 200_000
        autopilot.reboot(0.5)

        def fresh(came: list[Any]) -> list[Any]:
            return [m for m in named(came, "ATTITUDE") if m.time_boot_ms < 100_000]

        after = fresh(station.until(lambda came: len(fresh(came)) >= 5))
        assert 3.0 <= rate_hz(after) <= 5.0
        assert 1400 <= after[0].time_boot_ms <= 2000
        assert autopilot.boots == 2


def test_it_loses_and_corrupts_about_as_specified(flight: Flight, station: Station) -> None:
    with FakeAutopilot(flight, station.url, everything=True, faults=Faults(loss=0.3, corrupt=0.2)) as autopilot:
        came = station.listen(2.5)
    came += station.listen(0.3)  # what was still on its way
    assert 0.35 < len(came) / autopilot.counts.total() < 0.75


def test_delay_is_kept_both_ways(flight: Flight, station: Station) -> None:
    with FakeAutopilot(flight, station.url, faults=Faults(delay_s=0.1)):
        station.next_of("HEARTBEAT", 1)
        took_s: list[float] = []
        while not took_s or (min(took_s) > 0.5 and len(took_s) < 20):  # a busy machine may add to one
            sent_ns, _, back_ns = station.exchange()
            took_s.append((back_ns - sent_ns) / 1e9)
        assert 0.19 < min(took_s) < 0.5


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
            end.settimeout(PATIENCE_S)
            end.connect((host, int(port)))
            end.send(hello)
            read = lambda: end.recv(4096)  # noqa: E731
        parser, names = mavlink.MAVLink(None), set()
        parser.robust_parsing = True
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline and not {"ATTITUDE", "HEARTBEAT", "GLOBAL_POSITION_INT"} <= names:
            names |= {m.get_type() for m in parser.parse_buffer(read()) or []}
        assert {"ATTITUDE", "HEARTBEAT", "GLOBAL_POSITION_INT"} <= names
        assert autopilot.received_of("HEARTBEAT")[0].type == 18
        if scheme == "serial":
            os.close(end)
        else:
            end.close()


def test_a_recording_in_a_loop_never_turns_its_clock_back(flight: Flight, station: Station) -> None:
    short = Flight(flight.due_ns[:40], flight.messages[:40], flight.log_offset_ns, 1, 1)
    with FakeAutopilot(short, station.url, everything=True, loop=True) as autopilot:
        began_s = time.monotonic()
        came = station.until(lambda came: span_ms(named(came, "ATTITUDE")) > 2000)
        took_s = time.monotonic() - began_s
    assert not autopilot.is_over
    stamps = [m.time_boot_ms for m in named(came, "ATTITUDE")]
    assert stamps == sorted(stamps)
    assert span_ms(named(came, "ATTITUDE")) < 1e3 * took_s + 500.0
    assert len(stamps) > 2 * len([m for m in short.messages if m.get_type() == "ATTITUDE"])  # more than two rounds


def test_rates_hold_from_one_round_of_a_loop_to_the_next(flight: Flight, station: Station) -> None:
    short = Flight(flight.due_ns[:40], flight.messages[:40], flight.log_offset_ns, 1, 1)
    with FakeAutopilot(short, station.url, loop=True) as autopilot:
        came = station.next_of("ATTITUDE", 12)
    assert 3.0 <= rate_hz(came) <= 5.0  # unasked
    assert autopilot.counts["ATTITUDE"] >= len(came)


def test_silence_over_the_end_of_a_loop_is_not_made_up_for(flight: Flight, station: Station) -> None:
    """What was due meanwhile came all at once, which fills a serial line that no one empties as fast."""
    short = Flight(flight.due_ns[:40], flight.messages[:40], flight.log_offset_ns, 1, 1)
    with FakeAutopilot(short, station.url, everything=True, loop=True) as autopilot:
        station.next_of("ATTITUDE", 5)
        autopilot.mute(3.0)  # three rounds and a half
        muted_ns = time.monotonic_ns()

        def since_s(message: Any) -> float:
            return (autopilot.monotonic_ns(message.time_boot_ms * 1_000_000) - muted_ns) / 1e9

        came = station.until(lambda came: any(since_s(m) > 5.0 for m in named(came, "ATTITUDE")))
    after = named(came, "ATTITUDE")
    assert not [m for m in after if 1.0 < since_s(m) < 2.9]  # the order may have been taken a little late
    assert 10 <= sum(4.0 < since_s(m) < 5.0 for m in after) <= 40  # 25 Hz
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
        began_s = time.monotonic()
        came = named(station.until(lambda came: span_ms(named(came, "ATTITUDE")) > 9000), "ATTITUDE")
        took_s = time.monotonic() - began_s
    assert 0.85 < took_s < 8.9  # at the host's pace it would be nine seconds
    stamps = [m.time_boot_ms for m in came]
    assert max(b - a for a, b in itertools.pairwise(stamps)) < 400


def test_what_is_spoilt_is_sent_as_it_is_left(flight: Flight, station: Station) -> None:
    def spoil(now_ns: int, message: Any) -> Any:
        if message.get_type() == "GLOBAL_POSITION_INT":
            message.relative_alt = 7
        return None if message.get_type() == "ATTITUDE" else message

    with FakeAutopilot(flight, station.url, everything=True, spoil=spoil):
        came = station.until(lambda came: len(named(came, "GLOBAL_POSITION_INT")) > 3)
    assert {m.relative_alt for m in named(came, "GLOBAL_POSITION_INT")} == {7}
    assert not named(came, "ATTITUDE")
    assert all(m.relative_alt != 7 for m in flight.messages if m.get_type() == "GLOBAL_POSITION_INT")
