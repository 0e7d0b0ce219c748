"""Files of places and areas of any program: how a thing is named, and in which system GeoJSON is. Standard library."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence

from contract.errors import InputError

NAMES, NOTES = ("name", "title", "label"), ("note", "notes", "description", "desc", "comment", "cmt")
WGS84 = ("CRS84", "CRS84H", "EPSG::4326", "EPSG:4326", "EPSG::4979", "EPSG:4979")  # how its names end


def worded(about: Mapping[str, object], names: Sequence[str]) -> str:
    """The text that a thing of a file has under the first of some names, in small or capital letters; a number as it
    is written. Empty where it has none.
    """
    by_name = {key.lower(): value for key, value in reversed(list(about.items()))}
    found = (by_name.get(name) for name in names)
    return next((str(v) for v in found if isinstance(v, str | int | float) and not isinstance(v, bool) and v != ""), "")


def check_wgs84(content: Mapping[str, object]) -> None:
    """Raise InputError for GeoJSON of another system, which older GeoJSON and GIS programs name in `crs`."""
    crs = content.get("crs")
    if crs is None:
        return
    about = crs.get("properties") if isinstance(crs, dict) else None
    name = str(about.get("name") if isinstance(about, dict) else crs)
    if not name.upper().endswith(WGS84):
        raise InputError(f"its coordinates are of {name[:80]}, and WGS84 is needed: export it as EPSG:4326")


def kml_values(place: ET.Element) -> dict[str, str]:
    """The data of a placemark by their names, those of a schema too; its tags are without their namespaces."""
    found = {node.get("name", ""): node.text or "" for node in place.findall("ExtendedData/SchemaData/SimpleData")}
    return found | {node.get("name", ""): node.findtext("value", "") for node in place.findall("ExtendedData/Data")}
