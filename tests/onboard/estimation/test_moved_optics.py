"""Pictures scaled or shifted by the optics, in one window of a scene with truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from contract.feature_set import Status
from onboard.estimation.keyframe import observation
from onboard.estimation.moved_optics import adjust, explained, scaled
from onboard.estimation.window_solver import Request
from tests.onboard.scenes import draw

PX = 900.0
FROM = 5  # the first keyframe that is zoomed


def window_of(seed: int) -> Request:
    return draw(np.random.default_rng(seed)).window().prepare()


def zoomed(request: Request, log_scale: float) -> Request:
    """The same window with its later pictures taken through a longer lens."""
    camera = request.camera
    middle = np.array([camera.cx_px, camera.cy_px])
    keyframes = list(request.keyframes)
    for i in range(FROM, len(keyframes)):
        seen = keyframes[i].observation
        uv = middle + (seen.uv_px - middle) * np.exp(log_scale)
        keyframes[i] = replace(keyframes[i], observation=observation(camera, seen.ids, uv))
    return replace(request, keyframes=tuple(keyframes))


def test_a_zoom_within_a_window_is_found_and_refused_as_such() -> None:
    request = zoomed(window_of(3), 0.1)
    found, gain = scaled(request)
    assert gain > 200.0
    np.testing.assert_allclose(found[:FROM], 0.0, atol=0.035)
    np.testing.assert_allclose(found[FROM:], 0.1, atol=0.035)
    outcome = adjust(request)
    assert outcome.status is Status.ZOOMED and "zoomed" in outcome.reason
    assert abs(outcome.keyframes[-1].log_zoom - 0.1) < 0.035
    followed = adjust(replace(request, keyframes=outcome.keyframes))
    assert followed.status is Status.ZOOMED


def test_a_window_without_any_is_solved_as_ever() -> None:
    request = window_of(3)
    assert adjust(request).status is Status.OK
    assert scaled(request)[1] < 60.0
    explanation = explained(request)
    assert explanation is None or explanation.as_is - explanation.shifted < 15.0
