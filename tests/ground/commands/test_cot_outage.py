"""`pc-ground cot` to a server by certificates on both sides: what arrives, and what of it after a link that was gone.

Ten minutes pass without being waited for: each of the command's pauses is a period of ten seconds.
"""

import contextlib
import itertools
import socket
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from contract.errors import LinkError
from ground import cot_sender
from ground.__main__ import main
from ground.cot_sender import CotSender, Target
from ground.formats import cot
from ground.formats.mark import Mark
from ground.pins.store import PinStore
from tests.ground.commands.cot_server import Server, add_pins, issue, number_of, to
from tests.waiting import PATIENCE_S

PERIOD_S = 10.0
PERIODS = 60  # ten minutes
PINS = 1000


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return issue(tmp_path_factory.mktemp("keys"))


@pytest.fixture
def store(tmp_path: Path) -> Iterator[PinStore]:
    with PinStore(tmp_path / "pins") as made:
        yield made


@pytest.fixture
def server(keys: Path) -> Iterator[Server]:
    made = Server(keys)
    yield made
    made.stop()


def run_through(monkeypatch: pytest.MonkeyPatch, arguments: list[str], each: Callable[[int], object]) -> None:
    """The command for the periods of ten minutes; `each` is called with a period's number before that sends."""
    clock_ns, periods = time.time_ns(), itertools.count(1)
    pause = CotSender.pause

    def pass_by(self: CotSender, seconds: float) -> None:
        nonlocal clock_ns
        assert seconds == PERIOD_S
        clock_ns += round(seconds * 1e9)
        pause(self, 0.0)
        number = next(periods)
        if number == PERIODS:
            raise KeyboardInterrupt
        each(number)

    monkeypatch.setattr(CotSender, "pause", pass_by)
    monkeypatch.setattr("ground.commands.cot.time.time_ns", lambda: clock_ns)
    each(0)
    main([*arguments, "--period", str(PERIOD_S)])


def test_a_thousand_pins_of_ten_minutes_without_a_link_come_once_each(
    keys: Path, server: Server, store: PinStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The link is there for the last period alone: until then no event is made, so that none waits in memory."""
    made: list[Mark] = []

    def each(period: int) -> None:
        if period % 6 == 0:  # each minute's
            add_pins(store, range(period * PINS // PERIODS, (period + 6) * PINS // PERIODS))
        if period == PERIODS - 1:
            server.start()
            assert not made

    whole = cot.event

    def noted(mark: Mark, now_unix_ns: int, stale_s: float) -> str | None:
        made.append(mark)
        return whole(mark, now_unix_ns, stale_s)

    monkeypatch.setattr(cot, "event", noted)
    run_through(monkeypatch, [*to(keys, server.port), "--pins", str(tmp_path / "pins")], each)
    assert server.has(PINS) and len(made) == PINS
    assert Counter(map(number_of, server.events)) == Counter(range(PINS))


def test_what_was_sent_to_a_server_that_went_comes_again_and_nothing_twice(
    keys: Path, server: Server, store: PinStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is there, gone, there, gone and there: all pins are known in the end, and no event came twice."""

    def each(period: int) -> None:
        add_pins(store, range(2 * period, 2 * (period + 1)))
        if period in (5, 20, 45):
            server.start()
        if period in (12, 30):
            server.stop()

    run_through(monkeypatch, [*to(keys, server.port), "--pins", str(tmp_path / "pins")], each)
    assert server.has(sum(2 * (p + 1) for p in (*range(5, 12), *range(20, 30), *range(45, 60))))
    events = server.events
    assert {number_of(event) for event in events} == set(range(2 * PERIODS))
    assert max(Counter((event.get("uid"), event.get("time")) for event in events).values()) == 1
    newest = max(event.get("time", "") for event in events)
    assert sorted(number_of(e) for e in events if e.get("time") == newest) == list(range(2 * PERIODS))


def test_a_stream_that_ended_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither for an hour, which is the period, where there is no server, nor where one has just gone."""
    monkeypatch.setattr(cot_sender, "RETRY_S", 0.01)
    with socket.create_server(("127.0.0.1", 0)) as listener:
        sender = CotSender(Target.of(f"tcp://127.0.0.1:{listener.getsockname()[1]}"))
        sender.pause(3600.0)
        sender.connect()
        listener.accept()[0].close()
        sender.pause(3600.0)
        assert "closed by the server" in sender.ended


def test_the_last_event_arrives_even_if_the_server_sent_something_first(
    keys: Path, server: Server, store: PinStore, tmp_path: Path
) -> None:
    """A socket that is closed with something unread in it makes the server lose what it has not read yet."""
    server.start()
    add_pins(store, range(3))
    for times in range(1, 11):
        assert main([*to(keys, server.port), "--once", "--pins", str(tmp_path / "pins")]) == 0
        assert len(server.events) == 3 * times


def test_a_certificate_that_the_server_refuses_is_reported(
    keys: Path, server: Server, store: PinStore, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """With TLS 1.3 the handshake is over for us before the server has looked at it."""
    server.start()
    add_pins(store, range(3))
    stranger = to(keys, server.port, keys / "elsewhere" / "stranger")
    assert main([*stranger, "--once", "--pins", str(tmp_path / "pins")]) == 2
    assert "--to-certificate" in capsys.readouterr().err
    assert not server.events


def test_a_server_that_reads_no_more_is_given_up_with_what_waits_for_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing comes late over a link that was gone: the system's own queue is discarded after a while."""
    monkeypatch.setattr(cot_sender, "UNACKNOWLEDGED_S", 0.5)
    monkeypatch.setattr(cot_sender, "CONNECT_TIMEOUT_S", PATIENCE_S)
    with socket.create_server(("127.0.0.1", 0)) as listener:
        sender = CotSender(Target.of(f"tcp://127.0.0.1:{listener.getsockname()[1]}"))
        sender.connect()
        client, _ = listener.accept()
        number = 0
        with client:
            with pytest.raises(LinkError, match="Connection timed out"):
                while True:
                    number += 1
                    sender.send([f"<event uid='{number}'>{'x' * 50_000}</event>"])
            received = bytearray()
            with contextlib.suppress(OSError):
                while part := client.recv(1_000_000):
                    received += part
        assert b"uid='1'" in received and b"uid='%d'" % number not in received
        sender.connect()
        sender.send(["<event/>"])
        client, _ = listener.accept()
        with client:
            assert client.recv(100) == b"<event/>\n"
            client.close()
            sender.close()
