"""Several clicks of one thing -> one position, or that they contradict each other. Equations (17.1) to (17.6)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contract.answer import Ellipse
from contract.circular_error import ce90_m, le90_m
from contract.geodesy import EARTH_RADIUS_M, LocalFrame
from ground.chi_square import exceeded_with
from ground.pins.model import UNKNOWN_HEIGHT_SIGMA_M, PinClick, Tie
from ground.pins.shared import CONTRADICTION
from ground.pins.ties import condition

Array = NDArray[np.float64]

SPHERE = 0.01  # share of what an arc is longer than its chord by which the ellipsoid's may differ: twice its radii's


@dataclass(frozen=True, eq=False)
class Place:
    """The position of a pin. Heights are None where no click has one; every accuracy where no click has one.

    `clicks`: how many the position rests on. `chi2` of `freedom` degrees: how well they agree; 0 of 0 for one click.
    `tied`: how many ties took part. `heights_apart_m`: by how much the clicks' heights differ, where those of different
    aircraft cannot be of one datum: the place has none then.
    """

    lat_deg: float
    lon_deg: float
    height_ellipsoid_m: float | None
    height_amsl_m: float | None
    covariance_enu_m2: Array | None
    clicks: int = 1
    chi2: float = 0.0
    freedom: int = 0
    tied: int = 0
    heights_apart_m: float | None = None

    @property
    def ellipse(self) -> Ellipse | None:
        """The 90 % ellipse."""
        return None if self.covariance_enu_m2 is None else Ellipse.from_covariance(self.covariance_enu_m2[:2, :2])

    @property
    def ce90_m(self) -> float | None:
        """Radius about the position that holds the truth with 90 %."""
        return None if self.covariance_enu_m2 is None else ce90_m(self.covariance_enu_m2[:2, :2])

    @property
    def sigma_height_m(self) -> float | None:
        """One sigma; None where the height or its accuracy is not known."""
        if self.covariance_enu_m2 is None or (self.height_amsl_m is None and self.height_ellipsoid_m is None):
            return None
        sigma = math.sqrt(max(float(self.covariance_enu_m2[2, 2]), 0.0))
        return sigma if sigma < 0.99 * UNKNOWN_HEIGHT_SIGMA_M else None

    @property
    def le90_m(self) -> float | None:
        """Half the interval that holds the height with 90 %."""
        sigma = self.sigma_height_m
        return None if sigma is None else le90_m(sigma)


@dataclass(frozen=True, eq=False)
class Contradiction:
    """Clicks that cannot all be of one thing as they are stated: shown each by itself, never averaged."""

    chi2: float
    freedom: int
    probability: float  # of so much or more, if they were
    apart_m: float  # the longest horizontal distance between two of them
    answers: tuple[Place, ...]  # each click alone, ties applied, in the order given

    @property
    def reason(self) -> str:
        return (
            f"its {len(self.answers)} clicks contradict each other: they are up to {self.apart_m:.1f} m apart, "
            "more than their errors explain; remove the wrong one, or make two pins"
        )


@dataclass(frozen=True)
class Unplaced:
    """A pin without a click."""

    reason: str = "it has no click"


@dataclass(frozen=True, eq=False)
class Vector:
    """Distance, bearing and height difference from one place to another. Each with one sigma; None where not known."""

    distance_m: float
    bearing_deg: float  # clockwise from north, in [0, 360)
    sigma_distance_m: float | None
    sigma_bearing_deg: float | None
    height_difference_m: float | None
    sigma_height_difference_m: float | None


Fused = Place | Contradiction | Unplaced


def fuse(clicks: Sequence[PinClick], ties: Sequence[Tie] = ()) -> Fused:
    """One position from clicks of one thing, with the errors they share, and with ties applied."""
    return fuse_groups([clicks], ties)[0][0]


def fuse_groups(groups: Sequence[Sequence[PinClick]], ties: Sequence[Tie] = ()) -> tuple[list[Fused], Array | None]:
    """The same for several things at once, and the joint covariance (3 G, 3 G) of their positions.

    None for the covariance unless every one has a place with one.
    """
    out: list[Fused] = []
    used = [[c for c in group if c.covariance_enu_m2 is not None] for group in groups]
    if not any(used):
        return [_unknown(group) for group in groups], None
    flat, is_high, undulation = _in_one_datum([c for group in used for c in group])
    spots: list[object] = [g for g, group in enumerate(used) for _ in group]
    frame = LocalFrame(flat[0].lat_deg, flat[0].lon_deg, _height(flat[0], is_high))
    own = [t for t in ties if any((t.click.vehicle, t.click.session) == (c.vehicle, c.session) for c in flat)]
    y, (C_apart, C) = _adjusted(flat, spots, own, frame, is_high)
    weights = np.zeros((3 * len(groups), 3 * len(flat)))
    begin = 0
    for g, group in enumerate(used):
        n = len(group)
        with_height = any(_height_of(c, is_high) is not None for c in flat[begin : begin + n])
        at = slice(3 * begin, 3 * (begin + n))
        begin += n
        if not n:
            out.append(_unknown(groups[g]))
            continue
        W, chi2 = _least_squares(y[at], C_apart[at, at])
        weights[3 * g : 3 * g + 3, at] = W
        freedom = 3 * (n - 1)
        tied = sum(any((t.click.vehicle, t.click.session) == (c.vehicle, c.session) for c in group) for t in own)

        def place(
            enu_m: Array, cov: Array, n: int, chi2: float, freedom: int, tied: int = tied, known: bool = with_height
        ) -> Place:
            lat, lon, height = (float(v) for v in frame.to_geodetic(enu_m))
            heights = _both_heights(height, undulation, is_high) if known else (None, None)
            return Place(lat, lon, *heights, cov, n, chi2, freedom, tied)

        if freedom and exceeded_with(chi2, freedom) < CONTRADICTION:
            loose = _with_loose_datums(y[at], C_apart[at, at], C[at, at], group)
            if loose is not None:
                W, C_loose, chi2, freedom = loose
                weights[3 * g : 3 * g + 3, at] = W
                found = place(W @ y[at], W @ C_loose @ W.T, n, chi2, freedom, known=False)
                out.append(replace(found, heights_apart_m=float(np.ptp(y[at][2::3]))))
                continue
            single = [slice(3 * k, 3 * k + 3) for k in range(n)]
            y_own, C_own = y[at], C[at, at]
            apart = max(float(np.hypot(*(y_own[a] - y_own[b])[:2])) for a in single for b in single)
            answers = tuple(place(y_own[k], C_own[k, k], 1, 0.0, 0) for k in single)
            out.append(Contradiction(chi2, freedom, exceeded_with(chi2, freedom), apart, answers))
        else:
            out.append(place(W @ y[at], W @ C[at, at] @ W.T, n, chi2, freedom))
    if not all(isinstance(found, Place) and found.covariance_enu_m2 is not None for found in out):
        return out, None
    return out, weights @ C @ weights.T


def vector(
    clicks_a: Sequence[PinClick], clicks_b: Sequence[PinClick], ties: Sequence[Tie] = ()
) -> Vector | Contradiction | Unplaced:
    """The vector from a to b. What their errors share cancels."""
    (a, b), joint = fuse_groups([clicks_a, clicks_b], ties)
    for found in (a, b):
        if not isinstance(found, Place):
            return found
    assert isinstance(a, Place) and isinstance(b, Place)
    covariance = None
    if joint is not None:
        covariance = joint[:3, :3] + joint[3:, 3:] - joint[:3, 3:] - joint[3:, :3]
    return between(a, b, covariance)


def between(a: Place, b: Place, covariance_enu_m2: Array | None) -> Vector:
    """The vector from a to b, with the covariance of their difference; None: not known. (17.6)"""
    heights = next(
        (
            (p, q)
            for p, q in ((a.height_ellipsoid_m, b.height_ellipsoid_m), (a.height_amsl_m, b.height_amsl_m))
            if p is not None and q is not None
        ),
        None,
    )
    level = LocalFrame(a.lat_deg, a.lon_deg, 0.0 if heights is None else 0.5 * sum(heights))
    d = level.to_enu(b.lat_deg, b.lon_deg, level.height_m)
    # Both on one level: the chord is below the horizon by its sagitta alone, and shorter than the way by the arc's.
    chord, whole = float(np.linalg.norm(d)), 2.0 * (EARTH_RADIUS_M + level.height_m)
    distance = whole * math.asin(min(chord / whole, 1.0))
    bearing = math.degrees(math.atan2(float(d[0]), float(d[1]))) % 360.0
    rise = None if heights is None else heights[1] - heights[0]
    if covariance_enu_m2 is None:
        return Vector(distance, bearing, None, None, rise, None)
    C = covariance_enu_m2
    flat = math.hypot(float(d[0]), float(d[1]))
    along = np.array([d[0], d[1]]) / flat if flat > 0.0 else np.array([0.0, 1.0])
    across = np.array([along[1], -along[0]])
    sigma = math.hypot(math.sqrt(max(float(along @ C[:2, :2] @ along), 0.0)), SPHERE * (distance - chord))
    sideways = math.sqrt(max(float(across @ C[:2, :2] @ across), 0.0))
    # A bearing between places closer than their sigma may be any: 104 degrees is one sigma of a uniform circle.
    sigma_bearing = min(math.degrees(math.atan2(sideways, flat)) if flat > 0.0 else 180.0, 180.0)
    sigma_bearing = min(sigma_bearing if sideways < flat else 104.0, 104.0)
    sigma_rise = math.sqrt(max(float(C[2, 2]), 0.0))
    known = rise is not None and sigma_rise < 0.99 * UNKNOWN_HEIGHT_SIGMA_M
    return Vector(distance, bearing, sigma, sigma_bearing, rise, sigma_rise if known else None)


def _adjusted(
    clicks: Sequence[PinClick], spots: Sequence[object], ties: Sequence[Tie], frame: LocalFrame, is_ellipsoidal: bool
) -> tuple[Array, tuple[Array, Array]]:
    """Positions (3 N,) with the ties applied, and their joint covariances. (17.4)"""
    y = np.concatenate([frame.to_enu(c.lat_deg, c.lon_deg, _height(c, is_ellipsoidal, frame.height_m)) for c in clicks])
    shift, C = condition(clicks, spots, ties)
    return y - shift, C


def _least_squares(y: Array, C: Array) -> tuple[Array, float]:
    """Weights (3, 3 N) of the best linear unbiased estimate, and chi-square of what is left. (17.2), (17.3)

    C as if the clicks' own errors were not correlated: the weights then do not depend on their correlation.
    """
    n = len(y) // 3
    A = np.tile(np.eye(3), (n, 1))
    if n == 1:
        return A, 0.0
    scale = np.sqrt(np.diag(C)) + 1e-9
    inverse: Array = np.linalg.pinv(C / np.outer(scale, scale), rcond=1e-12, hermitian=True) / np.outer(scale, scale)
    N = A.T @ inverse
    W = np.asarray(np.linalg.solve(N @ A, N), np.float64)
    left = y - np.tile(W @ y, n)
    return W, float(left @ inverse @ left)


def _datums(clicks: Sequence[PinClick]) -> dict[object, int]:
    """Number each source of heights: an aircraft's session, and whatever was entered, each by itself."""
    keys = dict.fromkeys(_datum(click) for click in clicks)
    return {key: number for number, key in enumerate(keys)}


def _datum(click: PinClick) -> object:
    return click.id if click.errors is None else (click.vehicle, click.session)


def _with_loose_datums(
    y: Array, apart: Array, same: Array, clicks: Sequence[PinClick]
) -> tuple[Array, Array, float, int] | None:
    """Weights, covariance (3 N, 3 N), chi-square and its freedom with an unknown offset of the heights of each source;
    None of one source, and where the clicks contradict each other all the same. (17.9)
    """
    numbers = _datums(clicks)
    if len(numbers) < 2:
        return None
    of = np.array([numbers[_datum(click)] for click in clicks])
    offset = np.zeros_like(apart)
    offset[2::3, 2::3] = np.where(of[:, None] == of, UNKNOWN_HEIGHT_SIGMA_M**2, 0.0)
    W, chi2 = _least_squares(y, apart + offset)
    freedom = 3 * (len(clicks) - 1) - (len(numbers) - 1)
    return None if exceeded_with(chi2, freedom) < CONTRADICTION else (W, same + offset, chi2, freedom)


def _in_one_datum(clicks: Sequence[PinClick]) -> tuple[list[PinClick], bool, float | None]:
    """The clicks, all with heights of one datum where that can be; whether it is the ellipsoid; and the undulation.

    A height that cannot be brought into it counts as unknown: its sigma is UNKNOWN_HEIGHT_SIGMA_M.
    """
    is_ellipsoidal = sum(c.height_ellipsoid_m is not None for c in clicks) >= sum(
        c.height_amsl_m is not None for c in clicks
    )
    both = (
        c.height_ellipsoid_m - c.height_amsl_m
        for c in clicks
        if c.height_ellipsoid_m is not None and c.height_amsl_m is not None
    )
    undulation = next(both, None)
    out = []
    for click in clicks:
        c = click
        if _height_of(c, is_ellipsoidal) is None:
            other = _height_of(c, not is_ellipsoidal)
            if other is not None and undulation is not None:
                ellipsoid, amsl = _both_heights(other, undulation, not is_ellipsoidal)
                c = replace(c, height_ellipsoid_m=ellipsoid, height_amsl_m=amsl)
            else:
                assert c.covariance_enu_m2 is not None
                covariance = c.covariance_enu_m2.copy()
                covariance[2, 2] = max(float(covariance[2, 2]), UNKNOWN_HEIGHT_SIGMA_M**2)
                c = replace(c, covariance_enu_m2=covariance)
        out.append(c)
    return out, is_ellipsoidal, undulation


def _height_of(click: PinClick, is_ellipsoidal: bool) -> float | None:
    return click.height_ellipsoid_m if is_ellipsoidal else click.height_amsl_m


def _height(click: PinClick, is_ellipsoidal: bool, otherwise_m: float = 0.0) -> float:
    height = _height_of(click, is_ellipsoidal)
    return otherwise_m if height is None else height


def _both_heights(
    height_m: float, undulation_m: float | None, is_ellipsoidal: bool
) -> tuple[float | None, float | None]:
    """Above the ellipsoid and above mean sea level, from either."""
    if is_ellipsoidal:
        return height_m, None if undulation_m is None else height_m - undulation_m
    return None if undulation_m is None else height_m + undulation_m, height_m


def _unknown(group: Sequence[PinClick]) -> Fused:
    """The newest position of those whose accuracy is not known."""
    if not group:
        return Unplaced()
    c = max(group, key=lambda click: click.clicked_unix_ns)
    return Place(c.lat_deg, c.lon_deg, c.height_ellipsoid_m, c.height_amsl_m, None)
