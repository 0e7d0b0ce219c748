"""One window adjusted under a hypothesis about its optics: pictures moved by it, sensors as they are, no judgement."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from onboard.estimation.boresight import BORESIGHT, HEADING, OFFSET, STATES, VELOCITY_DELAY
from onboard.estimation.bundle_adjustment import Problem, Solution
from onboard.estimation.factors import AttitudePrior, Layout, Prior, State, VelocityPrior
from onboard.estimation.keyframe import Keyframe, observation
from onboard.estimation.second_start import by_attitude
from onboard.estimation.sensor_factors import sensor_priors
from onboard.estimation.window_acceptance import MIN_POINTS
from onboard.estimation.window_solver import Request, approximate
from onboard.estimation.window_start import grid, layout_of, starting_points, sweep

Array = NDArray[np.float64]

# By how much a logarithm of likelihood must grow. An attitude that errs exceeds it once in 20 million windows at most,
# however large the shift is that it suggests: the difference has the mean -d/2 and the variance d, (19.2).
LIKELIER = 15.0
HOPELESS = 100.0  # more of a cost with what is supposed than without: no further round makes up for that
MOST_STARTS = 4
LOSS_SIGMAS = 3.0
MAX_VARIANCE = 3.0  # of pixels, beside what was taken for it, in pictures that are explained
MIN_LEFT = 6.0  # measurements of every picture beyond what is fitted to it, to tell how they fit


def by_sensors(request: Request, keyframes: tuple[Keyframe, ...]) -> Array:
    """R_cam_enu (K, 3, 3) by attitude, where there is none as it is taken for."""
    attitudes = [by_attitude(k.nav, request.belief, request.R_body_cam) for k in keyframes]
    return np.stack([k.R_cam_enu if a is None else a for k, a in zip(keyframes, attitudes, strict=True)])


def seen_through(camera: Camera, keyframe: Keyframe) -> Keyframe:
    """The keyframe with its pixels taken for those of another camera."""
    seen = keyframe.observation
    return replace(keyframe, observation=observation(camera, seen.ids, seen.uv_px, seen.moving))


def settled(
    request: Request, keyframes: tuple[Keyframe, ...], R: Array, *, has_attitude: bool = False
) -> Solution | None:
    """Adjusted until it stays where it is: a compass may be wrong by more than one adjustment goes."""
    out = adjusted(request, keyframes, R, has_attitude=has_attitude)
    for _ in range(MOST_STARTS):
        again = None if out is None else adjusted(request, keyframes, out.state.R_cam_enu, has_attitude=has_attitude)
        if out is None or again is None or again.cost > out.cost - 1.0:
            break
        out = again
    return out


def adjusted(
    request: Request, keyframes: tuple[Keyframe, ...], R: Array, *, has_attitude: bool = False
) -> Solution | None:
    """Pictures, positions, velocities and level ground, from orientations (K, 3, 3); attitudes too, if asked for."""
    request = replace(request, keyframes=keyframes, previous=None)
    ids, counts = np.unique(np.concatenate([k.observation.ids for k in keyframes]), return_counts=True)
    ids = ids[counts >= 2]
    if len(ids) < MIN_POINTS:
        return None
    xy, raw, weight, share = grid(request, ids)
    centres = np.stack([k.nav.position_enu_m for k in keyframes])
    points, reference, plane = starting_points(request, ids, R, centres, xy, weight > 0)
    rows = sweep(request, keyframes, share)
    belief, layout, noise, config = request.belief, layout_of(request, keyframes, rows), request.noise, request.config
    offset_s, late_s, velocity_late_s = belief.mean[OFFSET : VELOCITY_DELAY + 1].tolist()
    lens, off = belief.mean[STATES:], np.zeros(layout.rates.shape)
    boresight, heading = belief.mean[BORESIGHT], belief.mean[HEADING]
    state = State(R, centres, points, boresight, offset_s, plane, late_s, velocity_late_s, heading, lens, off)
    priors = sensors(request, layout)
    ground = np.full(len(points), 1.0 / max(config.solve.relief_sigma_m, 1e-3))
    problem = Problem(
        layout,
        raw,
        weight * (noise.pixel_sigma_px / config.solve.pixel_sigma_px),
        [p for p in priors if has_attitude or not isinstance(p, AttitudePrior)],
        reference,
        ground,
        None,
        float(centres[:, 2].mean() - reference[2]),
        request.camera if layout.camera_states else None,
        request.camera_taken,
        rows,
    )
    return approximate(problem, state)


def sensors(request: Request, layout: Layout) -> list[Prior]:
    """What the sensors say of the request's keyframes."""
    keyframes, noise = list(request.keyframes), request.noise
    taken = request.belief, False, noise.jitter_s, noise.factors, request.slope
    return sensor_priors(request.config, request.R_body_cam, keyframes, layout, *taken)


def sensors_rms(request: Request, solution: Solution) -> float:
    """Of the velocities' and attitudes' whitened residuals, whichever is the larger; 0 where there is neither."""
    layout = Layout(len(request.keyframes), len(request.camera_taken), len(solution.state.rates_rad_s) > 0)
    told = [p for p in sensors(request, layout) if isinstance(p, AttitudePrior | VelocityPrior)]
    return max((float(np.sqrt(np.mean(p.evaluate(solution.state)[0] ** 2))) for p in told), default=0.0)


def pixel_variance(solution: Solution) -> float | None:
    """Of pixels, beside what was taken for it, at least 1; None where pictures do not fit: that explains nothing.

    Every picture must fit for itself: one that shows something else is no worse off with any scale.
    """
    sigmas = solution.residual_sigmas
    seen, squared = np.isfinite(sigmas), np.square(np.where(np.isfinite(sigmas), sigmas, 0.0))
    cost = np.where(seen, LOSS_SIGMAS**2 * np.log1p(squared / LOSS_SIGMAS**2), 0.0)
    points = np.count_nonzero(seen, axis=0)
    # Of two coordinates each, less a point's three, spread over its pictures, less a pose's six.
    left = np.sum(np.where(seen, 2.0 - 3.0 / np.maximum(points, 2), 0.0), axis=1) - 6.0
    enough = left > MIN_LEFT
    if not enough.all() or float((cost.sum(axis=1) / left).max()) > MAX_VARIANCE:
        return None
    return max(float(cost.sum() / left.sum()), 1.0)


def image_cost(solution: Solution) -> float:
    """Of the pictures alone, with the loss of the adjustment."""
    squared = np.square(solution.residual_sigmas[np.isfinite(solution.residual_sigmas)])
    return float(0.5 * LOSS_SIGMAS**2 * np.sum(np.log1p(squared / LOSS_SIGMAS**2)))
