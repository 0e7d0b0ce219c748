"""A short flight with pictures, and servers on it as their user starts them."""

import os
import re
import shutil
import signal
import subprocess
import sys
import threading
from pathlib import Path

from contract.camera import Camera
from contract.feature_set import FeatureSet, Status
from ground.recording import Recording
from onboard.storage.mcap_writer import SessionRecorder
from simulation.flight import DescribedSpec
from simulation.ordinary import ordinary
from simulation.paths import PathSpec
from simulation.session import SessionSpec
from simulation.terrain import TerrainSpec
from tests.flights_folder import kept
from tests.scenarios.flights import simulated
from tests.waiting import PATIENCE_S

ROOT = Path(__file__).resolve().parents[2]
# Without the window of a browser around it, Chromium opens a page for half of the processor time.
CHROMIUM = next(filter(None, map(shutil.which, ("chromium-headless-shell", "chromium", "chromium-browser"))), None)
# Chromium in a machine without a screen or a graphics card, that calls no one.
ARGUMENTS = [
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
]  # fmt: skip


# Turns of a pilot's own flight: sampled once for `pc-ground open` and `pc-ground live`.
TURNS = SessionSpec(
    DescribedSpec(PathSpec("turns", leg_m=120.0), ordinary(3), seed=3),
    seconds=18.0,
    rate_hz=3.0,
    camera=Camera.from_field_of_view(480, 360, 40.0),
    terrain=TerrainSpec(relief_m=20.0, wavelength_m=250.0),
)


class Simulated:
    """A recorded session with pictures, and what a test needs to know of it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.recording = Recording(path)
        (self.vehicle,) = self.recording.vehicles
        self.frames = self.recording.frames(self.vehicle)
        self.refused = self.frames[-1]  # answers nothing

    @property
    def newest(self) -> int:
        found = self.recording.newest(self.vehicle)
        assert found is not None
        return found.frame


def recorded() -> Simulated:
    """The session that all tests of the page share, whichever worker needs it first."""
    return Simulated(kept("recorded for the page", record) / "parts" / "flight.001.mcap")


def record(folder: Path) -> None:
    """Some seconds over simulated ground, four pictures a second, into a folder; and one more picture that refuses."""
    spec = SessionSpec(
        DescribedSpec(PathSpec("turns", leg_m=150.0), ordinary(3), seed=3),
        seconds=4.5,
        rate_hz=4.0,
        mount_deg=(0.0, -90.0, -90.0),
        terrain=TerrainSpec(relief_m=20.0, wavelength_m=250.0),
        level_ground=True,
    )
    first = folder / "parts" / "flight.001.mcap"
    first.parent.mkdir(parents=True)
    replay(simulated(spec), first)
    recording = Recording(first)
    (vehicle,) = recording.vehicles
    last = recording.newest_picture(vehicle)
    assert last is not None
    refused = FeatureSet(
        vehicle, last.session, last.frame + 1, last.capture_unix_ns + 250_000_000, Status.TURNING, last.camera
    )
    with SessionRecorder(folder / "parts" / "flight.002.mcap", vehicle, part=2) as out:
        out.write_set(refused)


def replay(flight: Path, out: Path, *words: object) -> None:
    """Replay a simulated session into a recording that keeps its pictures; `words`: what else the command is told."""
    config = out.with_suffix(".toml")
    config.write_text((flight / "config.toml").read_text() + '\n[recording]\npictures = "jpeg"\n')
    onboard(
        "replay", "--config", config, "--frames", flight / "frames", "--telemetry", flight / "telemetry.tlog",
        "--camera", flight / "camera.json", "--stamps", flight / "stamps.csv", "--out", out, *words,
    )  # fmt: skip


def onboard(*words: object) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "onboard", *map(str, words)],
        capture_output=True, text=True, check=False, cwd=ROOT, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr


class PageProgram:
    """A command of `pc-ground` that serves the page, as its user starts it, until the page is there or it ends."""

    ends_within_s = PATIENCE_S  # of a signal, or of its last line

    def __init__(self, *words: object, home: Path | None = None) -> None:
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": "1"}
        if home is not None:
            environment["XDG_DATA_HOME"] = str(home)
        self.process = subprocess.Popen(
            [sys.executable, "-m", "ground", *map(str, words)],
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment, cwd=ROOT,
        )  # fmt: skip
        self.printed, self.url = "", ""
        self.is_served = False  # whether the page was there
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.printed += line
            if found := re.match(r"open (http\S+)", line):
                self.url = found[1]
            if "Ctrl-C" in line:
                self.is_served = True
                # Whatever it says later is read, or it would wait for a reader.
                self.reader = threading.Thread(target=self._read, daemon=True)
                self.reader.start()
                return
        self.process.wait(self.ends_within_s)

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.printed += line

    @property
    def local(self) -> str:
        return self.url

    def end(self, number: signal.Signals = signal.SIGINT) -> int:
        self.process.send_signal(number)
        return self.process.wait(self.ends_within_s)


class Server:
    """`pc-ground web` as its user starts it."""

    def __init__(self, *arguments: object, port: int = 0) -> None:
        self.arguments = arguments
        self.start(port)

    def start(self, port: int = 0) -> None:
        program = PageProgram("web", "--port", port, *self.arguments)
        if not program.is_served:
            raise AssertionError(f"the server did not start: {program.printed}")
        self.process, self.printed, self.url = program.process, program.printed, program.url
        found = re.search(r":(\d+)/", self.url)
        assert found is not None
        self.port = int(found[1])

    @property
    def local(self) -> str:
        return f"http://127.0.0.1:{self.port}/"

    def kill(self) -> None:
        self.process.kill()
        self.process.wait(PATIENCE_S)

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
            try:
                self.process.wait(PATIENCE_S)
            except subprocess.TimeoutExpired:
                self.kill()
