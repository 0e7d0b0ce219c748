"""GPX 1.1 waypoints out and in. Heights are above the sea, as GPX means them.

The accuracy is in `desc` and in an extension of ours: `hdop` is a ratio of the satellites' geometry, no metres.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from functools import partial

from contract.circular_error import CE90_SIGMAS, LE90_SIGMAS
from contract.errors import InputError
from contract.xml_text import document, element
from ground.formats.coordinates import Grid, figure, shape_values
from ground.formats.imported import Imported, entered_pin
from ground.formats.mark import Mark
from ground.formats.xml_text import parsed
from ground.pins.model import Pin

NAMESPACE = "http://www.topografix.com/GPX/1/1"
OURS = "https://pointclick.invalid/gpx/1"


def write(marks: Sequence[Mark], grid: Grid | None = None) -> str:
    """Waypoints. GPX has none without a position: such marks are named in the file's description."""
    ET.register_namespace("", NAMESPACE)
    ET.register_namespace("pc", OURS)

    def tag(name: str) -> str:
        return f"{{{NAMESPACE}}}{name}"

    root = element(None, tag("gpx"), version="1.1", creator="pointclick")
    without = [mark for mark in marks if not mark.is_placed]
    if without:
        lines = "; ".join(f"{mark.title}: {mark.accuracy_text}" for mark in without)
        element(element(root, tag("metadata")), tag("desc"), f"without a position: {lines}")
    for mark in marks:
        if not mark.is_placed:
            continue
        lat, lon = mark.position
        point = element(root, tag("wpt"), lat=f"{lat:.9f}", lon=f"{lon:.9f}")
        if mark.height_amsl_m is not None:
            element(point, tag("ele"), f"{mark.height_amsl_m:.3f}")
        if mark.time_text:
            element(point, tag("time"), mark.time_text)
        element(point, tag("name"), mark.title)
        element(point, tag("desc"), f"{mark.accuracy_text}{'. ' if mark.note else ''}{mark.note}")
        element(point, tag("type"), mark.category)
        more = element(point, tag("extensions"))
        values: dict[str, object] = {
            "id": mark.id, "name": mark.name, "note": mark.note, "who": mark.who, "vehicle": mark.vehicle,
            "ce90_m": figure(mark.ce90_m), "le90_m": figure(mark.le90_m),
            "height_ellipsoid_m": figure(mark.height_ellipsoid_m),
        }  # fmt: skip
        values |= shape_values(mark, grid)
        for name, value in values.items():
            if value not in (None, ""):
                element(more, f"{{{OURS}}}{name}", str(value))
    return document(root)


def read(data: bytes, who: str = "", now_unix_ns: int = 0) -> Imported:
    """Waypoints; routes and tracks are left out. Raises InputError for what is no GPX."""
    root = parsed(data, "GPX", OURS)
    if root.tag != "gpx":
        raise InputError(f"not GPX: its root is {root.tag[:40]!r}")
    out = Imported()
    for point in root:
        if point.tag != "wpt":
            out.left_out += point.tag in ("rte", "trk")
            continue
        out.take(f"waypoint {point.findtext('name', '')[:40]!r}", partial(_pin, point, who, now_unix_ns))
    return out.checked()


def _pin(point: ET.Element, who: str, now_unix_ns: int) -> Pin:
    """A waypoint's. Raises ValueError for what is no number, InputError for no place."""
    # Other programs' extensions have names and colours of their own; ours state what is in `name` and `desc`.
    own = f"{{{OURS}}}"
    ours = {n.tag.removeprefix(own): n.text or "" for n in point.findall("extensions/*") if n.tag.startswith(own)}
    text = point.findtext("ele", "")  # 0: not known, as CalTopo and others write
    ce90, le90 = (float(ours[key]) if ours.get(key) else None for key in ("ce90_m", "le90_m"))
    return entered_pin(
        lat_deg=float(point.get("lat", "")), lon_deg=float(point.get("lon", "")),
        height_amsl_m=(float(text) if text else None) or None, sigma_m=None if ce90 is None else ce90 / CE90_SIGMAS,
        sigma_height_m=None if le90 is None else le90 / LE90_SIGMAS,
        name=ours.get("name", "" if ours else point.findtext("name", "")),
        note=ours.get("note", "" if ours else point.findtext("desc") or point.findtext("cmt", "")),
        category=point.findtext("type", ""), who=who, time_text=point.findtext("time", ""), now_unix_ns=now_unix_ns,
    )  # fmt: skip
