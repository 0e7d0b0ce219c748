"""Downloading an area of the base map from a tile server of this test: counted, bounded, ended, and used afterwards."""

import contextlib
import gzip
import io
import json
import re
import socket
import sqlite3
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.request import Request, urlopen

import pytest
from PIL import Image
from starlette.testclient import TestClient

from contract.errors import InputError
from ground.web import tile_area, tile_fetch
from ground.web.guard import Rules
from ground.web.tile_area import TileArea, area_of
from ground.web.tile_fetch import checked_tile
from ground.web.tiles import MbTiles, open_tiles
from tests.waiting import eventually
from tests.web.conftest import page_is_built
from tests.web.flying import Flight, requests_to
from tests.web.measured import SMALL, opened
from tests.web.served import PageProgram
from tests.web.test_base_map import share_drawn
from tests.web.tile_files import REGION, rendered_tile, write_mbtiles, write_region

pytestmark = pytest.mark.xdist_group("web: a flight in motion")

INSIDE = REGION[0] + 0.01, REGION[1] + 0.01, REGION[2] - 0.01, REGION[3] - 0.01
VIEW = dict(zip(("west", "south", "east", "north"), INSIDE, strict=True)) | {"zoom": 10}
TOKENS = {"operator": "operators-token-1234", "viewer": "viewers-token-1234"}
RULES = Rules(TOKENS["operator"], viewer_token=TOKENS["viewer"])
OPERATOR = {"authorization": f"Bearer {TOKENS['operator']}"}
HUGE = rendered_tile() + bytes(2_100_000)
VECTOR = b"\x1a\x05\x0a\x03sea"  # a layer with a name alone


class TileServer:
    """On loopback, of tiles that a test decides about: `answer` gives status, headers and content."""

    def __init__(self) -> None:
        self.asked: list[tuple[int, int, int]] = []
        self.agents: set[str] = set()
        self.most_at_once = 0
        self.gate = threading.Event()  # tiles wait for it
        self.gate.set()
        self.about: dict[str, Any] = {}
        self.answer: Callable[[int, int, int], tuple[int, dict[str, str], bytes]] = lambda *_: (
            200,
            {},
            rendered_tile(),
        )
        outer, lock, at_once = self, threading.Lock(), [0]

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def do_GET(self) -> None:
                found = re.fullmatch(r"/(\d+)/(\d+)/(\d+)\.png", self.path)
                status, headers, content = 404, {}, b"nothing"
                if self.path == "/map.json":
                    about = {"tiles": [outer.template], **outer.about}
                    status, content = 200, json.dumps(about).encode()
                elif found is not None:
                    z, x, y = (int(part) for part in found.groups())
                    with lock:
                        at_once[0] += 1
                        outer.most_at_once = max(outer.most_at_once, at_once[0])
                        outer.asked.append((z, x, y))
                        outer.agents.add(self.headers.get("user-agent", ""))
                    outer.gate.wait(60.0)
                    status, headers, content = outer.answer(z, x, y)
                    with lock:
                        at_once[0] -= 1
                self.send_response(status)
                for name, value in {"access-control-allow-origin": "*", **headers}.items():
                    self.send_header(name, value)
                self.send_header("content-length", str(len(content)))
                self.end_headers()
                with contextlib.suppress(ConnectionError):  # who gets too much hangs up
                    self.wfile.write(content)

            def log_message(self, format: str, *args: object) -> None:
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self._server.server_address[1]}"
        self.template = f"{self.url}/{{z}}/{{x}}/{{y}}.png"
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def close(self) -> None:
        self.gate.set()
        self._server.shutdown()
        self._server.server_close()


@pytest.fixture
def there() -> Iterator[TileServer]:
    server = TileServer()
    yield server
    server.close()


@contextmanager
def api(folder: Path, source: str | None, attribution: str = "") -> Iterator[TestClient]:
    tiles = None if source is None else open_tiles(source, attribution)
    with requests_to(folder, RULES, OPERATOR, tiles=tiles, area=area_of(tiles, folder / "tiles")) as (client, _):
        yield client


def ended(client: TestClient) -> dict[str, Any]:
    state: dict[str, Any] = {}

    def has_ended() -> bool:
        state.update(client.get("/api/tiles").json())
        return state["state"] != "running"

    assert eventually(has_ended)
    return state


def downloaded(client: TestClient, deepest: int = 12, **view: Any) -> dict[str, Any]:
    begun = client.post("/api/tiles/download", json={**VIEW, **view, "deepest": deepest})
    assert begun.status_code == 200, begun.text
    return ended(client)


def planned(client: TestClient) -> list[dict[str, int]]:
    choices: list[dict[str, int]] = client.post("/api/tiles/plan", json=VIEW).json()["choices"]
    return choices


def kept(folder: Path) -> tuple[dict[str, str], int]:
    """The metadata of the one file that is there, and how many tiles it has."""
    (path,) = (folder / "tiles").glob("*.mbtiles")
    with sqlite3.connect(path) as base:
        about = dict(base.execute("SELECT name, value FROM metadata").fetchall())
        return about, int(base.execute("SELECT count(*) FROM tiles").fetchone()[0])


def test_it_is_counted_first_then_kept_whole_by_one_connection(tmp_path: Path, there: TileServer) -> None:
    there.about = {"minzoom": 3, "maxzoom": 14, "attribution": "<b>us</b>"}
    with api(tmp_path, f"{there.url}/map.json") as client:
        plan = planned(client)
        # Two by two tiles of zoom 10, in each further zoom four times as many.
        assert [(c["deepest"], c["tiles"]) for c in plan] == [(10, 4), (11, 20), (12, 84), (13, 340), (14, 1364)]
        assert plan[1]["bytes"] == 20 * len(rendered_tile())
        assert len(there.asked) == 1 and client.get("/api/status").json()["tiles"]["kind"] == "tilejson"
        there.asked.clear()
        state = downloaded(client)
        assert (state["state"], state["tiles"], state["of"], state["gaps"]) == ("done", 84, 84, 0)
        assert len(there.asked) == len(set(there.asked)) == 84 and there.most_at_once == 1
        assert len(there.agents) == 1 and "pointclick" in there.agents.pop()
        again = planned(client)[2]
        assert (again["tiles"], again["held"], again["bytes"]) == (84, 84, 0)
        there.asked.clear()
        assert downloaded(client)["tiles"] == 84 and there.asked == []
    about, count = kept(tmp_path)
    assert count == 84 and (about["format"], about["minzoom"], about["maxzoom"]) == ("png", "10", "12")
    assert about["attribution"] == "<b>us</b>" and about["name"]
    assert [float(part) for part in about["bounds"].split(",")] == pytest.approx(INSIDE, abs=1e-5)
    (path,) = (tmp_path / "tiles").glob("*.mbtiles")
    assert open_tiles(str(path)).max_zoom == 12  # as a file of the operator's own too


def test_after_a_restart_without_the_address_the_file_alone_serves(tmp_path: Path, there: TileServer) -> None:
    with api(tmp_path, there.template, "us") as client:
        downloaded(client, 10)
        assert client.get("/tiles/10/935/649").content == rendered_tile()
        sent_on = client.get("/tiles/14/7/9")
        assert (sent_on.status_code, sent_on.headers["location"]) == (307, f"{there.url}/14/7/9.png")
    there.close()
    with api(tmp_path, there.template) as client:
        tile = client.get("/tiles/10/935/649")
        assert (tile.content, tile.headers["content-type"]) == (rendered_tile(), "image/png")
        tiles = client.get("/api/status").json()["tiles"]
        assert (tiles["kind"], tiles["url"], tiles["attribution"]) == ("kept", "/tiles/{z}/{x}/{y}", "us")
        refused = client.post("/api/tiles/plan", json=VIEW)
        assert refused.status_code == 422 and "127.0.0.1 is not reachable" in refused.json()["detail"]


def test_of_a_tilejson_address_that_is_gone_what_is_not_kept_is_not_there(tmp_path: Path, there: TileServer) -> None:
    there.about = {"minzoom": 3, "maxzoom": 11, "attribution": "us"}
    with api(tmp_path, f"{there.url}/map.json") as client:
        downloaded(client, 10)
        assert client.get("/tiles/11/7/9").status_code == 307
    there.close()
    with api(tmp_path, f"{there.url}/map.json") as client:
        assert client.get("/tiles/10/935/649").status_code == 200 and client.get("/tiles/11/7/9").status_code == 404
        tiles = client.get("/api/status").json()["tiles"]
        assert (tiles["min_zoom"], tiles["max_zoom"], tiles["attribution"]) == (3, 11, "us")


def test_gaps_are_counted_and_are_no_fault(tmp_path: Path, there: TileServer) -> None:
    there.answer = lambda z, x, y: (404, {}, b"") if x % 2 else (204, {}, b"") if y % 2 else (200, {}, rendered_tile())
    with api(tmp_path, there.template) as client:
        state = downloaded(client, 11)
        assert (state["state"], state["tiles"], state["gaps"]) == ("done", 5, 15)


@pytest.mark.parametrize(
    ("status", "headers", "content", "words"),
    [
        (429, {}, b"", "asks for no more now (429)"),
        (403, {}, b"", "forbids it (403)"),
        (503, {}, b"", "answers with an error (503)"),
        (200, {}, b"<html>log in to this network</html>", "sent no map tile for"),
        (200, {}, HUGE, "sends more than 2 MB"),
        (302, {"location": "http://localhost:1/10/1/1.png"}, b"", "another host (localhost): refused"),
        (302, {"location": "file:///etc/passwd"}, b"", "another host (None): refused"),
        (302, {"location": "/loop"}, b"", "sends on and on"),
    ],
    ids=["429", "403", "503", "page", "huge", "host", "file", "loop"],
)  # fmt: skip
def test_it_stops_at_once_and_states_why_and_keeps_what_came(
    tmp_path: Path, there: TileServer, monkeypatch: pytest.MonkeyPatch,
    status: int, headers: dict[str, str], content: bytes, words: str,
) -> None:  # fmt: skip
    monkeypatch.setattr(tile_fetch, "PAUSE_S", 0.01)
    most = 3 if status == 503 else 1  # an error of the server's own is tried again
    if headers.get("location") == "/loop":
        headers, most = {"location": "/10/0/0.png"}, 4  # three times onwards, not for ever
    there.answer = lambda *_: (status, headers, content) if len(there.asked) > 6 else (200, {}, rendered_tile())
    with api(tmp_path, there.template) as client:
        state = downloaded(client)
        assert state["state"] == "stopped" and words in state["words"]
        assert state["tiles"] == 6 and len(there.asked) == 6 + most
        assert kept(tmp_path)[1] == 6 and client.get("/tiles/10/935/649").status_code == 200
        # The rest is fetched once the server allows it.
        there.answer = lambda *_: (200, {}, rendered_tile())
        assert downloaded(client)["state"] == "done" and kept(tmp_path)[1] == 84


def test_it_is_cancelled_while_a_tile_is_waited_for(tmp_path: Path, there: TileServer) -> None:
    def answer(*_: int) -> tuple[int, dict[str, str], bytes]:
        if len(there.asked) == 5:
            there.gate.clear()
        return 200, {}, rendered_tile()

    there.answer = answer
    with api(tmp_path, there.template) as client:
        client.post("/api/tiles/download", json={**VIEW, "deepest": 12})
        assert eventually(lambda: len(there.asked) == 6)  # which is not answered
        busy = client.post("/api/tiles/download", json={**VIEW, "deepest": 12})
        assert busy.status_code == 422 and "cancel it" in busy.json()["detail"]
        client.delete("/api/tiles/download")
        state = ended(client)
        assert (state["state"], state["tiles"]) == ("cancelled", 5) and kept(tmp_path)[1] == 5
        there.gate.set()


def test_too_many_tiles_and_too_many_bytes_are_refused(
    tmp_path: Path, there: TileServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    with api(tmp_path, there.template) as client:
        deep = {**VIEW, "zoom": 16}
        for path, body in (("plan", deep), ("download", {**deep, "deepest": 16})):
            refused = client.post(f"/api/tiles/{path}", json=body)
            assert refused.status_code == 422 and "too many tiles" in refused.json()["detail"]
            assert "zoom in" in refused.json()["detail"]
        assert [c["deepest"] for c in planned(client)] == [10, 11, 12, 13, 14]
        monkeypatch.setattr(tile_area, "MOST_BYTES", 30 * len(rendered_tile()))
        assert [c["deepest"] for c in planned(client)] == [10, 11]
        state = downloaded(client)
        assert (state["state"], state["tiles"]) == ("stopped", 30) and "MB are the most" in state["words"]
        over = client.post("/api/tiles/plan", json={**VIEW, "west": -190.0})
        assert over.status_code == 422 and "180 degrees" in over.json()["detail"]


def test_without_an_address_of_single_tiles_the_reason_is_stated(tmp_path: Path) -> None:
    write_mbtiles(tmp_path / "own #1?.mbtiles")
    sources = {
        None: "no tile address is configured",
        str(tmp_path / "own #1?.mbtiles"): "a file already",
        "http://127.0.0.1:1/a.pmtiles": "copy that file",
    }
    for source, words in sources.items():
        with api(tmp_path, source) as client:
            for path in ("plan", "download"):
                more = {"deepest": 11} if path == "download" else {}
                refused = client.post(f"/api/tiles/{path}", json={**VIEW, **more})
                assert refused.status_code == 422 and words in refused.json()["detail"]


def test_tiles_of_another_host_than_the_tilejsons_are_refused(tmp_path: Path, there: TileServer) -> None:
    there.about = {"tiles": ["http://192.0.2.7/{z}/{x}/{y}.png"]}
    with api(tmp_path, f"{there.url}/map.json") as client:
        refused = client.post("/api/tiles/plan", json=VIEW)
        assert refused.status_code == 422 and "another host (192.0.2.7)" in refused.json()["detail"]
    there.about = {"tiles": [5]}
    with api(tmp_path, f"{there.url}/map.json") as client:
        assert "cannot be used" in client.post("/api/tiles/plan", json=VIEW).json()["detail"]


def test_rows_that_count_from_the_south_are_where_they_belong(tmp_path: Path, there: TileServer) -> None:
    """Taken as they are, they are a map of the other hemisphere."""
    there.about = {"scheme": "tms", "maxzoom": 12}
    with api(tmp_path, f"{there.url}/map.json") as client:
        assert downloaded(client, 10)["state"] == "done"
        asked = {(z, x, (1 << z) - 1 - y) for z, x, y in there.asked}
        assert asked and all(client.get(f"/tiles/{z}/{x}/{y}").status_code == 200 for z, x, y in asked)
        assert client.get("/tiles/10/0/1").headers["location"].endswith("/10/0/1022.png")
    for about in ({"scheme": "zyx"}, {"maxzoom": float("inf")}):
        there.about = about
        (tmp_path / "other").mkdir(exist_ok=True)
        with api(tmp_path / "other", f"{there.url}/map.json") as client:
            assert client.post("/api/tiles/plan", json=VIEW).status_code == 422


@pytest.mark.parametrize("wrong", ["zoom_level = 'deep'", "zoom_level = -1", "zoom_level = 1 << 40", "tile_row = NULL"])
def test_a_foreign_file_whose_tiles_are_of_no_map_is_refused(tmp_path: Path, wrong: str) -> None:
    write_region(tmp_path / "a.mbtiles")
    with sqlite3.connect(tmp_path / "a.mbtiles") as base:
        base.execute(f"UPDATE tiles SET {wrong}")
    with pytest.raises(InputError, match="not an MBTiles file"):
        open_tiles(str(tmp_path / "a.mbtiles"))


@pytest.mark.parametrize("content", ["'text'", "1000000000"])
def test_what_is_no_tile_in_a_foreign_file_is_none(tmp_path: Path, content: str) -> None:
    write_region(tmp_path / "a.mbtiles")
    file = MbTiles(open_tiles(str(tmp_path / "a.mbtiles")))
    assert file.tile(10, 935, 649) is not None
    with sqlite3.connect(tmp_path / "a.mbtiles") as base:
        base.execute(f"UPDATE tiles SET tile_data = {content}")
    assert file.tile(10, 935, 649) is None


def test_an_answer_that_never_comes_to_its_content_is_hung_up_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each line of it comes in time, without end."""
    monkeypatch.setattr(tile_fetch, "ANSWER_S", 0.2)
    with socket.create_server(("127.0.0.1", 0)) as server:

        def drip() -> None:
            held, _ = server.accept()
            with held, contextlib.suppress(OSError):
                while True:
                    held.sendall(b"HTTP/1.1 100 Continue\r\n\r\n")
                    threading.Event().wait(0.01)

        threading.Thread(target=drip, daemon=True).start()
        url = f"http://127.0.0.1:{server.getsockname()[1]}/"
        with tile_fetch.fetching(url, tries=1) as fetcher, pytest.raises(InputError, match="no answer in time"):
            fetcher.get(url, 1000)


def test_a_file_that_is_damaged_later_leaves_the_page_and_the_address(tmp_path: Path, there: TileServer) -> None:
    with api(tmp_path, there.template) as client:
        downloaded(client, 10)
        (path,) = (tmp_path / "tiles").glob("*.mbtiles")
        path.write_bytes(path.read_bytes()[:4096] + bytes(path.stat().st_size - 4096))
    with api(tmp_path, there.template) as client:
        assert client.get("/api/status").status_code == 200
        assert client.get("/tiles/10/935/649").headers["location"].startswith(there.url)


def test_a_viewer_begins_and_ends_nothing(tmp_path: Path, there: TileServer) -> None:
    viewer = {"authorization": f"Bearer {TOKENS['viewer']}"}
    with api(tmp_path, there.template) as client:
        assert client.post("/api/tiles/plan", json=VIEW, headers=viewer).status_code == 403
        assert client.post("/api/tiles/download", json={**VIEW, "deepest": 11}, headers=viewer).status_code == 403
        assert client.delete("/api/tiles/download", headers=viewer).status_code == 403
        assert there.asked == [] and client.get("/api/tiles", headers=viewer).json()["state"] == "idle"


def test_vector_tiles_are_kept_packed_and_not_mixed_with_images(tmp_path: Path, there: TileServer) -> None:
    there.answer = lambda z, x, y: (200, {}, VECTOR if x % 2 else gzip.compress(VECTOR))
    with api(tmp_path, there.template) as client:
        assert downloaded(client, 10)["format"] == "pbf"
        tile = client.get("/tiles/10/935/649")
        assert (tile.content, tile.headers["content-type"]) == (VECTOR, "application/x-protobuf")
        assert client.get("/api/status").json()["tiles"]["format"] == "pbf"
        there.answer = lambda *_: (200, {}, rendered_tile())
        state = downloaded(client, 11)
        assert state["state"] == "stopped" and "mixed" in state["words"]


def test_only_images_and_vector_tiles_are_tiles() -> None:
    for kind in ("PNG", "JPEG", "WEBP"):
        out = io.BytesIO()
        Image.new("RGB", (8, 8)).save(out, kind)
        assert checked_tile(out.getvalue()) == checked_tile(gzip.compress(out.getvalue())) == out.getvalue()
    packed = checked_tile(VECTOR * 2)
    assert packed is not None and gzip.decompress(packed) == VECTOR * 2
    bomb = gzip.compress(b"\x1a\x80\x80\x80\x10" + bytes(33_554_432))
    cut = VECTOR[:-1], VECTOR + b"\x1a", gzip.compress(VECTOR)[:-3]
    for wrong in (b"", b"GIF89a", b"<svg/>", b"\x0a" + VECTOR[1:], *cut, bomb):
        assert checked_tile(wrong) is None


def test_a_file_that_is_no_database_is_named(tmp_path: Path, there: TileServer) -> None:
    with api(tmp_path, there.template) as client:
        downloaded(client, 10)
    (path,) = (tmp_path / "tiles").glob("*.mbtiles")
    path.write_bytes(b"no database at all" * 100)
    with pytest.raises(InputError, match=path.name):
        TileArea(open_tiles(there.template), tmp_path / "tiles")


def test_the_command_keeps_it_in_the_users_data_folder(tmp_path: Path, there: TileServer) -> None:
    words = ("web", "--port", 0, "--no-journal", "--connect", "tcp/127.0.0.1:1", "--pins", tmp_path / "pins.sqlite")
    stated = "--tiles-attribution", "us"
    refused = PageProgram(*words, *stated, home=tmp_path)
    assert not refused.is_served and "--tiles-attribution goes with --tiles" in refused.printed
    program = PageProgram(*words, "--tiles", there.template, *stated, home=tmp_path)
    try:
        body = json.dumps({**VIEW, "deepest": 10}).encode()
        headers = {"content-type": "application/json"}
        with urlopen(Request(f"{program.url}api/tiles/download", body, headers)) as answer:
            assert json.load(answer)["of"] == 4
        files = tmp_path / "pointclick"
        assert eventually(lambda: len(there.asked) == 4)
    finally:
        program.end()
    about, count = kept(files)
    assert count == 4 and about["attribution"] == "us"


def test_an_operator_downloads_what_the_map_shows_and_has_it_without_the_address(
    tmp_path: Path, chromium: Any, there: TileServer
) -> None:
    page_is_built()
    there.about = {"minzoom": 3, "maxzoom": 12, "bounds": REGION, "attribution": "<i>ours</i>"}
    tiles = open_tiles(f"{there.url}/map.json")

    def started() -> Flight:
        return Flight(tmp_path / "pins.sqlite", tiles, aircraft=0, area=area_of(tiles, tmp_path / "tiles"))

    with started() as flight:
        page = opened(chromium, flight.url, SMALL, has_picture=False)
        asked: list[str] = []
        page.on("request", lambda request: asked.append(request.url))
        try:
            assert share_drawn(page) > 0.3
            page.get_by_test_id("layers").click()
            page.get_by_test_id("download-area").click()
            page.get_by_test_id("area-go").wait_for()
            assert page.get_by_test_id("area-words").inner_text().endswith("ours")
            choices = page.locator("#area-deepest option").all_inner_texts()
            assert re.fullmatch(r"12: \d+ tiles, about \d+\.\d+ MB", choices[-1])
            page.locator("#area-deepest").select_option("10")
            page.get_by_test_id("area-go").click()
            page.wait_for_selector("#area-dialog[data-state=done]")
            words = page.get_by_test_id("area-words").inner_text()
            count = int(choices[-3].split()[1])
            assert words.startswith("Downloaded: ") and f" of {count} tiles" in words
            page.locator("#area-dialog [data-close]").click()
            # Used at once: the map asks for its tiles here.
            assert eventually(lambda: any(url.startswith(f"{flight.local}tiles/") for url in asked))
        finally:
            page.context.close()
    there.close()
    with started() as flight:
        page = opened(chromium, flight.url, SMALL, has_picture=False)
        try:
            assert share_drawn(page) > 0.3
            assert "ours" in page.locator(".maplibregl-ctrl-attrib").text_content()
        finally:
            page.context.close()
