import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from contract.camera import Camera
from contract.errors import InputError

FISHEYE = Camera(640, 480, 330.0, 333.0, 322.0, 236.0, (-0.031, 0.012, -0.006, 0.0011), "fisheye")  # 140 degrees
MILD = Camera(640, 480, 700.0, 710.0, 322.0, 236.0, (-0.21, 0.052, 0.0007, -0.0004, 0.011))
FOLDING = Camera(640, 480, 400.0, 400.0, 319.5, 239.5, (-0.6, 0.0, 0.0, 0.0, 0.0))
us, vs = st.floats(-0.5, 639.5), st.floats(-0.5, 479.5)


@given(us, vs)
def test_a_pixels_ray_projects_back_to_it(u: float, v: float) -> None:
    for camera in (MILD, FISHEYE, Camera.from_field_of_view(640, 480, 40.0)):
        ray, valid = camera.unproject((u, v))
        assert valid and ray[2] == 1.0
        uv, _ = camera.project(7.0 * ray)
        np.testing.assert_allclose(uv, (u, v), atol=1e-6)


def test_a_camera_of_a_field_of_view_looks_through_its_middle_and_as_wide_as_asked() -> None:
    camera = Camera.from_field_of_view(640, 480, 40.0)
    assert (camera.cx_px, camera.cy_px) == (319.5, 239.5)
    edges = camera.unproject(np.array([[-0.5, 239.5], [639.5, 239.5]]))[0]
    assert np.degrees(np.arctan(edges[:, 0])) == pytest.approx([-20.0, 20.0])


@given(st.lists(st.tuples(st.floats(-0.5, 0.5), st.floats(-0.4, 0.4)), min_size=1, max_size=20))
def test_projection_is_opencvs(xy: list[tuple[float, float]]) -> None:
    points = np.array([[x * 5.0, y * 5.0, 5.0] for x, y in xy])
    K = np.array([[700.0, 0.0, 322.0], [0.0, 710.0, 236.0], [0.0, 0.0, 1.0]])
    expected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), K, np.array(MILD.distortion))
    np.testing.assert_allclose(MILD.project(points)[0], expected[:, 0], atol=1e-6)


@given(st.lists(st.tuples(st.floats(0.0, 79.9), st.floats(-180.0, 180.0)), min_size=1, max_size=20))
def test_a_fisheye_s_projection_and_rays_are_opencvs(polar_deg: list[tuple[float, float]]) -> None:
    off, about = np.radians(polar_deg).T
    points = np.stack([np.sin(off) * np.cos(about), np.sin(off) * np.sin(about), np.cos(off)], axis=1)
    K, D = np.array([[330.0, 0.0, 322.0], [0.0, 333.0, 236.0], [0.0, 0.0, 1.0]]), np.array(FISHEYE.distortion)
    expected, _ = cv2.fisheye.projectPoints(points[:, None], np.zeros(3), np.zeros(3), K, D)
    uv, inside = FISHEYE.project(points)
    np.testing.assert_allclose(uv, expected[:, 0], atol=1e-6)
    if np.any(inside):
        # OpenCV stops within a hundred millionth of an angle, which the tangent makes 33 times as much at 80 degrees.
        undistorted = cv2.fisheye.undistortPoints(uv[inside][:, None], K, D)[:, 0]
        rays, valid = FISHEYE.unproject(uv[inside])
        assert valid.all()
        np.testing.assert_allclose(rays[:, :2], undistorted, atol=1e-5)


def test_a_fisheye_s_rays_end_at_eighty_degrees_and_where_its_polynomial_folds() -> None:
    """Also of a lens that shows 220 degrees: what is beyond is not refused with the file, and has no ray."""
    wide = replace(FISHEYE, fx_px=170.0, fy_px=170.0, distortion=(0.0, 0.0, 0.0, 0.0))
    for angle_deg, is_valid in ((0.0, True), (79.9, True), (80.1, False), (100.0, False)):
        ray, valid = wide.unproject((wide.cx_px + 170.0 * np.radians(angle_deg), wide.cy_px))
        assert valid == is_valid and np.isfinite(ray).all()
    assert not wide.project((1.0, 0.0, 0.17))[1] and wide.project((1.0, 0.0, 0.18))[1]
    Camera.from_text(wide.to_json(), "wide")
    beyond = wide.rayless()
    assert beyond is not None and FISHEYE.rayless() is None and MILD.rayless() is None
    pixels = np.stack(np.meshgrid(np.arange(640.0), np.arange(480.0)), axis=-1)
    assert np.count_nonzero(beyond == wide.unproject(pixels)[1]) < 20  # but for the edge's own pixels
    folding = replace(FISHEYE, distortion=(-0.3, 0.0, 0.0, 0.0))
    assert np.hypot(*folding.unproject((0.0, 0.0))[0][:2]) <= np.tan(np.sqrt(0.7 / 0.9)) and folding.max_radius < 1.3
    assert not folding.unproject((0.0, 0.0))[1] and folding.unproject((320.0, 240.0))[1]


@given(us, vs)
def test_where_the_calibration_folds_a_pixel_has_no_ray_but_a_finite_one(u: float, v: float) -> None:
    ray, valid = FOLDING.unproject((u, v))
    assert np.all(np.isfinite(ray))
    if valid:
        assert np.hypot(*ray[:2]) <= FOLDING.max_radius + 1e-9
        np.testing.assert_allclose(FOLDING.project(ray)[0], (u, v), atol=2e-3)


def test_the_corner_of_a_folding_calibration_is_invalid_and_its_middle_valid() -> None:
    assert not FOLDING.unproject((0.0, 0.0))[1]
    assert FOLDING.unproject((320.0, 240.0))[1]


@pytest.mark.parametrize(("camera", "reach"), [(MILD, 0.4), (FISHEYE, 3.5)])
@given(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
@example(0.0, 0.0)
@example(1e-8, -1e-7)
def test_derivatives_are_the_distortion_s(camera: Camera, reach: float, x: float, y: float) -> None:
    xy, steps = reach * np.array([x, y]), 1e-6 * np.eye(2)
    J = np.stack([(camera.distort(xy + step) - camera.distort(xy - step)) / 2e-6 for step in steps], axis=1)
    there, along, cross = camera.lens.linearised(xy[:, None])
    np.testing.assert_allclose(there[:, 0], camera.distort(xy), atol=1e-15)
    np.testing.assert_allclose([[along[0, 0], cross[0]], [cross[0], along[1, 0]]], J, atol=1e-8)
    np.testing.assert_allclose(camera.area_gain(xy[None]), np.linalg.det(J), atol=1e-7)
    for number, by in enumerate(camera.lens.by_coefficients(xy[:, None])):
        more, less = (replace(camera, distortion=_moved(camera, number, step)) for step in (1e-6, -1e-6))
        np.testing.assert_allclose(by[:, 0], (more.distort(xy) - less.distort(xy)) / 2e-6, atol=1e-8)


def _moved(camera: Camera, number: int, step: float) -> tuple[float, ...]:
    return tuple(k + step * (i == number) for i, k in enumerate(camera.distortion))


@pytest.mark.filterwarnings("ignore:invalid value")  # of the infinite one
@pytest.mark.parametrize("uv", [(-0.6, 10.0), (639.6, 10.0), (10.0, -1.0), (10.0, 480.0), (np.nan, 1.0), (np.inf, 1.0)])
def test_pixels_off_the_picture_have_no_ray(uv: tuple[float, float]) -> None:
    ray, valid = MILD.unproject(uv)
    assert not valid and np.all(np.isfinite(ray))


def test_points_behind_the_camera_are_invalid() -> None:
    assert not MILD.project((0.0, 0.0, -5.0))[1]
    assert MILD.project((0.0, 0.0, 5.0))[1]


def test_a_camera_file_survives(tmp_path: Path) -> None:
    path = tmp_path / "camera.json"
    for camera in (MILD, FISHEYE):
        path.write_text(camera.to_json())
        assert Camera.from_json(path) == camera


@pytest.mark.parametrize(
    "text", ["[" * 100_000, MILD.to_json().replace("700.0", "1" + "0" * 400)], ids=["deep", "huge"]
)
def test_a_camera_file_without_measure_is_named(tmp_path: Path, text: str) -> None:
    """Other faults of one: tests/transcripts/pc-onboard-camera.txt."""
    (tmp_path / "camera.json").write_text(text)
    with pytest.raises(InputError, match=r"camera\.json"):
        Camera.from_json(tmp_path / "camera.json")


def test_lenses_as_there_are_are_accepted(tmp_path: Path) -> None:
    """A refusal of everything would satisfy the rows above: a fisheye's pinhole part, a long lens, squeezed pixels."""
    path = tmp_path / "camera.json"
    for change in (
        {"fx_px": 110.0, "fy_px": 110.0},
        {"fx_px": 60_000.0, "fy_px": 60_000.0, "distortion_opencv_k1_k2_p1_p2_k3": [2.0, 900.0, 0.0, 0.0, 0.0]},
        {"fx_px": 250.0, "fy_px": 490.0, "pixel_aspect": 1.96},
        {"fx_px": 500.0, "fy_px": 546.0},  # analogue video
        {"cx_px": 12.0},
    ):
        path.write_text(json.dumps({**json.loads(MILD.to_json()), **change}))
        camera = Camera.from_json(path)
        assert camera.size_px == MILD.size_px
        assert Camera.from_text(camera.to_json(), "as written") == camera
