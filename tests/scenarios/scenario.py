"""A row of the table of scenarios: a flight, what is wrong on it, and what is expected of its pictures and clicks."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest

from contract.feature_set import Status
from onboard.events.types import Event
from onboard.pipeline.terrain_at_hand import TerrainSource
from simulation.session import SessionSpec
from tests.scenarios.flights import CHI2_90, Outcome, play, simulated

MANY = 10**9
Bounds = tuple[float, float]


@dataclass(frozen=True)
class Expected:
    """Bounds on what comes of a flight; each that is named holds. Statuses are those of each picture's last set."""

    solved: Bounds = (0.0, 1.0)  # share of the pictures
    answered: float = 0.0  # at least this share of the clicks
    inside_99: float = 0.97  # at least this share of the answers inside their 99 % ellipses; 0: not asked
    refuses_clicks: bool = False  # none is answered
    may_refuse_all: bool = False  # bounds on answers hold where there are any
    median_m: float = math.inf  # error of the answers, at most
    semi_m: Bounds = (0.0, math.inf)  # median semi-major axis of their 90 % ellipses
    worst: float = math.inf  # error of any over its own 90 % ellipse, less than
    reasons: tuple[Status, ...] = tuple(Status)  # that pictures may have besides `ok` and `starting`
    starting: float = math.inf  # less than this share of the pictures is `starting`
    some: tuple[Status, ...] = ()  # at least one picture has one of these
    counts: Mapping[Status, tuple[int, int]] = field(default_factory=dict)  # pictures, at least and at most
    stretches: tuple[tuple[int, int | None, Status], ...] = ()  # all pictures from one to before another
    ok_from: tuple[int, float] = (0, 0.0)  # from this picture on, at least this share is answered
    settles: tuple[Status, int] | None = None  # `starting`, then this to the end, from that picture on at the latest
    refused_clicks: Mapping[Status, float] = field(default_factory=dict)  # more than this share of all clicks
    methods: Mapping[str, float] = field(default_factory=dict)  # by which this share of the answers is found, at least
    shortfall: str = ""  # part of the reason and remedy of a flight of which nothing is solved

    def check(self, outcome: Outcome) -> None:
        self._pictures(outcome)
        self._clicks(outcome)
        if self.shortfall:
            assert self.shortfall in why(outcome), why(outcome)

    def _pictures(self, outcome: Outcome) -> None:
        seen, found = outcome.reported, outcome.statuses
        assert self.solved[0] <= outcome.solved <= self.solved[1], seen
        assert set(found) <= {*self.reasons, Status.STARTING, Status.OK}, seen
        assert found[Status.STARTING] < self.starting * len(outcome.sets), seen
        assert not self.some or any(found[status] for status in self.some), seen
        for status, (least, most) in self.counts.items():
            assert least <= found[status] <= most, seen
        ordered = [outcome.sets[frame].status for frame in sorted(outcome.sets)]
        for begin, end, status in self.stretches:
            assert set(ordered[begin:end]) == {status}, (begin, end, seen, ordered)
        later = ordered[self.ok_from[0] :]
        assert later.count(Status.OK) >= self.ok_from[1] * len(later), seen
        if self.settles is not None:
            begin = ordered.index(self.settles[0])
            assert begin <= self.settles[1], seen
            assert set(ordered[:begin]) == {Status.STARTING} and set(ordered[begin:]) == {self.settles[0]}, ordered

    def _clicks(self, outcome: Outcome) -> None:
        seen, answered = outcome.reported, len(outcome.errors_m)
        asked = answered + outcome.refusals.total()
        assert answered >= self.answered * asked, seen
        for status, share in self.refused_clicks.items():
            assert outcome.refusals[status] > share * asked, seen
        if self.refuses_clicks:
            assert not answered, seen
        if answered == 0 and (self.may_refuse_all or self.refuses_clicks or self.inside_99 == 0.0):
            return
        assert outcome.inside_99 >= self.inside_99, seen  # fails where nothing was answered
        assert np.median(outcome.errors_m) < self.median_m, seen
        assert self.semi_m[0] < np.median(outcome.semi_m) < self.semi_m[1], seen
        assert np.sqrt(outcome.chi2.max() / CHI2_90) < self.worst, seen
        for method, share in self.methods.items():
            assert outcome.methods[method] >= share * outcome.methods.total(), outcome.methods


def why(outcome: Outcome) -> str:
    """Reason and remedy where nothing was solved."""
    summary = outcome.pipeline.summary
    assert summary.solved == 0 and summary.shortfall is not None, outcome.reported
    return f"{summary.shortfall.reason}; {summary.shortfall.remedy}"


SOLVED = Expected(solved=(0.9, 1.0), median_m=8.0, semi_m=(0.5, 40.0))
ANSWERS = Expected(answered=0.6, median_m=8.0, semi_m=(0.0, 25.0))


def solved(least: float = 0.9, median_m: float = 8.0, **more: object) -> Expected:
    """Answered nearly everywhere, near enough, inside of what is claimed, and the claim is worth something."""
    return replace(SOLVED, solved=(least, 1.0), median_m=median_m, **more)


def refused(*reasons: Status, starting: float = 0.5) -> Expected:
    """No click is answered, for one of these reasons; the first pictures may still be starting."""
    return Expected(refuses_clicks=True, reasons=reasons, starting=starting)


def either(*reasons: Status, **more: object) -> Expected:
    """Return bounds by which what is answered holds, and what is refused has one of these reasons."""
    return Expected(may_refuse_all=True, reasons=reasons, **more)


def unsolved(shortfall: str) -> Expected:
    """Nothing is solved, and the summary's reason and remedy contain this."""
    return Expected(solved=(0.0, 0.0), may_refuse_all=True, shortfall=shortfall)


@dataclass(frozen=True)
class Scenario:
    """One claim: what is flown, what is wrong, what is expected."""

    claim: str
    flight: SessionSpec
    expected: Expected
    spoilt: Callable[[Path], Path] | None = None  # its files, in a copy
    telemetry: Callable[[Event, float], Event | None] | None = None  # each event by seconds since the first picture
    config: tuple[tuple[str, object], ...] = ()
    terrain: TerrainSource | None = None
    # Another flight or configuration whose median radius this one's is compared with, as least and most times.
    radius_of: Scenario | None = None
    radius: Bounds = (0.0, math.inf)
    long: str = ""  # where `make test` shows the same, or why it cannot

    def play(self) -> Outcome:
        folder = simulated(self.flight)
        changed = folder if self.spoilt is None else self.spoilt(folder)
        return play(changed, *self.config, terrain=self.terrain, spoil=self.telemetry)

    def check(self) -> None:
        outcome = self.play()
        self.expected.check(outcome)
        if self.radius_of is not None:
            ratio = float(np.median(outcome.semi_m) / np.median(self.radius_of.play().semi_m))
            assert self.radius[0] < ratio < self.radius[1], (ratio, outcome.reported)


def as_parameters(table: Mapping[str, list[Scenario]]) -> list[object]:
    """Rows for `parametrize`; the short ones under a heading are one worker's, which simulates their flights once."""
    return [
        pytest.param(
            row,
            id=row.claim.replace(" ", "-"),
            marks=pytest.mark.long if row.long else pytest.mark.xdist_group(f"scenarios: {heading}"),
        )
        for heading, rows in table.items()
        for row in rows
    ]
