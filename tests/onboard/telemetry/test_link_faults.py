"""What the field does to a telemetry link, one fault a test: said within `lost_after_s`, got over by itself."""

import itertools
import random
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from onboard.events.source import Severity, State
from onboard.events.types import Attitude, PositionFix
from onboard.telemetry.autopilot_search import LISTEN_S
from simulation.autopilot.fake import FakeAutopilot, Faults
from tests.onboard.link.ports import free_port, free_udp_port
from tests.onboard.telemetry.listening import FLIGHT, Listening, config_for, errors_ms, expected, listening
from tests.waiting import eventually


@contextmanager
def both_libraries(**keys: object) -> Iterator[list[tuple[FakeAutopilot, Listening]]]:
    """An autopilot and a source of each library, side by side to save time."""
    with ExitStack() as stack:
        pairs = []
        for backend in ("pymavlink", "mavsdk"):
            autopilot = stack.enter_context(FakeAutopilot(FLIGHT, "tcpin:127.0.0.1:0", getting_ready_s=0.1))
            pairs.append(
                (autopilot, stack.enter_context(listening(config_for(autopilot.url, backend=backend, **keys))))
            )
        yield pairs


@pytest.mark.wall_clock(waits=True)
def test_silence_is_lost_in_time_and_a_reboot_starts_the_stamps_again() -> None:
    with both_libraries(lost_after_s=0.8, attitude_rate_hz=25.0) as pairs:
        for _, received in pairs:
            received.until(lambda received=received: len(received.of(Attitude)) > 20)
            received.wait(State.OK)
        for autopilot, _ in pairs:
            autopilot.mute(60.0)
        for _, received in pairs:
            assert received.wait(State.LOST) < 5.0
            received.until(lambda received=received: "silent" in received.source.health().detail)
        for autopilot, _ in pairs:
            autopilot.mute(0.0)
        for _, received in pairs:
            received.wait(State.OK)
        granted = [len(autopilot.received_of("COMMAND_LONG")) for autopilot, _ in pairs]
        for autopilot, _ in pairs:
            autopilot.reboot(0.4)
        for (autopilot, received), before in zip(pairs, granted, strict=True):
            received.until(lambda received=received: received.source.health().figures["reboots"] == 1.0)
            begun = len(received.of(Attitude))
            # Rates are lost with the reboot and asked for again: unasked they come at 4 Hz.
            received.until(lambda received=received, begun=begun: len(received.of(Attitude)) > begun + 20)
            received.wait(State.OK)
            assert len(autopilot.received_of("COMMAND_LONG")) > before + 2
            fixes = received.of(PositionFix)
            assert all(a.stamp_ns < b.stamp_ns for a, b in itertools.pairwise(fixes))
            true = expected(autopilot, received.clock)
            assert np.max(np.abs(errors_ms(fixes[:-3], true))) < 25.0


@pytest.mark.parametrize("line", ["serial", "tcp"])
def test_a_line_that_is_unplugged_and_comes_back_under_another_name_if_it_has_one_is_found_again(
    tmp_path: Path, line: str
) -> None:
    url = f"pty:{tmp_path / 'FC'}" if line == "serial" else f"tcpin:127.0.0.1:{free_port()}"
    with (
        FakeAutopilot(FLIGHT, url, everything=True) as autopilot,
        listening(config_for(autopilot.url)) as received,
    ):
        received.wait(State.OK)
        autopilot.unplug()
        received.wait(State.LOST)
        received.until(lambda: line == "tcp" or str(tmp_path) in received.source.health().detail)
        autopilot.plug()
        received.wait(State.OK)
        assert received.source.health().figures["reopened"] >= 1.0


def test_a_device_that_is_not_there_yet_is_waited_for(tmp_path: Path) -> None:
    link = tmp_path / "FC"
    with listening(config_for(f"serial:{link}:115200")) as received:
        received.wait(State.LOST)
        assert received.source.health().detail == f"cannot open {link}: No such file or directory"
        with FakeAutopilot(FLIGHT, f"pty:{link}", everything=True):
            received.wait(State.OK)


@pytest.mark.wall_clock(waits=True)
def test_a_bad_link_still_gives_the_right_moments() -> None:
    faults = Faults(loss=0.1, corrupt=0.05, delay_s=0.04, jitter_s=0.03)
    with (
        FakeAutopilot(FLIGHT, "udpin:127.0.0.1:0", faults=faults, drift=-400e-6, chatter=True) as autopilot,
        listening(config_for(autopilot.url, system=1)) as received,
    ):
        received.until(lambda: len(received.of(PositionFix)) > 25)
        true = expected(autopilot, received.clock)
        fixes = received.of(PositionFix)
        # Nothing tells on which way a delay was spent: half the excess of the best round trips is left over.
        assert np.median(np.abs(errors_ms(fixes[10:], true))) < 15.0
        assert np.max(np.abs(errors_ms(fixes[5:], true))) < 60.0
        assert np.max(np.abs(errors_ms(fixes, true))) < 200.0  # the first exchanges may all have been slow
        figures = received.source.health().figures
        assert 80.0 <= figures["round_trip_ms"] < 160.0
        assert figures["clock_sigma_ms"] > 20.0
        assert figures["lost_packets"] > 3.0


@pytest.mark.wall_clock(waits=True)
def test_without_timesync_arrivals_serve() -> None:
    with (
        FakeAutopilot(FLIGHT, "udpin:127.0.0.1:0", answers_timesync=False) as autopilot,
        listening(config_for(autopilot.url)) as received,
    ):
        received.until(lambda: len(received.of(PositionFix)) > 8)
        assert np.max(np.abs(errors_ms(received.of(PositionFix), expected(autopilot, received.clock)))) < 25.0
        assert "round_trip_ms" not in received.source.health().figures


def test_garbage_on_the_line_costs_only_itself() -> None:
    rng = random.Random(2)
    with FakeAutopilot(FLIGHT, "pty", everything=True) as autopilot, listening(config_for(autopilot.url)) as received:
        received.wait(State.OK)
        before = len(received.of(Attitude))
        for _ in range(20):
            autopilot.send_bytes(rng.randbytes(rng.randrange(1, 300)))
            autopilot.send_bytes(b"\xfd\xff\x00\x00\x00\x01\x01\x1e\x00\x00")
            time.sleep(0.05)
        received.until(lambda: len(received.of(Attitude)) > before + 15)
        received.wait(State.OK)
        errors_ms(received.of(Attitude)[before:-5], expected(autopilot, received.clock))


def test_nothing_but_garbage_is_reported_to_be_that() -> None:
    autopilot = FakeAutopilot(FLIGHT, "pty")
    autopilot.mute(60.0)  # before it begins: a single packet of its own would refute what is to be said
    with autopilot, listening(config_for(autopilot.url)) as received:

        def is_reported() -> bool:
            time.sleep(0.1)
            autopilot.send_bytes(random.Random(1).randbytes(500))
            return "baud rate" in received.source.health().detail

        received.until(is_reported)
        assert received.source.health().state is State.STARTING


@pytest.mark.parametrize("backend", ["pymavlink", "mavsdk"])
def test_another_vehicle_on_the_line_is_named_and_neither_is_followed(backend: str) -> None:
    with (
        FakeAutopilot(FLIGHT, "udpin:127.0.0.1:0", everything=True, chatter=True) as autopilot,
        listening(config_for(autopilot.url, system=0, backend=backend)) as received,
    ):
        received.until(lambda: "several vehicles" in received.source.health().detail)
        time.sleep(LISTEN_S)  # in which the first one would have been taken
        assert received.source.health().detail == (
            "several vehicles on this line (1 ArduPilot fixed wing, 7 PX4 quadrotor): set telemetry.system"
        )
        assert received.source.health().state is State.LOST
        assert not received.got


def test_what_is_reported_reaches_the_line_in_pieces_that_belong_together() -> None:
    with both_libraries() as pairs:
        for _, received in pairs:
            received.wait(State.OK)
            received.source.send_text(Severity.WARNING, "Kamera verloren: ä" + "x" * 50)
            received.source.send_text(Severity.INFO, "ok")
        for autopilot, received in pairs:
            received.until(lambda autopilot=autopilot: len(autopilot.received_of("STATUSTEXT")) >= 3)
            first, second, third = autopilot.received_of("STATUSTEXT")
            assert first.text + second.text == "Kamera verloren: ?" + "x" * 50
            assert len(first.text) == 50
            assert (first.severity, first.get_srcSystem(), first.get_srcComponent()) == (4, 1, 191)
            assert first.id == second.id != 0
            assert (first.chunk_seq, second.chunk_seq) == (0, 1)
            assert (third.text, third.id) == ("ok", 0)


def test_signed_both_ways_and_nothing_unsigned_is_accepted(tmp_path: Path) -> None:
    key = tmp_path / "key"
    key.write_text(bytes(range(32)).hex())
    with (
        FakeAutopilot(FLIGHT, "udpin:127.0.0.1:0", key=bytes(range(32)), everything=True) as autopilot,
        listening(config_for(autopilot.url, signing_key=str(key))) as received,
    ):
        received.wait(State.OK)
        received.until(lambda: autopilot.received_of("TIMESYNC"))
        forged = mavlink.MAVLink_global_position_int_message(1, 10, 20, 30, 40, 0, 0, 0, 0)
        autopilot.send_bytes(forged.pack(mavlink.MAVLink(None, 1, 1)))
        time.sleep(0.3)
        assert not [fix for fix in received.of(PositionFix) if abs(fix.lat_deg) < 1.0]


def test_a_wrong_key_is_reported_to_be_that(tmp_path: Path) -> None:
    key = tmp_path / "key"
    key.write_bytes(bytes(32))
    with (
        FakeAutopilot(FLIGHT, "udpin:127.0.0.1:0", key=bytes(range(32)), everything=True) as autopilot,
        listening(config_for(autopilot.url, signing_key=str(key))) as received,
    ):
        # It never believes us either, but it has learned where we are.
        received.until(lambda: "wrong signature" in received.source.health().detail)
        assert not received.got
        assert not autopilot.received_of("TIMESYNC")


def test_a_port_in_use_is_reported_and_waited_for() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", port := free_udp_port()))
        with listening(config_for(f"udpin:127.0.0.1:{port}")) as received:
            received.wait(State.LOST)
            assert "Address already in use" in received.source.health().detail
            other.close()
            with FakeAutopilot(FLIGHT, f"udpout:127.0.0.1:{port}", everything=True):
                received.wait(State.OK)


def test_a_clock_that_stands_still_is_frozen() -> None:
    still = mavlink.MAVLink_attitude_message(5000, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    beat = mavlink.MAVLink_heartbeat_message(1, 3, 0, 0, 4, 3)
    with FakeAutopilot(FLIGHT, "udpin:127.0.0.1:0") as autopilot, listening(config_for(autopilot.url)) as received:
        received.wait(State.OK)
        autopilot.mute(60.0)
        packer = mavlink.MAVLink(None, 1, 1)

        def is_frozen() -> bool:
            autopilot.send_bytes(beat.pack(packer) + still.pack(packer))
            time.sleep(0.1)
            return received.source.health().state is State.FROZEN

        received.until(is_frozen)


def test_px4_does_not_miss_us_when_we_leave_and_no_packet_counts_as_lost() -> None:
    """As an onboard controller we would be missed: PX4 tells the pilot, critical."""
    with FakeAutopilot(FLIGHT, "tcpin:127.0.0.1:0", style="px4", mission_computer_s=0.5) as autopilot:
        with listening(config_for(autopilot.url)) as received:
            received.wait(State.OK)
            received.until(lambda: len(received.of(PositionFix)) > 20)
            assert received.source.health().figures["lost_packets"] == 0.0
        time.sleep(1.0)
        assert autopilot.shown == []
        assert autopilot.received_of("HEARTBEAT")[-1].system_status == mavlink.MAV_STATE_POWEROFF


def test_the_fake_px4_misses_an_onboard_controller() -> None:
    """The control of the test above."""
    with FakeAutopilot(FLIGHT, "tcpin:127.0.0.1:0", style="px4", mission_computer_s=0.5) as autopilot:
        port = int(autopilot.url.rpartition(":")[2])
        beat = mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, mavlink.MAV_STATE_POWEROFF, 3)
        with socket.create_connection(("127.0.0.1", port)) as end:
            end.sendall(beat.pack(mavlink.MAVLink(None, autopilot.system, 191)))
            assert eventually(lambda: autopilot.shown)
        assert autopilot.shown == ["Connection to mission computer lost"]


def test_ardupilot_tells_its_pilot_nothing_of_our_requests() -> None:
    with both_libraries(attitude_rate_hz=50.0) as pairs:
        for autopilot, received in pairs:
            received.wait(State.OK)
            received.until(lambda autopilot=autopilot: len(autopilot.received_of("COMMAND_LONG")) >= 4)
        for autopilot, _ in pairs:
            assert autopilot.shown == []
            asked = [message for message in autopilot.received_of("COMMAND_LONG") if message.param1 == 30]
            assert [message.param2 for message in asked] == [25_000.0]  # 40 Hz: all its 50 Hz loop gives
            (beat, *_) = reversed(autopilot.received_of("HEARTBEAT"))
            assert beat.type == mavlink.MAV_TYPE_ONBOARD_CONTROLLER
