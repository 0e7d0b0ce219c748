"""Where a picture without parallax can still be answered: over terrain, a range finder's ground, or home's level."""

from __future__ import annotations

import numpy as np

from contract.camera import Camera
from contract.feature_set import DepthSource, FeatureSet
from contract.geodesy import LocalFrame
from onboard.config.schema import Config
from onboard.estimation.sliding_window import Window
from onboard.georeferencing.feature_sets import Origin
from onboard.georeferencing.surface_sets import Cast, level_cast, over_surface
from onboard.navigation.navigator import NavState


def over_known_ground(
    config: Config, camera: Camera, window: Window, nav: NavState, origin: Origin, frame: LocalFrame
) -> FeatureSet | None:
    """The picture's set by the autopilot's pose over a known ground; None without attitude or without such a ground."""
    sensor_pose = window.sensor_pose(nav)
    if sensor_pose is None:
        return None
    cast: Cast
    ranged = nav.ground_range
    if window.terrain is not None:
        cast, sigma_m, source = window.terrain.cast, config.terrain.sigma_m, DepthSource.TERRAIN
        over = sensor_pose.over_ground(config.terrain.sigma_datum_m)
    elif ranged is not None:
        # The beam hits one place; the ground about it lies as far off as relief goes.
        cast = level_cast(float(sensor_pose.centre_enu_m[2] + ranged.vector_enu_m[2]))
        sigma_m, source = 0.0, DepthSource.PLANE
        over = sensor_pose.over_ranged_ground(float(np.hypot(ranged.sigma_m, config.solve.relief_sigma_m)))
    elif config.solve.home_level and nav.height_above_home_m is not None:
        cast = level_cast(float(nav.position_enu_m[2]) - nav.height_above_home_m)
        sigma_m, source = 0.0, DepthSource.PLANE
        over = sensor_pose.over_ground(config.solve.home_level_sigma_m)
    else:
        return None
    result = over_surface(camera, over, cast, sigma_m, source, origin, frame, nav.undulation_m)
    return result if isinstance(result, FeatureSet) else None
