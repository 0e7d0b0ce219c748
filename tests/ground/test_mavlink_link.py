"""The ground's end of clicks over MAVLink, with an aircraft's end in the same process, over real sockets."""

import dataclasses
import json
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from contract.answer import Fix
from contract.errors import LinkError
from contract.feature_set import Status
from contract.wire.codec import encode
from contract.wire.radio_state import Held, RadioState
from ground import mavlink_link
from ground.__main__ import main
from ground.client import SetCache, inquire
from ground.mavlink_endpoint import MavlinkEndpoint
from ground.mavlink_link import MavlinkLink
from ground.mavlink_sets import REPORT_S
from ground.recording import Recording
from onboard.config.schema import parse_config
from onboard.link import set_feed
from onboard.link.autopilot_radio import AutopilotRadio
from onboard.link.reply import Answer, Question
from onboard.link.set_selection import Offer
from onboard.telemetry.mavlink_passage import Passage
from onboard.telemetry.mavlink_source import PymavlinkEnd
from tests.contract.sets import plain_set
from tests.onboard.link.ports import free_udp_port
from tests.waiting import PATIENCE_S, eventually

PAYLOAD = encode(dataclasses.replace(plain_set(60), frame=7))
KEY = bytes(range(32))


class Wire:
    def __init__(self, port: int) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.connect(("127.0.0.1", port))
        self.socket.settimeout(0.02)

    def write(self, data: bytes) -> None:
        try:
            self.socket.send(data)
        except OSError:  # the ground is not there yet, or no more
            return

    def read(self) -> bytes:
        try:
            return self.socket.recv(4096)
        except OSError:
            return b""


class Aircraft:
    """Autopilot and companion computer in one: heartbeats of the one, answers of the other."""

    def __init__(self, port: int, key: bytes | None = None, system: int = 3) -> None:
        config = parse_config(f"[telemetry]\nsystem = {system}\n")
        self.radio = AutopilotRadio("uav-1", self._look_up, lambda _: 0.25, 1e5, is_signed=key is not None)
        self.wire, self.system = Wire(port), system
        self.newest = PAYLOAD
        self.end, self.autopilot = PymavlinkEnd(config, key), PymavlinkEnd(config, key)
        self.autopilot._mav.srcComponent = 1
        self.end.attach(self.wire)
        self.autopilot.attach(self.wire)
        self.passage = Passage(config, self.radio)
        self.received: list[str] = []
        self.room_bytes = (
            10_000  # a larger packet of ours is dropped without a word, as an autopilot's full buffer does
        )
        self.stop, self.has_ended = threading.Event(), threading.Event()

    def _look_up(self, asked: Question) -> Answer | None:
        return Answer(self.newest, b'{"age_s":0.25}')

    def run(self) -> None:
        beat_s = 0.0
        while not self.stop.is_set():
            if time.monotonic() - beat_s > 0.2:
                beat_s = time.monotonic()
                self.autopilot.send(mavlink.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3))
            for _, message in self.end.take(self.wire.read(), 0):
                self.received.append(message.get_type())
                self.passage.receive(message, self.system)
            self.radio.clicks.work()
            for message in self.passage.due(0, self.system):
                if getattr(message, "payload_length", 0) <= self.room_bytes:
                    self.end.send(message)
        self.has_ended.set()


@contextmanager
def flying(key: bytes | None = None, *systems: int) -> Iterator[tuple[str, list[Aircraft]]]:
    port = free_udp_port()
    aircraft = [Aircraft(port, key, system) for system in systems or (3,)]
    threads = [threading.Thread(target=a.run, daemon=True) for a in aircraft]
    for thread in threads:
        thread.start()
    try:
        yield f"mavlink:udpin:127.0.0.1:{port}", aircraft
    finally:
        for a, thread in zip(aircraft, threads, strict=True):
            a.stop.set()
            thread.join(PATIENCE_S)
            a.wire.socket.close()


def test_clicks_are_answered_one_after_the_other_over_one_link() -> None:
    with flying() as (radio, (aircraft,)), MavlinkLink(MavlinkEndpoint.parse(radio)) as link:
        began_s = time.monotonic()
        first, second = link.ask(320.0, 240.0), link.ask(-5.0, 240.0)
        assert (first.vehicle, first.frame) == ("uav-1", 7)
        took_s = time.monotonic() - began_s
        # At the click, as old as when it was looked up less what the question waited before.
        assert 0.244 - took_s <= first.age_s < 0.25 + took_s + 0.5
        assert second.status is Status.OUTSIDE
        assert "HEARTBEAT" in aircraft.received  # by which the autopilot learns where we are


def test_with_a_key_both_ends_sign_and_without_it_nothing_is_answered(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "key").write_text(KEY.hex())
    with (
        flying(KEY) as (radio, _),
        MavlinkLink(MavlinkEndpoint.parse(f"{radio}?key={tmp_path / 'key'}")) as link,
    ):
        assert isinstance(link.ask(320.0, 240.0), Fix)
    with flying(KEY) as (radio, (aircraft,)):
        monkeypatch.setattr("ground.click_asking.GIVE_UP_S", 1.0)
        unsigned = MavlinkEndpoint.parse(f"{radio}?vehicle=3")
        with MavlinkLink(unsigned) as link, pytest.raises(LinkError, match="does not answer clicks"):
            link.ask(320.0, 240.0)
        assert aircraft.received == []


def test_several_vehicles_must_be_distinguished() -> None:
    with flying(None, 3, 4) as (radio, aircraft):
        with MavlinkLink(MavlinkEndpoint.parse(f"{radio}?vehicle=4")) as link:
            assert isinstance(link.ask(320.0, 240.0), Fix)
        assert "TUNNEL" in aircraft[1].received
        with MavlinkLink(MavlinkEndpoint.parse(radio)) as link:
            assert eventually(lambda: link.received() is not None and len(link.vehicles) == 2)
            with pytest.raises(LinkError, match="several vehicles are received: 3, 4"):
                link.ask(320.0, 240.0)


def test_a_ground_that_is_turned_away_says_what_it_would_have_hidden() -> None:
    with flying() as (radio, (aircraft,)), MavlinkLink(MavlinkEndpoint.parse(f"{radio}?system=250")) as link:
        aircraft.radio.know_ground_stations(250, 255)
        with pytest.raises(LinkError, match="MAV_GCS_SYSID 250 to 255"):
            link.ask(320.0, 240.0)


def test_a_click_whose_answers_find_no_room_says_that_the_radio_is_full(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("SOON_S", 0.1), ("ASK_AGAIN_S", 0.2), ("GIVE_UP_S", 2.0)):
        monkeypatch.setattr(f"ground.click_asking.{name}", value)
    with flying() as (radio, (aircraft,)), MavlinkLink(MavlinkEndpoint.parse(radio)) as link:
        aircraft.room_bytes = 20
        with pytest.raises(LinkError, match=r"vehicle 3 has received the click.*the radio is full: .* MAV_n_RATE"):
            link.ask(320.0, 240.0)
        assert aircraft.radio.report().unheard == aircraft.radio.report().answered == 1
        aircraft.room_bytes = 0
        with pytest.raises(LinkError, match=r"does not answer clicks: .* 0\.\d kbit/s of its autopilot's own messages"):
            link.ask(320.0, 240.0)
        aircraft.room_bytes = 100
        assert isinstance(link.ask(320.0, 240.0), Fix)


def test_watch_says_why_a_radio_that_is_received_brings_no_sets(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It said "nothing received yet", for as long as one cared to wait."""
    monkeypatch.setattr("ground.radio_traffic.QUIET_S", 0.5)
    with flying() as (radio, (aircraft,)):
        aircraft.room_bytes = 0

        def is_shown() -> bool:
            assert main(["watch", "--connect", radio, "--count", "2", "--period", "1"]) == 0
            shown = capsys.readouterr().err
            return "nothing received yet: nothing of pc-onboard comes" in shown and "it is full" in shown

        assert eventually(is_shown)


def test_watch_shows_the_aircrafts_own_words_of_its_radio(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(set_feed, "STATE_S", 1.0)
    with flying() as (radio, (aircraft,)):
        for frame in range(3):
            aircraft.radio.feed.offer(a_set(frame))
        stated = RadioState(Held.BY_RADIO, 400.0, 15.0)
        aircraft.radio.feed._state = lambda now_s: stated
        rows: list[dict[str, Any]] = []

        def is_shown() -> bool:
            assert main(["watch", "--connect", radio, "--json", "--count", "3", "--period", "1"]) == 0
            rows.extend(json.loads(line) for line in capsys.readouterr().out.splitlines())
            return any("the radio is full: a set takes 15 s at the 0.4 kbit/s" in row["reason"] for row in rows)

        assert eventually(is_shown), rows


def test_a_second_program_on_one_udp_port_is_refused() -> None:
    endpoint = MavlinkEndpoint.parse(f"mavlink:udpin:127.0.0.1:{free_udp_port()}")
    with MavlinkLink(endpoint):
        with pytest.raises(LinkError, match=f"another program receives at UDP port {endpoint.port}") as refused:
            MavlinkLink(endpoint)
        assert "\n" not in str(refused.value)
    MavlinkLink(endpoint).close()


def test_no_one_there_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mavlink_link, "FIND_S", 0.2)
    with flying() as (radio, (aircraft,)):
        aircraft.stop.set()
        assert aircraft.has_ended.wait(PATIENCE_S)
        with (
            MavlinkLink(MavlinkEndpoint.parse(radio)) as link,
            pytest.raises(LinkError, match="no autopilot was received"),
        ):
            link.ask(320.0, 240.0)


def a_set(frame: int) -> Offer[bytes]:
    stamp_ns = 1_700_000_000_000_000_000 + frame * 10**9
    made = dataclasses.replace(plain_set(100), frame=frame, capture_unix_ns=stamp_ns)
    return Offer(made.session, frame, 0, stamp_ns, True, False, encode(made))


def test_watch_and_record_show_and_keep_the_sets_that_come_in_pieces(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with flying() as (radio, (aircraft,)):
        for frame in range(3):
            aircraft.radio.feed.offer(a_set(frame))

        def is_kept() -> bool:
            """In five seconds, or in the next five where a busy machine's were too short."""
            assert main(["record", "--out", str(tmp_path), "--seconds", "5", "--connect", radio]) == 0
            vehicles = Recording(tmp_path).vehicles if any(tmp_path.iterdir()) else []
            return any(2 in Recording(tmp_path).frames(vehicle) for vehicle in vehicles)

        assert eventually(is_kept)
        aircraft.radio.feed.offer(a_set(3))
        aircraft.newest = a_set(3).item
        rows: list[dict[str, Any]] = []
        began_s = time.monotonic()

        def is_shown() -> bool:
            capsys.readouterr()
            assert main(["watch", "--connect", radio, "--json", "--count", "3", "--period", "1"]) == 0
            rows.extend(json.loads(line) for line in capsys.readouterr().out.splitlines())
            return bool(rows) and rows[-1]["frame"] == 3 and "the aircraft's clock is 3 years" in rows[-1]["reason"]

        assert eventually(is_shown), rows
        took_s = time.monotonic() - began_s
    recording = Recording(tmp_path)
    (vehicle,) = recording.vehicles
    kept = recording.by_frame(vehicle, 2)
    assert kept is not None and encode(kept) == a_set(2).item
    assert rows[-1]["vehicle"] == vehicle
    assert 0.25 <= rows[-1]["age_s"] < 0.25 + took_s


def test_another_vehicles_sets_are_left_out_and_what_needs_single_pictures_says_so() -> None:
    with flying() as (radio, (aircraft,)), SetCache(radio, "uav-9") as cache:
        aircraft.radio.feed.offer(a_set(0))
        assert eventually(lambda: aircraft.radio.feed.sent)
        time.sleep(0.3)
        assert aircraft.radio.feed.sent >= 1 and cache.vehicles == [] and cache.dropped.unreadable == 0
        with pytest.raises(LinkError, match="single pictures"):
            cache.ask_at("uav-1", 0.0)
    with pytest.raises(LinkError, match="it answers pc-ground click"):
        inquire(radio)


def test_a_listener_that_is_turned_away_says_why() -> None:
    with flying() as (radio, (aircraft,)):
        aircraft.radio.know_ground_stations(250, 255)
        with SetCache(f"{radio}?system=250") as cache:
            assert eventually(lambda: "MAV_GCS_SYSID 250 to 255" in cache.link_error)
            asked = len(aircraft.received)
            time.sleep(2.0 * REPORT_S)  # in which it would have asked again
            assert "MAV_GCS_SYSID 250 to 255" in cache.link_error
        assert len(aircraft.received) == asked and set(aircraft.received) == {"TUNNEL"}


def test_no_heartbeat_goes_out_before_every_aircraft_has_taken_us() -> None:
    with flying() as (radio, (aircraft,)), MavlinkLink(MavlinkEndpoint.parse(radio)) as link:
        assert eventually(lambda: link.received() is not None and link.vehicles == [3])
        link.beat()
        assert isinstance(link.ask(320.0, 240.0), Fix)
        assert set(aircraft.received) == {"TUNNEL"}
        link.beat()
        assert eventually(lambda: "HEARTBEAT" in aircraft.received)
