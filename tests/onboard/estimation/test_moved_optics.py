"""Pictures scaled or shifted by the optics, in one window of a scene with truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from contract.feature_set import Status
from contract.rotations import exp_so3
from onboard.estimation.keyframe import observation
from onboard.estimation.moved_optics import LIKELIER, Scales, adjust, explained, scaled
from onboard.estimation.window_solver import Request
from tests.onboard.scenes import draw

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


def shifted(request: Request, seed: int) -> Request:
    """The same window with every frame shifted, 25 px rms."""
    rng, camera = np.random.default_rng(seed), request.camera
    keyframes = []
    for k in request.keyframes:
        uv = k.observation.uv_px + rng.normal(0.0, 18.0, 2)
        keyframes.append(replace(k, observation=observation(camera, k.observation.ids, uv)))
    return replace(request, keyframes=tuple(keyframes))


def test_a_zoom_within_a_window_is_found_and_refused_as_such() -> None:
    request = zoomed(window_of(3), 0.1)
    found = scaled(request)
    assert found.is_zoom and found.gain > 200.0
    np.testing.assert_allclose(found.log_scale[:FROM], 0.0, atol=0.035)
    np.testing.assert_allclose(found.log_scale[FROM:], 0.1, atol=0.035)
    outcome = adjust(request)
    assert outcome.status is Status.ZOOMED and "zoomed" in outcome.reason
    assert abs(outcome.keyframes[-1].log_zoom - 0.1) < 0.035
    followed = adjust(replace(request, keyframes=outcome.keyframes))
    assert followed.status is Status.ZOOMED


@pytest.mark.parametrize("seed", range(4))
def test_frames_that_shift_from_picture_to_picture_are_told_from_attitudes_that_err(seed: int) -> None:
    request = window_of(seed)
    found = explained(shifted(request, seed))
    assert found is not None and found.gain > 2.0 * LIKELIER
    assert 10.0 < found.shift_px < 50.0
    # The same angles as errors of the attitudes: no frame is shifted.
    rng = np.random.default_rng(seed)
    turned = [exp_so3(rng.normal(0.0, 18.0 / request.camera.focal_px, 3)) for _ in request.keyframes]
    keyframes = []
    for k, turn in zip(request.keyframes, turned, strict=True):
        assert k.nav.R_enu_body is not None
        keyframes.append(replace(k, nav=replace(k.nav, R_enu_body=k.nav.R_enu_body @ turn)))
    wrong = explained(replace(request, keyframes=tuple(keyframes)))
    assert wrong is None or wrong.gain < 0.0


def test_a_compass_that_is_far_off_is_no_shifted_frame() -> None:
    """It was: the pictures as they are had not been adjusted as far as the heading was wrong."""
    request = window_of(2)
    about_up = exp_so3(np.array([0.0, 0.0, np.radians(40.0)]))
    keyframes = []
    for k in request.keyframes[-4:]:
        assert k.nav.R_enu_body is not None
        nav = replace(k.nav, R_enu_body=about_up @ k.nav.R_enu_body)
        keyframes.append(replace(k, nav=nav, R_cam_enu=k.R_cam_enu @ about_up.T))
    found = explained(replace(request, keyframes=tuple(keyframes)))
    assert found is None or found.gain < LIKELIER


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_a_window_without_any_is_solved_as_ever(seed: int) -> None:
    request = window_of(seed)
    assert adjust(request).status is Status.OK
    assert not scaled(request).is_zoom
    explanation = explained(request)
    assert explanation is None or explanation.gain < LIKELIER


def test_a_single_picture_that_fits_nothing_is_no_zoom() -> None:
    request = window_of(0)
    last = request.keyframes[-1]
    uv = np.random.default_rng(1).permutation(last.observation.uv_px)
    spoilt = replace(last, observation=observation(request.camera, last.observation.ids, uv))
    assert not scaled(replace(request, keyframes=(*request.keyframes[:-1], spoilt))).is_zoom


def test_only_a_steady_change_is_a_zoom() -> None:
    steady = np.array([0.0, 0.0, 0.05, 0.1, 0.1, 0.1])
    assert Scales(steady, 100.0).is_zoom
    assert Scales(steady[::-1] - 0.1, 100.0).is_zoom
    assert not Scales(steady, 20.0).is_zoom
    assert not Scales(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.3]), 100.0).is_zoom
    assert not Scales(np.array([0.0, 0.2, -0.2, 0.2, -0.2, 0.1]), 100.0).is_zoom
