"""Heights and gradients of the ground by place, as earlier windows of the flight found them; (16.5).

The ground does not move: a window that puts it elsewhere than its neighbours did is wrong, or they were. The memory is
bounded, and it can be wrong itself (the first window may be the turned-over one): patches that are refused are kept
aside, and when they agree among themselves over more time than one window spans, they take the memory's place.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from onboard.estimation.solved_window import Solved

Array = NDArray[np.float64]

REMEMBERED = 48  # patches
MAX_SIGMAS = 5.0
REACH = 3.0  # radii of both patches: ground farther apart says little
NEEDED = 3  # refused patches that agree with each other before they are believed
LASTING_S = 1.5  # of the longer of their windows, from the first of them to the last: they then share no picture


@dataclass(frozen=True, eq=False)
class GroundPatch:
    """The ground under one window: centre east, north (m), height there and gradient, with their covariance."""

    centre_m: Array  # (2,)
    height_m: float
    slope: Array  # (2,) east, north
    covariance: Array  # (3, 3) of height, slope east, slope north
    radius_m: float
    start_s: float
    end_s: float

    @classmethod
    def of(cls, solved: Solved) -> GroundPatch:
        """Least squares over the window's points, with the covariance that their common errors give it."""
        s = solved.solution
        points = s.state.points_enu_m[solved.good]
        centre = points[:, :2].mean(axis=0)
        arm = points[:, :2] - centre
        rows = np.concatenate([np.ones((len(points), 1)), arm], axis=1)
        N = rows.T @ rows
        fit = np.linalg.solve(N + 1e-9 * np.trace(N) * np.eye(3), rows.T)  # (3, P)
        height, slope_e, slope_n = (fit @ points[:, 2]).tolist()
        slope = np.array([slope_e, slope_n])
        # A point that moves sideways on a slope is another place of it: what counts is its height over the plane.
        normal = np.array([-slope_e, -slope_n, 1.0])
        by_state = fit @ np.einsum("i,pid->pd", normal, s.point_gain[solved.good])
        covariance = by_state @ solved.covariance_at(solved.keyframes[-1].nav.stamp_ns) @ by_state.T
        own = np.einsum("i,pij,j->p", normal, s.point_covariance[solved.good], normal)
        covariance = (covariance + (fit * own) @ fit.T) * solved.variance_factor
        radius = max(float(np.sqrt(np.mean(np.sum(arm * arm, axis=1)))), 1.0)
        return cls(centre, height, slope, covariance, radius, *solved.span_s)

    def differs(self, other: GroundPatch, slope_sigma_deg: float, relief_m: float) -> str | None:
        """In words if height or gradient contradict another patch's, None if not or if that is too far away. (16.5)"""
        d = self.centre_m - other.centre_m
        distance = float(np.linalg.norm(d))
        radius = max(self.radius_m, other.radius_m)
        if distance > REACH * (self.radius_m + other.radius_m):
            return None
        half = np.array([1.0, 0.5 * d[0], 0.5 * d[1]])
        back = half * [1.0, -1.0, -1.0]
        step = float(half[1:] @ (self.slope + other.slope))
        miss_m = self.height_m - other.height_m - step
        slope_sigma = float(np.tan(np.radians(slope_sigma_deg)))
        # Patches that overlap share their hills: relief counts as far as they are apart.
        apart = min(distance / radius, 1.0)
        variance = float(back @ self.covariance @ back + half @ other.covariance @ half)
        variance += (slope_sigma * distance) ** 2 + 2.0 * (relief_m * apart) ** 2
        if abs(miss_m) > MAX_SIGMAS * np.sqrt(variance):
            return f"ground off what lies beside it: {miss_m:+.0f} m, sigma {np.sqrt(variance):.0f}"
        turn = self.slope - other.slope
        covariance = (self.covariance + other.covariance)[1:, 1:]
        covariance = covariance + np.eye(2) * 2.0 * (slope_sigma**2 + (relief_m * apart / radius) ** 2)
        if float(turn @ np.linalg.solve(covariance, turn)) > MAX_SIGMAS**2:
            tilt = np.degrees(np.arctan(np.linalg.norm(turn)))
            return f"ground tilted against what lies beside it: {tilt:.0f} degrees"
        return None


@dataclass(frozen=True)
class Home:
    """Home's level, and how far away home may be (m)."""

    height_m: float
    sigma_m: float
    distance_m: float

    def miss(self, patch: GroundPatch, slope_sigma_deg: float, relief_m: float) -> tuple[float, float]:
        """The patch's height over it and its one sigma."""
        away_m = float(np.tan(np.radians(slope_sigma_deg))) * self.distance_m
        variance = float(patch.covariance[0, 0]) + self.sigma_m**2 + away_m**2 + 2.0 * relief_m**2
        return patch.height_m - self.height_m, float(np.sqrt(variance))


@dataclass(frozen=True, eq=False)
class GroundMemory:
    """Patches that were believed, and those that were refused because of them."""

    patches: tuple[GroundPatch, ...] = ()
    refused: tuple[GroundPatch, ...] = ()

    def with_patch(self, patch: GroundPatch, slope_sigma_deg: float, relief_m: float) -> GroundMemory:
        """A believed window's ground; what contradicts it has been outvoted and is forgotten."""
        others = tuple(p for p in self.patches if p.differs(patch, slope_sigma_deg, relief_m) is None)
        return GroundMemory((*others, patch)[-REMEMBERED:], ())

    def contradicted(self, patch: GroundPatch) -> GroundMemory:
        """A refused window's ground, kept aside."""
        return replace(self, refused=(*self.refused, patch)[-REMEMBERED:])

    def contradiction(
        self, patch: GroundPatch, slope_sigma_deg: float, relief_m: float, home: Home | None = None
    ) -> str | None:
        """What the memory says against a patch; None if it agrees, or knows nothing of the place, or is outvoted.

        Before anything is known of the ground, home's level stands for it.
        """
        if not self.patches and home is not None:
            miss_m, sigma_m = home.miss(patch, slope_sigma_deg, relief_m)
            if abs(miss_m) <= MAX_SIGMAS * sigma_m or self._is_outvoted(patch, slope_sigma_deg, relief_m):
                return None
            return f"ground off home's level: {miss_m:+.0f} m, sigma {sigma_m:.0f}"
        near = [p for p in self.patches if p.differs(patch, slope_sigma_deg, relief_m) is not None]
        if not near:
            return None
        close = [p for p in self.patches if _in_reach(p, patch)]
        if 2 * len(near) < len(close) or self._is_outvoted(patch, slope_sigma_deg, relief_m):
            return None
        return patch.differs(near[-1], slope_sigma_deg, relief_m)

    def _is_outvoted(self, patch: GroundPatch, slope_sigma_deg: float, relief_m: float) -> bool:
        """Whether enough refused windows without a common picture see the ground as this one does."""
        alike = [p for p in self.refused if _in_reach(p, patch) and patch.differs(p, slope_sigma_deg, relief_m) is None]
        if len(alike) < NEEDED:
            return False
        longest_s = max(p.end_s - p.start_s for p in (*alike, patch))
        return patch.end_s - alike[0].end_s > LASTING_S * longest_s


def _in_reach(one: GroundPatch, two: GroundPatch) -> bool:
    return float(np.linalg.norm(one.centre_m - two.centre_m)) <= REACH * (one.radius_m + two.radius_m)
