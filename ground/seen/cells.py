"""A grid of cells over the ground, by latitude and longitude: rows count northwards, columns eastwards.

Cells are as wide as they are high about the place that the grid is made at, to a tenth of a degree, so that one flight
has the same cells whichever of its pictures comes first; 50 km from there, at 45 degrees of latitude, they are 0.8 %
wider or narrower. Areas are those of the ellipsoid. No projection and no zones: exports are EPSG:4326.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contract.errors import InputError
from contract.geodesy import metres_per_degree, within_180

Array = NDArray[np.float64]
Index = NDArray[np.int64]

LEAST_CELL_M, MOST_CELL_M = 0.05, 1000.0
POLE_DEG = 85.0
PLACE_DECIMALS = 1  # of a degree, of the place that cells are made about: 11 km, 0.1 % of a width at 45 degrees


@dataclass(frozen=True)
class Cells:
    """Cell (row, column) reaches from (row, column) times the steps, in degrees and east of `lon0_deg`, to the next."""

    cell_m: float
    step_lat_deg: float
    step_lon_deg: float
    lon0_deg: float

    @classmethod
    def about(cls, lat_deg: float, lon_deg: float, cell_m: float) -> Cells:
        """Cells of a size at a place. Raises InputError for a size that is none, and near the poles."""
        if not LEAST_CELL_M <= cell_m <= MOST_CELL_M:
            raise InputError(f"a cell is {LEAST_CELL_M:g} to {MOST_CELL_M:g} m wide, not {cell_m:g}")
        if abs(lat_deg) > POLE_DEG:
            raise InputError(f"beyond {POLE_DEG:g} degrees of latitude there are no cells")
        north_m, east_m = metres_per_degree(round(lat_deg, PLACE_DECIMALS))
        lon0_deg = round(lon_deg, PLACE_DECIMALS)
        return cls(cell_m, cell_m / float(north_m), cell_m / float(east_m), lon0_deg)

    def at(self, lat_deg: ArrayLike, lon_deg: ArrayLike) -> tuple[Index, Index]:
        """Rows and columns of the cells that hold places."""
        row, column = self.places(lat_deg, lon_deg)
        return np.floor(row).astype(np.int64), np.floor(column).astype(np.int64)

    def places(self, lat_deg: ArrayLike, lon_deg: ArrayLike) -> tuple[Array, Array]:
        """Rows and columns of places, with fractions."""
        lat, lon = np.asarray(lat_deg, float), np.asarray(lon_deg, float)
        east = within_180(lon - self.lon0_deg)
        return np.asarray(lat / self.step_lat_deg), np.asarray(east / self.step_lon_deg)

    def lat_deg(self, row: ArrayLike) -> Array:
        """Latitudes of the southern edges of rows; half a row on is a middle."""
        return np.asarray(row, float) * self.step_lat_deg

    def lon_deg(self, column: ArrayLike) -> Array:
        """Longitudes of the western edges of columns; beyond the date line it counts on."""
        return self.lon0_deg + np.asarray(column, float) * self.step_lon_deg

    def area_m2(self, row: ArrayLike) -> Array:
        """The area of one cell of each row."""
        north_m, east_m = metres_per_degree(self.lat_deg(np.asarray(row, float) + 0.5))
        return north_m * self.step_lat_deg * east_m * self.step_lon_deg
