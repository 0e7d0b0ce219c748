"""The searched area from a GeoJSON file: polygons, of which the rings are taken."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contract.errors import InputError

Array = NDArray[np.float64]

MOST_CORNERS = 100_000


def read_area(path: Path) -> list[Array]:
    """Rings (K, 2) of longitude and latitude. Raises InputError, in a line, for what is no area."""
    try:
        content = json.loads(path.read_bytes())
    except OSError as error:
        raise InputError(f"--polygon {path}: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"--polygon {path}: not GeoJSON ({error})") from error
    try:
        rings = _rings(content)
    except InputError as error:
        raise InputError(f"--polygon {path}: {error}") from error
    if not rings:
        raise InputError(f"--polygon {path}: holds no Polygon")
    if sum(len(ring) for ring in rings) > MOST_CORNERS:
        raise InputError(f"--polygon {path}: more than {MOST_CORNERS} corners")
    return rings


def _rings(content: object) -> list[Array]:
    """The rings of a geometry, a Feature or a FeatureCollection; what is no area is passed over."""
    if not isinstance(content, dict):
        raise InputError("not GeoJSON: an object is needed")
    kind = content.get("type")
    if kind == "FeatureCollection":
        return [ring for one in _list(content.get("features"), "features") for ring in _rings(one)]
    if kind == "Feature":
        return [] if content.get("geometry") is None else _rings(content["geometry"])
    if kind == "GeometryCollection":
        return [ring for one in _list(content.get("geometries"), "geometries") for ring in _rings(one)]
    if kind == "Polygon":
        return [_ring(ring) for ring in _list(content.get("coordinates"), "coordinates")]
    if kind == "MultiPolygon":
        polygons = _list(content.get("coordinates"), "coordinates")
        return [_ring(ring) for polygon in polygons for ring in _list(polygon, "a polygon")]
    return []


def _list(content: object, what: str) -> list[Any]:
    if not isinstance(content, list):
        raise InputError(f"{what} must be a list")
    return content


def _ring(content: object) -> Array:
    corners = []
    for corner in _list(content, "a ring"):
        numbers = corner[:2] if isinstance(corner, list) else []
        if len(numbers) < 2 or not all(
            _is_degrees(number, most) for number, most in zip(numbers, (360.0, 90.0), strict=True)
        ):
            raise InputError("a corner is longitude and latitude in degrees")
        corners.append([float(number) for number in numbers])
    if len(corners) > 1 and corners[0] == corners[-1]:
        corners.pop()
    if len(corners) < 3:
        raise InputError("a ring needs three corners or more")
    return np.array(corners)


def _is_degrees(value: object, most: float) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and -most <= value <= most
