"""A sensor that contradicts all others is found, by name, counts for little, and is heard again."""

from collections.abc import Mapping

import numpy as np
import pytest
from numpy.typing import NDArray

from contract.rotations import exp_so3, log_so3
from onboard.estimation.factors import (
    AttitudePrior,
    Layout,
    Parts,
    PositionPrior,
    Prior,
    State,
    VelocityPrior,
    gauss_markov_covariance,
    whitener_of,
)
from onboard.estimation.platform_states import STATES
from onboard.estimation.sensor_groups import FADING_S, Failing, Innovation, contradictions, failing_groups, innovations
from onboard.estimation.sensor_table import HEADING, POSITION, SENSORS, TILT, VELOCITY
from onboard.navigation.limits import FALSE_ALARM

Array = NDArray[np.float64]
GROUPS = tuple(s.name for s in SENSORS)
MAY_FAIL = tuple(s.name for s in SENSORS if s.may_fail)
K = 10
LAYOUT = Layout(K)
STAMPS_S = np.arange(K) * 1.0
STATE = State(np.stack([np.eye(3)] * K), np.zeros((K, 3)), np.zeros((0, 3)), np.zeros(STATES), np.zeros(3))
SIGMA = {POSITION: 1.5, VELOCITY: 0.1, TILT: 0.01, HEADING: 0.035}
SECOND_NS = 1_000_000_000
HALF = np.repeat([0.0, 1.0], K // 2)


def covariance_of(group: str, n: int) -> Array:
    slow = gauss_markov_covariance(STAMPS_S[:n], SIGMA[group], 20.0 if group != POSITION else 60.0)
    return slow + (0.2 * SIGMA[group]) ** 2 * np.eye(n)


def drawn(rng: np.random.Generator, group: str, n: int) -> Array:
    return np.asarray(np.linalg.cholesky(covariance_of(group, n)) @ rng.standard_normal(n))


class Window:
    """Three sensors and pictures that know how the views moved and turned against each other; one sensor may be wrong.

    `fault` is added to a group's measurements: (n,) along its first axis.
    """

    def __init__(self, seed: int, group: str = "", fault: Array | None = None) -> None:
        rng = np.random.default_rng([seed, 5])
        errors = {
            POSITION: np.stack([drawn(rng, POSITION, K) for _ in range(3)], axis=1),
            VELOCITY: np.stack([drawn(rng, VELOCITY, K - 1) for _ in range(3)], axis=1),
        }
        turned = np.stack([drawn(rng, g, K) for g in (TILT, TILT, HEADING)], axis=1)
        if fault is not None and group in errors:
            errors[group][:, 0] += fault
        elif fault is not None:
            turned[:, 0 if group == TILT else 2] += fault
        self._errors, self._turned = errors, turned
        # Relative motion to a decimetre and 0.05 degrees, scale left open: between neighbours, level.
        rows = []
        for k in range(K - 1):
            for axis in range(3):
                row = np.zeros((2, LAYOUT.size))
                row[0, [LAYOUT.rotations()[k, axis], LAYOUT.rotations()[k + 1, axis]]] = [-1e3, 1e3]
                row[1, [LAYOUT.centre(k).start + axis, LAYOUT.centre(k + 1).start + axis]] = [-10.0, 10.0]
                rows.append(row)
        self._pictures = np.concatenate(rows)
        self._noise = rng.standard_normal(len(self._pictures))

    def priors(self, factors: Mapping[str, float]) -> list[Prior]:
        def whitener(group: str, n: int) -> Array:
            return whitener_of(factors.get(group, 1.0) * covariance_of(group, n))

        still = np.zeros((K, 3))
        none: Parts = ({}, {}, {})  # no variance is estimated
        position, velocity = np.stack([whitener(POSITION, K)] * 3), np.stack([whitener(VELOCITY, K - 1)] * 3)
        attitude = np.stack([whitener(g, K) for g in (TILT, TILT, HEADING)])
        return [
            PositionPrior(LAYOUT, self._errors[POSITION], still, position, np.zeros(K), parts=none),
            VelocityPrior(LAYOUT, self._errors[VELOCITY], still[1:], velocity, np.zeros(K - 1), parts=none),
            AttitudePrior(LAYOUT, exp_so3(self._turned), still, attitude, np.zeros(K), parts=none),
        ]

    def solve(self, factors: Mapping[str, float]) -> list[Innovation]:
        priors, state = self.priors(factors), STATE
        for _ in range(3):
            parts = [p.evaluate(state) for p in priors]
            J = np.concatenate([j for _, j in parts] + [self._pictures])
            moved = self._pictures @ np.concatenate([self._moved(state), np.zeros(11)])
            r = np.concatenate([r for r, _ in parts] + [moved + self._noise])
            held = np.zeros(LAYOUT.size)
            held[6 * K :] = 1e9  # nothing else is estimated
            covariance = np.linalg.inv(J.T @ J + np.diag(held))
            state = state.retract(-covariance @ (J.T @ r), np.zeros((0, 3)))
        return innovations(priors, state, covariance, factors)

    @staticmethod
    def _moved(state: State) -> Array:
        return np.concatenate([log_so3(state.R_cam_enu), state.centres_enu_m], axis=1).ravel()

    def failing(self, held: Mapping[str, float]) -> tuple[dict[str, float], set[str]]:
        return failing_groups(self.solve(held), self.solve, held)


FAULTS = {
    POSITION: 25.0 * HALF,
    VELOCITY: 3.0 * HALF[1:],
    TILT: np.radians(5.0) * HALF,
    HEADING: np.radians(40.0) * HALF,
}


def test_sensors_that_err_as_believed_are_never_held_to_fail() -> None:
    excess = [i.excess() for seed in range(60) for i in Window(seed).solve({})]
    assert max(excess) < 1.0
    assert max(excess) > 0.2, "a test that nothing comes near has no power"


def test_innovations_have_the_covariance_that_is_claimed() -> None:
    """Mean of squares over their count: one, group by group."""
    for group in GROUPS:
        squares = []
        for seed in range(40):
            i = next(i for i in Window(seed).solve({}) if i.group == group)
            n = len(i.residual)
            squares.append(float(i.residual @ np.linalg.solve(i.predicted + np.eye(n), i.residual)) / n)
        assert 0.5 < np.mean(squares) < 1.3, group  # what no other sensor sees counts as nothing


@pytest.mark.parametrize("group", MAY_FAIL)
def test_the_one_that_is_wrong_is_found_and_no_other(group: str) -> None:
    for seed in range(5):
        window = Window(seed, group, FAULTS[group])
        factors, failed = window.failing({})
        assert failed == {group} == set(factors)
        assert factors[group] > 4.0
        left = [i for i in window.solve(factors) if i.group != group]
        assert not contradictions(left), "the others are still pulled"


def test_it_fails_for_as_long_as_it_is_wrong_and_is_heard_again_after() -> None:
    failing = Failing()
    for k in range(8):
        begin_ns = k * 5 * SECOND_NS
        wrong = k in (2, 3)
        held = failing.factors(begin_ns)
        factors, failed = Window(k, TILT, FAULTS[TILT] if wrong else None).failing(held)
        assert (TILT in failed) == wrong
        failing = failing.after(begin_ns, begin_ns + 10 * SECOND_NS, {n: factors[n] for n in failed})
        assert failing.fails_at(begin_ns + 10 * SECOND_NS) == wrong
    assert failing.windows == {TILT: 2}
    last = failing.failures[TILT]
    assert (last.last_ns - last.since_ns) == 5 * SECOND_NS
    at = [failing.factors(last.last_ns + round(s * 1e9))[TILT] for s in (0.0, FADING_S, 20 * FADING_S)]
    assert at[0] == last.variance
    assert at[1] == pytest.approx(1.0 + (at[0] - 1.0) / np.e)
    assert at[2] == pytest.approx(1.0, abs=1e-3)
    later_ns = last.last_ns + round(20 * FADING_S * 1e9)
    assert failing.after(later_ns, later_ns + SECOND_NS, {}).factors(later_ns) == {}


@pytest.mark.parametrize("group", [POSITION, VELOCITY])
def test_what_contradicts_position_or_velocity_excuses_no_sensor(group: str) -> None:
    """It may be the pictures that are wrong, over a convoy: that the window's residuals must show."""
    window = Window(1, group, FAULTS[group])
    assert group in {i.group for i in contradictions(window.solve({}))}
    assert window.failing({}) == ({}, set())


def test_the_quantile_is_that_of_one_false_alarm_in_a_million() -> None:
    assert FALSE_ALARM == 1e-6
    one = Innovation(TILT, np.array([4.8, 0.0]), np.zeros((2, 2)), np.ones((2, 1)))
    assert one.excess() < 1.0 < Innovation(TILT, np.array([5.3, 0.0]), np.zeros((2, 2)), np.ones((2, 1))).excess()
    assert one.consistent_variance() >= 1.0


def test_a_variance_known_by_few_measurements_is_contradicted_by_larger_errors_only() -> None:
    """Errors of a variance known by so few measurements raise no more alarms than those of a known one."""
    rng, count, n = np.random.default_rng(5), 10.0, 8
    constant: Array = np.kron(np.eye(2), np.ones((n // 2, 1))).astype(np.float64)
    alarms = {count: 0, np.inf: 0}
    for _ in range(2000):
        residual: Array = rng.standard_normal(n) * float(np.sqrt(count / rng.chisquare(count)))
        for known_by in alarms:
            found = Innovation(TILT, residual, np.zeros((n, n)), constant, known_by)
            alarms[known_by] += found.excess() > 1.0
    assert alarms[count] <= 1
    assert alarms[np.inf] >= 2
    gross = Innovation(TILT, np.full(n, 12.0), np.zeros((n, n)), constant, count)
    assert gross.excess() > 1.0
