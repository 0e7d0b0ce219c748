"""Starting orientations: right where the seed's assumptions hold, near enough where they do not."""

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from contract.rotations import R_ENU_NED, exp_so3, log_so3, matrix_from_euler, mount_rotation
from onboard.estimation import window_start
from onboard.geometry.relative_orientation import (
    _five_point,
    absolute_from_direction,
    epipolar_error,
    refine_direction,
    relative_lsq,
    relative_ransac,
    rotation_only,
    small_angle,
    start_pair,
    travel_aligned,
)
from tests.rest_long import rest_long

Array = NDArray[np.float64]

PIXEL = 0.3 / 900.0
TOLERANCE = 4.0 * PIXEL


@dataclass(frozen=True, eq=False)
class Views:
    """Two views of one ground: rays (N, 3) of both, truth, and what is assumed of the mount."""

    rays1: Array
    rays2: Array
    first: Array  # R_cam_enu
    second: Array
    baseline_enu_m: Array
    R_body_cam: Array

    @property
    def Q(self) -> Array:
        return self.second @ self.first.T

    @property
    def t_cam1(self) -> Array:
        return self.first @ self.baseline_enu_m


def angle_deg(A: Array, B: Array) -> float:
    return float(np.degrees(np.linalg.norm(log_so3(A @ B.T))))


def views(
    rng: np.random.Generator,
    *,
    turn_deg: float = 0.0,
    crab_deg: float = 0.0,
    mount_yaw_deg: float = 0.0,
    mount_pitch_deg: float = -90.0,
    roll_deg: float = 0.0,
    relief_m: float = 15.0,
    baseline_m: float = 80.0,
    noise: float = PIXEL,
    outliers: float = 0.0,
    count: int = 90,
) -> Views:
    """250 m above rough ground, heading 30 degrees; the second view is turned against the first about a random axis."""
    heading = np.radians(30.0)
    R_body_cam = mount_rotation(0.0, mount_pitch_deg, mount_yaw_deg)
    R_enu_body = R_ENU_NED @ matrix_from_euler(np.radians(roll_deg), 0.0, heading + np.radians(crab_deg))
    first = (R_enu_body @ R_body_cam).T
    axis = rng.standard_normal(3)
    second = exp_so3(np.radians(turn_deg) * axis / np.linalg.norm(axis)) @ first
    baseline = baseline_m * np.array([np.sin(heading), np.cos(heading), 0.02])
    centre = np.array([0.0, 0.0, 250.0])
    pixels = rng.uniform([-0.36, -0.27], [0.36, 0.27], (6 * count, 2))
    d = np.concatenate([pixels, np.ones((6 * count, 1))], axis=1) @ first
    d = d[d[:, 2] < -0.1]
    ground = centre + d * (-250.0 / d[:, 2])[:, None]
    ground[:, 2] = relief_m * rng.standard_normal(len(ground))
    p1, p2 = (ground - centre) @ first.T, (ground - centre - baseline) @ second.T
    rays = [p / p[:, 2:] for p in (p1, p2)]
    inside = np.all(
        [np.all(np.abs(r[:, :2]) < [0.36, 0.27], axis=1) & (p[:, 2] > 0) for r, p in zip(rays, (p1, p2), strict=True)],
        0,
    )
    rays1, rays2 = (r[inside][:count] for r in rays)
    for r in (rays1, rays2):
        r[:, :2] += noise * rng.standard_normal((len(r), 2))
    wrong = np.arange(len(rays2)) < outliers * len(rays2)
    rays2[wrong, :2] = rng.uniform([-0.36, -0.27], [0.36, 0.27], (int(wrong.sum()), 2))
    return Views(rays1, rays2, first, second, baseline, R_body_cam)


def test_the_camera_that_flies_along_its_nose_looks_where_the_mount_says() -> None:
    """(3.2): heading 30 degrees, mount straight down: picture's top to the nose; yaw -90: x to the nose, the seed's."""
    travel = np.array([10.0, 10.0 * np.sqrt(3.0), 0.0])
    down = travel_aligned(travel, mount_rotation(0.0, -90.0, 0.0))
    nose = travel / 20.0
    assert down[2] == pytest.approx([0.0, 0.0, -1.0], abs=1e-12)
    assert down[1] == pytest.approx(-nose, abs=1e-12)
    seed = travel_aligned(travel, mount_rotation(0.0, -90.0, -90.0))
    assert seed[0] == pytest.approx(nose, abs=1e-12)
    assert seed[2] == pytest.approx([0.0, 0.0, -1.0], abs=1e-12)


def test_the_climbing_camera_has_its_x_along_the_climb_and_no_roll() -> None:
    travel = np.array([30.0, 0.0, 8.0])
    R = travel_aligned(travel, mount_rotation(0.0, -90.0, -90.0))
    assert R[0] == pytest.approx(travel / np.linalg.norm(travel), abs=1e-12)
    assert R[1, 2] == pytest.approx(0.0, abs=1e-12)


def test_true_matches_lie_on_their_epipolar_planes_and_a_pixel_off_is_a_pixel_off() -> None:
    v = views(np.random.default_rng(0), turn_deg=3.0, noise=0.0)
    assert epipolar_error(v.rays1, v.rays2, v.Q, v.t_cam1) == pytest.approx(0.0, abs=1e-12)
    # Both ends moved by PIXEL across the epipolar lines: Sampson's distance is what both ends share, sqrt(2) PIXEL.
    normal = np.cross(v.t_cam1, v.rays1) @ v.Q.T
    across2 = normal[:, :2] / np.linalg.norm(normal[:, :2], axis=1, keepdims=True)
    moved = v.rays2.copy()
    moved[:, :2] += PIXEL * across2
    error = np.abs(epipolar_error(v.rays1, moved, v.Q, v.t_cam1))
    assert error == pytest.approx(PIXEL / np.sqrt(2.0), rel=0.05)


def test_the_seeds_printed_constraint_mixes_axes_and_ours_does_not() -> None:
    """(3.3) and the three readings of the seed's line: world rays with t, camera rays with R t; never R^-1 t."""
    # Oblique: the R of a camera that looks straight down is a half turn, its own inverse, and hides one of the errors.
    v = views(np.random.default_rng(6), turn_deg=3.0, noise=0.0, mount_yaw_deg=-90.0, mount_pitch_deg=-50.0)
    R, t = v.first, v.baseline_enu_m / np.linalg.norm(v.baseline_enu_m)

    def worst(u1: Array, u2: Array, Q: Array, base: Array) -> float:
        return float(np.abs(np.sum((u2 @ Q) * np.cross(base, u1), axis=1)).max())

    Q_world = R.T @ v.second  # the seed's Q: X2 = K R Q (X - t)
    world1, world2 = v.rays1 @ R, v.rays2 @ R
    assert worst(world1, world2, Q_world, t) < 1e-12
    assert worst(v.rays1, v.rays2, R @ Q_world @ R.T, R @ t) < 1e-12
    assert worst(world1, world2, Q_world, R.T @ t) > 0.1
    assert worst(v.rays1, v.rays2, Q_world, R.T @ t) > 0.1


def test_sampson_distance_has_the_measurements_own_sigma() -> None:
    v = views(np.random.default_rng(1), turn_deg=3.0, count=800)
    error = epipolar_error(v.rays1, v.rays2, v.Q, v.t_cam1)
    assert 0.9 < np.std(error) / PIXEL < 1.1


def test_the_baselines_length_does_not_matter() -> None:
    v = views(np.random.default_rng(2), turn_deg=3.0)
    one, two = (small_angle(v.rays1, v.rays2, np.eye(3), scale * v.t_cam1) for scale in (1.0, 77.0))
    assert one == pytest.approx(two, abs=1e-9)


def test_one_small_angle_step_is_the_seeds_linear_solution() -> None:
    """Q ~ I + [theta]x: at three degrees one step is within a tenth of the angle, repeating it removes the rest."""
    v = views(np.random.default_rng(3), turn_deg=3.0, noise=0.0)
    theta = small_angle(v.rays1, v.rays2, np.eye(3), v.t_cam1)
    assert 0.0 < angle_deg(exp_so3(theta), v.Q) < 0.3
    assert angle_deg(relative_lsq(v.rays1, v.rays2, v.t_cam1, steps=8), v.Q) < 1e-6


@pytest.mark.parametrize("seed", range(5))
def test_least_squares_recovers_three_degrees_of_relative_rotation(seed: int) -> None:
    v = views(np.random.default_rng(seed), turn_deg=3.0)
    assert angle_deg(v.Q, np.eye(3)) == pytest.approx(3.0, abs=1e-6)
    assert 0.0 < angle_deg(relative_lsq(v.rays1, v.rays2, v.t_cam1), v.Q) < 0.1


@pytest.mark.parametrize("seed", range(5))
def test_ransac_finds_the_rotation_among_thirty_percent_outliers(seed: int) -> None:
    v = views(np.random.default_rng(seed), turn_deg=3.0, outliers=0.3)
    Q, inliers = relative_ransac(v.rays1, v.rays2, v.t_cam1, TOLERANCE)
    wrong = np.arange(len(inliers)) < 0.3 * len(inliers)
    assert angle_deg(Q, v.Q) < 0.1
    assert np.mean(inliers[~wrong]) > 0.95
    # An outlier may lie on its epipolar line by chance, one in twenty or so.
    assert np.mean(inliers[wrong]) < 0.2
    assert angle_deg(relative_lsq(v.rays1, v.rays2, v.t_cam1), v.Q) > 0.3


def test_ransac_gives_the_same_answer_again() -> None:
    v = views(np.random.default_rng(1), turn_deg=2.0, outliers=0.3)
    one, two = (relative_ransac(v.rays1, v.rays2, v.t_cam1, TOLERANCE)[0] for _ in range(2))
    assert np.array_equal(one, two)


def test_refinement_finds_a_direction_of_travel_that_was_fifteen_degrees_wrong() -> None:
    v = views(np.random.default_rng(4), turn_deg=2.0, relief_m=30.0)
    wrong = exp_so3(np.radians(15.0) * v.first[:, 2]) @ v.t_cam1
    Q, t = refine_direction(v.rays1, v.rays2, np.eye(3), wrong, TOLERANCE)
    cosine = t @ v.t_cam1 / np.linalg.norm(t) / np.linalg.norm(v.t_cam1)
    assert np.degrees(np.arccos(min(cosine, 1.0))) < 2.0
    assert angle_deg(Q, v.Q) < 0.5
    assert np.linalg.norm(t) == pytest.approx(np.linalg.norm(wrong))


def test_the_direction_step_is_the_epipolar_errors_descent() -> None:
    """(3.6): a single step from two degrees off comes nearer, in the direction as in the rotation."""
    v = views(np.random.default_rng(4), noise=0.0, relief_m=30.0)
    for sign in (-1.0, 1.0):
        wrong = exp_so3(sign * np.radians(2.0) * v.first[:, 2]) @ v.t_cam1
        _, t = refine_direction(v.rays1, v.rays2, v.Q, wrong, 1.0, steps=1)
        before, after = (
            np.linalg.norm(x / np.linalg.norm(x) - v.t_cam1 / np.linalg.norm(v.t_cam1)) for x in (wrong, t)
        )
        assert after < 0.2 * before


def test_the_baseline_and_the_level_give_the_absolute_orientation() -> None:
    """(3.7), exactly, of any camera whatever: the baseline is met, and down is down across it."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        R = exp_so3(rng.standard_normal(3))
        t = rng.standard_normal(3) * [50.0, 50.0, 5.0]
        assert absolute_from_direction(R @ t, t, R @ [0.0, 0.0, -1.0]) == pytest.approx(R, abs=1e-9)
        tilted = absolute_from_direction(R @ t, t, R @ [0.05, 0.08, -1.0])
        assert tilted @ t == pytest.approx(R @ t, abs=1e-9)
        assert 0.0 < angle_deg(tilted, R) < 6.0


def test_views_from_one_place_differ_by_a_rotation_that_is_found_among_outliers() -> None:
    v = views(np.random.default_rng(5), turn_deg=5.0, baseline_m=1e-6, outliers=0.2)
    assert angle_deg(rotation_only(v.rays1, v.rays2), v.Q) < 0.05


@pytest.mark.parametrize("mount_yaw_deg", [0.0, 90.0, 180.0, -90.0])
@pytest.mark.parametrize("crab_deg", rest_long([15.0, 0.0, -15.0]))
def test_a_pair_starts_whatever_the_mounts_yaw_and_under_crab(mount_yaw_deg: float, crab_deg: float) -> None:
    """The mount is known, the crab is not: travel is not assumed to follow the nose."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        v = views(rng, turn_deg=2.0, crab_deg=crab_deg, mount_yaw_deg=mount_yaw_deg, outliers=0.1)
        pair = start_pair(v.rays1, v.rays2, v.baseline_enu_m, v.R_body_cam, TOLERANCE)
        assert angle_deg(pair.first, v.first) < 8.0
        # Turning about the line across the flight looks much like tilting the baseline: a degree or two stays open.
        assert angle_deg(pair.second @ pair.first.T, v.Q) < 2.5
        assert 0.0 < pair.error_rad < TOLERANCE


@pytest.mark.parametrize(
    ("seed", "view"), [*((seed, {"relief_m": 0.0}) for seed in range(4)), (2, {"mount_pitch_deg": -50.0})]
)
def test_a_pair_over_flat_ground_and_an_oblique_camera_start(seed: int, view: dict[str, float]) -> None:
    """A plane has a second, wrong explanation in the relative orientation: the direction of travel decides."""
    v = views(np.random.default_rng(seed), turn_deg=2.0, **view)
    pair = start_pair(v.rays1, v.rays2, v.baseline_enu_m, v.R_body_cam, TOLERANCE)
    assert angle_deg(pair.first, v.first) < 8.0


def test_rays_that_belong_to_no_pair_of_views_are_refused() -> None:
    rng = np.random.default_rng(0)
    v = views(rng, outliers=1.0)
    assert start_pair(v.rays1, v.rays2, v.baseline_enu_m, v.R_body_cam, TOLERANCE) is None
    assert start_pair(v.rays1[:5], v.rays2[:5], v.baseline_enu_m, v.R_body_cam, TOLERANCE) is None


def five_point_is_right(v: Views) -> bool:
    """Whether the five-point start has the rotation within a degree and the direction of travel within six."""
    for Q, t in _five_point(v.rays1, v.rays2, float(np.linalg.norm(v.baseline_enu_m)), TOLERANCE):
        cosine = float(t @ v.t_cam1) / float(np.linalg.norm(t) * np.linalg.norm(v.t_cam1))
        return angle_deg(Q, v.Q) < 1.0 and cosine > np.cos(np.radians(6.0))
    return False


def test_five_points_find_large_turns_over_rough_ground_whatever_the_heading() -> None:
    def rate(outliers: float) -> float:
        sampled = []
        for seed in range(40):
            rng = np.random.default_rng(seed)
            turn, crab, roll = rng.uniform([0.0, -180.0, -20.0], [15.0, 180.0, 20.0])
            v = views(rng, turn_deg=turn, crab_deg=crab, roll_deg=roll, relief_m=40.0, outliers=outliers)
            if len(v.rays1) >= 30:
                sampled.append(five_point_is_right(v))
        assert len(sampled) >= 35
        return float(np.mean(sampled))

    assert rate(0.0) >= 0.95
    assert rate(0.2) >= 0.85


@pytest.mark.parametrize("extent", [(0.3, 0.0), (0.0, 0.0)], ids=["a line", "one place"])
def test_five_points_give_nothing_from_points_on_a_line_or_in_one_place(extent: tuple[float, float]) -> None:
    at = np.random.default_rng(1).uniform(-1.0, 1.0, (30, 2)) * extent
    rays1 = np.column_stack([at, np.ones(30)])
    assert _five_point(rays1, rays1 + np.array([0.1, 0.0, 0.0]), 80.0, TOLERANCE) == []


def test_a_whole_window_is_oriented_from_its_best_pair() -> None:
    rng = np.random.default_rng(11)
    K = 6
    R_body_cam = mount_rotation(0.0, -90.0, 0.0)
    base = (R_ENU_NED @ matrix_from_euler(0.0, 0.0, np.radians(45.0)) @ R_body_cam).T
    R = exp_so3(0.03 * rng.standard_normal((K, 3))) @ base
    centres = np.arange(K)[:, None] * np.array([14.0, 14.0, 0.0]) + [0.0, 0.0, 250.0]
    points = rng.uniform([-80.0, -80.0, -10.0], [150.0, 150.0, 10.0], (120, 3))
    p = np.einsum("kij,kpj->kpi", R, points[None] - centres[:, None])
    xy = p[..., :2] / p[..., 2:] + PIXEL * rng.standard_normal((K, 120, 2))
    seen = (np.abs(xy[..., 0]) < 0.36) & (np.abs(xy[..., 1]) < 0.27)
    found = window_start.orient(xy, seen, centres, R_body_cam, TOLERANCE)
    assert found is not None
    assert max(angle_deg(a, b) for a, b in zip(found, R, strict=True)) < 6.0
    relative = [angle_deg(found[k] @ found[0].T, R[k] @ R[0].T) for k in range(1, K)]
    assert 0.0 < max(relative) < 1.5
    assert window_start.orient(xy, seen & (np.arange(120) < 10), centres, R_body_cam, TOLERANCE) is None
