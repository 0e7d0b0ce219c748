"""What neighbouring pairs share is found by how a flight's parts scatter, for the sigma and for what is a rival."""

import numpy as np
import pytest

from onboard.foreign_clock.flight_parts import by_parts, overstated, resampled
from onboard.telemetry.log_clocks import BLOCKS


@pytest.mark.parametrize("pairs", [1, 5, BLOCKS, 80])
def test_parts_are_whole_neighbours_of_about_one_size(pairs: int) -> None:
    parts = by_parts(np.vstack([np.ones(pairs), np.arange(pairs)]))
    assert parts.shape == (2, min(BLOCKS, pairs)) and np.ptp(parts[0]) <= 1.0
    assert parts.sum(axis=1) == pytest.approx([pairs, pairs * (pairs - 1) / 2])
    assert (np.diff(parts[1] / parts[0]) > 0.0).all()


def test_the_sigma_is_that_of_the_parts_own_offsets_however_sure_each_is_of_its() -> None:
    """Parts that state 10 ms each and lie 0.2 s apart: 3 ms by the curvature of their sum."""
    errors, sigmas = [], []
    offsets_s = np.linspace(-0.5, 0.5, 401)
    for seed in range(60):
        own_s = np.random.default_rng(seed).normal(0.0, 0.2, BLOCKS)
        mean_s, sigma_s = resampled(offsets_s, np.square((offsets_s[:, None] - own_s) / 0.01), np.zeros(401)) or (0, 0)
        errors.append(mean_s)
        sigmas.append(sigma_s)
    assert 0.8 < np.sqrt(np.mean(np.square(errors)) / np.mean(np.square(sigmas))) < 1.2
    assert resampled(offsets_s, np.zeros((401, 1)), np.zeros(401)) is None


@pytest.mark.parametrize("factor", [3.0, 30.0])
def test_by_how_much_costs_overstate_is_found_though_parts_determine_much_and_little(factor: float) -> None:
    """A part's ratio has the variance that its mean asks for, times the factor."""
    rng = np.random.default_rng(0)
    means = factor * rng.choice([0.1, 1.0, 5.0], (50, 400))
    found = overstated(rng.normal(means, np.sqrt(4.0 * factor * means)))
    assert 0.85 * factor < np.median(found) < 1.15 * factor


def test_one_part_that_shows_it_all_is_no_doubt_and_parts_against_it_are() -> None:
    clear, torn, worse = np.zeros(BLOCKS), np.full(BLOCKS, 20.0), np.full(BLOCKS, -1.0)
    clear[3], torn[4:9] = 100.0, -10.0
    factors = overstated(np.stack([clear, torn, worse]))
    assert factors[0] == 0.0 and factors[1] > 20.0 / 13.8 and factors[2] == 0.0
