"""Stabilised video beside recorded telemetry is refused with its own reason, and nothing else is."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import Any

import pytest

from benchmarks.autopilots import ReplayedFlight, ReplayedTracker, Scene
from benchmarks.drawn_flight import DrawnFlight, DrawnSpec, fly
from benchmarks.platform_faults import FAULTS
from contract.feature_set import FeatureSet, Status
from contract.wire.codec import decode, encode
from onboard.config.schema import parse_config
from onboard.pipeline.pipeline import Pipeline
from simulation.paths import PathSpec

MOVED = {Status.STABILISED, Status.ZOOMED}


def flown(recording: str, start_s: float, seconds: float, **fault: Any) -> dict[int, FeatureSet]:
    """The last set of every picture, two a second."""
    scene = replace(Scene(recording, parse_config(""), start_s, seconds), **fault)
    flight = ReplayedFlight(scene, 0)
    pipeline = Pipeline(scene.config, scene.camera_file or scene.camera)
    pipeline.tracker = ReplayedTracker(flight)
    sets: dict[int, FeatureSet] = {}
    for event in flight.events():
        sets.update({out.frame: out for out in pipeline.handle(event)})
    sets.update({out.frame: out for out in pipeline.finish()})
    return sets


def counted(sets: dict[int, FeatureSet], frames: range) -> Counter[Status]:
    return Counter(sets[k].status for k in frames if k in sets)


def test_stabilised_video_is_refused_as_such_once_it_hides_a_turn() -> None:
    """The recording flies straight for 20 s, where nothing is hidden and answers are right."""
    sets = flown("plane_turn", 4.0, 36.0, stabilised_s=0.5)
    before, turning = counted(sets, range(10, 40)), counted(sets, range(52, 72))
    assert before[Status.OK] > 0.9 * before.total(), before
    assert turning[Status.STABILISED] > 0.8 * turning.total() and not turning[Status.OK], turning
    assert not any(s.status is Status.ZOOMED for s in sets.values())
    refused = next(s for s in sets.values() if s.status is Status.STABILISED)
    assert encode(refused)[2] == 0x21 and decode(encode(refused)).status is Status.STABILISED


@pytest.mark.parametrize("fault", ["wrong lens", "compass-flip"])
def test_other_faults_are_not_taken_for_moved_optics(fault: str) -> None:
    statuses = counted(flown("plane_turn", 12.0, 26.0, **FAULTS[fault]), range(52))
    assert not MOVED & set(statuses), statuses
    assert statuses[Status.OK] > 0.5 * statuses.total(), statuses


def drawn(path: PathSpec, seconds: float, zoom: tuple[float, float, float, float]) -> list[tuple[float, Status]]:
    """When each picture of a flight with a zoom was taken, and what became of it."""
    flight = DrawnFlight(DrawnSpec(parse_config(""), path, seconds, relief_sigma_m=2.0, zoom=zoom), 0)
    sets, _ = fly(flight)
    return [(float(t), sets[k].status) for k, t in enumerate(flight.times_s) if k in sets]


def test_a_small_zoom_in_a_turn_is_refused_for_as_long_as_it_lasts() -> None:
    """5 % that were over within the turn: 110 of 135 pictures after it were answered, by up to 17 m at 90 %."""
    path = PathSpec("turns", speed_m_s=20.0, height_m=150.0, bank_deg=35.5, leg_m=160.0)
    told = drawn(path, 24.0, (1.05, 11.5, 99.0, 0.3))
    before = Counter(status for t, status in told if 3.0 < t < 11.0)
    after = Counter(status for t, status in told if t > 13.5)
    assert before[Status.OK] > 0.9 * before.total(), before
    assert not after[Status.OK], after
    assert after[Status.ZOOMED] > 0.75 * after.total(), after


def test_a_zoom_that_comes_back_is_answered_again() -> None:
    told = drawn(PathSpec("straight", speed_m_s=20.0, height_m=150.0), 32.0, (1.1, 9.0, 15.0, 0.5))
    zoomed = Counter(status for t, status in told if 10.5 < t < 14.5)
    after = Counter(status for t, status in told if t > 26.0)
    assert zoomed[Status.ZOOMED] > 0.8 * zoomed.total() and not zoomed[Status.OK], zoomed
    assert after[Status.OK] > 0.9 * after.total(), after
