"""Which residuals a window gets: what the configuration asks for and the data can give, each as wide as declared."""

from dataclasses import replace

import numpy as np
import pytest

from contract.rotations import exp_so3, log_so3, mount_rotation
from onboard.config.schema import Config, parse_config
from onboard.estimation.boresight import PlatformEstimate
from onboard.estimation.factors import AttitudePrior, Layout, PositionPrior, Prior, SharedPrior, State, VelocityPrior
from onboard.estimation.ground_slope import SlopePrior
from onboard.estimation.keyframe import Keyframe
from onboard.estimation.platform_states import DELAY, STATES, VELOCITY_DELAY
from onboard.estimation.sensor_factors import Sensors, shared_prior
from onboard.estimation.variance_components import VarianceFactors
from tests.onboard.scenes import FULL, Scene, SceneSpec, draw

PLATFORM = PlatformEstimate(
    0,
    np.array([0.01, -0.02, 0.005, 0.03, 0.06, -0.04, 0.02, -0.01]),
    np.diag([1e-4, 1e-4, 4e-4, 1e-2, 4e-4, 4e-2, 1e-4, 4e-4]),
)
CALM = SceneSpec(keyframes=6, error_scale=0.0, pixel_sigma_px=0.0)
JITTER_S = 0.003


@pytest.fixture(scope="module")
def scene() -> Scene:
    return draw(np.random.default_rng(0), spec=CALM)


def keyframes_of(scene: Scene) -> list[Keyframe]:
    return scene.window().keyframes


def priors_of(
    config: Config, keyframes: list[Keyframe], has_terrain: bool = False, factors: VarianceFactors | None = None
) -> dict[type, Prior]:
    mount = config.mount
    R_body_cam = mount_rotation(mount.roll_deg, mount.pitch_deg, mount.yaw_deg)
    layout = Layout(len(keyframes))
    found = VarianceFactors() if factors is None else factors
    sensors = Sensors(config, R_body_cam, keyframes, layout, found, JITTER_S)
    return {type(p): p for p in sensors.priors(PLATFORM, has_terrain)}


def truth_of(scene: Scene) -> State:
    keys = scene.keys
    return State(
        scene.R_cam_enu[keys], scene.centres_enu_m[keys], scene.points_enu_m,
        np.array([*scene.boresight_rad, scene.offset_s, 0.0, 0.0, 0.0, 0.0]), np.zeros(3),
    )  # fmt: skip


def test_the_full_set_has_position_velocity_attitude_and_what_is_shared(scene: Scene) -> None:
    priors = priors_of(FULL, keyframes_of(scene))
    assert set(priors) == {PositionPrior, VelocityPrior, AttitudePrior, SharedPrior}


def test_at_the_truth_of_a_flight_without_errors_every_sensor_agrees(scene: Scene) -> None:
    truth = truth_of(scene)
    for kind, prior in priors_of(FULL, keyframes_of(scene)).items():
        if kind is not SharedPrior:
            assert np.abs(prior.evaluate(truth)[0]).max() < 1e-3, kind


def test_velocity_takes_part_only_where_asked_for_and_known(scene: Scene) -> None:
    keyframes = keyframes_of(scene)
    assert VelocityPrior not in priors_of(parse_config("[solve]\nvelocity = false"), keyframes)
    unknown = [replace(k, displacement=None) for k in keyframes]
    assert VelocityPrior not in priors_of(FULL, unknown)
    broken = [*keyframes[:3], replace(keyframes[3], displacement=None), *keyframes[4:]]
    whole, gap = (priors_of(FULL, k)[VelocityPrior] for k in (keyframes, broken))
    assert isinstance(whole, VelocityPrior) and isinstance(gap, VelocityPrior)
    # What displacements say of the views' centres: nothing over the gap, all of it over the other intervals.
    reported = [p.evaluate(truth_of(scene))[1] for p in (whole, gap)]
    over_gap = np.zeros(reported[0].shape[1])
    over_gap[whole.layout.centre(3).start :: 6][: len(keyframes) - 3] = 1.0  # all centres after the gap moved east
    assert np.linalg.norm(reported[0] @ over_gap) > 1.0 > 1e3 * np.linalg.norm(reported[1] @ over_gap)
    elsewhere = np.zeros(reported[0].shape[1])
    elsewhere[whole.layout.centre(5).start] = 1.0
    assert np.linalg.norm(reported[1] @ elsewhere) > 0.8 * np.linalg.norm(reported[0] @ elsewhere)
    first = [replace(keyframes[0], displacement=None), *keyframes[1:]]
    assert VelocityPrior in priors_of(FULL, first)


@pytest.mark.parametrize("claim_m_s", [0.0, 0.4])
def test_a_constant_error_of_velocity_weighs_as_much_as_the_receiver_claims(scene: Scene, claim_m_s: float) -> None:
    """Chi-square of a velocity that is off by 0.4 m/s all along: a few where so much is claimed, hundreds where not."""
    keyframes = [replace(k, nav=replace(k.nav, sigma_velocity_m_s=claim_m_s)) for k in keyframes_of(scene)]
    prior = priors_of(FULL, keyframes)[VelocityPrior]
    assert isinstance(prior, VelocityPrior)
    stamps_s = np.array([k.nav.stamp_ns for k in keyframes]) / 1e9
    whitened = prior.whitener[0] @ (0.4 * np.diff(stamps_s))
    chi2 = float(whitened @ whitened)
    assert (0.5 < chi2 < 3.0) if claim_m_s else chi2 > 30.0


def test_without_attitude_a_weak_belief_in_level_flight_along_the_path_stands_in(scene: Scene) -> None:
    blind = [replace(k, nav=replace(k.nav, R_enu_body=None)) for k in keyframes_of(scene)]
    strong, weak = (priors_of(FULL, k)[AttitudePrior] for k in (keyframes_of(scene), blind))
    assert isinstance(strong, AttitudePrior) and isinstance(weak, AttitudePrior)
    off = log_so3(strong.measured.transpose(0, 2, 1) @ weak.measured)
    assert np.degrees(np.linalg.norm(off, axis=1)).max() < 6.0
    turned = replace(truth_of(scene), R_cam_enu=exp_so3(np.array([0.1, 0.0, 0.0])) @ truth_of(scene).R_cam_enu)
    costs = [float(np.sum(p.evaluate(turned)[0] ** 2)) for p in (strong, weak)]
    assert costs[0] > 20.0 * costs[1] > 0.0


def test_a_vehicle_that_hardly_moves_has_no_belief_from_its_path(scene: Scene) -> None:
    slow = [
        replace(k, nav=replace(k.nav, R_enu_body=None, velocity_enu_m_s=np.array([0.3, 0.0, 0.0])))
        for k in keyframes_of(scene)
    ]
    assert AttitudePrior not in priors_of(FULL, slow)


def test_a_keyframe_without_attitude_shows_nothing_and_those_about_it_do(scene: Scene) -> None:
    keyframes = keyframes_of(scene)
    keyframes[2] = replace(keyframes[2], nav=replace(keyframes[2].nav, R_enu_body=None))
    full, gap = priors_of(FULL, keyframes_of(scene))[AttitudePrior], priors_of(FULL, keyframes)[AttitudePrior]
    assert isinstance(full, AttitudePrior) and isinstance(gap, AttitudePrior)
    known, left = (np.einsum("aji,aji->ai", p.whitener, p.whitener) for p in (full, gap))
    assert left[:, 2].max() < 1e-4
    about = np.delete(left / known, 2, axis=1)
    assert about.min() > 0.5 and about.max() < 1.01


def test_a_common_shift_costs_what_the_wandering_sigma_says(scene: Scene) -> None:
    """All positions off by the Gauss-Markov sigma: one sigma if the correlation outlasts the window, a little more."""
    prior = priors_of(FULL, keyframes_of(scene))[PositionPrior]
    truth = truth_of(scene)
    for axis, sigma in ((0, 1.5), (2, 2.5)):
        moved = replace(truth, centres_enu_m=truth.centres_enu_m + sigma * np.eye(3)[axis])
        cost = float(np.sum(prior.evaluate(moved)[0] ** 2) - np.sum(prior.evaluate(truth)[0] ** 2))
        assert 0.85 < cost < 1.3


def test_the_receivers_claim_widens_the_position(scene: Scene) -> None:
    keyframes = keyframes_of(scene)
    claimed = [replace(k, nav=replace(k.nav, sigma_horizontal_m=6.0)) for k in keyframes]
    truth = truth_of(scene)
    moved = replace(truth, centres_enu_m=truth.centres_enu_m + [6.0, 0.0, 0.0])
    near, wide = (
        float(np.sum(priors_of(FULL, k)[PositionPrior].evaluate(moved)[0] ** 2)) for k in (keyframes, claimed)
    )
    assert near > 10.0 * wide
    assert 0.8 < wide < 1.4


@pytest.mark.parametrize("sensor", [PositionPrior, VelocityPrior, AttitudePrior])
def test_in_straight_flight_errors_have_the_covariance_that_is_declared(scene: Scene, sensor: type[Prior]) -> None:
    """Written down here from the configuration, (5.5) to (5.7): no whitener of the modules has a part in it."""
    config = parse_config(
        "[gps]\nsigma_velocity_m_s = 0.3\nsigma_velocity_correlated_m_s = 0.2\nvelocity_correlation_time_s = 7.0\n"
        "correlation_time_s = 5.0\n[solve]\nattitude_correlation_time_s = 3.0\n"
        "attitude_sigma_deg = 0.7\nattitude_white_sigma_deg = 0.4\n"
        "heading_sigma_deg = 2.0\nheading_white_sigma_deg = 1.0\n"
    )
    velocity = np.array([20.0, 0.0, 0.0])
    keyframes = [
        replace(
            k,
            nav=replace(k.nav, velocity_enu_m_s=velocity, stamp_ns=3 * k.nav.stamp_ns // 2),  # intervals of no second
            body_rate_rad_s=np.zeros(3),
        )
        for k in keyframes_of(scene)
    ]
    nav, stamps_s = keyframes[0].nav, np.array([k.nav.stamp_ns for k in keyframes]) / 1e9
    early_m = JITTER_S * 20.0
    if sensor is VelocityPrior:
        apart_s = np.diff(stamps_s)
        slow, white = 0.2 * apart_s, 0.3 * np.sqrt(apart_s * np.minimum(apart_s, 1.0))
        parts = [(slow, np.hypot(white, np.sqrt(2.0) * early_m))] * 3
        stamps_s, time_s = 0.5 * (stamps_s[1:] + stamps_s[:-1]), 7.0
    elif sensor is PositionPrior:
        level, white, time_s = nav.sigma_horizontal_m, nav.sigma_white_m, 5.0
        parts = [(level, np.hypot(white, early_m)), (level, white), (nav.sigma_vertical_m, 1.5 * white)]
    else:
        parts, time_s = [*[tuple(np.radians([0.7, 0.4]))] * 2, tuple(np.radians([2.0, 1.0]))], 3.0
    prior = priors_of(config, keyframes)[sensor]
    decay = np.exp(-np.abs(stamps_s[:, None] - stamps_s) / time_s)
    for W, (slow, white) in zip(prior.whitener, parts, strict=True):
        declared = np.outer(ones := np.ones(len(W)) * slow, ones) * decay + np.diag((np.ones(len(W)) * white) ** 2)
        np.testing.assert_allclose(np.linalg.inv(W.T @ W), declared, rtol=1e-6)


def shared_sigmas(prior: Prior) -> np.ndarray:
    assert isinstance(prior, SharedPrior)
    return np.sqrt(np.diag(np.linalg.inv(prior.whitener.T @ prior.whitener)))


def test_what_is_shared_is_believed_as_learned_and_configured(scene: Scene) -> None:
    prior = priors_of(FULL, keyframes_of(scene))[SharedPrior]
    assert isinstance(prior, SharedPrior)
    assert np.all(prior.mean[:STATES] == PLATFORM.mean)
    sigmas = shared_sigmas(prior)
    delays = [DELAY, VELOCITY_DELAY]
    others = np.delete(np.arange(STATES), delays)
    assert sigmas[others] == pytest.approx(PLATFORM.sigma[others])
    assert sigmas[STATES] > 1e3
    assert sigmas[STATES + 1 :] == pytest.approx(np.tan(np.radians(FULL.solve.level_ground_sigma_deg)))


def test_estimates_keep_their_correlations_as_priors(scene: Scene) -> None:
    """Correlations of the platform's states, and of the slope's east and north, are those of the estimates."""
    root = np.tril(np.random.default_rng(1).normal(0.0, 0.01, (STATES, STATES))) + 0.05 * np.eye(STATES)
    slope = SlopePrior(covariance=np.array([[4e-4, 3e-4], [3e-4, 9e-4]]))
    platform = PlatformEstimate(0, PLATFORM.mean, root @ root.T)
    config = parse_config("[gps]\nsigma_latency_s = 0.0")
    prior = shared_prior(config, Layout(6), platform, has_terrain=False, slope=slope)
    accepted = np.linalg.inv(prior.whitener.T @ prior.whitener)
    np.testing.assert_allclose(accepted[:STATES, :STATES], platform.covariance, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(accepted[STATES + 1 :, STATES + 1 :], slope.covariance, rtol=1e-9)
    assert np.sqrt(accepted[STATES, STATES]) == pytest.approx(1e4)


def test_no_delay_is_surer_than_declared_however_sure_turns_make_it(scene: Scene) -> None:
    """(5.15): what turns show is kept as the mean; the sigma is the declared one, or the belief's if that is more."""
    assert PLATFORM.sigma[DELAY] < FULL.gps.sigma_latency_s < PLATFORM.sigma[VELOCITY_DELAY]
    sigmas = shared_sigmas(priors_of(FULL, keyframes_of(scene))[SharedPrior])
    assert sigmas[DELAY] == pytest.approx(FULL.gps.sigma_latency_s)
    assert sigmas[VELOCITY_DELAY] == pytest.approx(PLATFORM.sigma[VELOCITY_DELAY])
    sure = shared_sigmas(priors_of(parse_config("[gps]\nsigma_latency_s = 0.0"), keyframes_of(scene))[SharedPrior])
    assert sure[[DELAY, VELOCITY_DELAY]] == pytest.approx(PLATFORM.sigma[[DELAY, VELOCITY_DELAY]])


def test_ground_not_reported_to_be_level_may_slope_and_terrain_may_not(scene: Scene) -> None:
    keyframes = keyframes_of(scene)
    free = shared_sigmas(priors_of(parse_config("[solve]\nlevel_ground = false"), keyframes)[SharedPrior])
    known = shared_sigmas(priors_of(FULL, keyframes, has_terrain=True)[SharedPrior])
    assert free[STATES + 1 :].min() > 1.0
    over_300_m = 300.0 * known[STATES + 1 :]  # neighbouring heights of an elevation model are off together
    assert 1.0 < over_300_m.min() <= over_300_m.max() < 2.5
    assert known[STATES] == pytest.approx(FULL.terrain.sigma_datum_m, abs=0.01)


def heading_sigma_deg(keyframes: list[Keyframe], config: Config = FULL) -> float:
    prior = priors_of(config, keyframes)[AttitudePrior]
    assert isinstance(prior, AttitudePrior)
    whitener = prior.whitener[2]
    return float(np.degrees(np.sqrt(np.linalg.inv(whitener.T @ whitener)[-1, -1])))


def in_a_turn(keyframes: list[Keyframe], course_rad_s: float, yaw_rad_s: float) -> list[Keyframe]:
    """The same keyframes with velocities that turn, of a vehicle that itself turns about the vertical."""
    out = []
    for k in keyframes:
        angle = course_rad_s * (k.nav.stamp_ns - keyframes[0].nav.stamp_ns) / 1e9
        nav = replace(k.nav, velocity_enu_m_s=20.0 * np.array([np.cos(angle), np.sin(angle), 0.0]))
        rate = k.nav.R_enu_body.T @ np.array([0.0, 0.0, yaw_rad_s])
        out.append(replace(k, nav=nav, body_rate_rad_s=rate))
    return out


def test_heading_is_less_sure_in_turns_by_what_a_late_filter_turns_late(scene: Scene) -> None:
    """(5.23): by the declared delay times the rate of the course, not on straight legs or when yawing on the spot."""
    keyframes = keyframes_of(scene)
    level = heading_sigma_deg(in_a_turn(keyframes, 0.0, 0.0))
    turning = heading_sigma_deg(in_a_turn(keyframes, 0.2, 0.2))
    added = np.sqrt(turning**2 - level**2)
    assert added == pytest.approx(np.degrees(FULL.gps.sigma_latency_s * 0.2), rel=0.1)
    assert heading_sigma_deg(in_a_turn(keyframes, 0.0, 0.2)) == pytest.approx(level, rel=1e-3)
    assert heading_sigma_deg(in_a_turn(keyframes, 0.2, 0.0)) == pytest.approx(level, rel=1e-3)
    in_time = parse_config("[gps]\nsigma_latency_s = 0.0")
    assert heading_sigma_deg(in_a_turn(keyframes, 0.2, 0.2), in_time) == pytest.approx(level, rel=1e-3)


def test_a_course_that_shakes_to_and_fro_is_no_turn(scene: Scene) -> None:
    """Noise of velocities and of angular rates on a straight leg: what it turns one way it turns back."""
    keyframes = keyframes_of(scene)
    level, out = heading_sigma_deg(in_a_turn(keyframes, 0.0, 0.0)), []
    for number, k in enumerate(keyframes):
        angle = 0.05 * (-1.0) ** number
        nav = replace(k.nav, velocity_enu_m_s=20.0 * np.array([np.cos(angle), np.sin(angle), 0.0]))
        rate = k.nav.R_enu_body.T @ np.array([0.0, 0.0, 4.0 * angle])
        out.append(replace(k, nav=nav, body_rate_rad_s=rate))
    assert heading_sigma_deg(out) < 1.02 * level
