"""An aircraft that puts another's name into what it sends on its own, permitted key: nothing of ours accepts it.

Behind the ground station's own router with real certificates, by which it may publish on pc/uav-2 and nowhere else.
"""

import dataclasses
import json
import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import zenoh

from contract.answer import Refusal
from contract.errors import ForeignMessage, InputError, LinkError
from contract.feature_set import FeatureSet
from contract.topics import FEATURES, PICTURE
from contract.wire.codec import encode
from contract.wire.picture_code import cut
from ground.__main__ import main
from ground.client import ask
from ground.mavlink_sets import RadioSystems
from ground.recording import Recording
from ground.web.live import LiveSource
from onboard.storage.mcap_writer import SessionRecorder
from tests.contract.pictures import small_picture
from tests.contract.sets import plain_set
from tests.ground.test_router import Station, keys, station
from tests.waiting import eventually

__all__ = ["keys", "station"]  # fixtures
NAMED = "dropped, 'uav-2' sends what names 'uav-1'"
TRUE = dataclasses.replace(plain_set(40), vehicle="uav-1", session=round(time.time()), frame=3)
FALSE = dataclasses.replace(TRUE, frame=9, revision=9, camera_lat_deg=TRUE.camera_lat_deg + 1.0)  # 111 km away
OWN = FEATURES.key("uav-2")


def now(s: FeatureSet) -> FeatureSet:
    return dataclasses.replace(s, capture_unix_ns=time.time_ns())


class Flight:
    """uav-1 in the air, and uav-2, which claims to be uav-1."""

    def __init__(self, station: Station) -> None:
        self.endpoint, self.keys = station.endpoint, station.keys / "anna"
        self.true, self.liar = station.aircraft("uav-1"), station.session("uav-2")
        self.liar.declare_queryable(OWN, self._answer)

    def publish(self) -> None:
        """Both, the lies last."""
        self.true.publish(now(TRUE))
        self.liar.put(OWN, encode(now(FALSE)))
        for piece in cut(dataclasses.replace(small_picture(FALSE.frame), session=FALSE.session), with_parity=False):
            self.liar.put(PICTURE.key("uav-2"), piece)

    def _answer(self, query: zenoh.Query) -> None:
        with query:
            if "refuse" in str(query.selector):
                query.reply_err(json.dumps({"status": "camera_lost", "vehicle": "uav-1"}).encode())
            else:
                query.reply(OWN, encode(now(FALSE)), attachment=b'{"age_s":0.1}')

    def until(self, holds: Callable[[], object]) -> bool:
        """Return whether it comes to hold while both publish."""

        def again() -> object:
            self.publish()
            return holds()

        return eventually(again)

    def close(self) -> None:
        self.true.close()
        self.liar.close()


@pytest.fixture
def flight(station: Station):
    flying = Flight(station)
    yield flying
    flying.close()


def test_the_page_and_its_journal_have_the_true_aircraft_and_name_who_lies(
    flight: Flight, station: Station, tmp_path: Path
) -> None:
    source = LiveSource([flight.endpoint], station.tls("anna"), journal=tmp_path)
    try:
        is_named = flight.until(
            lambda: source.vehicles() == ["uav-1"] and sum(NAMED in s for s in source.damage()) >= 2
        )
        assert is_named, source.damage()  # of sets, and of pictures
        assert {row.frame for row in source.frames("uav-1")} == {TRUE.frame}
        assert source.picture("uav-1", FALSE.session, FALSE.frame) is None
    finally:
        source.close()
    assert Recording(tmp_path).vehicles == ["uav-1"] and Recording(tmp_path).frames("uav-1") == [TRUE.frame]


def test_a_journal_or_a_recording_that_holds_such_sets_gives_none_of_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Files as an earlier version wrote them, which recorded by the key alone."""
    path = tmp_path / "uav-2-7.001.mcap"
    with SessionRecorder(path, "uav-2") as recorder:
        recorder.write_set(FALSE)
    with pytest.raises(InputError, match=NAMED):
        Recording(path)
    assert main(["click", "320", "240", "--from", str(path)]) == 2
    assert NAMED in capsys.readouterr().err
    source = LiveSource([], journal=tmp_path)
    try:
        assert not source.damage() and source.vehicles() == []
    finally:
        source.close()


def test_watch_record_and_cot_show_the_true_aircraft_alone(
    flight: Flight, station: Station, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    link = ["--connect", flight.endpoint, "--credentials", str(flight.keys)]

    def both(*words: str) -> tuple[str, str]:
        """The output of a command, both aircraft publishing meanwhile."""
        end = threading.Event()

        def publish() -> None:
            while not end.wait(0.05):
                flight.publish()

        thread = threading.Thread(target=publish)
        thread.start()
        try:
            assert main([*words, *link]) == 0
        finally:
            end.set()
            thread.join()
        printed = capsys.readouterr()
        return printed.out, printed.err

    out, err = "", ""

    def is_watched() -> bool:
        nonlocal out, err
        out, err = both("watch", "--json", "--count", "2")
        return bool(out) and NAMED in err

    assert eventually(is_watched), (out, err)
    rows = [json.loads(line) for line in out.splitlines()]
    assert {row["vehicle"] for row in rows} == {"uav-1"}
    assert all(abs(row["lat_deg"] - TRUE.camera_lat_deg) < 1e-6 for row in rows)
    words, _ = both("record", "--out", str(tmp_path / "link"), "--seconds", "2")
    assert NAMED in words and Recording(tmp_path / "link").frames("uav-1") == [TRUE.frame]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as display:
        display.bind(("127.0.0.1", 0))
        display.settimeout(10.0)
        both("cot", "--to", f"udp://127.0.0.1:{display.getsockname()[1]}", "--once", "--only-aircraft")
        event = display.recv(65_000).decode()
    assert "pointclick.uav-1" in event and f'lat="{str(TRUE.camera_lat_deg)[:9]}' in event


def test_an_answer_in_another_s_name_is_no_answer(flight: Flight, station: Station) -> None:
    tls = station.tls("anna")
    flight.true.publish(now(TRUE))
    found = {}

    def are_asked() -> bool:
        found.update(ask(flight.endpoint, tls=tls))
        return "uav-1" in found

    assert eventually(are_asked)
    answer = found["uav-1"]
    assert not isinstance(answer, Refusal) and answer.frame == TRUE.frame and set(found) == {"uav-1"}
    with pytest.raises(LinkError, match=r"aircraft 'uav-2' does not answer .*" + NAMED):
        ask(flight.endpoint, "uav-2", tls=tls)


def test_a_refusal_in_another_s_name_is_asked_of_itself(station: Station) -> None:
    """A refusal has no key: whom it names is asked by its own."""
    refusal = json.dumps({"status": "camera_lost", "vehicle": "uav-1"}).encode()
    with station.session("uav-2") as liar:
        liar.declare_queryable(OWN, lambda query: query.reply_err(refusal))
        with station.aircraft("uav-1") as true:
            true.publish(now(TRUE))
            assert eventually(lambda: _frames(station) == {"uav-1": TRUE.frame})
        assert eventually(lambda: _frames(station) == {})  # it has left, and cannot be spoken for


def _frames(station: Station) -> dict[str, int | None]:
    try:
        return {name: answer.frame for name, answer in ask(station.endpoint, tls=station.tls("anna")).items()}
    except LinkError:
        return {}


def test_a_mavlink_system_is_the_vehicle_that_it_named_first() -> None:
    systems = RadioSystems()
    assert systems.checked(3, TRUE) is TRUE and systems.checked(3, FALSE) is FALSE
    with pytest.raises(ForeignMessage, match="system 4 sends what names 'uav-1', which is system 3"):
        systems.checked(4, TRUE)
    other = dataclasses.replace(TRUE, vehicle="uav-2")
    assert systems.checked(4, other) is other
    with pytest.raises(ForeignMessage, match="system 3, which is 'uav-1', sends what names 'uav-3'"):
        systems.checked(3, dataclasses.replace(TRUE, vehicle="uav-3"))


@pytest.mark.parametrize("both_answer", [True, False])
def test_of_two_aircraft_of_one_name_neither_answers(station: Station, both_answer: bool) -> None:
    """A second one with a copy of the first one's card: either answered a click, or refused it, as chance had it."""
    one, other = station.aircraft("uav-1"), station.aircraft("uav-1")
    reasons: list[str] = []

    def is_refused() -> bool:
        one.publish(now(TRUE))
        if both_answer:  # else the other has no picture yet
            other.publish(now(dataclasses.replace(FALSE, session=TRUE.session + 1)))
        try:
            ask(station.endpoint, "uav-1", tls=station.tls("anna"))
        except LinkError as error:
            reasons.append(str(error))
        return any("two aircraft call themselves 'uav-1'" in words for words in reasons)

    try:
        assert eventually(is_refused), reasons
    finally:
        one.close()
        other.close()
