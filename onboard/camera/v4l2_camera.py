"""The live camera: a V4L2 device as a source of Frames that survives its being unplugged, frozen and renumbered."""

from __future__ import annotations

import errno
import time
from collections.abc import Callable
from dataclasses import dataclass

from contract.camera import Camera
from contract.errors import ConfigError
from onboard.camera import v4l2_structures as v4l2
from onboard.camera.camera_health import figures, patience_s, stopped
from onboard.camera.control_lock import Lock, Wanted
from onboard.camera.discovery import Identity, candidates, identity, same_camera
from onboard.camera.format_negotiation import ENOUGH, choose_format
from onboard.camera.picture_decoder import Pictures, RawPicture
from onboard.camera.pixel_formats import DEEP
from onboard.camera.thermal_grey import thermal_grey
from onboard.camera.v4l2_device import Buffer, Device, Granted, V4l2Device
from onboard.config.schema import NOT_THERMAL, CameraConfig, ThermalConfig
from onboard.events.session_clock import SessionClock
from onboard.events.source import Emit, SourceStatus, State, Stop

TICK_S = 0.2
"""Longest wait in one go: how soon `stop` and a silent camera are seen."""
RETRY_S = 0.25
FIRST_PICTURE_S = 5.0
"""Some cameras take seconds to their first picture."""
STARVED_S = 0.05
"""A wait this much longer than asked: this process did not run, and the buffer there now has waited in the queue."""
SENDS_NOTHING = "opens but sends no picture"

_WORDS = {
    errno.ENOENT: "not there",
    errno.ENXIO: "not there",
    errno.ENODEV: "unplugged",
    errno.EACCES: "no permission: the user must be in the group 'video'",
    errno.EPERM: "no permission: the user must be in the group 'video'",
    errno.EBUSY: "in use by another program",
    errno.EIO: "input/output error",
}


class _Absent(Exception):
    """There is no camera to open at present; the text states why."""


@dataclass
class _Stream:
    """An open device that streams."""

    device: Device
    path: str
    format: Granted
    lock: Lock
    complaints: list[str]
    has_picture: bool = False
    stamped_at: str = ""  # the moment of the newest picture that its driver stamped: its start or its end


class V4l2Camera:
    """A `Source` of Frames. Stamps are the driver's own, on the session's clock, minus `latency_s`."""

    def __init__(
        self,
        config: CameraConfig,
        camera: Camera,
        clock: SessionClock,
        thermal: ThermalConfig = NOT_THERMAL,
        *,
        open_device: Callable[[str], Device] = V4l2Device,
        now_ns: Callable[[], int] = time.monotonic_ns,
        paths: Callable[[str], list[str]] = candidates,
        identify: Callable[[str, Device], Identity] = lambda path, device: identity(path, device.card()),
    ) -> None:
        self._config, self._camera, self._clock, self._thermal = config, camera, clock, thermal
        self._open_device, self._now_ns, self._paths, self._identify = open_device, now_ns, paths, identify
        self._pictures = Pictures(
            clock, config.latency_s, camera.size_px, config.rate_hz, thermal=thermal_grey(thermal)
        )
        self._known: Identity | None = None
        self._others: set[str] = set()  # bus places of other cameras: not ours, even if of the same type
        self._stream: _Stream | None = None
        self._absence = "not opened yet"
        self._has_failed = False  # since it was first opened, or its last picture: it is not starting any more
        self._sends_nothing = False  # the last opening ended without a single picture
        self._begun_ns = self._last_ns = now_ns()
        self._has_begun = False

    def run(self, emit: Emit, stop: Stop) -> None:
        """Emit pictures until `stop`; raises ConfigError if the device, at its first opening, cannot give them."""
        self._begun_ns, self._has_begun = self._now_ns(), True
        try:
            while not stop.is_set():
                try:
                    self._stream = stream = self._open()
                    while not stop.is_set() and self._step(stream, emit):
                        pass
                except _Absent as absent:
                    self._fail(str(absent))
                except OSError as error:
                    self._fail(f"{self._name()}: {_words(error)}")
                except ConfigError as error:
                    if self._known is None:
                        raise
                    self._fail(str(error))
                self._close()
                stop.wait(RETRY_S)
        finally:
            self._close()

    def _fail(self, why: str, *, sends_nothing: bool = False) -> None:
        self._absence, self._sends_nothing = why, sends_nothing
        self._has_failed = self._known is not None

    def _step(self, stream: _Stream, emit: Emit) -> bool:
        """Wait for one buffer and hand it on; False once the camera has been silent for too long."""
        asked_ns = self._now_ns()
        buffer = stream.device.take(TICK_S)
        now_ns = self._now_ns()
        if buffer is None:
            silent_s = (now_ns - self._last_ns) / 1e9
            if silent_s <= (patience_s(self._config) if stream.has_picture else FIRST_PICTURE_S):
                return True
            if stream.has_picture:
                self._fail(f"{stream.path}: no picture for {silent_s:.1f} s")
            else:
                self._fail(f"{stream.path}: {SENDS_NOTHING}", sends_nothing=True)
            return False
        was_starved = now_ns - asked_ns > (TICK_S + STARVED_S) * 1e9
        if not stream.has_picture:
            # Some drivers set their controls again when the stream begins.
            stream.complaints += stream.lock.check()
            stream.has_picture = True
            self._has_failed = self._sends_nothing = False
        self._last_ns = now_ns
        is_at_start = buffer.flags & v4l2.BUF_FLAG_TSTAMP_SRC_MASK == v4l2.BUF_FLAG_TSTAMP_SRC_SOE
        stream.stamped_at = "start" if is_at_start else "end"
        frame = self._pictures.take(_raw_picture(buffer, stream.format, was_starved), now_ns)
        if frame is not None:
            arrival_ns = self._clock.from_monotonic_ns(now_ns)
            emit(arrival_ns, frame)
        return True

    def _open(self) -> _Stream:
        """Find the camera, set it and begin."""
        path, device = self._find()
        try:
            if not device.card().can_capture:
                raise _Absent(f"{path}: no pictures to be had from it (no capture device, or nothing plays into it)")
            size_px = self._camera.size_px
            first = DEEP if self._thermal.enabled else ()
            granted = choose_format(device, path, size_px, self._config.format, self._config.rate_hz, first)
            rate_hz = device.set_rate_hz(self._config.rate_hz)
            c = self._config
            lock = Lock(device, Wanted(c.exposure_us, c.gain, c.focus, c.white_balance_k), size_px[0])
            complaints = list(lock.complaints)
            if not granted.is_progressive:
                complaints.append("pictures are interlaced: two times in one picture")
            if rate_hz is not None and rate_hz < ENOUGH * c.rate_hz:
                complaints.append(f"{rate_hz:.1f} pictures a second instead of {c.rate_hz:g}")
            found = self._identify(path, device)
            self._pictures.restart()
            device.start()
        except BaseException:
            device.close()
            raise
        if self._known is None:
            self._others = self._buses_of_others(path, found)
        else:
            self._pictures.counts.reopened += 1
        self._known = found
        self._last_ns = self._now_ns()
        return _Stream(device, path, granted, lock, complaints)

    def _find(self) -> tuple[str, Device]:
        """The configured device, or, once it is known, the same camera wherever it is now. Raises OSError, _Absent."""
        configured = self._config.device
        if self._known is None:
            return configured, self._open_device(configured)
        found: list[tuple[str, Identity]] = []
        why: OSError | None = None
        for path in self._paths(configured):
            try:
                device = self._open_device(path)
            except OSError as error:
                why = error if path == configured else why
                continue
            try:
                other = self._identify(path, device)
                if other.bus_info not in self._others and device.card().can_capture:
                    found.append((path, other))
            finally:
                device.close()
        path_now = same_camera(self._known, found)
        if path_now is not None:
            return path_now, self._open_device(path_now)
        if len(found) > 1:
            raise _Absent(f"{self._name()}: several cameras could be it, none surely")
        raise _Absent(f"{self._name()}: {_words(why) if why else 'not among the devices'}")

    def _buses_of_others(self, path: str, own: Identity) -> set[str]:
        """Return the buses of other cameras at the first opening, to mistake none of them for ours later."""
        buses = set()
        for other_path in self._paths(self._config.device):
            if other_path == path:
                continue
            try:
                device = self._open_device(other_path)
            except OSError:
                continue
            try:
                buses.add(self._identify(other_path, device).bus_info)
            finally:
                device.close()
        return buses - {own.bus_info}

    def _close(self) -> None:
        stream, self._stream = self._stream, None
        if stream is not None:
            stream.device.close()

    def _name(self) -> str:
        return f"{self._config.device} ({self._known.card})" if self._known else self._config.device

    def health(self) -> SourceStatus:
        """Return the camera's status, judged now and not when the last picture came: a hanging driver is seen too."""
        stream, now_ns = self._stream, self._now_ns()
        shown = figures(self._pictures, stream is not None)
        silent_s = (now_ns - self._last_ns) / 1e9
        if stream is None or not stream.has_picture:
            waited_s = (now_ns - self._begun_ns) / 1e9
            starting = not self._has_begun or (self._known is None and waited_s < patience_s(self._config))
            if stream is not None and self._pictures.counts.pictures == 0:
                starting = silent_s < FIRST_PICTURE_S and not self._has_failed
            # A camera that opens and sends nothing is opened again and again: one state and one reason all the while.
            why = self._absence
            if stream is not None:
                sends_nothing = self._sends_nothing or silent_s >= FIRST_PICTURE_S
                why = f"{stream.path}: {SENDS_NOTHING if sends_nothing else 'waiting for its first picture'}"
            return SourceStatus(State.STARTING if starting else State.LOST, why, shown)
        at_rest = stopped(stream.path, silent_s, self._pictures.frozen_s(now_ns), self._config, shown)
        if at_rest is not None:
            return at_rest
        what = (
            f"{stream.path}: {stream.format.width_px}x{stream.format.height_px} {stream.format.fourcc}, "
            f"stamped at its {stream.stamped_at}"
        )
        what += f"; {self._thermal.words}" if self._thermal.enabled else ""
        complaints = stream.complaints + self._pictures.complaints()
        return SourceStatus(State.DEGRADED if complaints else State.OK, "; ".join(complaints) or what, shown)


def _raw_picture(buffer: Buffer, format_: Granted, was_starved: bool) -> RawPicture:
    """The picture in a driver's buffer; `was_starved`: it may have been in the queue for longer than is known."""
    return RawPicture(
        buffer.data, format_.fourcc, (format_.width_px, format_.height_px), format_.bytes_per_line,
        buffer.stamp_ns, buffer.sequence,
        is_monotonic=buffer.flags & v4l2.BUF_FLAG_TIMESTAMP_MASK == v4l2.BUF_FLAG_TIMESTAMP_MONOTONIC,
        is_damaged=bool(buffer.flags & v4l2.BUF_FLAG_ERROR),
        has_waited=was_starved or buffer.has_waited,
    )  # fmt: skip


def _words(error: OSError) -> str:
    return _WORDS.get(error.errno or 0, error.strerror or str(error))
