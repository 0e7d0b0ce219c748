"""Where a click's error comes from: shares that add up, and one source of error at a time that reproduces its share."""

import time
from dataclasses import dataclass, replace
from unittest import mock

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.sampled_flight import SampledFlight, SampledSpec, SampledTracker
from contract.error_sources import ABOUT, Cause
from contract.locate import Locator
from contract.rotations import exp_so3, log_so3
from contract.wire.codec import decode, encode
from onboard.config.schema import parse_config
from onboard.estimation import second_solve, stages
from onboard.estimation.bundle_adjustment import Problem, solve
from onboard.estimation.error_budget import nearest_root, sources
from onboard.estimation.factors import AttitudePrior, PositionPrior, Prior, SharedPrior, State, VelocityPrior
from onboard.estimation.platform_states import BORESIGHT, DELAY, VELOCITY_DELAY
from onboard.estimation.sensor_table import POSITION, TILT
from onboard.estimation.solved_window import Solved
from onboard.georeferencing.click_budget import click_budget, click_terms
from onboard.georeferencing.feature_sets import Placed
from onboard.navigation.limits import LONG_NS
from onboard.pipeline.error_budgets import BudgetWatch, NewestBudget, budget_text
from onboard.pipeline.pipeline import Pipeline
from simulation.paths import PathSpec
from tests.rest_long import rest_long

Array = NDArray[np.float64]

DRAWS = 120
# Of the errors drawn against those declared: a budget is of first order, and a relief of its full size once more on
# top of the relief that is there moves the window's height by its square.
SMALL = 0.3


@dataclass(frozen=True)
class Flown:
    """The newest window of a drawn flight: its problem, its solution, and the pictures that it placed."""

    problem: Problem
    solved: Solved
    placed: list[Placed]


@pytest.fixture(scope="module")
def flown() -> Flown:
    config = parse_config("[gps]\nsigma_latency_s = 0.02")
    flight = SampledFlight(SampledSpec(config, PathSpec("turns", height_m=150.0, leg_m=150.0), seconds=14.0), 5)
    pipeline = Pipeline(config, flight.spec.camera)
    pipeline.tracker = SampledTracker(flight)
    problems: dict[int, Problem] = {}
    solve_again = stages.solve_again

    def kept(problem: Problem, *rest: object) -> second_solve.Adjusted | None:
        out = solve_again(problem, *rest)
        if out is not None:
            problems[id(out.solution)] = replace(problem, weight=out.kept / out.own)
        return out

    placed: list[Placed] = []
    pipeline.placing.watches.append(placed.append)
    with mock.patch.object(stages, "solve_again", kept):
        for event in flight.events():
            pipeline.handle(event)
        pipeline.finish()
    solved = pipeline.window.solved
    assert len(solved.keyframes) == config.solve.keyframes
    return Flown(problems[id(solved.solution)], solved, [p for p in placed if p.solved is solved])


def errors_of(name: str, problem: Problem, rng: np.random.Generator) -> Problem:
    """The problem with one draw of one source's errors in its measurements."""

    def drawn(covariance: Array) -> Array:
        values, vectors = np.linalg.eigh(covariance)
        return SMALL * (vectors * np.sqrt(np.maximum(values, 0.0))) @ rng.standard_normal(len(values))

    def by_axis(prior: PositionPrior | VelocityPrior | AttitudePrior, parts: tuple[str, ...], rest: bool) -> Array:
        """(n, 3): the named parts, or what is left of each axis's covariance without them."""
        assert prior.parts
        out = []
        for W, own in zip(prior.whitener, prior.parts, strict=True):
            whole = np.linalg.inv(W.T @ W)
            named = sum((Q for n, Q in own.items() if n in parts), np.zeros_like(whole))
            out.append(drawn(whole - named if rest else named))
        return np.stack(out, axis=1)

    def changed(prior: Prior) -> Prior:
        if isinstance(prior, PositionPrior) and name in (Cause.GPS_SLOW, Cause.GPS_WHITE):
            error = by_axis(prior, (POSITION,), name == Cause.GPS_WHITE)
            return replace(prior, measured=prior.measured + error)
        if isinstance(prior, VelocityPrior) and name == Cause.SPEED:
            whole = [drawn(np.linalg.inv(W.T @ W)) for W in prior.whitener]
            return replace(prior, measured=prior.measured + np.stack(whole, axis=1))
        if isinstance(prior, AttitudePrior) and name == Cause.ATTITUDE_SLOW:
            R = exp_so3(by_axis(prior, (TILT,), False)) @ prior.measured
            return replace(prior, measured=R)
        if isinstance(prior, SharedPrior) and name in (Cause.MOUNT, Cause.DELAYS, Cause.SLOPE):
            columns = {
                Cause.MOUNT: range(*BORESIGHT.indices(3)),
                Cause.DELAYS: (DELAY, VELOCITY_DELAY),
                Cause.SLOPE: (len(prior.mean) - 2, len(prior.mean) - 1),
            }[name]
            F = nearest_root(prior.whitener)[:, list(columns)]
            return replace(prior, mean=prior.mean + SMALL * F @ rng.standard_normal(F.shape[1]))
        return prior

    if name == Cause.PIXELS:
        noise = (
            SMALL
            * rng.standard_normal(problem.xy.shape)
            / np.where(problem.weight > 0, problem.weight, np.inf)[..., None]
        )
        return replace(problem, xy=problem.xy + noise)
    if name == Cause.RELIEF:
        assert problem.terrain is None
        return replace(
            problem, terrain=Bumps(SMALL * rng.standard_normal(problem.weight.shape[1]) / problem.ground_weight)
        )
    return replace(problem, priors=[changed(p) for p in problem.priors])


@dataclass(frozen=True)
class Bumps:
    height_m: Array

    def height_and_slope(self, xy_enu_m: Array) -> tuple[Array, Array]:
        return self.height_m, np.zeros_like(xy_enu_m)


def moved(was: State, now: State) -> Array:
    """(9,) of the newest keyframe's rotation and centre, and the ground plane."""
    turn = log_so3(now.R_cam_enu[-1] @ was.R_cam_enu[-1].T)
    return np.concatenate([turn, (now.centres_enu_m - was.centres_enu_m)[-1], now.plane - was.plane])


def gain_of(solved: Solved) -> Array:
    layout, last = solved.layout, solved.layout.keyframes - 1
    columns = [*range(6 * last, 6 * last + 6), *range(*layout.plane.indices(layout.size))]
    return np.asarray(np.eye(layout.size)[columns])


def test_sources_add_up_to_the_windows_covariance_and_none_is_negative(flown: Flown) -> None:
    gain = gain_of(flown.solved)
    terms = sources(flown.solved, gain)
    whole = gain @ flown.solved.solution.covariance @ gain.T
    scale = 1.0 / np.sqrt(np.diag(whole))
    for name, term in terms.items():
        assert np.linalg.eigvalsh(term * np.outer(scale, scale))[0] > -1e-6, name
    assert np.allclose(sum(terms.values(), np.zeros((9, 9))) * np.outer(scale, scale), whole * np.outer(scale, scale))
    assert {Cause.MOUNT, Cause.GPS_SLOW, Cause.ATTITUDE_SLOW, Cause.HEADING_NOISE, Cause.PIXELS} <= set(terms)


SOURCES = (
    Cause.GPS_SLOW,
    Cause.GPS_WHITE,
    Cause.SPEED,
    Cause.ATTITUDE_SLOW,
    Cause.MOUNT,
    Cause.DELAYS,
    Cause.SLOPE,
    Cause.RELIEF,
    Cause.PIXELS,
)


@pytest.mark.parametrize("name", rest_long(SOURCES))
def test_a_source_of_errors_alone_moves_the_window_by_its_share(flown: Flown, name: str) -> None:
    """A Monte Carlo through the adjustment itself, one source at a time."""
    rng, base = np.random.default_rng(7), flown.solved.solution.state
    start = solve(flown.problem, base, scale=6.0, tolerance=1e-9).state
    draws = [
        moved(start, solve(errors_of(name, flown.problem, rng), start, scale=6.0, tolerance=1e-7).state)
        for _ in range(DRAWS)
    ]
    gain = gain_of(flown.solved)
    whole = np.linalg.inv(gain @ flown.solved.solution.covariance @ gain.T)
    found = float(np.trace(whole @ np.cov(np.stack(draws).T))) / SMALL**2
    stated = float(np.trace(whole @ sources(flown.solved, gain)[name]))
    assert found == pytest.approx(stated, rel=0.3), (found, stated)


def test_a_clicks_terms_are_what_the_ground_makes_of_the_set(flown: Flown) -> None:
    ratios = []
    for placed in flown.placed:
        s = decode(encode(placed.feature_set))
        centre_px = (np.array(s.camera.size_px) - 1.0) / 2.0
        fix = Locator(s).locate(centre_px)
        terms = click_terms(placed, (0.0, 0.0))
        whole = sum(terms.values(), np.zeros((3, 3)))
        ratios.append(np.trace(whole[:2, :2]) / np.trace(fix.covariance_enu_m2[:2, :2]))
        budget = click_budget(placed)
        assert sum(budget.shares.values()) == pytest.approx(1.0)
        assert min(budget.shares.values()) > -1e-6
        assert budget.semi_major_m == pytest.approx(fix.ellipse.semi_major_m, rel=0.05)
        assert set(budget.shares) <= set(ABOUT)
    assert len(ratios) >= 3
    assert np.allclose(ratios, 1.0, atol=0.05), ratios


def test_the_advice_is_against_the_largest_source(flown: Flown) -> None:
    budget = click_budget(flown.placed[-1])
    assert next(iter(budget.shares)) == max(budget.shares, key=lambda n: budget.shares[n])
    surer = replace(budget, shares={Cause.MOUNT: 0.62, Cause.GPS_SLOW: 0.21, Cause.PIXELS: 0.17})
    assert surer.advice.startswith("mount 62 %, GPS, correlated 21 %: fly one circle")
    left_m = surer.semi_major_m * np.sqrt(0.38)
    assert surer.advice.endswith(f"(without it {left_m:.1f} m)")


def test_the_square_root_of_independent_errors_is_their_sigmas() -> None:
    sigma = np.array([2.0, 3.0, 0.5])
    assert np.allclose(nearest_root(np.diag(1.0 / sigma)), np.diag(sigma))
    covariance = np.diag(sigma) @ np.array([[1.0, 0.9, 0.0], [0.9, 1.0, 0.2], [0.0, 0.2, 1.0]]) @ np.diag(sigma)
    F = nearest_root(np.linalg.inv(np.linalg.cholesky(covariance)))
    assert np.allclose(F @ F.T, covariance)
    assert np.all(np.abs(F).argmax(axis=1) == np.arange(3))


def test_a_flight_keeps_the_first_level_picture_of_a_minute_as_it_was_placed_last(flown: Flown) -> None:
    """Minutes that were not reached have no column, and nothing of the first minute is shown."""
    level = flown.placed[-1]
    R_enu_body = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # level, towards north
    watch = BudgetWatch(R_enu_body.T @ level.pose.R_cam_enu.T)

    def at(seconds: float, placed: Placed) -> Placed:
        stamp_ns = 1_000_000_000_000 + round(seconds * 1e9)
        return replace(placed, feature_set=replace(placed.feature_set, capture_unix_ns=stamp_ns, frame=round(seconds)))

    watch(at(0.0, level))
    assert "no picture was placed after minute 1" in budget_text(watch.budgets())
    revised = at(70.0, level)
    revised = replace(revised, feature_set=replace(revised.feature_set, common_cov=4.0 * level.feature_set.common_cov))
    for placed in (at(70.0, level), at(80.0, level), revised, at(200.0, level)):
        watch(placed)
    found = watch.budgets()
    assert list(found) == ["minute 1, level", "minute 3, level"]
    assert found["minute 1, level"].semi_major_m == pytest.approx(2.0 * found["minute 3, level"].semi_major_m, rel=0.1)
    lines = budget_text(found).splitlines()
    assert lines[0].split() == ["error", "budget", "of", "a", "click", "minute", "1,", "level", "minute", "3,", "level"]
    assert any(line.startswith("minute 3, level: ") and "without it" in line for line in lines)


def test_the_budget_of_a_click_now_is_computed_now_and_then_and_not_of_long_ago(flown: Flown) -> None:
    newest, level = NewestBudget(), flown.placed[-1]

    def at(seconds: float) -> Placed:
        stamp_ns = 1_000_000_000_000 + round(seconds * 1e9)
        return replace(level, feature_set=replace(level.feature_set, capture_unix_ns=stamp_ns))

    assert newest.at(0) is None
    newest(at(0.0))
    first = newest.at(at(0.5).feature_set.capture_unix_ns)
    assert first.percent == click_budget(level).percent
    assert list(first.percent.values()) == sorted(first.percent.values(), reverse=True)
    newest(at(4.0))
    assert newest.at(at(4.0).feature_set.capture_unix_ns) is first
    newest(at(11.0))
    newest(at(9.0))  # a later revision of an earlier picture
    again = newest.at(at(11.0).feature_set.capture_unix_ns)
    assert again is not None and again is not first
    assert newest.at(at(60.0).feature_set.capture_unix_ns) is None  # nothing was placed for long: landed, or no GPS


def test_a_window_that_cannot_be_split_ends_no_flight(flown: Flown) -> None:
    newest, level = NewestBudget(), flown.placed[-1]
    newest(replace(level, by_state=np.full_like(level.by_state, np.nan)))
    assert newest.at(level.feature_set.capture_unix_ns) is None


def test_a_budget_costs_a_thousandth_of_a_core(flown: Flown) -> None:
    least_s = []
    for placed in flown.placed:
        spent_s = []
        for _ in range(3):
            begun = time.thread_time()
            click_budget(placed)
            spent_s.append(time.thread_time() - begun)
        least_s.append(min(spent_s))
    assert np.median(least_s) / (LONG_NS / 1e9) < 0.001 * 5  # of a slower machine's
