"""Things that are rendered: where their truth says, at the brightness asked, hidden by nothing but the next."""

import numpy as np
import pytest

from contract.camera import Camera
from contract.errors import InputError
from simulation.movers import Manoeuvre, Movers, MoverSpec
from simulation.renderer import Renderer, SensorSpec
from simulation.terrain import Terrain, TerrainSpec
from simulation.texture import Texture, TextureSpec
from simulation.trajectory import Pose

CAMERA = Camera.from_field_of_view(320, 240, 40.0)
POSE = Pose(np.array([3.0, -2.0, 60.0]), np.diag([1.0, -1.0, -1.0]))


def light(*specs: MoverSpec, time_s: float = 0.0) -> np.ndarray:
    terrain, texture = Terrain(TerrainSpec()), Texture(TextureSpec(style="plain"))
    sensor = SensorSpec(noise=0.0, vignetting=0.0, exposure_swing=1.0)
    return Renderer(CAMERA, terrain, texture, sensor, movers=Movers(specs, 5.0)).radiance(POSE, time_s)


def test_a_thing_is_rendered_where_its_truth_says() -> None:
    car = MoverSpec.car((1.0, 2.0), 4.0, 90.0)
    off = np.abs(light(car, time_s=6.0) - light(time_s=6.0))
    rows, columns = np.indices(off.shape)
    centre = np.array([(off * columns).sum(), (off * rows).sum()]) / off.sum()
    place = np.array([*car.place_m(1.0), Terrain(TerrainSpec()).height_m(5.0, 2.0)])
    expected, _ = CAMERA.project((place - POSE.centre_m) @ POSE.R_enu_cam)
    assert np.abs(centre - expected).max() < 2.0  # its spots are of different brightness
    assert off.max() > 0.1 and 4.0 * 1.8 * 0.5 < (off > 0.02).sum() * (60.0 / CAMERA.focal_px) ** 2 < 4.0 * 1.8 * 1.6


def test_a_shadow_darkens_the_ground_it_lies_on() -> None:
    shadow = MoverSpec((3.0, -2.0), length_m=4.0, width_m=4.0, albedo=None)
    ratio = light(shadow) / light()
    assert ratio[119, 159] == pytest.approx(0.45, abs=0.01) and ratio[10, 10] == pytest.approx(1.0)


def test_a_thing_goes_turns_and_stops_as_specified() -> None:
    walker = MoverSpec((0.0, 0.0), 2.0, 0.0, turn_deg_s=90.0, from_s=1.0, until_s=3.0)
    assert np.allclose(walker.place_m(0.5), 0.0) and np.allclose(walker.place_m(9.0), walker.place_m(3.0))
    assert np.allclose(walker.place_m(3.0), [2.0 * 2.0 / (np.pi / 2.0), 0.0])  # half a circle to the right
    assert np.allclose(walker.velocity_m_s(2.0), [2.0, 0.0]) and np.allclose(walker.velocity_m_s(0.0), 0.0)
    straight = MoverSpec.person((1.0, 1.0), 1.4, 90.0)
    assert np.allclose(straight.place_m([0.0, -2.0, 5.0]), [[1.0, 1.0], [-1.8, 1.0], [8.0, 1.0]])
    h = 1e-4
    slope = (walker.place_m(2.0 + h) - walker.place_m(2.0 - h)) / (2 * h)
    assert np.allclose(slope, walker.velocity_m_s(2.0), atol=1e-6)


def test_a_thing_brakes_and_turns_as_specified() -> None:
    turn = Manoeuvre(5.0, 7.0, turn_deg_s=45.0)
    car = MoverSpec((1.0, 2.0), 10.0, 90.0, manoeuvres=(Manoeuvre(1.0, 9.0, -4.0), Manoeuvre(10.0, 12.0, 2.0), turn))
    assert np.allclose(car.velocity_m_s([0.0, 2.0, 8.0]), [[10.0, 0.0], [6.0, 0.0], [0.0, 0.0]], atol=0.05)
    assert np.allclose(car.place_m([0.0, 1.0, 9.0]), [[1.0, 2.0], [11.0, 2.0], [11.0 + 100.0 / 8.0, 2.0]], atol=0.05)
    assert np.degrees(car.course_rad(6.0)) == pytest.approx(135.0, abs=1.0)
    assert np.allclose(car.velocity_m_s(13.0), [0.0, -4.0], atol=0.05)
    bend = MoverSpec((0.0, 0.0), 5.0, 20.0, turn_deg_s=30.0)
    same = MoverSpec((0.0, 0.0), 5.0, 20.0, manoeuvres=(Manoeuvre(-60.0, 60.0, turn_deg_s=30.0),))
    times = np.linspace(-3.0, 20.0, 40)
    assert np.allclose(same.place_m(times), bend.place_m(times), atol=2e-3)
    assert np.allclose(same.velocity_m_s(times), bend.velocity_m_s(times), atol=0.02)


def test_what_is_no_thing_is_refused() -> None:
    for wrong in ({"length_m": 0.0}, {"speed_m_s": -1.0}, {"from_s": 3.0, "until_s": 2.0}):
        with pytest.raises(InputError):
            MoverSpec((0.0, 0.0), **wrong)
