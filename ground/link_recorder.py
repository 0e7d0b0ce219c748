"""Recordings of what crosses the link: an MCAP file for each session of each vehicle, readable by `Recording`.

Without chunks, and each message is passed to the system at once: a killed process loses nothing. A file's name is made
of the vehicle's and the session's, cleaned: a publisher may use any name.
"""

from __future__ import annotations

import os
import re
import threading
import time
from pathlib import Path
from types import TracebackType
from typing import IO, Any

from contract import recording_format as names
from contract.errors import InputError, WireError
from contract.secrets import new_recording
from contract.topics import FEATURES
from contract.wire.message import SETS, payload_of
from ground.dropped_messages import DroppedMessages

MAX_FILES = 50  # at once: a peer may invent vehicles
SYNC_PERIOD_S = 2.0
_UNSAFE = re.compile(r"[^A-Za-z0-9_-]")


class LinkRecorder:
    """A folder of recordings. `take` is for any thread. Raises InputError for a folder that cannot be used."""

    def __init__(self, folder: Path) -> None:
        try:
            import mcap.writer  # noqa: F401, PLC0415  of the extra `record`
        except ImportError as error:
            raise InputError(
                "this needs the package mcap: install pointclick with its extra [record] (README)"
            ) from error
        self._folder = folder
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"recording into {folder}: {error.strerror}") from error
        self._lock = threading.Lock()
        self._files: dict[tuple[str, int], _File] = {}
        self._current: dict[str, int] = {}  # each vehicle's session, by its newest set or status
        self._synced_s = time.monotonic()
        self._messages = self._left_out = 0
        self._dropped = DroppedMessages("none of ours")
        self._failure: InputError | None = None

    @property
    def words(self) -> str:
        with self._lock:
            left = [f"{self._left_out} messages of no session were left out"] if self._left_out else []
            found = ", ".join(sorted(str(f.path) for f in self._files.values()))
            kept = f"{self._messages} messages in {found}" if found else "nothing received yet"
            return "; ".join([kept, *left, *self._dropped.lines()])

    def take(self, key: str, payload: bytes) -> None:
        """One message of the link. What is no message of a vehicle is counted and left out."""
        with self._lock:
            try:
                self._take(key, payload)
            except (ValueError, WireError) as error:
                self._dropped.failed(error)
            except OSError as error:
                self._failure = InputError(f"recording into {self._folder}: {error.strerror}")

    def _take(self, key: str, payload: bytes) -> None:
        came_ns = time.time_ns()
        before, _, name = key.rpartition("/")
        vehicle, kind = FEATURES.vehicle(f"{before}/features"), payload_of(key)
        if kind is None:
            session, at_ns, encoding = self._current.get(vehicle, 0), came_ns, name
        else:
            (session, at_ns), encoding = kind.stamp_of(key, payload), kind.topic.encoding
        if kind is SETS:
            self._current[vehicle] = max(session, self._current.get(vehicle, 0))
        if not session:
            self._left_out += 1  # before the first session nothing can be clicked
            return
        file = self._files.get((vehicle, session))
        if file is None:
            if len(self._files) >= MAX_FILES:
                self._left_out += 1
                return
            file = self._files[vehicle, session] = _File(self._new_path(vehicle, session), vehicle)
        file.write(key, encoding, came_ns, at_ns, payload)
        self._messages += 1

    def _new_path(self, vehicle: str, session: int) -> Path:
        """The next part of this session that is not there: a recording that is begun again adds to what there is."""
        base = f"{_UNSAFE.sub('_', vehicle)[:60]}-{session}"
        part = 1
        while (path := self._folder / names.part_name(base, part)).exists():
            part += 1
        return path

    def sync(self) -> None:
        """Put on the disk what was written, once in SYNC_PERIOD_S at most. Raises InputError if writing failed."""
        with self._lock:
            if self._failure is not None:
                raise self._failure
            if time.monotonic() - self._synced_s < SYNC_PERIOD_S:
                return
            self._synced_s = time.monotonic()
            for file in self._files.values():
                file.sync()

    def __enter__(self) -> LinkRecorder:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        with self._lock:
            for file in self._files.values():
                file.close()


class _File:
    """One MCAP file."""

    def __init__(self, path: Path, vehicle: str) -> None:
        from mcap.writer import CompressionType, Writer  # noqa: PLC0415

        self.path = path
        self._stream: IO[bytes] = new_recording(path)
        self._writer: Any = Writer(self._stream, use_chunking=False, compression=CompressionType.NONE)
        self._writer.start(profile="", library="pointclick ground")
        about = {"vehicle": vehicle, "recorder": "ground", "part": "1", "complete": "no"}
        self._writer.add_metadata(names.METADATA_NAME, about)
        self._channels: dict[str, int] = {}
        self._count = 0

    def write(self, key: str, encoding: str, came_ns: int, at_ns: int, payload: bytes) -> None:
        if key not in self._channels:
            self._channels[key] = self._writer.register_channel(topic=key, message_encoding=encoding, schema_id=0)
        self._count += 1
        self._writer.add_message(self._channels[key], came_ns, payload, at_ns, self._count)
        self._stream.flush()

    def sync(self) -> None:
        os.fsync(self._stream.fileno())

    def close(self) -> None:
        self._writer.finish()
        self._stream.flush()
        os.fsync(self._stream.fileno())
        self._stream.close()
