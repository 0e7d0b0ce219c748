"""A lens that zoomed or refocused: how each picture of a window is scaled, and how that is followed. (19.3), (19.4)

A zoom scales pictures as a change of height would, which contradicts positions. So a window is adjusted once more with
every picture scaled back to the first by as much as its features lie off radially. Once a zoom was seen each new
keyframe's scale follows by the others', until it has visibly come back, or until the window by itself says so.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from contract.feature_set import Status
from onboard.estimation.boresight import STATES
from onboard.estimation.bundle_adjustment import Solution
from onboard.estimation.camera_states import COUNT
from onboard.estimation.keyframe import Keyframe, have_attitude
from onboard.estimation.optics_hypotheses import (
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

SCALE_ROUNDS = 8
SETTLED_SCALE = 0.002
FALSE_ALARM = 1e-9  # that a zoom is found where there is none: chi-square of as many degrees of freedom, (19.3)
HOPELESS = 100.0  # more of a cost with scales than without: no further round makes up for that
LEAST_SCALE = 0.015  # of a zoom that is one: less is what relief and heights leave
MOST_SCALE = 1.5  # of its logarithm: beyond it features are not the same
BACK = 0.02  # from the camera file's scale, within which a zoom has come back: windows judge again
NEWEST = 3  # pictures that must say so
SURE = 3.0  # sigmas
LIKELIER = 15.0  # a logarithm of likelihood: as of shifted frames, (19.2)
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
        g, least = self.log_scale, 0.5 * float(chdtri(max(len(self.log_scale) - 1, 1), FALSE_ALARM))
        if not self.gain > least or np.count_nonzero(np.abs(g) > LEAST_SCALE) < 2:
            return False
        ends = abs(float(g[-1] - g[0]))
        there_and_back = 2.0 * float(np.ptp(g)) - ends
        return float(np.abs(np.diff(g)).sum()) < there_and_back + LEAST_SCALE * len(g)


@dataclass(frozen=True)
class OwnScale:
    """Logarithm of the scale that a window's pictures have in common, beside what was believed, and one sigma."""

    log_scale: float
    sigma: float
    is_explained: bool  # with it, sensors and pictures agree: it is what parted them

    def is_back_from(self, log_scale: float) -> bool:
        """Whether it is what was believed, and not what it was seen at (the logarithm of that), beyond doubt. (19.4)"""
        if self.sigma > MOST_OPEN or abs(self.log_scale) > SURE * self.sigma:
            return False
        away = (self.log_scale - log_scale) / self.sigma
        return 0.5 * (away**2 - (self.log_scale / self.sigma) ** 2) > LIKELIER

    @property
    def is_off(self) -> bool:
        """Whether it is not, beyond chance, and that alone is what is wrong."""
        beyond = 0.5 * (self.log_scale / self.sigma) ** 2 > 0.5 * float(chdtri(1, FALSE_ALARM))
        return self.is_explained and beyond and abs(self.log_scale) > LEAST_SCALE


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
    if not is_lost:
        return refused(replace(request, keyframes=keyframes), scaled(request).log_scale)
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
    reason = f"the lens has zoomed or refocused: scale {np.exp(total[-1]):.3f}"
    if has_come_back(total):  # go on with the pictures since
        since = int(np.flatnonzero(np.abs(total) >= BACK)[-1]) + 1
        keyframes = tuple(replace(k, log_zoom=0.0) for k in request.keyframes[since:])
        return Outcome(Status.ZOOMED, keyframes, replace(noise, zoomed_ns=0), reason=reason)
    # What lies before the first that is scaled is as on file; what comes after is not, however little it is scaled.
    scales = np.where(np.maximum.accumulate(np.abs(total)) < BACK, 0.0, total).tolist()
    keyframes = tuple(replace(k, log_zoom=z) for k, z in zip(request.keyframes, scales, strict=True))
    return Outcome(Status.ZOOMED, keyframes, noise, reason=reason)


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

    The focal length is adjusted with a prior that says nothing. (19.4)
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
    column = 6 * len(keyframes) + STATES
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
    anything = np.tril(np.ones((len(keyframes), len(keyframes))))[:, 1:]
    free = _fitted(request, R, first, picture_to_picture(keyframes, R, ground_m), anything)
    if free is None or not free.gain > 0.0:  # what explains less than no change is none
        return nothing if free is None else replace(nothing, gain=free.gain)
    # A slow drift of all scales is much like a climb, and found slowly. A lens is moved at once, and then rests.
    steps = np.abs(np.diff(free.log_scale))
    moved = anything[:, steps > max(STEP, LARGE_STEP * float(steps.max()))]
    stepped = _fitted(request, R, first, moved @ _share(moved, free.log_scale), moved) if moved.size else None
    return stepped if stepped is not None and stepped.gain > free.gain - len(steps) else free


def _share(steps: Array, log_scale: Array) -> Array:
    """What each step (S,) of scales (K,) that only change by `steps` (K, S) is, in least squares, a constant aside."""
    design = np.column_stack([np.ones(len(steps)), steps])
    return np.asarray(np.linalg.lstsq(design, log_scale, rcond=None)[0][1:], np.float64)


def _fitted(request: Request, R: Array, first: Solution, log_scale: Array, steps: Array) -> Scales | None:
    """Scales (K,) that change by `steps` (K, S) alone, from a first guess; None where they explain nothing."""
    keyframes, has_attitude, solution = request.keyframes, have_attitude(request.keyframes), first
    for _ in range(SCALE_ROUNDS):
        if np.abs(log_scale).max() > MOST_SCALE:
            return None
        back = tuple(_scaled_back(request, k, float(z)) for k, z in zip(keyframes, log_scale, strict=True))
        again = adjusted(request, back, R, has_attitude=has_attitude)
        if again is None or image_cost(again) - image_cost(first) > HOPELESS:
            return None
        solution, found = again, steps @ _share(steps, _farther_out(again, back))
        if np.abs(found).max() < SETTLED_SCALE:
            break
        log_scale = log_scale + found
    variance = pixel_variance(solution)
    return None if variance is None else Scales(log_scale, (first.cost - solution.cost) / variance)


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
    return seen_through(replace(camera, fx_px=camera.fx_px * grown, fy_px=camera.fy_px * grown), keyframe)
