"""Every analytic Jacobian against central differences, away from the solution; and what each residual measures."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from contract.rotations import exp_so3, log_so3
from onboard.estimation.factors import (
    AttitudePrior,
    Layout,
    PositionPrior,
    Prior,
    RangePrior,
    SharedPrior,
    State,
    VelocityPrior,
    gauss_markov_sqrt_information,
    ground_plane,
    reprojection,
    reprojection_jacobians,
)
from onboard.estimation.platform_states import BORESIGHT, DELAY, HEADING, OFFSET, STATES, VELOCITY_DELAY
from tests.onboard.scenes import bundle_problem

Array = NDArray[np.float64]
STEP = 1e-6
K, P = 4, 7


def sampled_state(rng: np.random.Generator) -> State:
    """Nothing of it special: every error is a tenth of a radian, metres, tenths of a second."""
    truth = bundle_problem(rng, K, 4 * P).truth
    truth = replace(truth, points_enu_m=truth.points_enu_m[:P])
    step = 0.1 * rng.standard_normal(Layout(K).size)
    return truth.retract(step, rng.standard_normal((P, 3)))


def numeric(f: Callable[[State], Array], state: State, columns: int) -> Array:
    """Central differences of f over the camera side, through the state's own retraction."""
    out = []
    for c in range(columns):
        step = np.zeros(columns)
        step[c] = STEP
        ahead, behind = state.retract(step, np.zeros((P, 3))), state.retract(-step, np.zeros((P, 3)))
        out.append((f(ahead) - f(behind)) / (2.0 * STEP))
    return np.stack(out, axis=-1)


def whitener(rng: np.random.Generator) -> Array:
    stamps = np.cumsum(rng.uniform(0.5, 2.0, K))
    return np.stack([gauss_markov_sqrt_information(stamps, s, 3.0 * s, 20.0) for s in (0.3, 0.5, 0.9)])


def position_prior(rng: np.random.Generator) -> PositionPrior:
    return PositionPrior(
        Layout(K), 50.0 * rng.standard_normal((K, 3)), 20.0 * rng.standard_normal((K, 3)), whitener(rng),
        0.1 * rng.standard_normal(K),
    )  # fmt: skip


def velocity_prior(rng: np.random.Generator) -> VelocityPrior:
    gained = 5.0 * rng.standard_normal((K - 1, 3))
    return VelocityPrior(
        Layout(K), 20.0 * rng.standard_normal((K - 1, 3)), gained, whitener(rng)[:, 1:, 1:], rng.normal(0.0, 0.1, K - 1)
    )


def with_lever_arm(
    make: Callable[[np.random.Generator], PositionPrior | VelocityPrior],
) -> Callable[[np.random.Generator], Prior]:
    """The same residual with the camera some metres from the autopilot's reference point."""

    def made(rng: np.random.Generator) -> Prior:
        return replace(make(rng), lever_cam_m=3.0 * rng.standard_normal(3))

    return made


def attitude_prior(rng: np.random.Generator) -> AttitudePrior:
    """Far from the state: attitude off by half a radian, rates of a radian a second."""
    truth = bundle_problem(rng, K, P).truth
    measured = truth.R_cam_enu.transpose(0, 2, 1) @ exp_so3(0.3 * rng.standard_normal((K, 3)))
    return AttitudePrior(Layout(K), measured, rng.standard_normal((K, 3)), whitener(rng), 0.1 * rng.standard_normal(K))


def compass_prior(rng: np.random.Generator) -> Prior:
    """An attitude whose heading errs by its heading, each picture's another."""
    bearing = rng.uniform(0.0, 2.0 * np.pi, K)
    return replace(attitude_prior(rng), by_heading=np.column_stack([np.cos(bearing), np.sin(bearing)]))


def shared_prior(rng: np.random.Generator) -> Prior:
    return SharedPrior(Layout(K), rng.standard_normal(11), rng.standard_normal((11, 11)))


def range_prior(rng: np.random.Generator) -> Prior:
    ends = 100.0 * rng.standard_normal((2, 3))
    return RangePrior(Layout(K), np.array([0, 2]), ends, rng.uniform(0.5, 3.0, 2), 20.0 * rng.standard_normal(3))


PRIORS = {
    "position": position_prior,
    "position, lever arm": with_lever_arm(position_prior),
    "velocity": velocity_prior,
    "velocity, lever arm": with_lever_arm(velocity_prior),
    "attitude": attitude_prior,
    "attitude by heading": compass_prior,
    "shared": shared_prior,
    "range": range_prior,
}


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("make", PRIORS.values(), ids=PRIORS.keys())
def test_a_priors_jacobian_is_its_residuals_derivative(make: Callable[[np.random.Generator], Prior], seed: int) -> None:
    rng = np.random.default_rng(seed)
    prior, state = make(rng), sampled_state(rng)
    residual, jacobian = prior.evaluate(state)
    assert jacobian.shape == (len(residual), Layout(K).size)
    expected = numeric(lambda s: prior.evaluate(s)[0], state, Layout(K).size)
    # A column in radians beside one in metres: each by its own largest entry, so that none hides behind another.
    largest = np.abs(expected).max(axis=0)
    assert np.all(np.abs(jacobian - expected) <= 1e-6 * np.abs(expected) + 2e-6 * largest + 1e-7)


COLUMNS = {
    "position": {"centres", "offset", "delay"},
    "position, lever arm": {"rotations", "centres", "offset", "delay"},
    "velocity": {"centres", "offset", "velocity_delay"},
    "velocity, lever arm": {"rotations", "centres", "offset", "velocity_delay"},
    "attitude": {"rotations", "boresight", "offset"},
    "attitude by heading": {"rotations", "boresight", "offset", "heading"},
    "shared": {"boresight", "offset", "delay", "velocity_delay", "heading", "plane"},
    "range": {"centres", "plane"},
}


@pytest.mark.parametrize("kind", PRIORS)
def test_a_prior_has_columns_of_the_states_it_depends_on_and_of_no_other(kind: str) -> None:
    """Left out of a Jacobian and of the residual alike, a state would pass the differences above."""
    rng, layout = np.random.default_rng(7), Layout(K)
    columns = np.arange(layout.size)
    platform = {
        "boresight": BORESIGHT, "offset": [OFFSET], "delay": [DELAY], "velocity_delay": [VELOCITY_DELAY],
        "heading": HEADING,
    }  # fmt: skip
    _, jacobian = PRIORS[kind](rng).evaluate(sampled_state(rng))
    whole = {
        "rotations": layout.rotations().ravel(),
        "centres": layout.centres().ravel(),
        **{name: columns[layout.platform][at] for name, at in platform.items()},
        "plane": columns[layout.plane],
    }
    assert sorted(np.concatenate(list(whole.values()))) == list(range(layout.size))
    assert {name for name, columns in whole.items() if jacobian[:, columns].any()} == COLUMNS[kind]


def test_the_attitude_jacobian_is_tested_where_its_terms_differ() -> None:
    """A left and a right Jacobian, and either order of boresight and turn, agree at zero error: the test must not."""
    rng = np.random.default_rng(0)
    prior, state = attitude_prior(rng), sampled_state(rng)
    assert isinstance(prior, AttitudePrior)
    turn = exp_so3(prior.rate * (state.platform[OFFSET] - prior.offset_s)[:, None])
    error = log_so3(state.R_cam_enu @ prior.measured @ turn @ exp_so3(state.platform[BORESIGHT]))
    assert np.linalg.norm(error, axis=1).min() > 0.1
    assert np.linalg.norm(state.platform[BORESIGHT]) > 0.05
    assert np.abs(state.platform[OFFSET] - prior.offset_s).max() > 0.05


@pytest.mark.parametrize("seed", range(3))
def test_reprojection_by_rotation_and_centre_is_its_derivative(seed: int) -> None:
    rng = np.random.default_rng(seed)
    state = sampled_state(rng)
    xy = 0.3 * rng.standard_normal((K, 2, P))

    def residual(s: State) -> Array:
        # Of the same points: a step of the views takes them along, to second order.
        return reprojection(s.R_cam_enu, s.centres_enu_m, state.points_enu_m, xy)[0]

    _, predicted, depth = reprojection(state.R_cam_enu, state.centres_enu_m, state.points_enu_m, xy)
    by_rotation, by_point = reprojection_jacobians(state.R_cam_enu, predicted, depth, np.ones_like(depth))
    by_view = np.concatenate([by_rotation, -by_point], axis=1).transpose(0, 2, 3, 1)
    expected = numeric(residual, state, Layout(K).size)
    for k in range(K):
        own = expected[k, :, :, 6 * k : 6 * k + 6]
        assert by_view[k] == pytest.approx(own, rel=1e-6, abs=1e-8)
        others = np.delete(expected[k], np.s_[6 * k : 6 * k + 6], axis=-1)
        assert not others.any()


@pytest.mark.parametrize("seed", range(3))
def test_reprojection_by_point_is_its_derivative(seed: int) -> None:
    rng = np.random.default_rng(seed)
    state = sampled_state(rng)
    xy = 0.3 * rng.standard_normal((K, 2, P))
    _, predicted, depth = reprojection(state.R_cam_enu, state.centres_enu_m, state.points_enu_m, xy)
    _, by_point = reprojection_jacobians(state.R_cam_enu, predicted, depth, np.ones_like(depth))
    for axis in range(3):
        step = np.zeros(3)
        step[axis] = 1e-4
        sides = [
            reprojection(state.R_cam_enu, state.centres_enu_m, state.points_enu_m + s, xy)[0] for s in (step, -step)
        ]
        assert by_point[:, axis] == pytest.approx((sides[0] - sides[1]) / 2e-4, rel=1e-6, abs=1e-9)


def test_a_point_behind_the_camera_is_finite_and_says_so() -> None:
    state = sampled_state(np.random.default_rng(0))
    above = state.centres_enu_m[:1] + [0.0, 0.0, 100.0]
    residual, predicted, depth = reprojection(state.R_cam_enu, state.centres_enu_m, above, np.zeros((K, 2, 1)))
    assert depth[0, 0] < 0.0
    assert np.all(np.isfinite(residual))
    jacobians = reprojection_jacobians(state.R_cam_enu, predicted, depth, np.ones_like(depth))
    assert all(np.all(np.isfinite(J)) for J in jacobians)


def test_the_ground_planes_jacobians_are_its_derivatives() -> None:
    rng = np.random.default_rng(0)
    points, reference, plane = 50.0 * rng.standard_normal((P, 3)), rng.standard_normal(3), rng.standard_normal(3)
    residual, by_point, by_plane = ground_plane(points, reference, plane)
    assert residual == pytest.approx(
        points[:, 2] - reference[2] - plane[0] - (points[:, :2] - reference[:2]) @ plane[1:], abs=1e-12
    )
    for axis in range(3):
        step = np.zeros(3)
        step[axis] = 1e-5
        ahead, behind = (ground_plane(points + s, reference, plane)[0] for s in (step, -step))
        assert by_point[:, axis] == pytest.approx((ahead - behind) / 2e-5, abs=1e-6)
        ahead, behind = (ground_plane(points, reference, plane + s)[0] for s in (step, -step))
        assert by_plane[:, axis] == pytest.approx((ahead - behind) / 2e-5, abs=1e-5)


def test_the_whitener_whitens_a_gauss_markov_error() -> None:
    """Samples of the model come out with unit covariance; one that ignored the correlation would not do it."""
    rng = np.random.default_rng(0)
    stamps = np.array([0.0, 1.0, 2.5, 4.0, 30.0])
    white, slow, tau = 0.3, 1.5, 10.0
    W = gauss_markov_sqrt_information(stamps, white, slow, tau)
    lag = np.abs(stamps[:, None] - stamps[None])
    covariance = slow**2 * np.exp(-lag / tau) + white**2 * np.eye(5)
    assert W @ covariance @ W.T == pytest.approx(np.eye(5), abs=1e-12)
    assert np.triu(W, 1) == pytest.approx(0.0, abs=1e-12)
    samples = np.linalg.cholesky(covariance) @ rng.standard_normal((5, 4000))
    assert np.cov(W @ samples) == pytest.approx(np.eye(5), abs=0.08)
    assert np.abs(np.cov(samples / np.hypot(white, slow)) - np.eye(5)).max() > 0.5


@pytest.mark.parametrize(
    ("which", "measured_m", "asked_s", "left_m"),
    [
        (OFFSET, 0.0, 0.0, 0.0), (DELAY, 0.0, 0.0, 0.0), (VELOCITY_DELAY, 0.0, 0.0, 2.0),
        (OFFSET, 2.0, 0.1, 0.0),  # a position that was asked for at the offset needs no move any more
    ],
    ids=["the time offset", "a delay of the position", "a delay of the velocity", "asked for at the offset"],
)  # fmt: skip
def test_the_time_offset_and_a_delay_move_positions_along_the_velocity(
    which: int, measured_m: float, asked_s: float, left_m: float
) -> None:
    """Stamps early, or positions old, by 0.1 s at 20 m/s east: the camera was 2 m further east than the GPS said."""
    velocity, measured = np.array([[20.0, 0.0, 0.0]]), np.array([[measured_m, 0.0, 0.0]])
    prior = PositionPrior(Layout(1), measured, velocity, np.ones((3, 1, 1)), np.array([asked_s]))
    shared = 0.1 * (np.arange(STATES) == which)
    state = State(np.eye(3)[None], np.array([[2.0, 0.0, 0.0]]), np.zeros((0, 3)), shared, np.zeros(3))
    assert prior.evaluate(state)[0] == pytest.approx([left_m, 0.0, 0.0], abs=1e-12)


def test_the_lever_arm_turns_with_the_camera() -> None:
    """A camera 0.5 m ahead of the GPS: the same centre, turned right about, is measured a metre from before. (5.14)"""
    ahead = np.array([0.5, 0.0, 0.0])
    prior = PositionPrior(
        Layout(1), np.array([[-0.5, 0.0, 0.0]]), np.zeros((1, 3)), np.ones((3, 1, 1)), np.zeros(1), lever_cam_m=ahead
    )
    state = State(np.eye(3)[None], np.zeros((1, 3)), np.zeros((0, 3)), np.zeros(STATES), np.zeros(3))
    assert prior.evaluate(state)[0] == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)
    about = replace(state, R_cam_enu=exp_so3(np.array([[0.0, 0.0, np.pi]])))
    assert prior.evaluate(about)[0] == pytest.approx([1.0, 0.0, 0.0], abs=1e-9)


def test_a_heading_error_by_heading_turns_each_picture_by_its_own_heading() -> None:
    """Cosine part 0.02 rad: northbound the compass shows 0.02 to the west of the camera, southbound to the east."""
    R_enu_cam = exp_so3(np.random.default_rng(4).standard_normal((3, 3)))
    by_heading = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0]])
    measured = exp_so3(np.array([[0.0, 0.0, 0.02], [0.0, 0.0, -0.02], [0.0, 0.0, 0.0]])) @ R_enu_cam
    prior = AttitudePrior(
        Layout(3), measured, np.zeros((3, 3)), np.stack([np.eye(3)] * 3), np.zeros(3), by_heading=by_heading
    )
    state = State(
        R_enu_cam.transpose(0, 2, 1), np.zeros((3, 3)), np.zeros((0, 3)),
        0.02 * (np.arange(STATES) == HEADING.start), np.zeros(3),
    )  # fmt: skip
    assert prior.evaluate(state)[0] == pytest.approx(0.0, abs=1e-9)
    believed = prior.evaluate(replace(state, platform=np.zeros(STATES)))[0].reshape(3, 3)
    assert believed[2] == pytest.approx([0.02, -0.02, 0.0], abs=1e-5)


def test_the_attitude_error_is_expressed_about_east_north_up() -> None:
    """A camera turned by 0.01 rad about the vertical shows 0.01 in the heading's residual only, however it looks."""
    rng = np.random.default_rng(3)
    R_enu_cam = exp_so3(rng.standard_normal((2, 3)))
    prior = AttitudePrior(Layout(2), R_enu_cam, np.zeros((2, 3)), np.stack([np.eye(2)] * 3), np.zeros(2))
    turned = exp_so3(np.array([0.0, 0.0, 0.01])) @ R_enu_cam
    state = State(turned.transpose(0, 2, 1), np.zeros((2, 3)), np.zeros((0, 3)), np.zeros(STATES), np.zeros(3))
    residual = prior.evaluate(state)[0].reshape(3, 2)
    assert residual[2] == pytest.approx([-0.01, -0.01], abs=1e-6)
    assert residual[:2] == pytest.approx(0.0, abs=1e-6)


def test_retraction_composes_as_the_error_says() -> None:
    rng = np.random.default_rng(1)
    state = sampled_state(rng)
    step = 0.01 * rng.standard_normal(Layout(K).size)
    moved = state.retract(step, np.ones((P, 3)))
    turn = log_so3(moved.R_cam_enu @ state.R_cam_enu.transpose(0, 2, 1))
    assert turn == pytest.approx(step[Layout(K).rotations()], abs=1e-12)
    assert moved.centres_enu_m - state.centres_enu_m == pytest.approx(step[Layout(K).centres()], abs=1e-12)
    less = state.retract(1e-4 * step, np.full((P, 3), 1e-4))  # of points it is the first order
    assert less.points_enu_m - state.points_enu_m == pytest.approx(1e-4, rel=1e-3)
    assert moved.platform - state.platform == pytest.approx(step[Layout(K).platform])
    assert moved.plane - state.plane == pytest.approx(step[Layout(K).plane])
    together = np.concatenate([moved.platform - state.platform, moved.plane - state.plane])
    assert together == pytest.approx(step[Layout(K).shared])


def test_no_step_takes_a_point_past_the_views_or_to_more_than_twice_its_distance_along_its_ray() -> None:
    """Of any length: a point with little parallax is sent anywhere by a linear step."""
    rng = np.random.default_rng(2)
    state, still = sampled_state(rng), np.zeros(Layout(K).size)
    rays = state.points_enu_m - state.centres_enu_m.mean(axis=0)
    distance = np.linalg.norm(rays, axis=1)
    for share in (1e-3, 0.1, 1.0, 30.0):
        step = share * distance[:, None] * rng.standard_normal((P, 3))
        moved = state.retract(still, step).points_enu_m - state.centres_enu_m.mean(axis=0)
        along = np.einsum("pi,pi->p", moved, rays) / distance**2
        assert np.all((along > 0.0) & (along < 2.001)), share
    # Along its ray it goes by the inverse distance, and with the views as they turn.
    moved = state.retract(still, 0.2 * rays).points_enu_m - state.centres_enu_m.mean(axis=0)
    assert 1.0 / np.linalg.norm(moved, axis=1) == pytest.approx(0.8 / distance)
    turn = np.array([0.3, -0.2, 0.5])
    still[Layout(K).rotations()] = -np.einsum("kij,j->ki", state.R_cam_enu, turn)
    moved = state.retract(still, np.cross(turn, rays))
    before, after = (s.R_cam_enu @ (s.points_enu_m - s.centres_enu_m.mean(axis=0)).T for s in (state, moved))
    assert after == pytest.approx(before)


def test_a_range_measures_the_height_over_the_plane_where_its_beam_ends() -> None:
    """A camera 100 m over a slope of 10 %, beam forward-down: the plane is 4 m higher where the beam ends."""
    prior = RangePrior(Layout(1), np.array([0]), np.array([[40.0, 0.0, -96.0]]), np.array([2.0]), np.zeros(3))
    centres = np.array([[0.0, 0.0, 100.0]])
    state = State(np.eye(3)[None], centres, np.zeros((0, 3)), np.zeros(STATES), np.array([0.0, 0.1, 0.0]))
    assert prior.evaluate(state)[0] == pytest.approx([0.0], abs=1e-12)
    higher = replace(state, centres_enu_m=centres + [0.0, 0.0, 3.0])
    assert prior.evaluate(higher)[0] == pytest.approx([1.5], abs=1e-12)
