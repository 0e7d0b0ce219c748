"""Elevation files -> `Terrain` around a place: GeoTIFF and SRTM `.hgt` through rasterio (extra `terrain`).

SRTM and most national models are above mean sea level (EGM96 or the like), as MAVLink's heights are. A model above the
ellipsoid is brought down by the undulation the receiver reports.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from contract.errors import ConfigError, InputError
from contract.geodesy import LocalFrame
from onboard.geometry.terrain_grid import Terrain

Array = NDArray[np.float64]

LOWEST_M, HIGHEST_M = -500.0, 9000.0  # of land: the shore of the Dead Sea, Mount Everest
VOIDS = (-9999.0, -32767.0, -32768.0, 32767.0, 65535.0)  # as stored where nothing was measured, declared or not
LEAST_SHORE_M = 50.0  # above the sea, below which some land lies wherever it meets the sea
METRES = {
    **dict.fromkeys(("", "m", "metre", "metres", "meter", "meters"), 1.0),
    **dict.fromkeys(("cm", "centimetre", "centimeter"), 0.01),
    **dict.fromkeys(("ft", "foot", "feet", "international foot"), 0.3048),
    **dict.fromkeys(("us survey foot", "us-ft", "ftus", "foot_us", "us_survey_foot"), 1200.0 / 3937.0),
}
MISS_HOLDS = 1.0 / 3.0
"""The share of the radius within which a place without any data stands for its neighbours. Another look at the files
takes a tenth of a second and more, too much for every picture; two thirds of the radius stay known to be empty."""


class TerrainFiles:
    """One file or a folder of tiles, opened once; `around` cuts what is needed."""

    def __init__(self, path: Path | str, datum: Literal["amsl", "ellipsoid"] = "amsl") -> None:
        """Raises InputError naming the file that is missing or no elevation model, ConfigError without rasterio."""
        try:
            import rasterio  # noqa: PLC0415  (166 MB: only for those who fly with terrain)
            from rasterio.warp import transform  # noqa: PLC0415
        except ImportError as error:
            raise ConfigError(
                "terrain.path is set, but rasterio is not installed: install with the extra [terrain] (README), "
                "or of the Debian package: apt-get install pointclick-onboard-terrain"
            ) from error
        self._transform = transform
        self.datum = datum
        self._missed: tuple[LocalFrame, Array, float] | None = None  # where there was no data, and within which radius
        place = Path(path)
        if place.is_dir():
            names = sorted(p for p in place.iterdir() if p.suffix.lower() in {".hgt", ".tif", ".tiff"})
        else:
            names = [place]
        if not names or not all(n.is_file() for n in names):
            raise InputError(f"terrain {path}: no such file, or no .hgt or .tif in that folder")
        self._tiles: list[Any] = []
        for name in names:
            try:
                tile = rasterio.open(name)
            except rasterio.errors.RasterioIOError as error:
                raise InputError(f"terrain {name}: not a readable elevation model ({error})") from error
            if tile.crs is None:
                raise InputError(f"terrain {name}: has no coordinate reference system")
            if _unit(tile) not in METRES:
                raise InputError(f"terrain {name}: heights in '{_unit(tile)}', not in metres or feet")
            if not (math.isfinite(tile.scales[0] * tile.offsets[0]) and tile.scales[0]):
                raise InputError(
                    f"terrain {name}: heights with a scale of {tile.scales[0]:g} and an offset of {tile.offsets[0]:g}"
                )
            self._tiles.append(tile)

    def around(
        self, frame: LocalFrame, centre_enu_m: Array, radius_m: float, spacing_m: float, undulation_m: float
    ) -> Terrain | None:
        """The terrain within `radius_m` (a square) of a place in a local frame; None where no tile has data.

        None too for an ellipsoidal model while the undulation is unknown (nan): its heights would mean nothing.
        Where there was no data the files are read again only once the place has moved by `MISS_HOLDS` of the radius.
        """
        if self.datum == "ellipsoid" and math.isnan(undulation_m):
            return None
        if self._is_known_miss(frame, centre_enu_m, radius_m):
            return None
        n = 2 * math.ceil(radius_m / spacing_m) + 1
        axis = (np.arange(n) - n // 2) * spacing_m
        west, south = centre_enu_m[0] + axis[0], centre_enu_m[1] + axis[0]
        east, north = np.meshgrid(centre_enu_m[0] + axis, centre_enu_m[1] + axis)
        # The frame's own height: the grid follows the ellipsoid, its heights are set back into the plane of the frame.
        level = np.stack([east, north, np.zeros_like(east)], axis=-1)
        geodetic = frame.to_geodetic(level)
        amsl = np.full(east.shape, np.nan)
        for tile in self._tiles:
            missing = np.isnan(amsl)
            if missing.any():
                amsl[missing] = self._sample(tile, geodetic[missing])
        if np.isnan(amsl).all():
            self._missed = (frame, np.array(centre_enu_m[:2]), radius_m)
            return None
        if self.datum == "ellipsoid":
            amsl -= undulation_m
        # geodetic[..., 2] is the height of the frame's plane above the datum there; the difference is the ENU height.
        return Terrain(float(west), float(south), spacing_m, amsl - geodetic[..., 2])

    def _is_known_miss(self, frame: LocalFrame, centre_enu_m: Array, radius_m: float) -> bool:
        if self._missed is None:
            return False
        missed_frame, place, missed_radius_m = self._missed
        moved_m = float(np.linalg.norm(centre_enu_m[:2] - place))
        return frame == missed_frame and radius_m <= missed_radius_m and moved_m < MISS_HOLDS * missed_radius_m

    def _sample(self, tile: Any, geodetic: Array) -> Array:
        """Bilinear heights (N,) of a tile at latitudes and longitudes (N, 3); nan outside of it."""
        xs, ys = self._transform("EPSG:4326", tile.crs, geodetic[:, 1].tolist(), geodetic[:, 0].tolist())
        to_pixel = ~tile.transform
        x, y = np.asarray(xs), np.asarray(ys)
        columns = to_pixel.a * x + to_pixel.b * y + to_pixel.c - 0.5  # counted from the centre of the first pixel
        rows = to_pixel.d * x + to_pixel.e * y + to_pixel.f - 0.5
        inside = (columns >= -0.5) & (rows >= -0.5) & (columns <= tile.width - 0.5) & (rows <= tile.height - 0.5)
        out = np.full(len(geodetic), np.nan)
        if not inside.any():
            return out
        c, r = np.clip(columns[inside], 0, tile.width - 1), np.clip(rows[inside], 0, tile.height - 1)
        c0, r0 = int(np.floor(c.min())), int(np.floor(r.min()))
        c1, r1 = min(int(np.ceil(c.max())) + 1, tile.width - 1), min(int(np.ceil(r.max())) + 1, tile.height - 1)
        block = _heights_m(tile, ((r0, r1 + 1), (c0, c1 + 1)))
        i, j = (r - r0).astype(int), (c - c0).astype(int)
        i1, j1 = np.minimum(i + 1, block.shape[0] - 1), np.minimum(j + 1, block.shape[1] - 1)
        a, b = c - c0 - j, r - r0 - i
        out[inside] = (1 - b) * ((1 - a) * block[i, j] + a * block[i, j1]) + b * (
            (1 - a) * block[i1, j] + a * block[i1, j1]
        )
        return out


def _heights_m(tile: Any, window: tuple[tuple[int, int], tuple[int, int]]) -> Array:
    """The heights (rows, columns), m, of a part of a tile; nan where it has none, declared or not."""
    stored = tile.read(1, window=window, masked=True)
    values = np.asarray(stored.data, float)
    void = np.ma.getmaskarray(stored) | np.isin(values, VOIDS) | ~np.isfinite(values)
    heights_m: Array = (values * tile.scales[0] + tile.offsets[0]) * METRES[_unit(tile)]
    void |= (heights_m < LOWEST_M) | (heights_m > HIGHEST_M)
    # A model of the sea has a shore; zeros among nothing but heights are where nothing was measured.
    land = ~void & (values != 0.0)
    if tile.nodata is None and land.any() and np.abs(heights_m[land]).min() > LEAST_SHORE_M:
        void |= values == 0.0
    heights_m[void] = np.nan
    return heights_m


def _unit(tile: Any) -> str:
    """The unit of a tile's heights, as it is written there; empty where none is."""
    return str((tile.units or ("",))[0] or "").strip().lower()
