"""The error budgets of a flight: of a click now, and in level flight and in a bank after one, three and ten minutes."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from contract.error_sources import ABOUT, Cause
from onboard.georeferencing.budget import Budget
from onboard.georeferencing.click_budget import click_budget
from onboard.georeferencing.feature_sets import Placed
from onboard.navigation.limits import LONG_NS

__all__ = ["BudgetWatch", "NewestBudget", "budget_text"]

Array = NDArray[np.float64]

MINUTES = (1.0, 3.0, 10.0)
LEVEL_DEG, BANKED_DEG = 10.0, 20.0


class NewestBudget:
    """Takes every picture as it is placed, in the pipeline's thread; gives another thread the budget of a click now."""

    def __init__(self) -> None:
        self.newest: Placed | None = None
        self._computed_ns = 0
        self._budget: Budget | None = None

    def __call__(self, placed: Placed) -> None:
        """Take a picture; no work."""
        if self.newest is None or placed.feature_set.capture_unix_ns >= self.newest.feature_set.capture_unix_ns:
            self.newest = placed

    def at(self, now_ns: int) -> Budget | None:
        """The budget of a click in the middle of the newest picture, computed again every `LONG_NS`: turns change it.

        None without a recent picture, and if its window's covariance cannot be split: a budget is only advice and must
        not end a flight.
        """
        newest = self.newest
        if newest is None or now_ns - newest.feature_set.capture_unix_ns > 3 * LONG_NS:
            return None
        if newest.feature_set.capture_unix_ns - self._computed_ns >= LONG_NS:
            self._computed_ns, self._budget = newest.feature_set.capture_unix_ns, None
            with suppress(np.linalg.LinAlgError):
                budget = click_budget(newest)
                if np.all(np.isfinite([budget.semi_major_m, *budget.shares.values()])):
                    self._budget = budget
        return self._budget


class BudgetWatch:
    """Takes every picture as it is placed; keeps the first of each kind, as it was placed last."""

    def __init__(self, R_body_cam: Array) -> None:
        self._R_body_cam = R_body_cam
        self._first_ns = 0
        self._kept: dict[tuple[float, str], Placed] = {}

    def __call__(self, placed: Placed) -> None:
        """Take a picture; one that was kept before is replaced by its later revision."""
        s = placed.feature_set
        self._first_ns = self._first_ns or s.capture_unix_ns
        minute = max((m for m in MINUTES if s.capture_unix_ns - self._first_ns >= m * 60e9), default=None)
        down = (placed.pose.R_cam_enu.T @ self._R_body_cam.T)[2, 2]
        bank_deg = np.degrees(np.arccos(np.clip(-down, -1.0, 1.0)))
        if minute is None or LEVEL_DEG <= bank_deg <= BANKED_DEG:
            return
        kind = minute, "level" if bank_deg < LEVEL_DEG else "bank"
        if self._kept.setdefault(kind, placed).feature_set.frame == s.frame:
            self._kept[kind] = placed

    def budgets(self) -> dict[str, Budget]:
        """A budget of a click in the middle of each picture that was kept, by what it is of."""
        kept = sorted(self._kept.items(), key=lambda item: (item[0][0], item[0][1] != "level"))
        return {f"minute {minute:.0f}, {kind}": click_budget(placed) for (minute, kind), placed in kept}


def budget_text(budgets: dict[str, Budget]) -> str:
    """A table of shares, a column a budget, and one line of advice for each."""
    if not budgets:
        return f"error budget: no picture was placed after minute {MINUTES[0]:.0f}"
    codes = sorted(
        {n for b in budgets.values() for n, share in b.shares.items() if share >= 0.005},
        key=lambda n: -max(b.shares.get(n, 0.0) for b in budgets.values()),
    )
    axes = (f"{b.semi_major_m:.1f} m" for b in budgets.values())
    rows = [("error budget of a click", *budgets), ("90 % ellipse, semi-axis", *axes)]
    for code in codes:
        shares = (f"{100.0 * b.shares.get(code, 0.0):.0f} %" for b in budgets.values())
        rows.append((ABOUT[Cause(code)].name, *shares))
    width = max(len(name) for name, *_ in rows)
    lines = [f"{name:<{width}}" + "".join(f"{cell:>18}" for cell in cells) for name, *cells in rows]
    return "\n".join([*lines, *(f"{title}: {b.advice}" for title, b in budgets.items())])
