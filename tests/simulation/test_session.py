"""A whole session in a folder: what replay reads, truth that fits the pictures, the same bytes again."""

import csv
import json
import tomllib
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from contract.camera import Camera
from contract.errors import InputError
from contract.geodesy import LocalFrame
from contract.rotations import R_ENU_NED, log_so3, matrix_from_euler, mount_rotation
from simulation.flight import DescribedSpec, RecordedSpec
from simulation.paths import PathSpec
from simulation.renderer import Renderer, SensorSpec
from simulation.session import SessionSpec, fly, make_flight
from simulation.terrain import Terrain, TerrainSpec
from simulation.texture import GUSTS_M_S, SHINE, Texture, TextureSpec
from simulation.trajectory import Pose, RecordedTruth
from simulation.truth import Truth
from tests.rest_long import rest_long

pytestmark = pytest.mark.xdist_group("session")  # one worker: what they share is made once

DATA = Path(__file__).resolve().parent.parent / "data"
LENS = Camera(320, 240, 440.0, 441.0, 158.7, 121.3, distortion=(-0.18, 0.05, 0.0006, -0.0004, 0.0))
SMALL = SessionSpec(
    DescribedSpec(PathSpec("straight", crab_deg=15.0), seed=3),
    seconds=1.6,
    camera=LENS,
    terrain=TerrainSpec(relief_m=20.0, wavelength_m=180.0, seed=3),
    boresight_deg=(0.5, -0.4, 1.0),
    seed=3,
)


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("session") / "hills"


@pytest.fixture(scope="module", autouse=True)
def simulated(session: Path) -> Truth:
    return fly(SMALL, session)


def _flow_error(folder: Path, truth: Truth, first: int, second: int) -> np.ndarray:
    """Where Lucas-Kanade finds a picture's corners in another, minus where truth puts them, pixels (N, 2)."""
    a, b = (cv2.imread(str(folder / "frames" / truth.files[k]), cv2.IMREAD_GRAYSCALE) for k in (first, second))
    corners = cv2.goodFeaturesToTrack(a, 150, 0.01, 8).reshape(-1, 2)
    ground = truth.ground(first, corners)
    predicted, seen = truth.project(second, ground.enu_m)
    start = predicted.astype(np.float32)[:, None]
    found, status, _ = cv2.calcOpticalFlowPyrLK(
        a, b, corners[:, None], start.copy(), winSize=(15, 15), maxLevel=1, flags=cv2.OPTFLOW_USE_INITIAL_FLOW
    )
    keep = (status.ravel() == 1) & seen & ground.is_valid
    assert keep.sum() > 60
    return (found[:, 0] - predicted)[keep]


def test_pictures_move_as_truth_says(session: Path) -> None:
    error = _flow_error(session, Truth.load(session), 0, 5)
    assert 0.0 < np.median(np.hypot(*error.T)) < 0.2
    assert np.all(np.abs(np.median(error, axis=0)) < 0.1)


def test_the_session_holds_what_replay_reads(session: Path) -> None:
    stamps = list(csv.reader((session / "stamps.csv").open()))
    assert stamps[0] == ["file", "unix_time_s"]
    assert [row[0] for row in stamps[1:]] == sorted(path.name for path in (session / "frames").iterdir())
    assert np.diff([float(row[1]) for row in stamps[1:]]) == pytest.approx(0.2, abs=1e-5)
    assert Camera.from_json(session / "camera.json") == LENS
    config = tomllib.loads((session / "config.toml").read_text())
    assert config == {
        "mount": {"roll_deg": 0.0, "pitch_deg": -90.0, "yaw_deg": 0.0, "gimbal": "never"},
        "solve": {"attitude": "autopilot", "velocity": True, "level_ground": False},
    }
    picture = cv2.imread(str(session / "frames" / "000000.png"), cv2.IMREAD_UNCHANGED)
    assert picture.shape == (240, 320)
    assert 60 < picture.mean() < 200 and picture.std() > 8


def test_truth_clicks_reproject_to_their_pixels(session: Path) -> None:
    truth = Truth.load(session)
    with (session / "truth_clicks.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 8 * SMALL.clicks_per_frame
    for row in rows:
        height = float(row["height_amsl_m"]) + truth.undulation_m
        enu = truth.origin.to_enu(float(row["lat_deg"]), float(row["lon_deg"]), height)
        uv, seen = truth.project(int(row["frame"]), enu[None])
        assert seen.all()
        assert np.hypot(uv[0, 0] - float(row["u"]), uv[0, 1] - float(row["v"])) < 0.01


def test_loaded_truth_is_the_simulated_truth(session: Path, simulated: Truth) -> None:
    loaded = Truth.load(session)
    uv = np.array([[0.0, 0.0], [319.0, 239.0], [100.0, 50.0]])
    np.testing.assert_allclose(loaded.ground(1, uv).enu_m, simulated.ground(1, uv).enu_m, atol=2e-3)
    np.testing.assert_allclose(loaded.unix_time_s, simulated.unix_time_s, atol=1e-6)


def test_ground_points_are_in_plain_sight_of_their_own_picture(session: Path) -> None:
    truth = Truth.load(session)
    uv = np.random.default_rng(0).uniform([0, 0], [319, 239], (100, 2))
    points = truth.ground(2, uv)
    assert truth.sees(2, points.enu_m).all()
    assert not truth.sees(2, points.enu_m - [0.0, 0.0, 5.0]).any()


def test_the_same_spec_writes_the_same_bytes_and_another_seed_does_not(session: Path, tmp_path: Path) -> None:
    fly(SMALL, tmp_path / "again")
    names = sorted(path.relative_to(session) for path in session.rglob("*") if path.is_file())
    assert names == sorted(p.relative_to(tmp_path / "again") for p in (tmp_path / "again").rglob("*") if p.is_file())
    for name in names:
        assert (session / name).read_bytes() == (tmp_path / "again" / name).read_bytes(), name
    fly(replace(SMALL, seconds=0.2, seed=4), tmp_path / "other")
    assert (tmp_path / "other/frames/000000.png").read_bytes() != (session / "frames/000000.png").read_bytes()


def test_the_true_mount_differs_from_the_declared_one_by_the_boresight(session: Path) -> None:
    truth, flight = Truth.load(session), make_flight(SMALL)
    declared = flight.trajectory.R_enu_body(0.0) @ mount_rotation(*SMALL.mount_deg)
    np.testing.assert_allclose(np.degrees(log_so3(declared.T @ truth.poses[0].R_enu_cam)), [0.5, -0.4, 1.0], atol=1e-6)


def test_camera_delay_moves_stamps_and_not_truth(tmp_path: Path) -> None:
    truth = fly(replace(SMALL, seconds=0.2, camera_delay_s=0.25), tmp_path / "late")
    stamp = float((tmp_path / "late/stamps.csv").read_text().splitlines()[1].split(",")[1])
    assert stamp - truth.unix_time_s[0] == pytest.approx(0.25, abs=1e-5)


def test_a_recorded_flight_is_simulated_where_its_truth_says(tmp_path: Path) -> None:
    """plane_turn, in its turn: camera straight down in the body, telemetry unchanged."""
    spec = SessionSpec(RecordedSpec("plane_turn", start_s=32.0), seconds=1.0, camera=LENS, seed=1)
    truth = fly(spec, tmp_path / "turn")
    recorded = RecordedTruth.read(DATA / "plane_turn.truth.csv")
    at = int(np.argmin(np.abs(recorded.unix_time_s - truth.unix_time_s[3])))
    near = LocalFrame(recorded.lat_deg[at], recorded.lon_deg[at], recorded.height_amsl_m[at])
    assert np.linalg.norm(near.to_enu(*truth.camera_geodetic(3))) < 22.0 * 0.02 + 0.05
    R_body = R_ENU_NED @ matrix_from_euler(*np.radians(recorded.roll_pitch_yaw_deg[at]))
    turned = log_so3((R_body @ mount_rotation(0.0, -90.0, 0.0)).T @ truth.R_local_cam(3))
    assert np.degrees(np.linalg.norm(turned)) < 1.0
    assert (tmp_path / "turn/telemetry.tlog").read_bytes() == (DATA / "plane_turn.tlog").read_bytes()
    error = _flow_error(tmp_path / "turn", truth, 1, 2)
    assert np.median(np.hypot(*error.T)) < 0.3


def test_a_trimmed_piece_tells_the_same_flight_as_the_whole(shared_data: Path, tmp_path: Path) -> None:
    """Their clocks differ by the drift of the boot clock; position and attitude at one boot time do not."""
    camera = replace(LENS, width_px=64, height_px=48)
    whole = fly(
        SessionSpec(RecordedSpec(str(shared_data / "sitl/plane_clean"), start_s=240.0), 0.4, camera=camera),
        tmp_path / "w",
    )
    piece = fly(SessionSpec(RecordedSpec("plane_turn", start_s=9.0), 0.4, camera=camera), tmp_path / "p")
    shift = whole.unix_time_s[0] - piece.unix_time_s[0]
    assert -0.2 < shift < -0.1
    for frame in range(2):
        assert whole.camera_geodetic(frame)[:2] == pytest.approx(piece.camera_geodetic(frame)[:2], abs=1e-6)


def test_oblique_pictures_have_sky_above_and_ground_below(tmp_path: Path) -> None:
    spec = replace(SMALL, seconds=0.2, mount_deg=(0.0, -5.0, 0.0), boresight_deg=(0.0, 0.0, 0.0))
    truth = fly(spec, tmp_path / "oblique")
    picture = cv2.imread(str(tmp_path / "oblique/frames/000000.png"), cv2.IMREAD_GRAYSCALE)
    assert picture[5:40, 20:-20].mean() > picture[-60:, 20:-20].mean() + 20
    valid = truth.ground(0, [[160.0, 5.0], [160.0, 235.0]]).is_valid
    assert valid.tolist() == [False, True]


def test_a_lens_that_folds_leaves_its_corners_black() -> None:
    camera = replace(LENS, fx_px=150.0, fy_px=150.0, distortion=(-0.35, 0.0, 0.0, 0.0, 0.0))
    renderer = Renderer(camera, Terrain(TerrainSpec()), Texture(TextureSpec("plain")), SensorSpec(), 0)
    picture = renderer.picture([Pose(np.array([0.0, 0.0, 100.0]), np.diag([1.0, -1.0, -1.0]))], 1.0, 0)
    corner_valid = camera.unproject([0.0, 0.0])[1]
    assert not corner_valid
    assert picture[0, 0] == 0
    assert picture[120, 160] > 60


def test_motion_blurs_along_the_motion(tmp_path: Path) -> None:
    def sharpness(exposure_s: float) -> float:
        spec = replace(SMALL, seconds=0.2, camera=replace(LENS, fx_px=1500.0, fy_px=1500.0))
        folder = tmp_path / str(exposure_s)
        fly(replace(spec, sensor=SensorSpec(noise=0.0, exposure_s=exposure_s)), folder)
        picture = cv2.imread(str(folder / "frames/000000.png"), cv2.IMREAD_GRAYSCALE).astype(float)
        return float(np.abs(np.diff(picture, axis=0)).mean())

    assert sharpness(0.1) < 0.7 * sharpness(0.0)


@pytest.mark.parametrize("style", ["plain", "stripes", "water"])
def test_degenerate_grounds_are_degenerate(style: str) -> None:
    camera = Camera.from_field_of_view(320, 240, 40.0)
    quiet = SensorSpec(noise=0.0, vignetting=0.0)
    renderer = Renderer(camera, Terrain(TerrainSpec()), Texture(TextureSpec(style)), quiet, 0)
    pose = Pose(np.array([0.0, 0.0, 60.0]), np.diag([1.0, -1.0, -1.0]))
    first, later = renderer.picture([pose], 1.0, 0, 0.0), renderer.picture([pose], 1.0, 0, 1.0)
    if style == "plain":
        assert first.std() < 1.0
    elif style == "water":
        assert np.abs(first.astype(int) - later.astype(int)).mean() > 3.0
    else:
        bearing = renderer.texture.layers[0].tile.bearing_rad
        step = 8.0 * np.array([np.cos(bearing), np.sin(bearing), 0.0])
        moved = renderer.picture([replace(pose, centre_m=pose.centre_m + step)], 1.0, 0)
        assert np.abs(first.astype(int) - moved.astype(int)).mean() < 0.5
        assert first.std() > 10.0


def test_the_land_does_not_repeat() -> None:
    camera = Camera.from_field_of_view(160, 120, 40.0)
    renderer = Renderer(camera, Terrain(TerrainSpec()), Texture(TextureSpec()), SensorSpec(noise=0.0), 0)
    looking_down = np.diag([1.0, -1.0, -1.0])
    centres = np.random.default_rng(1).uniform(-2000, 2000, (12, 2))
    pictures = [renderer.radiance(Pose(np.array([*c, 250.0]), looking_down)).ravel() for c in centres]
    alike = np.corrcoef([p - cv2.blur(p.reshape(120, 160), (31, 31)).ravel() for p in pictures])
    assert np.abs(alike - np.eye(len(alike))).max() < 0.25


def test_a_folder_that_holds_something_is_left_alone(session: Path) -> None:
    with pytest.raises(InputError, match="not an empty folder"):
        fly(SMALL, session)


def test_loading_a_folder_without_truth_names_the_file(tmp_path: Path) -> None:
    (tmp_path / "camera.json").write_text(LENS.to_json())
    with pytest.raises(InputError, match=r"world\.json"):
        Truth.load(tmp_path)


def test_world_file_is_plain_json(session: Path) -> None:
    assert json.loads((session / "world.json").read_text())["terrain"]["relief_m"] == 20.0


@pytest.mark.parametrize("readout_s", rest_long([0.06, -0.06]))
def test_rows_are_exposed_one_after_the_other(tmp_path: Path, readout_s: float) -> None:
    """Flow between pictures is that of truth by rows, and pixels off that of the middle rows' poses alone."""
    turns = DescribedSpec(PathSpec("turns", speed_m_s=20.0, height_m=120.0, bank_deg=35.0, leg_m=10.0), seed=2)
    spec = replace(SMALL, flight=turns, seconds=1.0, readout_s=readout_s, seed=2)
    truth = fly(spec, tmp_path / "rows")
    by_rows = _flow_error(tmp_path / "rows", truth, 2, 4)
    assert np.median(np.hypot(*by_rows.T)) < 0.2
    rays, _ = truth.camera.unproject(uv := np.array([[160.0, 5.0], [160.0, 235.0]]))
    pose = truth.poses[2]
    depth, _ = truth.terrain.cast(pose.centre_m, rays @ pose.R_enu_cam.T)
    at_once = pose.centre_m + rays @ pose.R_enu_cam.T * depth[:, None]
    off_px = np.linalg.norm(truth.project(2, at_once)[0] - uv, axis=1)
    assert off_px.min() > 1.0, "this motion would not show"
    assert tomllib.loads((tmp_path / "rows/config.toml").read_text())["camera"] == {"readout_s": readout_s}
    with pytest.raises(InputError, match="truth_clicks"):
        Truth.load(tmp_path / "rows")


def test_stabilised_and_zoomed_pictures_are_as_truth_says_and_the_camera_file_may_be_wrong(tmp_path: Path) -> None:
    filed = replace(LENS, fx_px=1.03 * LENS.fx_px, fy_px=1.03 * LENS.fy_px)
    turns = DescribedSpec(PathSpec("turns", speed_m_s=20.0, height_m=120.0, bank_deg=35.0, leg_m=10.0), seed=2)
    spec = replace(SMALL, flight=turns, seconds=1.0, seed=2, filed_camera=filed)
    for name, moved in (("eis", replace(spec, stabilised_s=0.5)), ("zoom", replace(spec, zoom=(1.2, 0.0, 9.0)))):
        truth = fly(moved, tmp_path / name)
        assert np.median(np.hypot(*_flow_error(tmp_path / name, truth, 1, 3).T)) < 0.2
        assert truth.optics is not None
        one, other = truth.optics.cameras[1], truth.optics.cameras[3]
        assert abs(one.cx_px - other.cx_px) + abs(one.cy_px - other.cy_px) + abs(one.fx_px - other.fx_px) > 2.0
        assert Camera.from_json(tmp_path / name / "camera.json") == filed


def test_what_shines_in_crops_goes_with_the_wind_and_the_ground_below_stays() -> None:
    east, north = (np.asarray(a, np.float32) for a in np.meshgrid(np.arange(0.0, 40.0, 0.4), np.arange(0.0, 40.0, 0.4)))
    crops, land = Texture(TextureSpec("crops")), Texture(TextureSpec("land"))
    far, origin = np.full_like(east, 0.4), np.array([3.0, 8.0])

    def shine(time_s: float) -> np.ndarray:
        at = origin + GUSTS_M_S * time_s
        return np.asarray(crops.albedo(at, east, north, far, time_s) - land.albedo(at, east, north, far), float)

    now, later = shine(0.0), shine(2.0)
    assert 0.5 * SHINE < now.std() < 1.5 * SHINE
    assert np.corrcoef(now.ravel(), later.ravel())[0, 1] > 0.7  # but for what bends with it
    assert abs(np.corrcoef(now.ravel(), land.albedo(origin, east, north, far).ravel())[0, 1]) < 0.4
