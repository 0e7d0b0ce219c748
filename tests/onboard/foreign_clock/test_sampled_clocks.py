"""The benchmark of clocks by positions alone samples the errors that it states, and judges answers by its goals."""

import re
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.foreign_clock import EPOCH_S, HOME, Motion, Receiver, Score, judge, log_of, report
from onboard.events.types import PositionFix


def test_clocks_that_are_off_by_what_their_sigmas_state_reach_the_goal_and_refused_ones_are_counted() -> None:
    error_s = 0.2 * np.array([-2.0, *np.linspace(-1.5, 1.5, 18), 2.1])
    honest = [Score("turns", 1, "fixed", float(each), 0.0, 0.2) for each in error_s]
    refused = Score("turns", 1, "fixed", reason="offsets of +1.5 s and -2.0 s fit equally")

    def pooled(scores: list[Score]) -> str:
        return report([*scores, refused]).split("| all ")[1]

    assert re.search(r"20 of 21 .* 0\.217 .* 1\.08 .* 90% \+- 7% .* 2\.10 .* reached", pooled(honest))
    assert "NOT" not in pooled(honest) and "turns, 1 refused: offsets of T s and T s fit equally" in pooled(honest)
    for wrong in (0.5, 1.5, 10.0):
        assert "NOT reached" in pooled([replace(score, sigma_s=0.2 * wrong) for score in honest])
    assert "NOT reached" in pooled([*honest[:-1], replace(honest[-1], error_s=0.61)])  # for one alone
    assert "reached" not in pooled(honest[1:])  # too few to be judged


def test_what_is_sampled_of_a_clock_is_as_late_and_as_far_off_as_it_is_stated() -> None:
    """Without a receiver's errors a log lies on the path, later by its age; a low pass is a part of that age."""
    rng = np.random.default_rng(5)
    motion = Motion.sampled("turns", 40.0, rng)
    exact = Receiver(0.3, 0.1, np.zeros(3), 30.0, 0.0, 0.0, 8)
    fixes = log_of(motion, exact, 40.0, 5, rng).events
    assert all(isinstance(fix, PositionFix) and fix.velocity_ned_m_s is None for fix in fixes)
    true_s = np.array([fix.stamp_ns / 1e9 for fix in fixes]) - EPOCH_S - 0.3
    logged = np.array([HOME.to_enu(f.lat_deg, f.lon_deg, f.height_amsl_m) for f in fixes])
    off_m = {late_s: np.abs(logged - motion.position_m(true_s + late_s))[5:, :2].max() for late_s in (-0.1, 0.0, 0.1)}
    assert off_m[0.0] < 0.1 and min(off_m[-0.1], off_m[0.1]) > 0.4
    errors_m = Receiver(0.0, 0.2, np.ones(3), 20.0, 0.05, 0.05, 8).errors_m(20_000, 0.2, rng)
    assert 0.7 < errors_m.std() < 1.0 and 0.05 < np.diff(errors_m, axis=0).std() < 0.12


@pytest.mark.long
def test_a_flight_whose_height_and_mount_are_not_quite_common_to_it_is_not_one_of_a_clock_that_was_set() -> None:
    """Another offset fitted its first half better by 91 where 48 were asked for, and left out the other half."""
    found = judge("turns", 10, 1017)
    assert not found.reason and abs(found.error_s) < 2.0 * found.sigma_s
