"""The rendered thermal camera: heat where its truth says, as much as it says, and the sensor's faults as declared."""

import csv
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from contract.camera import Camera
from contract.errors import InputError
from contract.rotations import exp_so3
from onboard.config.schema import load_config
from simulation.flight import DescribedSpec
from simulation.heat_sources import Fire, HeatSource, rocks_near
from simulation.paths import PathSpec
from simulation.session import SessionSpec, fly
from simulation.terrain import Terrain, TerrainSpec
from simulation.texture import Texture, TextureSpec
from simulation.thermal import ThermalRenderer, ThermalSpec
from simulation.trajectory import Pose

BOSON = Camera.from_field_of_view(640, 512, 50.0)
LEPTON = Camera.from_field_of_view(160, 120, 57.0)
DOWN = np.diag([1.0, -1.0, -1.0])
ABOVE = Pose(np.array([3.0, -2.0, 100.0]), DOWN)
IDEAL = ThermalSpec(netd_k=0.0, pattern_k=0.0, drift_k_min=0.0, blur_px=0.0)
GROUND = TextureSpec(seed=3)


def renderer(spec: ThermalSpec, camera: Camera = BOSON, terrain: TerrainSpec | None = None) -> ThermalRenderer:
    return ThermalRenderer(camera, Terrain(terrain or TerrainSpec()), Texture(GROUND), spec)


def kelvin(spec: ThermalSpec, camera: Camera = BOSON, pose: Pose = ABOVE, time_s: float = 0.0) -> np.ndarray:
    sampled = renderer(spec, camera)
    return np.asarray(100.0 * sampled.radiance(pose, time_s).astype(float) ** 0.25)


def ground_area_m2(camera: Camera, pose: Pose) -> np.ndarray:
    """Of each pixel, on level ground."""
    corners = np.stack(np.meshgrid(np.arange(camera.width_px + 1) - 0.5, np.arange(camera.height_px + 1) - 0.5), -1)
    rays = camera.unproject(corners)[0] @ pose.R_enu_cam.T
    at = rays[..., :2] / -rays[..., 2:] * pose.centre_m[2]
    across, down = np.diff(at, axis=1)[:-1], np.diff(at, axis=0)[:, :-1]
    return np.abs(across[..., 0] * down[..., 1] - across[..., 1] * down[..., 0])


def test_the_ground_varies_by_a_few_kelvin_as_natural_scenes_do() -> None:
    side = np.meshgrid(*2 * [np.arange(512, dtype=np.float32) * np.float32(0.5)])
    sampled = renderer(IDEAL)
    ground = sampled.ground_k(np.zeros(2), side[0], side[1], np.full((512, 512), 0.5, np.float32), 1.0).astype(float)
    assert 1.0 < ground.std() < 4.0 and 270.0 < ground.min() < ground.max() < 310.0
    window = np.hanning(512)[:, None] * np.hanning(512)[None, :]
    amplitude = np.abs(np.fft.fftshift(np.fft.fft2((ground - ground.mean()) * window)))
    radius = np.hypot(*np.meshgrid(np.arange(-256, 256), np.arange(-256, 256)))
    rings = np.array([np.sqrt(np.mean(amplitude[(radius > r / 1.2) & (radius < r * 1.2)] ** 2)) for r in (8, 90)])
    slope = np.log(rings[1] / rings[0]) / np.log(90 / 8)
    assert -2.0 < slope < -0.7  # amplitude against frequency, 32 m to 3 m; natural scenes about -1


@pytest.mark.parametrize("camera", [BOSON, LEPTON], ids=["640x512", "160x120"])
@pytest.mark.parametrize("tilt_deg", [0.0, 40.0])
def test_a_person_adds_its_own_warmth_where_its_truth_says(camera: Camera, tilt_deg: float) -> None:
    pose = Pose(ABOVE.centre_m, exp_so3(np.radians([tilt_deg, 0.0, 0.0])) @ DOWN)
    aim = pose.R_enu_cam[:, 2]
    place = pose.centre_m + aim * (100.0 / -aim[2])
    person = HeatSource.person((float(place[0]) + 3.3, float(place[1]) - 4.2))
    clear_air = replace(IDEAL, air_m=1e9)
    bare, warm = kelvin(clear_air, camera, pose), kelvin(replace(clear_air, sources=(person,)), camera, pose)
    gained = warm**4 - bare**4
    seen = renderer(clear_air, camera).seen(person, 0.0)
    assert seen.kelvin - seen.ground_k == 8.0 and seen.area_m2 == 0.25
    expected = (seen.kelvin**4 - seen.ground_k**4) * seen.area_m2
    assert (gained * ground_area_m2(camera, pose)).sum() == pytest.approx(expected, rel=0.12)  # its ground's texture
    rows, columns = np.indices(gained.shape)
    centre = np.array([(gained * columns).sum(), (gained * rows).sum()]) / gained.sum()
    uv, _ = camera.project((np.array([*seen.place_m, 0.0]) - pose.centre_m) @ pose.R_enu_cam)
    assert np.abs(centre - uv).max() < (0.15 if camera is BOSON else 0.51)  # in one pixel alone: anywhere in it
    assert warm.max() - seen.ground_k == pytest.approx(8.0, abs=0.1) if camera is BOSON and not tilt_deg else True


def test_a_person_half_hidden_by_a_coarse_pixel_looks_cooler() -> None:
    warm = kelvin(replace(IDEAL, sources=(HeatSource.person((3.0, -2.0)),)), LEPTON)
    bare = kelvin(IDEAL, LEPTON)
    assert 0.5 < (warm - bare).max() < 6.0  # 0.5 m in pixels of 0.68 m


def test_a_fire_grows_at_its_rate_and_is_shown_as_large_as_it_is() -> None:
    fire = Fire(((-4.0, 0.0), (8.0, 3.0)), rate_m_s=0.2, from_s=10.0, depth_m=50.0)
    assert fire.area_m2(9.9) == 0.0 and not len(fire.outline_m(9.9))
    assert fire.spread_m(40.0) - fire.spread_m(15.0) == pytest.approx(0.2 * 25.0)
    for time_s in (15.0, 40.0):
        outline = fire.outline_m(time_s)
        x, y = outline.T
        enclosed = 0.5 * float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
        assert enclosed == pytest.approx(fire.area_m2(time_s), rel=0.01)
        round_m = np.linalg.norm(np.roll(outline, -1, axis=0) - outline, axis=1).sum()
        assert round_m == pytest.approx(fire.perimeter_m(time_s), rel=0.01)
        hot = kelvin(replace(IDEAL, fires=(fire,)), time_s=time_s) > 590.0  # half covered
        assert hot.sum() * float(np.median(ground_area_m2(BOSON, ABOVE))) == pytest.approx(enclosed, rel=0.03)


def test_behind_the_flames_embers_cool() -> None:
    fire = Fire(((0.0, 0.0), (0.0, 0.1)), rate_m_s=0.1, first_m=0.5)
    at = fire.warmth_k(np.array([0.0, 3.0, 6.0, 6.9, 7.2]), np.zeros(5), 290.0, 65.0)  # spread: 7 m
    assert at[3] == 700.0 and np.isnan(at[4])
    assert 290.0 < at[0] < at[1] < at[2] < 420.1
    assert at[0] == pytest.approx(290.0 + 130.0 * np.exp(-60.0 / 120.0), abs=0.5)


def test_rocks_stay_where_they_are_whoever_looks() -> None:
    one, other = (rocks_near(np.array([x, 0.0]), 300.0, 200.0, 2.0, 7) for x in (0.0, 100.0))
    common = {r.mover.start_m for r in one} & {r.mover.start_m for r in other}
    both = [p for p in {r.mover.start_m for r in one} if np.hypot(p[0] - 100.0, p[1]) <= 300.0]
    assert common == set(both) and len(common) > 10
    many = rocks_near(np.zeros(2), 2000.0, 200.0, 2.0, 7)
    assert len(many) == pytest.approx(200.0 * np.pi * 4.0, rel=0.1)
    warmth = np.array([r.excess_k for r in many])
    assert warmth.mean() == pytest.approx(2.0, rel=0.1) and warmth.max() <= 8.0


def test_the_sensors_noise_and_pattern_are_as_declared() -> None:
    spec = replace(IDEAL, netd_k=0.05, pattern_k=0.08, drift_k_min=0.3)
    sampled, plain = renderer(spec, LEPTON), renderer(IDEAL, LEPTON)
    shots = [sampled.picture([ABOVE], 1.0, k, 0.0) / 100.0 for k in range(30)]
    truth = plain.picture([ABOVE], 1.0, 0, 0.0) / 100.0
    assert np.std(shots[1] - shots[0]) / np.sqrt(2.0) == pytest.approx(0.05, rel=0.1)
    assert np.std(np.mean(shots, axis=0) - truth) == pytest.approx(0.08, rel=0.1)
    late = np.mean([sampled.picture([ABOVE], 1.0, k, 60.0) / 100.0 for k in range(30)], axis=0)
    assert np.std(late - truth) == pytest.approx(np.hypot(0.08, 0.3), rel=0.1)


def test_the_shutter_freezes_the_picture_and_leaves_another_pattern() -> None:
    spec = replace(IDEAL, netd_k=0.05, pattern_k=0.08, shutter_s=(2.0,), freeze_s=0.4)
    sampled = renderer(spec, LEPTON)
    times = np.arange(1.5, 3.0, 0.1)
    shots = [sampled.picture([ABOVE], 1.0, k, float(t)) for k, t in enumerate(times)]
    repeats = [float(t) for t, a, b in zip(times[1:], shots[1:], shots, strict=False) if np.array_equal(a, b)]
    assert repeats == pytest.approx([2.0, 2.1, 2.2, 2.3])
    step = shots[-1].astype(float) - shots[0]
    assert 1.0 < abs(step.mean()) < 300.0  # centikelvin
    assert np.std(step) / 100.0 == pytest.approx(np.sqrt(2.0) * np.hypot(0.05, 0.08), rel=0.15)


def test_an_automatic_gain_gives_eight_bits_that_depend_on_what_is_seen() -> None:
    spec = replace(IDEAL, output="agc")
    grey = renderer(spec, LEPTON).picture([ABOVE], 1.0, 0, 0.0)
    assert grey.dtype == np.uint8 and np.percentile(grey, 99.5) > 240 and np.percentile(grey, 0.5) < 15
    fired = renderer(replace(spec, fires=(Fire(((0.0, 0.0), (5.0, 0.0)), first_m=5.0),)), LEPTON)
    assert np.median(fired.picture([ABOVE], 1.0, 0, 0.0)) < 0.2 * np.median(grey)


def test_what_cannot_be_rendered_is_refused() -> None:
    for wrong in ({"output": "colour"}, {"netd_k": -1.0}, {"air_m": 0.0}, {"rocks_km2": 401.0}):
        with pytest.raises(InputError):
            ThermalSpec(**wrong)
    with pytest.raises(InputError, match="rate"):
        Fire(((0.0, 0.0), (1.0, 0.0)), rate_m_s=0.0)
    with pytest.raises(InputError, match="water"):
        ThermalRenderer(LEPTON, Terrain(TerrainSpec()), Texture(TextureSpec("water")), ThermalSpec())


def test_a_thermal_flight_is_written_with_its_counts_and_the_truth_of_each_thing(tmp_path: Path) -> None:
    person = HeatSource.person((10.0, 20.0), 6.0)
    spec = SessionSpec(
        DescribedSpec(PathSpec("straight", height_m=100.0, speed_m_s=10.0)), seconds=4.0, rate_hz=2.0, camera=LEPTON,
        texture=GROUND, thermal=ThermalSpec(sources=(person,)),
    )  # fmt: skip
    truth = fly(spec, tmp_path / "flight")
    config = load_config(tmp_path / "flight" / "config.toml")
    assert config.thermal.enabled and config.thermal.calibration is not None
    with (tmp_path / "flight" / "truth_heat.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert 3 < len(rows) <= 8 and {row["kind"] for row in rows} == {"person"}
    for row in rows:
        frame = int(row["frame"])
        counts = cv2.imread(str(tmp_path / "flight" / "frames" / truth.files[frame]), cv2.IMREAD_UNCHANGED)
        assert counts.dtype == np.uint16 and counts.shape == (120, 160)
        assert abs(float(config.thermal.calibration.kelvin(counts).mean()) - 287.0) < 5.0
        lat, lon, height = (float(row[key]) for key in ("lat_deg", "lon_deg", "height_amsl_m"))
        place = truth.origin.to_enu(lat, lon, height + truth.undulation_m)
        assert np.abs(place[:2] - [10.0, 20.0]).max() < 1e-3
        uv, _ = truth.project(frame, place[None])
        assert np.abs(uv[0] - [float(row["u"]), float(row["v"])]).max() < 0.02
        assert float(row["kelvin"]) - float(row["ground_kelvin"]) == pytest.approx(6.0, abs=2e-3)
