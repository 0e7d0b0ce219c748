"""Optics that moved from picture to picture: electronic stabilisation, and zoom or refocus. (19.1), (19.2)

A frame that follows the smoothed rotation moves the principal point from picture to picture. Seen as the rotation that
it hides it contradicts the attitude, as an attitude that errs does. The two differ in perspective: a shift moves all of
a picture alike, a rotation its corners more. So a window that is strained is adjusted twice without any attitude: as it
is, and with every picture shifted back by as much as its orientation differs from the autopilot's. If the attitude
erred the second is the worse one, by perspective alone; if the frame was shifted it is the better one.

A zoom (`zoom`) is looked for in the same windows, and the likelier of the two names the refusal.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contract.feature_set import Status
from contract.rotations import log_so3
from onboard.estimation import zoom
from onboard.estimation.keyframe import Keyframe, have_attitude
from onboard.estimation.optics_hypotheses import (
    HOPELESS,
    LIKELIER,
    adjusted,
    by_sensors,
    image_cost,
    pixel_variance,
    seen_through,
    settled,
)
from onboard.estimation.sensor_groups import FORGOTTEN
from onboard.estimation.window_solver import GROUND_MOVES, MIN_KEYFRAMES, Noise, Outcome, Request
from onboard.estimation.window_solver import adjust as solve_window

Array = NDArray[np.float64]

MOVED = (Status.STABILISED, Status.ZOOMED)
ROUNDS = 5  # of shifts at most: each finds what is left of the one before
SETTLED_PX = 2.0  # rms, of a round that has found nothing new
STRAINED = 1.3  # times the declared noise, above which a window that is accepted is looked at too
DOUBTED = float(np.log(1000.0))  # likelier than this by chance once in 10,000 strained windows: not sure, not believed
SPREAD = 0.03  # between the first guesses of a window's scales, above which an accepted window is looked at
HELD_NS = 30_000_000_000  # for which a frame that was seen shifted, or a lens that zoomed, is still taken to be
LOOK_NS = 4_000_000_000  # until the next window is looked at, after one in vain
LEAST_JITTER_S = 0.003
PAST = 24  # windows whose noise is remembered: a few more than one window's keyframes


@dataclass(frozen=True)
class Explanation:
    """By how much likelier (natural logarithm) the pictures of a window are shifted back, and by how much (rms, px)."""

    gain: float
    shift_px: float


def adjust(request: Request) -> Outcome:
    """Solve a window; where it is strained or refused, see whether moved optics are why, and refuse it so."""
    before = _undisturbed(request)
    if any(k.log_zoom for k in request.keyframes):
        return zoom.followed(before)
    end_ns, seen_ns = request.keyframes[-1].nav.stamp_ns if request.keyframes else 0, request.noise.shifted_ns
    if seen_ns and end_ns - seen_ns < HELD_NS:
        return _still_shifted(before, seen_ns)
    outcome = solve_window(request)
    # A surface that flows explains itself, and the attitude of what may not carry the camera says nothing of its lens.
    if outcome.reason == GROUND_MOVES or request.is_carrier_open:
        return outcome
    # A window that no earlier one confirms is looked at too: three pictures of a turn may well hide a shift.
    is_strained = _is_strained(request, outcome)
    is_looked_at = not request.memory.windows or is_strained
    if outcome.status is not Status.POOR_FIT and not (outcome.status is Status.OK and is_looked_at):
        return _noted(outcome, end_ns)
    zoomed_ns = request.noise.zoomed_ns
    if zoomed_ns and end_ns - zoomed_ns < HELD_NS:
        noise = replace(request.noise, zoomed_ns=end_ns)
        reason = (
            f"the lens zoomed or refocused {(end_ns - zoomed_ns) / 1e9:.0f} s ago, and nothing says that it is back"
        )
        return Outcome(Status.ZOOMED, request.keyframes, noise, reason=reason)
    if not _is_due(request, outcome.status):
        return _noted(outcome, end_ns)
    is_solved, scales = outcome.status is Status.OK, None
    explanation = explained(replace(before, keyframes=outcome.keyframes), is_solved=is_solved)
    excess = _excess(explanation)
    if not is_solved or excess is not None or _spreads(request, outcome):
        scales = zoom.scaled(before)
        if scales.is_zoom and (explanation is None or scales.gain > explanation.gain):
            return zoom.refused(before, scales.log_scale)
    if excess is not None and (is_strained or not is_solved):
        return _shifted(before, seen_ns, excess)
    # Without attitudes nothing but the pictures themselves would tell a lens from the ground's shape.
    own = zoom.by_itself(before) if have_attitude(request.keyframes) else None
    if own is not None and own.is_off:
        return zoom.off_by(before, own)
    if is_solved and explanation is not None and explanation.gain > DOUBTED:
        return _doubted(before, f"a frame shifted by {explanation.shift_px:.0f} px rms explains the pictures better")
    if is_solved and scales is not None and scales.is_newest_alone:
        return _doubted(before, f"the newest picture seems scaled by {np.exp(scales.log_scale[-1]):.3f}")
    is_neither = explanation.gain < -LIKELIER if explanation is not None else not is_solved
    is_in_vain = (scales is None or scales.gain <= 0.0) and (own is None or not own.is_beyond_chance)
    if is_neither and is_in_vain:
        outcome = replace(outcome, noise=_looked(outcome.noise, outcome.status, end_ns))
    return _noted(outcome, end_ns)


def _still_shifted(request: Request, seen_ns: int) -> Outcome:
    """A window after ones whose frames were shifted until `seen_ns`: refused, and now and then looked at again."""
    if not _is_due(request, Status.OK):
        return _shifted(request, seen_ns, None)
    explanation = explained(request)
    # A zoom shifts what lies off the middle, and before enough pictures have it only that may have been seen.
    scales = zoom.scaled(request)
    if scales.is_zoom and (explanation is None or scales.gain > explanation.gain):
        noise = replace(request.noise, shifted_ns=0)
        return zoom.refused(replace(request, noise=noise), scales.log_scale)
    noise = _looked(request.noise, Status.OK, request.keyframes[-1].nav.stamp_ns)
    return _shifted(replace(request, noise=noise), seen_ns, _excess(explanation))


def _noted(outcome: Outcome, end_ns: int) -> Outcome:
    """With the noise that a window leaves written down, for later ones that share no picture with it."""
    noise = outcome.noise
    past = (*noise.past, (end_ns, noise.jitter_s, noise.noise_inflation))[-PAST:]
    return replace(outcome, noise=replace(noise, past=past))


def _undisturbed(request: Request) -> Request:
    """With the noise as it was found without any picture of this window.

    Optics that move make windows noisier, step by step, and what the first pictures of it did to the noise would excuse
    the next.
    """
    noise, start_ns = request.noise, request.keyframes[0].nav.stamp_ns if request.keyframes else 0
    earlier = [known for known in noise.past if known[0] < start_ns]
    if not earlier:
        return request
    _, jitter_s, inflation = earlier[-1]
    jitter_s, inflation = min(jitter_s, noise.jitter_s), min(inflation, noise.noise_inflation)
    return replace(request, noise=replace(noise, jitter_s=jitter_s, noise_inflation=inflation))


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


def _doubted(request: Request, why: str) -> Outcome:
    """Not sure enough to say that the optics moved, and far from sure that they did not."""
    return Outcome(Status.POOR_FIT, request.keyframes, request.noise, reason=why)


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
    found = zoom.picture_to_picture(outcome.keyframes, by_sensors(request, outcome.keyframes), ground_m)
    return bool(np.ptp(found) > SPREAD)


def explained(request: Request, *, is_solved: bool = False) -> Explanation | None:
    """Both adjustments of a window; None where there is no attitude or too little to adjust. (19.1), (19.2)

    `is_solved`: its keyframes are turned as a solution has them.
    """
    keyframes = request.keyframes
    if len(keyframes) < MIN_KEYFRAMES or not have_attitude(keyframes):
        return None
    R = by_sensors(request, keyframes)
    start = np.stack([k.R_cam_enu for k in keyframes])
    first = (adjusted if is_solved else settled)(request, keyframes, start)
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
        again = adjusted(request, _shifted_back(request, keyframes, shift), R)
        if again is None:
            return None
        solution = again
        if best is first or image_cost(again) < image_cost(best):
            best, best_px = again, float(np.sqrt(np.mean(np.sum(shift**2, axis=1)))) * request.camera.focal_px
        elif image_cost(best) - image_cost(first) > HOPELESS:
            break
    variance = pixel_variance(best)
    return None if variance is None else Explanation((image_cost(first) - image_cost(best)) / variance, best_px)


def _shifted_back(request: Request, keyframes: tuple[Keyframe, ...], shift: Array) -> tuple[Keyframe, ...]:
    c = request.camera
    return tuple(
        seen_through(replace(c, cx_px=c.cx_px + c.fx_px * x, cy_px=c.cy_px + c.fy_px * y), k)
        for k, (x, y) in zip(keyframes, shift.tolist(), strict=True)
    )
