"""Keyframes are looked up again where the time offset is known better than when they were taken."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.sampled_flight import SampledFlight, SampledSpec, SampledTracker
from contract.feature_set import Status
from onboard.config.schema import parse_config
from onboard.estimation.clock_profile import ClockProfile
from onboard.estimation.keyframe import Keyframe
from onboard.estimation.platform_states import OFFSET
from onboard.estimation.sensor_groups import Failing
from onboard.estimation.sliding_window import Window
from onboard.estimation.window_solver import adjust
from onboard.events.types import Attitude
from onboard.pipeline.keyframes import profile_of
from onboard.pipeline.pipeline import Pipeline
from simulation.paths import PathSpec

SPEC = SampledSpec(parse_config(""), PathSpec(), 9.0, 2.0, errors=0.2, offset_s=-0.2, delay_s=0.0)


def flown(attitudes: int = 1, spec: SampledSpec = SPEC, seed: int = 1) -> Pipeline:
    """A pipeline as it is at the flight's end, with every so manieth attitude."""
    flight = SampledFlight(spec, seed)
    pipeline = Pipeline(spec.config, spec.camera)
    pipeline.tracker = SampledTracker(flight)
    count = 0
    for event in flight.events():
        if isinstance(event, Attitude):
            count += 1
            if count % attitudes:
                continue
        pipeline.handle(event)
    return pipeline


def find(window: Window, offset_s: float) -> None:
    window._times_s = offset_s, window.times_s()[1]


def alike(one: list[Keyframe], other: list[Keyframe]) -> bool:
    return all(a is b for a, b in zip(one, other, strict=True))


def test_attitude_rate_position_and_distance_are_those_of_the_new_offset() -> None:
    pipeline = flown()
    window, navigation = pipeline.window, pipeline.navigation
    before = list(window.keyframes)
    assert len(before) >= 4
    find(window, -0.1)
    window.look_up_again(navigation)
    _, delay_s = window.times_s()
    for k, (old, new) in enumerate(zip(before, window.keyframes, strict=True)):
        nav = navigation.state_at(old.nav.stamp_ns, -0.1, 0.0, delay_s)
        assert new.nav_offset_s == pytest.approx(-0.1)
        assert new.nav.R_enu_body is not None
        assert nav.R_enu_body is not None
        assert np.allclose(new.nav.R_enu_body, nav.R_enu_body)
        assert np.allclose(new.nav.position_enu_m, nav.position_enu_m)
        rate = navigation.body_rate_at(old.nav.stamp_ns - 100_000_000)
        assert rate is not None
        assert np.allclose(new.body_rate_rad_s, rate)
        assert new.observation is old.observation
        if k and old.displacement is not None:
            assert 0.0 < np.linalg.norm(new.displacement.enu_m - old.displacement.enu_m) < 5.0
    moved = [
        np.linalg.norm(a.nav.position_enu_m - b.nav.position_enu_m)
        for a, b in zip(before, window.keyframes, strict=True)
    ]
    assert min(moved) > 1.0, "0.1 s is metres"


@pytest.mark.parametrize("best_s", [-0.4, -0.2])
def test_a_sensor_that_contradicted_because_of_the_clock_fails_no_longer(best_s: float) -> None:
    """And goes on to fail where the clock is not what contradicted."""
    window = flown().window
    start_ns, end_ns = window.keyframes[0].nav.stamp_ns, window.keyframes[-1].nav.stamp_ns
    failing = Failing().after(start_ns, end_ns, {"tilt": 1e4})
    window.noise = replace(window.noise, failing=failing)
    outcome = replace(adjust(window.prepare()), noise=window.noise)
    is_far = best_s == -0.4
    assert window.adopt(outcome, ClockProfile(best_s, 1e30, 0.0, 0.0, (best_s, best_s))) is (
        Status.STARTING if is_far else Status.OK
    )
    assert window.noise.failing.fails_at(end_ns) == (not is_far)
    assert window.noise.failing.windows == {"tilt": 1}


def test_nothing_is_touched_where_nothing_changed_or_navigation_is_gone() -> None:
    pipeline = flown()
    window = pipeline.window
    now_s = window.keyframes[-1].nav_offset_s
    find(window, now_s + 0.002)
    window.look_up_again(pipeline.navigation)
    before = list(window.keyframes)
    window.look_up_again(pipeline.navigation)
    assert alike(window.keyframes, before)
    find(window, now_s - 0.2)
    pipeline.navigation._forget()
    window.look_up_again(pipeline.navigation)
    assert alike(window.keyframes, before)


@pytest.mark.long
@pytest.mark.parametrize(("offset_s", "seeds"), [(-0.2, [2]), (-0.2, range(3)), (0.15, range(3))])
def test_stamps_that_are_far_off_are_learned_as_well_as_they_are_stated(offset_s: float, seeds: Sequence[int]) -> None:
    """Turns at 2.5 Hz of attitudes: each window takes its offset as linear about what the one before it found.

    About what the flight had learned, the same windows were 0.007 to 0.053 s off.
    """
    off = []
    for seed in seeds:
        spec = replace(SPEC, path=PathSpec("turns", bank_deg=40.0), seconds=25.0, errors=0.5, offset_s=offset_s)
        window = flown(8, spec, seed).window
        platform = window.alignment.platform
        assert abs(platform.mean[OFFSET] - offset_s) < 2.5 * platform.sigma[OFFSET]
        off.append(abs(window.times_s()[0] - offset_s))
    assert np.median(off) < 0.008
    assert max(off) < 0.02


def test_a_window_at_an_offset_that_another_clearly_beats_answers_nothing_and_teaches_nothing() -> None:
    window = flown(spec=replace(SPEC, path=PathSpec("turns", bank_deg=40.0), seconds=25.0, errors=0.5)).window
    assert window.solved is not None
    assert window.alignment.updates
    outcome = adjust(window.prepare())
    right_s = window.times_s()[0]
    assert window.adopt(outcome, ClockProfile(right_s, 1e30, 0.0, 0.0, (right_s, right_s))) is Status.OK
    taught = window.alignment.updates
    assert window.adopt(outcome, ClockProfile(-0.5, 1e30, 0.0, 0.0, (-0.5, -0.45))) is Status.STARTING
    assert window.solved is None
    assert window.times_s()[0] == -0.5
    assert window.refusal.startswith("attitudes fit at another time offset: -0.50 s, not -0.")
    assert taught and not window.alignment.updates, "the mount was learned at another offset"


@pytest.mark.long
def test_what_was_learned_stays_where_only_the_newest_window_went_astray() -> None:
    window = flown(spec=replace(SPEC, path=PathSpec("turns", bank_deg=40.0), seconds=25.0, errors=0.5)).window
    learned_s = float(window.alignment.platform.mean[OFFSET])
    outcome = adjust(window.prepare())
    find(window, learned_s + 0.3)
    assert window.adopt(outcome, ClockProfile(learned_s, 1e30, 0.0, 0.0, (learned_s, learned_s))) is Status.STARTING
    assert window.alignment.updates
    assert window.times_s()[0] == learned_s


def test_attitudes_at_other_offsets_are_those_of_the_states_there_and_none_where_they_end() -> None:
    pipeline = flown()
    navigation, last = pipeline.navigation, pipeline.window.keyframes[-1]
    moments_ns = [last.nav.stamp_ns + offset_ns for offset_ns in (-333_000_000, 0)]
    found = navigation.attitudes_at(moments_ns, last.nav.position_enu_m)
    states = [navigation.state_at(moment_ns) for moment_ns in moments_ns]
    assert found is not None
    for R, state in zip(found, states, strict=True):
        assert state.R_enu_body is not None
        assert np.allclose(R, state.R_enu_body, atol=1e-6)
    assert navigation.attitudes_at([last.nav.stamp_ns + 10**10], last.nav.position_enu_m) is None
    outcome = adjust(pipeline.window.prepare())
    assert profile_of(outcome, pipeline.window, navigation) is not None
    navigation._forget()
    assert navigation.attitudes_at(moments_ns, last.nav.position_enu_m) is None
    assert profile_of(outcome, pipeline.window, navigation) is None
