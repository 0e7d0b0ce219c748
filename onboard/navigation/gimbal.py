"""A stabilised camera: its attitude in place of the vehicle's, so that all other modules may take the mount as fixed.

A gimbal reports its own attitude; the modules that follow ask for that of a vehicle whose camera sits in the configured
mount. So what is answered is R_ned_gimbal R_body_gimbal^T with the nominal mount's R_body_gimbal (1.6): a vehicle that
would carry a fixed camera just as the gimbal carries it. The mount's boresight error then is the gimbal's own.
"""

from __future__ import annotations

from enum import Enum

import numpy as np
from numpy.typing import NDArray

from contract.feature_set import Status
from contract.rotations import log_so3, matrix_from_euler, matrix_from_quaternion
from onboard.config.schema import Config
from onboard.events.types import GimbalAttitude
from onboard.navigation.attitude_interpolation import RATE_WINDOW_NS, Attitudes, Orientation

Array = NDArray[np.float64]


class MountHypothesis(Enum):
    """A hypothesis of what the camera is mounted on."""

    MOUNT = "fixed mount"
    GIMBAL = "gimbal"  # as the message's flags specify
    JOINTS = "gimbal by joint angles"  # the same numbers as joint angles, counted from the vehicle's body


class Gimbal:
    """Takes a gimbal's attitudes; the vehicle's are needed where the gimbal counts its yaw from the nose.

    Once a gimbal has sent, its silence is a gap, never a return to the fixed mount: its attitude is then unknown.
    """

    def __init__(self, config: Config, vehicle: Attitudes) -> None:
        mount = config.mount
        self._R_body_gimbal = matrix_from_euler(*np.radians([mount.roll_deg, mount.pitch_deg, mount.yaw_deg]))
        self._vehicle, self.attitudes = vehicle, Attitudes(config.telemetry.max_attitude_gap_s)
        self._from_nose = False
        self._setting, self._is_of_camera = mount.gimbal, False

    @property
    def is_certain(self) -> bool:
        """True if its attitude is the camera's without confirmation by the pictures."""
        return self._setting == "always" or (self._setting == "auto" and self._is_of_camera)

    def insert(self, event: GimbalAttitude) -> None:
        """Take one attitude. One that counts from elsewhere than those before it replaces them."""
        self._is_of_camera = event.is_of_camera
        from_nose = event.reference == "vehicle"
        if from_nose != self._from_nose:
            self.attitudes, self._from_nose = Attitudes(self.attitudes.max_gap_s), from_nose
        self.attitudes.insert(event.stamp_ns, Orientation(matrix_from_quaternion(event.q_ref_gimbal)))

    def needed(self, hypothesis: MountHypothesis) -> list[Attitudes]:
        """The series of attitudes that the hypothesis needs."""
        if hypothesis is MountHypothesis.MOUNT:
            return [self._vehicle]
        return [self.attitudes, self._vehicle] if self._from_nose else [self.attitudes]

    def at(self, moment_ns: int, hypothesis: MountHypothesis) -> Array | Status:
        """R_ned_body (3, 3) of the vehicle that a fixed mount would need, or why there is none. Equation (1.6)."""
        if hypothesis is MountHypothesis.MOUNT:
            return self._vehicle.at(moment_ns)
        R_ref_gimbal = self.attitudes.at(moment_ns)
        if isinstance(R_ref_gimbal, Status):
            return R_ref_gimbal
        R_ned_ref = self._vehicle.at(moment_ns) if self._from_nose else np.eye(3)
        if isinstance(R_ned_ref, Status):
            return R_ned_ref
        if hypothesis is MountHypothesis.GIMBAL:
            R_ned_ref = matrix_from_euler(0.0, 0.0, np.arctan2(R_ned_ref[1, 0], R_ned_ref[0, 0]))
        return R_ned_ref @ R_ref_gimbal @ self._R_body_gimbal.T

    def sigma_at(self, moment_ns: int, hypothesis: MountHypothesis) -> float:
        """One sigma (rad) of what `at` may be off by between the messages that it is made of. (1.7)"""
        return float(np.hypot.reduce([held.sigma_at(moment_ns) for held in self.needed(hypothesis)]))

    def open_at(self, moment_ns: int) -> dict[MountHypothesis, Array]:
        """`at` by every hypothesis while the pictures must determine which is true, the mount first; else nothing."""
        if self._setting != "auto" or self._is_of_camera or not (self.attitudes.stamps_ns and self._vehicle.stamps_ns):
            return {}
        may_be = [h for h in MountHypothesis if self._from_nose or h is not MountHypothesis.JOINTS]
        found = {hypothesis: self.at(moment_ns, hypothesis) for hypothesis in may_be}
        return {hypothesis: R for hypothesis, R in found.items() if not isinstance(R, Status)}

    def rate_at(self, moment_ns: int, hypothesis: MountHypothesis) -> Array | None:
        """Angular rate (3,), rad/s, in the axes of what `at` answers; None if unknown."""
        if hypothesis is MountHypothesis.MOUNT:
            return self._vehicle.rate_at(moment_ns)
        before, after = (self.at(moment_ns + side * RATE_WINDOW_NS // 2, hypothesis) for side in (-1, 1))
        if isinstance(before, Status) or isinstance(after, Status):
            return None
        return log_so3(before.T @ after) / (RATE_WINDOW_NS / 1e9)
