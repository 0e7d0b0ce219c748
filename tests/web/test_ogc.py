"""The pins by OGC API - Features: as the standard has it, request by request; and read by another's client, GDAL's."""

import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import jsonschema
import numpy as np
import pyogrio
import pytest
from hypothesis import given
from hypothesis import strategies as st
from starlette.testclient import TestClient

from ground.formats.mark import Mark
from ground.pins.model import Category, PinClick
from ground.pins.store import PinStore
from ground.web.app import create_app
from ground.web.context import ServerContext
from ground.web.guard import Rules
from ground.web.ogc_definition import API_TYPE
from ground.web.ogc_selection import MAX_LIMIT, Selection, WrongParameter
from ground.web.recorded import RecordedSource
from tests.ground.pins.test_store import clicked
from tests.web.rendered import record_rendered
from tests.web.served import Server, Simulated

pytestmark = pytest.mark.xdist_group("web: served alone")
ITEMS = "/ogc/collections/pins/items"
NOON_NS = 1_767_268_800_000_000_000  # 2026-01-01T12:00:00Z
HOUR_NS = 3600 * 10**9

# What requirements 5, 7, 15 and 27 to 33 of OGC 17-069r4 ask of the documents.
LINK = {"type": "object", "required": ["href", "rel"], "properties": {"href": {"type": "string", "pattern": "^http"}}}
LINKS = {"type": "array", "minItems": 1, "items": LINK}
COLLECTION = {
    "type": "object",
    "required": ["id", "links"],
    "properties": {
        "links": LINKS,
        "itemType": {"const": "feature"},
        "crs": {"type": "array", "contains": {"const": "http://www.opengis.net/def/crs/OGC/1.3/CRS84"}},
        "extent": {
            "type": "object",
            "properties": {
                "spatial": {
                    "type": "object",
                    "required": ["bbox"],
                    "properties": {"bbox": {"type": "array", "minItems": 1, "items": {"type": "array", "minItems": 4}}},
                },
                "temporal": {"type": "object", "required": ["interval"]},
            },
        },
    },
}
POINT = {
    "type": "object",
    "required": ["type", "coordinates"],
    "properties": {
        "type": {"const": "Point"},
        "coordinates": {"type": "array", "minItems": 2, "maxItems": 3, "items": {"type": "number"}},
    },
}
FEATURE = {
    "type": "object",
    "required": ["type", "id", "geometry", "properties"],
    "properties": {
        "type": {"const": "Feature"},
        "id": {"type": "string"},
        "geometry": {"oneOf": [POINT, {"type": "null"}]},
        "properties": {"type": "object"},
    },
}
FEATURES = {
    "type": "object",
    "required": ["type", "features", "links", "timeStamp", "numberMatched", "numberReturned"],
    "properties": {
        "type": {"const": "FeatureCollection"},
        "features": {"type": "array", "items": FEATURE},
        "links": LINKS,
        "timeStamp": {"type": "string", "pattern": r"^\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ$"},
        "numberMatched": {"type": "integer", "minimum": 0},
        "numberReturned": {"type": "integer", "minimum": 0},
    },
}


def typed(lat_deg: float, lon_deg: float, hours: float | None) -> PinClick:
    seen = None if hours is None else NOON_NS + round(hours * HOUR_NS)
    return PinClick.entered(
        lat_deg, lon_deg, height_ellipsoid_m=650.0, sigma_m=2.0, who="ann", clicked_unix_ns=NOON_NS, seen_unix_ns=seen
    )


def filled(path: Path) -> PinStore:
    """Seven pins: one of a click, five that were typed, one of these deleted; one on the other side of the world."""
    store = PinStore(path)
    store.add([clicked()], name="tent", category=Category.PERSON, who="ann")
    for k in range(4):
        store.add([typed(-35.0 - 0.1 * k, 149.0 + 0.1 * k, float(k))], name=f"place {k}", who="ann")
    store.add([typed(10.0, 179.5, None)], name="across 'Ünï'", who="bob")
    gone = store.add([typed(0.0, 0.0, 0.0)], name="gone", who="bob")
    store.delete(gone.id, who="bob")
    return store


@pytest.fixture
def client(tmp_path: Path) -> Iterator[TestClient]:
    recording = tmp_path / "drawn.mcap"
    record_rendered(recording, 2)
    with filled(tmp_path / "pins.sqlite") as store:
        app = create_app(ServerContext(RecordedSource(recording), store, tmp_path, None), Rules())
        with TestClient(app, base_url="http://127.0.0.1:8080") as made:
            yield made


def got(client: TestClient, path: str, schema: dict[str, Any], kind: str = "application/json") -> dict[str, Any]:
    reply = client.get(path)
    assert reply.status_code == 200, reply.text
    assert reply.headers["content-type"].replace(" ", "") == kind
    content: dict[str, Any] = reply.json()
    jsonschema.validate(content, schema)
    return content


def rel(content: dict[str, Any], name: str) -> str:
    (found,) = (link["href"] for link in content["links"] if link["rel"] == name)
    assert isinstance(found, str)
    return found


def names(client: TestClient, query: str = "") -> list[str]:
    content = got(client, f"{ITEMS}{query}", FEATURES, "application/geo+json")
    assert content["numberReturned"] == len(content["features"])
    return [feature["properties"]["name"] for feature in content["features"]]


def test_from_the_landing_page_links_lead_to_everything(client: TestClient) -> None:
    landing = got(client, "/ogc", {"type": "object", "required": ["links"], "properties": {"links": LINKS}})
    assert got(client, "/ogc/", {}) == landing
    conformance = got(client, rel(landing, "conformance"), {"required": ["conformsTo"]})["conformsTo"]
    for name in ("core", "geojson", "oas30"):
        assert f"http://www.opengis.net/spec/ogcapi-features-1/1.0/conf/{name}" in conformance
    collections = got(
        client,
        rel(landing, "data"),
        {"required": ["links", "collections"], "properties": {"collections": {"items": COLLECTION}}},
    )
    (pins,) = collections["collections"]
    assert pins["id"] == "pins" and got(client, rel(pins, "self"), COLLECTION) == pins
    (west, south, east, north) = pins["extent"]["spatial"]["bbox"][0]
    assert [west, south, east, north] == pytest.approx([149.0, -35.36, 179.5, 10.0], abs=0.01)
    features = got(client, rel(pins, "items"), FEATURES, "application/geo+json")
    assert features["numberMatched"] == 6 and [link["rel"] for link in features["links"]] == ["self", "collection"]
    first = features["features"][0]
    one = got(client, f"{ITEMS}/{first['id']}", FEATURE, "application/geo+json")
    assert {key: one[key] for key in first} == first
    assert rel(one, "self").endswith(first["id"]) and rel(one, "collection").endswith("/collections/pins")
    assert first["properties"]["ce90_m"] > 0.0 and "pointclick" not in first  # who wants pins whole exports them


def test_the_definition_names_every_path_and_parameter_that_there_is(client: TestClient) -> None:
    landing = got(client, "/ogc", {})
    api = got(client, rel(landing, "service-desc"), {"required": ["openapi", "info", "paths"]}, API_TYPE)
    assert api["openapi"].startswith("3.0.") and api["servers"] == [{"url": "http://127.0.0.1:8080/ogc"}]
    some = names(client) and client.get(ITEMS).json()["features"][0]["id"]
    for path, methods in api["paths"].items():
        assert list(methods) == ["get"]
        assert client.get(f"/ogc{path.replace('{featureId}', some)}").status_code == 200
        for method in ("post", "put", "delete"):
            assert client.request(method, f"/ogc{path.replace('{featureId}', some)}").status_code == 405
    stated = {one["name"] for one in api["paths"]["/collections/pins/items"]["get"]["parameters"]}
    for name, value in {"bbox": "1,2,3,4", "datetime": "../..", "limit": "1", "after": "1", "f": "json"}.items():
        assert name in stated
        assert client.get(ITEMS, params={name: value}).status_code == 200
    assert len(stated) == 5


def test_pages_are_followed_to_the_last_and_hold_each_pin_once(client: TestClient) -> None:
    whole, found, path = names(client), [], f"{ITEMS}?limit=2&bbox=-180,-90,180,90"
    for page in range(3):
        content = got(client, path, FEATURES, "application/geo+json")
        assert content["numberMatched"] == 6 and content["numberReturned"] == 2
        found += [feature["properties"]["name"] for feature in content["features"]]
        if page < 2:
            path = rel(content, "next")
            assert "bbox=" in path
    assert not [link for link in content["links"] if link["rel"] == "next"] and found == whole
    assert names(client, f"?limit={MAX_LIMIT + 1}") == whole  # more than are given is no error


def test_what_is_added_or_deleted_between_two_pages_shifts_nothing(client: TestClient, tmp_path: Path) -> None:
    first = got(client, f"{ITEMS}?limit=3", FEATURES, "application/geo+json")
    with PinStore(tmp_path / "pins.sqlite") as other:
        other.delete(first["features"][0]["id"], who="bob")
        other.add([typed(1.0, 1.0, 9.0)], name="later", who="bob")
    second = got(client, rel(first, "next"), FEATURES, "application/geo+json")
    assert [f["properties"]["name"] for f in second["features"]] == ["place 2", "place 3", "across 'Ünï'"]
    third = got(client, rel(second, "next"), FEATURES, "application/geo+json")
    assert [f["properties"]["name"] for f in third["features"]] == ["later"]


@pytest.mark.parametrize(
    ("query", "expected"),
    [
        ("?bbox=149.05,-35.25,149.25,-35.05", ["place 1", "place 2"]),
        ("?bbox=149.05,-35.25,600,149.25,-35.05,700", ["place 1", "place 2"]),
        ("?bbox=149.05,-35.25,0,149.25,-35.05,600", []),
        ("?bbox=179,0,-179,20", ["across 'Ünï'"]),
        ("?datetime=2026-01-01T13:00:00Z", ["place 1"]),
        ("?datetime=2026-01-01T13:00:00Z/2026-01-01T14:30:00Z", ["place 1", "place 2"]),
        ("?datetime=2026-01-01T14:00:00Z/..", ["place 2", "place 3"]),
        ("?datetime=2026-01-01T12:00:00Z/2026-01-01T12:00:00Z&bbox=140,-40,150,-30", ["place 0"]),
        ("?datetime=/2025-01-01T00:00:00Z&bbox=140,-36,150,-34", ["tent"]),
    ],
)
def test_pins_are_selected_by_place_and_time(client: TestClient, query: str, expected: list[str]) -> None:
    assert names(client, query) == expected


@pytest.mark.parametrize(
    "query",
    ["?bbox=1,2,3", "?bbox=a,b,c,d", "?bbox=1,nan,2,3", "?bbox=0,10,1,5", "?bbox=-200,0,1,5", "?limit=0", "?limit=x",
     "?limit=-1", "?after=-1", "?datetime=yesterday", "?datetime=..", "?datetime=a/b/c", "?f=gml", "?name=tent",
     "?datetime=2026-01-02T00:00:00Z/2026-01-01T00:00:00Z", "?limit=1&limit=2"],
)  # fmt: skip
def test_a_wrong_parameter_is_refused_with_what_is_wrong(client: TestClient, query: str) -> None:
    reply = client.get(f"{ITEMS}{query}")
    assert reply.status_code == 400
    assert reply.json()["code"] == "400" and len(reply.json()["description"]) > 10


@pytest.mark.parametrize("path", ["/ogc/collections/none", "/ogc/collections/none/items", f"{ITEMS}/none"])
def test_what_is_not_there_is_a_404(client: TestClient, path: str) -> None:
    reply = client.get(path)
    assert reply.status_code == 404 and reply.json()["code"] == "404"


@given(st.text(max_size=60), st.sampled_from(["bbox", "datetime", "limit", "after", "f"]))
def test_whatever_is_asked_is_a_selection_or_a_refusal(text: str, name: str) -> None:
    try:
        selection = Selection.of({name: text})
    except WrongParameter as error:
        assert str(error)
    else:
        assert 1 <= selection.limit <= MAX_LIMIT


@given(
    st.tuples(*[st.floats(-180.0, 180.0)] * 2), st.tuples(*[st.floats(-90.0, 90.0)] * 2), st.floats(-180.0, 180.0),
    st.floats(-90.0, 90.0),
)  # fmt: skip
def test_a_box_holds_what_lies_in_it_also_across_the_antimeridian(
    lons: tuple[float, float], lats: tuple[float, float], lon: float, lat: float
) -> None:
    west, east = lons
    south, north = sorted(lats)
    mark = Mark("id", "name", "ok", number=1, lat_deg=lat, lon_deg=lon)
    selection = Selection.of({"bbox": f"{west!r},{south!r},{east!r},{north!r}"})
    width = (east - west) % 360.0 if east != west else 0.0
    if west <= east:
        width = east - west
    inside = (lon - west) % 360.0 <= width + 1e-9 and south <= lat <= north
    if min((lon - west) % 360.0, abs((lon - east) % 360.0)) > 1e-6:  # not on an edge, where rounding decides
        assert bool(selection.of_marks([mark])) == inside


def test_gdal_reads_and_selects_from_a_running_server(
    simulated: Simulated, serve: Callable[..., Server], tmp_path: Path
) -> None:
    """GDAL's driver for OGC API - Features, which is not of this project, follows pages of a server over HTTP."""
    server = serve()
    with PinStore(tmp_path / "pins.sqlite") as store:
        filled(tmp_path / "pins.sqlite").close()
        count = len(store.pins())
    source = f"OAPIF:http://127.0.0.1:{server.port}/ogc"
    assert [name for name, _ in pyogrio.list_layers(source)] == ["pins"]
    about = pyogrio.read_info(source, layer="pins", PAGE_SIZE="2")
    assert about["crs"] in ("OGC:CRS84", "EPSG:4326") and about["features"] == count == 6
    meta, _, geometry, columns = pyogrio.raw.read(source, layer="pins", PAGE_SIZE="2")
    fields = dict(zip(meta["fields"], columns, strict=True))
    assert sorted(fields["name"]) == ["across 'Ünï'", "place 0", "place 1", "place 2", "place 3", "tent"]
    assert fields["number"].tolist() == [1, 2, 3, 4, 5, 6] and np.all(fields["ce90_m"] > 0.0)
    placed = [np.frombuffer(point, "<f8", offset=5) for point in geometry]
    by_name = dict(zip(fields["name"], placed, strict=True))
    np.testing.assert_allclose(by_name["place 3"][:2], (149.3, -35.3), atol=1e-9)
    assert math.isclose(by_name["place 3"][2], 650.0)
    _, _, _, columns = pyogrio.raw.read(source, layer="pins", bbox=(149.05, -35.25, 149.25, -35.05), columns=["name"])
    assert sorted(columns[0]) == ["place 1", "place 2"]


def test_with_a_token_only_who_has_it_reads_the_pins(serve: Callable[..., Server]) -> None:
    server = serve("--token", "0123456789abcdef-token")
    port = urlsplit(server.local).port
    assert port == server.port
    from urllib.error import HTTPError  # noqa: PLC0415
    from urllib.request import Request, urlopen  # noqa: PLC0415

    with pytest.raises(HTTPError, match="401"):
        urlopen(f"{server.local}ogc/collections/pins/items")
    request = Request(
        f"{server.local}ogc/collections/pins/items", headers={"Authorization": "Bearer 0123456789abcdef-token"}
    )
    with urlopen(request) as reply:
        assert json.load(reply)["type"] == "FeatureCollection"
