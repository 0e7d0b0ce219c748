"""Image velocities against differences of exact projections."""

import numpy as np

from contract.rolling_shutter import RollingShutter, row_share
from contract.rotations import exp_so3


def test_image_velocities_are_the_differences_of_projections() -> None:
    rng = np.random.default_rng(1)
    shutter = RollingShutter(0.03, rng.normal(size=3), 20.0 * rng.normal(size=3))
    points = rng.uniform([-40.0, -40.0, 60.0], [40.0, 40.0, 120.0], (50, 3))

    def seen_at(time_s: float) -> np.ndarray:
        """Axes and centre move on from where points are given."""
        p = (points - time_s * shutter.velocity_cam_m_s) @ exp_so3(time_s * shutter.rate_cam_rad_s)
        return p[:, :2] / p[:, 2:]

    step = 1e-4
    got = shutter.image_velocity(points[:, :2] / points[:, 2:], 1.0 / points[:, 2])
    np.testing.assert_allclose(got, (seen_at(step) - seen_at(-step)) / (2.0 * step), rtol=1e-6, atol=1e-6)


def test_rows_count_from_the_middle() -> None:
    shares = np.asarray(row_share(np.array([-0.5, 239.5, 479.5]), 480))
    np.testing.assert_allclose(shares, [-0.5, 0.0, 0.5])
