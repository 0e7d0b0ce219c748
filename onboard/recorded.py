"""The recording as the daemon's sink: a file a session, and a full disk is a fault to report, not to die of."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Self

from contract.camera import Camera
from contract.errors import InputError
from contract.feature_set import FeatureSet
from onboard.config import Config
from onboard.events import Event
from onboard.recording import SessionRecorder
from onboard.session_clock import SessionClock

RETRY_NS = 10_000_000_000

log = logging.getLogger("pointclick")


class Recorded:
    """Writes `FOLDER/YYYYmmddTHHMMSSZ-VEHICLE.mcap`; after a fault a new file is begun once there is room again."""

    def __init__(self, folder: Path, config: Config, camera: Camera, clock: SessionClock, config_text: str) -> None:
        self._folder, self._vehicle, self._clock = folder, config.vehicle.id, clock
        self._config_text, self._camera_json = config_text, camera.to_json()
        self._recorder: SessionRecorder | None = None
        self._failed_ns: int | None = None
        self._fault = ""

    @property
    def fault(self) -> str:
        """Why nothing is recorded; empty while all is well."""
        return self._fault

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._recorder is not None:
            self._recorder.close()

    def event(self, arrival_ns: int, event: Event) -> None:
        """Record an event as it enters the pipeline."""
        self._write(lambda recorder: recorder.write_event(event))

    def feature_set(self, output: FeatureSet) -> None:
        """Record a set."""
        self._write(lambda recorder: recorder.write_set(output))

    def _write(self, what: Callable[[SessionRecorder], None]) -> None:
        recorder = self._ready()
        if recorder is None:
            return
        try:
            what(recorder)
        except InputError as error:
            self._give_up(error)
        else:
            if self._fault:
                log.info("recording again, %s", recorder.path)
                self._fault = ""

    def _ready(self) -> SessionRecorder | None:
        """The file being written; a new one if there is none and the last failure is a while ago."""
        if self._recorder is None:
            now_ns = self._clock.now_ns()
            if self._failed_ns is not None and now_ns - self._failed_ns < RETRY_NS:
                return None
            with contextlib.suppress(OSError):  # the recorder says it better
                self._folder.mkdir(parents=True, exist_ok=True)
            name = datetime.fromtimestamp(now_ns / 1e9, UTC).strftime("%Y%m%dT%H%M%SZ")
            self._recorder = SessionRecorder(
                _unused(self._folder, f"{name}-{self._vehicle}"),
                self._vehicle,
                config_text=self._config_text,
                camera_json=self._camera_json,
            )
        return self._recorder

    def _give_up(self, error: InputError) -> None:
        if not self._fault:
            log.error("%s; recording stops until there is room", error)
        self._fault, self._failed_ns = str(error), self._clock.now_ns()
        recorder, self._recorder = self._recorder, None
        if recorder is not None:
            recorder.abandon()


def _unused(folder: Path, name: str) -> Path:
    """A session never writes over another, even one begun in the same second."""
    path, number = folder / f"{name}.mcap", 2
    while path.exists():
        path, number = folder / f"{name}-{number}.mcap", number + 1
    return path
