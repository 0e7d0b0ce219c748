"""The camera's own errors: derivatives, a state file that outlives its camera file, and windows that find them."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from contract.camera import UNKNOWN_SIGMA, Camera
from onboard.estimation.boresight import Alignment
from onboard.estimation.bundle_adjustment import solve
from onboard.estimation.camera_states import COUNT, as_numbers, corrected, from_numbers
from onboard.estimation.platform_states import STATES
from onboard.geometry.camera_errors import by_states
from tests.onboard.scenes import bundle_problem, first_guess

PLAIN = Camera.from_field_of_view(640, 480, 40.0)
BENT = Camera(1640, 1232, 1329.5, 1327.3, 809.9, 618.5, (0.16, -0.22, -0.004, 0.002, -0.3))

WIDE = Camera(640, 480, 330.0, 333.0, 322.0, 236.0, (-0.031, 0.012, -0.006, 0.0011), "fisheye")


@pytest.mark.parametrize("camera", [PLAIN, BENT, WIDE])
def test_rays_of_a_pixel_move_with_the_states_as_derived(camera: Camera) -> None:
    """(15.2) against central differences of undistortion itself."""
    rng = np.random.default_rng(0)
    uv = rng.uniform(0.1, 0.9, (40, 2)) * camera.size_px
    xy = camera.unproject(uv)[0][:, :2]
    by = by_states(camera, xy[None, :, 0], xy[None, :, 1])[0]
    for state in range(COUNT):
        step = np.zeros(COUNT)
        step[state] = 1e-6
        ahead, behind = (corrected(camera, s).unproject(uv)[0][:, :2] for s in (step, -step))
        assert pytest.approx((ahead - behind) / 2e-6, abs=2e-7, rel=1e-6) == by[state].T


def test_a_camera_whose_sigmas_are_nothing_has_no_states() -> None:
    assert corrected(PLAIN, np.zeros(0)) is PLAIN
    assert len(Alignment(0.02, 0.1, 20.0, camera=PLAIN).platform.mean) == STATES
    unsure = replace(PLAIN, stated_sigma=UNKNOWN_SIGMA)
    assert Alignment(0.02, 0.1, 20.0, camera=unsure).platform.sigma[STATES:] == pytest.approx(UNKNOWN_SIGMA, rel=1e-3)


def test_errors_of_the_camera_are_found_without_bias_and_as_well_as_stated() -> None:
    """80 windows over drawn ground: normalised errors have mean 0 and mean square 1, and there is something to find.

    With derivatives taken at measurements instead of predictions the focal length comes out too large by many sigmas.
    """
    lens = replace(PLAIN, stated_sigma=(0.02, 0.01, 0.01, 0.05, 0.05))
    z, gained = [], []
    for seed in range(80):
        drawn = bundle_problem(np.random.default_rng(seed), 6, 60, lens=lens)
        start = first_guess(drawn, drawn.truth.R_cam_enu, drawn.truth.centres_enu_m)
        s = solve(drawn.problem, start, scale=None, tolerance=1e-7)
        sigma = np.sqrt(np.diag(s.covariance))[drawn.problem.layout.camera]
        z.append((s.state.camera - drawn.truth.camera) / sigma)
        gained.append(sigma / lens.sigma)
    mean_square = np.mean(np.square(z), axis=0)
    assert np.all((mean_square > 0.65) & (mean_square < 1.6)), mean_square
    assert np.all(np.abs(np.mean(z, axis=0)) < 0.45), np.mean(z, axis=0)
    assert np.all(np.median(gained, axis=0) < 0.6), np.median(gained, axis=0)


def test_what_was_found_of_a_camera_is_kept_as_what_it_is() -> None:
    """A camera file that was replaced by the corrected one leaves nothing to correct; sigmas stay."""
    states = np.array([0.03, -0.004, 0.002, -0.1, 0.02])
    filed = replace(BENT, stated_sigma=UNKNOWN_SIGMA)
    assert from_numbers(filed, as_numbers(filed, states)) == pytest.approx(states, abs=1e-12)
    better = replace(corrected(filed, states), stated_sigma=UNKNOWN_SIGMA)
    assert from_numbers(better, as_numbers(filed, states)) == pytest.approx(np.zeros(COUNT), abs=1e-12)

    with pytest.raises(ValueError, match="is not the fisheye that the camera file states; delete it"):
        from_numbers(WIDE, as_numbers(filed, states))
    first = Alignment(0.02, 0.1, 20.0, camera=filed)
    covariance = 0.01 * np.diag(first.platform.sigma**2)
    assert first.offer(10**18, 10**18 + 10**10, np.concatenate([np.zeros(STATES), states]), covariance)
    text = first.to_json()
    for camera, expected in ((filed, states), (better, np.zeros(COUNT))):
        again = Alignment(0.02, 0.1, 20.0, camera=camera)
        again.restore(text)
        assert again.platform.mean[STATES:] == pytest.approx(expected, abs=0.02 * np.abs(states).max())
        assert np.all(again.platform.sigma[STATES:] < 0.6 * np.array(UNKNOWN_SIGMA))
    sure = Alignment(0.02, 0.1, 20.0, camera=BENT)
    sure.restore(text)
    assert len(sure.platform.mean) == STATES
    older = json.loads(sure.to_json())
    again = Alignment(0.02, 0.1, 20.0, camera=filed)
    again.restore(json.dumps(older))
    assert again.platform.sigma[STATES:] == pytest.approx(np.sqrt(1.25) * np.array(UNKNOWN_SIGMA), rel=0.02)


def test_a_camera_file_states_its_sigmas_or_is_taken_for_a_lens_known_by_its_type(tmp_path: Path) -> None:
    path = tmp_path / "camera.json"
    stated = replace(BENT, stated_sigma=(0.001, 0.002, 0.003, 0.01, 0.02))
    path.write_text(stated.to_json())
    assert Camera.from_json(path) == BENT
    assert Camera.from_json(path).sigma == pytest.approx(stated.sigma)
    path.write_text(BENT.to_json())
    assert Camera.from_json(path).sigma == (0.0,) * 5
    bare = json.loads(BENT.to_json())
    del bare["calibration"]
    path.write_text(json.dumps(bare))
    assert Camera.from_json(path).sigma == UNKNOWN_SIGMA
