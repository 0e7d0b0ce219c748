"""An hour of flight before an open page, in fast motion; and as many tablets as a search has."""

import asyncio
import json
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import httpx2
import pytest
from websockets.asyncio.client import connect

from tests.waiting import PATIENCE_S
from tests.web.conftest import page_is_built
from tests.web.flying import Flight
from tests.web.measured import SMALL, grown, opened
from tests.web.rendered import VEHICLE

pytestmark = pytest.mark.xdist_group("web: a flight in motion")

HOUR = 3600  # pictures, one a second
SEEN_EVERY = 120  # the page shows one in so many
WARM = 2400
TABLETS = 50


@pytest.fixture
def flight(tmp_path: Path) -> Iterator[Flight]:
    page_is_built()
    with Flight(tmp_path / "pins.sqlite") as made:
        yield made


def fly(flight: Flight, page: Any, first: int, last: int) -> None:
    """Every so many pictures the page has caught up."""
    for count in range(first, last + 1, SEEN_EVERY):
        flight.source.fly_to(count)
        page.wait_for_function(
            "n => document.querySelector('#frame-label').textContent.startsWith(`picture ${n} `)",
            arg=count - 1,
            polling=50,
        )


@pytest.mark.long
def test_a_page_that_is_open_for_an_hour_of_flight_does_not_grow(flight: Flight, chromium: Any) -> None:
    page = opened(chromium, flight.url, SMALL)
    try:
        fly(flight, page, SEEN_EVERY, WARM)
        before_mb, before_nodes = grown(page)
        fly(flight, page, WARM + SEEN_EVERY, HOUR)
        after_mb, after_nodes = grown(page)
        held = page.locator("#time-bar").get_attribute("max")
    finally:
        page.context.close()
    print(f"\nheap {before_mb:.1f} -> {after_mb:.1f} MB, nodes {before_nodes} -> {after_nodes}")
    assert held == str(HOUR - 1)  # no picture that came was lost to the page
    # The rows of the pictures themselves are 0.2 kB each.
    assert after_mb - before_mb < 3.0
    assert after_nodes - before_nodes < 200


@pytest.mark.long  # short: two, in test_pins_page.py
def test_fifty_tablets_at_once_each_hear_of_every_pin(flight: Flight) -> None:
    async def tablet(k: int, joined: asyncio.Barrier, client: httpx2.AsyncClient) -> tuple[int, set[int]]:
        """Its own pin's number, and those that it knows of."""
        async with connect(f"ws://127.0.0.1:{flight.port}/api/events", open_timeout=PATIENCE_S) as socket:
            await joined.wait()
            click = {"vehicle": VEHICLE, "frame": 0, "u": 100.0 + 8.0 * k, "v": 150.0 + 3.0 * k}
            reported = await client.post("/api/pins", json={"click": click, "who": f"tablet {k}"})
            assert reported.status_code == 201, reported.text
            received: set[int] = set()
            while len(received) < TABLETS:
                event = json.loads(await socket.recv())
                if event["type"] == "pin":
                    received.add(event["pin"]["number"])
            return reported.json()["pin"]["number"], received

    async def all_of_them() -> list[tuple[int, set[int]]]:
        joined = asyncio.Barrier(TABLETS)
        limits = httpx2.Limits(max_connections=TABLETS)
        async with httpx2.AsyncClient(base_url=flight.url, timeout=PATIENCE_S, limits=limits) as client:
            return await asyncio.wait_for(
                asyncio.gather(*(tablet(k, joined, client) for k in range(TABLETS))), PATIENCE_S
            )

    with ThreadPoolExecutor(1) as thread:  # a browser that is open has a loop of its own in this one
        found = thread.submit(asyncio.run, all_of_them()).result()
    assert sorted(number for number, _ in found) == list(range(1, TABLETS + 1))
    assert all(received == set(range(1, TABLETS + 1)) for _, received in found)
    assert len(flight.store.pins()) == TABLETS
