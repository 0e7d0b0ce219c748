"""True motion, continuous in time: position and attitude of the vehicle's body, from samples.

Positions are ENU metres about the session's origin, attitudes R_enu_body in the same axes (body forward-right-down);
time is seconds since the session's epoch (Unix time of the log's clock for a recorded flight, minus its epoch).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

from contract.errors import InputError
from contract.geodesy import LocalFrame, rotation_enu_ecef
from contract.rotations import R_ENU_NED, matrix_from_euler, matrix_from_quaternion, quaternion_from_matrix

Array = NDArray[np.float64]

TRUTH_COLUMNS = "unix_time_s,lat_deg,lon_deg,height_amsl_m,roll_deg,pitch_deg,yaw_deg"


@dataclass(frozen=True, eq=False)
class Pose:
    """A camera at an instant: centre (3,) in ENU metres about the session's origin and R_enu_cam (3, 3)."""

    centre_m: Array
    R_enu_cam: Array


class Trajectory:
    """Cubic splines through positions and (sign-continuous) quaternions; smooth in velocity and rate."""

    def __init__(self, time_s: ArrayLike, position_enu_m: ArrayLike, R_enu_body: ArrayLike) -> None:
        time = np.asarray(time_s, float)
        q = quaternion_from_matrix(R_enu_body)
        flips = np.cumprod(np.concatenate([[1.0], np.where(np.sum(q[1:] * q[:-1], axis=1) < 0.0, -1.0, 1.0)]))
        self.start_s, self.end_s = float(time[0]), float(time[-1])
        self._position = CubicSpline(time, np.asarray(position_enu_m, float))
        self._velocity = self._position.derivative()
        self._quaternion = CubicSpline(time, q * flips[:, None])

    def position_enu_m(self, time_s: ArrayLike) -> Array:
        """(..., 3)."""
        out: Array = self._position(time_s)
        return out

    def velocity_enu_m_s(self, time_s: ArrayLike) -> Array:
        """(..., 3)."""
        out: Array = self._velocity(time_s)
        return out

    def R_enu_body(self, time_s: ArrayLike) -> Array:
        """(..., 3, 3), axes of the session's origin."""
        return matrix_from_quaternion(self._quaternion(time_s))

    def camera_pose(self, time_s: float, R_body_cam: Array) -> Pose:
        """The pose of a camera fixed to the body at its own centre."""
        return Pose(self.position_enu_m(time_s), self.R_enu_body(time_s) @ R_body_cam)


def axes_from_local(origin: LocalFrame, lat_deg: ArrayLike, lon_deg: ArrayLike) -> Array:
    """R_origin_local (N, 3, 3): ENU axes at each place -> the origin's ENU axes."""
    places = zip(np.atleast_1d(lat_deg), np.atleast_1d(lon_deg), strict=True)
    return np.stack([origin.R_enu_ecef @ rotation_enu_ecef(lat, lon).T for lat, lon in places])


@dataclass(frozen=True, eq=False)
class RecordedTruth:
    """A recorded flight's truth, columns as TRUTH_COLUMNS: Unix seconds, degrees, metres above mean sea level."""

    unix_time_s: Array
    lat_deg: Array
    lon_deg: Array
    height_amsl_m: Array
    roll_pitch_yaw_deg: Array  # (N, 3)

    @classmethod
    def read(cls, path: Path) -> RecordedTruth:
        """Read a truth CSV; raises InputError naming the file and what is wrong."""
        try:
            with path.open() as file:
                header = file.readline().strip()
                if header != TRUTH_COLUMNS:
                    raise InputError(f"truth file {path}: its first line must be {TRUTH_COLUMNS!r}, not {header!r}")
                table = np.loadtxt(file, delimiter=",", ndmin=2)
        except OSError as error:
            raise InputError(f"truth file {path}: {error.strerror}") from error
        except ValueError as error:
            raise InputError(f"truth file {path}: {error}") from error
        if table.shape[0] < 25 or table.shape[1] != 7 or np.any(np.diff(table[:, 0]) <= 0.0):
            raise InputError(f"truth file {path}: needs at least 25 rows of 7 numbers, times increasing")
        return cls(table[:, 0], table[:, 1], table[:, 2], table[:, 3], table[:, 4:7])

    def between(self, start_unix_s: float, end_unix_s: float) -> RecordedTruth:
        """The rows of a time span."""
        keep = (self.unix_time_s >= start_unix_s) & (self.unix_time_s <= end_unix_s)
        columns = (self.unix_time_s, self.lat_deg, self.lon_deg, self.height_amsl_m, self.roll_pitch_yaw_deg)
        return RecordedTruth(*(column[keep] for column in columns))

    def trajectory(self, origin: LocalFrame, epoch_unix_s: float, undulation_m: float) -> Trajectory:
        """Motion in the origin's axes; `origin` and its height are ellipsoidal, time counts from `epoch_unix_s`.

        The file rounds to 1 cm and 0.01 degree, 0.05 pixels at 40 degrees' field of view and 25 times a second: a
        short cubic smoothing takes that shake out and leaves the flight.
        """
        from scipy.signal import savgol_filter  # noqa: PLC0415  with scipy.stats behind it, a second of processor time

        position = origin.to_enu(self.lat_deg, self.lon_deg, self.height_amsl_m + undulation_m)
        R_ned_body = matrix_from_euler(*np.radians(self.roll_pitch_yaw_deg).T)
        R_enu_body = axes_from_local(origin, self.lat_deg, self.lon_deg) @ R_ENU_NED @ R_ned_body
        q = quaternion_from_matrix(R_enu_body)
        flips = np.cumprod(np.concatenate([[1.0], np.where(np.sum(q[1:] * q[:-1], axis=1) < 0.0, -1.0, 1.0)]))
        q = savgol_filter(q * flips[:, None], 9, 3, axis=0)
        position = savgol_filter(position, 9, 3, axis=0)
        return Trajectory(self.unix_time_s - epoch_unix_s, position, matrix_from_quaternion(q))
