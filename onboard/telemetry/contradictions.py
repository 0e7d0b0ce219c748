"""Rows of a file that contradict one another, positions or dates: a few are left out; of many, none is used."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from contract.errors import InputError
from contract.geodesy import geodetic_to_ecef
from onboard.events.types import PositionFix

NS_PER_S = 1_000_000_000
MAX_SPEED_M_S, SLACK_M = 300.0, 100.0  # more does not fly so; a receiver's own jumps are judged in flight, by its state
LEAST_SHARE = 0.9  # of the rows, that agree
TRIES = 5
SAME_BEGINNING_NS = 10_000_000_000  # by two dates: frame rates are rounded, and an hour of them is 4 s off


def agreeing(positions: list[PositionFix]) -> tuple[list[int], list[str]]:
    """Return which positions, in order of time, an aircraft can have passed, and a note of what is left out.

    Raises InputError where too few agree to determine which ones are wrong.
    """
    stamps_s = [(fix.stamp_ns - positions[0].stamp_ns) / NS_PER_S for fix in positions]
    geodetic = np.array([(fix.lat_deg, fix.lon_deg, fix.height_amsl_m) for fix in positions])
    places_m = geodetic_to_ecef(*geodetic.T)
    kept: list[int] = []
    rest = list(range(len(positions)))
    for _ in range(TRIES):
        chain, rest = _chain(stamps_s, places_m, rest)
        kept = max(kept, chain, key=len)
        if len(rest) <= len(kept):
            break
    out = sorted(set(range(len(positions))) - set(kept))
    if not out:
        return kept, []
    one = out[0]
    other = min(kept, key=lambda at: abs(stamps_s[at] - stamps_s[one]))
    where = [f"{positions[at].lat_deg:.5f}, {positions[at].lon_deg:.5f}" for at in (one, other)]
    apart = (
        f"{where[0]} and {where[1]} are {np.linalg.norm(places_m[one] - places_m[other]):.0f} m and "
        f"{abs(stamps_s[one] - stamps_s[other]):.2f} s apart"
    )
    if len(kept) < LEAST_SHARE * len(positions):
        raise InputError(f"positions contradict one another: {apart}; take out the rows that are wrong")
    return kept, [f"{len(out)} of {len(positions)} positions contradict the others and are not used: {apart}"]


def beginning(began_ns: Sequence[int], what: str) -> tuple[int, list[str]]:
    """Return when `what` began, of what each of its dates less the time since then gives (ns), and a note on dates that
    contradict the others.

    Whole seconds are cut off, never rounded up, so that the latest beginning that they allow is the best. Raises
    InputError where dates contradict one another and too few agree.
    """
    began = sorted(began_ns)
    middle_ns = began[len(began) // 2]
    agree = [one for one in began if abs(one - middle_ns) <= SAME_BEGINNING_NS]
    if len(agree) == len(began):
        return began[-1], []
    if len(agree) < LEAST_SHARE * len(began):
        days = [f"{datetime.fromtimestamp(one // NS_PER_S, UTC):%Y-%m-%d %H:%M:%S}" for one in (began[0], began[-1])]
        raise InputError(f"its dates contradict one another: {what} began at {days[0]} by one, at {days[1]} by another")
    return agree[-1], [f"{len(began) - len(agree)} of {len(began)} dates contradict the others and are not used"]


def _chain(stamps_s: list[float], places_m: NDArray[np.float64], of: list[int]) -> tuple[list[int], list[int]]:
    """Return the rows that can be reached one after the other from the first, and the others."""
    chain, rest = of[:1], list[int]()
    for at in of[1:]:
        last = chain[-1]
        reach_m = SLACK_M + MAX_SPEED_M_S * (stamps_s[at] - stamps_s[last])
        is_near = float(np.linalg.norm(places_m[at] - places_m[last])) <= reach_m
        (chain if is_near else rest).append(at)
    return chain, rest
