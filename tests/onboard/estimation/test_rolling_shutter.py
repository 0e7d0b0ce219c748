"""Rows read one after the other, in the adjustment, in a resection, and in what is kept of them."""

import json
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from contract.camera import UNKNOWN_SIGMA, Camera
from contract.rotations import exp_so3
from onboard.estimation.boresight import Alignment, PlatformEstimate
from onboard.estimation.bundle_adjustment import solve
from onboard.estimation.camera_states import READOUT, as_numbers, from_numbers
from onboard.estimation.factors import RATES
from onboard.estimation.keyframe import observation, seen_with
from onboard.estimation.platform_states import STATES
from onboard.estimation.resection import Sighted, resect
from onboard.estimation.rolling_shutter import Moving, Sweep, rates_between
from onboard.pipeline.estimates import as_rows, estimates_of, unconfirmed_of
from tests.onboard.scenes import Drawn, bundle_problem, first_guess

Array = NDArray[np.float64]

CAMERA = Camera.from_field_of_view(640, 480, 40.0)
READOUT_S = 0.03


def swept(drawn: Drawn, rates: Array, velocity: Array) -> tuple[Array, Array]:
    """What rows saw (K, P, 2) of the truth, exactly, and their shares (K, P); `rates` in camera axes."""
    s = drawn.truth
    xy, share = drawn.problem.xy.copy(), np.zeros(drawn.problem.weight.shape)
    for k in range(len(s.R_cam_enu)):
        for _ in range(8):
            share[k] = xy[k, :, 1] * CAMERA.fy_px / CAMERA.height_px
            late = READOUT_S * share[k]
            centres = s.centres_enu_m[k] + late[:, None] * velocity[k]
            R = exp_so3(-late[:, None] * rates[k]) @ s.R_cam_enu[k]
            p = np.einsum("pij,pj->pi", R, s.points_enu_m - centres)
            xy[k] = p[:, :2] / p[:, 2:]
    return xy, share


def scene(seed: int = 3) -> tuple[Drawn, Sweep, Array]:
    """Noise-free; turned by up to 20 degrees a second while flying at 20 m/s."""
    drawn = bundle_problem(np.random.default_rng(seed), 8, 60, noise=0.0)
    rng = np.random.default_rng(seed + 1)
    rates = np.radians(20.0) * rng.uniform(-1.0, 1.0, (8, 3))
    velocity = np.array([17.0, 10.0, -0.5]) + rng.normal(size=(8, 3))
    xy, share = swept(drawn, rates, velocity)
    return drawn, Sweep(READOUT_S, share, rates, velocity), xy


def test_a_window_of_swept_pictures_is_solved_as_if_they_had_been_taken_at_once() -> None:
    drawn, sweep, xy = scene()
    start = first_guess(drawn, drawn.truth.R_cam_enu, drawn.truth.centres_enu_m)
    errors = []
    for rows in (sweep, None):
        problem = replace(drawn.problem, xy=xy, sweep=rows)
        s = solve(problem, start, scale=None, max_iterations=60, tolerance=1e-12).state
        errors.append(float(np.abs(s.points_enu_m - drawn.truth.points_enu_m).max()))
    assert errors[0] < 0.15, "what is left is of second order, 0.05 px"
    assert errors[1] > 20.0 * errors[0], "this motion would not matter"


@pytest.mark.parametrize("is_rate_known", [True, False])
def test_a_picture_between_keyframes_finds_its_pose_through_its_rows_and_its_own_rate_too(is_rate_known: bool) -> None:
    drawn, sweep, xy = scene(7)
    s, k = drawn.truth, 3
    seen = drawn.problem.weight[k] > 0
    share, velocity, rates = sweep.share[k : k + 1, seen], sweep.velocity_enu_m_s[k : k + 1], sweep.rate_cam_rad_s[k]
    rows: list[Sweep | None] = [Sweep(READOUT_S, share, rates[None], velocity), None]
    if not is_rate_known:
        rows = [Sweep(READOUT_S, share, np.zeros((1, 3)), velocity, sigma, READOUT_S) for sigma in (0.3, 0.0)]
    points = Sighted(s.points_enu_m[seen], xy[k, seen], np.full(np.count_nonzero(seen), 900.0 / 0.3))
    loose = np.array([1.0] * 3 + [100.0] * 3)
    found, without = (resect(points, s.R_cam_enu[k], s.centres_enu_m[k], loose, sweep=own) for own in rows)
    missed, else_missed = (float(np.linalg.norm(f.centre_enu_m - s.centres_enu_m[k])) for f in (found, without))
    if is_rate_known:
        assert missed < 0.03
        assert else_missed > 0.5, "this motion would not matter"
    else:
        assert missed < 0.3 and (len(found.information), len(without.information)) == (9, 6)
        assert else_missed > 3.0 * missed, "this motion would not matter"
        np.testing.assert_allclose(found.rate_off_rad_s, rates, atol=0.03)


def test_rates_that_nothing_measures_are_found_with_the_poses() -> None:
    """Told that no picture turned; each turned by its own rate, which only its rows show."""
    drawn, sweep, xy = scene(5)
    layout = drawn.problem.layout.with_block(RATES)
    unknown = replace(sweep, rate_cam_rad_s=np.zeros((8, 3)), sigma_rate_rad_s=0.3, scale_s=READOUT_S)
    priors = [replace(prior, layout=layout) for prior in drawn.problem.priors]
    problem = replace(drawn.problem, layout=layout, priors=priors, xy=xy, sweep=unknown)
    start = first_guess(drawn, drawn.truth.R_cam_enu, drawn.truth.centres_enu_m)
    solution = solve(problem, replace(start, own=np.zeros((8, 3))), scale=None, max_iterations=60, tolerance=1e-12)
    known = solve(
        replace(drawn.problem, xy=xy, sweep=sweep), start, scale=None, max_iterations=60, tolerance=1e-12
    ).state
    off = solution.state.own - sweep.rate_cam_rad_s
    sigma = np.sqrt(np.diag(solution.covariance)[layout.by_picture])
    assert np.all(np.abs(off) < 3.0 * sigma)
    assert np.abs(off).max() < 0.15 * np.abs(sweep.rate_cam_rad_s).max()
    assert 0.001 < sigma.max() < 0.2
    missed_m = [np.abs(s.centres_enu_m - drawn.truth.centres_enu_m).max() for s in (solution.state, known)]
    assert missed_m[0] < missed_m[1] + 1.0


def test_the_residual_changes_with_the_readout_as_its_derivative_says() -> None:
    drawn, sweep, _ = scene(9)
    s = drawn.truth
    p = np.einsum("kij,kpj->kpi", s.R_cam_enu, s.points_enu_m[None] - s.centres_enu_m[:, None])
    predicted, depth = (p[..., :2] / p[..., 2:]).transpose(0, 2, 1), p[..., 2]
    by_readout = sweep.by_readout(s.R_cam_enu, predicted, depth)
    step = 1e-3
    for k in range(len(depth)):
        sides = []
        for sign in (1.0, -1.0):
            late = sign * step * sweep.share[k][:, None]
            R = exp_so3(-late * sweep.rate_cam_rad_s[k]) @ s.R_cam_enu[k]
            q = np.einsum("pij,pj->pi", R, s.points_enu_m - s.centres_enu_m[k] - late * sweep.velocity_enu_m_s[k])
            sides.append(q[:, :2] / q[:, 2:])
        np.testing.assert_allclose(by_readout[k].T, (sides[0] - sides[1]) / (2.0 * step), atol=1e-6)


def test_an_observation_is_brought_to_the_middle_rows_moment_over_the_assumed_ground() -> None:
    uv = np.array([[320.0, 3.0], [100.0, 239.5], [500.0, 470.0]])
    ids = np.arange(3)
    at_once = observation(CAMERA, ids, uv)
    rate, velocity, plane = np.array([0.35, 0.0, 0.0]), np.array([0.0, 20.0, 0.0]), np.array([0.01, 0.0, 0.0])
    moving = Moving(READOUT_S, rate, velocity, -velocity, plane)
    seen = observation(CAMERA, ids, uv, moving)
    np.testing.assert_array_equal(seen.raw_xy, at_once.xy)
    np.testing.assert_array_equal(at_once.raw_xy, at_once.xy)
    assert seen.xy[1] == pytest.approx(at_once.xy[1])
    # Both turn and travel move the ground down the picture, by 0.35 (1 + y^2) + 0.2 a second.
    share = (uv[:, 1] - 239.5) / 480.0
    expected = at_once.xy[:, 1] - READOUT_S * share * (0.35 * (1.0 + at_once.xy[:, 1] ** 2) + 0.2)
    np.testing.assert_allclose(seen.xy[:, 1], expected, atol=1e-9)
    doubled = seen_with(CAMERA, seen, 2.0 * READOUT_S)
    np.testing.assert_allclose(doubled.xy - at_once.xy, 2.0 * (seen.xy - at_once.xy), atol=1e-12)


def test_without_attitudes_rates_are_those_between_keyframes() -> None:
    rate, R = np.array([0.1, -0.2, 0.05]), exp_so3(np.array([0.3, 2.0, -0.4]))
    stamps = np.array([0.0, 1.0, 1.5, 3.0])
    R_cam_enu = exp_so3(-stamps[:, None] * rate) @ R
    np.testing.assert_allclose(rates_between(stamps, R_cam_enu), np.tile(rate, (4, 1)), atol=1e-12)
    np.testing.assert_array_equal(rates_between(stamps[:1], R_cam_enu[:1]), np.zeros((1, 3)))


def test_what_was_found_of_the_readout_is_kept_as_what_it_is() -> None:
    """A configuration that was set right meanwhile leaves nothing to correct; one without sigma drops the state."""
    first = Alignment(0.02, 0.1, 20.0, camera=CAMERA, readout=(0.0, 0.02))
    mean = np.concatenate([np.zeros(STATES + 5), [0.028]])
    assert first.offer(10**18, 10**18 + 10**10, mean, 0.01 * np.diag(first.platform.sigma**2))
    text = first.to_json()
    for configured, expected in ((0.0, 0.028), (0.028, 0.0)):
        again = Alignment(0.02, 0.1, 20.0, camera=CAMERA, readout=(configured, 0.02))
        again.restore(text)
        assert again.platform.mean[STATES + READOUT] == pytest.approx(expected, abs=0.0005)
        assert again.platform.sigma[STATES + READOUT] < 0.6 * 0.02
    sure = Alignment(0.02, 0.1, 20.0, camera=CAMERA, readout=(0.028, 0.0))
    sure.restore(text)
    assert len(sure.platform.mean) == STATES
    lens = Alignment(0.02, 0.1, 20.0, camera=replace(CAMERA, stated_sigma=UNKNOWN_SIGMA))
    lens.restore(text)
    assert len(lens.platform.mean) == STATES + 5
    both = Alignment(0.02, 0.1, 20.0, camera=replace(CAMERA, stated_sigma=UNKNOWN_SIGMA), readout=(0.01, 0.02))
    both.restore(lens.to_json())
    assert both.platform.mean[STATES + READOUT] == 0.0
    assert both.platform.sigma[STATES + READOUT] == pytest.approx(np.sqrt(1.25) * 0.02, rel=0.01)
    assert "readout_s" not in json.loads(lens.to_json())["camera"]
    states = np.array([0.01, 0.0, 0.0, 0.05, 0.0, 0.004])
    assert from_numbers(CAMERA, as_numbers(CAMERA, states, 0.02), 0.02) == pytest.approx(states, abs=1e-12)


def test_the_readout_is_reported_beside_the_camera_where_it_is_estimated() -> None:
    sure = Alignment(0.02, 0.1, 20.0, camera=CAMERA, readout=(0.03, 0.0)).platform
    assert "readout_error" not in [e.name for e in estimates_of(sure)]
    unsure = Alignment(0.02, 0.1, 20.0, camera=CAMERA, readout=(0.03, 0.02)).platform
    mean = unsure.mean.copy()
    mean[-1] = -0.0042
    found = estimates_of(PlatformEstimate(1, mean, unsure.covariance))
    assert [(e.name, e.unit) for e in found][-1] == ("readout_error", "seconds")
    assert ("readout", "-4.2 +-20.0 ms off camera.readout_s") in as_rows(found, ())


def test_what_is_not_confirmed_of_an_unsure_camera_is_reported_too() -> None:
    """It raised: states of the camera were counted on one side only."""
    alignment = Alignment(0.02, 0.1, 20.0, camera=replace(CAMERA, stated_sigma=UNKNOWN_SIGMA), readout=(0.0, 0.001))
    mean = np.zeros(STATES + 6)
    mean[-1] = 0.02
    assert not alignment.offer(10**18, 10**18 + 10**10, mean, 0.01 * np.diag(alignment.platform.sigma**2))
    assert [e.name for e in unconfirmed_of(alignment.unconfirmed)] == ["readout_error"]
