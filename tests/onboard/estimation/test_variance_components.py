"""The size of the sensors' errors, estimated from residuals: right on average, from either side, never below 1."""

import itertools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from contract.rotations import exp_so3
from onboard.estimation.factors import (
    AttitudePrior,
    Layout,
    PositionPrior,
    Prior,
    State,
    VelocityPrior,
    gauss_markov_covariance,
    whitener_of,
)
from onboard.estimation.platform_states import STATES
from onboard.estimation.sensor_table import BY_NAME, CLAIMED, HEADING, PARTS, POSITION, TILT, VELOCITY
from onboard.estimation.variance_components import MEMORY_S, PRIOR_COUNT, Evidence, VarianceFactors, evidence_of

Array = NDArray[np.float64]
K = 10
LAYOUT = Layout(K)
STAMPS_S = np.arange(K) * 1.0
SLOW_M, WHITE_M, SLOW_RAD, WHITE_RAD, VELOCITY_M_S = 1.5, 0.3, 0.01, 0.002, 0.1
WANDER_S, ATTITUDE_S, VELOCITY_S = 20.0, 8.0, 8.0
STATE = State(np.stack([np.eye(3)] * K), np.zeros((K, 3)), np.zeros((0, 3)), np.zeros(STATES), np.zeros(3))
T_NS = 1_000_000_000
TILT_WHITE, HEADING_WHITE = BY_NAME[TILT].white, BY_NAME[HEADING].white


def error(rng: np.random.Generator, covariance: Array) -> Array:
    return np.asarray(np.linalg.cholesky(covariance) @ rng.standard_normal(len(covariance)))


def position(rng: np.random.Generator, variance: float, scale: float) -> tuple[Prior, Array]:
    """Positions whose Gauss-Markov part has `variance` times its configured variance, weighted by `scale` times it."""
    slow, white = gauss_markov_covariance(STAMPS_S, SLOW_M, WANDER_S), WHITE_M**2 * np.eye(K)
    off = np.stack([error(rng, variance * slow + white) for _ in range(3)], axis=1)
    parts: dict[str, Array] = {POSITION: scale * slow}
    W = np.stack([whitener_of(scale * slow + white)] * 3)
    prior = PositionPrior(LAYOUT, off, np.zeros((K, 3)), W, np.zeros(K), parts=(parts, parts, parts))
    return prior, LAYOUT.centres()


def velocity(rng: np.random.Generator, variance: float, scale: float) -> tuple[Prior, Array]:
    slow = gauss_markov_covariance(0.5 * (STAMPS_S[1:] + STAMPS_S[:-1]), VELOCITY_M_S, VELOCITY_S)
    white = VELOCITY_M_S**2 * np.eye(K - 1)
    off = np.stack([error(rng, variance * slow + white) for _ in range(3)], axis=1)
    parts: dict[str, Array] = {VELOCITY: scale * slow}
    W = np.stack([whitener_of(scale * slow + white)] * 3)
    none = np.zeros((K - 1, 3))
    return VelocityPrior(LAYOUT, off, none, W, np.zeros(K - 1), parts=(parts, parts, parts)), LAYOUT.centres()


def attitude(rng: np.random.Generator, variance: float, scale: float) -> tuple[Prior, Array]:
    slow, white = gauss_markov_covariance(STAMPS_S, SLOW_RAD, ATTITUDE_S), WHITE_RAD**2 * np.eye(K)
    off = np.stack([error(rng, variance * slow + white) for _ in range(3)], axis=1)
    tilt: dict[str, Array] = {TILT: scale * slow, TILT_WHITE: white}
    heading: dict[str, Array] = {HEADING: scale * slow, HEADING_WHITE: white}
    W = np.stack([whitener_of(scale * slow + white)] * 3)
    still = np.zeros((K, 3))
    prior = AttitudePrior(LAYOUT, exp_so3(off), still, W, np.zeros(K), parts=(tilt, tilt, heading))
    return prior, LAYOUT.rotations()


SENSORS = {POSITION: position, VELOCITY: velocity, TILT: attitude, HEADING: attitude}
Make = Callable[[np.random.Generator, float, float], tuple[Prior, Array]]


def window(make: Make, rng: np.random.Generator, variance: float, used: VarianceFactors, name: str) -> Evidence:
    """A window fitted by least squares with pictures that know each unknown to a tenth of the sensor's sigma."""
    prior, columns = make(rng, variance, used.of(name))
    r, J = prior.evaluate(STATE)
    known = np.full(LAYOUT.size, 1e-9)
    free = columns.ravel()
    known[free] = 0.1 * (SLOW_RAD if isinstance(prior, AttitudePrior) else SLOW_M)
    if isinstance(prior, VelocityPrior):
        known[free] = 0.1 * VELOCITY_M_S
    pictures = known * rng.standard_normal(LAYOUT.size) * (known > 1e-8)
    covariance = np.linalg.inv(J.T @ J + np.diag(known**-2))
    step = covariance @ (-(J.T @ r) + pictures / known**2)
    fitted = STATE.retract(step, np.zeros((0, 3)))
    return evidence_of([prior], fitted, covariance, used)


@pytest.mark.parametrize("variance", [1.0, 4.0, 9.0])
@pytest.mark.parametrize("name", SENSORS)
def test_the_estimate_converges_to_the_factor_that_was_drawn(name: str, variance: float) -> None:
    """From factors of 1, window by window, each weighted by what those before it found."""
    rng = np.random.default_rng([7, *name.encode()])
    factors, k = VarianceFactors(), 0
    while factors.expected.get(name, 0.0) < 400.0:
        evidence = window(SENSORS[name], rng, variance, factors, name)
        factors, k = factors.with_evidence(evidence, T_NS + k), k + 1  # at one time: nothing is forgotten
        assert k < 2000
    scatter = np.sqrt(2.0 / factors.expected[name])
    found = (PRIOR_COUNT + factors.found[name]) / (PRIOR_COUNT + factors.expected[name])
    # The first windows are weighted by too small a variance and may say a little too much.
    assert abs(found / variance - 1.0) < 3.0 * scatter + 0.02
    assert factors.of(name) == (max(found, 1.0) if name in CLAIMED else found)


@pytest.mark.parametrize("name", SENSORS)
def test_the_expectation_is_what_residuals_come_to(name: str) -> None:
    """(13.1): drawn as believed, found over expected is 1, whatever share of the residuals the pictures decide."""
    rng = np.random.default_rng([8, *name.encode()])
    used = VarianceFactors()
    believed = used.of(name)
    evidence = [window(SENSORS[name], rng, believed, used, name) for _ in range(300)]
    found, expected = (sum(getattr(e, kind)[name] for e in evidence) for kind in ("found", "expected"))
    assert abs(found / believed / expected - 1.0) < 4.0 * np.sqrt(2.0 / expected)


@pytest.mark.parametrize("name", sorted(CLAIMED))
def test_a_sensor_better_than_its_claim_counts_as_claimed(name: str) -> None:
    """What turns and legs show within a window does not bound an error that lasts for minutes: the claim does."""
    rng = np.random.default_rng([9, *name.encode()])
    factors = VarianceFactors()
    for k in range(30):
        factors = factors.with_evidence(window(SENSORS[name], rng, 0.1, factors, name), T_NS + k)
        assert factors.of(name) >= 1.0
    assert factors.of(name) < 1.05
    assert all(VarianceFactors().of(n) == 1.0 for n in PARTS)


@pytest.mark.parametrize("name", sorted(set(SENSORS) - CLAIMED))
def test_a_sensor_without_a_claim_counts_for_as_little_as_the_flight_shows(name: str) -> None:
    """Sampled with a tenth of the configured variance: never below a tenth, and from above towards it."""
    rng = np.random.default_rng([9, *name.encode()])
    factors, found = VarianceFactors(), []
    while factors.expected.get(name, 0.0) < 400.0:
        factors = factors.with_evidence(window(SENSORS[name], rng, 0.1, factors, name), T_NS + len(found))
        found.append(factors.of(name))
        assert len(found) < 2000
    assert 0.5 < found[0] < 0.7  # one window: what is configured counts as much
    assert all(later < earlier for earlier, later in itertools.pairwise(found[::10]))
    assert 0.1 < found[-1] < 0.2


def test_one_odd_window_is_not_believed_as_much_as_many() -> None:
    """PRIOR_COUNT measurements as declared stand against it: five of nine times the variance say 3.7, not 9."""
    once = VarianceFactors().with_evidence(Evidence({HEADING: 45.0}, {HEADING: 5.0}), T_NS)
    assert once.of(HEADING) == pytest.approx((PRIOR_COUNT + 45.0) / (PRIOR_COUNT + 5.0))
    often = once
    for k in range(60):
        often = often.with_evidence(Evidence({HEADING: 45.0}, {HEADING: 5.0}), T_NS + k)
    assert 2.0 < once.of(HEADING) < 7.0
    assert 8.5 < often.of(HEADING) < 9.0
    assert often.of(TILT) == 1.0


def test_what_was_found_is_forgotten_over_minutes() -> None:
    old = VarianceFactors().with_evidence(Evidence({TILT: 90.0}, {TILT: 10.0}), T_NS)
    later = T_NS + round(MEMORY_S * 1e9)
    faded = old.with_evidence(Evidence({TILT: 10.0}, {TILT: 10.0}), later)
    assert faded.found[TILT] == pytest.approx(90.0 / np.e + 10.0)
    assert faded.expected[TILT] == pytest.approx(10.0 / np.e + 10.0)
    assert old.with_evidence(Evidence(), later).of(TILT) < old.of(TILT)


def test_a_prior_without_parts_says_nothing() -> None:
    prior, _ = attitude(np.random.default_rng(0), 9.0, 1.0)
    assert isinstance(prior, AttitudePrior)
    evidence = evidence_of([replace(prior, parts=())], STATE, np.zeros((LAYOUT.size,) * 2), VarianceFactors())
    assert evidence.found == {} and evidence.expected == {}
