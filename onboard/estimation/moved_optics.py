"""Optics that moved from picture to picture: electronic stabilisation, and zoom or refocus. (19.1) to (19.3)

A frame that follows the smoothed rotation moves the principal point from picture to picture. Seen as the rotation that
it hides it contradicts the attitude, as an attitude that errs does. The two differ in perspective: a shift moves all of
a picture alike, a rotation its corners more. So a window that is strained is adjusted twice without any attitude: as it
is, and with every picture shifted back by as much as its orientation differs from the autopilot's. If the attitude
erred the second is the worse one, by perspective alone; if the frame was shifted it is the better one.

A lens that zooms scales pictures as a change of height would, which contradicts positions. So a refused window is
adjusted once more with every picture scaled back to the first by as much as its features lie off radially.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contract.feature_set import Status
from contract.rotations import log_so3
from onboard.estimation.boresight import BORESIGHT, HEADING, OFFSET, STATES, VELOCITY_DELAY
from onboard.estimation.bundle_adjustment import Problem, Solution
from onboard.estimation.factors import AttitudePrior, Layout, State
from onboard.estimation.keyframe import Keyframe, have_attitude, observation
from onboard.estimation.second_start import by_attitude
from onboard.estimation.sensor_factors import sensor_priors
from onboard.estimation.sensor_groups import FORGOTTEN
from onboard.estimation.window_acceptance import MIN_POINTS
from onboard.estimation.window_solver import MIN_KEYFRAMES, Outcome, Request, approximate
from onboard.estimation.window_solver import adjust as solve_window
from onboard.estimation.window_start import grid, starting_points, sweep

Array = NDArray[np.float64]

MOVED = (Status.STABILISED, Status.ZOOMED)
ROUNDS = 2  # of shifts: each finds what is left of the one before
SCALE_ROUNDS = 4
LOSS_SIGMAS = 3.0
STRAINED = 1.3  # times the declared noise, above which a window that is accepted is looked at too
MAX_COST = 1.5  # a measurement, of pictures that are explained; of noise alone it is less than 1
LIKELIER = 15.0  # by how much a logarithm of likelihood must grow: pixels' errors are not quite independent
LIKELIER_SCALE = 60.0  # the same with a scale for every picture: height, too, may err
LEAST_SCALE = 0.015  # of a zoom that is one: less is what relief and heights leave
BACK = 0.03  # from the first scale, within which a zoom has come back: windows judge again
HELD_NS = 30_000_000_000  # for which a frame that was seen shifted is still taken to be
LEAST_JITTER_S = 0.003


@dataclass(frozen=True)
class Explanation:
    """Costs of the pictures of one window as they are, and shifted back; and how far they were shifted (rms, px)."""

    as_is: float
    shifted: float
    shift_px: float


def adjust(request: Request) -> Outcome:
    """Solve a window; where it is strained or refused, see whether moved optics are why, and refuse it so."""
    if any(k.log_zoom for k in request.keyframes):
        return _followed(request)
    end_ns, seen_ns = request.keyframes[-1].nav.stamp_ns if request.keyframes else 0, request.noise.shifted_ns
    if seen_ns and end_ns - seen_ns < HELD_NS:
        return _shifted(request, seen_ns, _excess(explained(request)))
    outcome = solve_window(request)
    if outcome.status is not Status.POOR_FIT and not (outcome.status is Status.OK and _is_strained(request, outcome)):
        return outcome
    explanation = explained(request)
    excess = _excess(explanation)
    if outcome.status is Status.POOR_FIT or excess is not None:
        log_scale, gain = scaled(request)
        by_shift = 0.0 if explanation is None else explanation.as_is - explanation.shifted
        if gain > max(LIKELIER_SCALE, by_shift) and np.abs(log_scale).max() > LEAST_SCALE:
            return _zoomed(request, log_scale)
    return outcome if excess is None else _shifted(request, seen_ns, excess)


def _excess(explanation: Explanation | None) -> float | None:
    """How far (px) a window's frame is shifted; None where nothing says that it is."""
    if explanation is None or explanation.as_is - explanation.shifted < LIKELIER:
        return None
    return explanation.shift_px


def _shifted(request: Request, seen_ns: int, shift_px: float | None) -> Outcome:
    """Refused; `shift_px` None: for what was seen of windows until `seen_ns`, for video is not stabilised by turns."""
    end_ns = request.keyframes[-1].nav.stamp_ns
    # What it did to the noise says nothing of the next window's.
    noise = replace(request.noise, shifted_ns=seen_ns if shift_px is None else end_ns)
    size = f"{(end_ns - seen_ns) / 1e9:.0f} s ago" if shift_px is None else f"{shift_px:.0f} px rms"
    reason = f"the frame is shifted from picture to picture (stabilisation), {size}"
    return Outcome(Status.STABILISED, request.keyframes, noise, reason=reason)


def _is_strained(request: Request, outcome: Outcome) -> bool:
    """Whether a window that is accepted needed more noise than declared, or a sensor left out."""
    noise, declared_s = outcome.noise, max(request.config.camera.sigma_jitter_s, LEAST_JITTER_S)
    fails = any(f.at(request.keyframes[-1].nav.stamp_ns) > FORGOTTEN for f in noise.failing.failures.values())
    return fails or noise.noise_inflation > STRAINED or noise.jitter_s > STRAINED * declared_s


def _followed(request: Request) -> Outcome:
    """A window of which some pictures are known to be scaled: the newest's scale, by all others."""
    if any(k.is_zoom_lost for k in request.keyframes):
        # Only the ground's height remains to tell: a window that fits it as the camera is on file is at that scale.
        plain = replace(
            request, keyframes=tuple(replace(k, log_zoom=0.0, is_zoom_lost=False) for k in request.keyframes)
        )
        outcome = solve_window(plain)
        if outcome.status is Status.OK:
            return outcome
    log_scale, _ = scaled(request)
    return _zoomed(request, log_scale)


def _zoomed(request: Request, log_scale: Array) -> Outcome:
    """`log_scale` (K,) beside the first picture's own."""
    total = request.keyframes[0].log_zoom + log_scale
    at_first = np.abs(total) < BACK
    scales = np.where(at_first, 0.0, total).tolist()
    keyframes = tuple(replace(k, log_zoom=z) for k, z in zip(request.keyframes, scales, strict=True))
    if at_first[-1] and not at_first.all():  # it has come back: go on with the pictures since
        keyframes = keyframes[int(np.flatnonzero(~at_first)[-1]) + 1 :]
    reason = f"the lens has zoomed or refocused: scale {np.exp(total[-1]):.3f}"
    return Outcome(Status.ZOOMED, keyframes, request.noise, reason=reason)


def scaled(request: Request) -> tuple[Array, float]:
    """Logarithm of each keyframe's scale (K,) beside the first one's, and by how much the cost falls with them. (19.3)

    As they were taken for and 0 where too little is there to adjust.
    """
    keyframes = request.keyframes
    nothing = np.array([k.log_zoom - keyframes[0].log_zoom for k in keyframes])
    if len(keyframes) < MIN_KEYFRAMES:
        return nothing, 0.0
    attitudes = [by_attitude(k.nav, request.belief, request.R_body_cam) for k in keyframes]
    R = np.stack([k.R_cam_enu if a is None else a for k, a in zip(keyframes, attitudes, strict=True)])
    has_attitude = have_attitude(keyframes)
    first = _adjusted(request, keyframes, R, has_attitude=has_attitude)
    if first is None:
        return nothing, 0.0
    ground_m = float(np.median(first.state.points_enu_m[:, 2]))
    log_scale, gain = _picture_to_picture(keyframes, R, ground_m), 0.0
    solution: Solution | None = None
    for _ in range(SCALE_ROUNDS):
        back = tuple(_scaled_back(request, k, float(z)) for k, z in zip(keyframes, log_scale, strict=True))
        solution = _adjusted(request, back, R, has_attitude=has_attitude)
        if solution is None:
            return nothing, 0.0
        gain = first.cost - solution.cost
        found = _farther_out(solution, back)
        log_scale = log_scale + found - found[0]
    return (log_scale, gain) if _fits(solution) else (nothing, 0.0)


def _picture_to_picture(keyframes: tuple[Keyframe, ...], R: Array, ground_m: float) -> Array:
    """A first guess of the scales (K,): how features spread from picture to picture, beside what sensors predict."""
    out = np.zeros(len(keyframes))
    for i in range(1, len(keyframes)):
        was, now = keyframes[i - 1], keyframes[i]
        _, at, to = np.intersect1d(was.observation.ids, now.observation.ids, return_indices=True)
        out[i] = out[i - 1]
        if len(at) < MIN_POINTS:
            continue
        rays = np.column_stack([was.observation.xy[at], np.ones(len(at))]) @ R[i - 1]
        depth = (ground_m - was.nav.position_enu_m[2]) / np.minimum(rays[:, 2], -1e-3)
        p = (was.nav.position_enu_m + rays * depth[:, None] - now.nav.position_enu_m) @ R[i].T
        both = p[:, :2] / p[:, 2:], now.observation.xy[to]
        spread = [float(np.median(np.linalg.norm(q - np.median(q, axis=0), axis=1))) for q in both]
        out[i] += float(np.log(max(spread[1], 1e-6) / max(spread[0], 1e-6)))
    return out


def _farther_out(solution: Solution, keyframes: tuple[Keyframe, ...]) -> Array:
    """By what logarithm (K,) each picture's features lie farther out than they are predicted: median over them."""
    s, out = solution.state, np.zeros(len(keyframes))
    ids, counts = np.unique(np.concatenate([k.observation.ids for k in keyframes]), return_counts=True)
    ids = ids[counts >= 2]
    for i, k in enumerate(keyframes):
        at = np.minimum(np.searchsorted(ids, k.observation.ids), len(ids) - 1)
        known = ids[at] == k.observation.ids
        p = (s.points_enu_m[at[known]] - s.centres_enu_m[i]) @ s.R_cam_enu[i].T
        predicted, seen = p[:, :2] / np.maximum(p[:, 2:], 1e-6), k.observation.xy[known]
        # About the middles of both, for a rotation is no scale.
        predicted, seen = predicted - np.median(predicted, axis=0), seen - np.median(seen, axis=0)
        far = np.linalg.norm(predicted, axis=1) > np.median(np.linalg.norm(predicted, axis=1))
        if np.count_nonzero(far) >= 3:
            ratio = np.sum(seen[far] * predicted[far], axis=1) / np.sum(predicted[far] ** 2, axis=1)
            out[i] = float(np.log(max(np.median(ratio), 0.1)))
    return out


def _scaled_back(request: Request, keyframe: Keyframe, log_scale: float) -> Keyframe:
    camera, seen = request.camera, keyframe.observation
    middle = np.array([camera.cx_px, camera.cy_px])
    uv = middle + (seen.uv_px - middle) * np.exp(-log_scale)
    return replace(keyframe, observation=observation(camera, seen.ids, uv, seen.moving))


def explained(request: Request) -> Explanation | None:
    """Both adjustments of a window; None where there is no attitude or too little to adjust. (19.1), (19.2)"""
    keyframes = request.keyframes
    if len(keyframes) < MIN_KEYFRAMES or not have_attitude(keyframes):
        return None
    attitudes = [by_attitude(k.nav, request.belief, request.R_body_cam) for k in keyframes]
    R = np.stack([a for a in attitudes if a is not None])
    first = _adjusted(request, keyframes, R)
    if first is None:
        return None
    solution, shift = first, np.zeros((len(keyframes), 2))
    for _ in range(ROUNDS):
        turned = log_so3(solution.state.R_cam_enu @ R.transpose(0, 2, 1))
        # A rotation e moves what lies ahead by (e_y, -e_x); what all pictures have in common is mount and lens.
        found = np.column_stack([turned[:, 1], -turned[:, 0]])
        shift = shift + found - np.median(found, axis=0)
        again = _adjusted(request, _shifted_back(request, keyframes, shift), R)
        if again is None:
            return None
        solution = again
    size_px = float(np.sqrt(np.mean(np.sum(shift**2, axis=1)))) * request.camera.focal_px
    if not _fits(solution):
        return None
    return Explanation(_image_cost(first), _image_cost(solution), size_px)


def _shifted_back(request: Request, keyframes: tuple[Keyframe, ...], shift: Array) -> tuple[Keyframe, ...]:
    focal = np.array([request.camera.fx_px, request.camera.fy_px])
    return tuple(
        replace(
            k,
            observation=observation(
                request.camera, k.observation.ids, k.observation.uv_px - s * focal, k.observation.moving
            ),
        )
        for k, s in zip(keyframes, shift, strict=True)
    )


def _adjusted(
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
    belief, layout = request.belief, Layout(len(keyframes), len(request.camera_taken))
    offset_s, late_s, velocity_late_s = belief.mean[OFFSET : VELOCITY_DELAY + 1].tolist()
    lens = belief.mean[STATES:]
    boresight, heading = belief.mean[BORESIGHT], belief.mean[HEADING]
    state = State(R, centres, points, boresight, offset_s, plane, late_s, velocity_late_s, heading, lens)
    noise, config = request.noise, request.config
    priors = sensor_priors(
        config, request.R_body_cam, list(keyframes), layout, belief, False, noise.jitter_s, noise.factors, request.slope
    )
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
        sweep(request, keyframes, share),
    )
    return approximate(problem, state)


def _fits(solution: Solution | None) -> bool:
    """Whether pictures fit at all: what leaves them as wrong as before explains nothing."""
    if solution is None:
        return False
    return _image_cost(solution) < MAX_COST * int(np.count_nonzero(np.isfinite(solution.residual_sigmas)))


def _image_cost(solution: Solution) -> float:
    """Of the pictures alone, with the loss of the adjustment."""
    squared = np.square(solution.residual_sigmas[np.isfinite(solution.residual_sigmas)])
    return float(0.5 * LOSS_SIGMAS**2 * np.sum(np.log1p(squared / LOSS_SIGMAS**2)))
