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
    """A source of elevations."""

    def around(
        self, frame: LocalFrame, centre_enu_m: Array, radius_m: float, spacing_m: float, undulation_m: float
    ) -> Terrain | None:
        """Terrain within a square about a place of a local frame; None where there is none."""


def terrain_about(
    source: TerrainSource, frame: LocalFrame | None, nav: NavState, held: Terrain | None
) -> Terrain | None:
    """The terrain around the vehicle: what is held, cut again when the vehicle comes near its edge."""
    if frame is None or (held is not None and held.covers(nav.position_enu_m[:2], TERRAIN_RADIUS_M / 3.0)):
        return held
    return source.around(frame, nav.position_enu_m, TERRAIN_RADIUS_M, TERRAIN_SPACING_M, nav.undulation_m)
