"""The Debian packages of both architectures, built here, unpacked and run: amd64 natively, arm64 under emulation."""

import json
import re
import subprocess
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from contract.geodesy import LocalFrame
from contract.locate import locate
from ground.recording import Recording
from onboard.camera import v4l2_structures
from simulation.flight import RecordedSpec
from simulation.session import SessionSpec, fly
from simulation.terrain import TerrainSpec
from tests.arm64 import emulation
from tests.arm64.emulation import CHECKOUT
from tests.arm64.fly_and_dump import FIELDS as SET_FIELDS
from tests.arm64.installation import ENVIRONMENT, Installation, unpack
from tests.bench.image.host import run
from tests.test_install import use_onboard, use_terrain

ARCHITECTURES = ("amd64", "arm64")
MOST_MB = {"amd64": (100, 330), "arm64": (80, 250)}
"""Of a package: to fetch, and unpacked. With nothing left out both were over 200 and 740."""
FIELDS = (*SET_FIELDS, "clicks")
LEAST_MB = (50, 180)  # OpenCV, NumPy, SciPy's linear algebra and zenoh alone are more
CAMERA_M, TURN_RAD, FEATURE_PX, CLICK_M = 1e-3, 1e-5, 1e-3, 4e-3
DEPTH, SIGMA = 2e-5, 5e-4  # relative
"""What architectures may differ by (docs/what-a-pi-can-do.md); three times what this flight was measured to."""
WIRE_M = 0.03  # of a click, where the payload's rounding falls the other way


@pytest.fixture(scope="session")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Installation]:
    @cache
    def of(architecture: str) -> Installation:
        return unpack(architecture, tmp_path_factory.mktemp(architecture))

    return of


@pytest.fixture(scope="session")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three seconds of a rendered flight along a real autopilot's recording, 15 pictures."""
    folder = tmp_path_factory.mktemp("flight") / "flight"
    spec = SessionSpec(
        RecordedSpec("plane_turn", 3.0, whole_log=False), seconds=3.0, rate_hz=5.0, mount_deg=(0.0, -90.0, -90.0),
        terrain=TerrainSpec(relief_m=10.0),
    )  # fmt: skip
    fly(spec, folder)
    return folder


@pytest.fixture(scope="session")
def simulated(
    installed: Callable[[str], Installation], flight: Path, tmp_path_factory: pytest.TempPathFactory
) -> Callable[[str], Path]:
    """The flight replayed by an installation; its recording."""

    @cache
    def by(architecture: str) -> Path:
        recording = tmp_path_factory.mktemp("flown") / "session.mcap"
        files = {"frames": "frames", "telemetry": "telemetry.tlog", "camera": "camera.json", "stamps": "stamps.csv"}
        done = installed(architecture)(
            *("-m", "onboard", "replay", "--config", flight / "config.toml", "--out", recording),
            *(part for key, name in files.items() for part in (f"--{key}", flight / name)),
        )
        assert (done.returncode, done.stderr) == (0, "")
        assert re.search(r"^solved +15$", done.stdout, re.MULTILINE)
        return recording

    return by


@pytest.fixture(params=ARCHITECTURES)
def here(request: pytest.FixtureRequest, installed: Callable[[str], Installation]) -> Installation:
    return installed(request.param)


def well(done: subprocess.CompletedProcess[str]) -> str:
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_it_is_for_its_architecture(here: Installation) -> None:
    printed = well(here("-c", "import onboard, platform, sys; print(platform.machine(), sys.prefix, onboard.__file__)"))
    machine, prefix, module = printed.split()
    assert machine == {"amd64": "x86_64", "arm64": "aarch64"}[here.architecture]
    assert prefix.endswith("/opt/pointclick")
    assert module.startswith(prefix)
    assert well(run_host(["dpkg-deb", "-f", here.archive, "Architecture"])).strip() == here.architecture


def run_host(argv: list[object]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(list(map(str, argv)), capture_output=True, text=True, check=False, timeout=60)


def test_it_is_slim(here: Installation, record_property: Callable[[str, object], None]) -> None:
    unpacked_mb = sum(f.stat().st_size for f in (here.root / ENVIRONMENT).rglob("*") if not f.is_symlink()) / 1e6
    fetched_mb = here.archive.stat().st_size / 1e6
    record_property("package, MB", round(fetched_mb))
    record_property("installed, MB", round(unpacked_mb))
    assert LEAST_MB[0] < fetched_mb < MOST_MB[here.architecture][0]
    assert LEAST_MB[1] < unpacked_mb < MOST_MB[here.architecture][1]


def test_every_module_of_ours_can_be_imported(here: Installation) -> None:
    """And what they import only when it is asked for; the camera's structures are the kernel's on both.

    But the page's server, which is the ground's (extra `web`): here it says in one line what it lacks.
    """
    program = """
import importlib, pkgutil
import contract, ground, onboard
names = [m.name for p in (contract, ground, onboard) for m in pkgutil.walk_packages(p.__path__, p.__name__ + ".")]
for name in names:
    needs_web = name.startswith("ground.web.") and name not in ("ground.web.command", "ground.web.startup")
    if not name.endswith("__main__") and not needs_web:
        importlib.import_module(name)
import cryptography.x509, mavsdk, mavsdk.plugins.mavlink_direct, mcap.reader, pyulog, zenoh
from PIL import features
from pymavlink import DFReader
from onboard.camera import v4l2_structures as v
assert features.check("jpg") and features.check("zlib") and features.check("libtiff") and features.check("webp")
print(len(names), *sorted(f"{n}={value}" for n, value in vars(v).items() if n.isupper() and isinstance(value, int)))
"""
    count, *constants = well(here("-c", program)).split()
    ours = {path for top in ("contract", "ground", "onboard") for path in (CHECKOUT / top).rglob("*.py")}
    assert int(count) == len(ours) - 3  # but the three packages' own
    # The requests hold the structures' sizes; that they are the kernel's is tested where the kernel's header is.
    here_too = {f"{n}={value}" for n, value in vars(v4l2_structures).items() if n.isupper() and isinstance(value, int)}
    assert set(constants) == here_too
    assert len([c for c in constants if c.startswith(("QUERYCAP=", "DQBUF=", "S_FMT="))]) == 3
    page = here("-m", "ground", "web")
    assert page.returncode != 0
    assert "install pointclick with its extra [web]" in page.stderr
    assert len(page.stderr.strip().splitlines()) == 1


def test_everything_that_people_do_with_it_works(installed: Callable[[str], Installation], tmp_path: Path) -> None:
    """Every command's help, certificates, the board, configurations, a flight and a click."""
    use_onboard(installed("amd64").programs, tmp_path)


def test_it_measures_the_computer(installed: Callable[[str], Installation], tmp_path: Path) -> None:
    """With its own small means: `simulation` is not in it. What it measures under emulation would mean nothing."""
    arguments = ("--config", tmp_path / "none.toml", "--size", "320x240", "--rate", "1", "--seconds", "0")
    found = json.loads(well(installed("amd64")("-m", "onboard", "bench", *arguments, "--json")))
    assert found["solved"] > 0.9 * found["pictures"] >= 100
    assert found["is_good"]


def test_the_emulated_one_reads_its_configuration_and_helps(
    installed: Callable[[str], Installation], tmp_path: Path
) -> None:
    arm64 = installed("arm64")
    assert "replay" in well(arm64("-m", "onboard", "--help"))
    assert "click" in well(arm64("-m", "ground", "--help"))
    assert well(arm64("-m", "onboard", "check-config")) == "/etc/pointclick/config.toml: good\n"
    unknown = tmp_path / "config.toml"
    unknown.write_text("[mount]\npich_deg = 3.0\n")
    done = arm64("-m", "onboard", "check-config", "--config", unknown)
    assert (done.returncode, "pitch_deg" in done.stderr) == (2, True)


def test_doctor_says_what_is_missing(here: Installation, flight: Path, tmp_path: Path) -> None:
    config = tmp_path / "config.toml"
    config.write_text(
        f'[camera]\ndevice = "/dev/video99"\nfile = "{flight}/camera.json"\n[telemetry]\nurl = "udpin:127.0.0.1:0"\n'
    )
    done = here("-m", "onboard", "doctor", "--config", config)
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    assert re.search(r"camera.*/dev/video99", done.stdout)


def test_a_video_is_refused_in_one_line(here: Installation, flight: Path, tmp_path: Path) -> None:
    """FFmpeg is not there: OpenCV would call it all the same."""
    video = tmp_path / "20260612T101500Z.mp4"
    video.write_bytes(b"\0\0\0\x18ftypmp42")
    done = here(
        *("-m", "onboard", "replay", "--frames", video, "--telemetry", flight / "telemetry.tlog"),
        *("--camera", flight / "camera.json"),
    )
    assert (done.returncode, done.stdout, len(done.stderr.splitlines())) == (2, "", 1)
    assert "reads no videos" in done.stderr


def test_terrain_is_an_addition(installed: Callable[[str], Installation], tmp_path: Path) -> None:
    amd64 = installed("amd64")
    without = amd64("-c", "from onboard.storage.elevation_files import TerrainFiles; TerrainFiles('/nowhere')")
    assert "pointclick-onboard-terrain" in without.stderr
    both = tmp_path / "root"
    both.mkdir()
    for archive in (amd64.archive, amd64.terrain):
        run(["dpkg-deb", "-x", archive, both])
    python = (str(both / ENVIRONMENT / "bin" / "python3"),)
    use_terrain(Installation("amd64", both, python, amd64.archive, amd64.terrain).programs, tmp_path)
    assert not names(amd64.archive) & names(amd64.terrain)  # dpkg would refuse the second


def names(archive: Path) -> set[str]:
    """Files of a package."""
    lines = well(run_host(["dpkg-deb", "-c", archive])).splitlines()
    return {line.split()[5] for line in lines if not line.startswith("d")}


def test_both_architectures_give_the_same_answers(
    installed: Callable[[str], Installation],
    flight: Path,
    tmp_path: Path,
    record_property: Callable[[str, object], None],
) -> None:
    """Not the same bytes: OpenCV and OpenBLAS sum in other orders. Everything is compared before it is rounded."""
    found = {}
    for architecture in ARCHITECTURES:
        out = tmp_path / f"{architecture}.npz"
        well(installed(architecture)(CHECKOUT / "tests" / "arm64" / "fly_and_dump.py", flight, out))
        found[architecture] = np.load(out)
    ours, theirs = (found[architecture] for architecture in ARCHITECTURES)
    assert ours.files == theirs.files
    frames = sorted({int(key.split(".")[0]) for key in ours.files})
    assert len(frames) == 15
    worst = dict.fromkeys(("camera, m", "turn, rad", "feature, px", "depth", "sigma", "click, m"), 0.0)

    def note(name: str, difference: np.ndarray) -> None:
        worst[name] = max(worst[name], float(np.abs(difference).max()))

    for frame in frames:
        a, b = ({key: kept[f"{frame}.{key}"] for key in FIELDS} for kept in (ours, theirs))
        place = LocalFrame(float(a["camera_lat_deg"]), float(a["camera_lon_deg"]), float(a["camera_height_m"]))
        there = place.to_enu(float(b["camera_lat_deg"]), float(b["camera_lon_deg"]), float(b["camera_height_m"]))
        note("camera, m", there)
        note("turn, rad", a["R_enu_cam"].T @ b["R_enu_cam"] - np.eye(3))
        note("feature, px", a["uv_px"] - b["uv_px"])
        note("depth", b["inverse_depth_per_m"] / a["inverse_depth_per_m"] - 1.0)
        note("sigma", b["sigma_inverse_depth_per_m"] / a["sigma_inverse_depth_per_m"] - 1.0)
        for x, y in zip(a["clicks"], b["clicks"], strict=True):
            note("click, m", LocalFrame(*x[:3]).to_enu(*y[:3]))
            note("sigma", y[3:] / x[3:] - 1.0)
    for name, value in worst.items():
        record_property(name, f"{value:.1e}")
    bounds = (CAMERA_M, TURN_RAD, FEATURE_PX, DEPTH, SIGMA, CLICK_M)
    assert all(value < bound for value, bound in zip(worst.values(), bounds, strict=True)), worst
    assert all(value > 0.0 for value in worst.values())  # else the same library was run twice


def test_a_recording_gives_the_same_answers(
    installed: Callable[[str], Installation],
    simulated: Callable[[str], Path],
    record_property: Callable[[str, object], None],
) -> None:
    """`pc-ground click` of each architecture on its own recording, and both readings of one recording."""
    click = ("-m", "ground", "click", "300", "200", "--frame", "12", "--format", "json", "--from")
    answers = [json.loads(well(installed(a)(*click, simulated(a)))) for a in ARCHITECTURES]
    assert [a["status"] for a in answers] == ["ok", "ok"]
    first, second = ([a[key] for key in ("lat_deg", "lon_deg", "height_amsl_m")] for a in answers)
    apart_m = float(np.abs(LocalFrame(*first).to_enu(*second)).max())
    record_property("click through the wire, m", f"{apart_m:.1e}")
    assert apart_m < WIRE_M
    again = json.loads(well(installed("arm64")(*click, simulated("amd64"))))
    there = [again[key] for key in ("lat_deg", "lon_deg", "height_amsl_m")]
    assert np.abs(LocalFrame(*first).to_enu(*there)).max() < 2e-4  # nine decimals of a degree are printed: 0.1 mm
    truth = Recording(simulated("arm64"))
    fix = locate(truth.by_frame(truth.vehicles[0], 12), (300.0, 200.0))
    assert fix.lat_deg == pytest.approx(second[0], abs=2e-9)


def test_golden_bytes_and_the_codecs_properties_hold_there(installed: Callable[[str], Installation]) -> None:
    """The contract's own tests, by the emulated Python and its NumPy."""
    tests = ("test_golden", "test_bits", "test_covariance_code", "test_codec")
    done = installed("arm64").beside(
        emulation.testing(), "-m", "pytest", "-p", "no:cacheprovider",
        *(CHECKOUT / "tests" / "contract" / f"{name}.py" for name in tests),
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-1000:]
    assert int(re.search(r"(\d+) passed", done.stdout)[1]) > 60
    assert "skipped" not in done.stdout
