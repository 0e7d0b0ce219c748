"""The definition of the API at /ogc in OpenAPI 3.0, which clients of OGC API - Features read."""

from __future__ import annotations

from typing import Any

from ground.web.ogc_selection import DEFAULT_LIMIT, MAX_LIMIT

API_TYPE = "application/vnd.oai.openapi+json;version=3.0"


def definition(base: str) -> dict[str, Any]:
    """The document, for a server at `base`."""
    pins = "/collections/pins"
    return {
        "openapi": "3.0.3",
        "info": {"title": "pointclick pins", "version": "1", "description": "OGC API - Features, read-only"},
        "servers": [{"url": base}],
        "paths": {
            "/": _get("landing page", "getLandingPage", "application/json"),
            "/conformance": _get("conformance classes", "getConformanceDeclaration", "application/json"),
            "/api": _get("this document", "getDefinition", API_TYPE),
            "/collections": _get("collections", "getCollections", "application/json"),
            pins: _get("the collection", "describePins", "application/json"),
            f"{pins}/items": _get("pins", "getPins", "application/geo+json", _query()),
            f"{pins}/items/{{featureId}}": _get(
                "one pin",
                "getPin",
                "application/geo+json",
                [{"name": "featureId", "in": "path", "required": True, "schema": {"type": "string"}}],
            ),
        },
    }


def _query() -> list[dict[str, Any]]:
    def parameter(name: str, about: str, schema: dict[str, Any], **more: Any) -> dict[str, Any]:
        return {"name": name, "in": "query", "required": False, "description": about, "schema": schema, **more}

    numbers = {
        "type": "array",
        "oneOf": [{"minItems": 4, "maxItems": 4}, {"minItems": 6, "maxItems": 6}],
        "items": {"type": "number"},
    }
    whole = {"type": "integer", "minimum": 1, "maximum": MAX_LIMIT, "default": DEFAULT_LIMIT}
    return [
        parameter("bbox", "degrees: west, south, east, north", numbers, style="form", explode=False),
        parameter("datetime", "RFC 3339: a moment, or two with a slash; .. is open", {"type": "string"}),
        parameter("limit", "features on a page at most", whole, style="form", explode=False),
        parameter("after", "pins with a higher number: next pages", {"type": "integer", "minimum": 0}),
        parameter("f", "format", {"type": "string", "enum": ["json", "geojson"]}),
    ]


def _get(about: str, name: str, kind: str, parameters: list[dict[str, Any]] | None = None) -> dict[str, Any]:
    responses: dict[str, Any] = {"200": {"description": about, "content": {kind: {"schema": {"type": "object"}}}}}
    if parameters:
        words = {"type": "object", "properties": {"code": {"type": "string"}, "description": {"type": "string"}}}
        wrong = {"application/json": {"schema": words}}
        responses["400"] = {"description": "a wrong parameter", "content": wrong}
        responses["404"] = {"description": "there is none", "content": wrong}
    operation: dict[str, Any] = {"summary": about, "operationId": name, "responses": responses}
    return {"get": operation | ({"parameters": parameters} if parameters else {})}
