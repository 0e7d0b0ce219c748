"""The window answers where its result is sound and says why where not."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from contract.feature_set import Status
from contract.rotations import log_so3
from onboard.config.schema import Config, parse_config
from onboard.estimation.keyframe import observation
from onboard.estimation.sliding_window import Window
from onboard.estimation.window_problem import MIN_KEYFRAMES
from tests.onboard.scenes import CAMERA, FULL, SEED_SENSORS, Scene, SceneSpec, draw
from tests.rest_long import rest_long

CALM = SceneSpec(error_scale=0.3)


def add(window: Window, scene: Scene, k: int) -> None:
    window.add(k, scene.observations[k], scene.navs[k], (0.0, 0.0), scene.rates[k], scene.flown[k])


def worst_turn_deg(window: Window, scene: Scene) -> float:
    solved = window.solved
    truth = scene.R_cam_enu[list(solved.frames)]
    turn = log_so3(solved.solution.state.R_cam_enu @ truth.transpose(0, 2, 1))
    return float(np.degrees(np.linalg.norm(turn, axis=1)).max())


@pytest.mark.parametrize("config", [FULL, SEED_SENSORS], ids=["full", "seed"])
@pytest.mark.parametrize("seed", rest_long(range(4)))
def test_an_ordinary_flight_is_solved(config: Config, seed: int) -> None:
    scene = draw(np.random.default_rng(seed), config, CALM)
    window = scene.window()
    assert window.solve() is Status.OK
    solved = window.solved
    error = solved.solution.state.centres_enu_m - scene.centres_enu_m[list(solved.frames)]
    assert np.linalg.norm(error, axis=1).max() < 6.0
    assert worst_turn_deg(window, scene) < 6.0
    assert 0.2 < solved.pixel_sigma_px < 0.4
    assert solved.good.mean() > 0.9


@pytest.mark.parametrize("mount_yaw_deg", [0.0, 90.0, 180.0])
@pytest.mark.parametrize("crab_deg", [0.0, 15.0])
def test_the_seeds_sensors_solve_under_any_mount_yaw_and_a_crab(mount_yaw_deg: float, crab_deg: float) -> None:
    config = parse_config(f'[mount]\nyaw_deg = {mount_yaw_deg}\n[solve]\nattitude = "none"\nvelocity = false')
    scene = draw(np.random.default_rng(1), config, replace(CALM, crab_deg=crab_deg))
    window = scene.window()
    assert window.solve() is Status.OK
    assert worst_turn_deg(window, scene) < 6.0


def test_fewer_keyframes_than_three_are_a_start() -> None:
    scene = draw(np.random.default_rng(0), spec=CALM)
    window = Window(FULL, CAMERA)
    for n, k in enumerate(scene.keys[:MIN_KEYFRAMES]):
        assert window.solve() is Status.STARTING
        assert len(window.keyframes) == n
        add(window, scene, int(k))
    assert window.solve() is Status.OK


@pytest.mark.parametrize("config", [FULL, SEED_SENSORS], ids=["full", "seed"])
def test_a_hover_has_no_parallax(config: Config) -> None:
    scene = draw(np.random.default_rng(0), config, replace(CALM, speed_m_s=0.0, error_scale=0.1))
    window = scene.window()
    assert window.solve() is Status.LOW_PARALLAX
    assert window.solved is None


def test_a_flight_that_shares_too_few_points_is_featureless() -> None:
    scene = draw(np.random.default_rng(0), spec=replace(CALM, points=10))
    window = scene.window()
    assert window.solve() is Status.FEATURELESS


@pytest.mark.parametrize("seed", rest_long(range(3)))
def test_tracks_that_mean_nothing_are_a_poor_fit(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scene = draw(rng, spec=CALM)
    for k in scene.keys:
        ids = scene.observations[k].ids
        uv = np.column_stack([rng.uniform(5, 630, len(ids)), rng.uniform(5, 470, len(ids))])
        scene.observations[k] = observation(CAMERA, ids, uv)
    window = scene.window()
    assert window.solve() in (Status.POOR_FIT, Status.LOW_PARALLAX)
    assert window.solved is None


MOUNTS = ["pitch_deg = 90.0", "roll_deg = 180.0", "pitch_deg = -90.0\nyaw_deg = 180.0"]


@pytest.mark.parametrize("mount", rest_long(MOUNTS))
def test_a_mount_that_looks_elsewhere_than_declared_is_refused(mount: str) -> None:
    """Upside down, or the wrong way round, with an attitude sensor that says so: turned over, not published."""
    scene = draw(np.random.default_rng(2), spec=CALM)
    window = Window(parse_config(f"[mount]\n{mount}"), CAMERA)
    for k in scene.keys:
        add(window, scene, int(k))
    assert window.solve() is not Status.OK
    assert window.solved is None


@pytest.mark.parametrize("seed", rest_long(range(6), 2))
def test_a_start_upside_down_is_never_published_upside_down(seed: int) -> None:
    """Without attitude a mirrored scene below an inverted camera explains the pixels as well: it must not go out."""
    rng = np.random.default_rng(seed)
    scene = draw(rng, SEED_SENSORS, replace(CALM, crab_deg=15.0))
    window = scene.window()
    status = window.solve()
    assert status is not Status.OK or worst_turn_deg(window, scene) < 10.0


def test_a_sliding_window_keeps_ten_keyframes_and_stays_right() -> None:
    scene = draw(np.random.default_rng(3), spec=replace(CALM, keyframes=18, points=300))
    window = Window(FULL, CAMERA)
    worst = []
    for k in scene.keys:
        add(window, scene, int(k))
        if window.solve() is Status.OK:
            solved = window.solved
            off = solved.solution.state.centres_enu_m - scene.centres_enu_m[list(solved.frames)]
            worst.append(np.linalg.norm(off, axis=1).max())
    assert len(window.keyframes) == FULL.solve.keyframes
    assert len(worst) == len(scene.keys) - MIN_KEYFRAMES + 1
    assert 0.0 < max(worst) < 6.0


@pytest.mark.parametrize("true_px", rest_long([0.8, 0.15]))
def test_the_noise_of_tracking_is_learned(true_px: float) -> None:
    scene = draw(np.random.default_rng(3), spec=replace(CALM, keyframes=20, points=300, pixel_sigma_px=true_px))
    window = Window(FULL, CAMERA)
    for k in scene.keys:
        add(window, scene, int(k))
        window.solve()
    # What is learned is the residuals' size; a fit's residuals are smaller than the noise by its degrees of freedom.
    assert 0.85 * true_px < window.noise.pixel_sigma_px < 1.15 * true_px


def test_a_reset_window_knows_nothing() -> None:
    scene = draw(np.random.default_rng(0), spec=CALM)
    window = scene.window()
    assert window.solve() is Status.OK
    window.reset()
    assert window.solved is None
    assert window.solve() is Status.STARTING


def test_a_solution_survives_a_solve_that_fails() -> None:
    scene = draw(np.random.default_rng(0), spec=CALM)
    window = Window(FULL, CAMERA)
    for k in scene.keys[:5]:
        add(window, scene, int(k))
    assert window.solve() is Status.OK
    before = window.solved
    empty = observation(CAMERA, np.zeros(0, np.int64), np.zeros((0, 2)))
    for k in range(10):
        window.add(100 + k, empty, scene.navs[int(scene.keys[5])], (0.0, 0.0), None, None)
    assert window.solve() is Status.FEATURELESS
    assert window.solved is before


def subset(scene: Scene, k: int, ids: NDArray[np.int64]) -> None:
    seen = scene.observations[k]
    kept = np.isin(seen.ids, ids)
    scene.observations[k] = observation(CAMERA, seen.ids[kept], seen.uv_px[kept])


@pytest.mark.parametrize("seed", rest_long(range(3)))
def test_a_picture_that_shares_no_known_point_is_oriented_from_the_one_before_it(seed: int) -> None:
    """As after a quick roll, where no sensor gives attitude: what both see has been seen but once before."""
    scene = draw(np.random.default_rng(seed), SEED_SENSORS, replace(CALM, points=400))
    *earlier, newest, last = (int(k) for k in scene.keys)
    both = np.intersect1d(scene.observations[newest].ids, scene.observations[last].ids)[::2]
    for k in earlier:
        subset(scene, k, np.setdiff1d(scene.observations[k].ids, both))
    subset(scene, last, both)
    window = Window(SEED_SENSORS, CAMERA)
    for k in (*earlier, newest):
        add(window, scene, k)
    assert window.solve() is Status.OK
    assert not window.solved.rows(both)[1].any()
    guess = window.pose_guess(scene.observations[last], scene.navs[last])
    turn_deg = np.degrees(np.linalg.norm(log_so3(guess.R_cam_enu @ scene.R_cam_enu[last].T)))
    assert 0.0 < turn_deg < 6.0
    add(window, scene, last)
    assert window.solve() is Status.OK
    assert worst_turn_deg(window, scene) < 6.0


def test_a_picture_that_fits_nothing_is_not_published_with_those_that_do() -> None:
    """Its pose would be its position's alone, and the next window would begin from it."""
    rng = np.random.default_rng(0)
    scene = draw(rng, SEED_SENSORS, CALM)
    last = int(scene.keys[-1])
    seen = scene.observations[last]
    scene.observations[last] = observation(CAMERA, seen.ids, rng.permutation(seen.uv_px))
    window = scene.window()
    assert window.solve() is Status.POOR_FIT
    assert "a picture contradicts the others" in window.refusal


@pytest.mark.parametrize("seed", rest_long(range(3)))
def test_a_climb_without_attitude_tells_no_heading_and_the_flight_after_it_does(seed: int) -> None:
    spec = replace(CALM, height_m=60.0, speed_m_s=0.0, climb_m_s=4.0, error_scale=0.1)
    scene = draw(np.random.default_rng(seed), SEED_SENSORS, spec)
    window = scene.window()
    assert window.solve() is Status.LOW_PARALLAX
    assert "heading" in window.refusal
    with_attitude = draw(np.random.default_rng(seed), FULL, spec).window()
    assert with_attitude.solve() is Status.OK
    onward = draw(np.random.default_rng(seed), SEED_SENSORS, replace(spec, speed_m_s=6.0, climb_m_s=2.0))
    window = onward.window()
    assert window.solve() is Status.OK
    assert worst_turn_deg(window, onward) < 6.0
