"""Ties to known places: a session's slow errors, estimated where they can be measured, removed elsewhere.

The error of a tie's click is its answer minus the surveyed coordinate. As far as other clicks of the session share
that error, by (9.13) to (9.15), earlier or later, it is conditioned on all ties together. Equations (17.4), (17.5).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contract.answer import Fix
from contract.errors import InputError
from contract.feature_set import FeatureSet
from contract.geodesy import LocalFrame
from contract.locate import Locator
from ground.chi_square import exceeded_with, limit
from ground.pins.model import POINTING_PX, PinClick, Tie
from ground.pins.shared import CONTRADICTION, joint_covariances

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Judgement:
    """The agreement of a tie with the accuracy that its click states and with the ties before it."""

    chi2: float
    freedom: int
    misses_m: float  # what is left between click and surveyed place, horizontally, after the earlier ties
    allowed_m: float  # how much of that would still have been accepted
    misses_height_m: float | None

    @property
    def is_accepted(self) -> bool:
        return exceeded_with(self.chi2, self.freedom) >= CONTRADICTION


class TieRefused(InputError):
    """A tie that disagrees by more than its sigma and the click's own allow. The figures are in `judgement`."""

    def __init__(self, judgement: Judgement) -> None:
        height = "" if judgement.misses_height_m is None else f" and {judgement.misses_height_m:+.1f} m in height"
        super().__init__(
            f"tie refused: the click misses the surveyed place by {judgement.misses_m:.1f} m{height}, and "
            f"{judgement.allowed_m:.1f} m that way would still be accepted: is it the same place, and its coordinate "
            "in WGS84?"
        )
        self.judgement = judgement


def tie_of(
    feature_set: FeatureSet,
    fix: Fix,
    uv_px: ArrayLike,
    *,
    lat_deg: float,
    lon_deg: float,
    height_m: float | None = None,
    datum: str = "amsl",
    sigma_m: float,
    sigma_height_m: float | None = None,
    name: str = "",
    who: str = "",
    created_unix_ns: int = 0,
    pointing_px: float = POINTING_PX,
    locator: Locator | None = None,
) -> Tie:
    """A tie from an answered click. Raises InputError for a place or sigma that cannot be."""
    click = PinClick.of(
        feature_set, fix, uv_px, who=who, clicked_unix_ns=created_unix_ns, pointing_px=pointing_px, locator=locator
    )
    made = Tie(click, lat_deg, lon_deg, height_m, datum, sigma_m, sigma_height_m, name, who, created_unix_ns)
    return Tie.from_dict(made.to_dict())  # checked


def judge(tie: Tie, earlier: Sequence[Tie]) -> Judgement:
    """Compare a tie with the ties of its session that are there already. (17.5)"""
    before = [t for t in earlier if _session(t) == _session(tie) and t.id != tie.id]
    shift, C = condition([tie.click], [_place(tie)], before)
    rows = _rows(tie)
    d = _difference(tie) - shift[rows]
    # A place that was tied before has one survey error, which is in `shift` as far as it could be estimated.
    V = C[0][np.ix_(rows, rows)] + _survey(tie)[np.ix_(rows, rows)]
    chi2 = float(d @ np.linalg.solve(V, d))
    freedom = len(rows)
    misses = float(np.hypot(d[0], d[1]))
    allowed = misses * float(np.sqrt(limit(CONTRADICTION, freedom) / chi2)) if chi2 > 0.0 else float("inf")
    return Judgement(chi2, freedom, misses, allowed, float(d[2]) if freedom == 3 else None)


def condition(
    clicks: Sequence[PinClick], spots: Sequence[object], ties: Sequence[Tie]
) -> tuple[Array, tuple[Array, Array]]:
    """The shift (3 N,) to subtract from the clicks' positions, and the joint covariances (3 N, 3 N) left. (17.4)

    Two of them, as in `shared.joint_covariances`.
    """
    n = 3 * len(clicks)
    both = joint_covariances([*clicks, *(t.click for t in ties)], [*spots, *(_place(t) for t in ties)])
    if not ties:
        return np.zeros(n), both
    rows = np.concatenate([n + 3 * k + np.array(_rows(t)) for k, t in enumerate(ties)])
    d = np.concatenate([_difference(t) for t in ties])
    survey = np.zeros((3 * len(ties), 3 * len(ties)))
    for k, one in enumerate(ties):
        for m, other in enumerate(ties):
            if k == m or _place(one) == _place(other):
                survey[3 * k : 3 * k + 3, 3 * m : 3 * m + 3] = np.sqrt(_survey(one) * _survey(other))
    S = survey[np.ix_(rows - n, rows - n)]
    # The gain as if the clicks' own errors were not correlated, and what is left of both covariances with that gain.
    gain = np.linalg.solve(both[0][np.ix_(rows, rows)] + S, both[0][rows, :n]).T
    left = [_left(C[:n, :n], C[rows, :n], C[np.ix_(rows, rows)] + S, gain) for C in both]
    return gain @ d, (left[0], left[1])


def _left(C: Array, cross: Array, V: Array, gain: Array) -> Array:
    """Covariance of what is left when `gain` times the ties' measured errors is subtracted."""
    off = gain @ cross
    return C - off - off.T + gain @ V @ gain.T


def _difference(tie: Tie) -> Array:
    """The click's answer minus the surveyed place, east, north and, where it is known, up."""
    c = tie.click
    known = c.height_amsl_m if tie.datum == "amsl" else c.height_ellipsoid_m
    height = known if known is not None else c.height_amsl_m if c.height_amsl_m is not None else c.height_ellipsoid_m
    height = 0.0 if height is None else height
    at = LocalFrame(tie.lat_deg, tie.lon_deg, height if tie.height_m is None else tie.height_m)
    return np.asarray(at.to_enu(c.lat_deg, c.lon_deg, height)[: len(_rows(tie))], np.float64)


def _rows(tie: Tie) -> list[int]:
    return [0, 1] if tie.height_m is None else [0, 1, 2]


def _survey(tie: Tie) -> Array:
    height = 0.0 if tie.sigma_height_m is None else tie.sigma_height_m
    return np.diag([tie.sigma_m**2, tie.sigma_m**2, height**2])


def _place(tie: Tie) -> tuple[str, float, float]:
    return "tie", tie.lat_deg, tie.lon_deg


def _session(tie: Tie) -> tuple[str, int]:
    return tie.click.vehicle, tie.click.session
