"""`pc-onboard run`: what the daemon opens and wires. Imported only after the environment is set."""

from __future__ import annotations

import argparse
import faulthandler
import logging
import os
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import cv2
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from contract.camera import Camera
from contract.errors import ConfigError, InputError, PointclickError
from contract.mavlink_camera.clicks import CameraClicks
from contract.mavlink_camera.component import MavlinkCamera
from contract.mavlink_camera.messages import CameraFacts, Stream
from contract.topics import SPOTS, STATUS, TRACKS
from contract.vehicle_status import encode_status
from onboard.camera.factory import open_camera, open_second_camera
from onboard.camera.picture_mask import read_mask
from onboard.camera.playback import PlayedCamera
from onboard.config.files import load_camera, load_config_files, load_second_camera, state_folder
from onboard.config.recorded import recorded_toml
from onboard.config.schema import Config
from onboard.events.kept_pictures import KeptPictures
from onboard.events.session_clock import SessionClock
from onboard.events.sink import Sink
from onboard.events.source import Severity, Source, TelemetrySource
from onboard.link.autopilot_radio import AutopilotRadio, radio_bucket
from onboard.link.byte_budget import left_for_pictures
from onboard.link.picture_sender import PictureSender
from onboard.link.publisher import Publisher
from onboard.pipeline.pipeline import Pipeline
from onboard.service import journal
from onboard.service.daemon import Daemon, SignalOrders
from onboard.service.host import cpu_temperature_c
from onboard.service.look_thread import LookThread
from onboard.service.measure_thread import MeasureThread
from onboard.service.prometheus import PrometheusServer
from onboard.service.reports import Report
from onboard.service.sd_notify import Notifier
from onboard.service.second_camera import SecondCameraThread
from onboard.service.session import Parts, Reporter, restore
from onboard.service.solver_thread import SolverThread
from onboard.service.spot_thread import SpotThread
from onboard.service.track_thread import TrackThread
from onboard.storage.alignment_file import StateFile
from onboard.storage.elevation_files import TerrainFiles
from onboard.storage.rotating_recorder import Recorded
from onboard.storage.session_number import next_session
from onboard.telemetry.factory import open_telemetry
from onboard.telemetry.mavlink_passage import SIGNATURE_BYTES
from onboard.telemetry.pointing import Pointing
from onboard.telemetry.tlog_playback import PlayedTelemetry

LEAST_FOR_PICTURES = 10_000.0  # bit/s: a picture of a kilobyte a second

log = logging.getLogger("pointclick")


def run(arguments: argparse.Namespace) -> int:
    """Fly by a configuration until asked to stop. Returns the exit code; ends the process if a thread hangs."""
    journal.set_up()
    faulthandler.enable()  # a watchdog's SIGABRT leaves every thread's stack in the journal
    cv2.setNumThreads(1)
    with SignalOrders() as orders:
        try:
            code = Daemon(partial(load_config_files, arguments.config), open_parts, orders, Notifier()).run()
        except PointclickError as error:
            log.error("%s", " ".join(str(error).split()))
            # 2: it never began, and an operator must mend why. A link that cannot be opened now may be soon.
            code = 2 if isinstance(error, ConfigError | InputError) else 1
        except Exception:
            log.exception("the daemon failed")
            code = 1
    if code:
        # A thread may hang where the interpreter would wait for it for ever.
        logging.shutdown()
        sys.stdout.flush()
        os._exit(code)
    return code


OpenCamera = Callable[[Config, Camera, SessionClock], Source]


def open_parts(config: Config, clock: SessionClock | None = None, open_camera: OpenCamera = open_camera) -> Parts:
    """Open everything a session needs; what was opened is closed again if something cannot be.

    A bench may give a clock that runs faster, and a camera of its own.
    """
    camera = load_camera(config)
    folder = state_folder(config, dict(os.environ))
    clock = clock or SessionClock.start()
    with ExitStack() as opened:
        solver = SolverThread()
        opened.callback(solver.close)
        pipeline, state, known = _begun(config, camera, solver, folder, clock)
        link = Publisher.open(config)
        opened.callback(link.close)
        sinks: list[Sink] = [link]
        threads = [solver.thread, link.thread]
        reporters: list[Reporter] = [partial(_send, link)]
        radio = None
        if config.link.mavlink:
            radio = AutopilotRadio.open(config, link)
            opened.callback(radio.close)
            threads.append(radio.thread)
        if config.picture.enabled:
            pictures = PictureSender(config.picture, link)
            if (left := left_for_pictures(config.link.max_bit_rate, config.link.max_rate_hz)) < LEAST_FOR_PICTURES:
                log.warning(
                    "pictures: next to %g sets a second link.max_bit_rate = %g leaves %d bit/s: raise it, or lower "
                    "link.max_rate_hz", config.link.max_rate_hz, config.link.max_bit_rate, max(left, 0.0),
                )  # fmt: skip
            sinks.append(pictures)
            threads.append(pictures.thread)
        optics = load_second_camera(config) if config.spots.enabled and config.camera.thermal.is_live else None
        kept = KeptPictures(round(config.tracks.keep_mb * 1e6))
        tracks, (spots, second) = _tracks(config, link, kept), _spots(config, link, clock, optics)
        clicks, component = _camera_component(config, camera, clock, radio, tracks)
        for one in (tracks, _measured(config, link, radio, kept), spots, second, clicks):
            if one is not None:
                sinks.append(one)
                threads.append(one.thread)
        telemetry, looks = _telemetry(config, clock, link, radio, component)
        if looks is not None:
            opened.enter_context(looks)
            threads.append(looks.thread)
        recording = None
        if config.recording.enabled:
            where = Path(config.recording.folder) if config.recording.folder else folder / "recordings"
            recording = Recorded(where, config, camera, clock, recorded_toml(config), known, optics)
            sinks.append(recording)
            if tracks is not None:
                tracks.outlets.append(partial(recording.report, TRACKS))
            if spots is not None:
                spots.outlets.append(partial(recording.report, SPOTS))
                spots.keepers.append(recording.second_picture)
            threads.append(recording.thread)
            reporters.append(partial(_record, recording))
        if config.service.prometheus is not None:
            server = opened.enter_context(PrometheusServer(config.service.prometheus, config.vehicle.id))
            threads.append(server.thread)
            reporters.append(server.show)
        parts = Parts(
            clock=clock,
            camera=in_step(open_camera(config, camera, clock), telemetry),
            telemetry=telemetry,
            pipeline=pipeline,
            thermal_camera=None if second is None else second.source,
            sinks=sinks,
            recording=recording,
            reporters=reporters,
            state=state,
            temperature_c=cpu_temperature_c,
            resources=opened.pop_all(),
            threads=threads,
            radio=None if radio is None else radio.report,
            look=None if looks is None else lambda: looks.newest,
        )
    began = datetime.fromtimestamp(clock.now_ns() / 1e9, UTC).strftime("%Y-%m-%d %H:%M:%S")
    log.info("session of %s begins, %s UTC by the host's clock", config.vehicle.id, began)
    return parts


def in_step(camera: Source, telemetry: TelemetrySource) -> Source:
    """Return the camera; recorded pictures and a log, where both are played, will come as they are stamped."""
    if isinstance(camera, PlayedCamera) and isinstance(telemetry, PlayedTelemetry):
        telemetry.pictures_ns = camera.span_ns
        camera.log_shift_ns = lambda: telemetry.shift_ns
    return camera


def _begun(
    config: Config, camera: Camera, solver: SolverThread, folder: Path, clock: SessionClock
) -> tuple[Pipeline, StateFile, str]:
    """The pipeline of a session that begins now, the file of what is learned, and its text as it begins from it."""
    terrain = None if config.terrain.path is None else TerrainFiles(config.terrain.path, config.terrain.datum)
    pipeline = Pipeline(config, camera, terrain, solver, read_mask(config.camera.mask, camera.size_px))
    pipeline.session, unkept = next_session(folder, clock.now_ns())
    if unkept:
        log.warning("the session's number is not kept: %s", unkept)
    state = StateFile(folder / "alignment.json")
    complaint = restore(state, pipeline)
    if complaint:
        log.warning("%s; beginning without it", complaint)
    return pipeline, state, "" if complaint else state.text()


def _tracks(config: Config, link: Publisher, kept: KeptPictures) -> TrackThread | None:
    if not config.tracks.enabled:
        return None
    tracks = TrackThread(config, [lambda _, payload: link.report(TRACKS, payload)], pictures=kept)
    link.follow = tracks.answer
    return tracks


def _measured(
    config: Config, link: Publisher, radio: AutopilotRadio | None, kept: KeptPictures
) -> MeasureThread | None:
    """Return the thread that measures the pixels that are clicked either way, in the pictures that things are followed
    in.
    """
    if not config.tracks.enabled:
        return None
    measured = MeasureThread(config, pictures=kept)
    link.measure = measured.measure
    if radio is not None:
        radio.clicks.measure = measured.measure
    return measured


def _camera_component(
    config: Config, camera: Camera, clock: SessionClock, radio: AutopilotRadio | None, tracks: TrackThread | None
) -> tuple[CameraClicks | None, MavlinkCamera | None]:
    """Return the thread that answers a MAVLink camera's clicks, and the camera on the autopilot's network."""
    stated = config.mavlink_camera
    if not stated.enabled:
        return None, None
    clicks = CameraClicks(config.vehicle.id, stated.delay_s, stated.sigma_delay_s)
    clicks.stamped_ago_s = lambda unix_ns: max((clock.now_ns() - unix_ns) / 1e9, 0.0)
    if tracks is not None:
        clicks.follow = tracks.answer
        tracks.outlets.append(clicks.tracks)
    share = radio_bucket(config.link.mavlink_bit_rate, time.monotonic()) if radio is None else radio.bucket
    stream = None if stated.video is None else Stream.parse(stated.video)
    facts = CameraFacts(mavlink, config.vehicle.id, camera, config.camera.rate_hz, stream, clock.now_ns())
    signature_bytes = 0 if config.telemetry.signing_key is None else SIGNATURE_BYTES
    return clicks, MavlinkCamera(stated.component, facts, clicks, share, signature_bytes=signature_bytes)


def _telemetry(
    config: Config, clock: SessionClock, link: Publisher, radio: AutopilotRadio | None, component: MavlinkCamera | None
) -> tuple[TelemetrySource, LookThread | None]:
    """The autopilot, and the thread that has it look where `link.pointers` ask; its pilot gets each in words."""
    if not config.link.pointers:
        return open_telemetry(config, clock, radio, component), None
    pointing = Pointing(config.telemetry.component)
    telemetry = open_telemetry(config, clock, radio, component, pointing)
    looks = LookThread(config.look, link.set_of, pointing)
    looks.notified.append(lambda text: telemetry.send_text(Severity.NOTICE, f"pointclick: {text}"))
    link.have_look = looks.ask
    return telemetry, looks


def _spots(
    config: Config, link: Publisher, clock: SessionClock, optics: Camera | None
) -> tuple[SpotThread | None, SecondCameraThread | None]:
    """Return the thread that looks for hot spots, and that of the second camera in whose pictures it looks, if any."""
    if not (config.spots.enabled and (optics is not None or config.thermal.enabled)):
        return None, None
    spots = SpotThread(config, [lambda _, payload: link.report(SPOTS, payload)], optics)
    if optics is None:
        return spots, None
    return spots, SecondCameraThread(open_second_camera(config, optics, clock), spots.second_picture)


def _send(link: Publisher, report: Report) -> None:
    link.publish_status(encode_status(report.status), report.to_json())


def _record(recording: Recorded, report: Report) -> None:
    recording.report(STATUS, round(report.status.unix_s * 1e9), encode_status(report.status))
