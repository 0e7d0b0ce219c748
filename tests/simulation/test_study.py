"""Claims about the seed's error study: its world, its order of steps, and what it must find."""

import csv
from pathlib import Path

import numpy as np
import pytest

from onboard.estimation.bundle_adjustment import parallax_of
from onboard.estimation.factors import State
from onboard.estimation.platform_states import STATES
from onboard.geometry.relative_orientation import epipolar_error, refine_direction, start_pair
from onboard.geometry.triangulation import triangulate
from simulation import study, study_seed
from simulation.study_window import Setting, begin, bound, draw, estimate, point_covariance
from simulation.study_world import (
    AXES,
    BASELINE_M,
    CAMERA,
    GRID_M,
    HEIGHT_M,
    R_BODY_CAM,
    nominal,
    two_views,
    unit_depth,
)
from tests.rest_long import rest_long


def rays(uv_px: np.ndarray) -> np.ndarray:
    xy = unit_depth(uv_px)
    return np.concatenate([xy, np.ones((*xy.shape[:2], 1))], axis=-1)


def test_the_world_is_the_seeds() -> None:
    scene = two_views()
    travel = scene.centres_enu_m[1] - scene.centres_enu_m[0]
    assert np.degrees(np.arctan2(travel[1], travel[0])) == pytest.approx(30.0)
    assert np.linalg.norm(travel) == pytest.approx(BASELINE_M)
    assert scene.centres_enu_m[:, 2] == pytest.approx([HEIGHT_M] * 2)
    assert np.all(scene.points_enu_m % GRID_M == 0.0)
    assert np.all((scene.uv_px >= -0.5) & (scene.uv_px <= [639.5, 479.5]))
    # A picture covers 182 m by 136 m; what both see is 142 m by 136 m, a feature in every 25 square metres.
    assert 720 < len(scene.points_enu_m) < 810
    assert CAMERA.fx_px == pytest.approx(320.0 / np.tan(np.radians(20.0)))
    # x along the travel, z straight down
    assert nominal() @ travel == pytest.approx([BASELINE_M, 0.0, 0.0])
    assert nominal()[2] == pytest.approx([0.0, 0.0, -1.0])


def test_turning_the_camera_moves_the_picture_as_its_axes_say() -> None:
    # A positive turn about y (pitch) swings the optical axis to +x, about x (roll) to -y; about z (heading) keeps it.
    angle = np.radians(5.0)
    for axis, expected in (("pitch", [np.sin(angle), 0.0]), ("roll", [0.0, -np.sin(angle)]), ("heading", [0.0, 0.0])):
        scene = two_views(first=(axis, angle))
        axis_in_nominal = nominal() @ scene.R_cam_enu[0, 2]
        assert axis_in_nominal[:2] == pytest.approx(expected, abs=1e-12)


def test_an_aligned_flight_without_noise_is_exact_from_the_start() -> None:
    scene = two_views()
    errors = study_seed.errors(scene.uv_px, scene.centres_enu_m, scene.points_enu_m, (0, 25, None))
    assert max(errors) < 1e-9


def test_roll_alone_is_removed_by_levelling_before_any_adjustment() -> None:
    scene = two_views(first=("roll", np.radians(10.0)))
    assert study_seed.errors(scene.uv_px, scene.centres_enu_m, scene.points_enu_m, (0,))[0] < 0.01


@pytest.mark.parametrize("turned", ["first", "second"])
@pytest.mark.parametrize("axis", ["heading", "pitch"])
def test_misalignment_hurts_the_start_and_adjustment_removes_it(turned: str, axis: str) -> None:
    scene = two_views(**{turned: (axis, np.radians(5.0))})
    start, some, converged = study_seed.errors(scene.uv_px, scene.centres_enu_m, scene.points_enu_m, (0, 25, None))
    assert start > 3.0
    assert some < start
    assert converged < 0.01


@pytest.mark.parametrize("turned", ["first", "second"])
@pytest.mark.parametrize("axis", list(AXES))
@pytest.mark.parametrize("angle_deg", rest_long([-15.0, 15.0, -5.0, 5.0], kept=2))
def test_onboards_start_reaches_a_centimetre_within_fifteen_iterations(
    turned: str, axis: str, angle_deg: float
) -> None:
    scene = two_views(**{turned: (axis, np.radians(angle_deg))})
    both, centres = rays(scene.uv_px), scene.centres_enu_m
    pair = start_pair(both[0], both[1], centres[1] - centres[0], R_BODY_CAM, 1.5 / CAMERA.focal_px)
    assert pair is not None
    R = np.stack([pair.first, pair.second])
    xy = unit_depth(scene.uv_px)
    points = triangulate(R, centres, xy, np.ones(xy.shape[:2], bool)).points_enu_m
    begun = State(R, centres, points, np.zeros(STATES), np.zeros(3))
    state = study_seed.adjusted(scene.uv_px, centres, begun, 15).state
    assert np.linalg.norm(study_seed.levelled(state) - scene.points_enu_m, axis=1).mean() < 0.01


def test_refining_the_direction_of_travel_goes_downhill() -> None:
    scene = two_views(first=("heading", np.radians(5.0)))
    first, second = rays(scene.uv_px)
    t = nominal() @ (scene.centres_enu_m[1] - scene.centres_enu_m[0])
    Q, refined = refine_direction(first, second, np.eye(3), t, 1.5 / CAMERA.focal_px)
    before = np.abs(epipolar_error(first, second, np.eye(3), t)).mean()
    assert np.abs(epipolar_error(first, second, Q, refined)).mean() < 1e-6 * before
    truth = scene.R_cam_enu[0] @ (scene.centres_enu_m[1] - scene.centres_enu_m[0])
    assert refined == pytest.approx(truth, abs=1e-6)


def test_gps_noise_scales_the_scene_and_pixels_matter_less() -> None:
    rows = {(r.panel, r.value, r.curve): r.mean_error_m for r in study.fig6(seeds=3)}
    assert rows["gps_noise_m", 0.0, "converged"] < 1e-9
    # 1 m on each end of 40 m: three and a half percent of 250 m, two degrees of direction, and the position itself.
    assert 5.0 < rows["gps_noise_m", 1.0, "converged"] < 25.0
    assert rows["pixel_noise_px", 1.0, "converged"] < 0.6 * rows["gps_noise_m", 1.0, "converged"]
    assert rows["gps_noise_m", 2.0, "converged"] == pytest.approx(2.0 * rows["gps_noise_m", 1.0, "converged"], rel=0.15)


def test_the_bound_is_the_inverse_of_a_numerical_fisher_information() -> None:
    setting = Setting(views=3, features_per_view=6, attitude_correlated_deg=(0.5, 2.0), velocity_sigma_m_s=0.1)
    flight = draw(setting, np.random.default_rng(3))
    problem, truth, size = flight.problem, flight.truth, flight.problem.layout.size
    P = len(truth.points_enu_m)

    def whitened(step: np.ndarray) -> np.ndarray:
        state = truth.retract(step[:size], step[size:].reshape(P, 3))
        p = np.einsum("kij,kpj->kpi", state.R_cam_enu, state.points_enu_m[None] - state.centres_enu_m[:, None])
        image = ((p[..., :2] / p[..., 2:] - problem.xy) * problem.weight[..., None]).ravel()
        offset = state.points_enu_m - problem.reference_enu_m
        height = offset[:, 2] - state.plane[0] - offset[:, :2] @ state.plane[1:]
        # relief counts by what a metre of it moves in the pictures: (5.9)
        assert problem.parallax is not None
        height *= parallax_of(state.centres_enu_m, problem.reference_enu_m, state.plane) / problem.parallax
        priors = [prior.evaluate(state)[0] for prior in problem.priors]
        return np.concatenate([image, height / setting.relief_sigma_m, *priors])

    h = 1e-6
    steps = h * np.eye(size + 3 * P)
    J = np.stack([(whitened(s) - whitened(-s)) / (2.0 * h) for s in steps], axis=1)
    # Scaled to a unit diagonal before inversion: rotations and metres differ by many powers of ten.
    information = J.T @ J
    scale = 1.0 / np.sqrt(np.diag(information))
    dense = np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale)
    ours = bound(flight)
    expected = np.sqrt(np.diag(dense))
    assert np.sqrt(np.diag(ours.covariance)) == pytest.approx(expected[:size], rel=1e-3)
    points = np.sqrt(np.einsum("pii->pi", point_covariance(ours)).ravel())
    assert points == pytest.approx(expected[size:], rel=1e-3)


def test_a_flight_with_every_sensor_is_estimated_near_its_bound() -> None:
    setting = Setting(attitude_correlated_deg=(0.5, 2.0), velocity_sigma_m_s=0.1, outlier_share=0.2)
    squared, bounds = [], []
    for seed in range(6):
        flight = draw(setting, np.random.default_rng(seed))
        start = begin(flight)
        assert start is not None
        solution, _ = estimate(flight, start)
        good = ~flight.is_outlier
        squared.append(np.sum((solution.state.points_enu_m - flight.truth.points_enu_m)[good] ** 2, axis=1).mean())
        bounds.append(np.trace(point_covariance(bound(flight))[good], axis1=1, axis2=2).mean())
    # Six flights say little about a ratio; far too good would be a leak of the truth, far too bad a failure.
    assert 0.3 < np.sqrt(np.mean(squared) / np.mean(bounds)) < 2.0


def test_the_command_writes_the_columns_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(study, "ANGLES_DEG", (-2.0, 0.0, 2.0))
    monkeypatch.setattr(study, "WINDOW_ANGLES_DEG", (0.0,))
    monkeypatch.setattr(study, "FIGURES", {"fig8": (study.fig8, lambda: study.fig8_windows(seeds=1))})
    assert study.main(["fig8", "--out", str(tmp_path / "new")]) == 0
    with (tmp_path / "new" / "fig8.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["axis", "value", "iterations", "mean_error_m"]
    assert {r["axis"] for r in rows} == {"heading", "pitch", "roll"}
    assert [r["iterations"] for r in rows[:4]] == ["initial", "25", "50", "converged"]
    assert len(rows) == 3 * 3 * 4
    for name in ("fig8.png", "fig8_windows.png"):
        assert (tmp_path / "new" / name).read_bytes().startswith(b"\x89PNG")
