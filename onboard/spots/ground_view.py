"""The places of level ground that a picture shows, and where in it: by its set's plane. (25.24)"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from contract.feature_set import FeatureSet
from contract.geodesy import LocalFrame
from contract.locate import pixels_of
from onboard.spots.ground_scale import GroundScale, grid_pixels

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FARTHEST = 16.0  # of the usual pixel's ground: where pixels show more, as by the horizon, nothing is looked at


class GroundView:
    """A picture over its ground. Places (N, 2) are east and north, m, of `origin`, at the height of the set's plane."""

    def __init__(self, its_set: FeatureSet, ground: GroundScale, origin: LocalFrame) -> None:
        self._set, self._origin = its_set, origin
        self._normal = np.asarray(its_set.R_enu_cam, float) @ its_set.plane_per_m[[1, 2, 0]]  # . place = 1
        self._frame = LocalFrame(its_set.camera_lat_deg, its_set.camera_lon_deg, its_set.camera_height_m)
        self._below_m = -1.0 / abs(float(self._normal[2]))
        usable = ground.is_ground & (ground.pixel_m2 <= FARTHEST * np.nanmedian(ground.pixel_m2))
        rays, _ = its_set.camera.unproject(grid_pixels(its_set.camera, usable.shape)[usable])
        ways = rays @ np.asarray(its_set.R_enu_cam, float).T
        shown = self._frame.to_geodetic(ways / (ways @ self._normal)[:, None])
        en_m = origin.to_enu(shown[:, 0], shown[:, 1], 0.0)[:, :2]
        low, high = en_m.min(axis=0), en_m.max(axis=0)
        beyond = (high - low) / (np.array(usable.shape).min() - 1)  # the middles of the grid's parts are inside of it
        self.box_m = np.array([low - beyond, high + beyond])
        """The least and the greatest (2, 2) east and north of what it shows."""
        pixels = its_set.camera.width_px * its_set.camera.height_px
        self.area_m2 = float(np.nanmedian(ground.pixel_m2)) * pixels
        """The ground that it would show, were all pixels as the usual one."""

    def shares(self, en_m: Array) -> tuple[Array, Mask]:
        """Return where in the picture places (N, 2) are, in shares of its height and width (N, 2), and which are."""
        lat_lon = self._origin.to_geodetic(np.column_stack([en_m, np.zeros(len(en_m))]))
        east_north = self._frame.to_enu(lat_lon[:, 0], lat_lon[:, 1], self._frame.height_m + self._below_m)[:, :2]
        up = (1.0 - east_north @ self._normal[:2]) / self._normal[2]
        uv, usable = pixels_of(self._set, np.column_stack([east_north, up]))
        camera = self._set.camera
        share = (uv[:, ::-1] + 0.5) / (camera.height_px, camera.width_px)
        return share, usable & np.all((share >= 0.0) & (share < 1.0), axis=1)
