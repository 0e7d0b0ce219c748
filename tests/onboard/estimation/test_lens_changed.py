"""What is kept of a camera file's errors when the lens is told to have zoomed. (21.2)"""

from dataclasses import replace

import numpy as np
import pytest

from contract.camera import Camera
from onboard.estimation.boresight import Alignment
from onboard.estimation.platform_states import STATES

SIGMA = (0.01, 0.004, 0.004, 0.01, 0.02)
FILE = replace(Camera.from_field_of_view(640, 480, 70.0), stated_sigma=SIGMA)
SURE = replace(FILE, stated_sigma=(0.0,) * 5)
LENS = slice(STATES, STATES + 5)


def learned(camera: Camera = FILE) -> Alignment:
    """An alignment that has found the focal length to be 2 % off, to 0.2 %."""
    alignment = Alignment(0.02, 0.1, 20.0, 0.05, 0.03, camera)
    first = alignment.platform
    mean, covariance = first.mean.copy(), first.covariance.copy()
    mean[STATES] = 0.02
    covariance[STATES, STATES] = 0.002**2
    assert alignment.offer(1, 10**9, mean, covariance)
    return alignment


def at(times: float, camera: Camera = FILE) -> Camera:
    return camera.zoomed(float(np.log(camera.focal_px * times)))


def test_a_small_step_keeps_what_was_found_and_a_large_one_forgets_it() -> None:
    near, far = learned(), learned()
    near.lens_changed(at(1.03), 0.003)
    far.lens_changed(at(6.0), 0.003)
    assert near.platform.mean[STATES] == pytest.approx(0.02, rel=0.15)
    assert 0.003 < near.platform.sigma[STATES] < 0.007
    assert abs(far.platform.mean[STATES]) < 0.001
    assert far.platform.sigma[STATES] == pytest.approx(np.hypot(0.01, 0.003), rel=0.01)


def test_zooming_to_and_fro_leaves_nobody_less_sure_than_the_file_and_what_is_told() -> None:
    alignment = learned()
    for k in range(60):
        alignment.lens_changed(at(1.0 + 0.02 * (k % 2)), 0.005)
        covariance = alignment.platform.covariance
        assert np.linalg.eigvalsh(covariance)[0] > 0.0 and np.allclose(covariance, covariance.T)
    assert alignment.platform.sigma[STATES] <= np.hypot(0.01, 0.005) * 1.001


def test_the_platform_stays_what_it_was() -> None:
    alignment = learned()
    before = alignment.platform
    alignment.lens_changed(at(4.0), 0.005)
    assert np.array_equal(before.mean[:STATES], alignment.platform.mean[:STATES])
    assert np.array_equal(before.covariance[:STATES, :STATES], alignment.platform.covariance[:STATES, :STATES])


def test_the_principal_point_keeps_its_pixels() -> None:
    alignment = learned()
    alignment.lens_changed(at(6.0), 0.0)
    assert alignment.platform.sigma[STATES + 1] == pytest.approx(0.004 / 6.0, rel=0.02)


def test_a_file_that_claims_no_error_gets_a_state_for_what_is_told() -> None:
    alignment = Alignment(0.02, 0.1, 20.0, 0.05, 0.03, SURE)
    assert len(alignment.platform.mean) == STATES
    alignment.lens_changed(at(3.0, SURE), 0.01)
    assert len(alignment.platform.mean) == STATES + 5
    assert alignment.platform.sigma[STATES] == pytest.approx(0.01, rel=0.01)
    assert np.all(alignment.platform.sigma[LENS][1:] < 1e-5)
    assert '"camera"' in alignment.to_json()
