"""A camera behind a helper program: frames out of a pipe as a source that survives whatever happens to the helper."""

from __future__ import annotations

import math
import signal
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Literal

from contract.camera import Camera
from contract.errors import ConfigError
from contract.tied_process import NOT_THERE
from onboard.camera.camera_health import figures, patience_s, stopped
from onboard.camera.frame_protocol import FrameReader, GimbalFrame, Header, Origin, middle_ns
from onboard.camera.helper_process import HelperProcess
from onboard.camera.picture_decoder import Pictures, RawPicture
from onboard.camera.sender_clock import SenderClock
from onboard.camera.thermal_grey import thermal_grey
from onboard.config.schema import NOT_THERMAL, CameraConfig, ThermalConfig
from onboard.events.session_clock import SessionClock
from onboard.events.source import Emit, SourceStatus, State, Stop
from onboard.events.types import GimbalAttitude, Zoom

TICK_S = 0.1
RETRY_S = (0.2, 0.4, 0.8)  # after so many helpers in a row that ended without a picture
FIRST_PICTURE_S = 10.0  # a server may send a key frame every some seconds, and decoders begin with one
# Times that, after so many helpers in a row that had none by then: a slow computer's GStreamer looks through all of its
# plugins at the first start, and begins that again if it is ended before.
LONGER = (1.0, 2.0, 4.0)
STALE_NS = 1_000_000_000
BAD_IN_A_ROW = 5
NEVER_WORKS = 2
"""Exit status of a helper for what no further attempt can mend: the last line of its error stream is why."""

ORIGIN_WORDS = {
    Origin.UNKNOWN: "stamps of an origin that is not stated",
    Origin.SENSOR: "stamps of the camera's driver",
    Origin.SEI: "capture times in the video (MISB 0604)",
    Origin.RTCP: "times of RTCP sender reports",
    Origin.MEDIA: "time stamps of the stream",
    Origin.ARRIVAL: "times of arrival",
}


@dataclass(frozen=True)
class Launch:
    """The command that starts a helper; `name` is what people see, without passwords."""

    name: str
    command: tuple[str, ...]
    stdin: bytes = b""
    environment: Mapping[str, str] = field(default_factory=dict)
    is_compressed: bool = False  # its pictures may have been compressed: a repeat of one may differ from it


def _of_lens_and_gimbal(header: Header, stamp_ns: int) -> Iterator[GimbalAttitude | Zoom]:
    """Yield the zoom and the gimbal's attitude that a frame's header states, if it does."""
    if math.isfinite(header.focal_px):
        yield Zoom(stamp_ns, header.focal_px, "focal_px", is_of_picture=True)
    elif math.isfinite(header.zoom):
        yield Zoom(stamp_ns, header.zoom, "times", is_of_picture=True)
    if header.gimbal_frame is not GimbalFrame.NONE and 0.5 < math.hypot(*header.gimbal) < 2.0:
        w, x, y, z = (part / math.hypot(*header.gimbal) for part in header.gimbal)
        reference: Literal["vehicle", "earth"] = "earth" if header.gimbal_frame is GimbalFrame.EARTH else "vehicle"
        yield GimbalAttitude(stamp_ns, (w, x, y, z), reference, is_of_camera=True)


@dataclass
class _Stream:
    """A running helper and what came of it."""

    process: HelperProcess
    reader: FrameReader
    has_picture: bool = False
    size_px: tuple[int, int] = (0, 0)  # of the newest frame
    header: Header | None = None


class HelperCamera:
    """A `Source` of Frames. Stamps are as `SenderClock` maps them, moved to mid-exposure, minus `latency_s`."""

    def __init__(
        self,
        config: CameraConfig,
        camera: Camera,
        clock: SessionClock,
        launch: Launch,
        thermal: ThermalConfig = NOT_THERMAL,
        *,
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._config, self._camera, self._clock, self._launch, self._now_ns = config, camera, clock, launch, now_ns
        self._thermal = thermal
        self._pictures = Pictures(
            clock,
            config.latency_s,
            camera.size_px,
            config.rate_hz,
            STALE_NS,
            "helper",
            launch.is_compressed,
            thermal_grey(thermal),
        )
        self._stamps = SenderClock(clock, config.stream_clock == "utc")
        self._stream: _Stream | None = None
        self._absence = "not started yet"
        self._has_been = False  # there has been a picture
        self._barren = 0  # helpers in a row that gave none
        self._overdue = 0  # helpers in a row that were ended because they gave none
        self._garbage, self._garbage_ns = 0, 0
        self._unusable_in_a_row = 0
        self._begun_ns = self._last_ns = now_ns()
        self._has_begun = False

    def run(self, emit: Emit, stop: Stop) -> None:
        """Emit pictures until `stop`; raises ConfigError if the helper, at first, reports that it can never work."""
        self._begun_ns, self._has_begun = self._now_ns(), True
        try:
            while not stop.is_set():
                self._open()
                while not stop.is_set() and self._step(emit):
                    pass
                self._close()
                stop.wait(RETRY_S[min(self._barren, len(RETRY_S) - 1)])
        finally:
            self._close()

    def _open(self) -> None:
        launch = self._launch
        try:
            process = HelperProcess(launch.command, launch.stdin, launch.environment)
        except OSError as error:
            self._absence = f"{launch.name}: {error.strerror}"
            return
        if self._has_been:
            self._pictures.counts.reopened += 1
        self._pictures.restart()
        self._stamps.restart()
        self._last_ns = self._now_ns()
        self._stream = _Stream(process, FrameReader())

    def _close(self) -> None:
        stream, self._stream = self._stream, None
        if stream is not None:
            if stream.has_picture:
                self._barren = self._overdue = 0
            else:
                self._barren += 1
            stream.process.close()

    def _step(self, emit: Emit) -> bool:
        """Take what has come; False once this helper is of no use any more."""
        stream = self._stream
        if stream is None:
            return False
        data = stream.process.read(TICK_S)
        if data is None:
            self._mourn(stream)
            return False
        now_ns, skipped = self._now_ns(), stream.reader.skipped_bytes
        for header, luma in stream.reader.feed(data):
            self._take(stream, header, luma, emit)
        if stream.reader.skipped_bytes > skipped:
            self._garbage += stream.reader.skipped_bytes - skipped
            self._garbage_ns = now_ns
        silent_s = (now_ns - self._last_ns) / 1e9
        if silent_s <= (patience_s(self._config) if stream.has_picture else self._first_picture_s):
            return True
        if not stream.has_picture:
            self._overdue += 1
        self._absence = f"{self._launch.name}: {self._silence(stream, silent_s)}"
        return False

    @property
    def _first_picture_s(self) -> float:
        return FIRST_PICTURE_S * LONGER[min(self._overdue, len(LONGER) - 1)]

    def _mourn(self, stream: _Stream) -> None:
        """Note how the helper ended; raises ConfigError if no other attempt can be better than this first one."""
        words = stream.process.last_words()
        status = stream.process.close()
        how = words or f"ended with exit status {status}"
        if status < 0:  # its last words are of something else
            how = f"ended by {signal.Signals(-status).name}{f' after: {words}' if words else ''}"
        self._absence = f"{self._launch.name}: {how}"
        if status in {NEVER_WORKS, NOT_THERE} and not self._has_been:
            raise ConfigError(self._absence)

    def _take(self, stream: _Stream, header: Header, luma: bytearray, emit: Emit) -> None:
        now_ns = self._now_ns()
        if not stream.has_picture:
            stream.has_picture = self._has_been = True
        self._last_ns = now_ns
        stream.size_px, stream.header = (header.width_px, header.height_px), header
        timed = self._stamps.to_monotonic_ns(header, now_ns)
        if timed is None:
            self._pictures.counts.skipped += 1
            self._unusable_in_a_row += not self._stamps.is_settling
            return
        stamp_ns = timed + middle_ns(header, abs(self._config.readout_s))
        raw = RawPicture(
            luma, header.fourcc, stream.size_px, header.line_bytes, stamp_ns, header.sequence,
            is_damaged=header.is_damaged,
        )  # fmt: skip
        frame = self._pictures.take(raw, now_ns)
        self._unusable_in_a_row = self._unusable_in_a_row + 1 if frame is None else 0
        if frame is not None:
            arrival_ns = self._clock.from_monotonic_ns(now_ns)
            for event in _of_lens_and_gimbal(header, frame.stamp_ns):
                emit(arrival_ns, event)
            emit(arrival_ns, frame)

    @staticmethod
    def _silence(stream: _Stream, silent_s: float) -> str:
        """Return the reason why nothing comes of a helper that runs."""
        if stream.has_picture:
            return f"no picture for {silent_s:.1f} s"
        if stream.reader.complaint:
            return f"writes frames that cannot be read: {stream.reader.complaint}"
        if stream.reader.skipped_bytes:
            return f"{stream.reader.skipped_bytes} bytes so far, and none of them begin a frame"
        return stream.process.words or "runs but sends no picture"

    def health(self) -> SourceStatus:
        """Return the camera's status, judged now."""
        stream, now_ns = self._stream, self._now_ns()
        shown, name = self._figures(), self._launch.name
        silent_s = (now_ns - self._last_ns) / 1e9
        if stream is None or not stream.has_picture:
            starting = not self._has_begun or (
                not self._has_been and self._barren == 0 and (now_ns - self._begun_ns) / 1e9 < FIRST_PICTURE_S
            )
            why = self._absence
            if starting or (stream is not None and why.startswith("not started")):
                why = f"{name}: waiting for its first picture"
            return SourceStatus(State.STARTING if starting else State.LOST, why, shown)
        at_rest = stopped(name, silent_s, self._pictures.frozen_s(now_ns), self._config, shown)
        if at_rest is not None:
            return at_rest
        if self._stamps.is_settling:
            return SourceStatus(State.STARTING, f"{name}: finding the least delay of its pictures", shown)
        complaints = self._complaints(stream, now_ns)
        what = f"{name}: {stream.size_px[0]}x{stream.size_px[1]}, {self.stamps_text()}"
        what += f"; {self._thermal.words}" if self._thermal.enabled else ""
        return SourceStatus(State.DEGRADED if complaints else State.OK, "; ".join(complaints) or what, shown)

    def stamps_text(self) -> str:
        """Return in words where stamps come from, how they are mapped to our clock, and how well each is known."""
        stream, stamps = self._stream, self._stamps
        if stream is None or stream.header is None:
            return "no stamp yet"
        known = "" if stamps.sigma_s is None else f", each +-{1e3 * stamps.sigma_s:.1f} ms"
        prior = f"their delay {self._config.latency_s:.2f} +-{self._config.sigma_latency_s:.2f} s before flight"
        return f"{ORIGIN_WORDS[stream.header.origin]} ({stamps.meaning}{known}; {prior})"

    def _complaints(self, stream: _Stream, now_ns: int) -> list[str]:
        found = self._pictures.complaints()
        if stream.size_px != self._camera.size_px:
            seen, own = ("x".join(map(str, size)) for size in (stream.size_px, self._camera.size_px))
            found.insert(0, f"pictures are {seen}, the camera file is for {own}: none is used")
        if self._stamps.complaint:
            found.append(self._stamps.complaint)
        elif self._unusable_in_a_row > BAD_IN_A_ROW:
            found.append(f"stamps run backwards or are too old: the last {self._unusable_in_a_row} pictures not used")
        if self._garbage and now_ns - self._garbage_ns < 2_000_000_000:
            found.append(f"{self._garbage} bytes that are no frames")
        return found

    def _figures(self) -> dict[str, float]:
        sigma_s = self._stamps.sigma_s
        return {
            **figures(self._pictures, self._stream is not None),
            "garbage_bytes": self._garbage,
            **({} if sigma_s is None else {"stamp_sigma_ms": 1e3 * sigma_s}),
        }
