"""The page of `pc-ground web` as its operator waits for it, in a real Chromium over this machine's own loopback.

    python -m benchmarks.web [--clicks 500] [--pictures 3600]

Press to answer: from the pointer's press on the picture until the frame of the screen with the answer is done; each
click is a new pin, on disk with its crop. First page: from the address to the first picture in a browser without a
cache, after the server's start; the middle of three. Ten thousand pins: the same clicks with as many in the file.
Live: the same clicks on the newest picture of one of two aircraft that publish five sets a second each, with a second
browser open. API click: POST /api/click over one connection. Drawn: from the press of "All" until the dots are on the
screen (looked at ten times a second). Import: POST /api/import of ten thousand pins, until it is answered.
A long flight: heap and DOM nodes after each third of so many pictures, one a second of flight, of which the page shows
one in twenty. Chromium draws without a graphics card here, and shares the cores with the server.
"""

from __future__ import annotations

import argparse
import http.client
import json
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

from playwright.sync_api import sync_playwright

from benchmarks.live_aircraft import Aircraft
from benchmarks.machine import describe, load, table, verdict
from ground.formats.documents import FORMATS
from ground.formats.mark import Mark
from ground.pins.places import Places
from ground.pins.store import PinStore
from tests.waiting import PATIENCE_S
from tests.web.flying import Flight
from tests.web.measured import first_page_s, grown, opened, press_to_answer_ms, share_of, ten_thousand_pins
from tests.web.rendered import VEHICLE, record_rendered
from tests.web.served import ARGUMENTS, CHROMIUM, Server

SEEN_EVERY = 20
ANSWER_MS, MANY_MS, PAGE_S, PAGE_BYTES, GROWTH_MB, GROWTH_NODES = 50.0, 100.0, 1.0, 3_000_000, 3.0, 200
MEDIAN_MS, API_MS, DRAWN_S, IMPORT_S = 25.0, 5.0, 2.0, 3.0
POI, DOTS_SHARE = (0, 115, 90), 0.001  # the colour of the dots, and how much of the map they cover at least


def waits(chromium: Any, folder: Path, clicks: int) -> str:
    """First page, clicks, and clicks among ten thousand pins."""
    record_rendered(folder / "drawn.mcap")
    ten_thousand_pins(folder / "many.sqlite")
    pages_s: list[float] = []
    for k in range(3):
        server = Server("--from", folder / "drawn.mcap", "--pins", folder / f"few{k}.sqlite")
        took_s, transferred, page = first_page_s(chromium, server)
        pages_s.append(took_s)
        if k == 2:
            few_ms = press_to_answer_ms(page, clicks)
        page.context.close()
        server.close()
    server = Server("--from", folder / "drawn.mcap", "--pins", folder / "many.sqlite")
    page = opened(chromium, server.url)
    page.wait_for_function("() => document.querySelector('#pin-count').textContent === '10000'")
    many_ms = press_to_answer_ms(page, max(clicks // 5, 20))
    page.context.close()
    server.close()
    page_s = statistics.median(pages_s)
    rows = [
        ["first page, s", f"{page_s:.2f}", "", f"under {PAGE_S:g}", verdict(page_s < PAGE_S)],
        ["transferred, MB", f"{transferred / 1e6:.2f}", "", "under 3", verdict(transferred < PAGE_BYTES)],
    ]
    for name, ms, goal in (("press to answer, ms", few_ms, ANSWER_MS), ("with 10,000 pins, ms", many_ms, MANY_MS)):
        p95 = ms[int(0.95 * len(ms))]
        rows.append([name, f"{statistics.median(ms):.1f}", f"{p95:.1f}", f"95 % under {goal:g}", verdict(p95 < goal)])
    return table(["", "median", "95 %", "goal", ""], rows)


def live(chromium: Any, folder: Path, clicks: int) -> str:
    """Clicks on one of two aircraft on the link, with two browsers."""
    fleet = [Aircraft(name) for name in ("uav-1", "uav-2")]
    server = None
    try:
        connect = [part for one in fleet for part in ("--connect", one.endpoint)]
        server = Server(*connect, "--pins", folder / "live.sqlite", "--journal", folder / "live.link")
        page, other = opened(chromium, server.url), opened(chromium, server.url)
        other.locator(".craft[data-vehicle=uav-2]").click()
        ms = press_to_answer_ms(page, clicks)
        page.context.close()
        other.context.close()
    finally:
        if server is not None:
            server.close()
        for one in fleet:
            one.close()
    median, p95 = statistics.median(ms), ms[int(0.95 * len(ms))]
    goal = f"{MEDIAN_MS:g}, 95 % {ANSWER_MS:g}"
    row = ["live, 2 aircraft, 2 browsers, ms", f"{median:.1f}", f"{p95:.1f}", goal]
    return table(["", "median", "95 %", "goal", ""], [[*row, verdict(median <= MEDIAN_MS and p95 <= ANSWER_MS)]])


def api_and_import(chromium: Any, folder: Path, clicks: int) -> str:
    """The times that programs wait for, and the cost of ten thousand pins."""
    record_rendered(folder / "api.mcap")
    ten_thousand_pins(folder / "wide.sqlite", step_deg=1e-3)
    with PinStore(folder / "wide.sqlite") as store:
        pins = store.pins()
        marks = [Mark.of_pin(pin, place) for pin, place in zip(pins, Places(store).of(pins), strict=True)]
    rows = []
    server = Server("--from", folder / "api.mcap", "--pins", folder / "api.sqlite")
    asked = http.client.HTTPConnection("127.0.0.1", server.port, timeout=PATIENCE_S)

    def post(path: str, body: bytes) -> float:
        began_s = time.monotonic()
        asked.request("POST", path, body, {"content-type": "application/json"})
        answer = asked.getresponse()
        answer.read()
        assert answer.status == 200, answer.status
        return time.monotonic() - began_s

    ms = []
    for k in range(clicks + 20):
        click = {"vehicle": VEHICLE, "frame": k % 12, "u": 60 + (37 * k) % 500, "v": 60 + (53 * k) % 350}
        ms.append(1000.0 * post("/api/click", json.dumps(click).encode()))
    ms = sorted(ms[20:])
    p95 = ms[int(0.95 * len(ms))]
    rows.append(
        ["API click, ms", f"{statistics.median(ms):.1f}", f"{p95:.1f}", f"95 % {API_MS:g}", verdict(p95 <= API_MS)]
    )
    for kind in ("csv", "geojson", "gpx", "kml"):
        about = FORMATS[kind]
        content = about.write(marks, None).encode()
        asked.close()  # the server closed it meanwhile; it opens again by itself
        took_s = post(f"/api/import?name=pins{about.suffix}", content)
        rows.append([f"import of 10,000, {kind}, s", f"{took_s:.1f}", "", f"{IMPORT_S:g}", verdict(took_s <= IMPORT_S)])
    server.close()
    server = Server("--from", folder / "api.mcap", "--pins", folder / "wide.sqlite")
    page = opened(chromium, server.url)
    page.wait_for_function("() => document.querySelector('#map').dataset.pins === '10000'")
    page.locator("#fit").click()
    began_s = time.monotonic()
    while share_of(page.get_by_test_id("map"), POI) < DOTS_SHARE and time.monotonic() - began_s < PATIENCE_S:
        page.wait_for_timeout(20)
    took_s = time.monotonic() - began_s
    rows.append(["10,000 pins drawn, s", f"{took_s:.1f}", "", f"{DRAWN_S:g}", verdict(took_s <= DRAWN_S)])
    page.context.close()
    server.close()
    return table(["", "median", "95 %", "goal", ""], rows)


def hour(chromium: Any, folder: Path, pictures: int) -> str:
    """The growth of an open page."""
    found = []
    with Flight(folder / "hour.sqlite") as flight:
        page = opened(chromium, flight.url)
        for third in range(3):
            for count in range(third * pictures // 3 + SEEN_EVERY, (third + 1) * pictures // 3 + 1, SEEN_EVERY):
                flight.source.fly_to(count)
                page.wait_for_function(
                    "n => document.querySelector('#frame-label').textContent.startsWith(`picture ${n} `)",
                    arg=count - 1, polling=20, timeout=PATIENCE_S * 1000.0,
                )  # fmt: skip
            found.append(grown(page))
        page.context.close()
    rows = [[f"{(k + 1) * pictures // 3} pictures", f"{mb:.1f}", str(nodes)] for k, (mb, nodes) in enumerate(found)]
    (first_mb, first_nodes), (last_mb, last_nodes) = found[0], found[-1]
    is_bounded = last_mb - first_mb < GROWTH_MB and last_nodes - first_nodes < GROWTH_NODES
    goal = f"grows by less than {GROWTH_MB:g} MB and {GROWTH_NODES} nodes: {verdict(is_bounded)}"
    return table(["", "heap, MB", "nodes"], rows) + f"\n\n{goal}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--clicks", type=int, default=500, help="default 500")
    parser.add_argument("--pictures", type=int, default=3600, help="of the long flight (default 3600: an hour)")
    args = parser.parse_args()
    if CHROMIUM is None:
        raise SystemExit("no chromium: sudo apt-get install chromium")
    print(f"{describe()}; {load()}\n")
    with tempfile.TemporaryDirectory(prefix="bench-web-") as folder, sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        print(waits(chromium, Path(folder), args.clicks))
        print("\n" + live(chromium, Path(folder), args.clicks))
        print("\n" + api_and_import(chromium, Path(folder), args.clicks))
        print("\n" + hour(chromium, Path(folder), args.pictures))
        chromium.close()
    print(f"\n{load()}")


if __name__ == "__main__":
    main()
