"""Pins of a file that has no ids of ours, such as KML, which stand here already: a file may be read twice."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from itertools import product

from contract.geodesy import distance_m
from ground.pins.fusion import Place
from ground.pins.model import ENTERED, Pin
from ground.pins.places import Places

SAME_M = 0.2  # within which a place that formats round, to 1e-6 degrees at worst, is the same
CELL_DEG = 1e-5  # of a grid of places: the same place is in the same cell or the next, but for its width near the poles


def without_known(pins: Sequence[Pin], here: Sequence[Pin], places: Places) -> list[Pin]:
    """Return the pins of a file but those that were entered and stand where a pin of that name and category is.

    One whose id is known here is returned: it may have been changed since.
    """
    ids = {pin.id for pin in here}
    held: dict[tuple[object, ...], list[tuple[float, float]]] = defaultdict(list)
    for pin, place in zip(here, places.of(here), strict=True):
        if isinstance(place, Place):
            held[_key(pin, *_cell(place.lat_deg, place.lon_deg))].append((place.lat_deg, place.lon_deg))
    return [pin for pin in pins if pin.id in ids or not _is_known(pin, held)]


def _is_known(pin: Pin, held: dict[tuple[object, ...], list[tuple[float, float]]]) -> bool:
    if len(pin.clicks) != 1 or pin.clicks[0].method != ENTERED:
        return False
    at = pin.clicks[0].lat_deg, pin.clicks[0].lon_deg
    row, column = _cell(*at)
    return any(
        distance_m(at, other) < SAME_M
        for north, east in product((-1, 0, 1), repeat=2)
        for other in held.get(_key(pin, row + north, column + east), ())
    )


def _key(pin: Pin, row: int, column: int) -> tuple[object, ...]:
    return pin.name, pin.category, row, column


def _cell(lat_deg: float, lon_deg: float) -> tuple[int, int]:
    return round(lat_deg / CELL_DEG), round(lon_deg / CELL_DEG)
