"""Stabilised video beside recorded telemetry is refused with its own reason, and nothing else is."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import Any

import pytest

from benchmarks.autopilots import ReplayedFlight, ReplayedTracker, Scene
from benchmarks.platform_faults import FAULTS
from contract.feature_set import FeatureSet, Status
from contract.wire.codec import decode, encode
from onboard.config.schema import parse_config
from onboard.pipeline.pipeline import Pipeline

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
