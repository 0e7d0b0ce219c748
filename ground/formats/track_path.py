"""The path of a followed thing, with times: GeoJSON (a line and its points) and KML (gx:Track)."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import PurePath

from contract.answer import Place, time_utc
from contract.track import TrackReport
from contract.xml_text import KML, document, element

GX = "http://www.google.com/kml/ext/2.2"
FORMATS = {".geojson": "geojson", ".json": "geojson", ".kml": "kml"}


def write(reports: Sequence[TrackReport], name: str) -> str:
    """Write the format that the file's name ends with. Raises KeyError for any other ending.

    Reports without a place are left out: a refusal is no point.
    """
    kind = FORMATS[PurePath(name).suffix.lower()]
    placed = [(report, report.place) for report in reports if report.place is not None]
    return _geojson(placed) if kind == "geojson" else _kml(placed)


def _geojson(placed: Sequence[tuple[TrackReport, Place]]) -> str:
    features = []
    for number in dict.fromkeys(report.number for report, _ in placed):
        own = [(report, place) for report, place in placed if report.number == number]
        times = [time_utc(report.capture_unix_ns) for report, _ in own]
        line = {"type": "LineString", "coordinates": [_lon_lat(place) for _, place in own]}
        about = {"track": number, "vehicle": own[0][0].vehicle, "times": times}
        if len(own) > 1:
            features.append({"type": "Feature", "geometry": line, "properties": about})
        for report, place in own:
            point = {"type": "Point", "coordinates": _lon_lat(place)}
            features.append({"type": "Feature", "geometry": point, "properties": json.loads(report.to_json())})
    lines = ",\n".join(json.dumps(feature, allow_nan=False) for feature in features)
    return '{"type": "FeatureCollection", "features": [\n' + lines + "\n]}\n"


def _kml(placed: Sequence[tuple[TrackReport, Place]]) -> str:
    ET.register_namespace("", KML)
    ET.register_namespace("gx", GX)
    root = element(None, f"{{{KML}}}kml")
    body = element(root, f"{{{KML}}}Document")
    element(body, f"{{{KML}}}name", "pointclick tracks")
    for number in dict.fromkeys(report.number for report, _ in placed):
        own = [(report, place) for report, place in placed if report.number == number]
        mark = element(body, f"{{{KML}}}Placemark")
        element(mark, f"{{{KML}}}name", f"track {number} of {own[0][0].vehicle}")
        element(mark, f"{{{KML}}}description", own[-1][0].course_text)
        path = element(mark, f"{{{GX}}}Track")
        element(path, f"{{{KML}}}altitudeMode", "clampToGround")
        for report, _ in own:
            element(path, f"{{{KML}}}when", time_utc(report.capture_unix_ns))
        for _, place in own:
            element(path, f"{{{GX}}}coord", f"{place.lon_deg:.9f} {place.lat_deg:.9f} 0")
    return document(root)


def _lon_lat(place: Place) -> list[float]:
    height = [] if place.height_ellipsoid_m is None else [round(place.height_ellipsoid_m, 3)]
    return [round(place.lon_deg, 9), round(place.lat_deg, 9), *height]
