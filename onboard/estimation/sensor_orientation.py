"""The camera's orientation by the sensors alone: the autopilot's attitude, or a coordinated turn along the path."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from contract.rotations import exp_so3
from onboard.estimation.boresight import PlatformEstimate
from onboard.estimation.keyframe import Keyframe, have_attitude
from onboard.estimation.platform_states import BORESIGHT, HEADING
from onboard.estimation.sensor_factors import coordinated_turn, cosine_sine_of_heading
from onboard.navigation.navigator import NavState

Array = NDArray[np.float64]


def by_attitude(nav: NavState, platform: PlatformEstimate, R_body_cam: Array) -> Array | None:
    """R_cam_enu from the autopilot through mount and boresight, or None without attitude."""
    if nav.R_enu_body is None:
        return None
    yaw = float(cosine_sine_of_heading(nav.R_enu_body) @ platform.mean[HEADING])
    R_enu_body = exp_so3(np.array([0.0, 0.0, -yaw])) @ nav.R_enu_body
    return (R_enu_body @ R_body_cam @ exp_so3(platform.mean[BORESIGHT])).T


def by_sensors(keyframes: Sequence[Keyframe], platform: PlatformEstimate, R_body_cam: Array) -> Array | None:
    """R_cam_enu (K, 3, 3) by the autopilot, or where it gives no attitude by a coordinated turn along the path."""
    if have_attitude(keyframes):
        return np.array([by_attitude(k.nav, platform, R_body_cam) for k in keyframes])
    path = coordinated_turn(R_body_cam, list(keyframes))
    return None if path is None else path.transpose(0, 2, 1)
