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
from onboard.navigation.attitude_interpolation import RATE_WINDOW_NS, Attitudes

Array = NDArray[np.float64]


class MountHypothesis(Enum):
    """A hypothesis of what the camera is mounted on."""

    MOUNT = "fixed mount"
    GIMBAL = "gimbal"  # as the message's flags specify
    JOINTS = "gimbal by joint angles"  # the same numbers as joint angles, counted from the vehicle's body


class Gimbal:
    """Fed with a gimbal's attitudes, and with the vehicle's where the gimbal counts its yaw from the nose.

    Once a gimbal has sent, its silence is a gap, never a return to the fixed mount: its attitude is then unknown.
    """

    def __init__(self, config: Config) -> None:
        mount = config.mount
        self._R_body_gimbal = matrix_from_euler(*np.radians([mount.roll_deg, mount.pitch_deg, mount.yaw_deg]))
        self._attitudes = Attitudes(config.telemetry.max_attitude_gap_s)
        self._from_nose = False
        self._setting, self._is_of_camera = mount.gimbal, False

    @property
    def is_certain(self) -> bool:
        """Whether its attitude is the camera's without asking the pictures."""
        return self._setting == "always" or (self._setting == "auto" and self._is_of_camera)

    @property
    def is_open(self) -> bool:
        """Whether it has sent messages and the pictures must determine what they mean, if anything."""
        return self._setting == "auto" and not self._is_of_camera and bool(self.stamps_ns)

    def insert(self, event: GimbalAttitude) -> None:
        """Take one attitude. One that counts from elsewhere than those before it replaces them."""
        self._is_of_camera = event.is_of_camera
        from_nose = event.reference == "vehicle"
        if from_nose != self._from_nose:
            self._attitudes.forget()
            self._from_nose = from_nose
        self._attitudes.insert(event.stamp_ns, matrix_from_quaternion(event.q_ref_gimbal), None)

    @property
    def stamps_ns(self) -> list[int]:
        """When attitudes are held, sorted."""
        return self._attitudes.stamps_ns

    def forget(self) -> None:
        """The clock has stepped."""
        self._attitudes.forget()

    @property
    def readings(self) -> list[MountHypothesis]:
        """What its messages may mean."""
        return [MountHypothesis.GIMBAL, MountHypothesis.JOINTS] if self._from_nose else [MountHypothesis.GIMBAL]

    def needed(self, vehicle: Attitudes) -> list[list[int]]:
        """Stamps of everything that an attitude is made of."""
        return [self.stamps_ns, vehicle.stamps_ns] if self._from_nose else [self.stamps_ns]

    def at(
        self, moment_ns: int, vehicle: Attitudes, reading: MountHypothesis = MountHypothesis.GIMBAL
    ) -> Array | Status:
        """R_ned_body (3, 3) of the vehicle that a fixed mount would need, or why there is none. Equation (1.6)."""
        R_ref_gimbal = self._attitudes.at(moment_ns)
        if isinstance(R_ref_gimbal, Status):
            return R_ref_gimbal
        R_ned_ref = np.eye(3)
        if self._from_nose:
            R_ned_body = vehicle.at(moment_ns) if vehicle.stamps_ns else Status.UNSYNCHRONISED
            if isinstance(R_ned_body, Status):
                return R_ned_body
            heading = np.arctan2(R_ned_body[1, 0], R_ned_body[0, 0])
            R_ned_ref = R_ned_body if reading is MountHypothesis.JOINTS else matrix_from_euler(0.0, 0.0, heading)
        out: Array = R_ned_ref @ R_ref_gimbal @ self._R_body_gimbal.T
        return out

    def rate_at(
        self, moment_ns: int, vehicle: Attitudes, reading: MountHypothesis = MountHypothesis.GIMBAL
    ) -> Array | None:
        """Angular rate (3,), rad/s, in the axes of what `at` answers; None if unknown."""
        before, after = (self.at(moment_ns + side * RATE_WINDOW_NS // 2, vehicle, reading) for side in (-1, 1))
        if isinstance(before, Status) or isinstance(after, Status):
            return None
        out: Array = log_so3(before.T @ after) / (RATE_WINDOW_NS / 1e9)
        return out
