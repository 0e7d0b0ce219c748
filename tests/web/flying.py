"""A flight in fast motion before a server of this process: pictures come as a test says."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any

import uvicorn
from starlette.testclient import TestClient

from ground.pins.store import PinStore
from ground.web.app import create_app
from ground.web.context import ServerContext
from ground.web.guard import Rules
from ground.web.source import Source
from ground.web.startup import STATIC
from ground.web.tile_area import TileArea
from ground.web.tiles import Tiles
from tests.waiting import PATIENCE_S
from tests.web.browsing import Operator
from tests.web.rendered import FlyingSource


class Flight:
    def __init__(
        self,
        pins: Path,
        tiles: Tiles | None = None,
        aircraft: int = 1,
        rules: Rules | None = None,
        token: str = "",
        source: Source | None = None,
        area: TileArea | None = None,
    ) -> None:
        self.source = FlyingSource(aircraft)
        self.store = PinStore(pins)
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._listening.getsockname()[1])
        self.local = f"http://127.0.0.1:{self.port}/"
        self.url = self.local + (f"?token={token}" if token else "")
        rules = rules or Rules(tile_origin="" if tiles is None else tiles.origin)
        app = create_app(ServerContext(source or self.source, self.store, STATIC, tiles, area=area), rules)
        self._server = uvicorn.Server(
            uvicorn.Config(app, log_level="warning", access_log=False, timeout_graceful_shutdown=1)
        )
        self._thread = threading.Thread(target=self._server.run, kwargs={"sockets": [self._listening]}, daemon=True)

    def __enter__(self) -> Flight:
        self._thread.start()
        until_s = time.monotonic() + PATIENCE_S
        while not self._server.started:
            assert time.monotonic() < until_s, "the server did not start"
            time.sleep(0.01)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._server.should_exit = True
        self._thread.join(PATIENCE_S)
        self.store.close()


Flying = Callable[..., tuple[Flight, Operator]]
"""Begins flights, each with its first picture and an operator before it: the fixture `flying`."""


@contextmanager
def requests_to(
    folder: Path, rules: Rules | None = None, headers: dict[str, str] | None = None, **context: Any
) -> Iterator[tuple[TestClient, FlyingSource]]:
    """Requests to a flight's server, without a page."""
    source = FlyingSource()
    with PinStore(folder / "pins.sqlite") as store:
        app = create_app(ServerContext(source, store, folder, **context), rules or Rules())
        with TestClient(app, "http://127.0.0.1:8080", headers=headers, follow_redirects=False) as client:
            yield client, source
