"""Other tools' calibrations: right to a thousandth of a pixel by their own equations, or refused in one line.

What is refused, and in which words: tests/transcripts/pc-onboard-camera.txt.
"""

import json
import os
import random
from pathlib import Path

import cv2
import numpy as np
import pytest

from contract.camera import UNKNOWN_SIGMA, Camera
from contract.errors import InputError
from onboard.__main__ import main
from onboard.camera_files.formats import FORMATS, load_camera_file, read_camera_file, table
from onboard.commands.imported_flight import optics_of
from onboard.config.files import load_camera
from onboard.config.schema import parse_config
from tests.onboard.camera_files.writers import (
    FILES,
    FISHEYES,
    KALIBR,
    METASHAPE_FISHEYE,
    OPENCV,
    ROS,
    H,
    W,
    Written,
    fisheye_metashape,
)

ROOT = Path(__file__).parents[3]
XY = np.stack(np.meshgrid(np.linspace(-0.6, 0.6, 9), np.linspace(-0.45, 0.45, 7)), axis=-1).reshape(-1, 2)
WIDE_XY = 3.0 * XY  # 66 degrees off the axis
EACH = pytest.mark.parametrize("written", FILES, ids=lambda w: w.name)


def put(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def pixels_off(camera: Camera, xy: np.ndarray, u: np.ndarray, v: np.ndarray) -> float:
    uv = camera.project(np.column_stack([xy, np.ones(len(xy))]))[0]
    return float(np.abs(uv - np.column_stack([u, v])).max())


@EACH
def test_a_pixel_is_where_the_tool_s_own_equations_put_it(written: Written, tmp_path: Path) -> None:
    read = read_camera_file(put(tmp_path, written.name, written.text), written.size)
    assert read.form.key == written.key and read.camera.size_px == (W, H)
    assert read.camera.model == ("fisheye" if written in FISHEYES else "pinhole")
    xy = WIDE_XY if written in FISHEYES else XY
    u, v = written.project(*xy.T)
    assert pixels_off(read.camera, xy, u - written.corner, v - written.corner) < 1e-3
    assert read.took and read.off_px == 0.0
    assert read.has_sigmas == ("covariance" in written.text)
    if not read.has_sigmas:
        assert read.camera.sigma == UNKNOWN_SIGMA


def test_every_format_has_a_sample_and_the_docs_have_the_table() -> None:
    assert {each.key for each in FORMATS} == {written.key for written in FILES}
    assert table() in (ROOT / "docs/calibrate.md").read_text(encoding="utf-8")


def test_metashape_s_covariance_is_taken(tmp_path: Path) -> None:
    f, x, y, k1, k2 = load_camera_file(put(tmp_path, "cameras.xml", PROJECT)).sigma
    assert f * 3100 == pytest.approx(np.sqrt(16 + 2 + 2 * 3)) and k1 == pytest.approx(1e-3) and k2 == 0.0
    assert x / y == pytest.approx(2 / 3) and x * 3105 == pytest.approx(2.0, rel=1e-3)
    fixed = put(tmp_path, "cameras.xml", PROJECT.replace("b1 k1</params>", "b1 b2</params>"))
    assert load_camera_file(fixed).sigma == UNKNOWN_SIGMA  # of a k1 that was not adjusted nothing is known
    with pytest.raises(InputError, match="a variance is not above zero"):
        load_camera_file(put(tmp_path, "cameras.xml", PROJECT.replace("<coeffs>16", "<coeffs>-16")))


MATRIX = [[900.0, 0, 650.0], [0, 902.0, 350.0], [0, 0, 1]]
RATIONAL = [8.2, 3.1, 0.0009, -0.0004, 0.2, 8.3, 3.9, 0.6]
PRISM = [*RATIONAL, 0.002, -0.0006, 0.001, 0.0004]


@pytest.mark.parametrize("terms", [RATIONAL, PRISM], ids=["rational", "prism"])
def test_further_terms_are_reduced_and_the_residual_is_what_it_says(terms: list[float], tmp_path: Path) -> None:
    text = json.dumps({
        "image_width": 1280, "image_height": 720, "dist_coeffs": {"type_id": "opencv-matrix", "data": terms},
        "camera_matrix": MATRIX,
    })  # fmt: skip
    read = read_camera_file(put(tmp_path, "camera.json", text))
    echoed = f"width: 1280\nheight: 720\ndistortion_model: rational_polynomial\nd: {terms}\nk: {MATRIX}\n---\n"
    assert read_camera_file(put(tmp_path, "echo.yaml", echoed)).camera == read.camera  # ros2 topic echo
    assert 0.0 < read.off_px < 1280 / 640 and read.had
    rays = read.camera.unproject(np.stack(np.meshgrid(np.linspace(0, 1279, 33), np.linspace(0, 719, 25)), axis=-1))[0]
    rays = rays.reshape(-1, 3)
    truth = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), np.array(MATRIX), np.array(terms))[0].reshape(-1, 2)
    off_px = float(np.hypot(*(read.camera.project(rays)[0] - truth).T).max())
    assert off_px == pytest.approx(read.off_px, rel=0.1, abs=0.01)
    k1, k2, p1, p2, k3 = terms[:5]
    cut = Camera(1280, 720, 900.0, 902.0, 650.0, 350.0, (k1, k2, p1, p2, k3))
    assert np.hypot(*(cut.project(rays)[0] - truth).T).max() > 10.0 * off_px  # had the further terms been left out


def test_a_fisheye_s_further_terms_are_reduced_and_the_residual_is_what_it_says(tmp_path: Path) -> None:
    p1, p2, b2 = 4e-4, -3e-4, 0.4
    terms = f"<p1>{p1}</p1><p2>{p2}</p2><b2>{b2}</b2><date>"
    read = read_camera_file(put(tmp_path, "calibration.xml", METASHAPE_FISHEYE.replace("<date>", terms)))
    assert read.camera.model == "fisheye" and read.had
    with pytest.raises(InputError, match="without the skew and the tangential P1 P2 its pixels are up to"):
        too_much = terms.replace(str(p1), "0.01")
        load_camera_file(put(tmp_path, "much.xml", METASHAPE_FISHEYE.replace("<date>", too_much)))
    with pytest.raises(InputError, match="'equisolid_fisheye' is a fisheye's model that is not read"):
        load_camera_file(put(tmp_path, "solid.xml", METASHAPE_FISHEYE.replace("equidistant", "equisolid")))
    pixels = np.stack(np.meshgrid(np.linspace(0, W - 1, 33), np.linspace(0, H - 1, 25)), axis=-1).reshape(-1, 2)
    rays, are_known = read.camera.unproject(pixels)
    rays = rays[are_known]
    u, v = fisheye_metashape(rays[:, 0] / rays[:, 2], rays[:, 1] / rays[:, 2], p1, p2, b2)
    truth = np.column_stack([u, v]) - 0.5
    off_px = float(np.hypot(*(read.camera.project(rays)[0] - truth).T).max())
    assert 0.0 < read.off_px < W / 640 and off_px == pytest.approx(read.off_px, rel=0.15)
    cut = read_camera_file(put(tmp_path, "plain.xml", METASHAPE_FISHEYE)).camera
    assert np.hypot(*(cut.project(rays)[0] - truth).T).max() > 1.3 * off_px  # had the further terms been left out


PROJECT = next(each for each in FILES if each.name == "cameras.xml").text


def test_a_pipe_is_refused_and_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "camera.json")
    with pytest.raises(InputError, match="a pipe or a device, and no file"):
        load_camera_file(tmp_path / "camera.json")


@EACH
def test_damage_is_refused_in_one_line_or_leaves_a_camera(written: Written, tmp_path: Path) -> None:
    rng = random.Random(written.name)
    text = written.text
    damaged = [text[: rng.randrange(len(text))] for _ in range(15)]
    for _ in range(25):
        at = rng.randrange(len(text))
        put_in = rng.choice(["\0", "é", "-", "0", "9" * 400, "[", "<", '"', "&a *a", "\n"])
        damaged.append(text[:at] + put_in + text[at + 1 :])
    for each in damaged:
        path = put(tmp_path, written.name, each)
        try:
            camera = load_camera_file(path)
        except InputError as error:
            assert str(error).startswith(f"camera file {path}")
        else:
            assert np.isfinite([camera.fx_px, camera.fy_px, *camera.distortion, *camera.sigma]).all()


def test_terms_that_cannot_be_done_without_are_refused(tmp_path: Path) -> None:
    text = OPENCV.replace("rows: 5", "rows: 12").replace("-0.008 ]", "-0.008, 0, 0, 0, 0.5, 0.4, -0.5, 0.3 ]")
    with pytest.raises(InputError, match=r"without the thin prism's s1 to s4 its pixels are up to .* px off"):
        load_camera_file(put(tmp_path, "camera.yml", text))


def test_it_serves_wherever_a_camera_file_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = put(tmp_path, "camera.yaml", ROS + '"\\e[2J": 1\n'), tmp_path / "camera.json"
    assert main(["camera", str(path), "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "left: camera_name, rectification_matrix" in printed and "[2J" in printed and "\x1b" not in printed
    camera = Camera.from_json(out)
    assert camera == load_camera_file(path) == load_camera(parse_config(f'[camera]\nfile = "{path}"'))
    assert camera.sigma == pytest.approx(UNKNOWN_SIGMA)
    optics = optics_of((W, H), None, tmp_path, {"camera.file": f'"{path}"'})
    assert Camera.from_text(optics.file_text, "flight") == camera
    assert read_camera_file(out).form is None and load_camera_file(out) == camera
    two = put(tmp_path, "camchain.yaml", KALIBR + KALIBR.replace("cam0", "cam1").replace("3100.0", "3000.0"))
    assert read_camera_file(two, which="cam1").camera.fx_px == 3000.0
