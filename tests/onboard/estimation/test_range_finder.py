"""The range finder in the window solve: the scene's scale gets as good as it says, and a roof does not spoil it."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from contract.feature_set import Status
from onboard.estimation.sliding_window import Window
from onboard.navigation.navigator import GroundRange
from tests.onboard.scenes import SEED_SENSORS, Scene, SceneSpec, draw

pytestmark = pytest.mark.xdist_group("range finder")  # one worker: what they share is made once

Array = NDArray[np.float64]
SIGMA_M = 0.5
SPEC = SceneSpec(relief_sigma_m=0.5, step_s=0.5)


def ranged(scene: Scene, rng: np.random.Generator, roof: int | None = None) -> Scene:
    """The scene with a vertical range at every picture; from one of them a roof 25 m above the ground."""
    heights = scene.centres_enu_m[:, 2] - scene.ground.height_m(scene.centres_enu_m[:, :2])
    heights = heights + SIGMA_M * rng.standard_normal(len(heights))
    if roof is not None:
        heights[scene.keys[roof]] -= 25.0
    navs = [
        replace(nav, ground_range=GroundRange(np.array([0.0, 0.0, -h]), SIGMA_M))
        for nav, h in zip(scene.navs, heights, strict=True)
    ]
    return replace(scene, navs=navs)


def scale_error(scene: Scene) -> tuple[float, float]:
    """Mean relative error of height above ground in the newest keyframe, and its stated sigma."""
    window = scene.window()
    assert window.solve() is Status.OK
    s = window.solved
    k = scene.keys[-1]
    points, truth = s.solution.state.points_enu_m[s.good], scene.points_enu_m[s.point_ids[s.good]]
    height = scene.centres_enu_m[k, 2] - truth[:, 2]
    found = s.solution.state.centres_enu_m[-1, 2] - points[:, 2]
    return float(np.mean(found / height) - 1.0), scale_sigma(window)


def scale_sigma(window: Window) -> float:
    s = window.solved
    layout, good = s.layout, s.good
    M = -s.solution.point_gain[good][:, 2].mean(axis=0)
    M[layout.centre(layout.keyframes - 1).stop - 1] -= 1.0
    height = (s.solution.state.centres_enu_m[-1, 2] - s.solution.state.points_enu_m[good][:, 2]).mean()
    return float(np.sqrt(M @ s.solution.covariance @ M) / height)


@pytest.fixture(scope="module")
def scenes() -> list[Scene]:
    return [draw(np.random.default_rng([5, k]), SEED_SENSORS, SPEC) for k in range(12)]


def twice_as_good_with_ranges(scenes: list[Scene]) -> Array:
    """Scale errors and their stated sigmas (N, 2) with ranges, both half of those without."""
    plain = np.array([scale_error(s) for s in scenes])
    with_range = np.array([scale_error(ranged(s, np.random.default_rng([6, k % 12]))) for k, s in enumerate(scenes)])
    rms_plain, rms = (np.sqrt(np.mean(e[:, 0] ** 2)) for e in (plain, with_range))
    assert rms < 0.5 * rms_plain
    assert np.median(with_range[:, 1]) < 0.5 * np.median(plain[:, 1])
    return with_range


@pytest.mark.long
def test_ranges_give_the_seeds_sensors_a_scale_twice_as_good_and_stated_so(scenes: list[Scene]) -> None:
    twice_as_good_with_ranges(scenes[:8])


@pytest.mark.long  # whether it is as good as stated takes two dozen scenes; short, without that: above
def test_ranges_give_the_seeds_sensors_a_scale_as_good_as_they_say(scenes: list[Scene]) -> None:
    scenes = [*scenes, *(draw(np.random.default_rng([15, k]), SEED_SENSORS, SPEC) for k in range(12))]
    with_range = twice_as_good_with_ranges(scenes)
    assert 0.65 < np.sqrt(np.mean((with_range[:, 0] / with_range[:, 1]) ** 2)) < 1.35


def test_one_echo_from_a_roof_is_left_out(scenes: list[Scene]) -> None:
    for k, scene in enumerate(scenes[:4]):
        clean, roofed = (ranged(scene, np.random.default_rng(k), roof) for roof in (None, 4))
        assert abs(scale_error(roofed)[0] - scale_error(clean)[0]) < 0.003
