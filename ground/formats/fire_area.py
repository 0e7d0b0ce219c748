"""A fire as polygons: GeoJSON (RFC 7946) and KML: as seen, surely, and perhaps burning."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from pathlib import PurePath
from typing import Any

from contract.answer import time_utc
from contract.geodesy import within_180
from contract.xml_text import KML, document, element
from ground.spots.fire import Area, Fire, Ring

FORMATS = {".geojson": "geojson", ".json": "geojson", ".kml": "kml"}
DIGITS = 8  # of degrees: a millimetre
# KML's colours are alpha, blue, green, red.
_STYLES = {"perhaps": ("ff00a5ff", "2000a5ff"), "burned": ("ff0000ff", "500000ff"), "surely": ("ff000080", "70000080")}


def write(fire: Fire, name: str) -> str:
    """Write the format that the file's name ends with. Raises KeyError for any other ending."""
    return json.dumps(features(fire)) + "\n" if FORMATS[PurePath(name).suffix.lower()] == "geojson" else _kml(fire)


def features(fire: Fire) -> dict[str, Any]:
    """A FeatureCollection: what perhaps burned below what surely did."""
    about = {
        "first_utc": time_utc(fire.first_unix_ns),
        "last_utc": time_utc(fire.last_unix_ns),
        "pictures": fire.pictures,
        "has_temperature": fire.has_temperature,
        "spread_m_s": _rounded(fire.spread_m_s),
        "sigma_spread_m_s": _rounded(fire.sigma_spread_m_s),
    }
    made = []
    for kind, area in _areas(fire):
        polygons = [[_digits(ring) for ring in polygon] for polygon in area.polygons]
        sizes = {"area_m2": round(area.area_m2, 1), "perimeter_m": round(area.perimeter_m, 1)}
        if kind == "burned":
            sizes["sigma_area_m2"] = round(fire.sigma_area_m2, 1)
        geometry = {"type": "MultiPolygon", "coordinates": polygons}
        made.append({"type": "Feature", "geometry": geometry, "properties": {"kind": kind, **sizes, **about}})
    return {"type": "FeatureCollection", "features": made}


def _kml(fire: Fire) -> str:
    def tag(name: str) -> str:
        return f"{{{KML}}}{name}"

    ET.register_namespace("", KML)
    root = element(None, tag("kml"))
    body = element(root, tag("Document"))
    element(body, tag("name"), "pointclick fire")
    for kind, area in _areas(fire):
        mark = element(body, tag("Placemark"))
        element(mark, tag("name"), {"burned": "burned, as seen"}.get(kind, f"{kind} burned"))
        element(mark, tag("description"), fire.to_text())
        span = element(mark, tag("TimeSpan"))
        element(span, tag("begin"), time_utc(fire.first_unix_ns))
        element(span, tag("end"), time_utc(fire.last_unix_ns))
        style, (edge, fill) = element(mark, tag("Style")), _STYLES[kind]
        element(element(style, tag("LineStyle")), tag("color"), edge)
        element(element(style, tag("PolyStyle")), tag("color"), fill)
        many = element(mark, tag("MultiGeometry"))
        for outer, *holes in area.polygons:
            polygon = element(many, tag("Polygon"))
            for name, rings in (("outerBoundaryIs", [outer]), ("innerBoundaryIs", holes)):
                for ring in rings:
                    line = element(element(polygon, tag(name)), tag("LinearRing"))
                    # KML's readers close a ring over the 180th meridian by themselves.
                    element(line, tag("coordinates"), " ".join(f"{within_180(lon):.8f},{lat:.8f}" for lon, lat in ring))
    return document(root)


def _areas(fire: Fire) -> list[tuple[str, Area]]:
    return [("perhaps", fire.perhaps), ("burned", fire.burned), ("surely", fire.surely)]


def _digits(ring: Ring) -> list[list[float]]:
    return [[round(lon, DIGITS), round(lat, DIGITS)] for lon, lat in ring]


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 4)
