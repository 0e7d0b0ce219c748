"""One flight, one server and one real Chromium for all tests of the page. Without Chromium: left out, loudly."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from ground.web.guard import Rules
from ground.web.startup import STATIC
from tests.left_out import NO_PROGRAM
from tests.onboard.link.ports import free_port
from tests.web.browsing import Operator
from tests.web.flying import Flight, Flying
from tests.web.served import ARGUMENTS, CHROMIUM, Server, Simulated, recorded


@pytest.fixture(scope="session")
def simulated() -> Simulated:
    return recorded()


@pytest.fixture
def serve(simulated: Simulated, tmp_path: Path) -> Iterator[Callable[..., Server]]:
    """Starts servers of a test's own on the flight; pins go into the test's folder."""
    page_is_built()
    running: list[Server] = []

    def start(*arguments: object, pins: str = "pins.sqlite") -> Server:
        running.append(Server("--from", simulated.path, "--pins", tmp_path / pins, *arguments))
        return running[-1]

    yield start
    for server in running:
        server.close()


@pytest.fixture(scope="session")
def station(simulated: Simulated, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """One server for all tests that do not need another; what they leave behind is cleared by `anna`."""
    page_is_built()
    # It is started again at its port, which no one else may have been given by then.
    server = Server(
        "--from", simulated.path, "--pins", tmp_path_factory.mktemp("station") / "pins.sqlite", port=free_port()
    )
    yield server
    server.close()


@pytest.fixture(scope="session")
def chromium() -> Iterator[Any]:
    if CHROMIUM is None:
        pytest.skip(f"{NO_PROGRAM} chromium; sudo apt-get install chromium")
    from playwright.sync_api import sync_playwright  # noqa: PLC0415

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        yield browser
        browser.close()


@pytest.fixture(scope="session")
def first_operator() -> Iterator[list[Operator]]:
    """Whoever sits at the station from test to test, if anybody."""
    held: list[Operator] = []
    yield held
    for operator in held:
        operator.context.close()


@pytest.fixture
def anna(station: Server, chromium: Any, simulated: Simulated, first_operator: list[Operator]) -> Iterator[Operator]:
    """The station's operator before the newest picture that answers, without pins; one page serves all tests."""
    if not first_operator:
        first_operator.append(Operator(chromium, station))
    (operator,) = first_operator
    operator.show(simulated.newest, simulated)
    yield operator
    try:
        operator.tidy()
    except BaseException:
        operator.context.close()
        first_operator.clear()
        raise
    operator.check()


@pytest.fixture
def operators(station: Server, chromium: Any, simulated: Simulated) -> Iterator[Callable[..., Operator]]:
    made: list[Operator] = []

    def another(server: Server = station, **context: Any) -> Operator:
        made.append(Operator(chromium, server, **context))
        made[-1].show(simulated.newest, simulated)
        return made[-1]

    yield another
    for operator in made:
        operator.clear()
        operator.context.close()
        operator.check()


@pytest.fixture
def flying(tmp_path: Path, chromium: Any) -> Iterator[Flying]:
    page_is_built()
    made: list[tuple[Flight, Operator]] = []

    def begin(
        aircraft: int = 1, rules: Rules | None = None, token: str = "", **context: Any
    ) -> tuple[Flight, Operator]:
        flight = Flight(tmp_path / "pins.sqlite", aircraft=aircraft, rules=rules, token=token)
        flight.__enter__()
        flight.source.fly_to(1)
        made.append((flight, Operator(chromium, flight, **context)))
        return made[-1]

    yield begin
    for flight, operator in made:
        operator.context.close()
        flight.__exit__(None, None, None)
        operator.check()


def page_is_built() -> None:
    """Or the test fails."""
    if not (STATIC / "index.html").is_file():
        pytest.fail("the page was not built: make web")
