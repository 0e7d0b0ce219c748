"""The pins by OGC API - Features, read-only, for QGIS and other GIS: core, GeoJSON and OpenAPI 3.0 of OGC 17-069r4.

One collection, `pins`, in longitude and latitude (CRS84), with the height above the ellipsoid where it is known.
"""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any
from urllib.parse import quote, urlencode

from fastapi import APIRouter, Request
from fastapi.responses import JSONResponse

from contract.answer import time_utc
from ground.formats import geojson
from ground.formats.mark import Mark
from ground.web.context import NotThere, ServerContext
from ground.web.dependency import Context
from ground.web.ogc_definition import API_TYPE, definition
from ground.web.ogc_selection import Selection, WrongParameter

PINS = "pins"
TITLE = "pointclick pins"
ABOUT = "Things found in pictures from aircraft, with their 90 % accuracy"
CRS84, CRS84H = "http://www.opengis.net/def/crs/OGC/1.3/CRS84", "http://www.opengis.net/def/crs/OGC/0/CRS84h"
CONFORMANCE = tuple(
    f"http://www.opengis.net/spec/ogcapi-features-1/1.0/conf/{name}" for name in ("core", "geojson", "oas30")
)
JSON, GEOJSON = "application/json", "application/geo+json"

Link = dict[str, str]


# Routes below /ogc. No other method than GET is answered.
router = APIRouter(include_in_schema=False)


def _marks(context: ServerContext) -> list[Mark]:
    pins = context.store.pins()
    return [Mark.of_pin(pin, place) for pin, place in zip(pins, context.places.of(pins), strict=True)]


@router.get("")
@router.get("/")
def landing(request: Request) -> JSONResponse:
    """The landing page of the standard: links to all of it."""
    base = _base(request)
    links = [
        _link(base, "self", JSON, TITLE),
        _link(f"{base}/api", "service-desc", API_TYPE, "definition of the API"),
        _link(f"{base}/conformance", "conformance", JSON, "what of the standard is here"),
        _link(f"{base}/collections", "data", JSON, "collections"),
    ]
    return JSONResponse({"title": TITLE, "description": ABOUT, "links": links})


@router.get("/conformance")
def conformance() -> JSONResponse:
    return JSONResponse({"conformsTo": list(CONFORMANCE)})


@router.get("/api")
def api(request: Request) -> JSONResponse:
    return JSONResponse(definition(_base(request)), media_type=API_TYPE)


@router.get("/collections")
def collections(context: Context, request: Request) -> JSONResponse:
    """The one collection there is, that of the pins."""
    base = _base(request)
    links = [_link(f"{base}/collections", "self", JSON, "collections")]
    return JSONResponse({"links": links, "collections": [_collection(base, _marks(context))]})


@router.get("/collections/{name}")
def collection(context: Context, name: str, request: Request) -> JSONResponse:
    return JSONResponse(_collection(_base(request), _marks(context))) if name == PINS else _nothing(name)


@router.get("/collections/{name}/items")
def items(context: Context, name: str, request: Request) -> JSONResponse:
    """A page of a collection's features, as the request's parameters choose them."""
    if name != PINS:
        return _nothing(name)
    return _items(request, _marks(context))


@router.get("/collections/{name}/items/{pin_id}")
def item(context: Context, name: str, pin_id: str, request: Request) -> JSONResponse:
    """One feature by its number, or the problem with it."""
    if name != PINS:
        return _nothing(name)
    try:
        pin = context.pin(pin_id)
    except NotThere as error:
        return _problem(404, str(error))
    base = f"{_base(request)}/collections/{PINS}"
    found = geojson.feature(Mark.of_pin(pin, context.places.place(pin)))
    found["links"] = [
        _link(f"{base}/items/{quote(pin_id)}", "self", GEOJSON, "this pin"),
        _link(base, "collection", JSON, TITLE),
    ]
    return JSONResponse(found, media_type=GEOJSON)


def _items(request: Request, marks: list[Mark]) -> JSONResponse:
    asked = request.query_params.multi_items()
    try:
        if len({key for key, _ in asked}) < len(asked):
            raise WrongParameter("a parameter was given twice")
        selection = Selection.of(dict(asked))
    except WrongParameter as error:
        return _problem(400, str(error))
    matching = selection.of_marks(marks)
    page, after = selection.page(matching)
    base = f"{_base(request)}/collections/{PINS}"
    links = [
        _link(str(request.url), "self", GEOJSON, "this page"),
        _link(base, "collection", JSON, TITLE),
    ]
    if after is not None:
        more = urlencode({**dict(asked), "limit": selection.limit, "after": after})
        links.append(_link(f"{base}/items?{more}", "next", GEOJSON, "next page"))
    content = {
        "type": "FeatureCollection",
        "features": [geojson.feature(mark) for mark in page],
        "numberMatched": len(matching),
        "numberReturned": len(page),
        "timeStamp": datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        "links": links,
    }
    return JSONResponse(content, media_type=GEOJSON)


def _base(request: Request) -> str:
    return f"{request.url.scheme}://{request.url.netloc}/ogc"


def _link(href: str, rel: str, kind: str, title: str) -> Link:
    return {"href": href, "rel": rel, "type": kind, "title": title}


def _collection(base: str, marks: list[Mark]) -> dict[str, Any]:
    place = f"{base}/collections/{PINS}"
    extent = {}
    placed = [mark.position for mark in marks if mark.is_placed]
    if placed:
        lats, lons = [lat for lat, _ in placed], [lon for _, lon in placed]
        extent["spatial"] = {"bbox": [[min(lons), min(lats), max(lons), max(lats)]], "crs": CRS84}
    times = [mark.time_unix_ns for mark in marks if mark.time_unix_ns is not None]
    if times:
        extent["temporal"] = {"interval": [[time_utc(min(times)), time_utc(max(times))]]}
    return {
        "id": PINS,
        "title": TITLE,
        "description": ABOUT,
        "itemType": "feature",
        "crs": [CRS84, CRS84H],
        **({"extent": extent} if extent else {}),
        "links": [
            _link(place, "self", JSON, TITLE),
            _link(f"{place}/items", "items", GEOJSON, "the pins"),
        ],
    }


def _nothing(name: str) -> JSONResponse:
    return _problem(404, f"no collection {name[:40]!r}; there is {PINS}")


def _problem(status: int, words: str) -> JSONResponse:
    return JSONResponse({"code": str(status), "description": words}, status_code=status)
