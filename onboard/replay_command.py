"""What `pc-onboard replay` opens, wires and prints. Imported only after the environment is set."""

from __future__ import annotations

import argparse
import contextlib
import importlib.metadata
import sys
import threading
from pathlib import Path
from types import TracebackType
from typing import Self

import cv2

from contract.camera import Camera
from contract.errors import InputError
from contract.feature_set import FeatureSet
from onboard.config import Config, to_toml
from onboard.config_files import load_config_files
from onboard.events import Event
from onboard.pipeline import Pipeline
from onboard.publisher import Publisher
from onboard.recording import SessionRecorder
from onboard.replay import Flight, Sink, replay, summary_text
from onboard.state_file import StateFile
from onboard.terrain_files import TerrainFiles


def run(arguments: argparse.Namespace, stop: threading.Event) -> str:
    """Replay as asked and return the summary; everything is opened and checked before anything is written."""
    cv2.setNumThreads(1)
    config_text = ""
    config = Config()
    if arguments.config is not None:
        config = load_config_files(arguments.config)
        config_text = to_toml(config)
    camera = Camera.from_json(arguments.camera)
    sinks: list[Sink] = []
    if arguments.record is not None:
        sinks.append(WholeRecording(arguments.record, config.vehicle.id, config_text, camera))
    flight = Flight.open(config, camera, arguments.frames, arguments.telemetry, arguments.stamps)
    if arguments.publish:
        sinks.append(Publisher.open(config))
    terminal = sys.stderr if sys.stderr.isatty() else None
    linger_s = arguments.linger if arguments.publish else 0.0
    terrain = None if config.terrain.path is None else TerrainFiles(config.terrain.path, config.terrain.datum)
    pipeline = Pipeline(config, camera, terrain)
    state = StateFile(arguments.state) if arguments.state is not None else None
    if state is not None:
        state.restore(pipeline.window.alignment)
    summary = replay(flight, pipeline, sinks, arguments.speed, linger_s, terminal, stop)
    if state is not None:
        state.keep(pipeline.window.alignment)
    return summary_text(summary)


class WholeRecording:
    """A recording written beside its name and moved there only when all went well.

    An error at the five-hundredth picture so leaves nothing behind, and an earlier recording of that name as it was.
    Raises InputError if it cannot be written.
    """

    def __init__(self, path: Path, vehicle: str, config_text: str, camera: Camera) -> None:
        if not path.parent.is_dir():
            raise InputError(f"recording {path}: no such folder as {path.parent}")
        if path.is_dir():
            raise InputError(f"recording {path}: is a folder; name a file")
        self._path, self._part = path, path.with_name(f".{path.name}.part")
        try:
            version = importlib.metadata.version("pointclick")
        except importlib.metadata.PackageNotFoundError:  # run from a checkout
            version = ""
        self._recorder = SessionRecorder(
            self._part, vehicle, config_text=config_text, camera_json=camera.to_json(), software_version=version
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self._recorder.close()
            if kind is None:
                self._part.replace(self._path)
        except OSError as failure:
            raise InputError(f"recording {self._path}: {failure.strerror}") from failure
        finally:
            with contextlib.suppress(OSError):
                self._part.unlink(missing_ok=True)

    def event(self, arrival_ns: int, event: Event) -> None:
        """Record an event."""
        self._recorder.write_event(event)

    def feature_set(self, output: FeatureSet) -> None:
        """Record a set."""
        self._recorder.write_set(output)
