"""A click's error and the share of each source in it, as they are reported. `click_budget` computes them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from contract.error_sources import ABOUT, LEAST_SHARE, Cause
from contract.vehicle_status import MAX_SHARES


@dataclass(frozen=True)
class Budget:
    """One click's error: semi-major axis of its 90 % ellipse (m), and each source's share of its horizontal variance.

    `shares` by the codes of `contract.error_sources`; they add up to 1, the largest first.
    """

    semi_major_m: float
    shares: Mapping[str, float]

    @property
    def percent(self) -> dict[str, int]:
        """The largest shares in whole per cent, those that are worth an advice; at least the largest one."""
        first, *others = self.shares.items()
        worth = [first, *(item for item in others if item[1] >= LEAST_SHARE)][:MAX_SHARES]
        return {str(code): min(round(100.0 * share), 100) for code, share in worth}

    @property
    def advice(self) -> str:
        """One line: the two largest sources, what to do against the first, and what that is worth."""
        largest = list(self.shares.items())[:2]
        named = ", ".join(f"{ABOUT[Cause(code)].name} {100.0 * share:.0f} %" for code, share in largest)
        code, share = largest[0]
        if share < LEAST_SHARE:
            return f"{named}: no single source dominates"
        left_m = self.semi_major_m * np.sqrt(1.0 - min(share, 1.0))
        return f"{named}: {ABOUT[Cause(code)].in_full} (without it {left_m:.1f} m)"
