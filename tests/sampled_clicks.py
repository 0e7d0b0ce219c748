"""Clicks on the sets of a simulated flight, next to the truth."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from benchmarks.sampled_flight import PLACE, SampledFlight
from contract.answer import Fix
from contract.feature_set import FeatureSet
from contract.locate import Locator
from contract.wire.codec import decode, encode

Array = NDArray[np.float64]


def located(flight: SampledFlight, found: FeatureSet, uv_px: Array) -> Iterator[tuple[Array, Fix]]:
    """Horizontal error (2,) in metres and answer of each pixel (N, 2) that gets one; the set goes over the wire."""
    locator = Locator(decode(encode(found)))
    for uv in uv_px:
        answer = locator.locate(uv)
        if isinstance(answer, Fix):
            assert answer.height_amsl_m is not None
            where = PLACE.to_enu(answer.lat_deg, answer.lon_deg, answer.height_amsl_m)
            yield (where - flight.ground_points(found.frame, uv[None])[0])[:2], answer


def chi2_of(error_m: Array, answer: Fix) -> float:
    """The squared error in units of the stated covariance."""
    return float(error_m @ np.linalg.solve(answer.covariance_enu_m2[:2, :2], error_m))
