"""The map of a report, as SVG: north up, in Web Mercator, with what was seen, flight paths, pins and their ellipses."""

from __future__ import annotations

import base64
import html
import math
from collections.abc import Callable, Iterator, Sequence

from ground.formats.mark import Mark
from ground.web.tiles import MERCATOR_LAT_DEG

SIDE = 256  # of a tile, and of the drawing's unit at the chosen zoom
MOST_PX, LEAST_M = 760.0, 120.0  # the drawing's longer side, and the least that it shows
MARGIN = 0.12
MOST_ZOOM = 21
EARTH_M = 40_075_017.0
ROUNDING_DEG = 1e-9
COLOURS = {"person": "#b3400a", "vehicle": "#0067a8", "fire": "#c1121f", "hazard": "#8a5a00", "poi": "#00735a"}
LonLat = tuple[float, float]


def report_map(marks: Sequence[Mark], paths: Sequence[Sequence[LonLat]], tile: Callable[[int, int, int], bytes]) -> str:
    """The SVG; empty where there is nothing to show. `tile`: PNG of what was seen at zoom, column and row."""
    on_map = [mark for mark in marks if abs(mark.position[0]) <= MERCATOR_LAT_DEG]
    paths = [[at for at in path if abs(at[1]) <= MERCATOR_LAT_DEG] for path in paths]
    places = [(lon, lat) for lat, lon in (mark.position for mark in on_map)] + [at for path in paths for at in path]
    if not places:
        return ""
    first_deg = _westernmost_deg([lon for lon, _ in places])
    world = [_mercator(_eastwards_deg(first_deg, lon), lat) for lon, lat in places]
    middle_lat = sum(lat for _, lat in places) / len(places)
    (left, right), (top, bottom) = ((min(axis), max(axis)) for axis in zip(*world, strict=True))
    span = max(right - left, bottom - top, LEAST_M * _metre(middle_lat)) * (1.0 + 2.0 * MARGIN)
    zoom = min(int(math.log2(MOST_PX / (SIDE * span))) + 1, MOST_ZOOM)
    scale = MOST_PX / span
    x0, y0 = (left + right - span) / 2.0, (top + bottom - span) / 2.0

    def at(lon: float, lat: float) -> tuple[float, float]:
        x, y = _mercator(_eastwards_deg(first_deg, lon), lat)
        return (x - x0) * scale, (y - y0) * scale

    parts = list(_tiles(zoom, x0, y0, span, scale, tile))
    for path in paths:
        points = " ".join(f"{x:.1f},{y:.1f}" for x, y in (at(*place) for place in path))
        parts.append(f'<polyline points="{points}" fill="none" stroke="#0a5fb4" stroke-width="1.5"/>')
    for mark in on_map:
        lat, lon = mark.position
        parts.extend(_pin(mark, *at(lon, lat), scale * _metre(lat)))
    parts.append(_bar(scale * _metre(middle_lat)))
    if missing := len(marks) - len(on_map):
        parts.append(f'<text x="18" y="20" font-size="13">{missing} beyond 85 degrees, where this map ends</text>')
    size = f"{MOST_PX:.0f}"
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {size} {size}" role="img" aria-label="map, north up">'
        f'<rect width="{size}" height="{size}" fill="#eef1f4"/>{"".join(parts)}</svg>'
    )


def _westernmost_deg(lon_deg: Sequence[float]) -> float:
    """The longitude from which all others are reached eastwards soonest, also over the 180th meridian."""
    around = sorted(lon % 360.0 for lon in lon_deg)
    gaps = [(lon - before) % 360.0 for lon, before in zip(around, [around[-1], *around[:-1]], strict=True)]
    first = around[max(range(len(around)), key=gaps.__getitem__)]
    return first if first < 180.0 else first - 360.0


def _eastwards_deg(first_deg: float, lon_deg: float) -> float:
    """A longitude from the first one on; what rounding has left of that is still there."""
    return first_deg + (lon_deg - first_deg + ROUNDING_DEG) % 360.0 - ROUNDING_DEG


def _metre(lat_deg: float) -> float:
    """The length of a metre at a latitude, in parts of the world's width."""
    return 1.0 / (EARTH_M * math.cos(math.radians(lat_deg)))


def _mercator(lon: float, lat: float) -> tuple[float, float]:
    """A place as parts of the world's width from its north-western corner; beyond 1 it is the next world's."""
    y = math.asinh(math.tan(math.radians(lat)))
    return (lon + 180.0) / 360.0, (1.0 - y / math.pi) / 2.0


def _tiles(
    zoom: int, x0: float, y0: float, span: float, scale: float, tile: Callable[[int, int, int], bytes]
) -> Sequence[str]:
    count = 1 << zoom
    side = scale / count
    out = []
    for column in range(math.floor(x0 * count), math.floor((x0 + span) * count) + 1):
        for row in range(max(int(y0 * count), 0), min(int((y0 + span) * count), count - 1) + 1):
            data = base64.b64encode(tile(zoom, column % count, row)).decode()
            x, y = (column / count - x0) * scale, (row / count - y0) * scale
            place = f'x="{x:.2f}" y="{y:.2f}" width="{side:.2f}" height="{side:.2f}"'
            out.append(f'<image {place} href="data:image/png;base64,{data}"/>')
    return out


def _pin(mark: Mark, x: float, y: float, px_per_m: float) -> Iterator[str]:
    colour = COLOURS.get(mark.category, COLOURS["poi"])
    if mark.ellipse is not None:
        e = mark.ellipse
        radii = f'rx="{e.semi_major_m * px_per_m:.1f}" ry="{e.semi_minor_m * px_per_m:.1f}"'
        # Its longer axis points to the azimuth, clockwise from north; an SVG's x axis to the east.
        turned = f'transform="rotate({e.azimuth_deg - 90.0:.1f} {x:.1f} {y:.1f})"'
        look = f'fill="{colour}" fill-opacity="0.2" stroke="{colour}"'
        yield f'<ellipse cx="{x:.1f}" cy="{y:.1f}" {radii} {turned} {look}/>'
    number = html.escape(str(mark.number))
    yield f'<circle cx="{x:.1f}" cy="{y:.1f}" r="9" fill="{colour}" stroke="#fff" stroke-width="2"/>'
    yield f'<text x="{x:.1f}" y="{y + 4:.1f}" text-anchor="middle" font-size="11" fill="#fff">{number}</text>'


def _bar(px_per_m: float) -> str:
    longest_m = 160.0 / px_per_m
    ten = 10.0 ** math.floor(math.log10(longest_m))
    metres = max(step * ten for step in (1.0, 2.0, 5.0) if step * ten <= longest_m)
    width, text = metres * px_per_m, f"{metres:.0f} m" if metres < 1000.0 else f"{metres / 1000.0:.0f} km"
    y = MOST_PX - 16.0
    return (
        f'<path d="M14 {y - 6} V{y} H{14 + width:.1f} V{y - 6}" fill="none" stroke="#14202b" stroke-width="2"/>'
        f'<text x="18" y="{y - 6}" font-size="13" fill="#14202b">{text}, north is up</text>'
    )
