"""Other tools' calibrations: right to a thousandth of a pixel by their own equations, or refused in one line."""

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
    COLMAP,
    COLMAP_FISHEYE,
    CX,
    FILES,
    FISHEYES,
    FK1,
    K1,
    K3,
    KALIBR,
    METASHAPE,
    ODM,
    OPENCV,
    OPENCV_FISHEYE,
    P4D,
    PIX4D,
    ROS,
    H,
    W,
    Written,
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


PROJECT = next(each for each in FILES if each.name == "cameras.xml").text
SENSOR = PROJECT[PROJECT.index("<sensor ") : PROJECT.index("</sensors>")]
TWO_SENSORS = PROJECT.replace("</sensors>", SENSOR.replace('id="0"', 'id="1"') + "</sensors>")
REFUSED = {
    "ros fisheye": (ROS.replace("plumb_bob", "equidistant"), "5 values: must be a list of 4 numbers"),
    "ros unknown": (ROS.replace("plumb_bob", "plumb_bobb"), "did you mean 'plumb_bob'"),
    "ros key": (ROS.replace("camera_matrix", "camera_matrx"), "'camera_matrix' is missing; is 'camera_matrx' meant"),
    "ros count": (ROS.replace(f", {K3}]", "]").replace(f"[{K1}, ", "["), "3 values: must be a list of 0 or 4"),
    "ros roi": (ROS + "roi: {x_offset: 640, y_offset: 0, width: 0, height: 0}\n", "roi cuts the picture"),
    "ros cut": (ROS[: ROS.index("distortion_model") - 5], r"not YAML \(.* in line 7\)"),
    "yaml alias": ("a: &a [1]\nb: &b [*a, *a]\nsize_px: *b\n", r"not YAML \(an alias, .* in line 2\)"),
    "ros from the middle": (ROS.replace(f"{CX}", "10.25"), "principal point is 10.25 px in x, 50 % of the picture off"),
    "ros size": (ROS.replace("image_width", "width_"), "states no picture size.*--size"),
    "opencv fisheye": (OPENCV + "fisheye_model: 1\n", "5 values: must be a list of 4 numbers"),
    "opencv fisheye skew": (
        OPENCV_FISHEYE.replace("1500.0, 0.,", "1500.0, 3.,"),
        "a fisheye with the skew is not read",
    ),
    "opencv four": (OPENCV.replace(",\n       -0.008", ""), "4 coefficients: k1 k2 p1 p2, or a fisheye's"),
    "kalibr fov": (KALIBR.replace("radtan", "fov"), "'fov' is a fisheye's model that is not read"),
    "kalibr omni": (KALIBR.replace("pinhole", "omni"), "'omni' is a fisheye's model"),
    "kalibr two": (KALIBR + KALIBR.replace("cam0", "cam1"), "holds 2 cameras, 'cam0', 'cam1': choose"),
    "colmap fisheye": (f"1 FOV {W} {H} 3100 3100 2000 1500 0.9\n", "fisheye's model that is not read"),
    "colmap fisheye count": (COLMAP_FISHEYE.replace(" 0.0011", ""), "OPENCV_FISHEYE has 9 values and not 10"),
    "colmap twice": (COLMAP_FISHEYE + COLMAP_FISHEYE.replace("4000", "4001"), "camera '1' is there twice"),
    "yaml twice": (ROS + "camera_name: a\ncamera_name: b\n", r"not YAML \('camera_name' is there twice"),
    "json twice": (ODM.replace("{", '{"a": 1, "a": 2, ', 1), r"not JSON \('a' is there twice"),
    "xml twice": ("<opencv_storage><K>1</K><K>2</K></opencv_storage>", "'K' is there twice"),
    "fisheye absurd": (COLMAP_FISHEYE.replace(str(FK1), "9.0"), "half of the picture is spread more than .* times"),
    "pinhole absurd": (ROS.replace(f"[{K1}, ", "[30.0, "), "half of the picture is spread more than .* times"),
    "colmap unknown": (COLMAP.replace("FULL_OPENCV", "FULL_CV"), "model 'FULL_CV' is not read"),
    "colmap count": (COLMAP.replace(" 0 0 0\n", "\n"), "FULL_OPENCV has 11 values and not 14"),
    "metashape fisheye": (METASHAPE.replace(">frame<", ">fisheye<"), "fisheye's model"),
    "metashape old": (METASHAPE.replace("<f>", "<fx>3100</fx><f>"), "PhotoScan before 1.2"),
    "metashape two": (TWO_SENSORS, "holds 2 cameras, 'M3M', 'M3M 1': choose"),
    "metashape guess": (TWO_SENSORS.replace("adjusted", "initial"), "has no adjusted calibration"),
    "metashape doctype": ('<!DOCTYPE a [<!ENTITY b "c">]>' + METASHAPE.split("?>")[1], "document type"),
    "pix4d size": (PIX4D, "states no picture size"),
    "pix4d fisheye": (P4D.replace("perspective", "fisheye"), "fisheye's model"),
    "opensfm fisheye": (ODM.replace('"brown"', '"fisheye_opencv"'), "a fisheye with p1 and p2 is not read"),
    "opensfm fisheye62": (ODM.replace('"brown"', '"fisheye62"'), "'fisheye62' is a fisheye's model that is not read"),
    "huge": (ROS.replace("3100.0", "1e999"), "must be a number"),
    "huge json": (ODM.replace("0.775,", "1e999,"), "focal_x is Infinity: must be a number"),
    "zeros": (ROS.replace("3100.0", "0.0"), "fx is 0.0: must be a number"),
    "aspect": (ROS.replace("3110.0", "4110.0"), "pixels are not square"),
    "centre": (ROS.replace("2010.25", "9010.25"), "principal point is 9010 px in x"),
    "nothing": ("hello: world\n", "not a camera file; read are ours, .*COLMAP"),
    "empty": ("", "not a camera file"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_refusal_names_file_and_reason_in_one_line(
    case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text, reason = REFUSED[case]
    path = put(tmp_path, "some.file", text)
    with pytest.raises(InputError, match=reason):
        load_camera_file(path)
    assert main(["camera", str(path), "--out", str(tmp_path / "out.json")]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and f"camera file {path}" in err and not (tmp_path / "out.json").exists()


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
