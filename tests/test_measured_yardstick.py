"""The yardstick of `benchmarks.measured_clicks`: by what a set's features are off together, against the truth."""

from types import SimpleNamespace
from typing import cast

import numpy as np

from benchmarks.measured_clicks import shared_of
from contract.camera import Camera
from contract.feature_set import FeatureSet, Status
from simulation.truth import Truth

CAMERA = Camera.from_field_of_view(640, 480, 60.0)
GROUND_M, WALL_M, SIGMA = 200.0, 194.0, 5e-4


def test_features_at_edges_are_left_out() -> None:
    """Right half: they were tracked on the upper edge of something 6 m high, and the truth at their pixels is the
    ground's next to it. With them the tilt is off by four hundredths.
    """
    rng = np.random.default_rng(3)
    uv = rng.uniform([20.0, 20.0], [620.0, 460.0], (120, 2)).round()
    at_edge = uv[:, 0] > 320.0
    edges = uv[at_edge]

    def ground(frame: int, at: np.ndarray) -> SimpleNamespace:
        off = at[:, None] - edges
        is_high = ((off[..., 0] > 0.5) & (off[..., 0] < 8.0) & (np.abs(off[..., 1]) < 8.0)).any(axis=1)
        places = CAMERA.unproject(at)[0] * np.where(is_high, WALL_M, GROUND_M)[:, None]
        return SimpleNamespace(enu_m=places, is_valid=np.ones(len(at), bool))

    truth = SimpleNamespace(ground=ground, poses={0: SimpleNamespace(centre_m=np.zeros(3), R_enu_cam=np.eye(3))})
    off_by = CAMERA.unproject(uv)[0] @ [0.002, 0.0, 0.001] + SIGMA * rng.standard_normal(len(uv))
    w = (1.0 + off_by) / np.where(at_edge, WALL_M, GROUND_M)
    tracked = FeatureSet(
        "uav-1", 1, 0, 1, Status.OK, CAMERA, uv_px=uv, inverse_depth_per_m=w, sigma_inverse_depth_per_m=SIGMA * w
    )
    modes, covariance = shared_of(cast(Truth, truth), 0, tracked)
    assert np.abs((modes - [0.001, 0.002, 0.0]) / np.sqrt(np.diag(covariance))).max() < 3.5
    assert np.sqrt(covariance[1, 1]) < 1e-3
