"""The weights of a window: its noise, and the sensors' variances, until its own residuals ask for no other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from onboard.estimation import row_waves
from onboard.estimation.attitude_misfit import attitude_misfit
from onboard.estimation.factors import WAVES, AttitudePrior, Prior, VelocityPrior
from onboard.estimation.keyframe import have_attitude
from onboard.estimation.second_solve import lie_near
from onboard.estimation.sensor_groups import Innovation, failing_groups, innovations
from onboard.estimation.sensor_table import PARTS, TILT
from onboard.estimation.solved_window import AS_KNOWN
from onboard.estimation.variance_components import evidence_of
from onboard.estimation.window_problem import Weighed
from onboard.estimation.window_request import Noise

Array = NDArray[np.float64]

WEIGHING_ROUNDS = 5
TOLERATED_RMS = 1.3  # of velocity's and attitude's whitened residuals
MAX_JITTER_S = 0.02
MAX_NOISE_INFLATION = 2.0
MIN_CHANGE = 0.3  # of a variance's logarithm, by which it must change to weigh a window again


@dataclass(frozen=True, eq=False)
class Settled:
    """A window whose weights ask for no change.

    `before`: the noise that its sensors are held against, of earlier windows and of sensors that fail in this one.
    `noise`: the one that the next window is weighed by. `failed`: the names of the sensors that were found to fail.
    """

    weighed: Weighed
    before: Noise
    noise: Noise
    failed: frozenset[str]

    def priors_before(self) -> list[Prior]:
        """The priors as `before` weights the sensors: this window's own weights would excuse them."""
        return _priors_before(self.weighed, self.before)


def without_near_points(weighed: Weighed) -> Weighed:
    """The window without tracks whose point lies next to a camera that saw it, (6.16)."""
    near = lie_near(weighed.solution.state, weighed.problem.weight)
    if not near.any():
        return weighed
    window = weighed.window.with_problem(weight=np.where(near, 0.0, weighed.window.unweighed.weight))
    return window.weighed(weighed.noise, weighed.solution.state)


def with_waves(weighed: Weighed, rounds: int = 1) -> Weighed:
    """The window with the vibration that its rows show, if they are read in turn: again while it grows.

    Strong waves turn features into outliers, and poses take some of them, until they are modelled.
    """
    for _ in range(rounds * (weighed.window.unweighed.sweep is not None)):
        waves = row_waves.seen(weighed.problem, weighed.solution)
        if waves is None:
            break
        sweep = weighed.window.unweighed.sweep
        assert sweep is not None
        has_grown = waves.sigma_rad > np.exp(0.5 * MIN_CHANGE) * sweep.sigma_wave_rad
        window = weighed.window.vibrating(waves)
        weighed = window.weighed(weighed.noise, weighed.solution.state.with_block(window.layout, WAVES))
        if not has_grown:
            break
    return weighed


def without_failing_sensors(weighed: Weighed) -> tuple[Weighed, frozenset[str]]:
    """The window with the sensors down-weighted that fail by it, and the names of those that were found to."""
    noise, held = weighed.noise, weighed.noise.factors.groups
    if not noise.factors.stamp_ns:  # a sensor that never agreed with pictures (a convoy) has not failed: refused below
        return weighed, frozenset()

    def of(solved: Weighed, groups: Mapping[str, float]) -> list[Innovation]:
        s = solved.solution
        return innovations(solved.problem.priors, s.state, s.covariance, groups, noise.factors.known_by)

    def innovations_with(groups: Mapping[str, float]) -> list[Innovation]:
        factors = replace(noise.factors, groups=groups)
        return of(weighed.again(replace(noise, factors=factors)), groups)

    groups, failed = failing_groups(of(weighed, held), innovations_with, held)
    if not failed:
        return weighed, frozenset()
    return weighed.again(replace(noise, factors=replace(noise.factors, groups=groups))), frozenset(failed)


def settled(weighed: Weighed, failed: frozenset[str]) -> Settled:
    """Weigh a window until its own residuals ask for no other weights; `failed`: its sensors that do."""
    before = noise = weighed.noise
    for _ in range(WEIGHING_ROUNDS):
        noise, again = _reweighed(weighed)
        if not again:
            noise, again = _with_own_evidence(weighed, before, noise)
        if not again:
            break
        weighed = weighed.again(noise)
    return Settled(_with_attitude_as_found(weighed, before), before, noise, failed)


def _with_attitude_as_found(weighed: Weighed, before: Noise) -> Weighed:
    """The window with mount and tilt known to as many more sigmas as they are off what was known, where that is more.

    An attitude that is off by a constant angle shows in level flight by nothing else: the ground slopes instead.
    Equations (16.13), (16.15).
    """
    misfit = attitude_misfit(weighed.solution, weighed.problem.priors, _priors_before(weighed, before))
    if max(misfit.mount.max() ** 2, misfit.tilt_variance) < np.exp(MIN_CHANGE):
        return weighed
    x, y, z = np.maximum(misfit.mount, 1.0).tolist()
    noise, groups = weighed.noise, weighed.noise.factors.groups
    groups = {**groups, TILT: groups.get(TILT, 1.0) * misfit.tilt_variance}
    return weighed.again(replace(noise, mount_sigmas=(x, y, z), factors=replace(noise.factors, groups=groups)))


def _priors_before(weighed: Weighed, before: Noise) -> list[Prior]:
    noise, factors = weighed.noise, before.factors
    if noise.factors is factors and noise.mount_sigmas == AS_KNOWN:
        return weighed.problem.priors
    return weighed.window.problem(replace(noise, factors=factors, mount_sigmas=AS_KNOWN)).priors


def _with_own_evidence(weighed: Weighed, before: Noise, used: Noise) -> tuple[Noise, bool]:
    """The sensors' variances with what this window itself shows of them; True if that changes its weights. (13.2)"""
    first = weighed.solution
    evidence = evidence_of(weighed.problem.priors, first.state, first.covariance, used.factors)
    own = before.factors.with_evidence(evidence, weighed.window.request.keyframes[-1].nav.stamp_ns)
    changed = any(abs(np.log(own.of(n) / used.factors.of(n))) > MIN_CHANGE for n in PARTS)
    return (replace(used, factors=own), True) if changed else (used, False)


def _reweighed(weighed: Weighed) -> tuple[Noise, bool]:
    """Stamp jitter and noise inflation from velocity and attitude residuals; True if weights changed.

    Stamps that are off by some milliseconds (photographs, USB) raise both residuals at once, and are allowed for first.
    What disagreement remains is the picture's: a calibration's error moves many features together, biases the poses and
    hardly shows in the features' own residuals. The sigma of all pixels is then raised until both sides agree. (6.7)
    """
    request, noise, state = weighed.window.request, weighed.noise, weighed.solution.state
    kinds = VelocityPrior | AttitudePrior if have_attitude(request.keyframes) else VelocityPrior
    measured = [p.evaluate(state)[0] for p in weighed.problem.priors if isinstance(p, kinds)]
    if not measured:
        return noise, False
    rms = max(float(np.sqrt(np.mean(r**2))) for r in measured)
    if rms > TOLERATED_RMS:
        if noise.jitter_s < MAX_JITTER_S:
            return replace(noise, jitter_s=min(max(noise.jitter_s, 0.003) * min(rms, 3.0), MAX_JITTER_S)), True
        if noise.noise_inflation < MAX_NOISE_INFLATION:
            return replace(noise, noise_inflation=min(noise.noise_inflation * min(rms, 2.0), MAX_NOISE_INFLATION)), True
    elif rms < 1.0 / TOLERATED_RMS:
        least_s = request.config.camera.sigma_jitter_s
        jitter_s, inflation = max(0.95 * noise.jitter_s, least_s), max(0.95 * noise.noise_inflation, 1.0)
        return replace(noise, jitter_s=jitter_s, noise_inflation=inflation), False
    return noise, False
