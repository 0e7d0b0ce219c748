"""SO(3) tools and this project's frames: ENU world, FRD body, OpenCV camera. See docs/mathematics.md, section 1.

Rotations are `R_dst_src`, arrays (..., 3, 3) that take components in `src` to components in `dst`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

R_ENU_NED: Array = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
# MAVLink's gimbal frame has x along the optical axis, y to the picture's right, z to its bottom.
R_GIMBAL_CAM: Array = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
_IDENTITY: Array = np.eye(3)
# Row i holds the matrix of the cross product by unit vector i, row by row; the second takes half the difference back.
_SKEW: Array = np.array(
    [[0, 0, 0, 0, 0, -1, 0, 1, 0], [0, 0, 1, 0, 0, 0, -1, 0, 0], [0, -1, 0, 1, 0, 0, 0, 0, 0]], dtype=np.float64
)
_UNSKEW: Array = 0.5 * _SKEW.T


def skew(v: ArrayLike) -> Array:
    """(..., 3) -> (..., 3, 3) with skew(v) @ w = v x w."""
    v = np.asarray(v, float)
    return (v @ _SKEW).reshape(*v.shape[:-1], 3, 3)


def exp_so3(v: ArrayLike) -> Array:
    """Rotation vectors (..., 3), rad -> rotation matrices (..., 3, 3). Rodrigues, equation (1.4)."""
    v = np.asarray(v, float)
    if v.ndim == 1:
        return _exp_of_one(v)
    angle2 = (v * v).sum(axis=-1)[..., None, None]
    small = angle2 < 1e-8
    safe = np.sqrt(np.where(small, 1.0, angle2))
    a = np.where(small, 1.0 - angle2 / 6.0, np.sin(safe) / safe)
    b = np.where(small, 0.5 - angle2 / 24.0, (1.0 - np.cos(safe)) / (safe * safe))
    k = skew(v)
    out: Array = _IDENTITY + a * k + b * (k @ k)
    return out


def exp_of_plain(x: float, y: float, z: float) -> list[list[float]]:
    """`exp_so3` of one vector in plain numbers: the matrix's rows, in a fifth of the time. (1.4)

    Its last bits may differ from those of `exp_so3`.
    """
    angle2 = x * x + y * y + z * z
    if angle2 < 1e-8:
        a, b = 1.0 - angle2 / 6.0, 0.5 - angle2 / 24.0
    else:
        angle = math.sqrt(angle2)
        a, b = math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle2
    c = 1.0 - b * angle2
    bx, by, bz = b * x, b * y, b * z
    ax, ay, az = a * x, a * y, a * z
    return [
        [c + bx * x, bx * y - az, bx * z + ay],
        [bx * y + az, c + by * y, by * z - ax],
        [bx * z - ay, by * z + ax, c + bz * z],
    ]


def _exp_of_one(v: Array) -> Array:
    """`exp_so3` of one vector (3,), the same to the last bit in a third of the time."""
    x, y, z = v.tolist()
    angle2 = x * x + y * y + z * z
    if angle2 < 1e-8:
        a, b = 1.0 - angle2 / 6.0, 0.5 - angle2 / 24.0
    else:
        angle = math.sqrt(angle2)
        # NumPy's sine and cosine, as for many: the standard library's may differ in the last bit.
        a, b = np.sin(angle) / angle, (1.0 - np.cos(angle)) / (angle * angle)
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    out: Array = _IDENTITY + a * k + b * (k @ k)
    return out


def log_so3(R: ArrayLike) -> Array:
    """Rotation matrices (..., 3, 3) -> rotation vectors (..., 3), rad, length at most pi. Inverse of (1.4)."""
    R = np.asarray(R, float)
    if R.ndim == 2:
        return np.array(log_of_one(R.tolist()))
    flat = R.reshape(*R.shape[:-2], 9)
    cosine = 0.5 * (flat[..., 0] + flat[..., 4] + flat[..., 8] - 1.0)
    if np.any(cosine < -0.5):  # near half a turn the sine is too small: by quaternions
        return _log_by_quaternion(R)
    out = flat @ _UNSKEW
    sine = np.sqrt((out * out).sum(axis=-1))
    small = sine < 1e-9
    out *= np.where(small, 1.0, np.arctan2(sine, cosine) / np.where(small, 1.0, sine))[..., None]
    return out


def _log_by_quaternion(R: Array) -> Array:
    q = quaternion_from_matrix(R)
    q = np.where(q[..., :1] < 0.0, -q, q)
    norm = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    small = norm < 1e-9
    scale = np.where(small, 2.0, 2.0 * np.arctan2(norm, q[..., :1]) / np.where(small, 1.0, norm))
    return scale * q[..., 1:]


def log_of_one(rows: list[list[float]]) -> list[float]:
    """`log_so3` of one matrix in plain numbers: its rows -> the rotation vector, in a tenth of the time.

    By the quaternion at every angle, so that the last bits may differ from those of many below 120 degrees.
    """
    (r00, r01, r02), (r10, r11, r12), (r20, r21, r22) = rows
    squares = (1 + r00 + r11 + r22, 1 + r00 - r11 - r22, 1 - r00 + r11 - r22, 1 - r00 - r11 + r22)
    a, b, c = r21 - r12, r02 - r20, r10 - r01
    p, q, r = r01 + r10, r02 + r20, r12 + r21
    best = squares.index(max(squares))
    w, x, y, z = (
        (squares[0], a, b, c),
        (a, squares[1], p, q),
        (b, p, squares[2], r),
        (c, q, r, squares[3]),
    )[best]
    if w < 0.0:
        w, x, y, z = -w, -x, -y, -z
    length = math.sqrt(x * x + y * y + z * z)
    # Not normalised: only ratios count. Where the vector part is nothing the scale is its limit, 2 / w.
    scale = 2.0 * math.atan2(length, w) / length if length > 1e-9 * w else 2.0 / w
    return [scale * x, scale * y, scale * z]


def right_jacobian_inverse(v: ArrayLike) -> Array:
    """Jr^-1 (..., 3, 3): log(exp(v) exp(d)) ~ v + Jr^-1(v) d. Equation (1.5)."""
    v = np.asarray(v, float)
    angle2 = (v * v).sum(axis=-1)[..., None, None]
    small = angle2 < 1e-6
    angle = np.sqrt(np.where(small, 1.0, angle2))
    exact = 1.0 / angle**2 - (1.0 + np.cos(angle)) / (2.0 * angle * np.sin(angle))
    c = np.where(small, 1.0 / 12.0 + angle2 / 720.0, exact)
    k = skew(v)
    return _IDENTITY + 0.5 * k + c * (k @ k)


def quaternion_from_matrix(R: ArrayLike) -> Array:
    """Rotation matrices (..., 3, 3) -> unit quaternions (..., 4) as w, x, y, z. Shepperd's choice of the largest."""
    R = np.asarray(R, float)
    d0, d1, d2 = R[..., 0, 0], R[..., 1, 1], R[..., 2, 2]
    squares = np.stack([1 + d0 + d1 + d2, 1 + d0 - d1 - d2, 1 - d0 + d1 - d2, 1 - d0 - d1 + d2], axis=-1)
    best = np.argmax(squares, axis=-1)
    a, b, c = R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]
    p, q, r = R[..., 0, 1] + R[..., 1, 0], R[..., 0, 2] + R[..., 2, 0], R[..., 1, 2] + R[..., 2, 1]
    rows = np.stack(
        [
            np.stack([squares[..., 0], a, b, c], axis=-1),
            np.stack([a, squares[..., 1], p, q], axis=-1),
            np.stack([b, p, squares[..., 2], r], axis=-1),
            np.stack([c, q, r, squares[..., 3]], axis=-1),
        ],
        axis=-2,
    )
    out: Array = np.take_along_axis(rows, best[..., None, None], axis=-2)[..., 0, :]
    out = out / np.linalg.norm(out, axis=-1, keepdims=True)
    return out


def matrix_from_quaternion(q_wxyz: ArrayLike) -> Array:
    """Quaternions (..., 4) ordered w, x, y, z, any length but zero -> rotation matrices (..., 3, 3)."""
    q = np.asarray(q_wxyz, float)
    if q.ndim == 1 and q.any():
        return _matrix_of_one(q)
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return np.stack([np.stack(row, axis=-1) for row in _rows_of_unit(*np.moveaxis(q, -1, 0))], axis=-2)


def _matrix_of_one(q: Array) -> Array:
    """`matrix_from_quaternion` of one quaternion (4,), not zero, the same to the last bit in a tenth of the time."""
    w, x, y, z = q.tolist()
    length = math.sqrt(w * w + x * x + y * y + z * z)
    return np.array(_rows_of_unit(w / length, x / length, y / length, z / length))


def _rows_of_unit(w: Any, x: Any, y: Any, z: Any) -> list[list[Any]]:
    """The matrix of quaternions of length one: its entries, numbers or arrays as the four are."""
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]


def matrix_from_euler(roll_rad: ArrayLike, pitch_rad: ArrayLike, yaw_rad: ArrayLike) -> Array:
    """Aerospace angles -> Rz(yaw) Ry(pitch) Rx(roll), (..., 3, 3). Equation (1.2).

    R_ned_body of a vehicle, R_body_gimbal of a mount.
    """
    roll, pitch, yaw = np.broadcast_arrays(*(np.asarray(a, float) for a in (roll_rad, pitch_rad, yaw_rad)))
    cr, sr, cp, sp, cy, sy = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch), np.cos(yaw), np.sin(yaw)
    return np.stack(
        [
            np.stack([cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr], axis=-1),
            np.stack([sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr], axis=-1),
            np.stack([-sp, cp * sr, cp * cr], axis=-1),
        ],
        axis=-2,
    )


def euler_from_matrix(R: ArrayLike) -> Array:
    """Inverse of `matrix_from_euler`: (..., 3) roll, pitch, yaw in rad, pitch within +-pi/2. Roll is 0 at the pole."""
    R = np.asarray(R, float)
    pitch = np.arcsin(np.clip(-R[..., 2, 0], -1.0, 1.0))
    polar = np.abs(R[..., 2, 0]) > 1.0 - 1e-12
    roll = np.where(polar, 0.0, np.arctan2(R[..., 2, 1], R[..., 2, 2]))
    yaw = np.where(polar, np.arctan2(-R[..., 0, 1], R[..., 1, 1]), np.arctan2(R[..., 1, 0], R[..., 0, 0]))
    return np.stack([roll, pitch, yaw], axis=-1)


def mount_rotation(roll_deg: float, pitch_deg: float, yaw_deg: float) -> Array:
    """R_body_cam (3, 3) of a mount given as MAVLink gives a gimbal's attitude in the vehicle's frame. Equation (1.3).

    Pitch -90, yaw 0 looks straight down with the picture's top towards the nose; yaw -90 then turns the camera's x
    axis towards the nose, which is the seed's camera.
    """
    return matrix_from_euler(*np.radians([roll_deg, pitch_deg, yaw_deg])) @ R_GIMBAL_CAM
