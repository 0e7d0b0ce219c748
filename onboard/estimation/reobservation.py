"""The same ground points in two windows without a common picture: how true the stated relative errors are.

Their places must agree within the covariance of their difference. What a window is off by as a whole is a shift, turn
and scale of its patch of ground; these seven are compared, (16.1) to (16.3). Over a flight their normalised squares
show by how much the published variances are too small: `RelativeVariance`, (16.4). Section 16 of docs/mathematics.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contract.error_correlation import slow_error_correlations
from contract.rotations import skew
from onboard.estimation.solved_window import Solved
from onboard.estimation.variance_components import MEMORY_S
from onboard.geometry.robust import OUTLIER_SIGMAS, median_chi2

Array = NDArray[np.float64]

PARAMETERS = 7  # shift (3), turn (3) and scale of a patch of ground
MIN_COMMON = 12
PRIOR_COUNT = 3.0 * PARAMETERS  # degrees of freedom that "as stated" counts for: three windows' worth
MAX_RATIO = 30.0  # of one comparison's mean square, so that a single wrong window does not speak for the flight


@dataclass(frozen=True)
class Agreement:
    """The disagreement of two windows on their common points: chi-square of seven differences, and the shift."""

    chi2: float  # of PARAMETERS degrees of freedom if both covariances are true, (16.3)
    points: int
    shift_m: float  # length of the patch's shift


@dataclass(frozen=True)
class RelativeVariance:
    """Running estimate of the factor by which true relative variances exceed the stated ones. (16.4)"""

    stamp_ns: int = 0
    found: float = 0.0
    expected: float = 0.0

    @property
    def factor(self) -> float:
        """The factor on variances, at least 1."""
        return max((PRIOR_COUNT + self.found) / (PRIOR_COUNT + self.expected), 1.0)

    @property
    def sigma(self) -> float:
        """One sigma of the factor, by the count of what it rests on."""
        return self.factor * float(np.sqrt(2.0 / (PRIOR_COUNT + self.expected)))

    def with_agreement(self, agreement: Agreement, stamp_ns: int, weight: float) -> RelativeVariance:
        """One more comparison; older ones fade. `weight`: the share of it that the one before did not have."""
        age_s = max(stamp_ns - self.stamp_ns, 0) / 1e9 if self.stamp_ns else 0.0
        keep = float(np.exp(-age_s / MEMORY_S))
        chi2 = min(agreement.chi2, MAX_RATIO * PARAMETERS * self.factor)
        return RelativeVariance(stamp_ns, keep * self.found + weight * chi2, keep * self.expected + weight * PARAMETERS)


def agreement(earlier: Solved, later: Solved) -> Agreement | None:
    """Compare two windows by the points they have in common; None where these are too few.

    Without a picture in common their measurements are independent but for the slow errors, (9.13).
    """
    one, two = earlier.common(later)
    while len(one) >= MIN_COMMON:
        X = earlier.solution.state.points_enu_m[one]
        difference = later.solution.state.points_enu_m[two] - X
        own = earlier.solution.point_covariance[one] + later.solution.point_covariance[two]
        fit, spread, basis, weight = _similarity(X, own)
        q = np.einsum("pij,pj->i", fit, difference)
        left = difference - basis @ q
        square = np.einsum("pi,pij,pj->p", left, weight, left)
        keep = square < OUTLIER_SIGMAS**2 * max(float(np.median(square)) / median_chi2(3), 1.0)
        if np.all(keep):
            break
        one, two = one[keep], two[keep]
    else:
        return None
    total, by_nuisance = spread, []
    for window, at in ((earlier, one), (later, two)):
        D = np.einsum("pij,pjd->id", fit, window.solution.point_gain[at])
        total = total + D @ window.covariance_at(window.keyframes[-1].nav.stamp_ns) @ D.T
        by_nuisance.append(D @ window.shared.by_nuisance)
    correlation = slow_error_correlations(earlier.shared, earlier.span_s, later.shared, later.span_s)
    cross = (by_nuisance[0] * correlation) @ by_nuisance[1].T
    total = total - cross - cross.T
    values, vectors = np.linalg.eigh(0.5 * (total + total.T))
    values = np.maximum(values, np.linalg.eigvalsh(spread)[0])  # never surer than the points' own noise allows
    chi2 = float(np.sum((vectors.T @ q) ** 2 / values))
    return Agreement(chi2, len(difference), float(np.linalg.norm(q[:3])))


def _similarity(X: Array, own: Array) -> tuple[Array, Array, Array, Array]:
    """Weighted fit of (16.1) to differences of points X (P, 3), of covariances `own` (P, 3, 3): H, its covariance, B
    and weights. Turn and scale are in metres at the patch's own radius.
    """
    arm = X - X.mean(axis=0)
    arm = arm / np.sqrt(np.mean(np.sum(arm * arm, axis=1)))
    basis = np.concatenate([np.broadcast_to(np.eye(3), (len(X), 3, 3)), -skew(arm), arm[:, :, None]], axis=2)
    weight = np.linalg.inv(own)
    pull = basis.transpose(0, 2, 1) @ weight  # (P, 7, 3)
    spread: Array = np.linalg.inv(np.sum(pull @ basis, axis=0))
    fit: Array = spread @ pull
    return fit, spread, basis, np.asarray(weight, float)
