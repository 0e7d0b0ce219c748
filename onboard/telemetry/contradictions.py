"""Rows of a file of positions that contradict one another: a few are left out; of many, none is used."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from contract.errors import InputError
from contract.geodesy import geodetic_to_ecef
from onboard.events.types import PositionFix

NS_PER_S = 1_000_000_000
MAX_SPEED_M_S, SLACK_M = 300.0, 100.0  # more does not fly so; a receiver's own jumps are judged in flight, by its state
LEAST_SHARE = 0.9  # of the rows, that agree
TRIES = 5


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


def _chain(stamps_s: list[float], places_m: NDArray[np.float64], of: list[int]) -> tuple[list[int], list[int]]:
    """Return the rows that can be reached one after the other from the first, and the others."""
    chain, rest = of[:1], list[int]()
    for at in of[1:]:
        last = chain[-1]
        reach_m = SLACK_M + MAX_SPEED_M_S * (stamps_s[at] - stamps_s[last])
        is_near = float(np.linalg.norm(places_m[at] - places_m[last])) <= reach_m
        (chain if is_near else rest).append(at)
    return chain, rest
