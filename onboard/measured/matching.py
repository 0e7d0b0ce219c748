"""A place's inverse depth to a part of a step and its error: least-squares matching in all views at once. (29.7)

The clicked patch and each view's are taken at mean zero and length one. What is left between them, r, a step of the
inverse depth or of the surface's slope explains by J.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from onboard.geometry.robust import student_widening
from onboard.measured.patches import Patch, Values, by_inverse_depth, by_view, shifted
from onboard.measured.views import Features, View

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

ROUNDS = 3
SMALL_STEP = 0.1  # sigmas of the pictures' noise: another round would change nothing
LEAST_NOISE = 1e-4  # squared, of a patch of length one: no two pictures agree better
MOST_STEP = 0.05  # of the inverse depth, relative: what runs farther has found another place
SLOPE_SIGMA = 1.0  # of d ln w / d (x, y) about the ground's or the picture's: a roof of 45 degrees seen from above


@dataclass(frozen=True, eq=False)
class Match:
    """Inverse depth (1/m), the surface's slope, and the parts of the depth's variance: the pictures' noise, the poses
    of the views. `rest`: by how much more than by both the views contradict each other, squared, over what is expected.

    `toward_set`: by how much of itself the depth changes to have the errors that the set's features have in common, and
    `by_common`, the variance of that and of what the camera's own errors do.
    """

    inverse_depth_per_m: float
    slope: Array
    by_pictures: float
    by_poses: float
    rest: float
    toward_set: float
    by_common: float
    by_surface: float = 0.0  # how uneven the surface is next to the click
    by_edge: float = 0.0  # the ground behind the surface, which the click may be of

    @property
    def sigma_per_m(self) -> float:
        """One sigma of the inverse depth. (29.16)"""
        by_views = (self.by_pictures + self.by_poses) * max(self.rest, 1.0)
        return math.sqrt(by_views + self.by_common + self.by_surface + self.by_edge)


@dataclass(frozen=True, eq=False)
class Row:
    """One view at the present depth and slope, of the n pixels that count."""

    residual: Array  # (n,)
    J: Array  # (n, 3) by inverse depth and slope
    by_pixel: Array  # (n, 2) by the place in the view
    noise: float  # squared, of one pixel of the residual


def matched(
    patch: Patch, views: Sequence[View], features: Features, start: tuple[float, Array], window: Mask
) -> Match | None:
    """Refine an inverse depth and a slope and state the depth's error; None if it runs away.

    `window` (225,): the pixels that count.
    """
    w, slope = start
    prior = np.diag([0.0, SLOPE_SIGMA**-2, SLOPE_SIGMA**-2])
    rows: list[Row] = []
    covariance = prior
    for _ in range(ROUNDS):
        rows = [linearised(patch, view, w, slope, window) for view in views]
        N = prior + sum(row.J.T @ row.J / row.noise for row in rows)
        toward = np.sum([row.J.T @ row.residual / row.noise for row in rows], axis=0) - prior @ [
            0.0,
            *(slope - start[1]),
        ]
        if not N[0, 0] > 0.0:
            return None
        covariance = np.linalg.inv(N)
        step = covariance @ toward
        w, slope = w + float(step[0]), slope + step[1:]
        if not abs(w / start[0] - 1.0) < MOST_STEP:
            return None
        if step[0] ** 2 < SMALL_STEP**2 * covariance[0, 0]:
            break
    return _with_errors(rows, covariance[0], views, features, (patch, w, slope))


def linearised(patch: Patch, view: View, w: float, slope: Array, window: Mask) -> Row:
    """Return the residual between the clicked patch and a view's, and its derivatives. (29.7)"""
    values, by_pixel = shifted(patch, view, w, slope)
    clicked, _ = normalised(patch.values[window])
    seen, length = normalised(values[window])
    g = by_pixel[window]
    g = (g - g.mean(axis=0)) / length
    g -= np.outer(seen, seen @ g)
    along = g @ by_inverse_depth(patch, view, w)
    J = np.column_stack([along, w * along[:, None] * patch.by_offset[window]])
    residual = clicked - seen
    noise = max(float(residual @ residual) / max(len(residual) - 6, 1), LEAST_NOISE / len(residual))
    return Row(residual, J, g, noise)


def normalised(values: Values | Array) -> tuple[Array, float]:
    """Values at mean zero and length one, and their length before."""
    centred = np.asarray(values, float) - float(np.mean(values))
    length = max(float(np.linalg.norm(centred)), 1e-6)
    return centred / length, length


def _with_errors(
    rows: Sequence[Row], by_score: Array, views: Sequence[View], features: Features, found: tuple[Patch, float, Array]
) -> Match:
    """(29.8) to (29.15). `by_score` (3,): the first row of the normal matrix's inverse; `found`: what, w, slope."""
    patch, w, slope = found
    L = [row.J @ by_score / row.noise for row in rows]  # d w / d residual, (n,) of each view
    own = [float(each @ each) * row.noise for each, row in zip(L, rows, strict=True)]
    # Half of the residual's noise is the clicked patch's, the same in all views.
    common = np.sum(L, axis=0)
    noise = float(np.mean([row.noise for row in rows]))
    by_pictures = 0.5 * sum(own) + 0.5 * noise * float(common @ common)
    c, by_camera = _by_views(patch, w, views, [each @ row.by_pixel for each, row in zip(L, rows, strict=True)])
    by_noise = [np.einsum("k,kni->ni", ck, v.by_feature) * v.pixel_sigma_px for ck, v in zip(c, views, strict=True)]
    by_depth = np.sum([ck @ view.by_depth for ck, view in zip(c, views, strict=True)], axis=0)
    posed = [float((each**2).sum()) for each in by_noise]
    half_common = 0.5 * float((np.sum(by_noise, axis=0) ** 2).sum())
    by_poses = 0.5 * sum(posed) + half_common + float((by_depth**2).sum())
    apart = np.array([float(each @ row.residual) for each, row in zip(L, rows, strict=True)])
    free = max(len(rows) - 1, 1)
    rest = float((apart**2 / (np.array(own) + posed)).sum()) / free * float(student_widening(free)) ** 2
    # Minus d ln w by what all features have in common: through the poses, and by the camera's errors of themselves.
    seen = -np.sum([ck @ view.common.by_pose for ck, view in zip(c, views, strict=True)], axis=0) / w
    missing = np.concatenate([[1.0, *patch.rays[0, :2]], by_camera / w]) - seen
    toward_set, unknown = _toward_set(missing, views, features.common_cov)
    return Match(w, slope, by_pictures, by_poses, rest, toward_set, unknown * w * w)


def _by_views(patch: Patch, w: float, views: Sequence[View], by_pixel: Sequence[Array]) -> tuple[list[Array], Array]:
    """Minus d w / d pose, (6,) of each view, and minus d w / d the camera's errors (5,), of all views together.

    `by_pixel`: minus d w / d the click's pixel, (2,) of each view.
    """
    each = [by_view(patch, view, w) for view in views]
    by_pose = [by @ pose for by, (pose, _) in zip(by_pixel, each, strict=True)]
    return by_pose, np.sum([by @ camera for by, (_, camera) in zip(by_pixel, each, strict=True)], axis=0)


def _toward_set(missing: Array, views: Sequence[View], cov: Array) -> tuple[float, float]:
    """The relative change by which a depth that the views give gets the set's common errors, and its variance. (29.15)

    `missing` (8,): what the depth lacks of what is common.
    """
    # All views show the same features, whose own depths are the larger part of their errors: together as one view.
    information = np.mean([view.common.information for view in views], axis=0)
    known = np.linalg.solve(np.eye(len(cov)) + cov @ information, cov)
    common = known @ np.mean([view.common.toward for view in views], axis=0)
    return float(missing @ common), max(float(missing @ known @ missing), 0.0)
