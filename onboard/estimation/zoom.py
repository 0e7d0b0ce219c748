"""A lens that zoomed or refocused: how pictures are scaled, and how that is followed. (19.3) to (19.6)

A zoom scales pictures as a change of height would, which contradicts positions. So a window is adjusted once more with
every picture scaled back to the first by as much as its features lie off radially, and that as steps of the lens. Once
a zoom was seen each new keyframe's scale follows by the others', until it has visibly come back, or until the window by
itself says so: turns are seen through the lens as it is.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from contract.feature_set import Status
from onboard.estimation.boresight import STATES
from onboard.estimation.bundle_adjustment import Solution
from onboard.estimation.camera_states import COUNT
from onboard.estimation.factors import Layout
from onboard.estimation.keyframe import Keyframe, have_attitude
from onboard.estimation.optics_hypotheses import (
    HOPELESS,
    LIKELIER,
    adjusted,
    by_sensors,
    image_cost,
    pixel_variance,
    seen_through,
    sensors_rms,
    settled,
)
from onboard.estimation.window_acceptance import MIN_POINTS
from onboard.estimation.window_solver import MIN_KEYFRAMES, TOLERATED_RMS, Outcome, Request
from onboard.estimation.window_solver import adjust as solve_window

Array = NDArray[np.float64]
Scaled = tuple[Keyframe, ...]

SCALE_ROUNDS = 8
SETTLED_SCALE = 0.002
STEP_ROUNDS = 6
SHOWN, LEAST_SHOWN = 0.05, 0.005  # of what a scale is off by, in the features: at first, and at least
LONGEST = 0.05  # change of a step's size in one round
FALSE_ALARM = 1e-9  # that a zoom is found where there is none: chi-square of as many degrees of freedom, (19.3)
LEAST_SCALE = 0.015  # of a zoom that is one: less is what relief and heights leave
MOST_SCALE = 1.5  # of its logarithm: beyond it features are not the same
BACK = 0.02  # from the camera file's scale, within which a zoom has come back: windows judge again
NEWEST = 3  # pictures that must say so
SURE = 3.0  # sigmas
MOST_OPEN = 0.035  # one sigma of a scale's logarithm, above which a window says nothing of it
KNOWN = 0.015  # one sigma, below which a window's own scale is what pictures are taken to have
STEP, LARGE_STEP = 0.008, 0.4  # of a scale from picture to picture, and of the largest: less is not the lens
OPEN_SCALE = 0.3  # one sigma of the scale's logarithm, where nothing is believed of it
CERTAIN = 1e-6  # the same of what a camera file is sure of


@dataclass(frozen=True, eq=False)
class Scales:
    """Logarithm of each keyframe's scale (K,) beside the first one's, and by how much likelier pictures are with it."""

    log_scale: Array
    gain: float

    @property
    def is_zoom(self) -> bool:
        """Whether they are beyond chance and change as a zoomed lens does: out and back, and not for one picture."""
        g = self.log_scale
        if not self._is_beyond_chance or np.count_nonzero(np.abs(g) > LEAST_SCALE) < 2:
            return False
        ends = abs(float(g[-1] - g[0]))
        there_and_back = 2.0 * float(np.ptp(g)) - ends
        return float(np.abs(np.diff(g)).sum()) < there_and_back + LEAST_SCALE * len(g)

    @property
    def is_newest_alone(self) -> bool:
        """Whether, beyond chance, the newest picture is scaled and no other: a zoom that begins, or one odd picture."""
        scaled = np.abs(self.log_scale) > LEAST_SCALE
        return bool(self._is_beyond_chance and scaled[-1] and np.count_nonzero(scaled) == 1)

    @property
    def _is_beyond_chance(self) -> bool:
        return self.gain > 0.5 * float(chdtri(max(len(self.log_scale) - 1, 1), FALSE_ALARM))


@dataclass(frozen=True)
class OwnScale:
    """Logarithm of the scale that a window's pictures have in common, beside what was believed, and one sigma."""

    log_scale: float
    sigma: float
    is_explained: bool  # with it, sensors and pictures agree: it is what parted them

    def is_back_from(self, log_scale: float) -> bool:
        """Whether it is what was believed, and not what it was seen at (the logarithm of that), beyond doubt. (19.6)"""
        if self.sigma > MOST_OPEN or abs(self.log_scale) > SURE * self.sigma:
            return False
        away = (self.log_scale - log_scale) / self.sigma
        return 0.5 * (away**2 - (self.log_scale / self.sigma) ** 2) > LIKELIER

    @property
    def is_beyond_chance(self) -> bool:
        """Whether it is not what was believed, or something else is wrong."""
        return (self.log_scale / self.sigma) ** 2 > float(chdtri(1, FALSE_ALARM)) and abs(self.log_scale) > LEAST_SCALE

    @property
    def is_off(self) -> bool:
        """Whether it is not, beyond chance, and that alone is what is wrong."""
        return self.is_explained and self.is_beyond_chance


def followed(request: Request) -> Outcome:
    """A window of which some pictures are known to be scaled: the newest's scale, by all others.

    Where the features that tied it to those before the zoom are lost, only the window by itself can say that it is as
    the camera is on file.
    """
    keyframes, is_lost = request.keyframes, any(k.is_zoom_lost for k in request.keyframes)
    noise = replace(request.noise, zoomed_ns=keyframes[-1].nav.stamp_ns)
    if is_lost or all(k.log_zoom for k in keyframes):
        plain = tuple(replace(k, log_zoom=0.0, is_zoom_lost=False) for k in keyframes)
        found = by_itself(replace(request, keyframes=plain))
        if found is not None and found.is_back_from(keyframes[-1].log_zoom):
            return solve_window(replace(request, keyframes=plain, noise=replace(noise, zoomed_ns=0)))
        if found is not None and found.is_off and found.sigma < KNOWN:
            keyframes = tuple(replace(k, log_zoom=found.log_scale) for k in keyframes)
            return Outcome(Status.ZOOMED, keyframes, noise, reason=_reason(found.log_scale))
    if not is_lost:
        return refused(request, scaled(request).log_scale)
    reason = "the lens had zoomed or refocused when its pictures were lost, and nothing says that it is back"
    return Outcome(Status.ZOOMED, keyframes, noise, reason=reason)


def off_by(request: Request, found: OwnScale) -> Outcome:
    """Refused, for all pictures of the window are scaled alike: the zoom was over before them, or not seen."""
    end_ns = request.keyframes[-1].nav.stamp_ns
    lost = tuple(replace(k, log_zoom=found.log_scale, is_zoom_lost=True) for k in request.keyframes)
    grown, sigma = float(np.exp(found.log_scale)), found.sigma
    reason = f"the lens has zoomed or refocused, or its file is wrong: scale {grown:.3f} +- {sigma:.3f} throughout"
    return Outcome(Status.ZOOMED, lost, replace(request.noise, zoomed_ns=end_ns), reason=reason)


def refused(request: Request, log_scale: Array) -> Outcome:
    """A window whose pictures are scaled so (K,) beside its first one, which are then followed, or have come back."""
    total = followed_by(np.array([k.log_zoom for k in request.keyframes]), log_scale)
    noise = replace(request.noise, zoomed_ns=request.keyframes[-1].nav.stamp_ns)
    reason = _reason(float(total[-1]))
    if has_come_back(total):  # go on with the pictures since
        since = int(np.flatnonzero(np.abs(total) >= BACK)[-1]) + 1
        keyframes = tuple(replace(k, log_zoom=0.0) for k in request.keyframes[since:])
        return Outcome(Status.ZOOMED, keyframes, replace(noise, zoomed_ns=0), reason=reason)
    # What lies before the first that is scaled is as on file; what comes after is not, however little it is scaled.
    scales = np.where(np.maximum.accumulate(np.abs(total)) < BACK, 0.0, total).tolist()
    keyframes = tuple(replace(k, log_zoom=z) for k, z in zip(request.keyframes, scales, strict=True))
    return Outcome(Status.ZOOMED, keyframes, noise, reason=reason)


def _reason(log_scale: float) -> str:
    return f"the lens has zoomed or refocused: scale {np.exp(log_scale):.3f}"


def followed_by(known: Array, log_scale: Array) -> Array:
    """Scales (K,) beside the camera file's, of pictures scaled so beside the first, by what is `known` but of the last.

    By all that is known and not by the first alone: each scale errs by about a hundredth, and an error that every
    window hands to the next grows without limit.
    """
    if not known.any():
        return log_scale
    return log_scale + float(np.median((known - log_scale)[:-1]))


def has_come_back(total: Array) -> bool:
    """Whether scales (K,) fell to the camera file's and stayed there, by more than a single one of them errs."""
    newest, largest = float(np.abs(total[-NEWEST:]).max()), float(np.abs(total).max())
    return len(total) > NEWEST and largest >= BACK > newest and largest - newest > max(0.5 * largest, LEAST_SCALE)


def by_itself(request: Request) -> OwnScale | None:
    """The scale that all pictures of a window have in common, as rotations and attitudes tell it; None if they cannot.

    The focal length is adjusted with a prior that says nothing. (19.5)
    """
    belief = request.belief
    mean, covariance, taken = belief.mean, belief.covariance, request.camera_taken
    if len(mean) == STATES:
        mean, taken = np.concatenate([mean, np.zeros(COUNT)]), np.zeros(COUNT)
        covariance = np.diag(np.concatenate([np.zeros(STATES), np.full(COUNT, CERTAIN**2)]))
        covariance[:STATES, :STATES] = belief.covariance
    own, covariance = float(covariance[STATES, STATES]), covariance.copy()
    covariance[STATES], covariance[:, STATES] = 0.0, 0.0
    covariance[STATES, STATES] = OPEN_SCALE**2
    request = replace(request, belief=replace(belief, mean=mean, covariance=covariance), camera_taken=taken)
    keyframes = request.keyframes
    if len(keyframes) < MIN_KEYFRAMES:
        return None
    has_attitude = have_attitude(keyframes)
    solution = settled(request, keyframes, by_sensors(request, keyframes), has_attitude=has_attitude)
    variance = None if solution is None else pixel_variance(solution)
    if solution is None or variance is None:
        return None
    column = Layout(len(keyframes), COUNT).camera.start  # of the focal length
    sigma2 = float(solution.covariance[column, column]) * variance
    is_explained = sensors_rms(request, solution) < TOLERATED_RMS
    return OwnScale(float(solution.state.camera[0] - mean[STATES]), float(np.sqrt(sigma2 + own)), is_explained)


def scaled(request: Request) -> Scales:
    """The scales that explain a window best; as they were taken for, where too little is there to adjust. (19.3)"""
    keyframes = request.keyframes
    known = np.array([k.log_zoom for k in keyframes])
    nothing = Scales(known - known[0], 0.0)
    if len(keyframes) < MIN_KEYFRAMES:
        return nothing
    R, has_attitude = by_sensors(request, keyframes), have_attitude(keyframes)
    first = settled(request, keyframes, R, has_attitude=has_attitude)
    if first is None:
        return nothing
    ground_m = float(np.median(first.state.points_enu_m[:, 2]))
    free = _free(request, R, first, picture_to_picture(keyframes, R, ground_m))
    every = np.tril(np.ones((len(keyframes), len(keyframes))))[:, 1:]
    if free is not None and free.gain > 0.0:
        # A slow drift of all scales is much like a climb, and found slowly. A lens is moved at once, and then rests.
        sizes = np.abs(np.diff(free.log_scale))
        stepped = _stepped(request, R, first, free.log_scale, every[:, sizes > max(STEP, LARGE_STEP * sizes.max())])
    else:
        stepped = _stepped(request, R, first, np.zeros(len(keyframes)), _likeliest(first, keyframes, every))
    if stepped is None and free is None:
        return nothing
    least = -np.inf if free is None else free.gain - len(keyframes)
    best = stepped if stepped is not None and stepped.gain > least else free
    assert best is not None
    return best if best.gain > 0.0 else replace(nothing, gain=best.gain)  # what explains less than no change is none


def _likeliest(first: Solution, keyframes: Scaled, steps: Array) -> Array:
    """The one of the steps (K, S) that explains most, by the slope of the cost where there is none: (K, 1)."""
    gradient, weight = _radially(first, keyframes)
    score = (steps.T @ gradient) ** 2 / np.sum(steps * weight[:, None], axis=0)
    return steps[:, [int(np.argmax(score))]]


def _scaled_by(request: Request, R: Array, first: Solution, log_scale: Array) -> tuple[Solution, Scaled] | None:
    """The window adjusted with pictures scaled back by these (K,), and those pictures; None if that makes it worse."""
    if np.abs(log_scale).max() > MOST_SCALE:
        return None
    back = tuple(_scaled_back(request, k, float(z)) for k, z in zip(request.keyframes, log_scale, strict=True))
    solution = adjusted(request, back, R, has_attitude=have_attitude(request.keyframes))
    if solution is None or image_cost(solution) - image_cost(first) > HOPELESS:
        return None
    return solution, back


def _explains(first: Solution, solution: Solution, log_scale: Array) -> Scales | None:
    variance = pixel_variance(solution)
    return None if variance is None else Scales(log_scale, (first.cost - solution.cost) / variance)


def _free(request: Request, R: Array, first: Solution, log_scale: Array) -> Scales | None:
    """Scales (K,) of each picture by itself, from a first guess; None where they explain nothing."""
    solution = first
    for _ in range(SCALE_ROUNDS):
        made = _scaled_by(request, R, first, log_scale)
        if made is None:
            return None
        solution, back = made
        found = _farther_out(solution, back)
        found = found - found[0]
        if np.abs(found).max() < SETTLED_SCALE:
            break
        log_scale = log_scale + found
    return _explains(first, solution, log_scale)


def _stepped(request: Request, R: Array, first: Solution, log_scale: Array, steps: Array) -> Scales | None:
    """Scales (K,) that change only by `steps` (K, S), where they fit best; None where they explain nothing. (19.4)

    Of what a step is off by, heights take most and leave features a share of some hundredths. The share is what the
    features lie off less by after a step's size was changed.
    """
    if not steps.size:
        return None
    design = np.column_stack([np.ones(len(steps)), steps])
    sizes = np.asarray(np.linalg.lstsq(design, log_scale, rcond=None)[0][1:], np.float64)
    was: tuple[Array, Array] | None = None  # what was found, and by what sizes were changed for it
    best: Scales | None = None
    for _ in range(STEP_ROUNDS):
        made = _scaled_by(request, R, first, steps @ sizes)
        if made is None:
            break
        scales = _explains(first, made[0], steps @ sizes)
        best = scales if best is None or (scales is not None and scales.gain > best.gain) else best
        gradient, weight = _radially(*made)
        found = np.asarray(np.linalg.solve((steps.T * weight) @ steps, steps.T @ gradient), np.float64)
        share = SHOWN
        if was is not None:
            share = float(np.clip((was[0] - found) @ was[1] / (was[1] @ was[1]), LEAST_SHOWN, 1.0))
        moved = np.clip(found / share, -LONGEST, LONGEST)
        if np.abs(moved).max() < SETTLED_SCALE:
            break
        was, sizes = (found, moved), sizes + moved
    return best


def _predicted(solution: Solution, keyframes: Scaled) -> Iterator[tuple[Array, Array, Array]]:
    """Of each picture's known features: predicted and seen (N, 2), and the weight (N,) that the loss left them."""
    s = solution.state
    ids, counts = np.unique(np.concatenate([k.observation.ids for k in keyframes]), return_counts=True)
    ids = ids[counts >= 2]
    for i, k in enumerate(keyframes):
        at = np.minimum(np.searchsorted(ids, k.observation.ids), len(ids) - 1)
        known = ids[at] == k.observation.ids
        p = (s.points_enu_m[at[known]] - s.centres_enu_m[i]) @ s.R_cam_enu[i].T
        seen, gain = k.observation.xy[known], k.observation.gain[known]
        yield p[:, :2] / np.maximum(p[:, 2:], 1e-6), seen, solution.robust_weight[i, at[known]] / gain**2


def _radially(solution: Solution, keyframes: Scaled) -> tuple[Array, Array]:
    """What the cost falls by with each picture's scale (K,), and how fast that changes; all else stays."""
    gradient, weight = np.zeros(len(keyframes)), np.zeros(len(keyframes))
    for i, (predicted, seen, w) in enumerate(_predicted(solution, keyframes)):
        gradient[i] = float(np.sum(w * np.sum((seen - predicted) * seen, axis=1)))
        weight[i] = float(np.sum(w * np.sum(seen**2, axis=1)))
    return gradient, np.maximum(weight, 1e-9)


def picture_to_picture(keyframes: tuple[Keyframe, ...], R: Array, ground_m: float) -> Array:
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


def _farther_out(solution: Solution, keyframes: Scaled) -> Array:
    """By what logarithm (K,) each picture's features lie farther out than they are predicted: median over them."""
    out = np.zeros(len(keyframes))
    for i, (predicted, seen, _) in enumerate(_predicted(solution, keyframes)):
        # About the middles of both, for a rotation is no scale.
        where, to = predicted - np.median(predicted, axis=0), seen - np.median(seen, axis=0)
        far = np.linalg.norm(where, axis=1) > np.median(np.linalg.norm(where, axis=1))
        if np.count_nonzero(far) >= 3:
            ratio = np.sum(to[far] * where[far], axis=1) / np.sum(where[far] ** 2, axis=1)
            out[i] = float(np.log(max(np.median(ratio), 0.1)))
    return out


def _scaled_back(request: Request, keyframe: Keyframe, log_scale: float) -> Keyframe:
    grown, camera = float(np.exp(log_scale)), request.camera
    return seen_through(replace(camera, fx_px=camera.fx_px * grown, fy_px=camera.fy_px * grown), keyframe)
