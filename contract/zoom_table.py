"""A zoom lens by its zoom position: focal length, principal point and k1, as a camera file holds them. (21.1)

Positions count how many times the widest view is enlarged, or per cent of the way from the widest to the longest.
Between the rows the logarithm of the focal length is linear in the logarithm of a magnification, or in a percentage;
principal point and k1 are linear in the logarithm of the focal length. Beyond the rows a magnification is taken at its
word, and a percentage as the nearest row's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from contract.errors import InputError
from contract.stated_values import check_keys, numbers

Unit = Literal["times", "percent"]
COLUMNS = ("position", "focal_px", "cx_px", "cy_px", "k1")
MAX_NUMBER = 1e7
MAX_BEYOND = 1.3  # times the table's ends, up to which a magnification or a focal length is accepted


@dataclass(frozen=True)
class ZoomTable:
    """Rows by rising position, at least two; focal lengths rise with them."""

    unit: Unit
    position: tuple[float, ...]
    focal_px: tuple[float, ...]
    cx_px: tuple[float, ...]
    cy_px: tuple[float, ...]
    k1: tuple[float, ...]

    @classmethod
    def from_json(cls, raw: Any, what: str) -> ZoomTable:
        """The value of a camera file's `zoom`; raises InputError, one line that begins with `what`."""
        if not isinstance(raw, dict) or raw.get("unit") not in ("times", "percent"):
            raise InputError(f"{what}: zoom needs a unit, 'times' or 'percent', and the columns {', '.join(COLUMNS)}")
        check_keys(raw, ("unit", *COLUMNS), f"{what}: zoom", needed=COLUMNS)
        rows = len(raw["position"]) if isinstance(raw["position"], list) else 0
        if rows < 2 or any(not isinstance(raw[name], list) or len(raw[name]) != rows for name in COLUMNS):
            raise InputError(f"{what}: zoom needs two rows or more, and as many in every column")
        columns = [tuple(numbers(raw[name], rows, MAX_NUMBER, f"{what}: zoom: {name}")) for name in COLUMNS]
        lowest = {"times": 0.1, "percent": 0.0}[raw["unit"]]
        if (
            min(np.diff(columns[0])) <= 0
            or min(np.diff(columns[1])) <= 0
            or columns[0][0] < lowest
            or columns[1][0] <= 0
        ):
            raise InputError(f"{what}: zoom: positions and focal lengths must rise from row to row")
        return cls(raw["unit"], *columns)

    def to_json(self) -> dict[str, Any]:
        """Return the JSON object that `from_json` reads."""
        return {"unit": self.unit, **{name: list(getattr(self, name)) for name in COLUMNS}}

    def log_focal(self, position: float) -> float | None:
        """The logarithm of the focal length at a position; None for one that the lens cannot have."""
        at, rows = self._as_axis(position), [self._as_axis(p) for p in self.position]
        if at is None:
            return None
        logs = np.log(self.focal_px)
        known = float(np.interp(at, rows, logs))  # type: ignore[arg-type]
        if self.unit == "times":
            known += min(at - rows[0], 0.0) + max(at - rows[-1], 0.0)  # type: ignore[operator]
        return known if self.has(known) else None

    def _as_axis(self, position: float) -> float | None:
        if not math.isfinite(position):
            return None
        if self.unit == "times":
            return math.log(position) if position > 0.0 else None
        return position if 0.0 <= position <= 100.0 else None

    def has(self, log_focal: float) -> bool:
        """Return whether the lens can have this focal length, or nearly."""
        return math.log(self.focal_px[0] / MAX_BEYOND) <= log_focal <= math.log(self.focal_px[-1] * MAX_BEYOND)

    def at(self, log_focal: float) -> tuple[float, float, float]:
        """Principal point (px) and k1 at a focal length."""
        logs = np.log(self.focal_px)
        cx, cy, k1 = (float(np.interp(log_focal, logs, column)) for column in (self.cx_px, self.cy_px, self.k1))
        return cx, cy, k1
