"""`pc-onboard replay`: a recorded flight through the same pipeline as live. Plumbing only.

Pictures and telemetry are merged by time (pictures by their stamp, telemetry by its arrival in the log), handed to the
pipeline one by one, and what comes out goes to the sinks. Nothing here changes an event.
"""

from __future__ import annotations

import io
import math
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, TextIO

from tqdm import tqdm

from contract.camera import Camera
from contract.errors import InputError
from contract.feature_set import FeatureSet
from onboard.camera.photo_metadata import read_photo
from onboard.camera.picture_files import FrameSource, Video, open_frames
from onboard.config.schema import Config
from onboard.events.sink import Sink
from onboard.events.types import Event, Frame
from onboard.pipeline.estimates import as_rows
from onboard.replay.digital_zoom import at_one_zoom, optical_zoom
from onboard.replay.photo_steps import doubt_text, without_steps
from onboard.replay.photo_telemetry import check_gaps, photo_telemetry
from onboard.telemetry.log_files import read_logs
from onboard.telemetry.own_video import another_length, began_ns, cut_sigma_s
from onboard.telemetry.read_options import ReadOptions
from onboard.telemetry.srt_axis_order import Order
from onboard.telemetry.telemetry_log import TelemetryLog

if TYPE_CHECKING:
    from onboard.pipeline.pipeline import Pipeline
    from onboard.pipeline.summary import Summary

EXIF = "exif"  # in place of a log: what the pictures themselves state
WHOLE_SECOND_SIGMA_S = 0.25  # of a stamp, from which on one cut to the second is no worse: evenly within it is 0.29
# Telemetry this long before the first and after the last picture takes part: enough for a receiver's state to be known
# and for the last exposure to be bracketed, whatever the length of the log.
LEAD_NS = 30_000_000_000
TAIL_NS = 5_000_000_000
PACE_LEAD_NS = 1_000_000_000
LINE_S = 10.0  # between two lines of progress where there is no terminal
# Pictures may lie this far outside of the telemetry and still be interpolated or extrapolated.
OVERLAP_SLACK_NS = 300_000_000
QUARTER_NS, MAX_QUARTERS = 900_000_000_000, 56  # of an hour; zones go to 14 h


@dataclass(frozen=True)
class Flight:
    """A recorded flight, opened and checked: every error that can be known without decoding has been raised."""

    frames: FrameSource
    telemetry: TelemetryLog
    camera: Camera  # that the pictures were taken with: as given, but for a digital zoom that the log states
    behind_ns: int = 0  # how far positions lag behind their stamps

    @classmethod
    def open(
        cls,
        config: Config,
        camera: Camera,
        frames: Path | str,
        telemetry: Path | str | Sequence[Path | str],
        stamps: Path | str | None,
        home_amsl_m: float | None = None,
        gps_order: Order | None = None,
        boot_unix_s: float | None = None,
        max_rate_hz: float = math.inf,
    ) -> Flight:
        """Open both inputs; raises InputError, one line, if either is unusable or they do not overlap in time.

        `telemetry` is a log, or two of one flight, or the word "exif": what the pictures themselves state.
        `home_amsl_m`, `gps_order`, `boot_unix_s`: see `ReadOptions`. Pictures closer together than
        `max_rate_hz` are left out.
        """
        logs = [telemetry] if isinstance(telemetry, str | Path) else list(telemetry)
        if EXIF in map(str, logs):
            if len(logs) > 1:
                raise InputError("--telemetry exif: pictures that state where they were go without a log")
            return cls._of_photos(config, camera, frames, stamps, max_rate_hz)
        whole = config.camera.sigma_jitter_s >= WHOLE_SECOND_SIGMA_S
        line, gimbal = config.telemetry, config.mount.gimbal_component
        stated = line.clock, home_amsl_m, gps_order, boot_unix_s, gimbal, line.system, config.gps.undulation_m
        log = read_logs(logs, ReadOptions(*stated))
        latency_s, in_colour = config.camera.latency_s, config.recording.pictures == "jpeg"
        epoch_ns = began_ns(log, logs, frames)
        source = open_frames(
            frames,
            camera,
            stamps,
            latency_s,
            whole,
            epoch_ns,
            max_rate_hz,
            in_colour,
            config.thermal.enabled,
            config.thermal.black_hot,
        )
        if stamps is None and isinstance(source, Video) and (why := another_length(log, source.last_s)):
            raise InputError(
                f"frames {frames}: {why}: pc-onboard import-video searches when it began, or give --stamps"
            )
        if stamps is None and isinstance(source, Video):
            cut_s = cut_sigma_s(log, source.end_s)
            log = replace(log, position_sigma_s=math.hypot(log.position_sigma_s, cut_s))
        zooms, words = optical_zoom(camera, log.focal_mm, log.digital_zoom, log.span_ns[1])
        camera, source = at_one_zoom(camera, source, log.digital_zoom)
        if words:
            log = log.with_events(zooms, words)
        check_overlap(source.stamps_ns, log)
        return cls(source, log, camera, max(round(config.gps.latency_s * 1e9), 0))

    @classmethod
    def _of_photos(
        cls, config: Config, camera: Camera, frames: Path | str, stamps: Path | str | None, max_rate_hz: float
    ) -> Flight:
        folder = Path(frames)
        if folder.is_file():
            raise InputError(f"telemetry exif: {folder} is a video; pictures in a folder have EXIF")
        in_colour = config.recording.pictures == "jpeg"
        source = open_frames(
            frames,
            camera,
            stamps,
            config.camera.latency_s,
            True,
            None,
            max_rate_hz,
            in_colour,
            config.thermal.enabled,
            config.thermal.black_hot,
        )
        check_gaps(config, source.stamps_ns)
        photos = [read_photo(folder / name) for name in source.names]
        log = photo_telemetry(photos, source.stamps_ns, config.gps.undulation_m)
        mended = without_steps(photos, folder, camera, config.gps)
        if mended.steps:
            words = [f"a step {step}" for step in mended.steps]
            words += [f"positions: {doubt_text(mended.doubt_m)}"] * (mended.doubt_m > 0.0)
            log = photo_telemetry(mended.photos, source.stamps_ns, config.gps.undulation_m)
            log = replace(log, notes=(*log.notes, *words), correlation_time_s=mended.correlation_time_s)
        return cls(source, log, camera)

    @property
    def stamps_ns(self) -> Sequence[int]:
        return self.frames.stamps_ns

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the operator on how the inputs were read, one line each."""
        return (*self.telemetry.notes, *self.frames.notes)

    def events(self) -> Iterator[tuple[int, Event]]:
        """Everything in the order in which it would have arrived, with that time (Unix ns)."""
        stamps = self.frames.stamps_ns
        log = zip(self.telemetry.arrival_ns, self.telemetry.events, strict=True)
        near = ((t, e) for t, e in log if stamps[0] - LEAD_NS <= t <= stamps[-1] + TAIL_NS + self.behind_ns)
        waiting = next(near, None)
        for frame in self.frames.frames():
            while waiting is not None and waiting[0] <= frame.stamp_ns:
                yield waiting
                waiting = next(near, None)
            yield frame.stamp_ns, frame
        while waiting is not None:
            yield waiting
            waiting = next(near, None)


class Events(Protocol):
    """A flight to replay: `Flight`, or `onboard.storage.mcap_reader.RecordedFlight`."""

    @property
    def stamps_ns(self) -> Sequence[int]:
        """Capture times of the pictures."""

    def events(self) -> Iterator[tuple[int, Event]]:
        """Everything in the order in which it arrived, with that time (Unix ns)."""


class ProgressLines(io.StringIO):
    """The file that a bar is written to without a terminal: each state that it shows is a line."""

    def __init__(self, out: TextIO) -> None:
        super().__init__()
        self._out = out

    def write(self, text: str) -> int:
        """A line, if there is anything in it."""
        for line in text.replace("\n", "\r").split("\r"):
            if line.strip():
                print(line.strip(), file=self._out, flush=True)
        return len(text)


class Pace:
    """Waits so that events leave `speed` times as fast as they came; never when `speed` is None."""

    def __init__(self, speed: float | None, start_ns: int, stop: threading.Event) -> None:
        self._speed, self._start_ns, self._stop = speed, start_ns, stop
        self._began = time.monotonic()

    def wait_for(self, moment_ns: int) -> None:
        """Sleep until `moment_ns` is due or `stop` is set; everything before the start is due at once."""
        if self._speed is not None:
            due = self._began + (moment_ns - self._start_ns) / 1e9 / self._speed
            self._stop.wait(max(due - time.monotonic(), 0.0))


def replay(
    flight: Events,
    pipeline: Pipeline,
    sinks: Sequence[Sink] = (),
    speed: float | None = None,
    linger_s: float = 0.0,
    progress: TextIO | None = None,
    stop: threading.Event | None = None,
) -> Summary:
    """Drive the pipeline with a flight; returns its summary.

    `speed` None is as fast as it goes; `progress` a terminal for a bar. Once `stop` is set no further event enters, but
    what has begun is finished, so that a recording is whole. Raises InputError at a picture that cannot be decoded.
    """
    stop = stop or threading.Event()
    with ExitStack() as stack:
        bar = stack.enter_context(
            tqdm(
                total=len(flight.stamps_ns),
                unit="frame",
                file=progress,
                disable=progress is None,
                leave=False,
                **({} if progress is None or progress.isatty() else {"mininterval": LINE_S, "delay": LINE_S}),
            )
        )
        for sink in sinks:
            stack.enter_context(sink)
        pace = Pace(speed, flight.stamps_ns[0] - PACE_LEAD_NS, stop)
        for moment_ns, event in flight.events():
            pace.wait_for(moment_ns)
            if stop.is_set():
                break
            for sink in sinks:
                sink.event(moment_ns, event)
            _publish(pipeline.handle(event), sinks)
            if isinstance(event, Frame):
                bar.update()
        _publish(pipeline.finish(), sinks)
        if linger_s > 0:
            stop.wait(linger_s)
    return pipeline.summary


def _publish(outputs: Iterable[FeatureSet], sinks: Sequence[Sink]) -> None:
    for output in outputs:
        for sink in sinks:
            sink.feature_set(output)


def summary_text(summary: Summary) -> str:
    """The figures at the end of a replay, a few aligned lines."""
    refused = ", ".join(f"{count} {why}" for why, count in sorted(summary.refused.items(), key=lambda kv: -kv[1]))
    rows = [
        ("frames", f"{summary.frames}"),
        ("keyframes", f"{summary.keyframes}"),
        ("solved", f"{summary.solved}"),
        ("refused", f"{sum(summary.refused.values())}" + (f" ({refused})" if refused else "")),
        ("median tracks", f"{summary.median_tracks:.0f}"),
        ("reprojection", f"{summary.reprojection_px:.2f} px"),
    ]
    if summary.refused_windows:
        rows.append(("refused windows", ", ".join(f"{n} {why}" for why, n in summary.refused_windows.items())))
    if str(summary.left_out):
        rows.append(("left out", str(summary.left_out)))
    if summary.mounted_on:
        rows.append(("camera carried by", summary.mounted_on))
    rows += as_rows(summary.estimates, summary.sensor_errors, summary.unconfirmed, summary.contradictions)
    if summary.terrain_doubt:
        rows.append(("terrain model", f"left out: {summary.terrain_doubt}"))
    frames = max(summary.frames, 1)
    rows += [
        (f"time, {stage}", f"{seconds:.2f} s ({1000.0 * seconds / frames:.1f} ms a frame)")
        for stage, seconds in summary.stage_seconds.items()
    ]
    if summary.shortfall is not None:
        rows += [("nothing solved", summary.shortfall.reason), ("what to do", summary.shortfall.remedy)]
    width = max(len(name) for name, _ in rows)
    return "\n".join(f"{name:<{width}}  {value}" for name, value in rows)


def check_overlap(stamps_ns: Sequence[int], log: TelemetryLog) -> None:
    """Raise InputError if a log does not cover the time of the pictures; its line states how far apart they are."""
    (first, last), (begin, end) = (min(stamps_ns), max(stamps_ns)), log.span_ns
    if last >= begin - OVERLAP_SLACK_NS and first <= end + OVERLAP_SLACK_NS:
        return
    # A camera's clock that shows a local time is off by whole quarters of an hour.
    quarters = round((first + last - begin - end) / 2 / QUARTER_NS)
    shift_ns = quarters * QUARTER_NS
    is_local = 0 < abs(quarters) <= MAX_QUARTERS and begin <= first - shift_ns and last - shift_ns <= end
    raise InputError(
        f"pictures and telemetry do not overlap: pictures {_utc(first)} to {_utc(last)}, "
        f"telemetry {_utc(begin)} to {_utc(end)}"
        + (
            f"; if the camera's clock showed a local time: import with --utc-offset {quarters / 4:g}"
            if is_local
            else ""
        )
    )


def _utc(stamp_ns: int) -> str:
    return datetime.fromtimestamp(stamp_ns / 1e9, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
