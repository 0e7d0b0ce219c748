"""What is installed: the lock, the wheel, and each extra alone, in an environment with nothing else next to it."""

import ast
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import urllib.request
import zipfile
from collections.abc import Callable
from importlib.metadata import packages_distributions
from pathlib import Path

import numpy as np
import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from PIL import Image

from contract.camera import Camera
from contract.feature_set import FeatureSet, Status
from onboard.events.types import Frame
from onboard.storage.mcap_writer import SessionRecorder
from simulation.flight import RecordedSpec
from simulation.session import SessionSpec, fly
from simulation.terrain import TerrainSpec
from tests import postgres
from tests.installed import ROOT, built, declared, extras, laid_over, needed
from tests.left_out import NO_PROGRAM
from tests.locked import lines, versions
from tests.onboard.camera_files.writers import KALIBR
from tests.onboard.link.ports import free_udp_port
from tests.rest_long import rest_long

pytestmark = pytest.mark.xdist_group("install")  # one worker: each environment is built once
SHIPPED = ("contract", "ground", "onboard")
AIRCRAFT_ONLY = ("cv2", "scipy", "mavsdk", "pymavlink", "serial", "mcap", "pydantic", "PIL", "tqdm")
CAPTURE_NS = 1_700_000_000_000_000_000
HEIGHT_M = 120.0


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of what an installation is made of: setuptools leaves its build folder next to it."""
    ignored = shutil.ignore_patterns(".*", "out", "build", "*.egg-info", "tests", "docs", "frontend", "__pycache__")
    return Path(shutil.copytree(ROOT, tmp_path_factory.mktemp("source") / "pointclick", ignore=ignored))


@pytest.fixture(scope="module")
def wheel(source: Path) -> Path:
    """The wheel, built as `make` builds: with the setuptools of this environment."""
    out = source.parent / "wheels"
    built(sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", out, source)
    (path,) = out.glob("pointclick-*.whl")
    return path


@pytest.fixture(scope="module")
def environment(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of programs of the ground's environment: the wheel, its dependencies by pip, and nothing else."""
    folder = tmp_path_factory.mktemp("base") / "venv"
    listed = folder.parent / "requirements.txt"
    listed.write_text(lines(needed(declared())))
    built(sys.executable, "-m", "venv", "--without-pip", folder)
    built(
        sys.executable, "-m", "pip", "--python", folder / "bin" / "python", "install", "--no-compile",
        "--disable-pip-version-check", "--quiet", "--require-hashes", "--requirement", listed,
    )  # fmt: skip
    built(
        sys.executable, "-m", "pip", "--python", folder / "bin" / "python", "install", "--no-compile", "--no-deps",
        "--disable-pip-version-check", "--quiet", "--no-index", wheel,
    )  # fmt: skip
    return folder / "bin"


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return level_session(tmp_path_factory.mktemp("session") / "session.mcap")


def level_session(path: Path) -> Path:
    """A recording of one picture: a camera that looks straight down at level ground, on a lattice of features."""
    camera = Camera.from_field_of_view(640, 480, 40.0)
    uv = [(float(u), float(v)) for u in range(40, 640, 80) for v in range(40, 480, 80)]
    level = FeatureSet(
        "uav", 1, 0, CAPTURE_NS, Status.OK, camera,
        camera_lat_deg=-43.38, camera_lon_deg=172.4, camera_height_m=HEIGHT_M,
        R_enu_cam=np.diag([1.0, -1.0, -1.0]), common_cov=1e-4 * np.eye(9),
        plane_per_m=np.array([1.0 / HEIGHT_M, 0.0, 0.0]), plane_sigma_relative=1e-3, roughness=1e-5,
        uv_px=np.array(uv), inverse_depth_per_m=np.full(len(uv), 1.0 / HEIGHT_M),
        sigma_inverse_depth_per_m=np.full(len(uv), 1e-6),
    )  # fmt: skip
    with SessionRecorder(path, "uav") as out:
        out.write_event(Frame(CAPTURE_NS, 0, None, "picture.png"))
        out.write_set(level)
    return path


def run(environment: Path, program: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    """A program of the new environment, from a folder without our sources."""
    clean = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    return subprocess.run(
        [environment / program, *map(str, arguments)],
        cwd=environment, env=clean, capture_output=True, text=True, check=False, timeout=60,
    )  # fmt: skip


def test_the_lock_holds_every_dependency_at_a_version_that_will_do() -> None:
    locked = versions()
    for requirement in map(Requirement, declared(*extras())):
        assert requirement.specifier.contains(locked[canonicalize_name(requirement.name)]), requirement


def test_none_of_the_aircrafts_packages_is_there(environment: Path) -> None:
    probe = "import importlib.util as u, sys; print([n for n in sys.argv[1:] if u.find_spec(n)])"
    assert run(environment, "python", "-c", probe, *AIRCRAFT_ONLY).stdout.strip() == "[]"
    present = run(environment, "python", "-c", probe, "numpy", "zenoh", "contract", "ground").stdout
    assert present.strip() == "['numpy', 'zenoh', 'contract', 'ground']"


def test_a_recording_can_be_clicked(environment: Path, session: Path) -> None:
    done = run(environment, "pc-ground", "click", 319.5, 239.5, "--frame", 0, "--from", session, "--format", "json")
    assert (done.returncode, done.stderr) == (0, "")
    answer = json.loads(done.stdout)
    assert answer["lat_deg"] == pytest.approx(-43.38, abs=1e-7)
    assert answer["lon_deg"] == pytest.approx(172.4, abs=1e-7)
    assert answer["height_amsl_m"] == pytest.approx(0.0, abs=0.01)


CLICK_IN_EACH = """
import sys
from ground.__main__ import main
for form in ("text", "geojson", "kml", "gpx", "csv", "cot", "dms", "dm"):
    print(f"as {form}:")
    assert main([*sys.argv[1:], "--format", form]) == 0, form
"""


def test_the_base_writes_every_format_but_projections(environment: Path, session: Path) -> None:
    words = ["click", 319.5, 239.5, "--frame", 0, "--from", session, "--local=-43.4,172.4"]
    written = re.split(r"^as \w+:\n", run_well(environment, "python", "-c", CLICK_IN_EACH, *words), flags=re.MULTILINE)
    assert len(written) == 9 and all(written[1:]) and len(set(written)) == 9


@pytest.mark.parametrize(
    ("arguments", "extra"),
    [
        (["click", "1", "2", "--format", "mgrs"], "geo"), (["click", "1", "2", "--crs", "EPSG:2193"], "geo"),
        (["click", "1", "2", "--format", "utm"], "geo"), (["completion", "bash"], "completion"),
        (["record", "--out", "x", "--seconds", "1", "--connect", "tcp/127.0.0.1:9"], "record"),
        (["watch", "--connect", "mavlink:udpin:127.0.0.1:14551"], "mavlink"),
    ],
)  # fmt: skip
def test_what_needs_an_extra_says_which(
    environment: Path, session: Path, arguments: list[str], extra: str, tmp_path: Path
) -> None:
    source = ["--from", str(session), "--frame", "0"] if arguments[0] == "click" else []
    done = run(environment, "pc-ground", *arguments, *source)
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1
    assert f"with its extra [{extra}]" in done.stderr


def test_a_link_without_an_aircraft_is_one_clear_line(environment: Path) -> None:
    done = run(environment, "pc-ground", "click", 1, 2, "--connect", "tcp/127.0.0.1:9")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("pc-ground: error: ")
    assert done.stderr.count("\n") == 1


def test_the_aircrafts_command_says_what_it_needs(environment: Path) -> None:
    done = run(environment, "pc-onboard", "replay", "--frames", ".", "--telemetry", "x.tlog", "--camera", "c.json")
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert "with its extra [onboard]" in done.stderr


def run_well(environment: Path, program: str, *arguments: object) -> str:
    """What a program prints that ends well and complains of nothing."""
    done = run(environment, program, *arguments)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


HELP_OF_EACH = """
import importlib, sys
main = importlib.import_module(sys.argv[1] + ".__main__").main
for command in sys.argv[2:]:
    try:
        main([command, "--help"])
    except SystemExit as ended:
        assert ended.code == 0, command
"""


def every_command_has_its_help(environment: Path, program: str) -> None:
    """Of the commands that a program's own help lists; one process for all, what is not installed none of them has."""
    found = re.findall(r"^    ([a-z][\w-]*)", run_well(environment, program, "--help"), re.MULTILINE)
    assert found
    printed = run_well(environment, "python", "-c", HELP_OF_EACH, program.removeprefix("pc-"), *found)
    for command in found:
        assert f"usage: {program} {command}" in printed


def fly_and_click(environment: Path, folder: Path) -> None:
    """A short flight through the installed `pc-onboard`, and a click on what it recorded."""
    # The same level ground and mount as elsewhere in the tests, for three seconds.
    spec = SessionSpec(
        RecordedSpec("plane_turn", 3.0, whole_log=False), seconds=3.0, rate_hz=5.0, mount_deg=(0.0, -90.0, -90.0),
        terrain=TerrainSpec(relief_m=10.0), camera=Camera.from_field_of_view(320, 240, 40.0),
    )  # fmt: skip
    flight, recording = folder / "flight", folder / "session.mcap"
    fly(spec, flight)
    files = {"frames": "frames", "telemetry": "telemetry.tlog", "camera": "camera.json", "stamps": "stamps.csv"}
    arguments = [part for key, name in files.items() for part in (f"--{key}", flight / name)]
    summary = run_well(
        environment, "pc-onboard", "replay", *arguments, "--config", flight / "config.toml", "--out", recording
    )
    assert re.search(r"^solved +15$", summary, re.MULTILINE)
    click = run_well(
        environment, "pc-ground", "click", 160, 120, "--frame", 12, "--from", recording, "--format", "json"
    )
    assert json.loads(click)["status"] == "ok"


def use_onboard(environment: Path, folder: Path) -> None:
    """What people do with the aircraft's installation, each command that needs a package of its own."""
    every_command_has_its_help(environment, "pc-onboard")
    keys = folder / "keys"
    run_well(environment, "pc-onboard", "make-credentials", keys, "--vehicle", "uav1", "--address", "10.0.0.7")
    assert "BEGIN CERTIFICATE" in (keys / "uav1" / "certificate.pem").read_text()
    run_well(environment, "pc-onboard", "calibrate", "--print-board", folder / "board.pdf")
    assert (folder / "board.pdf").read_bytes().startswith(b"%PDF")
    (folder / "camchain.yaml").write_text(KALIBR)
    assert "fx 3100.00" in run_well(environment, "pc-onboard", "camera", folder / "camchain.yaml")
    (folder / "config.toml").write_text("[mount]\npitch_deg = -45.0\n")
    assert "good" in run_well(environment, "pc-onboard", "check-config", "--config", folder / "config.toml")
    for url in ("udpin:127.0.0.1:14999", "nmea:/dev/ttyUSB0:9600", "mavsdk:udpin://127.0.0.1:14998"):
        (folder / "config.toml").write_text(f'[telemetry]\nurl = "{url}"\n')
        run_well(environment, "pc-onboard", "check-config", "--config", folder / "config.toml")
    fly_and_click(environment, folder)


def use_terrain(environment: Path, folder: Path) -> None:
    """An elevation model is read with nothing but the base and rasterio."""
    heights = np.full((1201, 1201), 77, ">i2")
    (folder / "S44E172.hgt").write_bytes(heights.tobytes())
    program = f"""
import numpy as np
from contract.geodesy import LocalFrame
from onboard.storage.elevation_files import TerrainFiles
terrain = TerrainFiles({str(folder)!r}).around(LocalFrame(-43.5, 172.5, 0.0), np.zeros(3), 300.0, 30.0, 0.0)
print(round(float(terrain.height_and_slope(np.zeros((1, 2)))[0][0]), 3))
"""
    assert run_well(environment, "python", "-c", program) == "77.0\n"


def clicks(environment: Path, session: Path, *arguments: object) -> str:
    """The centre of the one picture, through the installed `pc-ground`."""
    return run_well(environment, "pc-ground", "click", 319.5, 239.5, "--frame", 0, "--from", session, *arguments)


def use_geo(environment: Path, folder: Path) -> None:
    """Squares of MGRS, UTM, and any EPSG system."""
    session = level_session(folder / "session.mcap")
    assert clicks(environment, session, "--format", "mgrs").startswith("59GPM13406960")
    assert clicks(environment, session, "--format", "utm").startswith("59G 613406.")
    crs = json.loads(clicks(environment, session, "--format", "json", "--crs", "EPSG:2193"))["crs"]
    assert (crs["x"], crs["y"]) == pytest.approx((1551397.4, 5196810.7), abs=1.0)


def use_geotiff(environment: Path, folder: Path) -> None:
    """What was seen, as a raster; with the base alone as polygons."""
    files = folder / "seen.tif", folder / "seen.geojson"
    output = run_well(
        environment, "pc-ground", "seen", "--from", level_session(folder / "session.mcap"),
        *(word for file in files for word in ("--out", file)),
    )  # fmt: skip
    assert output.startswith("seen: ") and "in 1 picture of uav" in output
    assert files[0].read_bytes()[:2] in (b"II", b"MM")
    assert json.loads(files[1].read_text())["type"] == "FeatureCollection"


def use_record(environment: Path, folder: Path) -> None:
    """What the link delivers is kept; without an aircraft nothing, and it says so."""
    output = run_well(
        environment, "pc-ground", "record", "--out", folder / "kept", "--seconds", 0.3, "--connect", "tcp/127.0.0.1:9"
    )
    assert "nothing received yet" in output
    program = f"""
from pathlib import Path
from contract.wire.codec import encode
from ground.link_recorder import LinkRecorder
from ground.recording import Recording
source = Recording({str(level_session(folder / "session.mcap"))!r})
with LinkRecorder(Path({str(folder / "kept")!r})) as out:
    out.take("pc/uav/features", encode(source.by_frame("uav", 0)))
"""
    run_well(environment, "python", "-c", program)
    assert json.loads(clicks(environment, folder / "kept", "--format", "json"))["status"] == "ok"


def use_plot(environment: Path, folder: Path) -> None:
    """A picture of errors."""
    marks = folder / "marks.csv"
    marks.write_text("frame,u,v,lat_deg,lon_deg\n0,319.5,239.5,-43.38,172.4\n0,330,240,-43.38,172.4\n")
    run_well(
        environment, "pc-ground", "accuracy", "--truth", marks, "--from", level_session(folder / "session.mcap"),
        "--plot", folder / "p.png",
    )  # fmt: skip
    assert (folder / "p.png").read_bytes().startswith(b"\x89PNG")


def use_completion(environment: Path, folder: Path) -> None:
    """For each shell."""
    for shell in ("bash", "zsh", "fish"):
        assert "measure" in run_well(environment, "pc-ground", "completion", shell)


def use_web(environment: Path, folder: Path) -> None:
    """The page out of the wheel, and a click through it."""
    clean = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    program = subprocess.Popen(
        [environment / "pc-ground", "web", "--port", "0", "--from", level_session(folder / "session.mcap"),
         "--pins", folder / "pins.sqlite"],
        cwd=environment, env={**clean, "PYTHONUNBUFFERED": "1"}, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        assert program.stdout is not None
        url = next(line.split()[1] for line in program.stdout if line.startswith("open "))
        with urllib.request.urlopen(url, timeout=30) as page:
            assert b'data-testid="picture"' in page.read()
        body = json.dumps({"vehicle": "uav", "frame": 0, "u": 319.5, "v": 239.5}).encode()
        asked = urllib.request.Request(f"{url}api/click", body, {"content-type": "application/json"})
        with urllib.request.urlopen(asked, timeout=30) as answer:
            assert json.loads(answer.read())["lat_deg"] == pytest.approx(-43.38, abs=1e-7)
    finally:
        program.terminate()
        program.wait(60)


def use_video(environment: Path, folder: Path) -> None:
    """A video is read; the page is another extra's."""
    program = ROOT / "tests" / "web" / "read_a_video.py"
    assert run_well(environment, "python", program, folder / "v.avi") == "(64, 48)\n"
    assert "with its extra [web]" in run(environment, "pc-ground", "web", "--video", folder / "v.avi").stderr


def use_open(programs: Path, folder: Path) -> None:
    """Both programs and what they need are there: the second reads the photographs, and says what they lack."""
    (folder / "photos").mkdir()
    for second in range(3):
        Image.new("RGB", (64, 48)).save(folder / "photos" / f"20260612T10152{second}.5Z.jpg")
    done = subprocess.run(
        [programs / "pc-ground", "open", folder / "photos", "--no-browser"],
        capture_output=True, text=True, check=False,
        env={"PATH": "/usr/bin:/bin", "XDG_DATA_HOME": str(folder / "data")},
    )  # fmt: skip
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
    assert "no log next to them" in done.stderr


def use_mavlink(programs: Path, folder: Path) -> None:
    """A click asked of no one: the library is there, and what is wrong is said."""
    radio = f"mavlink:udpin:127.0.0.1:{free_udp_port()}"
    done = run(programs, "pc-ground", "click", 1, 2, "--connect", radio)
    assert (done.returncode, done.stdout) == (2, "") and "no autopilot was received" in done.stderr, done.stderr


def use_live(programs: Path, folder: Path) -> None:
    """Daemon and page on one machine, with a camera that needs nothing but the system's Python."""
    camera = folder / "camera.json"
    camera.write_text(Camera.from_field_of_view(64, 48, 60.0).to_json())
    own = f"exec:/usr/bin/python3 -I {ROOT / 'examples' / 'own_camera.py'}"
    radio = f"udpin:127.0.0.1:{free_udp_port()}"
    words = ["live", "--camera", own, "--telemetry", radio, "--camera-file", camera]
    with subprocess.Popen(
        [programs / "pc-ground", *words, "--no-browser", "--port", "0"],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        env={"PATH": "/usr/bin:/bin", "XDG_DATA_HOME": str(folder / "data"), "PYTHONUNBUFFERED": "1"},
    ) as program:  # fmt: skip
        assert program.stdout is not None
        output = ""
        try:
            for line in program.stdout:
                output += line
                if "Ctrl-C" in line:
                    break
            program.send_signal(signal.SIGINT)
            assert program.wait(60) == 130, output
        finally:
            program.kill()
    assert "pc-onboard runs" in output


def use_postgresql(environment: Path, folder: Path) -> None:
    """Pins in a real server."""
    if postgres.programs() is None:
        pytest.skip(f"{NO_PROGRAM} postgres; sudo apt-get install {postgres.PACKAGES}")
    with postgres.running() as server:
        at = ["--store", server.database()]
        run_well(environment, "pc-ground", "pins", "add", "--at=-35.0,149.0", "--name", "tent", *at)
        assert "tent" in run_well(environment, "pc-ground", "pins", "list", *at)


USES: dict[str, Callable[[Path, Path], None]] = {
    "onboard": use_onboard,
    "terrain": use_terrain,
    "geo": use_geo,
    "geotiff": use_geotiff,
    "postgresql": use_postgresql,
    "record": use_record,
    "mavlink": use_mavlink,
    "plot": use_plot,
    "completion": use_completion,
    "web": use_web,
    "video": use_video,
    "open": use_open,
    "live": use_live,
}
"""What each extra, installed alone, is used for. A new extra gets an entry here."""


def test_every_extra_for_users_is_tried() -> None:
    assert set(USES) == extras() - {"dev"}


# What an operator installs; the others are of `make test-long`, and of a submission that changes what is installed.
@pytest.mark.parametrize("extra", rest_long(["open", *sorted(set(USES) - {"open"})]))
def test_an_extra_installed_alone_does_its_work(extra: str, environment: Path, tmp_path: Path) -> None:
    USES[extra](laid_over(environment, extra, tmp_path / "venv"), tmp_path)


def test_every_command_of_the_ground_has_its_help_with_the_base_alone(environment: Path) -> None:
    every_command_has_its_help(environment, "pc-ground")


def test_the_wheel_holds_what_ships_and_nothing_else(source: Path, wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    ours = {name for name in names if ".dist-info/" not in name}
    shipped = {
        str(file.relative_to(source)) for top in SHIPPED for file in (source / top).rglob("*")
        if file.is_file() and "__pycache__" not in file.parts
    }  # fmt: skip
    assert ours == shipped
    (entries,) = (name for name in names if name.endswith("entry_points.txt"))
    scripts = re.findall(r"^([\w-]+) = ", zipfile.ZipFile(wheel).read(entries).decode(), re.MULTILINE)
    assert sorted(scripts) == ["pc-ground", "pc-onboard"]


@pytest.mark.long  # short: what the wheel holds, above
def test_the_source_archive_makes_the_same_wheel(source: Path, wheel: Path) -> None:
    out = source.parent / "sdist"
    out.mkdir()
    make = f"import setuptools.build_meta as b; b.build_sdist({str(out)!r})"
    done = subprocess.run(
        [sys.executable, "-c", make], cwd=source, capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode == 0, done.stderr
    (archive,) = out.glob("pointclick-*.tar.gz")
    built(sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", out, archive)
    (again,) = out.glob("pointclick-*.whl")
    assert sorted(zipfile.ZipFile(again).namelist()) == sorted(zipfile.ZipFile(wheel).namelist())


def imported_packages(top: str) -> dict[str, Path]:
    """Top-level modules that the files below a folder import anywhere, with one file that does."""
    found: dict[str, Path] = {}
    for file in sorted((ROOT / top).rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            found |= {name.split(".")[0]: file for name in names}
    return found


@pytest.mark.parametrize("top", SHIPPED)
def test_every_package_that_is_imported_is_declared(top: str) -> None:
    """`cryptography` was there while developing, as a dependency of something else, and missing when installed.

    What may be imported where, and at module level, is `test_architecture`'s to say.
    """
    may = {canonicalize_name(Requirement(line).name) for line in declared(*(extras() - {"dev"}))}
    owners = packages_distributions()
    # GStreamer's bindings are Debian's: what loads them runs under the system's Python.
    known = {*SHIPPED, *sys.stdlib_module_names, "gi"}
    others = {name: file for name, file in imported_packages(top).items() if name not in known}
    undeclared = {
        name: str(file) for name, file in others.items()
        if not may & {canonicalize_name(owner) for owner in owners.get(name, [])}
    }  # fmt: skip
    assert not undeclared
