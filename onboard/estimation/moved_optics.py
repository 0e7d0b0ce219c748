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
from scipy.special import chdtri

from contract.camera import Camera
from contract.feature_set import Status
from contract.rotations import log_so3
from onboard.estimation.boresight import BORESIGHT, HEADING, OFFSET, STATES, VELOCITY_DELAY
from onboard.estimation.bundle_adjustment import Problem, Solution
from onboard.estimation.factors import AttitudePrior, State
from onboard.estimation.keyframe import Keyframe, have_attitude, observation
from onboard.estimation.second_start import by_attitude
from onboard.estimation.sensor_factors import sensor_priors
from onboard.estimation.sensor_groups import FORGOTTEN
from onboard.estimation.window_acceptance import MIN_POINTS
from onboard.estimation.window_solver import GROUND_MOVES, MIN_KEYFRAMES, Noise, Outcome, Request, approximate
from onboard.estimation.window_solver import adjust as solve_window
from onboard.estimation.window_start import grid, layout_of, starting_points, sweep

Array = NDArray[np.float64]

MOVED = (Status.STABILISED, Status.ZOOMED)
ROUNDS = 5  # of shifts at most: each finds what is left of the one before
MOST_STARTS = 4
SETTLED_PX = 2.0  # rms, of a round that has found nothing new
SCALE_ROUNDS = 8
SETTLED_SCALE = 0.002
LOSS_SIGMAS = 3.0
STRAINED = 1.3  # times the declared noise, above which a window that is accepted is looked at too
MAX_VARIANCE = 3.0  # of pixels, beside what was taken for it, in pictures that are explained
# By how much a logarithm of likelihood must grow. An attitude that errs exceeds it once in 20 million windows at most,
# however large the shift is that it suggests: the difference has the mean -d/2 and the variance d, (19.2).
LIKELIER = 15.0
HOPELESS = 100.0  # more of a cost with shifts, or scales, than without: no further round makes up for that
FALSE_ALARM = 1e-9  # the same for scales, which are fitted: chi-square of as many degrees of freedom, (19.3)
LEAST_SCALE = 0.015  # of a zoom that is one: less is what relief and heights leave
MOST_SCALE = 1.5  # of its logarithm: beyond it features are not the same
SPREAD = 0.03  # between the first guesses of a window's scales, above which an accepted window is looked at
BACK = 0.03  # from the first scale, within which a zoom has come back: windows judge again
HELD_NS = 30_000_000_000  # for which a frame that was seen shifted, or a lens that zoomed, is still taken to be
LOOK_NS = 4_000_000_000  # until the next window is looked at, after one in vain
LEAST_JITTER_S = 0.003
MIN_LEFT = 6.0  # measurements of every picture beyond what is fitted to it, to tell how they fit


@dataclass(frozen=True)
class Explanation:
    """By how much likelier (natural logarithm) the pictures of a window are shifted back, and by how much (rms, px)."""

    gain: float
    shift_px: float


@dataclass(frozen=True, eq=False)
class Scales:
    """Logarithm of each keyframe's scale (K,) beside the first one's, and by how much likelier pictures are with it."""

    log_scale: Array
    gain: float

    @property
    def is_zoom(self) -> bool:
        """Whether they are beyond chance and change as a zoomed lens does: out and back, and not for one picture."""
        g, least = self.log_scale, 0.5 * float(chdtri(max(len(self.log_scale) - 1, 1), FALSE_ALARM))
        if not self.gain > least or np.count_nonzero(np.abs(g) > LEAST_SCALE) < 2:
            return False
        ends = abs(float(g[-1] - g[0]))
        there_and_back = 2.0 * float(np.ptp(g)) - ends
        return float(np.abs(np.diff(g)).sum()) < there_and_back + LEAST_SCALE * len(g)


def adjust(request: Request) -> Outcome:
    """Solve a window; where it is strained or refused, see whether moved optics are why, and refuse it so."""
    if any(k.log_zoom for k in request.keyframes):
        return _followed(request)
    end_ns, seen_ns = request.keyframes[-1].nav.stamp_ns if request.keyframes else 0, request.noise.shifted_ns
    if seen_ns and end_ns - seen_ns < HELD_NS:
        if not _is_due(request, Status.OK):
            return _shifted(request, seen_ns, None)
        noise = _looked(request.noise, Status.OK, end_ns)
        return _shifted(replace(request, noise=noise), seen_ns, _excess(explained(request)))
    outcome = solve_window(request)
    # A surface that flows explains itself, and the attitude of what may not carry the camera says nothing of its lens.
    if outcome.reason == GROUND_MOVES or request.is_carrier_open:
        return outcome
    if outcome.status is not Status.POOR_FIT and not (outcome.status is Status.OK and _is_strained(request, outcome)):
        return outcome
    zoomed_ns = request.noise.zoomed_ns
    if zoomed_ns and end_ns - zoomed_ns < HELD_NS:
        noise = replace(request.noise, zoomed_ns=end_ns)
        reason = (
            f"the lens zoomed or refocused {(end_ns - zoomed_ns) / 1e9:.0f} s ago, and nothing says that it is back"
        )
        return Outcome(Status.ZOOMED, request.keyframes, noise, reason=reason)
    if not _is_due(request, outcome.status):
        return outcome
    is_solved, zoom = outcome.status is Status.OK, None
    explanation = explained(replace(request, keyframes=outcome.keyframes), is_solved=is_solved)
    excess = _excess(explanation)
    if not is_solved or excess is not None or _spreads(request, outcome):
        zoom = scaled(request)
        if zoom.is_zoom and (explanation is None or zoom.gain > explanation.gain):
            return _zoomed(request, zoom.log_scale)
    if excess is not None:
        return _shifted(request, seen_ns, excess)
    is_neither = explanation.gain < -LIKELIER if explanation is not None else not is_solved
    if is_neither and (zoom is None or zoom.gain <= 0.0):
        return replace(outcome, noise=_looked(outcome.noise, outcome.status, end_ns))
    return outcome


def _is_due(request: Request, status: Status) -> bool:
    """Whether a window that was accepted (OK), or refused, is to be looked at: that takes longer than to solve it."""
    looked_ns = request.noise.looked_ns[0 if status is Status.OK else 1]
    return not 0 <= request.keyframes[-1].nav.stamp_ns - looked_ns < LOOK_NS


def _looked(noise: Noise, status: Status, end_ns: int) -> Noise:
    accepted_ns, refused_ns = noise.looked_ns
    return replace(noise, looked_ns=(end_ns, refused_ns) if status is Status.OK else (accepted_ns, end_ns))


def _excess(explanation: Explanation | None) -> float | None:
    """How far (px) a window's frame is shifted; None where nothing says that it is."""
    if explanation is None or explanation.gain < LIKELIER:
        return None
    return explanation.shift_px


def _shifted(request: Request, seen_ns: int, shift_px: float | None) -> Outcome:
    """Refused; `shift_px` None: for what was seen of windows until `seen_ns`, for video is not stabilised by turns."""
    end_ns = request.keyframes[-1].nav.stamp_ns
    # What it did to the noise says nothing of the next window's.
    noise = replace(request.noise, shifted_ns=seen_ns if shift_px is None else end_ns)
    size = f"{(end_ns - seen_ns) / 1e9:.0f} s ago" if shift_px is None else f"{shift_px:.0f} px rms"
    reason = f"the frame is shifted from picture to picture (stabilisation, a zoom, or rows read late), {size}"
    return Outcome(Status.STABILISED, request.keyframes, noise, reason=reason)


def _is_strained(request: Request, outcome: Outcome) -> bool:
    """Whether a window that is accepted needed more noise than declared, or a sensor left out."""
    noise, declared_s = outcome.noise, max(request.config.camera.sigma_jitter_s, LEAST_JITTER_S)
    fails = any(f.at(request.keyframes[-1].nav.stamp_ns) > FORGOTTEN for f in noise.failing.failures.values())
    return fails or noise.noise_inflation > STRAINED or noise.jitter_s > STRAINED * declared_s


def _spreads(request: Request, outcome: Outcome) -> bool:
    """Whether features of an accepted window spread, from picture to picture, more than sensors make them."""
    if outcome.solved is None:
        return False
    ground_m = float(np.median(outcome.solved.solution.state.points_enu_m[outcome.solved.good, 2]))
    found = _picture_to_picture(outcome.keyframes, _by_sensors(request, outcome.keyframes), ground_m)
    return bool(np.ptp(found) > SPREAD)


def _by_sensors(request: Request, keyframes: tuple[Keyframe, ...]) -> Array:
    """R_cam_enu (K, 3, 3) by attitude, where there is none as it is taken for."""
    attitudes = [by_attitude(k.nav, request.belief, request.R_body_cam) for k in keyframes]
    return np.stack([k.R_cam_enu if a is None else a for k, a in zip(keyframes, attitudes, strict=True)])


def _followed(request: Request) -> Outcome:
    """A window of which some pictures are known to be scaled: the newest's scale, by all others."""
    if any(k.is_zoom_lost for k in request.keyframes):
        # Only the ground's height remains to tell: a window that fits it as the camera is on file is at that scale.
        plain = replace(
            request, keyframes=tuple(replace(k, log_zoom=0.0, is_zoom_lost=False) for k in request.keyframes)
        )
        outcome = solve_window(plain)
        if outcome.status is Status.OK and not _is_strained(plain, outcome):
            return outcome
    return _zoomed(request, scaled(request).log_scale)


def _zoomed(request: Request, log_scale: Array) -> Outcome:
    """`log_scale` (K,) beside the first picture's own."""
    total = request.keyframes[0].log_zoom + log_scale
    at_first = np.abs(total) < BACK
    scales = np.where(at_first, 0.0, total).tolist()
    keyframes = tuple(replace(k, log_zoom=z) for k, z in zip(request.keyframes, scales, strict=True))
    noise = replace(request.noise, zoomed_ns=request.keyframes[-1].nav.stamp_ns)
    if at_first[-1] and not at_first.all():  # it has come back: go on with the pictures since
        noise = replace(noise, zoomed_ns=0)
        keyframes = keyframes[int(np.flatnonzero(~at_first)[-1]) + 1 :]
    reason = f"the lens has zoomed or refocused: scale {np.exp(total[-1]):.3f}"
    return Outcome(Status.ZOOMED, keyframes, noise, reason=reason)


def scaled(request: Request) -> Scales:
    """The scales that explain a window best; as they were taken for, where too little is there to adjust. (19.3)"""
    keyframes = request.keyframes
    nothing = Scales(np.array([k.log_zoom - keyframes[0].log_zoom for k in keyframes]), 0.0)
    if len(keyframes) < MIN_KEYFRAMES:
        return nothing
    R, has_attitude = _by_sensors(request, keyframes), have_attitude(keyframes)
    first = _settled(request, keyframes, R, has_attitude=has_attitude)
    if first is None:
        return nothing
    ground_m = float(np.median(first.state.points_enu_m[:, 2]))
    log_scale, solution = _picture_to_picture(keyframes, R, ground_m), first
    for _ in range(SCALE_ROUNDS):
        if np.abs(log_scale).max() > MOST_SCALE:
            return nothing
        back = tuple(_scaled_back(request, k, float(z)) for k, z in zip(keyframes, log_scale, strict=True))
        again = _adjusted(request, back, R, has_attitude=has_attitude)
        if again is None:
            return nothing
        if _image_cost(again) - _image_cost(first) > HOPELESS:
            return nothing
        solution, found = again, _farther_out(again, back)
        found = found - found[0]
        if np.abs(found).max() < SETTLED_SCALE:
            break
        log_scale = log_scale + found
    variance = _pixel_variance(solution)
    if variance is None:
        return nothing
    return Scales(log_scale, (first.cost - solution.cost) / variance)


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
    grown, camera = float(np.exp(log_scale)), request.camera
    return _seen_through(replace(camera, fx_px=camera.fx_px * grown, fy_px=camera.fy_px * grown), keyframe)


def _seen_through(camera: Camera, keyframe: Keyframe) -> Keyframe:
    seen = keyframe.observation
    return replace(keyframe, observation=observation(camera, seen.ids, seen.uv_px, seen.moving))


def explained(request: Request, *, is_solved: bool = False) -> Explanation | None:
    """Both adjustments of a window; None where there is no attitude or too little to adjust. (19.1), (19.2)

    `is_solved`: its keyframes are turned as a solution has them.
    """
    keyframes = request.keyframes
    if len(keyframes) < MIN_KEYFRAMES or not have_attitude(keyframes):
        return None
    R = _by_sensors(request, keyframes)
    start = np.stack([k.R_cam_enu for k in keyframes])
    first = (_adjusted if is_solved else _settled)(request, keyframes, start)
    if first is None:
        return None
    solution, best, shift, best_px = first, first, np.zeros((len(keyframes), 2)), 0.0
    for _ in range(ROUNDS):
        turned = log_so3(solution.state.R_cam_enu @ R.transpose(0, 2, 1))
        # A rotation e moves what lies ahead by (e_y, -e_x); what all pictures have in common is mount and lens.
        found = np.column_stack([turned[:, 1], -turned[:, 0]])
        found = found - np.median(found, axis=0)
        if float(np.sqrt(np.mean(np.sum(found**2, axis=1)))) * request.camera.focal_px < SETTLED_PX:
            break
        shift = shift + found
        # Where the frame is what moved, the camera is turned as the autopilot says.
        again = _adjusted(request, _shifted_back(request, keyframes, shift), R)
        if again is None:
            return None
        solution = again
        if best is first or _image_cost(again) < _image_cost(best):
            best, best_px = again, float(np.sqrt(np.mean(np.sum(shift**2, axis=1)))) * request.camera.focal_px
        elif _image_cost(best) - _image_cost(first) > HOPELESS:
            break
    variance = _pixel_variance(best)
    return None if variance is None else Explanation((_image_cost(first) - _image_cost(best)) / variance, best_px)


def _shifted_back(request: Request, keyframes: tuple[Keyframe, ...], shift: Array) -> tuple[Keyframe, ...]:
    c = request.camera
    return tuple(
        _seen_through(replace(c, cx_px=c.cx_px + c.fx_px * x, cy_px=c.cy_px + c.fy_px * y), k)
        for k, (x, y) in zip(keyframes, shift.tolist(), strict=True)
    )


def _settled(
    request: Request, keyframes: tuple[Keyframe, ...], R: Array, *, has_attitude: bool = False
) -> Solution | None:
    """Adjusted until it stays where it is: a compass may be wrong by more than one adjustment goes."""
    out = _adjusted(request, keyframes, R, has_attitude=has_attitude)
    for _ in range(MOST_STARTS):
        again = None if out is None else _adjusted(request, keyframes, out.state.R_cam_enu, has_attitude=has_attitude)
        if out is None or again is None or again.cost > out.cost - 1.0:
            break
        out = again
    return out


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
    rows = sweep(request, keyframes, share)
    belief, layout = request.belief, layout_of(request, keyframes, rows)
    offset_s, late_s, velocity_late_s = belief.mean[OFFSET : VELOCITY_DELAY + 1].tolist()
    lens, off = belief.mean[STATES:], np.zeros(layout.rates.shape)
    boresight, heading = belief.mean[BORESIGHT], belief.mean[HEADING]
    state = State(R, centres, points, boresight, offset_s, plane, late_s, velocity_late_s, heading, lens, off)
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
        rows,
    )
    return approximate(problem, state)


def _pixel_variance(solution: Solution) -> float | None:
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


def _image_cost(solution: Solution) -> float:
    """Of the pictures alone, with the loss of the adjustment."""
    squared = np.square(solution.residual_sigmas[np.isfinite(solution.residual_sigmas)])
    return float(0.5 * LOSS_SIGMAS**2 * np.sum(np.log1p(squared / LOSS_SIGMAS**2)))
