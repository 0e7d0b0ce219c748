"""Pairs of looks at the same ground: what scores at a place in one picture, scores there in the next.

Pictures that follow each other are laid over one another by a homography. What makes a rock look like a person in one
picture does so in another: how much looks have in common is fitted in `again.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from training.calibration import logit
from training.labelled_pictures import KINDS, Grey, Labelled
from training.peaks import Judged, Peaks, judge, peaks_of
from training.run_onnx import Maps

Array = NDArray[np.float64]

SUCCESSORS, MOST_NUMBERS = 3, 30  # a picture is compared with so many, none further in number
FEATURES, LEAST_INLIERS, REPROJECTION_PX, LEAST_OVERLAP = 1500, 40, 3.0, 0.4
GATE_PX, SAME_THING_PX, EDGE_PX = 20.0, 10.0, 10.0
STILL_PX = 20.0  # pictures that have moved by less show the ground from the same place
NO_SCORE = 0.005  # of a place without a peak, for the correlation
FALSE_FROM = 0.1  # a false peak's least score in the first look


class Corners(NamedTuple):
    """Corners of a picture: where they are (N, 2) px, and their descriptors (N, 32); its height and width."""

    at_px: Array
    descriptors: Grey
    shape: tuple[int, int]


@dataclass(frozen=True, eq=False)
class Seen:
    """A picture with its corners, and the peaks that the net finds in it."""

    picture: Labelled
    corners: Corners
    peaks: Peaks
    judged: Judged


class Pair(NamedTuple):
    """Scores (N, 2) of the first and the second look at false places and at things, by kind; 0 without a peak."""

    false: list[Array]
    things: list[Array]
    moved_px: float


def seen(picture: Labelled, maps_of: Callable[[Grey], Maps]) -> Seen:
    grey = picture.grey()
    peaks = peaks_of(maps_of(grey))
    return Seen(picture, corners_of(grey), peaks, judge(peaks, picture.things, picture.left_open))


def corners_of(grey: Grey) -> Corners:
    even = cv2.createCLAHE(2.0, (8, 8)).apply(grey)
    points, descriptors = cv2.ORB.create(FEATURES, fastThreshold=5).detectAndCompute(even, None)
    known = np.zeros((0, 32), np.uint8) if descriptors is None else np.asarray(descriptors, dtype=np.uint8)
    at = np.array([point.pt for point in points], dtype=np.float64).reshape(-1, 2)
    return Corners(at, known, (grey.shape[0], grey.shape[1]))


def overlay(one: Corners, other: Corners) -> Array | None:
    """Return the homography (3, 3) from one picture to another, none unless both show enough of the same ground."""
    matches = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(one.descriptors, other.descriptors)
    if len(matches) < LEAST_INLIERS:
        return None
    p, q = one.at_px[[m.queryIdx for m in matches]], other.at_px[[m.trainIdx for m in matches]]
    H, inliers = cv2.findHomography(p, q, cv2.RANSAC, REPROJECTION_PX)
    if H is None or int(inliers.sum()) < LEAST_INLIERS or abs(np.linalg.det(H)) < 1e-6:
        return None
    height, width = one.shape
    shown = cv2.warpPerspective(np.ones(other.shape, np.uint8), np.linalg.inv(H), (width, height))
    return np.asarray(H, dtype=np.float64) if float(shown.mean()) >= LEAST_OVERLAP else None


def carried(points: Array, H: Array) -> Array:
    """Return points (N, 2) in the other picture."""
    w = points @ H[:, :2].T + H[:, 2]
    return np.asarray(w[:, :2] / w[:, 2:], dtype=np.float64)


def inside(points: Array, shape: tuple[int, int]) -> NDArray[np.bool_]:
    height, width = shape
    return np.asarray(((points > EDGE_PX) & (points < np.array([width, height]) - EDGE_PX)).all(1))


def is_near_a_thing(points: Array, picture: Labelled) -> NDArray[np.bool_]:
    """Return which points (N, 2) have a thing of any kind, or what the labels leave open, within the gate."""
    left, top = picture.things[:, 1] - picture.things[:, 3] / 2, picture.things[:, 2] - picture.things[:, 4] / 2
    boxes = np.vstack([np.c_[left, top, left + picture.things[:, 3], top + picture.things[:, 4]], picture.left_open])
    low, high = points[:, None] - boxes[None, :, :2], boxes[None, :, 2:] - points[:, None]
    return np.asarray((np.minimum(low, high).min(2) > -GATE_PX).any(1))


def false_places(one: Seen, other: Seen, H: Array, kind: int) -> Array:
    """Return the scores (N, 2) of false peaks of `one`, and of the highest peak within the gate in `other`."""
    peaks = one.peaks
    false = (peaks.kind == kind) & (peaks.score >= FALSE_FROM) & one.judged.counts & (one.judged.thing < 0)
    points = peaks.middle_px[false]
    there = carried(points, H)
    kept = (
        inside(there, other.corners.shape)
        & ~is_near_a_thing(points, one.picture)
        & ~is_near_a_thing(there, other.picture)
    )
    of_kind = other.peaks.kind == kind
    gap = np.linalg.norm(there[:, None] - other.peaks.middle_px[None, of_kind], axis=2)
    again = np.where(gap < GATE_PX, other.peaks.score[None, of_kind], 0.0).max(1, initial=0.0)
    return np.stack([peaks.score[false], again], 1)[kept]


def same_things(one: Seen, other: Seen, H: Array, kind: int) -> Array:
    """Return the scores (N, 2) of things that are labelled at the same place in both pictures, 0 where missed."""
    ours, theirs = (np.flatnonzero(s.picture.things[:, 0] == kind) for s in (one, other))
    if len(ours) == 0 or len(theirs) == 0:
        return np.zeros((0, 2))
    there = carried(one.picture.things[ours, 1:3], H)
    gap = np.linalg.norm(there[:, None] - other.picture.things[None, theirs, 1:3], axis=2)
    near = gap.argmin(1)
    mutual = (gap.argmin(0)[near] == np.arange(len(ours))) & (gap.min(1) < SAME_THING_PX)
    found = one.judged.found_by[ours[mutual]], other.judged.found_by[theirs[near[mutual]]]
    scores = [
        np.where(by >= 0, np.append(s.peaks.score, 0.0)[by], 0.0) for by, s in zip(found, (one, other), strict=True)
    ]
    return np.stack(scores, 1)


def pairs_of(pictures: Sequence[Labelled], maps_of: Callable[[Grey], Maps]) -> list[Pair]:
    """Return what pictures and their successors have in common, each pair in both orders."""
    pairs: list[Pair] = []
    before: list[Seen] = []
    for picture in pictures:
        now = seen(picture, maps_of)
        for earlier in before:
            is_close = picture.number - earlier.picture.number <= MOST_NUMBERS
            H = overlay(earlier.corners, now.corners) if is_close else None
            if H is None:
                continue
            middle = np.array([now.corners.shape[::-1]]) / 2.0
            moved = float(np.linalg.norm(carried(middle, H) - middle))
            for one, other, M in ((earlier, now, H), (now, earlier, np.asarray(np.linalg.inv(H), dtype=np.float64))):
                kinds = range(len(KINDS))
                false = [false_places(one, other, M, kind) for kind in kinds]
                pairs.append(Pair(false, [same_things(one, other, M, kind) for kind in kinds], moved))
        before = [*before[1 - SUCCESSORS :], now]
    return pairs


def moved_pairs(pairs: Sequence[Pair]) -> list[Pair]:
    """Return the pairs between which the camera has moved: the others are almost the same picture."""
    return [pair for pair in pairs if pair.moved_px >= STILL_PX]


def of_kind(pairs: Sequence[Pair], kind: int) -> tuple[Array, Array]:
    """Return the scores (N, 2) of false places and of things of all pairs."""
    none = np.zeros((0, 2))
    return np.vstack([none, *(p.false[kind] for p in pairs)]), np.vstack([none, *(p.things[kind] for p in pairs)])


def correlation(scores: Array) -> float | None:
    """Return the correlation of the logits of scores (N, 2), none of fewer than ten."""
    if len(scores) < 10:
        return None
    first, second = logit(np.maximum(scores, NO_SCORE)).T
    both = np.r_[first, second], np.r_[second, first]  # neither look is the first
    return round(float(np.corrcoef(*both)[0, 1]), 3)
