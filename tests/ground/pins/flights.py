"""A flight that sees one place again and again, with the errors its sets declare: clicks on it, and their truth."""

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from contract.answer import Fix
from contract.feature_set import ALIGNMENT, ATTITUDE, GROUND, NUISANCES, POSITION, SharedErrors
from contract.locate import Locator
from ground.pins.model import PinClick
from tests.ground.worlds import ORIGIN, Errors, build

Array = NDArray[np.float64]

POSITION_S, ATTITUDE_S = 100.0, 20.0
START_NS = 1_700_000_000_000_000_000
# Ground that is nearly flat: each world draws hills of its own, and a place has but one.
FLAT = {"relief_relative": 1e-4, "roughness": 1e-7, "feature_relative": 0.01}


def shared(span_s: float = 0.0) -> SharedErrors:
    """Position and attitude wander, a mount, a clock and a slope, as a window of a straight flight has them."""
    F = np.zeros((9, NUISANCES))
    F[:3, POSITION] = np.diag([2.0, 2.0, 3.0])
    F[3:6, ATTITUDE] = np.diag([0.006, 0.006, 0.02])
    F[3:6, ALIGNMENT] = 0.01 * np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]])
    F[1, ALIGNMENT.stop - 1] = 1.0
    F[3, GROUND.start + 1] = 0.005
    return SharedErrors(F, POSITION_S, ATTITUDE_S, np.array([0.01, 0.01, 0.01, 0.05]), (-span_s / 2.0, span_s / 2.0))


def drifting(rng: np.random.Generator, times_s: Array) -> Array:
    """(N, NUISANCES) unit draws at these times: what wanders wanders, what stays stays."""
    out = np.tile(rng.normal(size=NUISANCES), (len(times_s), 1))
    for k in range(1, len(times_s)):
        for part, tau in ((POSITION, POSITION_S), (ATTITUDE, ATTITUDE_S)):
            keep = math.exp(-(times_s[k] - times_s[k - 1]) / tau)
            out[k, part] = keep * out[k - 1, part] + math.sqrt(1.0 - keep * keep) * rng.normal(size=3)
    return out


def sightings(
    rng: np.random.Generator,
    times_s: Array,
    targets_enu_m: Array,
    *,
    same_window: bool = False,
    draws: Array | None = None,
    pointing_px: float = 1.0,
) -> list[PinClick]:
    """A click a picture at these times on targets (N, 3) in ORIGIN's axes; each answer errs as its set declares.

    `same_window`: all pictures have the fresh errors and the features in common, as pictures of one window have.
    """
    draws = drifting(rng, times_s) if draws is None else draws
    if same_window:
        draws = np.tile(draws[0], (len(times_s), 1))
    pixel = rng.uniform([150.0, 120.0], [490.0, 360.0], (1, 2))
    fresh, seed = rng.normal(size=9), int(rng.integers(2**32))
    clicks = []
    for k, at_s in enumerate(times_s):
        world = build(
            np.random.default_rng(seed) if same_window else rng,
            Errors(shared=shared(span_s=200.0 if same_window else 0.0), **FLAT),
            features=24,
            clicks_px=pixel if same_window else rng.uniform([150.0, 120.0], [490.0, 360.0], (1, 2)),
            draws=draws[k],
            fresh=fresh if same_window else None,
            yaw_rad=0.3 if same_window else None,
            frame=k,
            capture_unix_ns=START_NS + round(at_s * 1e9),
        )
        locator = Locator(world.feature_set)
        fix = locator.locate(world.clicks_px[0])
        assert isinstance(fix, Fix)
        parts = locator.error_parts(world.clicks_px[0])
        error = world.error(0, fix) + parts.by_pixel_m @ rng.normal(0.0, pointing_px, 2)
        click = PinClick.of(world.feature_set, fix, world.clicks_px[0], locator=locator, clicked_unix_ns=START_NS)
        lat, lon, height = (float(v) for v in ORIGIN.to_geodetic(targets_enu_m[k] + error))
        clicks.append(
            dataclasses.replace(click, lat_deg=lat, lon_deg=lon, height_ellipsoid_m=height, height_amsl_m=height - 20.0)
        )
    return clicks
