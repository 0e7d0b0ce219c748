"""A base map of the operator's own, seen in the browser."""

import json
import re
import threading
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

from ground.web.tiles import open_tiles
from tests.rest_long import rest_long
from tests.waiting import eventually
from tests.web.conftest import page_is_built
from tests.web.flying import Flight
from tests.web.measured import SMALL, opened, share_of
from tests.web.tile_files import COLOUR, REGION, rendered_tile, write_mbtiles, write_pmtiles, write_region

pytestmark = pytest.mark.xdist_group("web: a flight in motion")


def share_drawn(page: Any) -> float:
    """Of the map's pixels, those of the tiles, looked at until they are there: a map says nothing when it has drawn."""
    share = 0.0

    def is_drawn() -> bool:
        nonlocal share
        page.wait_for_timeout(100)
        share = share_of(page.get_by_test_id("map"), COLOUR)
        return share > 0.3

    eventually(is_drawn)
    return share


@pytest.mark.parametrize(
    ("name", "write"), rest_long([("base.mbtiles", write_mbtiles), ("base.pmtiles", write_pmtiles)])
)
def test_tiles_of_a_file_lie_under_the_map(
    tmp_path: Path, chromium: Any, name: str, write: Callable[[Path], None]
) -> None:
    page_is_built()
    write(tmp_path / name)
    with Flight(tmp_path / "pins.sqlite", open_tiles(str(tmp_path / name))) as flight:
        page = opened(chromium, flight.url, SMALL)
        try:
            assert share_drawn(page) > 0.3
        finally:
            page.context.close()


class Elsewhere(BaseHTTPRequestHandler):
    """Another server with the region's tiles: as TileJSON, one by one, and as a PMTiles file that is read in parts."""

    protocol_version = "HTTP/1.1"
    archive = b""

    def do_GET(self) -> None:
        content, status = self.archive, 200
        if found := re.fullmatch(r"/(\d+)/\d+/\d+\.png", self.path):
            content, status = (rendered_tile(), 200) if 10 <= int(found[1]) <= 12 else (b"", 404)
        elif self.path == "/map.json":
            tiles = f"http://127.0.0.1:{self.server.server_address[1]}/{{z}}/{{x}}/{{y}}.png"
            content = json.dumps({"tiles": [tiles], "minzoom": 10, "maxzoom": 12, "bounds": REGION}).encode()
        elif part := re.fullmatch(r"bytes=(\d+)-(\d+)", self.headers.get("range", "")):
            content, status = content[int(part[1]) : int(part[2]) + 1], 206
        self.send_response(status)
        self.send_header("access-control-allow-origin", "*")
        self.send_header("cross-origin-resource-policy", "cross-origin")
        self.send_header("content-length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def do_OPTIONS(self) -> None:
        self.send_response(204)
        self.send_header("access-control-allow-origin", "*")
        self.send_header("access-control-allow-headers", "range")
        self.end_headers()

    def log_message(self, format: str, *args: object) -> None:
        """Nothing."""


@pytest.fixture
def elsewhere(tmp_path: Path) -> Iterator[str]:
    write_region(tmp_path / "there.pmtiles")
    handler = type("Handler", (Elsewhere,), {"archive": (tmp_path / "there.pmtiles").read_bytes()})
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_address[1]}"
    server.shutdown()
    server.server_close()


@pytest.mark.parametrize("name", rest_long(["region.pmtiles", "region.mbtiles", "URL/there.pmtiles", "URL/map.json"]))
def test_tiles_of_a_region_are_in_sight_before_any_aircraft_is(
    tmp_path: Path, chromium: Any, elsewhere: str, name: str
) -> None:
    """Zooms 10 to 12 of some degrees: the page begins there, and not with the whole world."""
    page_is_built()
    if name.startswith("URL"):
        tiles = open_tiles(name.replace("URL", elsewhere))
    else:
        write_region(tmp_path / name)
        tiles = open_tiles(str(tmp_path / name))
        assert (tiles.min_zoom, tiles.max_zoom) == (10, 12)
        assert tiles.bounds == pytest.approx(REGION, abs=1e-3)
    with Flight(tmp_path / "pins.sqlite", tiles, aircraft=0) as flight:
        page = opened(chromium, flight.url, SMALL, has_picture=False)
        try:
            assert share_drawn(page) > 0.3
        finally:
            page.context.close()
