"""Pictures scaled or shifted by the optics, in one window of a scene with truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from contract.feature_set import Status
from contract.rotations import exp_so3
from onboard.estimation.keyframe import Keyframe, observation
from onboard.estimation.moved_optics import adjust, explained
from onboard.estimation.optics_hypotheses import LIKELIER
from onboard.estimation.window_solver import Request
from onboard.estimation.zoom import Scales, by_itself, followed_by, has_come_back, scaled
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


def all_zoomed(request: Request, log_scale: float) -> Request:
    """The same window with every picture taken through a longer lens."""
    camera = request.camera
    middle = np.array([camera.cx_px, camera.cy_px])
    keyframes = []
    for k in request.keyframes:
        uv = middle + (k.observation.uv_px - middle) * np.exp(log_scale)
        keyframes.append(replace(k, observation=observation(camera, k.observation.ids, uv)))
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


@pytest.mark.parametrize("seed", range(4))
def test_a_scale_that_all_pictures_have_is_told_by_rotations(seed: int) -> None:
    """The zoom was over before the window's first picture: nothing changes within it."""
    request = window_of(seed)
    honest, longer = by_itself(request), by_itself(all_zoomed(request, 0.1))
    assert honest is not None and longer is not None
    assert 0.002 < honest.sigma < 0.02 and abs(honest.log_scale) < 4.0 * honest.sigma
    assert abs(longer.log_scale - 0.1) < 4.0 * longer.sigma
    assert longer.is_off and not honest.is_off
    assert honest.is_back_from(0.15) and not longer.is_back_from(0.15)
    assert not honest.is_back_from(0.005)  # too near to be told from it


def test_a_lens_that_had_zoomed_before_the_window_is_refused_until_it_surely_is_back() -> None:
    """It was believed where its windows were not strained, after whatever loss of features."""
    request = window_of(3)
    lost = _marked(request, 0.1)
    longer = all_zoomed(request, 0.1)
    still = adjust(replace(longer, keyframes=_marked(longer, 0.1)))
    assert still.status is Status.ZOOMED and all(k.is_zoom_lost for k in still.keyframes)
    back = adjust(replace(request, keyframes=lost))
    assert back.status is Status.OK and not any(k.log_zoom or k.is_zoom_lost for k in back.keyframes)
    # Three pictures are too few to tell, and are not believed for it.
    few = adjust(replace(request, keyframes=lost[-3:]))
    assert few.status is Status.ZOOMED


def _marked(request: Request, log_scale: float) -> tuple[Keyframe, ...]:
    return tuple(replace(k, log_zoom=log_scale, is_zoom_lost=True) for k in request.keyframes)


def test_scales_are_followed_by_all_that_are_known_and_not_by_the_first() -> None:
    known = np.array([0.0, 0.05, 0.05, 0.05, 0.05, 0.05])
    found = np.array([0.0, 0.08, 0.08, 0.08, 0.08, 0.08])  # the first one's features err
    np.testing.assert_allclose(followed_by(known, found), [-0.03, 0.05, 0.05, 0.05, 0.05, 0.05])
    np.testing.assert_allclose(followed_by(np.zeros(6), found), found)


def test_a_zoom_is_over_once_it_is_seen_to_come_back_and_not_when_an_estimate_wanders_there() -> None:
    assert has_come_back(np.array([0.1, 0.1, 0.1, 0.05, 0.005, 0.0, 0.01]))
    assert not has_come_back(np.array([0.1, 0.1, 0.1, 0.1, 0.05, 0.005, 0.0]))  # two pictures
    assert not has_come_back(np.array([0.03, 0.028, 0.026, 0.024, 0.022, 0.019, 0.018]))
    assert not has_come_back(np.array([0.05, 0.05, 0.05, 0.05, 0.05, 0.03, 0.015]))


def test_what_a_zoom_did_to_the_noise_is_no_excuse_for_the_next_window() -> None:
    request = window_of(3)
    start_ns = request.keyframes[0].nav.stamp_ns
    spoilt = replace(request.noise, jitter_s=0.02, noise_inflation=2.0, past=((start_ns - 1, 0.003, 1.0),))
    outcome = adjust(replace(zoomed(request, 0.05), noise=spoilt))
    assert outcome.status is Status.ZOOMED
    assert (outcome.noise.jitter_s, outcome.noise.noise_inflation) == (0.003, 1.0)
    # Of windows that share a picture with this one nothing is known to be undisturbed.
    shared = replace(spoilt, past=((start_ns + 1, 0.003, 1.0),))
    assert adjust(replace(zoomed(request, 0.05), noise=shared)).noise.jitter_s == 0.02


def test_scales_are_found_as_steps_of_the_lens_and_not_as_a_slow_drift() -> None:
    found = scaled(zoomed(window_of(4), 0.05))
    assert found.is_zoom
    np.testing.assert_allclose(found.log_scale[:FROM], 0.0, atol=1e-9)
    np.testing.assert_allclose(found.log_scale[FROM:], 0.05, atol=0.01)


def test_a_zoom_that_begins_with_the_newest_picture_is_not_answered() -> None:
    """One picture is not enough to call it a zoom; it was answered, with more noise."""
    request = window_of(4)
    camera, last = request.camera, request.keyframes[-1]
    middle = np.array([camera.cx_px, camera.cy_px])
    uv = middle + (last.observation.uv_px - middle) * 1.05
    spoilt = replace(last, observation=observation(camera, last.observation.ids, uv))
    outcome = adjust(replace(request, keyframes=(*request.keyframes[:-1], spoilt)))
    assert outcome.status is Status.POOR_FIT
    assert outcome.noise.noise_inflation == request.noise.noise_inflation
