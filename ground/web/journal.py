"""The journal of the link on the ground's disk: a server that is started again has the last hour back.

The files are those of `pc-ground record`: anything that reads recordings reads them. Old ones make room for new ones.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator
from pathlib import Path

from contract.errors import InputError
from contract.mcap_records import CHANNEL, MESSAGE, MESSAGE_HEAD, mapped, read_channel, records
from contract.topics import STATUS, TOPICS
from ground.link_recorder import LinkRecorder
from ground.watched_thread import WatchedThread

MAX_BYTES = 2_000_000_000  # of earlier flights, when the server is started
MIN_FREE_BYTES = 200_000_000
SYNC_S = 2.0

_READ = {topic.encoding for topic in TOPICS if topic is not STATUS}  # the state of before is of no use

Kept = tuple[str, str, bytes, int]
"""A message's key, its encoding, the message, and when it came (Unix ns)."""


class Journal:
    """A folder that `take` adds to. Raises InputError for one that cannot be used."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._recorder = LinkRecorder(folder)
        self.begun_unix_s = time.time()
        self._is_full = False
        _make_room(folder, MAX_BYTES)
        self._thread = WatchedThread("journal of the link", self._sync, SYNC_S)

    @property
    def error(self) -> str:
        """The reason why nothing is kept just now, in a line; empty while all is well."""
        return self._thread.trouble

    def take(self, key: str, payload: bytes) -> None:
        """One message of the link; from any thread."""
        if not self._is_full:
            self._recorder.take(key, payload)

    def recent(self, within_s: float) -> Iterator[tuple[Path, float, Iterator[Kept]]]:
        """The files of earlier runs whose last message came within so many seconds, the newest first, with its age (s).

        A file's own time states only when it was written: a copy of yesterday's is of today.
        """
        files = []
        for path in self.folder.glob("*.mcap"):
            if not self.begun_unix_s - within_s <= path.stat().st_mtime < self.begun_unix_s:
                continue
            last_s = max((came_ns for *_, came_ns in _messages(path)), default=0) / 1e9
            if self.begun_unix_s - within_s <= last_s < self.begun_unix_s:
                files.append((last_s, path))
        for last_s, path in sorted(files, reverse=True):
            yield path, max(time.time() - last_s, 0.0), _messages(path)

    def close(self) -> None:
        """Write what was taken to the disk, and end."""
        self._thread.close()
        self._recorder.__exit__(None, None, None)

    def _sync(self) -> None:
        self._is_full = shutil.disk_usage(self.folder).free < MIN_FREE_BYTES
        self._recorder.sync()
        if self._is_full:
            raise InputError(f"the disk of {self.folder} is nearly full: what crosses the link is not kept; free some")


def _messages(path: Path) -> Iterator[Kept]:
    """All messages of a file that can be read, as they came."""
    try:
        data = mapped(path)
    except InputError:
        return  # one that was begun in the moment of the end
    channels: dict[int, tuple[str, str]] = {}
    for opcode, start, length in records(data, lambda _: None):
        if opcode == CHANNEL:
            channel, topic, encoding = read_channel(bytes(data[start : start + length]))
            channels[channel] = topic, encoding
        elif opcode == MESSAGE and (data[start] | data[start + 1] << 8) in channels:
            topic, encoding = channels[data[start] | data[start + 1] << 8]
            if encoding in _READ:
                came_ns = MESSAGE_HEAD.unpack_from(data, start)[2]
                yield topic, encoding, bytes(data[start + MESSAGE_HEAD.size : start + length]), came_ns


def _make_room(folder: Path, most_bytes: int) -> None:
    """Delete the oldest files until the others take at most so many bytes."""
    files = sorted(folder.glob("*.mcap"), key=lambda path: path.stat().st_mtime, reverse=True)
    total = 0
    for path in files:
        total += path.stat().st_size
        if total > most_bytes:
            path.unlink(missing_ok=True)
