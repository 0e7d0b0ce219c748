"""The parts that `pc-onboard replay` opens, wires and prints. Imported only after the environment is set."""

from __future__ import annotations

import argparse
import contextlib
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Self

import cv2

from contract.camera import Camera
from contract.errors import ConfigError, InputError
from contract.feature_set import FeatureSet
from contract.spot import SpotReport
from contract.topics import SPOTS, STATUS, TRACKS
from contract.track import MOST_TRACKS, TrackReport
from contract.vehicle_status import VehicleStatus, encode_status
from contract.wire.spot_code import encode_spots
from contract.wire.track_code import encode_track
from onboard.camera.picture_files import open_frames
from onboard.camera.picture_mask import read_mask
from onboard.camera_files.formats import load_camera_file
from onboard.commands.imported_flight import settings_of, with_settings
from onboard.config.files import load_config_files, load_second_camera
from onboard.config.recorded import recorded_toml
from onboard.config.schema import Config, parse_config
from onboard.events.sink import Sink
from onboard.events.types import Event, Frame
from onboard.link.picture_sender import PictureSender
from onboard.link.publisher import Publisher
from onboard.pipeline.error_budgets import BudgetWatch, NewestBudget, budget_text
from onboard.pipeline.pipeline import Pipeline
from onboard.replay.comparison import Comparison
from onboard.replay.followed import Clicked, Followed
from onboard.replay.runner import Events, Flight, ProgressLines, replay, summary_text
from onboard.replay.spotted import Spotted
from onboard.storage.alignment_file import StateFile
from onboard.storage.elevation_files import TerrainFiles
from onboard.storage.mcap_reader import RecordedFlight
from onboard.storage.mcap_writer import SessionRecorder
from onboard.storage.rotating_recorder import software_version
from onboard.telemetry.two_logs import loosened


@dataclass(frozen=True)
class _Inputs:
    """The inputs of a replay."""

    config: Config
    config_text: str
    camera: Camera
    state_json: str
    flight: Events
    recorded: RecordedFlight | None  # the same flight, if it was


def run(arguments: argparse.Namespace, stop: threading.Event) -> tuple[str, bool]:
    """Replay as asked: the summary, and whether any picture was solved.

    Everything is opened and checked before anything is written.
    """
    cv2.setNumThreads(1)
    state = StateFile(arguments.state) if arguments.state is not None else None
    inputs = _open_recording(arguments) if arguments.recording else _open_files(arguments)
    config, camera = inputs.config, inputs.camera
    terrain = None if config.terrain.path is None else TerrainFiles(config.terrain.path, config.terrain.datum)
    pipeline = Pipeline(config, camera, terrain, burned_in=read_mask(config.camera.mask, camera.size_px))
    if inputs.recorded is not None:
        pipeline.session = inputs.recorded.session
    state_json = inputs.state_json
    if state is not None:
        state_json = state.text()
        state.restore(pipeline.window.alignment)
    elif state_json:
        pipeline.window.alignment.restore(state_json)
    watch, newest = BudgetWatch(pipeline.window.R_body_cam), NewestBudget()
    pipeline.placing.watches += [newest, watch] if arguments.budget else [newest]
    sinks: list[Sink] = []
    comparison = None if inputs.recorded is None else Comparison(inputs.recorded)
    if comparison is not None:
        sinks.append(comparison)
    whole, second = None, _second_camera(arguments, inputs)
    if arguments.out is not None:
        if inputs.recorded is not None and arguments.out.resolve() in [p.resolve() for p in inputs.recorded.paths]:
            raise InputError(f"recording {arguments.out}: is what is replayed; name another file")
        whole = WholeRecording(arguments.out, config, inputs.config_text, camera, state_json, second)
        whole.at_its_end = partial(_last_status, pipeline, newest)
        sinks.append(whole)
    followed = _followed(arguments, config, whole)
    sinks += [] if followed is None else [followed]
    spotted = _spotted(arguments, inputs, second, whole)
    sinks += [] if spotted is None else [spotted]
    if arguments.publish:
        link = Publisher.open(config)
        sinks.append(link)
        if config.picture.enabled:
            sinks.append(PictureSender(config.picture, link))
    terminal = sys.stderr if sys.stderr.isatty() else ProgressLines(sys.stderr) if arguments.progress else None
    linger_s = arguments.linger if arguments.publish else 0.0
    summary = replay(inputs.flight, pipeline, sinks, arguments.speed, linger_s, terminal, stop)
    if state is not None:
        state.keep(pipeline.window.alignment)
    text = summary_text(summary)
    if arguments.budget:
        text += f"\n{budget_text(watch.budgets())}"
    if comparison is not None and inputs.recorded is not None and not stop.is_set():
        text += f"\nas recorded: {comparison}"
        text += "".join(f"\nnot exactly the same flight: {why}" for why in inputs.recorded.caveats)
    return text, summary.solved > 0


def _open_files(arguments: argparse.Namespace) -> _Inputs:
    """Pictures and an autopilot's log."""
    needed = {"--frames": arguments.frames, "--telemetry": arguments.telemetry, "--camera": arguments.camera}
    missing = [name for name, given in needed.items() if not given]
    if missing:
        raise InputError(f"replay needs a recording, or pictures and a log: {' and '.join(missing)} missing")
    config = Config() if arguments.config is None else load_config_files(arguments.config)
    config_text = "" if arguments.config is None else recorded_toml(config)
    if arguments.set:
        config = with_settings(config, settings_of(arguments.set))
        config_text = recorded_toml(config)
    camera = load_camera_file(arguments.camera)
    if arguments.out is not None:
        _check_place(arguments.out)
    flight = Flight.open(
        *(config, camera, arguments.frames, arguments.telemetry, arguments.stamps),
        home_amsl_m=arguments.home_amsl_m,
        gps_order=arguments.gps_order,
        boot_unix_s=arguments.time_offset,
        max_rate_hz=arguments.rate,
    )
    if (loose := loosened(config, flight.telemetry)) != config:
        config, config_text = loose, recorded_toml(loose)
    for note in flight.notes:
        print(f"note: {note}", file=sys.stderr)
    return _Inputs(config, config_text, flight.camera, "", flight, None)


def _open_recording(arguments: argparse.Namespace) -> _Inputs:
    """A session as the daemon recorded it, with its own configuration unless another is asked for."""
    given = [f"--{name}" for name in ("frames", "telemetry", "stamps") if getattr(arguments, name)]
    if given:
        raise InputError(f"a recording brings its own pictures and telemetry: leave {' and '.join(given)} out")
    recorded = RecordedFlight.open(arguments.recording)
    if arguments.config is not None:
        config = load_config_files(arguments.config)
        config_text = recorded_toml(config)
    else:
        config_text = recorded.config_text
        try:
            config = parse_config(config_text)
        except ConfigError as error:
            raise ConfigError(
                f"recording {recorded.paths[0]}: its configuration (version {recorded.version or 'unknown'}): {error}"
            ) from error
    if arguments.set:
        config = with_settings(config, settings_of(arguments.set))
        config_text = recorded_toml(config)
    camera = recorded.camera if arguments.camera is None else load_camera_file(arguments.camera)
    return _Inputs(config, config_text, camera, recorded.state_json, recorded, recorded)


def recorded_flight(session: Path) -> tuple[Config, Camera, Events]:
    """A recorded session's configuration, camera and events. Raises InputError, ConfigError."""
    recorded = RecordedFlight.open([session])
    return parse_config(recorded.config_text), recorded.camera, recorded


def _check_place(path: Path) -> None:
    if not path.parent.is_dir():
        raise InputError(f"recording {path}: no such folder as {path.parent}")
    if path.is_dir():
        raise InputError(f"recording {path}: is a folder; name a file")


def _followed(arguments: argparse.Namespace, config: Config, whole: WholeRecording | None) -> Followed | None:
    """Return the follower of the things clicked with --track; None without any. Raises InputError for too many."""
    if len(arguments.track) > MOST_TRACKS:
        raise InputError(f"--track: {MOST_TRACKS} things can be followed at once, not {len(arguments.track)}")
    outlets = [_print_tracks] if whole is None else [_print_tracks, whole.tracks]
    clicks = [Clicked(*click) for click in arguments.track]
    return Followed(config.vehicle.id, clicks, _not_followed, outlets) if clicks else None


def _second_camera(arguments: argparse.Namespace, inputs: _Inputs) -> Camera | None:
    """The optics of a second camera in whose pictures hot spots are looked for, as the recording or a file has them."""
    if arguments.thermal is not None and not arguments.spots:
        raise InputError("--thermal: hot spots are looked for in these pictures: add --spots")
    if not arguments.spots or not (arguments.thermal or inputs.config.camera.thermal.is_stated):
        return None
    if inputs.recorded is not None and inputs.recorded.second_camera is not None and arguments.config is None:
        return inputs.recorded.second_camera
    return load_second_camera(inputs.config)


def _second_pictures(arguments: argparse.Namespace, inputs: _Inputs, camera: Camera) -> Iterator[Frame]:
    """Return that camera's pictures: as named, else as recorded. Raises InputError where there are none."""
    if arguments.thermal is not None:
        stamps, second = arguments.thermal_stamps, inputs.config.camera.thermal
        return open_frames(
            arguments.thermal, camera, stamps, second.latency_s, is_thermal=True, black_hot=second.black_hot
        ).frames()
    if inputs.recorded is not None and inputs.recorded.has_second_counts:
        return inputs.recorded.second_pictures()
    raise InputError(
        "--spots: the configuration states a second camera: name its pictures with --thermal (a recording "
        'brings those that were looked at if recording.pictures was "lossless")'
    )


def _spotted(
    arguments: argparse.Namespace, inputs: _Inputs, second: Camera | None, whole: WholeRecording | None
) -> Spotted | None:
    """Return the search for hot spots; None if it is not requested. Raises InputError where no thermal camera is
    stated.
    """
    if not arguments.spots:
        return None
    config = inputs.config
    outlets = [_print_spots] if whole is None else [_print_spots, whole.spots]
    if second is not None:
        spotted = Spotted(config, outlets, (second, _second_pictures(arguments, inputs, second)))
        if whole is not None:
            spotted.keepers.append(whole.second_picture)
        return spotted
    if not config.thermal.enabled:
        raise InputError("--spots: the configuration states no thermal camera: set thermal.enabled (docs/thermal.md)")
    return Spotted(config, outlets)


def _print_spots(report: SpotReport) -> None:
    print(report.to_json(), flush=True)


def _not_followed(click: Clicked) -> None:
    print(f"note: nothing could be followed at {click.u_px:g} {click.v_px:g} of picture {click.frame}", file=sys.stderr)


def _print_tracks(reports: list[TrackReport]) -> None:
    for report in reports:
        print(report.to_json(), flush=True)


def _last_status(pipeline: Pipeline, newest: NewestBudget) -> VehicleStatus | None:
    """Return the status at the flight's end, for the error budget that is in it; None if no picture was placed."""
    if newest.newest is None:
        return None
    s = newest.newest.feature_set
    budget = newest.at(s.capture_unix_ns)
    tracks = len(pipeline.tracks)
    shares = {} if budget is None else budget.percent
    return VehicleStatus(s.capture_unix_ns / 1e9, s.session, "ok", frame=s.frame, tracks=tracks, shares=shares)


class WholeRecording:
    """A recording written under a temporary name and moved to its own only when all went well.

    So an error at the five-hundredth picture leaves nothing behind, and an earlier recording of that name as it was.
    Raises InputError if it cannot be written.
    """

    def __init__(
        self,
        path: Path,
        config: Config,
        config_text: str,
        camera: Camera,
        state_json: str = "",
        second: Camera | None = None,
    ) -> None:
        _check_place(path)
        self._path, self._part = path, path.with_name(f".{path.name}.part")
        self._recorder = SessionRecorder(
            self._part,
            config.vehicle.id,
            config_text=config_text,
            camera_json=camera.to_json(),
            second_camera_json="" if second is None else second.to_json(),
            software_version=software_version(),
            state_json=state_json,
            pictures=config.recording.pictures,
        )
        self.at_its_end: Callable[[], VehicleStatus | None] = lambda: None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            status = self.at_its_end() if kind is None else None
            if status is not None:
                self._recorder.write_report(STATUS, round(status.unix_s * 1e9), encode_status(status))
            self._recorder.close()
            if kind is None:
                self._part.replace(self._path)
        except OSError as failure:
            raise InputError(f"recording {self._path}: {failure.strerror}") from failure
        finally:
            with contextlib.suppress(OSError):
                self._part.unlink(missing_ok=True)

    def event(self, arrival_ns: int, event: Event) -> None:
        self._recorder.write_event(event, arrival_ns)

    def tracks(self, reports: list[TrackReport]) -> None:
        """Write reports of one picture as one message."""
        payload = b"".join(encode_track(report) for report in reports)
        self._recorder.write_report(TRACKS, reports[0].capture_unix_ns, payload)

    def spots(self, report: SpotReport) -> None:
        self._recorder.write_report(SPOTS, report.capture_unix_ns, encode_spots(report))

    def second_picture(self, frame: Frame) -> None:
        self._recorder.write_second_picture(frame)

    def feature_set(self, output: FeatureSet) -> None:
        self._recorder.write_set(output)
