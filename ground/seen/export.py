"""Export of the seen ground to other programs: GeoJSON and KML (polygons), GeoTIFF (extra `geotiff`), all in WGS84."""

from __future__ import annotations

import json
import os
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contract.answer import time_utc
from contract.errors import InputError
from contract.xml_text import KML, element
from contract.xml_text import document as xml_document
from ground.seen.coverage import Coverage
from ground.seen.outline import Patch, patches
from ground.seen.searched import Searched, area_text
from ground.seen.tally import TILE, SeenGround

Array = NDArray[np.float64]

DIGITS = 8  # of degrees: a millimetre
BANDS = (
    ("count", "pictures that saw it; 0 in the searched area: a gap"),
    ("first_s", "first seen, Unix seconds (UTC)"),
    ("last_s", "last seen, Unix seconds (UTC)"),
    ("gsd_m", "finest ground sample distance, metres"),
)

POD_BANDS = (
    ("machine", "probability that the thermal search would have found a person"),
    ("operator", "probability that an operator would have seen a person"),
)


def write(path: Path, seen: SeenGround, found: Coverage, searched: Searched | None = None) -> None:
    """Write the format that the file's name ends with, as a whole or not at all. Raises InputError."""
    writer = WRITERS.get(path.suffix.lower())
    if writer is None:
        raise InputError(f"--out {path}: the name must end in {', '.join(sorted(WRITERS))}")
    half = path.with_name(f".{path.stem}.half{path.suffix}")
    try:
        writer(half, seen, found, searched)
        os.replace(half, path)  # noqa: PTH105
    except OSError as error:
        raise InputError(f"--out {path}: {error.strerror or error}") from error
    finally:
        half.unlink(missing_ok=True)


def time_text(unix_s: int) -> str:
    """A whole second, ISO 8601."""
    return time_utc(unix_s * 10**9).replace(".000000", "")


def document(found: Coverage, searched: Searched | None = None) -> dict[str, Any]:
    """A FeatureCollection (RFC 7946): what was seen, the searched area, and each of its gaps, the largest first."""
    about = {
        "cell_m": found.cells.cell_m,
        "first_utc": time_text(found.first_s),
        "last_utc": time_text(found.last_s),
        "gsd_m": [round(gsd, 4) for gsd in found.gsd_m],
    }
    whole = {"area_m2": round(found.searched_m2, 1), "seen_m2": round(found.seen_of_searched_m2, 1)}
    features = [
        _feature("seen", patches(found.seen), found, {"area_m2": round(found.seen_m2, 1), **about}),
        _feature("searched", patches(found.searched), found, {"is_hull": found.is_hull, **whole}),
    ]
    for number, gap in enumerate(found.gaps, 1):
        features.append(_feature("gap", [gap.patch], found, {"number": number, "area_m2": round(gap.area_m2, 1)}))
    about_search = {} if searched is None else {"detection": searched.to_dict()}
    if searched is not None:
        by = {"by": searched.who, "below": searched.below}
        for number, gap in enumerate(searched.gaps, 1):
            about_gap = {"number": number, "area_m2": round(gap.area_m2, 1), **by}
            features.append(_feature("undetected", [gap.patch], found, about_gap))
    return {"type": "FeatureCollection", **about_search, "features": features}


def _feature(kind: str, parts: list[Patch], found: Coverage, about: dict[str, Any]) -> dict[str, Any]:
    polygons = [[_closed(ring, found) for ring in (part.outer, *part.holes)] for part in parts]
    return {
        "type": "Feature",
        "geometry": {"type": "MultiPolygon", "coordinates": polygons},
        "properties": {"kind": kind, **about},
    }


def _closed(ring: Array, found: Coverage) -> list[list[float]]:
    corners: list[list[float]] = np.round(found.lon_lat(ring), DIGITS).tolist()
    return [*corners, corners[0]]


def _write_geojson(path: Path, _: SeenGround, found: Coverage, searched: Searched | None) -> None:
    path.write_text(json.dumps(document(found, searched), separators=(",", ":")) + "\n", encoding="utf-8")


def gaps_kml(found: Coverage, searched: Searched | None) -> str:
    """The gaps as polygons: of what was not seen, or with `searched` of what would not have been found."""
    ET.register_namespace("", KML)
    root = element(None, f"{{{KML}}}kml")
    body = element(root, f"{{{KML}}}Document")
    why = "not seen" if searched is None else f"below {searched.below:g} by {searched.who}"
    element(body, f"{{{KML}}}name", f"gaps: {why}")
    for number, gap in enumerate(found.gaps if searched is None else searched.gaps, 1):
        place = element(body, f"{{{KML}}}Placemark")
        element(place, f"{{{KML}}}name", f"gap {number}")
        element(place, f"{{{KML}}}description", f"{area_text(gap.area_m2)} {why}")
        polygon = element(place, f"{{{KML}}}Polygon")
        for kind, ring in [("outer", gap.patch.outer), *(("inner", hole) for hole in gap.patch.holes)]:
            line = element(element(polygon, f"{{{KML}}}{kind}BoundaryIs"), f"{{{KML}}}LinearRing")
            corners = " ".join(f"{lon:.8f},{lat:.8f}" for lon, lat in _closed(ring, found))
            element(line, f"{{{KML}}}coordinates", corners)
    return xml_document(root)


def _write_kml(path: Path, _: SeenGround, found: Coverage, searched: Searched | None) -> None:
    path.write_text(gaps_kml(found, searched), encoding="utf-8")


def _write_geotiff(path: Path, seen: SeenGround, found: Coverage, searched: Searched | None) -> None:
    try:
        import rasterio  # noqa: PLC0415  of the extra `geotiff`
        from rasterio.errors import RasterioError  # noqa: PLC0415
        from rasterio.transform import Affine  # noqa: PLC0415
        from rasterio.windows import Window  # noqa: PLC0415
    except ImportError as error:
        raise InputError(
            "GeoTIFF needs the package rasterio: install pointclick with its extra [geotiff] (README), or use .geojson"
        ) from error
    cells, (rows, columns) = found.cells, found.seen.shape
    top = found.row0 + rows
    corner = float(cells.lon_deg(found.column0)), float(cells.lat_deg(top))
    bands = [*BANDS, *([] if searched is None else POD_BANDS)]
    profile = {
        "driver": "GTiff", "width": columns, "height": rows, "count": len(bands), "dtype": "float64", "nodata": np.nan,
        "crs": "EPSG:4326", "compress": "deflate", "tiled": True, "blockxsize": 256, "blockysize": TILE,
        "BIGTIFF": "IF_SAFER",
        "transform": Affine(cells.step_lon_deg, 0.0, corner[0], 0.0, -cells.step_lat_deg, corner[1]),
    }  # fmt: skip
    try:
        with rasterio.open(path, "w", **profile) as out:
            for band, (_, meaning) in enumerate(bands, 1):
                out.set_band_description(band, meaning)
            for above in range(0, rows, TILE):
                low, high = max(rows - above - TILE, 0), rows - above
                strip = _strip(seen, found, low, high)
                if searched is not None:
                    strip = np.concatenate([strip, _pod_strip(found, searched, low, high)])
                out.write(strip[:, ::-1], window=Window(0, above, columns, strip.shape[1]))
    except RasterioError as error:
        raise InputError(f"--out {path}: {error}") from error


def _strip(seen: SeenGround, found: Coverage, low: int, high: int) -> Array:
    """The bands (4, high - low, columns) of rows of a coverage, nan outside of all that was seen or searched."""
    out = np.full((len(BANDS), high - low, found.seen.shape[1]), np.nan)
    out[0][found.searched[low:high]] = 0.0
    if not found.seen[low:high].any():
        return out
    first, last = found.row0 + low, found.row0 + high - 1
    columns = np.flatnonzero(found.seen[low:high].any(axis=0)) + found.column0
    for row in range(first // TILE, last // TILE + 1):
        for column in np.unique(columns // TILE).tolist():
            tile = seen.tile((row, column))
            if tile is None:
                continue
            part = tile[max(first - row * TILE, 0) : last + 1 - row * TILE]
            y, x = max(row * TILE - first, 0), column * TILE - found.column0
            is_seen = part["count"] > 0
            for band, (name, _) in enumerate(BANDS):
                into = out[band, y : y + len(part), x : x + TILE]
                into[is_seen] = part[name][is_seen]
    return out


def _pod_strip(found: Coverage, searched: Searched, low: int, high: int) -> Array:
    """The further bands (2, high - low, columns): as stated; nan outside of all that was seen or searched."""
    inside = (found.seen | found.searched)[low:high]
    each = [np.nan if p is None else p[0, low:high] for p in (searched.detection.machine, searched.detection.operator)]
    return np.stack([np.where(inside, p, np.nan) for p in each])


WRITERS: dict[str, Callable[[Path, SeenGround, Coverage, Searched | None], None]] = {
    ".geojson": _write_geojson,
    ".kml": _write_kml,
    ".tif": _write_geotiff,
    ".tiff": _write_geotiff,
}
