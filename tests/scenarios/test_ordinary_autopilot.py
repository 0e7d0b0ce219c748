"""Next to an ordinary autopilot, whose errors are not the declared ones, answers are as honest as claimed."""

from __future__ import annotations

import numpy as np
import pytest

from simulation.flight import DescribedSpec
from simulation.ordinary import ordinary
from simulation.paths import PathSpec
from simulation.session import SessionSpec
from tests.rest_long import rest_long
from tests.scenarios.flights import CAMERA, CHI2_90, play, simulated

# Sampled with the preset: 1, positions twice a second and 0.06 s ahead; 3, 0.07 s ahead and a compass up to 2.6 degrees
# off; 8, a followed glitch of 21 m; 12, positions 0.22 s behind.
SEEDS = rest_long([(1, 30.0), (1, 45.0), (3, 45.0), (8, 45.0), (12, 45.0)])


@pytest.mark.parametrize(("seed", "seconds"), SEEDS)
def test_an_ordinary_autopilots_errors_are_inside_what_is_claimed(seed: int, seconds: float) -> None:
    """Legs joined by turns of 25 degrees: issue E's bounds, flight by flight."""
    path = PathSpec("turns", leg_m=250.0)
    spec = SessionSpec(
        DescribedSpec(path, ordinary(seed), seed=seed),
        seconds=seconds,
        rate_hz=2.0,
        camera=CAMERA,
        clicks_per_frame=6,
        seed=seed,
    )
    outcome = play(simulated(spec))
    asked = len(outcome.errors_m) + outcome.refusals.total()
    assert len(outcome.errors_m) >= 0.6 * asked, outcome.reported
    assert outcome.inside_99 >= 0.93, outcome.reported
    assert float(np.sqrt(outcome.chi2.max() / CHI2_90)) < 3.0, outcome.reported
    assert np.median(outcome.semi_m) < 30.0, outcome.reported
