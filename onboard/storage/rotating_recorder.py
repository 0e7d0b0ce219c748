"""The recording as the daemon's sink: a session's files one after the other, in a thread of its own.

What is handed over waits in a queue, so that neither a picture's compression nor a slow disk holds up the pipeline; if
the disk falls behind for good, the pipeline is made to wait, which sheds pictures before they are recorded. A full disk
is a fault to report, not to die of: sets are published all the same, and recording goes on when there is room again.
"""

from __future__ import annotations

import contextlib
import importlib.metadata
import logging
import os
import threading
from collections import deque
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Self

from contract import recording_format as names
from contract.camera import Camera
from contract.errors import InputError
from contract.feature_set import FeatureSet
from onboard.config.schema import Config
from onboard.events.session_clock import SessionClock
from onboard.events.types import Event, Frame
from onboard.storage.mcap_writer import SessionRecorder

SYNC_S = 0.5  # between writes to the disk itself: what a loss of power may cost, with what the disk takes
RETRY_S = 5.0
MAX_WAITING = 4096
MAX_WAITING_BYTES = 64_000_000  # of pictures, not yet compressed
PATIENCE_S = 2.0  # with a disk that does not keep up
MEGABYTE = 1_000_000

log = logging.getLogger("pointclick")
Write = Callable[[SessionRecorder], None]


def free_bytes(folder: Path) -> int:
    """What an ordinary user may still write there. Raises OSError."""
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
    """Writes `FOLDER/YYYYmmddTHHMMSSZ-VEHICLE.001.mcap`, then `.002.mcap` and so on, as the section `recording` says.

    For the daemon: one of the sinks, entered before the first event; `status` takes each encoded status, from any
    thread. `state_json` is the state file's text as the session began with it: without it a replay would begin with
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
        free: Callable[[Path], int] = free_bytes,
        retry_s: float = RETRY_S,
    ) -> None:
        self._folder, self._config, self._clock, self._free = folder, config, clock, free
        self._config_text, self._camera_json, self._state_json = config_text, camera.to_json(), state_json
        self._retry_s = retry_s
        self._session = ""
        self._part = 0
        self._is_complete = True
        self._recorder: SessionRecorder | None = None
        self._synced_s = self._failed_s = 0.0
        self._fault = ""
        self._waiting: deque[tuple[int, Write]] = deque()
        self._waiting_bytes = 0
        self._is_over = False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="recording", daemon=True)

    @property
    def fault(self) -> str:
        """Why nothing is recorded; empty while all is well."""
        return self._fault

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Write what waits, and the end of the file."""
        with self._changed:
            self._is_over = True
            self._changed.notify_all()
        self._thread.join()

    def event(self, arrival_ns: int, event: Event) -> None:
        """Record an event as it enters the pipeline."""
        size = event.image.nbytes if isinstance(event, Frame) and event.image is not None else 0
        self._put(size, lambda recorder: recorder.write_event(event, arrival_ns))

    def feature_set(self, output: FeatureSet) -> None:
        """Record a set."""
        self._put(0, lambda recorder: recorder.write_set(output))

    def status(self, stamp_ns: int, payload: bytes) -> None:
        """Record an encoded status."""
        self._put(0, lambda recorder: recorder.write_status(stamp_ns, payload))

    def _now_s(self) -> float:
        return self._clock.now_ns() / 1e9

    def _put(self, size: int, write: Write) -> None:
        with self._changed:
            if not self._changed.wait_for(self._has_room, PATIENCE_S):
                self._fault = self._fault or f"recording {self._folder}: the disk does not keep up"
                self._is_complete = False  # of what follows
                return
            self._waiting.append((size, write))
            self._waiting_bytes += size
            self._changed.notify_all()

    def _has_room(self) -> bool:
        return len(self._waiting) < MAX_WAITING and self._waiting_bytes < MAX_WAITING_BYTES

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._is_over, SYNC_S)
                if self._is_over and not self._waiting:
                    break
                size, write = self._waiting.popleft() if self._waiting else (0, None)
                self._waiting_bytes -= size
                self._changed.notify_all()
            self._work(write)
        self._finish_file()

    def _work(self, write: Write | None) -> None:
        try:
            recorder = self._ready() if write is not None else self._recorder
            if recorder is None:
                self._is_complete = self._is_complete and write is None
                return
            if write is not None:
                write(recorder)
            self._look_after(recorder)
        except NoRoom as error:
            self._give_up(error)
            self._finish_file()
        except InputError as error:
            self._give_up(error)
            recorder, self._recorder = self._recorder, None
            if recorder is not None:
                recorder.abandon()
        else:
            if self._fault:
                log.info("recording again, %s", recorder.path)
                self._fault = ""

    def _ready(self) -> SessionRecorder | None:
        """The file being written; a new one if there is none, there is room, and the last failure is a while ago."""
        if self._recorder is not None:
            return self._recorder
        now_s = self._now_s()
        if now_s - self._failed_s < self._retry_s:
            return None
        with contextlib.suppress(OSError):  # the check says it better
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

    def _give_up(self, error: InputError) -> None:
        if not self._fault:
            log.error("%s; recording stops until there is room", error)
        self._fault, self._failed_s, self._is_complete = str(error), self._now_s(), False

    def _finish_file(self) -> None:
        recorder, self._recorder = self._recorder, None
        if recorder is not None:
            try:
                recorder.close()
            except InputError as error:  # what is in it can be read without its end
                log.error("%s", error)


def _unused(folder: Path, now_ns: int, vehicle: str) -> str:
    """A name for the session that no other has, even one begun in the same second."""
    name = f"{datetime.fromtimestamp(now_ns / 1e9, UTC):%Y%m%dT%H%M%SZ}-{vehicle}"
    session, number = name, 2
    while (folder / names.part_name(session, 1)).exists():
        session, number = f"{name}-{number}", number + 1
    return session
