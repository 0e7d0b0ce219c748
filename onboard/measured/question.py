"""A set and a pixel -> the same set with the pixel measured: where it is looked for, and how far. (29.17)"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from contract.feature_set import ClickedPixel, FeatureSet, Measured
from contract.locate import Locator
from onboard.events.kept_pictures import KEPT_BYTES, Grey, Pictured
from onboard.measured.matching import Match
from onboard.measured.measuring import Sought, measure
from onboard.measured.patches import Patch
from onboard.measured.views import Features, View, pixels, reach_px, relative_pose, view_of

Array = NDArray[np.float64]

MOST_VIEWS = 8
# How far the other cameras should be from the clicked one at right angles to the ray, in distances to the ground: so
# far that depth is well known, and so near that the surface looks the same.
BASELINES = (0.06, 0.12, 0.2, 0.3)
LEAST_BASELINE, MOST_BASELINE = 0.02, 0.45
MOST_TURN_COS = 0.8  # of the viewing directions
KEPT_VIEWS = 64  # of the last clicked pictures; fewer of pictures so large that they take more than the ring does
# Where a surface may be, as a share of the height above the ground: what stands on it, and a pit.
ABOVE_SHARE, BELOW_SHARE = 0.25, 0.06
SIGMAS = 4.0  # of the ground between the features, at least
UNDER_SIGMAS = 3.0  # a depth below the ground by so many sigmas of the ground is no surface: it moves


class Questions:
    """Measures clicked pixels. Views of a picture that is clicked again are not found again. For one thread."""

    def __init__(self) -> None:
        self._views: OrderedDict[tuple[tuple[int, int], tuple[int, int]], View | None] = OrderedDict()
        self._locator: Locator | None = None  # of the last set
        self._session = -1

    def measured_set(
        self, asked: FeatureSet, uv_px: tuple[float, float], clicked: Pictured | None, others: Sequence[Pictured]
    ) -> FeatureSet:
        """The set as it was asked for, and what became of the pixel. `clicked`: its picture, if that is kept; `others`:
        those that it may be looked for in.
        """
        u, v = (float(np.float32(c)) for c in uv_px)  # as the wire has it
        found = self._measure(asked, np.array([u, v]), clicked, others)
        if isinstance(found, Measured):
            return replace(asked, clicked=ClickedPixel(u, v, found))
        pixel = ClickedPixel(u, v, Measured.MEASURED, found.inverse_depth_per_m, found.sigma_per_m)
        return replace(asked, clicked=pixel)

    def _measure(
        self, asked: FeatureSet, uv_px: Array, kept: Pictured | None, others: Sequence[Pictured]
    ) -> Match | Measured:
        if asked.session != self._session:
            self._views.clear()
            self._session = asked.session
        image = None if kept is None else kept.image
        if image is None:
            return Measured.NO_PICTURE
        if asked.shutter is not None:
            return Measured.ROLLING
        held = self._locator
        if held is None or identity(held.feature_set) != identity(asked):
            held = self._locator = Locator(asked)
        ray, valid = asked.camera.unproject(uv_px)
        patch = Patch.at(image, asked.camera, uv_px) if valid else None
        if patch is None:
            return Measured.BORDER
        sought = where(held, ray[:2])
        if sought is None:
            return Measured.HIDDEN
        features = Features.of(asked)
        ground = sought.ground_per_m
        found = measure(patch, self._seen_by(asked, image, others, ray, ground, features), features, sought)
        if isinstance(found, Match) and found.inverse_depth_per_m < ground * (1.0 - UNDER_SIGMAS * sought.ground_sigma):
            return Measured.MOVES
        return found

    def _seen_by(
        self, asked: FeatureSet, image: Grey, others: Sequence[Pictured], ray: Array, w: float, features: Features
    ) -> list[View]:
        mine = identity(asked)
        out = []
        for other in chosen(asked, others, ray, w):
            key = mine, identity(other.its_set)
            if key not in self._views:
                self._views[key] = _view(asked, image, other, features)
                while len(self._views) > max(min(KEPT_VIEWS, KEPT_BYTES // image.nbytes), MOST_VIEWS):
                    self._views.popitem(last=False)
            self._views.move_to_end(key)
            if (view := self._views[key]) is not None:
                out.append(view)
        return out


def _view(asked: FeatureSet, image: Grey, other: Pictured, features: Features) -> View | None:
    there = other.image
    if there is None or there.shape != image.shape:
        return None
    start = relative_pose(asked, other.its_set)
    return view_of(image, features, there, other.its_set, start, reach_px(asked, other.its_set))


def identity(of: FeatureSet) -> tuple[int, int]:
    return of.frame, of.revision


def where(locator: Locator, xy: Array) -> Sought | None:
    """Return the range to search along a ray x, y about the ground between the features; None where there is none."""
    s = locator.feature_set
    plane = float(s.plane_per_m[0] + xy @ s.plane_per_m[1:])
    r, sigma = locator.between_features(xy)
    w = plane * (1.0 + r)
    if plane <= 0.0 or w <= 0.0:
        return None
    reach = SIGMAS * sigma
    far, near = w * (1.0 - max(BELOW_SHARE, reach)), w / (1.0 - min(max(ABOVE_SHARE, reach), 0.6))
    return Sought(max(far, 0.3 * w), near, w, sigma, s.plane_per_m[1:] / plane)


def chosen(asked: FeatureSet, others: Sequence[Pictured], ray: Array, w: float) -> list[Pictured]:
    """Return at most MOST_VIEWS pictures that show a ray's ground from elsewhere, spread over BASELINES, both sides."""
    size = asked.camera.size_px
    comparable = [o for o in others if o.its_set.shutter is None and o.its_set.camera.size_px == size]
    if not comparable:
        return []
    poses = [relative_pose(asked, other.its_set) for other in comparable]
    R, centres_m = np.stack([R for R, _ in poses]), np.stack([centre_m for _, centre_m in poses])
    direction = ray / np.linalg.norm(ray)
    across = (centres_m - np.outer(centres_m @ direction, direction)) * (w / float(np.linalg.norm(ray)))
    share = np.linalg.norm(across, axis=1)
    seen = np.einsum("nij,nj->ni", R, ray - w * centres_m)
    elsewhere = (share > LEAST_BASELINE) & (share < MOST_BASELINE) & (R[:, 2, 2] > MOST_TURN_COS) & (seen[:, 2] > 0.0)
    rows = [
        i
        for i in np.flatnonzero(elsewhere)
        if comparable[i].its_set.camera.contains(pixels(comparable[i].its_set.camera, seen[None, i])[0])
    ]
    usable = [(share[i] if float(across[i] @ across[rows[0]]) > 0.0 else -share[i], comparable[i]) for i in rows]
    out: dict[int, Pictured] = {}
    for target in (sign * share for share in BASELINES for sign in (1.0, -1.0)):
        left = [(abs(share - target), i) for i, (share, _) in enumerate(usable) if i not in out]
        if left and len(out) < MOST_VIEWS:
            _, i = min(left)
            out[i] = usable[i][1]
    return list(out.values())
