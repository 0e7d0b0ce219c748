"""The searched area and its sectors from a GeoJSON or KML file, and woods: polygons, each an outer ring with holes.

Polygons of one area that overlap are one: what lies in any of them belongs to it.
"""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contract.errors import InputError
from contract.kmz import ZIP, kml_documents
from contract.place_files import NAMES, check_wgs84, kml_values, worded
from contract.xml_root import xml_root

Array = NDArray[np.float64]
Polygon = list[Array]

MOST_CORNERS = 100_000
MOST_OUTLINED = 500  # corners of a sector that is outlined by hand
MOST_NAME = 60  # characters of a sector's
MOST_UNPACKED = 64_000_000  # bytes of a KMZ


@dataclass(frozen=True, eq=False)
class Sector:
    """A named part of the searched area: polygons, each an outer ring (K, 2) of longitude and latitude, and holes."""

    name: str
    polygons: list[Polygon]

    @property
    def rings(self) -> list[Array]:
        return [ring for polygon in self.polygons for ring in polygon]


@dataclass(frozen=True, eq=False)
class Woods:
    """Trees: polygons as a sector's, and the share of the ground that their canopy hides from above."""

    polygons: list[Polygon]
    canopy: float


def read_sectors(path: Path) -> list[Sector]:
    """The areas of a GeoJSON, KML or KMZ file, each with its name, else its number. Raises InputError, in a line."""
    return _sectors(_read(path, "--polygon", ".kml"))


def sectors_of(name: str, data: bytes) -> list[Sector]:
    """The same of a file's name and content. Raises InputError, in a line."""
    return _sectors(_areas(name, data, ".kml"))


def _sectors(found: Sequence[_Area]) -> list[Sector]:
    """The areas with their names. One without a name, or with another's, has its number, which is no one's name."""
    names = [_name(about) for about, _ in found]
    if not any(names):
        names = [str(number) for number in range(1, len(names) + 1)]
    shown: list[str] = []
    for number, name in enumerate(names, 1):
        shown.append(f"{name or 'without a name'} ({number})" if not name or name in names[: number - 1] else name)
    return [Sector(name, polygons) for name, (_, polygons) in zip(shown, found, strict=True)]


def outlined_sector(name: str, corners: object) -> Sector:
    """A sector of corners that somebody set, longitude and latitude in degrees. Raises InputError, in a line.

    One whose sides cross is refused: which part was meant is not known.
    """
    try:
        ring = _ring(corners)
    except InputError as error:
        raise InputError(f"an outlined sector: {error}") from error
    ring = ring[(ring != np.roll(ring, 1, axis=0)).any(axis=1)]  # a double click sets a corner twice
    if len(ring) < 3:
        raise InputError("an outlined sector needs three corners or more")
    if len(ring) > MOST_OUTLINED:
        raise InputError(f"an outlined sector: more than {MOST_OUTLINED} corners")
    if sides_cross(ring):
        raise InputError("the sector's sides cross: set its corners in order round it")
    return Sector(" ".join(name.split())[:MOST_NAME], [[ring]])


def sides_cross(ring: Array) -> bool:
    """Return whether two sides of a ring (K, 2) that are no neighbours have a point in common."""
    ends = np.roll(ring, -1, axis=0)

    def side_of(p: Array, q: Array, r: Array) -> Array:
        return np.sign(
            (q[..., 0] - p[..., 0]) * (r[..., 1] - p[..., 1]) - (q[..., 1] - p[..., 1]) * (r[..., 0] - p[..., 0])
        )

    a, b, c, d = ring[:, None], ends[:, None], ring[None], ends[None]
    meets = (side_of(a, b, c) * side_of(a, b, d) <= 0.0) & (side_of(c, d, a) * side_of(c, d, b) <= 0.0)
    # Of sides on one line the signs are all 0: they meet if what they span does.
    overlap = (np.maximum(a, b) >= np.minimum(c, d)) & (np.maximum(c, d) >= np.minimum(a, b))
    number = np.arange(len(ring))
    apart = np.abs(number[:, None] - number[None])
    is_neighbour = (apart <= 1) | (apart == len(ring) - 1)
    return bool((meets & overlap.all(axis=-1) & ~is_neighbour).any())


def sectors_document(sectors: Sequence[Sector]) -> dict[str, Any]:
    """Sectors as a GeoJSON FeatureCollection, which `sectors_of` reads again."""
    features = [
        {
            "type": "Feature",
            "properties": {"name": sector.name},
            "geometry": {
                "type": "MultiPolygon",
                "coordinates": [[[*ring.tolist(), ring[0].tolist()] for ring in rings] for rings in sector.polygons],
            },
        }
        for sector in sectors
    ]
    return {"type": "FeatureCollection", "features": features}


def read_woods(path: Path) -> list[Woods]:
    """The woods of a GeoJSON file, each with the property `canopy`, 0 to 1. Raises InputError, in a line."""
    return _woods(f"--woods {path}", _read(path, "--woods"))


def woods_of(name: str, data: bytes) -> list[Woods]:
    """The same of a file's name and content. Raises InputError, in a line."""
    return _woods(name, _areas(name, data, ""))


def _woods(name: str, found: Sequence[_Area]) -> list[Woods]:
    out = []
    for number, (about, polygons) in enumerate(found, 1):
        canopy = about.get("canopy")
        if isinstance(canopy, bool) or not isinstance(canopy, int | float) or not 0.0 <= canopy <= 1.0:
            raise InputError(f"{name}: area {number} needs the property canopy, a share from 0 to 1")
        out.append(Woods(polygons, float(canopy)))
    return out


_Area = tuple[dict[str, Any], list[Polygon]]  # properties and polygons


def _read(path: Path, option: str, xml: str = "") -> list[_Area]:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{option} {path}: {error.strerror}") from error
    return _areas(f"{option} {path}", data, xml)


def _areas(name: str, data: bytes, xml: str) -> list[_Area]:
    """The areas of a file's content, by how its name ends."""
    is_packed = data.startswith(ZIP)
    try:
        if is_packed and not xml:
            raise InputError("is a zip archive: unpack it, and give the GeoJSON in it")
        if xml and (is_packed or name.lower().endswith(xml)):
            documents = kml_documents(data, MOST_UNPACKED)
            found = [area for document in documents for area in _placemarks(document)]
        else:
            found = _features(_json(data))
    except InputError as error:
        raise InputError(f"{name}: {error}") from error
    found = [area for area in found if area[1]]
    if not found:
        raise InputError(f"{name}: holds no Polygon")
    if sum(len(ring) for _, polygons in found for polygon in polygons for ring in polygon) > MOST_CORNERS:
        raise InputError(f"{name}: more than {MOST_CORNERS} corners")
    return found


def _json(data: bytes) -> object:
    try:
        content: object = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise InputError(f"not GeoJSON ({error})") from error
    return content


def _name(about: dict[str, Any]) -> str:
    """The name among properties, in one line; empty if there is none."""
    return " ".join(worded(about, NAMES).split())[:MOST_NAME]


def _features(content: object) -> list[_Area]:
    """The areas of a geometry, a Feature or a FeatureCollection, by feature; what is no area is passed over."""
    if not isinstance(content, dict):
        raise InputError("not GeoJSON: an object is needed")
    check_wgs84(content)
    if content.get("type") == "FeatureCollection":
        return [area for one in _list(content.get("features"), "features") for area in _features(one)]
    if content.get("type") != "Feature":
        return [({}, _polygons(content))]
    about = content.get("properties")
    polygons = [] if content.get("geometry") is None else _polygons(content["geometry"])
    return [(about if isinstance(about, dict) else {}, polygons)]


def _placemarks(data: bytes) -> list[_Area]:
    """The areas of KML, by placemark."""
    root = xml_root(data, "an area needs none")
    if root.tag != "kml":
        raise InputError(f"not KML: its root is {root.tag[:40]!r}")
    return [(_about(place), _kml_polygons(place)) for place in root.iter("Placemark")]


def _about(place: ET.Element) -> dict[str, Any]:
    """A placemark's values; its own name goes before one among them."""
    name = place.findtext("name")
    return kml_values(place) | ({"name": name} if name else {})


def _kml_polygons(place: ET.Element) -> list[Polygon]:
    """A placemark's polygons, and rings that are in none."""
    within = [list(polygon.iter("LinearRing")) for polygon in place.iter("Polygon")]
    known = {id(ring) for rings in within for ring in rings}
    alone = [[ring] for ring in place.iter("LinearRing") if id(ring) not in known]
    return [[_kml_ring(ring) for ring in rings] for rings in [*within, *alone] if rings]


def _kml_ring(ring: ET.Element) -> Array:
    corners = [corner.split(",")[:2] for corner in ring.findtext("coordinates", "").split()]
    try:
        return _ring([[float(number) for number in corner] for corner in corners])
    except ValueError as error:
        raise InputError("a corner is longitude and latitude in degrees") from error


def _polygons(content: object) -> list[Polygon]:
    """The polygons of a geometry; what is no area is passed over."""
    if not isinstance(content, dict):
        raise InputError("not GeoJSON: an object is needed")
    check_wgs84(content)
    kind = content.get("type")
    if kind == "GeometryCollection":
        return [polygon for one in _list(content.get("geometries"), "geometries") for polygon in _polygons(one)]
    if kind == "Polygon":
        polygon = [_ring(ring) for ring in _list(content.get("coordinates"), "coordinates")]
        return [polygon] if polygon else []
    if kind == "MultiPolygon":
        polygons = _list(content.get("coordinates"), "coordinates")
        return [[_ring(ring) for ring in rings] for polygon in polygons if (rings := _list(polygon, "a polygon"))]
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
