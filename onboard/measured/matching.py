"""A place's inverse depth to a part of a step and its error: least-squares matching in all views at once. (29.7)

The clicked patch and each view's are taken at mean zero and length one. What is left between them, r, a step of the
inverse depth or of the surface's slope explains by J, a wrong pose of the view by P.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from onboard.measured.patches import Patch, Values, by_inverse_depth, by_offset, shifted
from onboard.measured.views import Features, View

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

ROUNDS = 3
LEAST_NOISE = 1e-4  # squared, of a patch of length one: no two pictures agree better
MOST_STEP = 0.05  # of the inverse depth, relative: what runs farther has found another place
SLOPE_SIGMA = 1.0  # of d ln w / d (x, y) about the ground's or the picture's: a roof of 45 degrees seen from above


@dataclass(frozen=True, eq=False)
class Match:
    """Inverse depth (1/m), the surface's slope, and the parts of the depth's variance: the pictures' noise, the poses
    of the views. `rest`: by how much more than by both the views contradict each other, squared, over what is expected.

    `toward_set`: by how much of itself the depth changes to have the errors that the set's features have in common, and
    `by_modes`, the variance of that. `across_sigmas`: how far the views' patches lie off their epipolar lines, in
    sigmas, root mean square.
    """

    inverse_depth_per_m: float
    slope: Array
    by_pictures: float
    by_poses: float
    rest: float
    across_sigmas: float
    toward_set: float
    by_modes: float
    by_surface: float = 0.0  # how uneven the surface is next to the click

    @property
    def sigma_per_m(self) -> float:
        """One sigma of the inverse depth. (29.14)"""
        return math.sqrt((self.by_pictures + self.by_poses) * max(self.rest, 1.0) + self.by_modes + self.by_surface)


@dataclass(frozen=True, eq=False)
class Row:
    """One view at the present depth and slope, of the n pixels that count."""

    residual: Array  # (n,)
    J: Array  # (n, 3) by inverse depth and slope
    P: Array  # (n, 6) by the view's pose
    across: Array  # (n,) by a pixel at right angles to the epipolar line
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
    return _with_errors(rows, covariance[0], views, features, (patch.rays[0], w, slope))


def linearised(patch: Patch, view: View, w: float, slope: Array, window: Mask) -> Row:
    """Return the residual between the clicked patch and a view's, and its derivatives. (29.7)"""
    values, by_pixel = shifted(patch, view, w, slope)
    clicked, _ = normalised(patch.values[window])
    seen, length = normalised(values[window])
    g = by_pixel[window]
    g = (g - g.mean(axis=0)) / length
    g -= np.outer(seen, seen @ g)
    b, A = by_inverse_depth(patch, view, w)
    along = g @ b
    J = np.column_stack([along, w * along[:, None] * by_offset(patch)[window]])
    residual = clicked - seen
    noise = max(float(residual @ residual) / max(len(residual) - 6, 1), LEAST_NOISE / len(residual))
    normal = np.array([-b[1], b[0]]) / max(float(np.hypot(*b)), 1e-12)
    return Row(residual, J, g @ A, g @ normal, noise)


def normalised(values: Values | Array) -> tuple[Array, float]:
    """Values at mean zero and length one, and their length before."""
    centred = np.asarray(values, float) - float(np.mean(values))
    length = max(float(np.linalg.norm(centred)), 1e-6)
    return centred / length, length


def _with_errors(
    rows: Sequence[Row], by_score: Array, views: Sequence[View], features: Features, found: tuple[Array, float, Array]
) -> Match:
    """(29.8) to (29.13). `by_score` (3,): the first row of the normal matrix's inverse; `found`: ray, w, slope."""
    ray, w, slope = found
    L = [row.J @ by_score / row.noise for row in rows]  # d w / d residual, (n,) of each view
    own = [float(each @ each) * row.noise for each, row in zip(L, rows, strict=True)]
    # Half of the residual's noise is the clicked patch's, the same in all views.
    common = np.sum(L, axis=0)
    noise = float(np.mean([row.noise for row in rows]))
    by_pictures = 0.5 * sum(own) + 0.5 * noise * float(common @ common)
    c = [each @ row.P for each, row in zip(L, rows, strict=True)]  # d w / d pose, (6,)
    by_noise = [np.einsum("k,kni->ni", ck, v.by_feature) * v.pixel_sigma_px for ck, v in zip(c, views, strict=True)]
    by_depth = np.sum([ck @ view.by_depth for ck, view in zip(c, views, strict=True)], axis=0)
    posed = [float((each**2).sum()) for each in by_noise]
    half_common = 0.5 * float((np.sum(by_noise, axis=0) ** 2).sum())
    by_poses = 0.5 * sum(posed) + half_common + float((by_depth**2).sum())
    apart = np.array([float(each @ row.residual) for each, row in zip(L, rows, strict=True)])
    free = max(len(rows) - 1, 1)
    # So few differences know their variance badly: widened so that 1.645 sigmas hold 90 % of Student's t.
    student = float(stdtrit(free, 0.95)) / 1.645
    rest = float((apart**2 / (np.array(own) + posed)).sum()) / free * student**2
    toward_set, unknown = _toward_set(ray, c, w, views, features.modes_cov)
    return Match(w, slope, by_pictures, by_poses, rest, _across(rows), toward_set, unknown * w * w)


def _toward_set(
    ray: Array, by_poses: Sequence[Array], w: float, views: Sequence[View], cov: Array
) -> tuple[float, float]:
    """The relative change by which a depth that the views give gets the set's common errors, and its variance. (29.13)

    `by_poses`: d w / d pose, (6,) of each view, with the opposite sign.
    """
    seen = -np.sum([ck @ view.modes.by_pose for ck, view in zip(by_poses, views, strict=True)], axis=0) / w
    missing = np.array([1.0, *ray[:2]]) - seen
    # All views show the same features, whose own depths are the larger part of their errors: together as one view.
    information = np.mean([view.modes.information for view in views], axis=0)
    known = np.linalg.solve(np.eye(3) + cov @ information, cov)
    modes = known @ np.mean([view.modes.toward for view in views], axis=0)
    return float(missing @ modes), max(float(missing @ known @ missing), 0.0)


def _across(rows: Sequence[Row]) -> float:
    out = []
    for row in rows:
        information = float(row.across @ row.across)
        along = row.J[:, 0]
        free = row.across - along * float(along @ row.across) / max(float(along @ along), 1e-30)
        left = float(free @ free)
        if left > 1e-3 * information:
            out.append(float(free @ row.residual) / np.sqrt(left * row.noise))
    return float(np.sqrt(np.mean(np.square(out)))) if out else 0.0
