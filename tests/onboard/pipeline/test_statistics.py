"""What a flight without an answer is told: counts that agree with each other, however long it was."""

import numpy as np

from contract.feature_set import Status
from onboard.config.schema import parse_config
from onboard.navigation.navigator import NavState
from onboard.pipeline.statistics import REMEMBERED, Break, RunStatistics
from onboard.pipeline.summary import Shortfall

APART_NS = 500_000_000


def state(number: int) -> NavState:
    place = np.array([5.0 * number, 0.0, 100.0])
    return NavState(number * APART_NS, place, np.array([10.0, 0.0, 0.0]), np.eye(3), 1.0, 1.5, 0.1, 0.0, 100.0)


def after(pictures: int) -> Shortfall | None:
    """Every picture parted from the one before it by a jump, none of them answered."""
    statistics = RunStatistics(parse_config(""))
    last = None
    for number in range(pictures):
        nav = state(number)
        statistics.note_state(last, nav, None if last is None else Break.JUMP)
        statistics.note(number, Status.STARTING)
        last = nav
    return statistics.summary.shortfall


def test_no_more_pairs_are_reported_to_be_parted_than_there_are() -> None:
    short, long = after(100), after(REMEMBERED + 1000)
    assert "between 99 of 99 pairs" in short.reason
    assert f"between {REMEMBERED} of {REMEMBERED} pairs" in long.reason
