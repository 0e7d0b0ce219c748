"""GeoJSON (RFC 7946) out and in. Pins are written whole in a member of their own: they come back without loss.

Longitude comes first, heights are above the WGS84 ellipsoid as the RFC specifies and are left out where only the height
above the sea is known. Without a position the geometry is null.
"""

from __future__ import annotations

import base64
import binascii
import json
import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from contract.circular_error import CE90_SIGMAS, LE90_SIGMAS
from contract.errors import InputError
from contract.geodesy import within_180
from contract.place_files import NAMES, NOTES, check_wgs84, worded
from ground.formats.coordinates import Grid, projected
from ground.formats.imported import Imported, entered_pin
from ground.formats.mark import Mark
from ground.pins.model import Pin

WHOLE = "pointclick"  # the member with the pin itself
MAX_FEATURES = 100_000


def write(marks: Sequence[Mark], grid: Grid | None = None, crop_of: Callable[[str], bytes | None] | None = None) -> str:
    """A FeatureCollection, one feature a line. `crop_of` gives the pictures of the pins' clicks, by click id."""
    features = ",\n".join(json.dumps(_feature(mark, grid, crop_of), allow_nan=False) for mark in marks)
    return '{"type": "FeatureCollection", "features": [\n' + features + "\n]}\n"


def _feature(mark: Mark, grid: Grid | None, crop_of: Callable[[str], bytes | None] | None) -> dict[str, Any]:
    out = feature(mark, grid)
    if mark.pin is not None:
        out[WHOLE] = {"version": 1, "pin": mark.pin.to_dict(), "crops": _crops(mark.pin, crop_of)}
    return out


def feature(mark: Mark, grid: Grid | None = None) -> dict[str, Any]:
    """A mark as others read it, without the pin itself."""
    geometry = None
    if mark.is_placed:
        lat, lon = mark.position
        height = [] if mark.height_ellipsoid_m is None else [round(mark.height_ellipsoid_m, 3)]
        geometry = {"type": "Point", "coordinates": [round(lon, 9), round(lat, 9), *height]}
    e = mark.ellipse
    properties: dict[str, Any] = {
        "name": mark.name,
        "number": mark.number,
        "category": mark.category,
        "note": mark.note,
        "who": mark.who,
        "status": mark.status,
        "reason": mark.reason,
        "time": mark.time_text or None,
        "ce90_m": _rounded(mark.ce90_m),
        "le90_m": _rounded(mark.le90_m),
        "ellipse": None
        if e is None
        else {
            "confidence": 0.9,
            "semi_major_m": _rounded(e.semi_major_m),
            "semi_minor_m": _rounded(e.semi_minor_m),
            "azimuth_deg": round(e.azimuth_deg, 2),
        },
        "height_ellipsoid_m": _rounded(mark.height_ellipsoid_m),
        "height_amsl_m": _rounded(mark.height_amsl_m),
        "vehicle": mark.vehicle,
        "frame": mark.frame,
        "u_px": mark.u_px,
        "v_px": mark.v_px,
        "method": mark.method,
        "clicks": mark.clicks,
        "ties": mark.tied,
    }
    if (p := projected(mark, grid)) is not None:
        properties |= {"crs": p.crs, "x": p.x, "y": p.y, "x_name": p.x_name, "y_name": p.y_name}
    return {"type": "Feature", "id": mark.id, "geometry": geometry, "properties": properties}


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 3)


def _crops(pin: Pin, crop_of: Callable[[str], bytes | None] | None) -> dict[str, str]:
    if crop_of is None:
        return {}
    found = {click.id: crop_of(click.id) for click in pin.clicks}
    return {key: base64.b64encode(crop).decode("ascii") for key, crop in found.items() if crop is not None}


def read(data: bytes, who: str = "", now_unix_ns: int = 0) -> Imported:
    """Pins of ours as they were, and others' points as entered positions. Raises InputError for what is no GeoJSON."""
    try:
        content = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise InputError(f"not GeoJSON ({error})") from error
    kind = content.get("type") if isinstance(content, dict) else None
    features = [content] if kind == "Feature" else content.get("features") if kind == "FeatureCollection" else None
    if not isinstance(features, list):
        raise InputError("not GeoJSON: a FeatureCollection or a Feature is needed")
    if len(features) > MAX_FEATURES:
        raise InputError(f"{len(features)} features; at most {MAX_FEATURES} are read")
    check_wgs84(content)
    out = Imported()
    for index, feature in enumerate(features):
        whole = feature.get(WHOLE) if isinstance(feature, dict) else None
        if isinstance(whole, dict):
            out.take(f"feature {index}", partial(_whole, out, whole))
        elif isinstance(feature, dict) and not (points := _points(feature.get("geometry"))):
            out.left_out += 1
        else:
            for coordinates in points if isinstance(feature, dict) else [None]:
                out.take(f"feature {index}", partial(_pin, feature, coordinates, who, now_unix_ns))
    return out.checked()


def _whole(out: Imported, whole: dict[str, Any]) -> Pin:
    pin, crops = Pin.from_dict(whole.get("pin")), _crops_read(whole.get("crops"))
    out.crops |= crops
    return pin


def _points(geometry: object, is_part: bool = False) -> list[object]:
    """The coordinates of a Point, or of each point of a MultiPoint or of a collection; none of any other geometry."""
    about = geometry if isinstance(geometry, dict) else {}
    kind, found, parts = about.get("type"), about.get("coordinates"), about.get("geometries")
    if kind == "GeometryCollection" and isinstance(parts, list) and not is_part:
        return [point for part in parts for point in _points(part, is_part=True)]
    if kind == "MultiPoint" and isinstance(found, list):
        return list(found)
    return [found] if kind == "Point" else []


def _crops_read(content: object) -> dict[str, bytes]:
    if not isinstance(content, dict):
        return {}
    try:
        return {str(key): base64.b64decode(str(text), validate=True) for key, text in content.items()}
    except (binascii.Error, ValueError) as error:
        raise InputError(f"a crop is not base64 ({error})") from error


def _pin(feature: object, coordinates: object, who: str, now_unix_ns: int) -> Pin:
    """A point's as an entered position. Raises InputError for no place, OverflowError for a number beyond any."""
    if not isinstance(feature, dict):
        raise InputError("not an object")
    for stated in (feature, feature["geometry"]):
        check_wgs84(stated)
    numbers = coordinates if isinstance(coordinates, list) and 2 <= len(coordinates) <= 4 else []
    if not numbers or not all(isinstance(c, int | float) and not isinstance(c, bool) for c in numbers):
        raise InputError("coordinates are longitude, latitude and perhaps height")
    given = feature.get("properties")
    about: dict[str, Any] = given if isinstance(given, dict) else {}
    ce90, le90 = _positive(about.get("ce90_m")), _positive(about.get("le90_m"))
    if any(abs(c) > 360.0 for c in numbers[:2]):
        raise InputError("metres rather than degrees: its coordinates are of another system than WGS84 (EPSG:4326)")
    # A height of exactly 0 is what CalTopo and others write for one that they do not know.
    return entered_pin(
        lat_deg=float(numbers[1]), lon_deg=_lon_deg(float(numbers[0])),
        height_ellipsoid_m=float(numbers[2]) if len(numbers) > 2 and numbers[2] != 0 else None,
        sigma_m=None if ce90 is None else ce90 / CE90_SIGMAS,
        sigma_height_m=None if le90 is None else le90 / LE90_SIGMAS,
        name=worded(about, NAMES), note=worded(about, NOTES), category=about.get("category"), who=who,
        time_text=about.get("time"), now_unix_ns=now_unix_ns,
    )  # fmt: skip


def _lon_deg(value: float) -> float:
    """A longitude that a map counted on beyond the date line, as it is on this side of it."""
    return value if abs(value) <= 180.0 else within_180(value)


def _positive(value: object) -> float | None:
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value < 1e6:
        return None
    return float(value) if math.isfinite(value) else None
