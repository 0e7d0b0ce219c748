"""Positions that come seldom and late, as over a telemetry modem: every picture between two of them is placed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace

import pytest

from benchmarks.drawn_flight import DrawnFlight, DrawnSpec, fly
from contract.feature_set import Status
from onboard.config.schema import parse_config
from onboard.events.types import Event, Frame, PositionFix
from simulation.paths import PathSpec

PATH = PathSpec("turns", leg_m=250.0)
SECONDS = 26.0


class SparseFlight(DrawnFlight):
    """One position every so often, its stamp and its arrival late."""

    def __init__(self, spec: DrawnSpec, seed: int, every_s: float, late_s: float, without: int = -1) -> None:
        super().__init__(spec, seed)
        self._every_ns, self._late_ns, self._without = round(every_s * 1e9), round(late_s * 1e9), without

    def events(self) -> Iterator[Event]:
        kept, last, count = list[tuple[int, Event]](), None, 0
        for event in super().events():
            if not isinstance(event, PositionFix):
                kept.append((event.stamp_ns, event))
                continue
            if last is None or event.stamp_ns - last >= self._every_ns:
                last, count = event.stamp_ns, count + 1
                late = replace(event, stamp_ns=event.stamp_ns + self._late_ns)
                if count != self._without:
                    kept.append((late.stamp_ns, late))
        yield from (event for _, event in sorted(kept, key=lambda pair: pair[0]))


@pytest.mark.parametrize(("every_s", "late_s"), [(2.0, 2.5), (2.0, 0.5)])
def test_a_picture_waits_for_the_position_that_it_is_joined_by(every_s: float, late_s: float) -> None:
    config = parse_config(
        f"[gps]\nlatency_s = {late_s}\nsigma_latency_s = 0.05\nmax_gap_s = {every_s + 0.5}\nglitch_m = 50.0\n"
        f"quality_timeout_s = {every_s + 1.0}\n"
    )
    flight = SparseFlight(DrawnSpec(config, PATH, seconds=SECONDS, rate_hz=5.0), 3, every_s, late_s)
    sets, _ = fly(flight)
    inside = {frame: s for frame, s in sets.items() if frame < 5 * (SECONDS - every_s - late_s) - 5}
    statuses = Counter(s.status for s in inside.values())
    assert statuses[Status.UNSYNCHRONISED] == 0, statuses
    assert statuses[Status.OK] > 0.8 * len(inside), statuses


def test_in_a_gap_that_is_not_joined_pictures_are_refused_and_those_before_it_are_not() -> None:
    config = parse_config(
        "[gps]\nlatency_s = 2.5\nsigma_latency_s = 0.05\nmax_gap_s = 2.5\nglitch_m = 50.0\nquality_timeout_s = 6.0\n"
    )
    flight = SparseFlight(DrawnSpec(config, PATH, seconds=36.0, rate_hz=2.0), 3, 2.0, 2.5, without=9)
    sets, _ = fly(flight)
    # One position is missing: only pictures within those four seconds have none near enough on both sides.
    refused = [frame / 2.0 for frame, s in sets.items() if s.status is Status.UNSYNCHRONISED and frame < 56]
    assert 3.0 <= max(refused) - min(refused) <= 4.0 and len(refused) <= 9, refused


def test_where_positions_come_often_a_picture_waits_no_longer_for_those_that_were_lost() -> None:
    """A picture in an outage of a usual autopilot's positions is answered when it was before."""
    config = parse_config("")
    flight = DrawnFlight(DrawnSpec(config, PATH, seconds=20.0, rate_hz=2.0), 3)
    from onboard.pipeline.pipeline import Pipeline  # noqa: PLC0415

    pipeline = Pipeline(config, flight.spec.camera)
    for event in flight.events():
        if not isinstance(event, Frame):
            pipeline.navigation.add(event)
    assert pipeline.navigation.behind_ns < 0.3e9 + config.gps.latency_s * 1e9
