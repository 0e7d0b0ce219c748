"""Input of a window's adjustment: the flight's noise so far, and the request."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from onboard.config.schema import Config
from onboard.estimation.boresight import PlatformEstimate
from onboard.estimation.ground_slope import SlopePrior
from onboard.estimation.keyframe import Keyframe
from onboard.estimation.sensor_groups import Failing
from onboard.estimation.solved_window import AS_KNOWN, Solved
from onboard.estimation.variance_components import VarianceFactors
from onboard.estimation.window_acceptance import Memory
from onboard.geometry.terrain_grid import Terrain

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Noise:
    """The flight's own noise as estimated so far; every window is weighted by it and updates it a little."""

    pixel_sigma_px: float
    jitter_s: float
    noise_inflation: float = 1.0  # times the sigma that the tracks' own residuals show
    mount_sigmas: tuple[float, float, float] = AS_KNOWN  # times what is known of the mount's angles, in one window
    factors: VarianceFactors = field(default_factory=VarianceFactors)
    failing: Failing = field(default_factory=Failing)  # sensors that contradict the others

    def factors_at(self, start_ns: int) -> VarianceFactors:
        """The sensors' variances for a window that begins then, those of failing sensors as they fade."""
        return replace(self.factors, groups=self.failing.factors(start_ns))


@dataclass(frozen=True, eq=False)
class Request:
    """A window as it stands, with the priors of the sensors and of the tracking noise so far."""

    config: Config
    camera: Camera  # that the keyframes' observations were made with
    camera_file: Camera
    camera_taken: Array  # the states that part the two, (C,)
    R_body_cam: Array
    keyframes: tuple[Keyframe, ...]
    previous: Solved | None
    terrain: Terrain | None
    platform: PlatformEstimate  # of boresight and time offset, for a window that begins where this one does
    noise: Noise
    slope: SlopePrior | None = None  # of the ground where the window is; None: as configured
    memory: Memory = field(default_factory=Memory)
    is_mount_open: bool = False  # it is not known yet whether mount or gimbal carries the camera
    has_terrain_agreed: bool = False  # with the ground that an earlier window showed
    is_terrain_left_out: bool = False  # it contradicts that ground, and only shows whether it still does
    is_oriented: bool = False  # the keyframes' orientations are a start, whatever they came from
    is_mirrored: bool | None = None  # earlier windows have shown the pictures to be mirror images, or not to be
    is_stretched: bool | None = None  # and to be stretched along one side against the camera file
