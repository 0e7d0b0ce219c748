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

STUCK_S = 900.0  # without anything new: only of programs that stand still, on however busy a machine
AGAIN_S = 0.2
NOT_THERE_YET = "unknown_frame"
ANSWERED, REFUSED = 0, 3  # exit codes of `pc-ground click`


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

    def __init__(self, flight: Path, recording: Path, speed: float, pictures: int) -> None:
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        self._last = pictures - 1
        config = flight / "config.toml"
        link = f'\n[link]\nlisten = ["{self.endpoint}"]\n\n[recording]\npictures = "jpeg"  # for make demo-web\n'
        config.write_text(config.read_text() + link)
        options = {
            "config": config,
            "frames": flight / "frames",
            "telemetry": flight / "telemetry.tlog",
            "camera": flight / "camera.json",
            "stamps": flight / "stamps.csv",
            "out": recording,
            "speed": f"{speed:g}",
            "linger": f"{10.0 * STUCK_S:g}",
        }
        arguments = ["replay", "--publish", *(part for k, v in options.items() for part in (f"--{k}", str(v)))]
        self.command = shlex.join(["pc-onboard", *arguments])
        self._process = subprocess.Popen(
            [program("pc-onboard"), *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )

    def click(self, u_px: int, v_px: int, frame: int) -> dict[str, Any]:
        """Ask for a picture until it is answered; a refusal counts once the last picture has come.

        Raises InputError if pc-onboard has ended or for STUCK_S nothing new is received.
        """
        received, since_s = "", time.monotonic()
        while True:
            is_whole = bool(received) and _has_come(received) and _has_come(self._ask(0, 0, self._last)[1])
            code, now_received = self._ask(u_px, v_px, frame)
            if code == ANSWERED or (code == REFUSED and is_whole and _has_come(now_received)):
                answer: dict[str, Any] = json.loads(now_received)
                return answer
            news, received = _gist(now_received) != _gist(received), now_received
            if news:
                since_s = time.monotonic()
            elif time.monotonic() - since_s > STUCK_S:
                raise InputError(f"pc-ground click: {received}")
            time.sleep(AGAIN_S)

    def land(self) -> str:
        """Once the last picture has come, end it; returns its summary.

        Raises InputError with what it said if it failed.
        """
        self.click(0, 0, self._last)
        self._process.send_signal(signal.SIGTERM)
        try:
            reported, complaint = self._process.communicate(timeout=STUCK_S)
        except subprocess.TimeoutExpired as late:
            raise InputError(f"pc-onboard did not end within {STUCK_S:g} s of SIGTERM") from late
        if self._process.returncode not in (0, 130):
            raise InputError(f"pc-onboard ended with {self._process.returncode}: {complaint.strip()}")
        return reported.strip()

    def _ask(self, u_px: int, v_px: int, frame: int) -> tuple[int, str]:
        """Return the exit code of one `pc-ground click`, and its answer or its complaint."""
        if self._process.poll() is not None:
            _, complaint = self._process.communicate()
            raise InputError(f"pc-onboard ended with {self._process.returncode}: {complaint.strip()}")
        place = [str(u_px), str(v_px), "--frame", str(frame)]
        done = subprocess.run(
            [program("pc-ground"), "click", *place, "--connect", self.endpoint, "--format", "json"],
            capture_output=True,
            text=True,
            check=False,
        )
        return done.returncode, (done.stdout if done.returncode in (ANSWERED, REFUSED) else done.stderr).strip()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()


def _gist(received: str) -> str:
    """Return the status of an answer, without the figures that differ each time, or a complaint."""
    return str(json.loads(received)["status"]) if received.startswith("{") else received


def _has_come(received: str) -> bool:
    """Return whether an answer is about the picture: not that there is none yet, and not that no one answers."""
    return received.startswith("{") and _gist(received) != NOT_THERE_YET
