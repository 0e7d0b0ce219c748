"""The link's messages, written as they come into a telemetry log that any ground station reads."""

from __future__ import annotations

import os
import shutil
import struct
from datetime import UTC, datetime
from pathlib import Path
from typing import BinaryIO

from contract.secrets import new_recording

FLUSH_NS = 1_000_000_000
SPACE_NS = 10_000_000_000


class TlogWriter:
    """One file a session, begun with its first packet. Never in the way of the flight: a fault ends it, and is kept."""

    def __init__(self, folder: Path | str, keep_free_mb: float) -> None:
        self._folder = Path(folder)
        self._keep_free = keep_free_mb * 1e6
        self._stream: BinaryIO | None = None
        self._flushed_ns = self._looked_ns = 0
        self.path: Path | None = None
        self.fault = ""

    def write(self, arrival_ns: int, packet: bytes) -> None:
        """Add one packet at its arrival (Unix ns)."""
        if self.fault:
            return
        try:
            stream = self._stream or self._begin(arrival_ns)
            stream.write(struct.pack(">Q", arrival_ns // 1000) + packet)
            if arrival_ns - self._flushed_ns > FLUSH_NS:
                self._flushed_ns = arrival_ns
                stream.flush()
            if arrival_ns - self._looked_ns > SPACE_NS:
                self._looked_ns = arrival_ns
                if shutil.disk_usage(self._folder).free < self._keep_free:
                    self._end("the disk is nearly full")
        except OSError as error:
            self._end(error.strerror or str(error))

    def close(self) -> None:
        if self._stream is not None:
            stream, self._stream = self._stream, None
            try:
                stream.flush()
                os.fsync(stream.fileno())
                stream.close()
            except OSError as error:
                self.fault = error.strerror or str(error)

    def _begin(self, arrival_ns: int) -> BinaryIO:
        self._folder.mkdir(parents=True, exist_ok=True)
        name = datetime.fromtimestamp(arrival_ns / 1e9, UTC).strftime("%Y%m%dT%H%M%SZ")
        number = 0
        while True:
            self.path = self._folder / (f"{name}.tlog" if not number else f"{name}-{number}.tlog")
            try:
                self._stream = new_recording(self.path)
            except FileExistsError:
                number += 1
                continue
            return self._stream

    def _end(self, fault: str) -> None:
        self.fault = fault
        self.close()
        self.fault = fault
