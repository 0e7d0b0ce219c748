"""What is published is what is true: clicks on solved windows fall into their ellipses as often as the ellipses say."""

from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from contract.answer import CHI2_2, Fix
from contract.feature_set import FeatureSet, Status
from contract.locate import Locator
from contract.rotations import log_so3
from contract.wire.codec import decode, encode
from onboard.config.schema import Config
from onboard.estimation import variance_components
from onboard.estimation.keyframe import observation
from onboard.estimation.sliding_window import Window
from onboard.georeferencing.feature_sets import Origin, Picture, Placed, place
from tests.onboard.scenes import FRAME, FULL, SEED_SENSORS, T0_NS, Scene, SceneSpec, draw
from tests.rest_long import rest_long

Array = NDArray[np.float64]

UNDULATION_M = 11.0
LOW_CLIMB = SceneSpec(speed_m_s=0.5, climb_m_s=3.0, height_m=30.0)


def solved(scene: Scene) -> Window:
    window = scene.window()
    assert window.solve() is Status.OK
    return window


def placed_by(scene: Scene, window: Window, frame: int) -> Placed | Status:
    seen, nav = scene.observations[frame], scene.navs[frame]
    guess = window.pose_guess(seen, nav)
    assert guess is not None
    assert window.solved is not None
    origin = Origin("uav-1", 7, frame, T0_NS + frame, 0, bool(scene.is_key[frame]))
    picture = Picture(window.camera, origin, FRAME, UNDULATION_M)
    return place(window, window.solved, seen, picture, guess, nav)


def publish(scene: Scene, window: Window, frame: int) -> FeatureSet | Status:
    placed = placed_by(scene, window, frame)
    return placed.feature_set if isinstance(placed, Placed) else placed


@pytest.mark.parametrize("spec", [SceneSpec(), LOW_CLIMB], ids=["level", "low climb"])
def test_what_moves_the_window_moves_every_picture_with_it(spec: SceneSpec) -> None:
    """A picture between keyframes has the window's errors, whatever its own prior adds: that is a keyframe's pose."""
    scene = draw(np.random.default_rng(2), FULL, spec)
    window = solved(scene)
    layout, slope = window.solved.layout, window.solved.solution.state.plane[1:]
    for axis in range(3):
        moved = np.zeros(layout.size)
        moved[layout.centres()[:, axis]] = 1.0
        moved[np.arange(layout.size)[layout.plane][0]] = [-slope[0], -slope[1], 1.0][axis]
        for frame in (scene.keys[3], scene.keys[3] + 1):
            placed = placed_by(scene, window, int(frame))
            assert isinstance(placed, Placed)
            np.testing.assert_allclose(placed.by_state @ moved, np.eye(9)[axis], atol=1e-6)


def truth_at(scene: Scene, frame: int, uv: Array) -> Array:
    rays = scene.camera.unproject(uv)[0] @ scene.R_cam_enu[frame]
    return scene.ground.meet(scene.centres_enu_m[frame], rays)


def enu(fix: Fix) -> Array:
    assert fix.height_amsl_m is not None
    return FRAME.to_enu(fix.lat_deg, fix.lon_deg, fix.height_amsl_m)


@dataclass
class Study:
    """One row a world: the first click's normalised squares, the pose's, the difference's to a second click."""

    horizontal: list[float] = field(default_factory=list)  # squared sigmas, two degrees of freedom
    height: list[float] = field(default_factory=list)
    pose: list[float] = field(default_factory=list)  # position and rotation, six
    relative: list[float] = field(default_factory=list)  # difference of two clicks, three
    major_m: list[float] = field(default_factory=list)
    error_m: list[float] = field(default_factory=list)
    refused: int = 0


@cache
def study(
    config: Config, spec: SceneSpec, worlds: int, first_seed: int = 0, may_refuse: int = 0
) -> tuple[Study, Study]:
    """Fly, solve, publish and click in worlds as `config` believes them: on a keyframe, and on a picture between.

    At most `may_refuse` windows may be refused; with errors as configured none is.
    """
    out = Study(), Study()
    refused = 0
    for seed in range(first_seed, first_seed + worlds):
        rng = np.random.default_rng(seed)
        scene = draw(rng, config, spec)
        window = scene.window()
        if (status := window.solve()) is not Status.OK:
            refused += 1
            assert refused <= may_refuse, status
            continue
        uv = np.stack([rng.uniform([80, 80], [300, 400]), rng.uniform([340, 80], [560, 400])])
        middle = int(scene.keys[len(scene.keys) // 2])
        for one, frame in zip(out, (middle, middle + 1), strict=True):
            _click(one, scene, window, frame, uv)
    return out


def _click(out: Study, scene: Scene, window: Window, frame: int, uv: Array) -> None:
    s = publish(scene, window, frame)
    assert isinstance(s, FeatureSet)
    locator = Locator(s)
    first, second = (locator.locate(at) for at in uv)
    if not isinstance(first, Fix) or not isinstance(second, Fix):
        out.refused += 1
        return
    truth = truth_at(scene, frame, uv)
    error, other = enu(first) - truth[0], enu(second) - truth[1]
    cov = first.covariance_enu_m2
    out.horizontal.append(float(error[:2] @ np.linalg.solve(cov[:2, :2], error[:2])))
    out.height.append(float(error[2] ** 2 / cov[2, 2]))
    turn = log_so3(s.R_enu_cam @ scene.R_cam_enu[frame])
    centre = FRAME.to_enu(s.camera_lat_deg, s.camera_lon_deg, s.camera_height_m)
    pose = np.concatenate([centre - scene.centres_enu_m[frame], turn])
    out.pose.append(float(pose @ np.linalg.solve(s.common_cov[:6, :6], pose)) / 6)
    joint = locator.difference_covariance(*uv)
    assert joint is not None
    out.relative.append(float((error - other) @ np.linalg.solve(joint, error - other)) / 3)
    out.major_m.append(first.ellipse.semi_major_m)
    out.error_m.append(float(np.linalg.norm(error[:2])))


FEW_WORLDS, WORLDS = 40, 100


@pytest.mark.parametrize("worlds", rest_long([FEW_WORLDS, WORLDS]))
def test_nine_of_ten_clicks_lie_inside_the_ellipse_with_the_full_sensor_set(worlds: int) -> None:
    """Flat ground of unknown slope, every sensor erring as configured, boresight and clock unknown.

    Means of chi-square over 100 worlds have a sigma of 0.1 (two degrees of freedom), 0.14, 0.06 and 0.08.
    """
    for s in study(FULL, SceneSpec(), worlds):
        assert s.refused == 0
        assert 0.85 < np.mean(np.array(s.horizontal) < CHI2_2) < 0.965
        assert 0.75 < np.mean(s.horizontal) / 2 < 1.25
        assert 0.70 < np.mean(s.height) < 1.35
        assert 0.80 < np.mean(s.pose) < 1.20
        assert 0.75 < np.mean(s.relative) < 1.25
        assert 4.0 < np.median(s.major_m) < 14.0


@pytest.mark.long
def test_nine_of_ten_clicks_lie_inside_the_ellipse_over_hills() -> None:
    for s in study(FULL, SceneSpec(relief_sigma_m=3.0), WORLDS, first_seed=1000):
        assert s.refused == 0
        assert 0.85 < np.mean(np.array(s.horizontal) < CHI2_2) < 0.965
        assert 0.7 < np.mean(s.horizontal) / 2 < 1.25
        assert 0.5 < np.mean(s.height) < 1.35
        assert 0.4 < np.mean(s.relative) < 1.25


@pytest.mark.long
def test_with_the_seeds_sensors_the_ellipse_is_wide_and_holds_what_it_says() -> None:
    """No attitude, no velocity: the path's weak belief (a bank of 15 degrees) is wider than this calm flight."""
    s, _ = study(SEED_SENSORS, SceneSpec(), 50, first_seed=2000)
    assert s.refused == 0
    assert 0.8 < np.mean(np.array(s.horizontal) < CHI2_2) < 1.0  # of 50 flights: one sigma is 0.042
    assert 0.4 < np.mean(s.horizontal) / 2 < 1.3
    assert 10.0 < np.median(s.major_m) < 35.0
    assert 3.0 < np.median(s.error_m) < 12.0


@pytest.mark.long
def test_an_ellipse_that_is_taken_too_small_would_be_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sensors with errors twice as large as configured: clicks leave their ellipses, or the window is refused.

    The configuration is held to be right, whatever residuals say.
    """
    monkeypatch.setattr(variance_components, "PRIOR_COUNT", 1e9)
    s, _ = study(FULL, SceneSpec(error_scale=2.0), 40, first_seed=3000, may_refuse=10)
    assert np.mean(np.array(s.horizontal) < CHI2_2) < 0.7
    assert 2.5 < np.mean(s.horizontal) / 2 < 6.0


@pytest.mark.long
def test_better_sensors_make_smaller_ellipses() -> None:
    full, _ = study(FULL, SceneSpec(), FEW_WORLDS)  # solved for what is above; as many count as of the other
    seed, _ = study(SEED_SENSORS, SceneSpec(), 8)
    assert 1.3 < np.median(seed.major_m) / np.median(full.major_m[:8]) < 5.0


def test_without_errors_a_click_is_where_the_ground_is() -> None:
    spec = SceneSpec(error_scale=0.0, pixel_sigma_px=0.0)
    for s in study(FULL, spec, 3):
        assert 0.0 <= max(s.error_m) < 0.05


def test_a_set_of_a_window_survives_the_wire_and_answers_the_same() -> None:
    scene = draw(np.random.default_rng(4))
    s = publish(scene, solved(scene), int(scene.keys[4]))
    assert isinstance(s, FeatureSet)
    assert 60 <= len(s) <= 100
    received = decode(encode(s))
    for uv in ((100.0, 100.0), (320.0, 240.0), (500.0, 400.0)):
        sent, got = Locator(s).locate(uv), Locator(received).locate(uv)
        assert isinstance(sent, Fix)
        assert isinstance(got, Fix)
        assert np.linalg.norm(enu(sent) - enu(got)) < 0.2
        assert got.ellipse.semi_major_m == pytest.approx(sent.ellipse.semi_major_m, rel=0.05)


def test_a_set_says_what_picture_it_is() -> None:
    scene = draw(np.random.default_rng(5))
    frame = int(scene.keys[3])
    s = publish(scene, solved(scene), frame)
    assert isinstance(s, FeatureSet)
    assert (s.vehicle, s.session, s.frame, s.capture_unix_ns) == ("uav-1", 7, frame, T0_NS + frame)
    assert s.is_keyframe
    assert s.undulation_m == UNDULATION_M
    assert (s.shared.position_time_s, s.shared.attitude_time_s) == (
        FULL.gps.correlation_time_s,
        FULL.solve.attitude_correlation_time_s,
    )
    fresh = s.common_cov - s.shared.by_nuisance @ s.shared.by_nuisance.T
    sigma = np.sqrt(np.diag(s.common_cov))
    assert 1e-5 < np.linalg.eigvalsh(fresh / np.outer(sigma, sigma))[0] < 1.0
    # Most of where the window is, and hardly anything of its shape, is what its neighbours err by too.
    shares = 1.0 - np.diag(fresh) / np.diag(s.common_cov)
    assert np.all(shares[:3] > 0.7) and np.all(shares[6:] < 0.3)
    assert np.all(np.linalg.eigvalsh(s.common_cov) > 0.0)
    assert np.all(s.sigma_inverse_depth_per_m > 0.0)
    assert s.inverse_depth_per_m == pytest.approx(1.0 / 250.0, rel=0.15)


def test_a_picture_that_shares_too_little_with_the_window_is_refused() -> None:
    scene = draw(np.random.default_rng(6))
    window = solved(scene)
    frame = int(scene.keys[2]) + 1
    seen = scene.observations[frame]
    few = observation(window.camera, seen.ids[:5], seen.uv_px[:5])
    scene.observations[frame] = few
    assert publish(scene, window, frame) is Status.FEATURELESS


def test_a_picture_whose_pixels_contradict_the_window_is_refused() -> None:
    rng = np.random.default_rng(7)
    scene = draw(rng)
    window = solved(scene)
    frame = int(scene.keys[2]) + 1
    seen = scene.observations[frame]
    scene.observations[frame] = replace(seen, raw_xy=seen.raw_xy + rng.uniform(-0.1, 0.1, seen.xy.shape))
    assert publish(scene, window, frame) is Status.POOR_FIT
