"""Tracks that follow no point of the ground: what of them agrees by chance must not count.

A hover at 80 m, whose heading shows in a metre of travel only, with every tenth track off by 2.5 px at random in each
picture. Six flights: before, 71 % of the clicks were inside their 90 % ellipse; without such tracks 91 %. (6.15)
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.ablation_scenes import TIMED, WRONG_TRACKS
from benchmarks.sampled_flight import SampledFlight, SampledSpec, fly
from contract.answer import CHI2_2
from simulation.study_window import CAMERA, Setting, begin, draw, estimate
from tests.test_platform_errors import clicks

Array = NDArray[np.float64]

HOVER = SampledSpec(TIMED, seconds=70.0, rate_hz=2.0, **WRONG_TRACKS)


def ratios(seeds: Sequence[int]) -> Array:
    out = []
    for seed in seeds:
        flight = SampledFlight(HOVER, 12380 + seed)
        sets, _ = fly(flight)
        assert sum(s.is_ok for s in sets.values()) > 0.9 * len(sets)
        out.append(np.sqrt(clicks(flight, sets, 10.0, 2)[0] / CHI2_2))
    return np.concatenate(out)


@pytest.mark.long
@pytest.mark.parametrize("seeds", [[0], range(6)])
def test_a_hover_with_wrong_tracks_is_answered_and_its_ellipses_hold(seeds: Sequence[int]) -> None:
    ratio = ratios(seeds)
    assert 0.78 < np.mean(ratio < 1.0) < 0.97
    assert 0.6 < np.quantile(ratio, 0.9) < 1.3  # nor by ellipses that hold anything


def test_of_tracks_that_jump_about_hardly_anything_is_kept_and_of_the_others_nearly_everything() -> None:
    for seed in range(3):
        rng = np.random.default_rng([seed, 615])
        flight = draw(Setting(pixel_sigma_px=0.15), rng)
        wrong = rng.random(flight.seen.shape[1]) < 0.1
        xy = flight.problem.xy + wrong[:, None] * rng.normal(0.0, 2.5 / CAMERA.focal_px, flight.problem.xy.shape)
        flight = replace(flight, problem=replace(flight.problem, xy=xy), is_outlier=wrong)
        state = begin(flight)
        assert state is not None
        kept = estimate(flight, state)[1] > 0
        assert np.count_nonzero(kept[:, wrong]) < 0.12 * np.count_nonzero(flight.seen[:, wrong])  # before, 0.17 to 0.26
        assert np.count_nonzero(kept[:, ~wrong]) > 0.99 * np.count_nonzero(flight.seen[:, ~wrong])
