"""Clicks of the demo: spots on the ground, each in two pictures, and what the answers were worth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from simulation.truth import Truth

Array = NDArray[np.float64]

# When in the flight (share of its pictures) and where in that picture (share of its width and height) a spot is seen.
PLACES = ((0.25, 0.75, 0.25), (0.40, 0.70, 0.70), (0.55, 0.75, 0.40), (0.70, 0.65, 0.80))
APART = 8  # pictures between the two clicks on a spot, at most


class View(NamedTuple):
    """A spot in a picture: the whole pixel that a person clicks."""

    frame: int
    u_px: int
    v_px: int


@dataclass(frozen=True, eq=False)
class Spot:
    """A point of the ground (3,), ENU metres about the session's origin, and the pictures it is clicked in."""

    name: str
    enu_m: Array
    views: tuple[View, ...]


@dataclass(frozen=True, eq=False)
class Clicked:
    """One answer of `pc-ground click`; position and horizontal error are None where it was refused."""

    spot: Spot
    view: View
    answer: dict[str, Any]
    enu_m: Array | None
    error_m: float | None


def choose_spots(truth: Truth) -> list[Spot]:
    """Four spots along the flight, seen twice as long as they stay on the picture."""
    spots = []
    for name, (when, across, down) in zip("ABCD", PLACES, strict=True):
        first = round(when * (len(truth) - 1))
        width, height = truth.camera.size_px
        enu_m = truth.ground(first, [round(across * width), round(down * height)]).enu_m[0]
        last = next(
            f for f in range(min(first + APART, len(truth) - 1), first - 1, -1) if truth.sees(f, enu_m[None])[0]
        )
        views = []
        for frame in sorted({first, last}):
            uv, _ = truth.project(frame, enu_m[None])
            u, v = np.rint(uv[0]).astype(int)
            views.append(View(frame, int(u), int(v)))
        spots.append(Spot(name, enu_m, tuple(views)))
    return spots
