"""Pictures scaled or shifted by the optics, in one window of a scene with truth."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from contract.camera import UNKNOWN_SIGMA, Camera
from contract.feature_set import Status
from contract.rotations import exp_so3
from onboard.estimation import window_problem
from onboard.estimation.boresight import Alignment
from onboard.estimation.bundle_adjustment import image_residuals
from onboard.estimation.explanations import open_optics
from onboard.estimation.explanations import zoomed as by_zoom
from onboard.estimation.factors import OWN_STATES, SHIFT, ZOOM
from onboard.estimation.keyframe import observation
from onboard.estimation.moved_optics import LEAST_STRETCH, are_stretched, signs_of, try_one
from onboard.estimation.platform_states import STATES
from onboard.estimation.window_problem import WindowProblem
from onboard.estimation.window_request import Request
from onboard.estimation.window_solver import adjust
from tests.onboard.scenes import CAMERA, SceneSpec, draw
from tests.rest_long import rest_long

Array = NDArray[np.float64]

FROM = 5  # the first keyframe that is zoomed


def window_of(seed: int, spec: SceneSpec | None = None) -> Request:
    return draw(np.random.default_rng(seed), spec=spec).window().prepare()


def seen_by_another_lens(request: Request, log_scale: Array, shift_px: Array) -> Request:
    """The same window through a lens that is longer (K,) and off to the side (K, 2) in each picture."""
    camera = request.camera
    middle = np.array([camera.cx_px, camera.cy_px])
    keyframes = []
    for k, z, shift in zip(request.keyframes, log_scale, shift_px, strict=True):
        uv = middle + (k.observation.uv_px - middle) * np.exp(z) + shift
        keyframes.append(replace(k, observation=observation(camera, k.observation.ids, uv)))
    return replace(request, keyframes=tuple(keyframes))


def zoomed(request: Request, log_scale: float, first: int = FROM) -> Request:
    K = len(request.keyframes)
    return seen_by_another_lens(request, np.where(np.arange(K) >= first, log_scale, 0.0), np.zeros((K, 2)))


def shifted(request: Request, seed: int) -> Request:
    K = len(request.keyframes)
    return seen_by_another_lens(request, np.zeros(K), np.random.default_rng(seed).normal(0.0, 18.0, (K, 2)))


def stretched(request: Request, log_width: float) -> Request:
    """The same window with pictures that are so much wider than the camera file has them, and as high."""
    camera, keyframes = request.camera, []
    for k in request.keyframes:
        uv = k.observation.uv_px.copy()
        uv[:, 0] = camera.cx_px + (uv[:, 0] - camera.cx_px) * np.exp(log_width)
        keyframes.append(replace(k, observation=observation(camera, k.observation.ids, uv)))
    return replace(request, keyframes=tuple(keyframes))


def turned(request: Request, turns_rad: Array) -> Request:
    """The same window with attitudes that are off by these (K, 3), body axes."""
    keyframes = []
    for k, turn in zip(request.keyframes, turns_rad, strict=True):
        keyframes.append(replace(k, nav=replace(k.nav, R_enu_body=k.nav.R_enu_body @ exp_so3(turn))))
    return replace(request, keyframes=tuple(keyframes))


def problem_of(request: Request) -> WindowProblem:
    made = window_problem.from_request(request)
    assert isinstance(made, WindowProblem)
    return made


@pytest.mark.parametrize("seed", rest_long(range(4)))
@pytest.mark.parametrize("log_scale", [0.02, 0.05, 0.1])
def test_a_zoom_within_a_window_is_refused_as_such_and_measured(seed: int, log_scale: float) -> None:
    outcome = adjust(zoomed(window_of(seed), log_scale))
    assert outcome.status is Status.ZOOMED, outcome.reason
    assert abs(outcome.lens_moved - log_scale) < 0.015


def test_a_refusal_leaves_the_flights_noise_as_it_was() -> None:
    request = zoomed(window_of(3), 0.05)
    assert adjust(request).noise == request.noise


@pytest.mark.parametrize("seed", rest_long(range(4)))
def test_shifted_frames_are_told_from_attitudes_that_are_off_by_the_same_angles(seed: int) -> None:
    request = window_of(seed)
    assert adjust(shifted(request, seed)).status is Status.STABILISED
    turns = np.random.default_rng(seed).normal(0.0, 18.0 / request.camera.focal_px, (len(request.keyframes), 3))
    assert adjust(turned(request, turns)).status not in (Status.STABILISED, Status.ZOOMED)


def test_a_compass_that_is_far_off_is_no_shifted_frame() -> None:
    request = window_of(2)
    turns = np.zeros((len(request.keyframes), 3))
    turns[-4:, 2] = np.radians(40.0)
    assert adjust(turned(request, turns)).status not in (Status.STABILISED, Status.ZOOMED)


@pytest.mark.parametrize(
    "spec", [SceneSpec(), SceneSpec(relief_sigma_m=15.0), SceneSpec(climb_m_s=2.0, wobble_deg=4.0)]
)
@pytest.mark.parametrize("seed", rest_long([3, 4, 5]))
def test_a_window_without_any_is_solved_and_its_score_is_that_of_chance(seed: int, spec: SceneSpec) -> None:
    request = window_of(seed, spec)
    assert adjust(request).status is Status.OK
    window = problem_of(request)
    score = signs_of(window.weighed(request.noise, window.state)).zoom
    assert score.gain < 3.0 * score.freedom


def test_the_score_of_a_small_change_is_nearly_what_it_explains() -> None:
    """The first step stands for the whole adjustment: that is why every window can be looked at."""
    request = zoomed(window_of(4), 0.02)
    window = problem_of(request)
    weighed = window.weighed(request.noise, window.state)
    score = signs_of(weighed).zoom
    optics = open_optics(weighed)
    assert score.gain == pytest.approx(try_one(optics, by_zoom(optics)).gain, rel=0.3)


def test_a_single_picture_that_fits_nothing_is_no_zoom() -> None:
    request = window_of(0)
    last = request.keyframes[-1]
    uv = np.random.default_rng(1).permutation(last.observation.uv_px)
    spoilt = replace(last, observation=observation(request.camera, last.observation.ids, uv))
    outcome = adjust(replace(request, keyframes=(*request.keyframes[:-1], spoilt)))
    assert outcome.status not in (Status.ZOOMED, Status.STABILISED)


def test_a_zoom_that_begins_with_the_newest_picture_is_not_answered() -> None:
    request = window_of(4)
    assert adjust(zoomed(request, 0.05, len(request.keyframes) - 1)).status is Status.ZOOMED


@pytest.mark.parametrize("off", [-0.05, 0.05])
@pytest.mark.parametrize("seed", rest_long(range(3)))
def test_a_camera_file_that_is_wrong_is_no_zoom(seed: int, off: float) -> None:
    """Its focal length is found instead; every picture is off alike."""
    file = replace(CAMERA, fx_px=CAMERA.fx_px * (1 + off), fy_px=CAMERA.fy_px * (1 + off), stated_sigma=UNKNOWN_SIGMA)
    window = draw(np.random.default_rng(seed), spec=SceneSpec(relief_sigma_m=15.0), camera=file).window()
    request = zoomed(window.prepare(), float(-np.log1p(off)), 0)
    outcome = adjust(request)
    assert outcome.status is Status.OK, outcome.reason
    column = outcome.solved.layout.camera.start
    sigma = float(np.sqrt(outcome.solved.solution.covariance[column, column]))
    assert abs(outcome.solved.solution.state.camera[0] + np.log1p(off)) < 3.0 * sigma


def test_a_file_that_admits_no_error_and_is_wrong_is_refused_for_that() -> None:
    outcome = adjust(zoomed(window_of(1), 0.1, 0))
    assert outcome.status is Status.POOR_FIT and "off the camera file" in outcome.reason, outcome.reason


@pytest.mark.parametrize("block", [SHIFT, ZOOM])
def test_image_coordinates_move_with_a_blocks_states_as_its_jacobian_says(block: str) -> None:
    request = window_of(1)
    window = problem_of(request).with_block(block)
    problem, still = window.problem(request.noise), image_residuals(window.problem(request.noise), window.state)
    own = np.zeros_like(window.state.own)
    own[2] = 0.01
    moved = image_residuals(problem, replace(window.state, own=own)) - still
    assert own.shape[1] == OWN_STATES[block]
    predicted = still[2] + problem.xy[2].T
    expected = 0.01 * (predicted if block == ZOOM else np.ones_like(predicted))
    np.testing.assert_allclose(moved[2], expected, atol=1e-12)
    assert not moved[[0, 1, 3]].any()


def test_after_a_zoom_the_focal_length_is_open_again() -> None:
    """The lens stays where it stopped: windows that hold only pictures since then find its focal length."""
    request = window_of(2)
    for file in (CAMERA, replace(CAMERA, stated_sigma=UNKNOWN_SIGMA)):
        alignment = Alignment(0.02, 0.1, 20.0, camera=file)
        before = alignment.platform.sigma
        alignment.lens_moved(0.05)
        sigma = alignment.platform.sigma
        assert sigma[STATES] == pytest.approx(np.hypot(file.sigma[0], 0.05), rel=1e-3)
        np.testing.assert_allclose(sigma[:STATES], before[:STATES])
        platform = alignment.prior_for(0)
        longer = zoomed(
            replace(request, platform=platform, camera_taken=np.zeros(len(platform.mean) - STATES)), 0.05, 0
        )
        outcome = adjust(longer)
        assert outcome.status is Status.OK and outcome.solved is not None, outcome.reason
        assert abs(outcome.solved.solution.state.camera[0] - 0.05) < 0.03


def test_the_state_file_of_a_lens_that_zoomed_serves_a_file_without_sigmas() -> None:
    zoomed_lens = Alignment(0.02, 0.1, 20.0, camera=Camera.from_field_of_view(640, 480, 40.0))
    zoomed_lens.lens_moved(0.05)
    fresh = Alignment(0.02, 0.1, 20.0, camera=Camera.from_field_of_view(640, 480, 40.0))
    fresh.restore(zoomed_lens.to_json())
    assert len(fresh.platform.mean) == STATES


@pytest.mark.parametrize("seed", rest_long(range(4)))
@pytest.mark.parametrize("log_width", [-0.2877, 0.1, 0.2877])
def test_pictures_stretched_along_one_side_are_refused_as_such(seed: int, log_width: float) -> None:
    outcome = adjust(stretched(window_of(seed), log_width))
    assert outcome.status is Status.STRETCHED, outcome.reason
    assert outcome.is_stretched


@pytest.mark.parametrize("log_width", [0.0, pytest.param(0.02, marks=pytest.mark.long)])
def test_a_stretch_is_measured_as_well_as_its_sigma_states(log_width: float) -> None:
    sigmas = []
    for seed in range(8):
        request = stretched(window_of(seed), log_width)
        window = problem_of(request)
        weighed = window.weighed(request.noise, window.state)
        found = signs_of(weighed).stretch
        assert found.sigma < 0.3 * LEAST_STRETCH
        assert not are_stretched(weighed, found)
        sigmas.append((found.value - log_width) / found.sigma)
    assert 0.4 < np.sqrt(np.mean(np.square(sigmas))) < 1.8
