"""KML 2.2 (OGC 07-147r2) out and in. Heights are above the sea, as KML means them; accuracy is in words and data."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from functools import partial

from contract.circular_error import CE90_SIGMAS, LE90_SIGMAS
from contract.errors import InputError
from contract.geodesy import LocalFrame
from contract.kmz import ZIP, kml_documents
from contract.place_files import NAMES, NOTES, kml_values, worded
from contract.xml_text import KML, document, element
from ground.formats.coordinates import Grid, figure, shape_values
from ground.formats.imported import Imported, entered_pin
from ground.formats.mark import Mark
from ground.formats.xml_text import MAX_BYTES, parsed
from ground.pins.model import Pin

# aabbggrr, as in KML; a letter next to the colour is in the name of the style.
_COLOURS = {"person": "ff00a5ff", "vehicle": "ffff901e", "fire": "ff0000ff", "hazard": "ff00ffff", "poi": "ff98fb98"}
_ELLIPSE_POINTS = 32
ELLIPSES = "90 % ellipses"


def write(marks: Sequence[Mark], grid: Grid | None = None) -> str:
    """A document of placemarks, each with its 90 % ellipse; one without a position has no geometry, and states why."""
    ET.register_namespace("", KML)
    root = element(None, f"{{{KML}}}kml")
    body = element(root, f"{{{KML}}}Document")
    element(body, f"{{{KML}}}name", "pointclick")
    for category, colour in _COLOURS.items():
        style = element(body, f"{{{KML}}}Style", id=category)
        element(element(style, f"{{{KML}}}IconStyle"), f"{{{KML}}}color", colour)
        element(element(style, f"{{{KML}}}LineStyle"), f"{{{KML}}}color", colour)
    pins = _folder(body, "pins")
    for mark in marks:
        _placemark(pins, mark, grid)
    # In a folder of their own: readers of points then find points.
    ellipses = _folder(body, ELLIPSES)
    for mark in marks:
        if mark.is_placed and mark.ellipse is not None:
            place = element(ellipses, f"{{{KML}}}Placemark")
            element(place, f"{{{KML}}}name", mark.title)
            element(place, f"{{{KML}}}styleUrl", f"#{mark.category}")
            line = element(place, f"{{{KML}}}LineString")
            element(line, f"{{{KML}}}tessellate", "1")
            element(line, f"{{{KML}}}coordinates", " ".join(f"{x:.7f},{y:.7f}" for x, y in outline(mark)))
    return document(root)


def _folder(body: ET.Element, name: str) -> ET.Element:
    made = element(body, f"{{{KML}}}Folder")
    element(made, f"{{{KML}}}name", name)
    return made


def _placemark(body: ET.Element, mark: Mark, grid: Grid | None) -> None:
    def tag(name: str) -> str:
        return f"{{{KML}}}{name}"

    place = element(body, tag("Placemark"))
    element(place, tag("name"), mark.title)
    # Earth browsers show a description as HTML: the texts of people are shown as texts.
    lines = [mark.accuracy_text, mark.note, f"{mark.category} {mark.who} {mark.time_text} {mark.vehicle}".strip()]
    element(place, tag("description"), "<br/>".join(_html(line) for line in lines if line))
    if mark.time_text:
        element(element(place, tag("TimeStamp")), tag("when"), mark.time_text)
    element(place, tag("styleUrl"), f"#{mark.category}")
    data = element(place, tag("ExtendedData"))
    values: dict[str, object] = {
        "id": mark.id, "pin_name": mark.name, "number": mark.number, "category": mark.category, "note": mark.note,
        "who": mark.who, "status": mark.status, "reason": mark.reason or None, "ce90_m": figure(mark.ce90_m),
        "le90_m": figure(mark.le90_m), "height_ellipsoid_m": figure(mark.height_ellipsoid_m),
        "height_amsl_m": figure(mark.height_amsl_m), "vehicle": mark.vehicle, "frame": mark.frame,
        "method": mark.method,
    }  # fmt: skip
    values |= shape_values(mark, grid)
    for name, value in values.items():
        if value is not None:
            element(element(data, tag("Data"), name=name), tag("value"), str(value))
    if not mark.is_placed:
        return
    lat, lon = mark.position
    height = mark.height_amsl_m
    point = element(place, tag("Point"))
    if height is not None:
        element(point, tag("altitudeMode"), "absolute")
    element(point, tag("coordinates"), f"{lon:.9f},{lat:.9f}" + ("" if height is None else f",{height:.3f}"))


def outline(mark: Mark) -> list[tuple[float, float]]:
    """Longitude and latitude around the 90 % ellipse, closed."""
    e = mark.ellipse
    assert e is not None
    lat, lon = mark.position
    frame, azimuth = LocalFrame(lat, lon, 0.0), math.radians(e.azimuth_deg)
    out = []
    for k in range(_ELLIPSE_POINTS + 1):
        turn = 2.0 * math.pi * (k % _ELLIPSE_POINTS) / _ELLIPSE_POINTS
        along, across = e.semi_major_m * math.cos(turn), e.semi_minor_m * math.sin(turn)
        east = along * math.sin(azimuth) + across * math.cos(azimuth)
        north = along * math.cos(azimuth) - across * math.sin(azimuth)
        there = frame.to_geodetic([east, north, 0.0])
        out.append((float(there[1]), float(there[0])))
    return out


def read(data: bytes, who: str = "", now_unix_ns: int = 0) -> Imported:
    """Placemarks' points, of KML or of all documents of a KMZ. Raises InputError for what is neither."""
    roots = [parsed(document, "KML") for document in kml_documents(data, MAX_BYTES)]
    for root in roots:
        if root.tag != "kml":
            raise InputError(f"not KML: its root is {root.tag[:40]!r}")
    out = Imported()
    for root in roots:
        _take_all(out, root, data[:2] == ZIP, who, now_unix_ns)
    return out.checked()


def _take_all(out: Imported, root: ET.Element, is_packed: bool, who: str, now_unix_ns: int) -> None:
    """Take the points of one document; a link to places that are elsewhere is noted as one that cannot be read."""
    ours = {id(p) for folder in root.iter("Folder") if folder.findtext("name") == ELLIPSES for p in folder}
    for place in root.iter("Placemark"):
        if id(place) in ours or place.get("targetId") is not None:  # a change of another placemark is no place
            continue
        points = list(place.iter("Point"))  # deeper too, as in a MultiGeometry
        out.left_out += not points
        name = place.findtext("name", "")[:40]
        for point in points:
            out.take(f"placemark {name!r}", partial(_pin, place, point, who, now_unix_ns))
    for link in root.iter("NetworkLink"):
        href = next((h.text.strip() for h in link.iter("href") if h.text), "")
        if not (is_packed and "://" not in href):
            out.bad.append(f"link {link.findtext('name', '')[:40]!r}: its places are in {href[:80]!r}: import that")


def _pin(place: ET.Element, point: ET.Element, who: str, now_unix_ns: int) -> Pin:
    """A placemark's. Raises ValueError for what is no number, InputError for no place."""
    about = kml_values(place)
    is_ours = "pin_name" in about  # its name and description are then made for people
    numbers = point.findtext("coordinates", "").strip().split(",")
    if len(numbers) < 2:
        raise InputError("no coordinates (longitude, latitude) in its point")
    if len(numbers) > 3:  # decimal commas, or more places than one
        raise InputError("its coordinates are not longitude, latitude and perhaps height, with points as decimal marks")
    has_height = len(numbers) > 2 and point.findtext("altitudeMode", "") == "absolute"
    height_m = (float(numbers[2]) if has_height else None) or None  # 0: not known, as CalTopo and others write
    ce90, le90 = (float(about[key]) if about.get(key) else None for key in ("ce90_m", "le90_m"))
    return entered_pin(
        lat_deg=float(numbers[1]), lon_deg=float(numbers[0]), height_amsl_m=height_m,
        sigma_m=None if ce90 is None else ce90 / CE90_SIGMAS,
        sigma_height_m=None if le90 is None else le90 / LE90_SIGMAS,
        name=about.get("pin_name") if is_ours else place.findtext("name") or worded(about, NAMES),
        note=about.get("note") if is_ours else place.findtext("description") or worded(about, NOTES),
        category=about.get("category"), who=who, time_text=place.findtext("TimeStamp/when", ""),
        now_unix_ns=now_unix_ns,
    )  # fmt: skip


def _html(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;").replace('"', "&quot;")
