"""The two programs as their users run them: `pc-onboard` in one process, `pc-ground` in another, zenoh between."""

from __future__ import annotations

import json
import shlex
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from contract.errors import InputError

PATIENCE_S = 60.0  # for an answer: the picture may still have to come, on whatever machine
LANDING_S = 60.0


def program(name: str) -> str:
    """A console script of this environment; raises InputError if the package is not installed in it."""
    path = Path(sys.executable).parent / name
    if not path.is_file():
        raise InputError(f"{path} is not there: install the package into this environment (make venv)")
    return str(path)


def free_port() -> int:
    """A TCP port of this machine that no one listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class Aircraft:
    """`pc-onboard replay --publish` over a folder that `simulation.session.fly` has written."""

    def __init__(self, flight: Path, recording: Path, speed: float) -> None:
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        config = flight / "config.toml"
        link = f'\n[link]\nlisten = ["{self.endpoint}"]\n\n[recording]\npictures = "jpeg"  # for make demo-web\n'
        config.write_text(config.read_text() + link)
        options = {
            "config": config,
            "frames": flight / "frames",
            "telemetry": flight / "telemetry.tlog",
            "camera": flight / "camera.json",
            "stamps": flight / "stamps.csv",
            "record": recording,
            "speed": f"{speed:g}",
            "linger": "600",
        }
        arguments = ["replay", "--publish", *(part for k, v in options.items() for part in (f"--{k}", str(v)))]
        self.command = shlex.join(["pc-onboard", *arguments])
        self._process = subprocess.Popen(
            [program("pc-onboard"), *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )

    def land(self, last_frame: int) -> str:
        """Once the last picture has come, end it; returns its summary.

        Raises InputError with what it said if it failed.
        """
        click(0, 0, last_frame, self.endpoint)
        self._process.send_signal(signal.SIGTERM)
        try:
            reported, complaint = self._process.communicate(timeout=LANDING_S)
        except subprocess.TimeoutExpired as late:
            raise InputError(f"pc-onboard did not end within {LANDING_S:g} s of SIGTERM") from late
        if self._process.returncode not in (0, 130):
            raise InputError(f"pc-onboard ended with {self._process.returncode}: {complaint.strip()}")
        return reported.strip()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()


def click(u_px: int, v_px: int, frame: int, endpoint: str) -> dict[str, Any]:
    """Ask until the picture has come and placed; the last refusal if it never is.

    Raises InputError if no one answers at all.
    """
    arguments = ["click", str(u_px), str(v_px), "--frame", str(frame), "--connect", endpoint, "--format", "json"]
    deadline = time.monotonic() + PATIENCE_S
    while True:
        done = subprocess.run([program("pc-ground"), *arguments], capture_output=True, text=True, check=False)
        is_late = time.monotonic() > deadline
        if done.returncode == 0 or (done.returncode == 3 and is_late):
            answer: dict[str, Any] = json.loads(done.stdout)
            return answer
        if is_late:
            raise InputError(f"pc-ground click: {done.stderr.strip()}")
        time.sleep(0.2)
