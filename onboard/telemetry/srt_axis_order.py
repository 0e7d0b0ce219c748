"""The order of latitude and longitude in `GPS(a, b, c)` of DJI's subtitles: models differ, and nothing labels them.

Evidence, the surest first: a number beyond 90 is a longitude; what the operator states; a distance from home or a speed
in the same subtitles, which fits one order only, because a degree of longitude is shorter than one of latitude; and the
model's format, known by its third number. What contradicts, or determines nothing, is refused.
"""

from __future__ import annotations

import bisect
import math
import re
from collections import Counter
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from contract.errors import InputError

Order = Literal["lat-lon", "lon-lat"]
ORDERS: tuple[Order, ...] = get_args(Order)
WORDS: dict[Order, str] = {"lat-lon": "latitude, longitude", "lon-lat": "longitude, latitude"}
METRES_A_DEGREE = 111_320.0
MAX_LATITUDE_DEG = 90.0
MAX_SATELLITES = 60  # a larger number in that place is a height
# A distance from home, or a speed, fits an order within its rounding and this share; an order is excluded where it
# misses by this many times as much.
DISTANCE_M, DISTANCE_SHARE, EXCLUDED = 2.0, 0.02, 3.0
SPEED_WINDOW_NS, SPEED_SHARE = 20_000_000_000, 0.15
MIN_SPEED_WINDOWS = 3
SAME_SHARE = 0.9  # share of places of one format


@dataclass(frozen=True)
class UnlabelledPlace:
    """One `GPS(a, b, c)`: both numbers as they stand, how many decimals they have, the third as text, and the rest of
    the subtitle: `at_ns` on the video's time, the home point in the same order, the distance from it, the speed.
    """

    at_ns: int
    first: float
    second: float
    decimals: int
    third: str
    has_pressure: bool  # BAROMETER(91.2), as the Avata 2 writes, not BAROMETER:0.3M
    home: tuple[float, float] | None
    from_home_m: float | None
    speed_m_s: float | None


def axis_order(places: list[UnlabelledPlace], stated: Order | None) -> tuple[Order, str]:
    """The order of all `places` and why, as text for the operator.

    Raises InputError (without the file's name) where evidence is missing or contradicts itself.
    """
    by_range = _by_range(places)
    if by_range is not None:
        if stated not in (None, by_range):
            raise InputError(f"--gps-order {stated} puts a latitude beyond 90; leave --gps-order out")
        return by_range, "a longitude is beyond 90"
    if stated is not None:
        return stated, "by --gps-order"
    measured, by_format = _by_distances(places), _by_format(places)
    if measured is None and by_format is None:
        raise InputError(
            "GPS(a, b) without labels in a format of no known model, and nothing else shows which number is the "
            "latitude; state it: --gps-order lat-lon or --gps-order lon-lat"
        )
    if measured is not None and by_format is not None and measured[0] != by_format[0]:
        raise InputError(
            f"GPS(a, b) contradicts itself: {WORDS[by_format[0]]} by {by_format[1]}, but {WORDS[measured[0]]} by "
            f"{measured[1]}; state which is right: --gps-order lat-lon or --gps-order lon-lat"
        )
    reasons = [found for found in (by_format, measured) if found is not None]
    return reasons[0][0], "by " + " and by ".join(why for _, why in reasons)


def _by_range(places: list[UnlabelledPlace]) -> Order | None:
    pairs = [(place.first, place.second) for place in places]
    pairs += [place.home for place in places if place.home is not None]
    first, second = (float(np.median([abs(pair[i]) for pair in pairs])) > MAX_LATITUDE_DEG for i in (0, 1))
    if first and second:
        raise InputError("GPS(a, b) holds numbers beyond 90 in both places: no latitude among them; give another log")
    return "lon-lat" if first else "lat-lon" if second else None


def _by_format(places: list[UnlabelledPlace]) -> tuple[Order, str] | None:
    """Return the order by the third number, if nearly all places have the same format (some may be damaged)."""
    usual, count = Counter(_model(place) for place in places).most_common(1)[0]
    return usual if count >= SAME_SHARE * len(places) else None


def _model(place: UnlabelledPlace) -> tuple[Order, str] | None:
    if re.fullmatch(r"[+-]?\d+(\.\d+)?\s*[Mm]", place.third):
        return "lat-lon", "the format, a height in metres third (Matrice 300)"
    if place.has_pressure and "." in place.third:
        return "lat-lon", "the format, a height third and BAROMETER( (Avata 2)"
    if place.third.isdecimal() and int(place.third) <= MAX_SATELLITES:
        return "lon-lat", "the format, a number of satellites third (Phantom, Mavic, Mini)"
    return None


def _by_distances(places: list[UnlabelledPlace]) -> tuple[Order, str] | None:
    """Return the order by distances from home, else by speeds, that the same subtitles state; None if neither."""
    misses = {order: _distance_miss(places, order) for order in ORDERS}
    best, other = sorted(ORDERS, key=lambda order: misses[order])
    if misses[best] <= 1.0 and misses[other] > EXCLUDED:
        return best, "the distances from home"
    too_fast = {order: _share_too_fast(places, order) for order in ORDERS}
    best, other = sorted(ORDERS, key=lambda order: too_fast[order])
    if too_fast[best] == 0.0 and too_fast[other] > 0.5:
        return best, "the speeds"
    return None


def _metres(a: tuple[float, float], b: tuple[float, float], order: Order) -> float:
    """Distance of two pairs of numbers as `order` reads them."""
    (lat_a, lon_a), (lat_b, lon_b) = (pair if order == "lat-lon" else pair[::-1] for pair in (a, b))
    shrink = math.cos(math.radians(0.5 * (lat_a + lat_b)))
    return METRES_A_DEGREE * math.hypot(lat_b - lat_a, shrink * (lon_b - lon_a))


def _step_m(place: UnlabelledPlace) -> float:
    return METRES_A_DEGREE * 10.0**-place.decimals


def _distance_miss(places: list[UnlabelledPlace], order: Order) -> float:
    """Median miss of the stated distances from home, in units of what rounding allows; 0 without any."""
    misses = [
        abs(_metres(p.home, (p.first, p.second), order) - p.from_home_m)
        / (_step_m(p) + DISTANCE_M + DISTANCE_SHARE * p.from_home_m)
        for p in places
        if p.home is not None and p.home != (0.0, 0.0) and p.from_home_m is not None
    ]
    return float(np.median(misses)) if misses else 0.0


def _share_too_fast(places: list[UnlabelledPlace], order: Order) -> float:
    """Return the share of stretches of the track that are longer than the stated speeds allow.

    Only those that are long enough to decide count; 0 with fewer than MIN_SPEED_WINDOWS of them.
    """
    known = [place for place in places if place.speed_m_s is not None]
    times_ns = [place.at_ns for place in known]
    travelled_m = np.zeros(len(known))
    for i in range(1, len(known)):
        fastest_m_s = max(known[i].speed_m_s or 0.0, known[i - 1].speed_m_s or 0.0)
        travelled_m[i] = travelled_m[i - 1] + fastest_m_s * (times_ns[i] - times_ns[i - 1]) / 1e9
    verdicts: list[bool] = []
    start = 0
    while start < len(known):
        end = bisect.bisect_left(times_ns, times_ns[start] + SPEED_WINDOW_NS)
        if end >= len(known):
            break
        a, b = known[start], known[end]
        allowed_m = (1.0 + SPEED_SHARE) * float(travelled_m[end] - travelled_m[start])
        moved_m = _metres((a.first, a.second), (b.first, b.second), order)
        if allowed_m > EXCLUDED * _step_m(a):
            verdicts.append(moved_m > allowed_m + _step_m(a))
        start = end
    return sum(verdicts) / len(verdicts) if len(verdicts) >= MIN_SPEED_WINDOWS else 0.0
