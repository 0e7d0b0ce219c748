"""KLT: Shi-Tomasi features followed by pyramidal Lucas-Kanade, every track verified. The seed's section 2.1.

Shi and Tomasi 1994; Bouguet's pyramidal LK. Two things differ from following picture by picture:

- Each feature is matched against the last *keyframe*, not the last picture. Its error does not grow with the number
  of pictures in between, and a picture that fails (dark, blurred) is simply passed over.
- Before LK starts, the whole picture's motion is known to a few pixels: from telemetry, from the last picture's
  motion, by phase correlation of thumbnails, or by matched descriptors if all that fails. Where that motion turns or
  scales, the picture is warped back first, because LK compares patches by translation alone.

A track is accepted if LK converged, its patch looks the same (LK's own error on the normalised picture) and its motion
agrees with its neighbours'. Where the dispersion of all tracks is too large, none is accepted (`track_consistency`).

At high picture rates a cheaper search comes first: if the last motion, extrapolated, predicted the last picture well,
the next one starts from such a prediction, without phase correlation and with as few pyramid levels as the last
prediction's error requires. Where this finds too few features, the full search is made.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from onboard.geometry.plane_homography import HomographyFit, move
from onboard.geometry.robust import cauchy_weight, middle
from onboard.vision.coarse_flow import flow_disagreement
from onboard.vision.contrast_normalisation import SPREAD, Normaliser, Picture, thumbnail
from onboard.vision.descriptor_matching import Described, describe, motion_between
from onboard.vision.repetitive_texture import repetition_px
from onboard.vision.standing_parts import StandingParts
from onboard.vision.track_consistency import are_inconsistent

Array = NDArray[np.float64]

WINDOW_PX = 21
LEVELS = 3
BORDER_PX = 8.0
# Mean absolute difference of two unlike patches is about 1.1 times their standard deviation; of two equal ones at
# correlation 0.75 half that. It is taken of the patch itself: mere noise is less than the texture aimed at.
MAX_DIFFERENCE = 0.56
MIN_QUALITY = 0.01
MIN_EIGENVALUE = 1e-3
MAX_TURN = 0.06  # rotation (rad) or scale change of a motion above which the picture is warped back before LK
MIN_PEAK = 0.04  # response of phase correlation below which its shift is not used
MIN_TRACKS = 12
CROWDED = 0.7  # of the least distance of new features: nearer ones leave the rest of the picture without any
# Largest error (px) of the extrapolated motion for nine features of ten, and the pyramid levels that are then enough;
# LK on one level finds patches several pixels away, these are the distances at which it does so for practically all.
CALM_LEVELS = ((1.5, 0), (4.0, 1), (8.0, 2))
CALM_SHARE = 0.8  # of the features that should be on the picture; with fewer found again the full search follows
ROUNDS = 5  # of reweighting, at most
# One sigma of telemetry's prediction of the motion between two pictures where only its order counts: a share of that
# motion (at first the ground's height is known no better) and attitude noise, at 640 px width.
PREDICTED_SHARE = 0.15
PREDICTED_PX = 3.0
# On rows: how many sigmas of the prediction a search reaches; and a thousand to one, against the next row.
REACH_SIGMAS, SURE_LOG_ODDS = 3.0, 6.9
GATE_PX = 4.0  # least deviation from the neighbours' motion that condemns a track, at 640 px width


@dataclass(frozen=True, eq=False)
class Tracks:
    """Features found again in one picture: identifiers (N,), pixels here and in the keyframe (N, 2)."""

    ids: NDArray[np.int64]
    uv_px: Array
    keyframe_uv_px: Array
    offered: int  # features that were looked for
    motion: Array  # H (3, 3): keyframe pixel -> this picture

    def __len__(self) -> int:
        return len(self.ids)

    def shown_before(self, size_px: tuple[int, int]) -> float:
        """The share (0 to 1) of this picture that the keyframe showed as well."""
        width, height = size_px
        corners = np.array([[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]]) - 0.5
        both, _ = cv2.intersectConvexConvex(move(self.motion, corners).astype(np.float32), corners.astype(np.float32))
        return float(both) / (width * height)

    def thinned(self, least_px: float) -> Tracks:
        """The tracks but those nearer than this to an older one: while the camera climbs, all features converge."""
        apart_px = np.linalg.norm(self.uv_px[:, None] - self.uv_px, axis=2)
        kept = np.ones(len(self), bool)
        for k in range(1, len(self)):
            kept[k] = not np.any(kept[:k] & (apart_px[k, :k] < least_px))
        return replace(self, ids=self.ids[kept], uv_px=self.uv_px[kept], keyframe_uv_px=self.keyframe_uv_px[kept])


def is_nearest(spacing_px: float, miss_px: float, sigma_px: float) -> bool:
    """Return whether tracks that lie so far from their prediction are no row off, on rows this far apart. (4.5)

    A miss that is larger than its sigma is evidence of a larger one.
    """
    log_odds = 0.5 * spacing_px * (spacing_px - 2.0 * miss_px) / max(sigma_px, miss_px, 1e-6) ** 2
    return log_odds > SURE_LOG_ODDS


class Tracker:
    """Holds the keyframe's picture and features; `track` looks for them, `promote` makes a picture the keyframe."""

    def __init__(self, size_px: tuple[int, int], features: int, min_distance_px: float = 0.0) -> None:
        self.width_px, self.height_px = size_px
        self.features = features
        spacing = np.sqrt(self.width_px * self.height_px / features)
        self.min_distance_px = min_distance_px or float(max(4.0, 0.45 * spacing))
        self._picture: Picture | None = None
        self._thumbnail: NDArray[np.float32] | None = None
        self._described: Described | None = None  # the keyframe's, once it was asked for
        self._ids = np.zeros(0, np.int64)
        self._uv = np.zeros((0, 2))
        self._contrast = np.zeros(0)  # grey levels, one sigma of each feature's patch in the keyframe
        self._next_id = 0
        self._current: Picture | None = None
        self._newest: Picture | None = None  # the same as it came
        self._motion = np.eye(3)  # keyframe -> the last picture that was followed
        self._predicted: Array | None = None  # the same as it was predicted
        self._step = np.eye(3)  # the last picture's motion since the one before
        self._levels: int | None = None  # pyramid levels that the extrapolated motion needs; None: full search
        self._hann: NDArray[np.float32] | None = None
        self._normalise = Normaliser(size_px)
        self._repetition_px: float | None = None  # at which the keyframe repeats itself, if it does
        self.is_ambiguous = False  # whether the last picture's tracks were given up because they may be a row off
        self._standing = StandingParts(size_px)
        self._masked: NDArray[np.bool_] | None = None  # (H, W) what is no ground, as configured
        self._burned_in: NDArray[np.bool_] | None = None  # the same with what has been found to stand still
        self._usable: NDArray[np.bool_] | None = None  # (H, W) pixels whose whole window is ground
        self.flow_disagreement_px: Array | None = None  # (2,) `coarse_flow` since the keyframe before the present one

    def leave_out(self, burned_in: NDArray[np.bool_]) -> None:
        """Take no feature where (H, W) something is burned into every picture, nor where a window would hold it."""
        self._masked = burned_in
        self._leave_out_all()

    def _leave_out_all(self) -> None:
        """Leave out the parts that are configured and those found to stand still."""
        burned_in = self._standing.mask if self._masked is None else self._standing.mask | self._masked
        self._burned_in = burned_in
        window = np.ones((WINDOW_PX, WINDOW_PX), np.uint8)
        self._usable = np.asarray(cv2.dilate(burned_in.astype(np.uint8), window)) == 0

    @property
    def left_out_shares(self) -> tuple[float, float]:
        """Shares (0 to 1) of the picture: as configured, and found to stand still while the ground moves."""
        return 0.0 if self._masked is None else float(self._masked.mean()), self._standing.share

    @property
    def has_keyframe(self) -> bool:
        return self._picture is not None

    @property
    def is_repeating(self) -> bool:
        """True if the keyframe's ground repeats itself: its tracks may be off by a row."""
        return self._repetition_px is not None

    @property
    def keyframe_features(self) -> tuple[NDArray[np.int64], Array]:
        """Identifiers (N,) and pixels (N, 2) of the keyframe's features, tracked ones and new ones."""
        return self._ids, self._uv

    def track(self, image: Picture, predicted: Array | None, sigma_px: float | None = None) -> Tracks:
        """Look for the keyframe's features in a grey picture (H, W). `predicted`: H (3, 3) from keyframe, or None.

        `sigma_px`: one sigma of what was predicted since the last picture that was followed. Ground that repeats itself
        is not followed without it.
        """
        tracks = self._find_again(image, predicted, sigma_px)
        if self._standing.see(image, (tracks.motion if len(tracks) else None, predicted)):
            self._leave_out_all()
        return tracks

    def _find_again(self, image: Picture, predicted: Array | None, sigma_px: float | None) -> Tracks:
        self._newest, self.is_ambiguous = image, False
        self._current = self._normalised(image)
        if self._picture is None or not len(self._ids):
            return self.nothing()
        carried_on = self._carry_on(predicted)
        if self._repetition_px is None:
            best = self._follow_anywhere(carried_on, predicted)
        else:
            best = self._follow_nearest(carried_on, predicted, sigma_px)
        self._levels = None
        if len(best) >= MIN_TRACKS:
            if self._is_plenty(best):
                surprise = np.linalg.norm(move(carried_on, best.keyframe_uv_px) - best.uv_px, axis=1)
                ninth = 9 * len(best) // 10
                off_px = float(np.partition(surprise, ninth)[ninth])
                self._levels = next((levels for limit_px, levels in CALM_LEVELS if off_px < limit_px), None)
            self._step = best.motion @ np.linalg.inv(self._motion)
            self._motion, self._predicted = best.motion, predicted
        return best

    def _normalised(self, image: Picture) -> Picture:
        """The normalised picture, plain grey where something is burned in: else it would be tracked as ground."""
        out = self._normalise(image)
        if self._burned_in is not None:
            out[self._burned_in] = 128
        return out

    def _relocate(self) -> Tracks:
        """Track from the motion that matched descriptors give; tried last, because it costs most."""
        assert self._picture is not None and self._current is not None
        if self._described is None:
            self._described = describe(self._picture)
        motion = motion_between(self._described, describe(self._current), self.width_px)
        return self.nothing() if motion is None else self._follow(motion, LEVELS)

    def _carry_on(self, predicted: Array | None) -> Array:
        """The last picture's motion extrapolated: by telemetry's change since then, else by the same step again."""
        if predicted is None or self._predicted is None:
            step = self._step
        else:
            step = predicted @ np.linalg.inv(self._predicted)
        out: Array = step @ self._motion
        out /= out[2, 2]
        return out

    def _follow_anywhere(self, carried_on: Array, predicted: Array | None) -> Tracks:
        """Search from every start that there is, as far as one is needed."""
        best = self.nothing()
        if self._levels is not None:
            best = self._follow(carried_on, self._levels)
        if not self._is_plenty(best):
            for start in [self._motion] if predicted is None else [predicted, self._motion]:
                found = self._follow(self._align(start), LEVELS)
                if len(found) > len(best):
                    best = found
                if len(found) >= max(MIN_TRACKS, 0.5 * len(self._ids)):
                    break
        if len(best) < MIN_TRACKS or self._are_inconsistent(best):  # so is a start that misses half of the picture
            best = self._relocate()
            if len(best) >= MIN_TRACKS and self._are_inconsistent(best):
                best = self.nothing()
        return best

    def _follow_nearest(self, carried_on: Array, predicted: Array | None, sigma_px: float | None) -> Tracks:
        """Return the tracks nearest to the prediction, on repetitive ground, if that excludes those of a row away.

        Nothing but the prediction gives a start: phase correlation and descriptors take one row for another.
        """
        start = carried_on if predicted is None or self._predicted is not None else predicted
        reach_px = np.inf if sigma_px is None else REACH_SIGMAS * sigma_px
        levels = next((levels for limit_px, levels in CALM_LEVELS if reach_px < limit_px), LEVELS)
        tracks = self._follow(start, levels)
        if len(tracks) < MIN_TRACKS:
            self.is_ambiguous = len(self._follow(self._align(start), LEVELS)) >= MIN_TRACKS
            return self.nothing()
        miss = tracks.uv_px - move(start, tracks.keyframe_uv_px)
        miss_px = float(np.hypot(middle(miss[:, 0]), middle(miss[:, 1])))
        assert self._repetition_px is not None
        is_sure = sigma_px is not None and is_nearest(self._repetition_px, miss_px, sigma_px)
        if predicted is None or not is_sure or self._are_inconsistent(tracks):
            self.is_ambiguous = True
            return self.nothing()
        return tracks

    def _is_plenty(self, tracks: Tracks) -> bool:
        """Return whether nearly all features were found again that should be on the picture."""
        return len(tracks) >= max(MIN_TRACKS, CALM_SHARE * self._expected(tracks.motion))

    def _expected(self, motion: Array) -> int:
        """The number of features that should be on the picture; at least one."""
        return max(int(np.count_nonzero(self._inside(move(motion, self._uv)))), 1)

    def _are_inconsistent(self, tracks: Tracks) -> bool:
        share = len(tracks) / self._expected(tracks.motion)
        return are_inconsistent(tracks.motion, tracks.keyframe_uv_px, tracks.uv_px, share, self.width_px)

    def promote(self, tracks: Tracks) -> tuple[NDArray[np.int64], Array]:
        """Make the last picture the keyframe: keep `tracks`, but for crowded ones, and fill up with new features.

        All ids and pixels.
        """
        if self._current is None:
            raise RuntimeError("promote() before track(): there is no picture yet")
        self.flow_disagreement_px = None
        if self._picture is not None and len(tracks):
            self.flow_disagreement_px = flow_disagreement(
                self._picture, self._current, tracks.motion, tracks.keyframe_uv_px, tracks.uv_px
            )
        if self._newest is not None and not len(tracks):
            self._standing.begin(self._newest)
        else:
            self._standing.new_keyframe(tracks.motion)
        tracks = tracks.thinned(CROWDED * self.min_distance_px)
        self._picture, self._thumbnail, self._described = self._current, None, None
        self._motion = np.eye(3)
        self._predicted = None if self._predicted is None else np.eye(3)
        fresh = self._detect(tracks.uv_px, self.features - len(tracks))
        ids = self._next_id + np.arange(len(fresh))
        self._next_id += len(fresh)
        self._ids = np.concatenate([tracks.ids, ids]).astype(np.int64)
        self._uv = np.concatenate([tracks.uv_px, fresh])
        self._contrast = np.minimum(_contrast(self._picture, self._uv), SPREAD)
        self._repetition_px = repetition_px(self._picture, self._uv)
        return self._ids, self._uv

    def forget(self) -> None:
        """Drop the keyframe: the next picture starts again."""
        self._picture = self._thumbnail = self._described = None
        self._ids, self._uv = np.zeros(0, np.int64), np.zeros((0, 2))
        self._motion, self._step = np.eye(3), np.eye(3)
        self._predicted = self._levels = None

    def nothing(self) -> Tracks:
        """No track at all: what a picture that cannot be followed gives, and what a new start is promoted with."""
        return Tracks(np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 2)), len(self._ids), np.eye(3))

    def _align(self, start: Array) -> Array:
        """Refine a whole-picture motion by phase correlation of thumbnails, the current one warped back by it."""
        assert self._picture is not None and self._current is not None
        if self._thumbnail is None:
            self._thumbnail = thumbnail(self._picture)
        small = self._thumbnail
        current = thumbnail(self._current)
        rows, columns = small.shape
        shrink = np.diag([columns / self.width_px, rows / self.height_px, 1.0])
        H_small = shrink @ start @ np.linalg.inv(shrink)
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        warped = cv2.warpPerspective(
            current, H_small, (columns, rows), flags=flags, borderMode=cv2.BORDER_CONSTANT, borderValue=(128.0,)
        )
        if self._hann is None or self._hann.shape != small.shape:
            self._hann = np.asarray(cv2.createHanningWindow((columns, rows), cv2.CV_32F), np.float32)
        (dx, dy), response = cv2.phaseCorrelate(small - 128.0, warped - 128.0, self._hann)
        if response < MIN_PEAK:
            return start
        shift = np.eye(3)
        shift[:2, 2] = dx * self.width_px / columns, dy * self.height_px / rows
        return start @ shift

    def _follow(self, motion: Array, levels: int) -> Tracks:
        """LK from the keyframe into the current picture around a known whole-picture motion, then verification."""
        assert self._picture is not None and self._current is not None
        turns = _turn(motion, self.width_px, self.height_px) > MAX_TURN
        target, back = self._current, np.eye(3)
        if turns:
            flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
            target = np.asarray(
                cv2.warpPerspective(
                    self._current, motion, (self.width_px, self.height_px), flags=flags, borderMode=cv2.BORDER_REPLICATE
                ),
                np.uint8,
            )
            back = motion
        guess = self._uv if turns else move(motion, self._uv)
        expected = move(motion, self._uv)
        inside = self._inside(expected)
        if np.count_nonzero(inside) < MIN_TRACKS:
            return self.nothing()
        start = self._uv[inside].astype(np.float32)
        end, status, difference = cv2.calcOpticalFlowPyrLK(
            self._picture,
            target,
            start,
            guess[inside].astype(np.float32).copy(),
            winSize=(WINDOW_PX, WINDOW_PX),
            maxLevel=levels,
            criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 20, 0.01),
            flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
            minEigThreshold=MIN_EIGENVALUE,
        )
        uv = move(back, np.asarray(end, float)) if turns else np.asarray(end, float)
        found = status[:, 0] == 1
        difference = np.where(found, difference[:, 0], np.float32(np.inf))  # uninitialised for the others
        accepted = found & (difference < MAX_DIFFERENCE * self._contrast[inside]) & self._inside(uv)
        keep = np.flatnonzero(accepted)
        if len(keep) < MIN_TRACKS:
            return self.nothing()
        at = self._uv[inside]
        H, agree = self._agreement(at[keep], uv[keep])
        keep = keep[agree]
        if len(keep) < MIN_TRACKS:
            return self.nothing()
        return Tracks(self._ids[inside][keep], uv[keep], at[keep], len(self._ids), H)

    def _agreement(self, at: Array, to: Array) -> tuple[Array, NDArray[np.bool_]]:
        """A homography through the tracks by reweighted least squares, and which tracks follow it.

        Rough ground moves tracks off it smoothly; the gate is therefore relative to the others, never under GATE_PX.
        """
        floor = GATE_PX * self.width_px / 640.0
        fit = HomographyFit(at, to)
        weight = np.ones(len(at))
        spread = np.inf
        for _ in range(ROUNDS):
            miss = fit.solve(weight)
            before, spread = spread, 1.4826 * middle(miss)
            # Settled: neither outliers nor the spread they are judged by will change any more.
            if spread > 0.9 * before:
                break
            weight = cauchy_weight(miss, max(spread, 0.2))
        return fit.H, miss < max(floor, 4.0 * spread)

    def _inside(self, uv: Array) -> NDArray[np.bool_]:
        u, v = uv[:, 0], uv[:, 1]
        out: NDArray[np.bool_] = (
            (u > BORDER_PX) & (v > BORDER_PX) & (u < self.width_px - BORDER_PX) & (v < self.height_px - BORDER_PX)
        )
        if self._usable is not None:
            out[out] = self._usable[np.rint(v[out]).astype(np.intp), np.rint(u[out]).astype(np.intp)]
        return out

    def _detect(self, taken: Array, wanted: int) -> Array:
        """Up to `wanted` new Shi-Tomasi corners (N, 2), apart from `taken` and each other, spread over the picture."""
        if wanted <= 0 or self._picture is None:
            return np.zeros((0, 2))
        mask = np.full((self.height_px, self.width_px), 0, np.uint8)
        b = int(BORDER_PX) + 2
        mask[b:-b, b:-b] = 255
        if self._usable is not None:
            mask[~self._usable] = 0
        radius = int(self.min_distance_px)
        for u, v in taken:
            cv2.circle(mask, (round(float(u)), round(float(v))), radius, 0, -1)
        smooth = cv2.GaussianBlur(self._picture, (3, 3), 0.8)
        corners = cv2.goodFeaturesToTrack(
            smooth,
            maxCorners=4 * wanted,
            qualityLevel=MIN_QUALITY,
            minDistance=self.min_distance_px,
            mask=mask,
            blockSize=7,
        )
        if corners is None:
            return np.zeros((0, 2))
        found = np.asarray(corners, float).reshape(-1, 2)
        return found[_spread_out(found, taken, wanted, (self.width_px, self.height_px))]


def _spread_out(found: Array, taken: Array, wanted: int, size_px: tuple[int, int]) -> NDArray[np.intp]:
    """Indices of those of `found` (best first) that cover the picture evenly: the emptiest cell comes first."""
    if len(found) <= wanted:
        return np.arange(len(found))
    cells = np.array([8, 6])
    cell = np.minimum((found / size_px * cells).astype(int), cells - 1) @ [1, 8]
    filled = np.zeros(48, int)
    if len(taken):
        at = np.clip((taken / size_px * cells).astype(int), 0, cells - 1) @ [1, 8]
        filled += np.bincount(at, minlength=48)
    # A corner's rank is how full its cell is when its turn comes; ties go to the stronger corner.
    rank = np.empty(len(found), int)
    seen = filled.copy()
    for i, c in enumerate(cell):
        rank[i] = seen[c]
        seen[c] += 1
    return np.sort(np.argsort(rank, kind="stable")[:wanted])


def _contrast(picture: Picture, uv: Array) -> Array:
    """Standard deviation of the picture in LK's window around pixels (N, 2), grey levels."""
    reach = np.arange(WINDOW_PX) - WINDOW_PX // 2
    height, width = picture.shape
    at = np.rint(uv).astype(np.intp)
    rows = np.clip(at[:, 1, None] + reach, 0, height - 1)
    columns = np.clip(at[:, 0, None] + reach, 0, width - 1)
    out: Array = picture[rows[:, :, None], columns[:, None, :]].std(axis=(1, 2))
    return out


def _turn(H: Array, width_px: int, height_px: int) -> float:
    """The largest deviation of a homography's linear part, at the picture's middle, from the identity."""
    middle = np.array([width_px / 2.0, height_px / 2.0])
    steps = middle + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    moved = move(H, steps)
    linear = (moved[1:] - moved[0]).T
    return float(np.abs(linear - np.eye(2)).max())
