"""A short flight with pictures, servers on it, and a real Chromium. Without Chromium its tests are left out, loudly."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from contract.feature_set import FeatureSet, Status
from ground.recording import Recording
from ground.web.command import STATIC
from onboard.storage.mcap_writer import SessionRecorder
from simulation.flight import DescribedSpec
from simulation.ordinary import ordinary
from simulation.paths import PathSpec
from simulation.session import SessionSpec, fly
from simulation.terrain import TerrainSpec

ROOT = Path(__file__).resolve().parents[2]
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
NO_PROGRAM = "left out: no program"  # as in tests/conftest.py, which says so at the end of a run
# Chromium in a machine without a screen or a graphics card, that calls nobody.
ARGUMENTS = [
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
]  # fmt: skip


class Flown:
    """A recorded session with pictures, and what a test needs to know of it."""

    def __init__(self, path: Path, refused: int) -> None:
        self.path = path
        self.refused = refused  # the frame that answers nothing
        self.recording = Recording(path)
        (self.vehicle,) = self.recording.vehicles
        self.frames = self.recording.frames(self.vehicle)

    @property
    def newest(self) -> int:
        """The last frame that answers."""
        found = self.recording.newest(self.vehicle)
        assert found is not None
        return found.frame


@pytest.fixture(scope="session")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Flown:
    """Six seconds over simulated ground, 24 pictures; and one more picture that refuses."""
    folder = tmp_path_factory.mktemp("flown")
    flight = folder / "flight"
    spec = SessionSpec(
        DescribedSpec(PathSpec("turns", leg_m=150.0), ordinary(3), seed=3),
        seconds=6.0,
        rate_hz=4.0,
        mount_deg=(0.0, -90.0, -90.0),
        terrain=TerrainSpec(relief_m=20.0, wavelength_m=250.0),
        level_ground=True,
    )
    fly(spec, flight)
    config = flight / "config.toml"
    config.write_text(config.read_text() + '\n[recording]\npictures = "jpeg"\n')
    first = folder / "parts" / "flight.001.mcap"
    first.parent.mkdir()
    done = subprocess.run(
        [sys.executable, "-m", "onboard", "replay", "--config", config, "--frames", flight / "frames",
         "--telemetry", flight / "telemetry.tlog", "--camera", flight / "camera.json",
         "--stamps", flight / "stamps.csv", "--record", first],
        capture_output=True, text=True, check=False, cwd=ROOT, timeout=120,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    recording = Recording(first)
    (vehicle,) = recording.vehicles
    last = recording.newest_picture(vehicle)
    assert last is not None
    refused = FeatureSet(
        vehicle, last.session, last.frame + 1, last.capture_unix_ns + 250_000_000, Status.TURNING, last.camera
    )
    with SessionRecorder(folder / "parts" / "flight.002.mcap", vehicle, part=2) as out:
        out.write_set(refused)
    return Flown(first, refused.frame)


class Server:
    """`pc-ground web` as its user starts it."""

    def __init__(self, *arguments: object, port: int = 0) -> None:
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": "1"}
        self.process = subprocess.Popen(
            [sys.executable, "-m", "ground", "web", "--port", str(port), *map(str, arguments)],
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment, cwd=ROOT,
        )  # fmt: skip
        self.said = ""
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.said += line
            if found := re.match(r"open (\S+)", line):
                self.url = found[1]
            if "Ctrl-C" in line:
                break
        else:
            raise AssertionError(f"the server did not start: {self.said}")
        # Whatever it says later is read, or it would wait for a reader.
        threading.Thread(target=self.process.stdout.read, daemon=True).start()
        found = re.search(r":(\d+)/", self.url)
        assert found is not None
        self.port = int(found[1])

    def kill(self) -> None:
        """As a power cut ends it."""
        self.process.kill()
        self.process.wait(10)

    def close(self) -> None:
        """As its user ends it."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
            try:
                self.process.wait(10)
            except subprocess.TimeoutExpired:
                self.kill()


@pytest.fixture
def serve(flown: Flown, tmp_path: Path) -> Iterator[Callable[..., Server]]:
    """Starts servers on the flight; pins go into the test's own folder."""
    if not (STATIC / "index.html").is_file():
        pytest.fail("the page was not built: make web")
    running: list[Server] = []

    def start(*arguments: object, port: int = 0, pins: str = "pins.sqlite") -> Server:
        server = Server("--from", flown.path, "--pins", tmp_path / pins, *arguments, port=port)
        running.append(server)
        return server

    yield start
    for server in running:
        server.close()


@pytest.fixture(scope="session")
def chromium() -> Iterator[Any]:
    """One real browser for all tests."""
    if CHROMIUM is None:
        pytest.skip(f"{NO_PROGRAM} chromium; sudo apt-get install chromium")
    from playwright.sync_api import sync_playwright  # noqa: PLC0415

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        yield browser
        browser.close()
