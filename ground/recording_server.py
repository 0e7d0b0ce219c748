"""Clicked pixels of a recording, measured in its pictures: by `pc-onboard serve`, which is asked as an aircraft is."""

from __future__ import annotations

import signal
import subprocess
import threading
from pathlib import Path
from typing import Any

from contract.closing import Closing
from contract.errors import LinkError
from contract.feature_set import FeatureSet
from contract.tied_process import tied
from ground.client import ask_measured, open_link
from ground.dropped_messages import DroppedMessages
from ground.onboard_program import pc_onboard, unused_port
from ground.unmeasured import NOT_TRIED

START_S = 30.0  # until a long recording has been looked through
END_S = 5.0


class RecordingServer(Closing):
    """`pc-onboard serve` of one recording, for this process and as long as it lives. Thread-safe; a context manager.

    To be made in a thread that lives as long: the program ends with it. Raises InputError where it is not installed.
    """

    def __init__(self, recording: Path) -> None:
        self._endpoint = f"tcp/127.0.0.1:{unused_port()}"
        command = tied([pc_onboard(), "serve", str(recording), "--listen", self._endpoint], signal.SIGTERM)
        self._process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        self._lock = threading.Lock()
        self._session: Any = None
        self._begun = threading.Event()  # it answers, or has ended
        self._last_line = ""
        self._dropped = DroppedMessages()
        threading.Thread(target=self._read, daemon=True, name="pc-onboard serve").start()

    def measured(self, feature_set: FeatureSet, uv_px: tuple[float, float]) -> FeatureSet:
        """The set with what became of the pixel; waits until the program has begun. Raises LinkError, WireError."""
        if not self._begun.wait(START_S):
            raise LinkError("the recording is still being looked through: click again")
        found = ask_measured(self._link(), feature_set.vehicle, feature_set.frame, uv_px, self._dropped)
        if found is None or found.session != feature_set.session or found.clicked is None:
            raise LinkError(NOT_TRIED)
        return found

    def close(self) -> None:
        """End the program."""
        with self._lock:
            session, self._session = self._session, None
        if session is not None:
            session.close()
        self._process.terminate()
        try:
            self._process.wait(END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _link(self) -> Any:
        with self._lock:
            if self._process.poll() is not None:
                raise LinkError(f"pc-onboard serve has ended: {self._last_line or self._process.returncode}")
            if self._session is None:
                self._session = open_link("client", self._endpoint, None)
            return self._session

    def _read(self) -> None:
        """Its first line is printed when it answers, its last states why it has ended."""
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self._last_line = line.strip()
            if self._endpoint in line:
                self._begun.set()
        self._process.wait()
        self._begun.set()
