"""The recording as the daemon's sink: a session's files one after the other, in a thread of its own.

What is handed over waits in a bounded queue, so that neither a picture's compression nor a slow disk holds up the
pipeline; if the disk falls behind, what the queue cannot take is dropped at once, and a gap record stands in its place.
A disk that is full or fails is a fault to report, not to die of: sets are published all the same, and recording goes on
when there is room again.
"""

from __future__ import annotations

import contextlib
import importlib.metadata
import logging
import math
import os
import struct
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Self

from contract import recording_format as names
from contract.camera import Camera
from contract.errors import InputError
from contract.feature_set import FeatureSet
from contract.supervised_thread import Policy, SupervisedThread, ThreadState
from contract.topics import FEATURES, Topic
from contract.wire.codec import encode
from onboard.config.schema import Config
from onboard.events.session_clock import SessionClock
from onboard.events.types import Event, Frame
from onboard.storage.mcap_writer import SessionRecorder
from onboard.storage.recording_queue import EVENTS, PICTURES, Entry, Gap, RecordingQueue, counted

SYNC_S = 0.5  # between writes to the disk itself: what a loss of power may cost, with what the disk takes
RETRY_S, MAX_RETRY_S = 5.0, 60.0
STEADY_S = 60.0  # a file that fails earlier than this after a failure failed of the same thing
REPEAT_S = 60.0  # between lines of the log about one thing
MAX_WAITING = 4096
MAX_WAITING_BYTES = 64_000_000  # of pictures, not yet compressed
BEHIND_S = 2.0  # after the last drop, until the disk is reported to keep up again
LATE_S = 10.0  # in one write: the disk hangs
CLOSE_SILENT_S, CLOSE_S = 3.0, 8.0  # at the end: with a disk that takes nothing more, and with one that is slow
MEGABYTE = 1_000_000
# Exceptions of encoding a set in which a number has no place on the wire.
UNENCODABLE = (ValueError, ArithmeticError, struct.error)

log = logging.getLogger("pointclick")


def free_bytes(folder: Path) -> int:
    """The number of bytes that an ordinary user may still write there. Raises OSError."""
    system = os.statvfs(folder)
    return system.f_bavail * system.f_frsize


def software_version() -> str:
    """The installed version; empty when run from a checkout."""
    try:
        return importlib.metadata.version("pointclick")
    except importlib.metadata.PackageNotFoundError:
        return ""


class NoRoom(InputError):
    """The disk has less free than is to be kept."""


class Recorded:
    """Writes `FOLDER/YYYYmmddTHHMMSSZ-VEHICLE.001.mcap`, then `.002.mcap` and so on, as `recording` specifies.

    For the daemon: one of the sinks, entered before the first event; `report` takes each message of a report, from
    any thread. `state_json` is the state file's text as the session began with it: without it a replay would begin with
    less knowledge, and end with other bytes. `fault` is why nothing is recorded just now.
    """

    def __init__(
        self,
        folder: Path,
        config: Config,
        camera: Camera,
        clock: SessionClock,
        config_text: str,
        state_json: str = "",
        second: Camera | None = None,
        free: Callable[[Path], int] = free_bytes,
        retry_s: float = RETRY_S,
    ) -> None:
        self._folder, self._config, self._clock, self._free = folder, config, clock, free
        self._config_text, self._camera_json, self._state_json = config_text, camera.to_json(), state_json
        self._second_json = "" if second is None else second.to_json()
        self._retry_s = retry_s
        self._session = ""
        self._part = 0
        self._is_complete = True
        self._recorder: SessionRecorder | None = None
        self._synced_s = self._failed_s = 0.0
        self._resumed_s = self._reported_s = self._unencodable_s = self._drops_reported_s = -math.inf
        self._pause_s = retry_s
        self._fault = ""
        self._is_reported = False  # the fault, in the log
        self._missing: Gap | None = None  # not yet in a file
        self._queue = RecordingQueue(MAX_WAITING, MAX_WAITING_BYTES)
        self._dropped_s = -math.inf
        self.unencodable = 0  # sets left out because they have no encoding
        self.thread = SupervisedThread("recording", self._run, Policy.RESTART, late_after_s=LATE_S)

    @property
    def fault(self) -> str:
        """The reason why nothing, or not everything, is recorded; empty while all is well."""
        state = self.thread.report().state
        if state in (ThreadState.LATE, ThreadState.RESTARTING, ThreadState.FAILED):
            what = "the disk takes nothing" if state is ThreadState.LATE else f"its thread is {state.value}"
            return f"recording {self._folder}: {what}"
        if not self._fault and self._now_s() - self._dropped_s < BEHIND_S:
            return f"recording {self._folder}: the disk does not keep up"
        return self._fault

    @property
    def dropped(self) -> int:
        """Records dropped because the disk did not keep up."""
        return self._queue.dropped

    def __enter__(self) -> Self:
        self.thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Write what waits, and the end of the file. Raises InputError if the disk does not take it in time."""
        self.thread.end()
        self._queue.close()
        deadline_s = time.monotonic() + CLOSE_S
        while not self.thread.join(0.05):
            if time.monotonic() > deadline_s or self.thread.heartbeat_age_s > CLOSE_SILENT_S:
                raise InputError(f"recording {self._folder}: the disk did not take the end of it")

    def event(self, arrival_ns: int, event: Event) -> None:
        """Record an event as it enters the pipeline; never waits."""
        if isinstance(event, Frame) and event.image is not None:
            self._put(Entry(PICTURES.many, arrival_ns, _held_bytes(event), lambda f: f.write_event(event, arrival_ns)))
        else:
            self._put(Entry(EVENTS.many, arrival_ns, 0, lambda file: file.write_event(event, arrival_ns)))

    def second_picture(self, frame: Frame) -> None:
        self._put(Entry(PICTURES.many, frame.stamp_ns, _held_bytes(frame), lambda f: f.write_second_picture(frame)))

    def feature_set(self, output: FeatureSet) -> None:
        self._put(Entry(counted(FEATURES).many, output.capture_unix_ns, 0, lambda file: _write_set(file, output)))

    def report(self, topic: Topic, stamp_ns: int, payload: bytes) -> None:
        self._put(Entry(counted(topic).many, stamp_ns, 0, lambda file: file.write_report(topic, stamp_ns, payload)))

    def _now_s(self) -> float:
        return self._clock.now_ns() / 1e9

    def _put(self, entry: Entry) -> None:
        if not self._queue.put(entry):
            self._dropped_s = self._now_s()

    def _run(self, thread: SupervisedThread) -> None:
        while not self._queue.is_over:
            thread.beat()
            self._work(self._queue.get(SYNC_S))
        thread.beat()
        self._finish_file()

    def _work(self, found: Entry | Gap | None) -> None:
        if isinstance(found, Gap):
            self._miss(found)
            self._report_drops()
            found = None
        is_written = found is None
        try:
            recorder = self._ready() if found is not None else self._recorder
            if recorder is None:
                if found is not None:
                    self._miss(found.missing(self._fault or "no file"))
                self._report_fault()
                return
            if found is not None:
                self._write_gap(recorder)
                self._write(found, recorder)
                is_written = True
            self._look_after(recorder)
        except NoRoom as error:
            self._give_up(error, self._retry_s)
            self._finish_file()
        except (
            Exception
        ) as error:  # a bug in a writer must cost the file and not the thread: status would not report it
            if not isinstance(error, InputError):
                log.error("the recording failed", exc_info=error)
            # A file that failed again so soon is the same fault: each try leaves a small file behind.
            is_again = self._now_s() - self._resumed_s < STEADY_S and not self._fault
            self._give_up(error, min(2.0 * self._pause_s, MAX_RETRY_S) if is_again else self._pause_s)
            self._abandon_file()
        else:
            self._recovered(recorder)
        if found is not None and not is_written:
            self._miss(found.missing(self._fault))

    def _write(self, entry: Entry, recorder: SessionRecorder) -> None:
        """Into the file; a set that has no encoding leaves a gap."""
        try:
            entry.write(recorder)
        except _Unencodable as error:
            self.unencodable += 1
            self._miss(entry.missing("it cannot be encoded"))
            if self._now_s() - self._unencodable_s >= REPEAT_S:
                self._unencodable_s = self._now_s()
                log.error("recording %s: %s (%d so far)", recorder.path, error, self.unencodable)

    def _write_gap(self, recorder: SessionRecorder) -> None:
        if self._missing is not None:
            recorder.write_gap(self._missing.begin_ns, self._missing.end_ns, self._missing.to_json())
            self._missing = None

    def _miss(self, gap: Gap) -> None:
        self._missing = gap if self._missing is None else self._missing.and_then(gap)
        self._is_complete = False

    def _ready(self) -> SessionRecorder | None:
        """The file being written; a new one if there is none, there is room, and the last failure is a while ago."""
        if self._recorder is not None:
            return self._recorder
        now_s = self._now_s()
        if now_s - self._failed_s < self._pause_s:
            return None
        with contextlib.suppress(OSError):  # the check reports it better
            self._folder.mkdir(parents=True, exist_ok=True)
        self._check_room()
        if not self._session:
            self._session = _unused(self._folder, self._clock.now_ns(), self._config.vehicle.id)
        self._part += 1
        self._recorder = SessionRecorder(
            self._folder / names.part_name(self._session, self._part),
            self._config.vehicle.id,
            config_text=self._config_text,
            camera_json=self._camera_json,
            second_camera_json=self._second_json,
            software_version=software_version(),
            state_json=self._state_json,
            pictures=self._config.recording.pictures,
            part=self._part,
            is_complete=self._is_complete,
        )
        return self._recorder

    def _look_after(self, recorder: SessionRecorder) -> None:
        """Onto the disk twice a second, with a look at its room; a new file when this one is large enough."""
        if self._now_s() - self._synced_s >= SYNC_S:
            recorder.sync()
            self._synced_s = self._now_s()
            self._check_room()
        if recorder.size_bytes >= self._config.recording.rotate_mb * MEGABYTE:
            self._recorder = None
            recorder.close()

    def _check_room(self) -> None:
        try:
            free_mb = self._free(self._folder) / MEGABYTE
        except OSError as error:
            raise InputError(f"recording {self._folder}: {error.strerror}") from error
        keep_mb = self._config.recording.keep_free_mb
        if free_mb < keep_mb:
            raise NoRoom(
                f"recording {self._folder}: {free_mb:.0f} MB free, less than recording.keep_free_mb = {keep_mb:g}"
            )

    def _give_up(self, error: Exception, pause_s: float) -> None:
        """Open no file for `pause_s`. A fault that comes back soon is logged once a minute, however often it does."""
        if not self._fault:
            self._is_reported = False
        self._fault = str(error) or type(error).__name__
        self._failed_s, self._pause_s, self._is_complete = self._now_s(), pause_s, False
        self._report_fault()

    def _report_drops(self) -> None:
        if self._now_s() - self._drops_reported_s >= REPEAT_S:
            self._drops_reported_s = self._now_s()
            log.warning(
                "recording %s: the disk does not keep up: %d records left out so far", self._folder, self.dropped
            )

    def _report_fault(self) -> None:
        if self._fault and not self._is_reported and self._now_s() - self._reported_s >= REPEAT_S:
            log.error("%s; recording stops until there is room", self._fault)
            self._is_reported, self._reported_s = True, self._now_s()

    def _recovered(self, recorder: SessionRecorder) -> None:
        if self._fault:
            if self._is_reported:
                log.info("recording again, %s", recorder.path)
            self._fault, self._resumed_s = "", self._now_s()
        elif self._now_s() - self._resumed_s >= STEADY_S:
            self._pause_s = self._retry_s

    def _abandon_file(self) -> None:
        recorder, self._recorder = self._recorder, None
        if recorder is not None:
            recorder.abandon()
            if not recorder.has_message:
                self._part -= 1  # nothing of it is left

    def _finish_file(self) -> None:
        recorder, self._recorder = self._recorder, None
        if recorder is not None:
            try:
                self._write_gap(recorder)
                recorder.close()
            except InputError as error:  # what is in it can be read without its end
                log.error("%s", error)


def _held_bytes(frame: Frame) -> int:
    return sum(0 if part is None else part.nbytes for part in (frame.image, frame.counts))


class _Unencodable(Exception):
    """A set that has no encoding: nothing of it was written."""


def _write_set(recorder: SessionRecorder, output: FeatureSet) -> None:
    try:
        payload = encode(output)
    except UNENCODABLE as error:
        raise _Unencodable(f"the set of frame {output.frame} cannot be encoded: {error}") from error
    recorder.write_set(output, payload)


def _unused(folder: Path, now_ns: int, vehicle: str) -> str:
    """A name for the session that no other has, even one begun in the same second."""
    name = f"{datetime.fromtimestamp(now_ns / 1e9, UTC):%Y%m%dT%H%M%SZ}-{vehicle}"
    session, number = name, 2
    while (folder / names.part_name(session, 1)).exists():
        session, number = f"{name}-{number}", number + 1
    return session
