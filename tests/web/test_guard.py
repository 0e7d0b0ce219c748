"""Who is refused: other names for this machine, other origins, no token, and paths that lead elsewhere."""

import sqlite3
from collections.abc import Iterator
from pathlib import Path

import pytest
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from contract.errors import InputError
from ground.web.guard import Rules, is_loopback
from ground.web.tiles import open_tiles
from tests.web.served import Simulated
from tests.web.test_api import Api

pytestmark = pytest.mark.xdist_group("web: served alone")
TOKEN = "a-token-of-some-length"


@pytest.fixture
def guarded(simulated: Simulated, tmp_path: Path) -> Iterator[TestClient]:
    (tmp_path / "index.html").write_text("<p>page</p>")
    (tmp_path.parent / "secret.txt").write_text("secret")
    api = Api(simulated, tmp_path / "pins.sqlite", Rules(TOKEN, frozenset({"ops.example"})))
    with api.client as client:
        yield client
    api.store.close()


@pytest.fixture
def open_to_this_machine(simulated: Simulated, tmp_path: Path) -> Iterator[TestClient]:
    (tmp_path / "index.html").write_text("<p>page</p>")
    api = Api(simulated, tmp_path / "pins.sqlite")
    with api.client as client:
        yield client
    api.store.close()


@pytest.mark.parametrize("host", ["evil.example", "evil.example:8080", "127.0.0.1.evil.example", "", "a b", "[::1"])
def test_a_name_that_is_made_to_resolve_to_us_is_refused(open_to_this_machine: TestClient, host: str) -> None:
    for path in ("/", "/api/pins"):
        assert open_to_this_machine.get(path, headers={"host": host}).status_code == 421


@pytest.mark.parametrize("host", ["127.0.0.1:8080", "localhost:8080", "[::1]:8080", "192.168.1.7"])
def test_addresses_and_localhost_are_answered(open_to_this_machine: TestClient, host: str) -> None:
    assert open_to_this_machine.get("/", headers={"host": host}).status_code == 200


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1:9999", "https://127.0.0.1.evil"])
def test_other_origins_are_refused(open_to_this_machine: TestClient, origin: str) -> None:
    for method, path in (("POST", "/api/undo"), ("GET", "/api/pins"), ("POST", "/api/click")):
        assert open_to_this_machine.request(method, path, headers={"origin": origin}, json={}).status_code == 403
    with (
        pytest.raises(WebSocketDisconnect),
        open_to_this_machine.websocket_connect(
            "/api/events", headers={"origin": origin, "host": "127.0.0.1:8080"}
        ) as socket,
    ):
        socket.receive_json()


def test_our_own_origin_and_none_are_answered(open_to_this_machine: TestClient) -> None:
    own = {"origin": "http://127.0.0.1:8080"}
    assert open_to_this_machine.post("/api/undo", headers=own, json={}).status_code == 200
    assert open_to_this_machine.post("/api/undo", json={}).status_code == 200
    other_site = {"sec-fetch-site": "cross-site"}
    assert open_to_this_machine.post("/api/undo", headers=other_site, json={}).status_code == 403


def test_a_token_opens_everything_and_nothing_opens_without(guarded: TestClient) -> None:
    for path in ("/", "/api/pins", "/api/openapi.json", "/index.html", "/?token=wrong", f"/api/pins?token={TOKEN}"):
        assert guarded.get(path).status_code == 401
    assert guarded.get("/api/pins", headers={"authorization": "Bearer wrong"}).status_code == 401
    assert guarded.get("/api/pins", headers={"authorization": f"Bearer {TOKEN}"}).status_code == 200
    with (
        pytest.raises(WebSocketDisconnect),
        guarded.websocket_connect("/api/events", headers={"host": "127.0.0.1:8080"}) as socket,
    ):
        socket.receive_json()
    opened = guarded.get(f"/?token={TOKEN}", follow_redirects=False)
    assert (opened.status_code, opened.headers["location"]) == (303, "/")
    cookie = opened.headers["set-cookie"]
    assert "HttpOnly" in cookie
    assert "SameSite=strict" in cookie
    assert guarded.get("/api/pins").status_code == 200  # the cookie is kept
    assert guarded.get("/", headers={"host": "ops.example:8080"}).status_code in (200, 401)


@pytest.mark.parametrize(
    "path",
    ["/../secret.txt", "/%2e%2e/secret.txt", "/..%2fsecret.txt", "/a/../../secret.txt"],
)
def test_paths_that_lead_out_of_the_page_lead_nowhere(open_to_this_machine: TestClient, path: str) -> None:
    found = open_to_this_machine.get(path)
    assert found.status_code in (403, 404)
    assert "secret" not in found.text


def test_every_answer_keeps_the_page_to_its_own_origin(open_to_this_machine: TestClient) -> None:
    for path in ("/", "/api/pins", "/nowhere"):
        headers = open_to_this_machine.get(path).headers
        policy = headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "script-src 'self';" in policy
        assert "unsafe" not in policy
        assert headers["x-content-type-options"] == "nosniff"


def test_bodies_that_are_too_large_or_endless_are_refused(open_to_this_machine: TestClient) -> None:
    large = b"x" * 5_000_000
    assert open_to_this_machine.post("/api/pins", content=large).status_code == 413
    assert open_to_this_machine.post("/api/pins", content=iter([b"{}"])).status_code == 411


def test_loopback_is_distinguished_from_the_rest() -> None:
    assert [is_loopback(a) for a in ("127.0.0.1", "127.8.0.1", "::1", "localhost")] == [True] * 4
    assert [is_loopback(a) for a in ("0.0.0.0", "192.168.0.1", "::", "example.org")] == [False] * 4


def test_only_tiles_are_served_as_tiles(tmp_path: Path) -> None:
    (tmp_path / "text.pmtiles").write_text("no tiles")
    (tmp_path / "empty.mbtiles").write_bytes(b"")
    for name in ("text.pmtiles", "empty.mbtiles", "none.pmtiles"):
        with pytest.raises(InputError, match=name):
            open_tiles(str(tmp_path / name))
    with pytest.raises(InputError, match="must end with"):
        open_tiles("https://tiles.example/map")
    url = open_tiles("https://tiles.example/{z}/{x}/{y}.png")
    assert url.origin == "https://tiles.example"
    assert "https://tiles.example" in Rules(tile_origin=url.origin).content_security_policy()


def test_mbtiles_are_served_from_the_north(simulated: Simulated, tmp_path: Path) -> None:
    path = tmp_path / "base.mbtiles"
    with sqlite3.connect(path) as base:
        base.execute("CREATE TABLE metadata (name TEXT, value TEXT)")
        base.execute("CREATE TABLE tiles (zoom_level INT, tile_column INT, tile_row INT, tile_data BLOB)")
        base.execute("INSERT INTO metadata VALUES ('format', 'png')")
        base.execute("INSERT INTO tiles VALUES (3, 2, 7, x'89504e47')")
    api = Api(simulated, tmp_path / "pins.sqlite", tiles=open_tiles(str(path)))
    with api.client as client:
        found = client.get("/tiles/3/2/0")
        assert (found.content, found.headers["content-type"]) == (b"\x89PNG", "image/png")
        assert client.get("/tiles/3/2/7").status_code == 404
        assert client.get("/tiles/3/99/0").status_code == 404
    api.store.close()
