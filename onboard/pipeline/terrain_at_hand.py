"""The terrain around the aircraft: where it comes from, and when it is cut again."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from contract.geodesy import LocalFrame
from onboard.geometry.terrain_grid import Terrain
from onboard.navigation.navigator import NavState

Array = NDArray[np.float64]

TERRAIN_RADIUS_M = 3000.0
TERRAIN_SPACING_M = 20.0


class TerrainSource(Protocol):
    """Where elevation comes from."""

    def around(
        self, frame: LocalFrame, centre_enu_m: Array, radius_m: float, spacing_m: float, undulation_m: float
    ) -> Terrain | None:
        """Terrain within a square about a place of a local frame; None where there is none."""


def is_at_hand(held: Terrain | None, nav: NavState) -> bool:
    """Whether the terrain that is held reaches far enough around the vehicle."""
    return held is not None and held.covers(nav.position_enu_m[:2], TERRAIN_RADIUS_M / 3.0)


def cut(source: TerrainSource, frame: LocalFrame, nav: NavState) -> Terrain | None:
    """The terrain around the vehicle."""
    return source.around(frame, nav.position_enu_m, TERRAIN_RADIUS_M, TERRAIN_SPACING_M, nav.undulation_m)
