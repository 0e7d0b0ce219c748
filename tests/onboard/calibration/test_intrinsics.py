"""A known camera is calibrated: its numbers come back with honest sigmas, or a refusal that says what to do."""

import json
import re
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from contract.camera import Camera
from onboard.__main__ import main
from onboard.calibration.board import Board
from onboard.calibration.intrinsics import MODELS, Model, View, calibrate, fit
from onboard.calibration.verdict import coverage_picture, judge
from onboard.commands.calibrate import Collector, camera_file
from tests.onboard.calibration.board_pictures import Photographer, Pose, poses_all_over
from tests.rest_long import rest_long

TRUTH = Camera(640, 480, 560.0, 558.0, 322.3, 236.1, (-0.28, 0.09, 0.0008, -0.0005, 0.0))
CHARUCO = Board()
CHECKERS = Board("checkerboard", 7, 6)
FRONTAL = [Pose((0.0, 0.0, p.turn_rad[2]), p.middle_cam_m) for p in poses_all_over(14, 3)]


def seen(poses: list[Pose], noise_px: float = 0.05, camera: Camera = TRUTH, seed: int = 0) -> list[View]:
    """What a perfect detector would find, with noise; no picture is rendered."""
    rng = np.random.default_rng(seed)
    points_m = CHARUCO.points_m()
    middle_m = np.array([CHARUCO.columns, CHARUCO.rows, 0.0]) * CHARUCO.square_m / 2.0
    views = []
    for number, pose in enumerate(poses):
        R = np.asarray(cv2.Rodrigues(np.array(pose.turn_rad))[0])
        uv_px, is_inside = camera.project((points_m - middle_m) @ R.T + np.array(pose.middle_cam_m))
        numbers = np.flatnonzero(is_inside)
        noisy = uv_px[numbers] + rng.normal(0.0, noise_px, (len(numbers), 2))
        views.append(View(f"{number}", numbers, noisy, points_m[numbers]))
    return views


def direction_errors_px(camera: Camera, truth: Camera = TRUTH) -> NDArray[np.float64]:
    """How far off the camera sees the true directions of a grid of pixels, (N,)."""
    grid = np.stack(np.meshgrid(np.linspace(8, 631, 9), np.linspace(8, 471, 7)), axis=-1).reshape(-1, 2)
    rays, _ = truth.unproject(grid)
    uv_px, _ = camera.project(rays)
    return np.asarray(np.linalg.norm(uv_px - grid, axis=1))


@cache
def photographs(board: Board) -> list[NDArray[np.uint8]]:
    photographer = Photographer(TRUTH, board)
    return [photographer.photograph(pose) for pose in poses_all_over(18, 1)]


def photograph(board: Board, count: int, folder: Path) -> None:
    for number, picture in enumerate(photographs(board)[:count]):
        Image.fromarray(picture).save(folder / f"{number:02d}.png", compress_level=1)


@pytest.mark.parametrize(
    ("board", "words"),
    [
        pytest.param(CHARUCO, [], id="charuco"),
        pytest.param(
            CHECKERS, ["--board", "checkerboard", "--squares", "7x6"], id="checkerboard", marks=pytest.mark.long
        ),
    ],
)
def test_a_known_camera_is_recovered_from_pictures(
    board: Board, words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pictures, out = tmp_path / "pictures", tmp_path / "camera.json"
    pictures.mkdir()
    photograph(board, 18, pictures)
    assert main(["calibrate", "--pictures", str(pictures), "--out", str(out), *words]) == 0
    camera = Camera.from_json(out)
    assert camera.size_px == (640, 480)
    assert camera.fx_px == pytest.approx(560.0, rel=0.002)
    assert camera.fy_px == pytest.approx(558.0, rel=0.002)
    assert camera.cx_px == pytest.approx(322.3, abs=1.5)
    assert camera.cy_px == pytest.approx(236.1, abs=1.5)
    assert camera.distortion[0] == pytest.approx(-0.28, abs=0.01)
    assert camera.distortion[1] == pytest.approx(0.09, abs=0.03)
    assert direction_errors_px(camera).max() < 1.5
    known = json.loads(out.read_text())["calibration"]
    assert known["verdict"] == "good" and known["views"] == 18
    assert 0.01 < known["reprojection_rms_px"] < 0.2
    assert 0.0 < known["sigma"]["fx"] < 1.5
    text = capsys.readouterr().out
    assert "board found in 18 of 18 pictures" in text and "verdict: good" in text
    sampled = np.asarray(Image.open(tmp_path / "camera.coverage.png"))
    assert sampled.shape[1] == 1280 and len(np.unique(sampled.reshape(-1, 3) @ [1 << 16, 1 << 8, 1])) > 20


def test_sigmas_are_what_the_errors_are() -> None:
    poses = poses_all_over(14, 1)
    truth = (TRUTH.fx_px, TRUTH.fy_px, TRUTH.cx_px, TRUTH.cy_px, *TRUTH.distortion)
    scores, sigmas_px = [], []
    for seed in range(40):
        fitted = fit(seen(poses, seed=seed), TRUTH.size_px, Model(2, True))
        c = fitted.camera
        found = (c.fx_px, c.fy_px, c.cx_px, c.cy_px, *c.distortion)
        scores.append(
            [
                (f - t) / fitted.sigmas[n]
                for n, f, t in zip(fitted.model.parameters[:8], found[:8], truth[:8], strict=True)
            ]
        )
        sigmas_px.append(fitted.ray_sigma_px.max())
    rms = np.sqrt(np.mean(np.square(scores), axis=0))
    assert np.all((rms > 0.65) & (rms < 1.4)), rms
    assert 0.75 < np.sqrt(np.mean(np.square(scores))) < 1.25
    assert 0.02 < np.mean(sigmas_px) < 0.5


@pytest.mark.parametrize(
    ("distortion", "chosen"),
    [
        ((0.0, 0.0, 0.0, 0.0, 0.0), "none"),
        ((-0.1, 0.0, 0.0, 0.0, 0.0), "k1"),
        ((-0.28, 0.09, 0.0, 0.0, 0.0), "k1 k2"),
        ((-0.28, 0.09, 0.002, -0.001, 0.0), "k1 k2 p1 p2"),
        ((-0.25, 0.1, 0.002, -0.001, -0.03), "k1 k2 k3 p1 p2"),
    ],
)
def test_the_model_has_what_the_evidence_asks_for_and_no_more(
    distortion: tuple[float, float, float, float, float], chosen: str
) -> None:
    camera = Camera(640, 480, 460.0, 460.0, 320.0, 240.0, distortion)
    poses = poses_all_over(18, 2, distance_m=0.27)
    result = calibrate(seen(poses, camera=camera), (640, 480))
    assert result[0].model.name == chosen
    assert direction_errors_px(result[0].camera, camera).max() < 1.0


def test_boards_that_all_face_the_camera_leave_the_focal_length_unknown() -> None:
    result = calibrate(seen(FRONTAL), TRUTH.size_px)
    verdict = judge(None if result is None else result[0], [], TRUTH.size_px, len(FRONTAL))
    assert not verdict.is_good
    assert "too few tilts: the focal length" in str(verdict)
    assert "lean the board 20 to 40 degrees forwards or backwards and to the left or right" in str(verdict)


def test_boards_that_lean_one_way_only_are_advised_the_other() -> None:
    poses = [Pose((0.5 * (-1) ** n, 0.0, 0.0), p.middle_cam_m) for n, p in enumerate(poses_all_over(14, 3))]
    result = calibrate(seen(poses), TRUTH.size_px)
    complaint, *_ = judge(*result, TRUTH.size_px, 14).complaints
    assert complaint.startswith("too few tilts")
    assert complaint.endswith("lean the board 20 to 40 degrees to the left or right")


def test_too_few_views_are_refused_and_nothing_is_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pictures, out = tmp_path / "pictures", tmp_path / "camera.json"
    pictures.mkdir()
    photograph(CHARUCO, 3, pictures)
    Image.new("L", (640, 480), 90).save(pictures / "empty.png")
    assert main(["calibrate", "--pictures", str(pictures), "--out", str(out)]) == 1
    assert not out.exists()
    text = capsys.readouterr().out
    assert "board found in 3 of 4 pictures, not in empty.png" in text
    assert "verdict: not good: the board was found in 3 pictures only: take 16" in text


def test_a_bad_calibration_is_written_only_if_insisted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pictures, out = tmp_path / "pictures", tmp_path / "camera.json"
    pictures.mkdir()
    photograph(CHARUCO, 6, pictures)
    command = ["calibrate", "--pictures", str(pictures), "--out", str(out)]
    assert main(command) == 1
    assert not out.exists()
    assert "too few views (6)" in capsys.readouterr().out
    assert main([*command, "--accept"]) == 1
    assert Camera.from_json(out).fx_px == pytest.approx(560.0, rel=0.02)
    assert json.loads(out.read_text())["calibration"]["verdict"].startswith("not good: too few views (6)")


def test_a_corner_that_saw_no_board_is_named() -> None:
    poses = [Pose(p.turn_rad, (-0.08 - 0.02 * (n % 3), -0.06, 0.45)) for n, p in enumerate(poses_all_over(14, 5))]
    result = calibrate(seen(poses), TRUTH.size_px)
    text = str(judge(*result, TRUTH.size_px, 14))
    assert "not enough coverage" in text and "lower right" in text
    assert "upper left" not in text


def test_noisy_corners_are_a_high_error() -> None:
    result = calibrate(seen(poses_all_over(12, 1), noise_px=1.5), TRUTH.size_px)
    assert any(text.startswith("high error (2.") for text in judge(*result, TRUTH.size_px, 12).complaints)


def test_a_view_that_contradicts_the_others_is_dropped() -> None:
    views = seen(poses_all_over(12, 1))
    moved = views[7].uv_px + np.where(np.arange(len(views[7].uv_px)) % 2, 3.0, -3.0)[:, None]
    views[7] = View("moved", views[7].numbers, moved, views[7].points_m)
    result = calibrate(views, TRUTH.size_px)
    assert result is not None
    fitted, dropped = result
    assert [view.name for view in dropped] == ["moved"]
    assert fitted.camera.fx_px == pytest.approx(560.0, rel=0.002)
    assert fitted.rms_px < 0.1


def test_a_lens_whose_distortion_folds_is_refused() -> None:
    folding = Camera(640, 480, 460.0, 460.0, 320.0, 240.0, (-0.3, 0.2, 0.0, 0.0, -0.2))
    result = calibrate(seen(poses_all_over(12, 2, distance_m=0.27), camera=folding), (640, 480))
    assert result[0].rms_px < 0.1
    assert any("folds within the picture" in text for text in judge(*result, (640, 480), 12).complaints)


@pytest.mark.parametrize("wide_deg", [105.0, pytest.param(150.0, marks=pytest.mark.long)])
def test_a_fisheye_is_chosen_by_held_out_views_and_recovered(wide_deg: float, tmp_path: Path) -> None:
    f = 0.5 * 640 / np.radians(0.5 * wide_deg)
    truth = Camera(640, 480, f, 1.002 * f, 322.3, 236.1, (-0.02, 0.008, -0.004, 0.0008), "fisheye")
    views = [view for view in seen(poses_all_around(24, 5), camera=truth) if len(view.numbers) >= 8]
    result = calibrate(views, (640, 480))
    assert result is not None
    fitted, dropped = result
    assert fitted.camera.model == "fisheye" and not dropped and fitted.rms_px < 0.1
    assert re.match(r"fisheye: views held out are 0\.\d\d px off a fisheye's fit and \d+\.\d\d off", fitted.why)
    assert abs(fitted.camera.fx_px / f - 1.0) < 4.0 * fitted.sigmas["fx"] / f < 0.012
    grid = np.stack(np.meshgrid(np.linspace(60, 580, 9), np.linspace(40, 440, 7)), axis=-1).reshape(-1, 2)
    rays, valid = truth.unproject(grid)
    assert np.linalg.norm(fitted.camera.project(rays)[0] - grid, axis=1)[valid].max() < 1.5
    verdict = judge(fitted, dropped, (640, 480), len(views))
    (tmp_path / "camera.json").write_text(camera_file(fitted, verdict))
    assert Camera.from_json(tmp_path / "camera.json").model == "fisheye"


@pytest.mark.long
def test_photographs_of_boards_through_120_degrees_make_a_camera_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    f = 640 / np.radians(120.0)
    truth = Camera(640, 480, f, f, 322.3, 236.1, (-0.02, 0.008, -0.004, 0.0008), "fisheye")
    pictures, out, photographer = tmp_path / "pictures", tmp_path / "camera.json", Photographer(truth, CHARUCO)
    pictures.mkdir()
    for number, pose in enumerate(poses_all_around(24, 5, lean_rad=0.25)):
        Image.fromarray(photographer.photograph(pose)).save(pictures / f"{number:02d}.png", compress_level=1)
    assert main(["calibrate", "--pictures", str(pictures), "--out", str(out)]) == 0
    camera, text = Camera.from_json(out), capsys.readouterr().out
    assert camera.model == "fisheye" and camera.fx_px == pytest.approx(f, rel=0.005)
    assert "lens: fisheye: views held out are" in text and "verdict: good" in text


def poses_all_around(count: int, seed: int, lean_rad: float = 0.35) -> list[Pose]:
    """Boards in all directions up to 70 degrees off the axis, each about facing the camera and leaning."""
    rng, poses = np.random.default_rng(seed), []
    for number in range(count):
        off, about = np.radians(70.0) * np.sqrt((number % 6 + 0.5) / 6.0), 2.4 * number
        direction = np.array([np.sin(off) * np.cos(about), np.sin(off) * np.sin(about), np.cos(off)])
        facing = np.cross([0.0, 0.0, 1.0], direction)
        turn = facing / max(float(np.linalg.norm(facing)), 1e-9) * off * 0.8 + rng.normal(0.0, lean_rad, 3)
        x, y, z = direction * rng.uniform(0.25, 0.4)
        poses.append(Pose((float(turn[0]), float(turn[1]), float(turn[2])), (float(x), float(y), float(z))))
    return poses


def test_a_wide_pinhole_stays_one() -> None:
    camera = Camera(640, 480, 300.0, 301.0, 320.0, 240.0, (-0.05, 0.004, 0.0, 0.0, 0.0))
    result = calibrate(seen(poses_all_over(14, 2, distance_m=0.18), camera=camera), (640, 480))
    assert result[0].camera.model == "pinhole"
    assert result[0].why.startswith("pinhole: views held out are")


@pytest.mark.parametrize("seed", rest_long(range(5), 2))
def test_boards_in_the_middle_only_are_never_good_and_leave_a_ray_at_every_pixel(seed: int) -> None:
    poses = [Pose(p.turn_rad, (0.0, 0.0, 0.9)) for p in poses_all_over(12, 4)]
    edge = np.array([(0.0, 0.0), (639.0, 0.0), (0.0, 479.0), (639.0, 479.0), (320.0, 0.0)])
    result = calibrate(seen(poses, noise_px=0.4, seed=seed), TRUTH.size_px)
    assert np.all(result[0].camera.unproject(edge)[1])
    assert "not enough coverage" in str(judge(*result, TRUTH.size_px, 12))


def test_every_model_is_its_parameters() -> None:
    assert [model.name for model in MODELS] == [
        *("none", "p1 p2", "k1", "k1 p1 p2", "k1 k2", "k1 k2 p1 p2", "k1 k2 k3", "k1 k2 k3 p1 p2")
    ]
    for model in MODELS:
        free = {model.parameters[column] for column in model.columns} - {"fx", "fy", "cx", "cy"}
        assert free == set(model.name.split()) - {"none"}


def test_residual_arrows_and_bare_cells_are_rendered() -> None:
    result = calibrate(seen(poses_all_over(18, 1)[:6]), TRUTH.size_px)
    sampled = coverage_picture(result[0], judge(*result, TRUTH.size_px, 6))
    assert sampled.shape == (2 * 480 + 52, 1280, 3)


@pytest.mark.parametrize("board", [CHARUCO, CHECKERS], ids=["charuco", "checkerboard"])
def test_the_printed_board_is_found_at_its_true_size(board: Board, tmp_path: Path) -> None:
    path = tmp_path / "board.png"
    words = ["--board", board.kind, "--squares", f"{board.columns}x{board.rows}"]
    assert main(["calibrate", "--print-board", str(path), *words]) == 0
    with Image.open(path) as image:
        assert image.info["dpi"] == pytest.approx((300.0, 300.0), abs=0.01)
        page = np.asarray(image)
    view = board.find(np.asarray(cv2.resize(page, None, fx=0.3, fy=0.3, interpolation=cv2.INTER_AREA), np.uint8))
    assert len(view.numbers) == board.corners
    spread_mm = np.ptp(view.uv_px, axis=0) / 0.3 / 300.0 * 25.4
    wanted_mm = np.array([board.columns - 2, board.rows - 2]) * 25.0
    assert np.sort(spread_mm) == pytest.approx(np.sort(wanted_mm), rel=0.003)
    assert main(["calibrate", "--print-board", str(tmp_path / "board.pdf"), *words]) == 0
    assert (tmp_path / "board.pdf").read_bytes().startswith(b"%PDF")


def test_part_of_a_charuco_board_is_enough_and_its_corners_are_the_right_ones() -> None:
    photographer = Photographer(TRUTH, CHARUCO)
    pose = Pose((0.2, -0.3, 0.1), (0.1, 0.05, 0.3))
    view = CHARUCO.find(photographer.photograph(pose))
    assert len(view.numbers) < CHARUCO.corners
    (true,) = seen([pose], noise_px=0.0)
    _, in_found, in_true = np.intersect1d(view.numbers, true.numbers, return_indices=True)
    assert len(in_found) == len(view.numbers)
    assert np.linalg.norm(view.uv_px[in_found] - true.uv_px[in_true], axis=1).max() < 0.5
    assert CHARUCO.find(np.full((480, 640), 90, np.uint8)) is None


def test_live_views_are_kept_when_still_and_new() -> None:
    first, second = seen(poses_all_over(2, 1), noise_px=0.0)
    collector = Collector((640, 480))
    shaken = View("", first.numbers, first.uv_px + 3.0, first.points_m)
    at_ns = iter(range(0, 10**10, 10**8))
    offered = [first, shaken, first, first, first, None, second, second, first, first]
    kept = [collector.offer(next(at_ns), view) for view in offered]
    assert kept == [False, False, False, True, False, False, False, True, False, False]
    late = Collector((640, 480))
    assert not late.offer(0, first)
    assert not late.offer(10**9, first)
