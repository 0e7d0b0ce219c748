"""A flight whose rows are read in 30 ms, told that they are not: it finds out, and answers as if it had been told."""

from __future__ import annotations

import numpy as np

from benchmarks.drawn_flight import DrawnFlight, fly
from benchmarks.rolling_shutter import TOLD, spec_of
from contract.feature_set import FeatureSet
from ground.answer import CHI2_2
from tests.drawn_clicks import chi2_of, located

AFTER_S = 14.0


def flown(told: dict[str, float]) -> tuple[list[float], list[float], tuple[float, float], list[FeatureSet]]:
    """Errors (m) and chi-squares of clicks in the outer rows, what was found of the readout, and the sets."""
    flight = DrawnFlight(spec_of(told, 26.0, 150.0), 1)
    sets, pipeline = fly(flight)
    rng = np.random.default_rng(5)
    errors_m, chi2 = [], []
    for k, s in sets.items():
        if flight.times_s[k] < AFTER_S or not s.is_ok:
            continue
        uv = np.column_stack([rng.uniform(20.0, 620.0, 4), rng.choice([20.0, 60.0, 420.0, 460.0], 4)])
        for error, answer in located(flight, s, uv):
            errors_m.append(float(np.hypot(*error)))
            chi2.append(chi2_of(error, answer))
    return errors_m, chi2, pipeline.window.readout, list(sets.values())


def test_a_readout_that_nobody_declared_is_found_and_hardly_costs_accuracy() -> None:
    right, _, _, _ = flown(TOLD["right"])
    found, chi2, (readout_s, sigma_s), sets = flown(TOLD["0 to 20 ms"])
    assert len(found) > 60
    assert abs(readout_s - 0.03) < 3.0 * sigma_s
    assert sigma_s < 0.003
    assert np.median(found) < 1.3 * np.median(right)
    assert np.mean(np.array(chi2) < CHI2_2) > 0.85
    published = [s.shutter for s in sets if s.is_ok]
    assert all(shutter is not None for shutter in published)


def test_a_global_shutter_publishes_no_rows() -> None:
    flight = DrawnFlight(spec_of({}, 8.0, 150.0), 1)
    sets, _ = fly(flight)
    assert any(s.is_ok for s in sets.values())
    assert all(s.shutter is None for s in sets.values())
