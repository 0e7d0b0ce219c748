"""What browsers are sent as it happens: nothing that fails ends it; concurrent changes of a pin do not swap places."""

import json
import logging
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient
from starlette.websockets import WebSocket

from contract.errors import InputError
from ground.pins.model import PinClick
from ground.pins.store import PinStore
from ground.web.app import create_app
from ground.web.context import ServerContext
from ground.web.guard import Rules
from ground.web.source import FrameRow
from tests.waiting import PATIENCE_S
from tests.web.rendered import VEHICLE, FlyingSource

OTHER = "uav-2"


class TwoAircraft(FlyingSource):
    """The first of which may be unreadable."""

    def __init__(self) -> None:
        super().__init__()
        self.failure: Exception | None = None

    def vehicles(self) -> list[str]:
        return [VEHICLE, OTHER]

    def frames(self, vehicle: str, newest: int | None = None) -> list[FrameRow]:
        if vehicle == VEHICLE and self.failure is not None:
            raise self.failure
        return super().frames(vehicle, newest)


@pytest.fixture
def source() -> TwoAircraft:
    return TwoAircraft()


@pytest.fixture
def context(source: TwoAircraft, tmp_path: Path) -> Iterator[ServerContext]:
    with PinStore(tmp_path / "pins.sqlite") as store:
        yield ServerContext(source, store, tmp_path)


def browser(context: ServerContext) -> Any:
    """A server with one browser on its events; both are there while it is entered."""
    client = TestClient(create_app(context, Rules()), base_url="http://127.0.0.1:8080")

    class Opened:
        def __enter__(self) -> Any:
            client.__enter__()
            self.socket = client.websocket_connect("/api/events", headers={"host": "127.0.0.1:8080"})
            return self.socket.__enter__()

        def __exit__(self, *what: Any) -> None:
            try:
                self.socket.__exit__(*what)
            finally:
                client.__exit__(*what)

    return Opened()


def receive(socket: Any, is_it: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    """The first event that is meant; the test fails if none comes."""
    found: list[dict[str, Any]] = []
    reading = threading.Thread(
        target=lambda: found.append(next(e for e in iter(socket.receive_json, None) if is_it(e))), daemon=True
    )
    reading.start()
    reading.join(PATIENCE_S)
    assert found, "no such event came"
    return found[0]


def frames_of(vehicle: str, newest: int) -> Callable[[dict[str, Any]], bool]:
    return lambda e: e["type"] == "frames" and e["vehicle"] == vehicle and e["frames"][-1]["frame"] == newest


def test_pictures_and_state_come_though_the_pins_cannot_be_read(context: ServerContext, source: TwoAircraft) -> None:
    context.store.close()  # as good as a disk that was pulled out
    with browser(context) as socket:
        status = receive(socket, lambda e: e["type"] == "status")
        assert [v["id"] for v in status["vehicles"]] == [VEHICLE, OTHER]
        assert any("pins.sqlite: closed" in line for line in status["damage"])
        source.fly_to(7)
        receive(socket, frames_of(VEHICLE, 6))
        receive(socket, lambda e: e["type"] == "status")


@pytest.mark.parametrize("failure", [InputError("damaged at byte 17"), RuntimeError("a fault of ours")])
def test_pictures_that_cannot_be_read_stop_no_one_else_s_and_come_once_they_can(
    context: ServerContext, source: TwoAircraft, failure: Exception, caplog: pytest.LogCaptureFixture
) -> None:
    with browser(context) as socket:
        source.failure = failure
        source.fly_to(5)
        receive(socket, frames_of(OTHER, 4))
        receive(socket, lambda e: e["type"] == "status" and any(str(failure) in line for line in e["damage"]))
        source.failure = None
        receive(socket, frames_of(VEHICLE, 4))
        receive(socket, lambda e: e["type"] == "status" and e["damage"] == [])
    logged = [r for r in caplog.records if r.levelno == logging.ERROR]
    # Once, with its trace; what is wrong with a file is no fault of the program's.
    assert [bool(r.exc_info) for r in logged] == ([] if isinstance(failure, InputError) else [True])


def test_a_browser_that_cannot_be_sent_to_is_let_go_so_that_it_connects_again(
    context: ServerContext, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def fail(self: WebSocket, data: str) -> None:
        raise ValueError("a fault of ours")

    monkeypatch.setattr(WebSocket, "send_text", fail)
    ended = threading.Event()

    def stay() -> None:
        try:
            with browser(context) as socket:
                socket.receive_json()
        except BaseException:
            ended.set()

    threading.Thread(target=stay, daemon=True).start()
    assert ended.wait(PATIENCE_S), "the browser waits for events that cannot come"
    assert len(context.hub) == 0


@pytest.fixture
def events(context: ServerContext, monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """What browsers are sent, in order."""
    sent: list[dict[str, Any]] = []
    monkeypatch.setattr(
        context.hub, "send_from_thread", lambda e: sent.append(json.loads(e) if isinstance(e, str) else e)
    )
    return sent


def a_pin(store: PinStore) -> str:
    return store.add([PinClick.entered(47.0, 8.0, sigma_m=3.0)]).id


def test_the_last_event_of_a_pin_is_the_pin_as_it_is_whoever_reports_last(
    context: ServerContext, events: list[dict[str, Any]]
) -> None:
    """Two requests change a pin; the thread of the first reports after that of the second."""
    pin_id = a_pin(context.store)
    context.store.edit(pin_id, name="earlier")
    context.store.edit(pin_id, name="later")
    context.changed(pin_id)
    context.changed(pin_id)
    assert [e["pin"]["name"] for e in events] == ["later", "later"]
    assert [e["revision"] for e in events] == [context.store.revision] * 2
    context.store.delete(pin_id)
    context.changed(pin_id)
    assert (events[-1]["type"], events[-1]["revision"]) == ("pin_deleted", context.store.revision)
    context.store.undo()
    context.changed(pin_id)  # the deletion's own report, late: the pin is there again
    assert events[-1]["type"] == "pin"


def test_no_event_is_marked_newer_than_what_it_holds(
    context: ServerContext, events: list[dict[str, Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A change after the reading of the revision is reported again, and the page must take that report too."""
    pin_id = a_pin(context.store)
    read = PinStore.pin

    def changed_just_before(store: PinStore, which: str) -> Any:
        monkeypatch.setattr(PinStore, "pin", read)
        store.edit(which, name="in between")
        return read(store, which)

    before = context.store.revision
    monkeypatch.setattr(PinStore, "pin", changed_just_before)
    context.changed(pin_id)
    assert (events[-1]["pin"]["name"], events[-1]["revision"]) == ("in between", before)


def test_a_change_elsewhere_is_not_lost_behind_one_s_own(context: ServerContext, events: list[dict[str, Any]]) -> None:
    pin_id = a_pin(context.store)
    context.changed(pin_id)
    assert not context.changed_elsewhere()
    context.store.edit(pin_id, name="here")
    with PinStore(context.store.name) as other:
        a_pin(other)
    context.changed(pin_id)
    assert context.changed_elsewhere()
    assert not context.changed_elsewhere()
