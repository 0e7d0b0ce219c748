"""Rows that are read one after the other, in the estimator: where each feature was at its picture's own moment.

A picture's pose is that of its middle row. A feature of another row was seen earlier or later, and has moved on the
picture by its image velocity since, which follows from the vehicle's rate and velocity and the feature's depth, (18.2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contract.rolling_shutter import RollingShutter, image_velocity
from contract.rotations import log_so3

Array = NDArray[np.float64]

# Share of the turning rate: measured rates with so small an error bias the readout by at most its square, 4 %.
FOLLOWED = 0.2
LEAST_READOUT_S = 0.005  # travel at 20 m/s moves the outer rows by 5 cm in it


@dataclass(frozen=True, eq=False)
class Moving:
    """The camera's motion while one picture was read.

    A noisy rate biases the estimated readout towards 0, so such pictures teach nothing of it.
    `plane_per_m` (3,): inverse depth a + b x + c y of the ground, as it is taken for before the window is solved.
    """

    readout_s: float  # as estimated when the picture was taken up
    rate_cam_rad_s: Array
    velocity_enu_m_s: Array
    velocity_cam_m_s: Array
    plane_per_m: Array
    sigma_rate_rad_s: float = 0.0  # of a rate joined from measured ones, or the difference of attitudes; 0: nothing
    is_measured: bool = True  # that rate, if perhaps too rarely

    def by_readout(self, xy: Array, share: Array) -> Array:
        """d place / d readout (N, 2) of places (N, 2) seen in rows of these shares (N,), over the assumed ground."""
        w = np.maximum(self.plane_per_m[0] + xy @ self.plane_per_m[1:], 0.0)
        shutter = RollingShutter(self.readout_s, self.rate_cam_rad_s, self.velocity_cam_m_s)
        return shutter.image_velocity(xy, w) * share[:, None]

    def for_ground(self, R_cam_enu: Array, readout_s: float, sigma_readout_s: float) -> RollingShutter:
        """The shutter fields published with this picture's set.

        `sigma_readout_s`: one sigma of the readout beyond what the set's other errors hold.
        """
        return RollingShutter(readout_s, self.rate_cam_rad_s, R_cam_enu @ self.velocity_enu_m_s, sigma_readout_s)


@dataclass(frozen=True, eq=False)
class Sweep:
    """K pictures' rows on the (keyframe, point) grid of an adjustment."""

    readout_s: float  # as configured: what an estimated deviation is counted from
    share: Array  # (K, P) of the readout at which each measurement's row was exposed, 0 where there is none
    rate_cam_rad_s: Array  # (K, 3)
    velocity_enu_m_s: Array  # (K, 3)
    # One sigma of unmeasured rates, estimated with the poses as the angle that they turn in `scale_s`; 0: as given.
    sigma_rate_rad_s: float = 0.0
    scale_s: float = 0.0
    # Vibration while pictures are read: swings (K,) in the time of the readout, and one sigma of an angle.
    cycles: Array | None = None
    sigma_wave_rad: float = 0.0

    def by_readout(self, R_cam_enu: Array, predicted: Array, depth: Array, *, turns: bool = True) -> Array:
        """d x / d readout (K, 2, P) of points predicted at (K, 2, P) with `depth` (K, P), by (18.2).

        `turns` False: what travel alone does.
        """
        velocity = np.einsum("kij,kj->ik", R_cam_enu, self.velocity_enu_m_s)[:, :, None]
        rate = self.rate_cam_rad_s.T[:, :, None] * float(turns)
        moved = image_velocity(predicted[:, 0], predicted[:, 1], 1.0 / np.maximum(depth, 1e-6), rate, velocity)
        return np.stack(moved, axis=1) * self.share[:, None]

    def by_rate(self, predicted: Array) -> Array:
        """d x / d rate (K, 3, 2, P) of points predicted at (K, 2, P), in the time `scale_s`. (18.4)"""
        return _by_turn(predicted) * (self.scale_s * self.share)[:, None, None]

    def by_wave(self, predicted: Array) -> Array:
        """d x / d wave (K, 6, 2, P) of points predicted at (K, 2, P): about three axes by the cosine, then the sine
        of what `cycles` swings have come to in the row. (18.6)
        """
        assert self.cycles is not None
        phase, moved = 2.0 * np.pi * self.cycles[:, None] * self.share, _by_turn(predicted)
        waves = (np.cos(phase)[:, None, None], np.sin(phase)[:, None, None])
        return np.concatenate([moved * wave for wave in waves], axis=1)

    def rates_in(self, readout_s: float, off: Array) -> Array:
        """The rates (K, 3) that move in another readout what these, with `off` (K, 3) found of them, move. (18.4)"""
        return (self.readout_s * self.rate_cam_rad_s + self.scale_s * off) / readout_s


def sigma_of_rates(moving: Sequence[Moving], rates_cam_rad_s: Array) -> float:
    """One sigma (rad/s) of the rates (K, 3) of a window's pictures; 0 where they are taken as they are."""
    sigmas = np.array([m.sigma_rate_rad_s for m in moving])
    if all(m.is_measured for m in moving):
        sigma, turning = np.sqrt(np.mean(sigmas**2)), np.sqrt(np.mean(rates_cam_rad_s**2))
        return float(sigma) if sigma > FOLLOWED * turning else 0.0
    return float(sigmas.max())


def _by_turn(predicted: Array) -> Array:
    """d x / d turn (K, 3, 2, P) of points predicted at (K, 2, P), as (18.2) has it for a rate."""
    x, y = predicted[:, 0], predicted[:, 1]
    return np.stack([x * y, 1.0 + y * y, -1.0 - x * x, -x * y, y, -x], axis=1).reshape(len(x), 3, 2, -1)


def rates_between(stamps_s: Array, R_cam_enu: Array) -> Array:
    """Angular rates (K, 3), camera axes, of poses at these times (K,), in order: over the neighbours on both sides."""
    K = len(stamps_s)
    if K < 2:
        return np.zeros((K, 3))
    before, after = np.maximum(np.arange(K) - 1, 0), np.minimum(np.arange(K) + 1, K - 1)
    # R_cam_enu(t + dt) = exp(-rate dt) R_cam_enu(t)
    turned = log_so3(R_cam_enu[before] @ R_cam_enu[after].transpose(0, 2, 1))
    return turned / np.maximum(stamps_s[after] - stamps_s[before], 1e-3)[:, None]
