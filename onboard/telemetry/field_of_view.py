"""Horizontal fields of view, as cameras state them -> focal lengths, equivalent to film 36 mm wide."""

from __future__ import annotations

import math
from collections.abc import Iterable

FILM_WIDTH_MM = 36.0
SAME_ZOOM = 0.01  # of a focal length, as a share: the steps of a stated field of view, and what a lens breathes
DIGITS_MM = 2


def focal_lengths(widths_deg: Iterable[tuple[int, float | None]]) -> tuple[tuple[int, float], ...]:
    """Return from which moment (ns) on a lens had which focal length, mm, equivalent to film 36 mm wide, by horizontal
    fields of view in degrees, each with its stamp.
    """
    out: list[tuple[int, float]] = []
    for stamp_ns, width_deg in sorted(widths_deg, key=lambda each: each[0]):
        if width_deg is not None and 0.0 < width_deg < 180.0:  # half a turn has no length
            focal_mm = 0.5 * FILM_WIDTH_MM / math.tan(math.radians(0.5 * width_deg))
            if not out or abs(math.log(focal_mm / out[-1][1])) > SAME_ZOOM:
                out.append((stamp_ns, round(focal_mm, DIGITS_MM)))
    return tuple(out)
