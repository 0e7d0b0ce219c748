"""Stabilised video and a lens that zooms beside recorded telemetry: refused with their own reasons, and only they."""

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
from tests.onboard.telemetry.recordings import needs_recordings

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


@needs_recordings
@pytest.mark.parametrize(("recording", "start_s"), [("plane_breeze", 45.0), ("plane_clean", 60.0)])
def test_stabilised_video_is_refused_as_such(recording: str, start_s: float) -> None:
    sets = flown(recording, start_s, 25.0, stabilised_s=0.5)
    statuses = counted(sets, range(12, 50))
    assert statuses[Status.STABILISED] > 0.6 * statuses.total(), statuses
    assert statuses[Status.OK] < 0.1 * statuses.total(), statuses
    assert statuses[Status.ZOOMED] == 0
    refused = next(s for s in sets.values() if s.status is Status.STABILISED)
    assert encode(refused)[2] == 0x21 and decode(encode(refused)).status is Status.STABILISED


@needs_recordings
def test_a_zoom_is_refused_until_it_comes_back() -> None:
    sets = flown("plane_breeze", 70.0, 60.0, zoom=(1.25, 18.0, 30.0))
    before, during, after = counted(sets, range(12, 36)), counted(sets, range(44, 60)), counted(sets, range(100, 120))
    assert before[Status.OK] > 0.6 * before.total() and not before[Status.ZOOMED], before
    assert during[Status.ZOOMED] > 0.6 * during.total() and not during[Status.OK], during
    assert after[Status.OK] > 0.6 * after.total(), after
    assert not any(s.status is Status.STABILISED for s in sets.values())


@needs_recordings
@pytest.mark.parametrize("fault", ["none", "wrong lens", "tilt-jump", "compass-flip"])
def test_other_faults_are_not_taken_for_moved_optics(fault: str) -> None:
    statuses = counted(flown("plane_breeze", 45.0, 25.0, **FAULTS[fault]), range(50))
    assert not MOVED & set(statuses), statuses
    assert statuses[Status.OK] > 0.5 * statuses.total(), statuses
