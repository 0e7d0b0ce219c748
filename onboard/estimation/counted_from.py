"""The declarations that estimates of mount, clock and camera are counted from; and these where that was changed.

An estimate of an earlier session is the error of what was declared then. Where the declaration is another today, it
either states now what was found, or it is of another mount, camera or clock: then what was found of the old one is
none of the new one's, and the declaration counts with its own sigma. (10.8)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.rotations import exp_so3, log_so3
from onboard.config.schema import Config
from onboard.estimation.platform_states import BORESIGHT, DELAY, OFFSET, STATES, VELOCITY_DELAY, present
from onboard.navigation.limits import SURE_SIGMAS

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

LENS = slice(STATES, None)


@dataclass(frozen=True, eq=False)
class CountedFrom:
    """The declarations that the states are errors of: vehicle, mount (3, 3), latencies (s), and the camera's file."""

    vehicle: str = ""
    R_body_cam: Array = field(default_factory=lambda: np.eye(3))
    picture_latency_s: float = 0.0
    position_latency_s: float = 0.0
    camera: Camera | None = None

    @classmethod
    def of(cls, config: Config, camera: Camera, R_body_cam: Array) -> CountedFrom:
        """Return those of a configuration, and of a camera's file."""
        return cls(config.vehicle.id, R_body_cam, config.camera.latency_s, config.gps.latency_s, camera)

    def as_numbers(self) -> dict[str, Any]:
        """Return it as it is kept with the estimates."""
        out = {
            "vehicle": self.vehicle,
            "R_body_cam": self.R_body_cam.tolist(),
            "picture_latency_s": self.picture_latency_s,
            "position_latency_s": self.position_latency_s,
        }
        return out if self.camera is None else {**out, "camera_file": _file_of(self.camera)}

    def recounted(self, before: Mapping[str, Any], found: Array, sigma: Array) -> tuple[Array, Mask]:
        """Return states (B,) counted from here, and a mask (B,) of those that are of something else, not to be taken.

        `before`: what `found` (B,), with one `sigma` (B,) each, was counted from; its lens is counted from here
        already. Raises KeyError, TypeError, ValueError.
        """
        out, changed = found.copy(), np.zeros(len(found), bool)
        if before["vehicle"] != self.vehicle:
            return out, ~changed
        R_before = np.array(before["R_body_cam"], float).reshape(3, 3)
        later_s = self.picture_latency_s - float(before["picture_latency_s"])
        older_s = float(before["position_latency_s"]) - self.position_latency_s
        if not np.array_equal(R_before, self.R_body_cam):
            out[BORESIGHT] = log_so3(self.R_body_cam.T @ R_before @ exp_so3(found[BORESIGHT]))
            changed[BORESIGHT] = True
        out[OFFSET] += later_s
        changed[OFFSET] = later_s != 0.0
        delays = [at for at in (DELAY, VELOCITY_DELAY) if at < len(found)]
        out[delays] += older_s
        changed[delays] = older_s != 0.0
        is_other_file = self.camera is not None and before.get("camera_file") != _file_of(self.camera)
        changed[LENS] = is_other_file
        is_lost = changed & (np.abs(out) > SURE_SIGMAS * sigma)
        if is_other_file and (len(found) <= STATES or is_lost[LENS].any() or not self._has_size_of(before)):
            is_lost[BORESIGHT] = is_lost[OFFSET] = is_lost[LENS] = True  # another camera, another lens: all is its own
        for _, at in present(len(found)):
            is_lost[at] = is_lost[at].any()
        return out, is_lost

    def _has_size_of(self, before: Mapping[str, Any]) -> bool:
        assert self.camera is not None
        return bool(before.get("camera_file", {}).get("size_px") == list(self.camera.size_px))


def _file_of(camera: Camera) -> dict[str, Any]:
    return {
        "model": camera.model,
        "size_px": list(camera.size_px),
        "matrix_px": [camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px],
        "distortion": list(camera.distortion),
    }
