"""A simulated flight in real time: its pictures from an RTSP server, its autopilot's messages over UDP."""

import csv
import socket
import struct
import threading
import time
from pathlib import Path
from types import TracebackType
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray

from tests.rtsp import BITS, MARK_PX, RtspServer, marked
from tests.waiting import PATIENCE_S


def telemetry_of(session: Path) -> list[tuple[float, bytes]]:
    """The messages of a session's log, each with the Unix time at which it came."""
    data, at, out = (session / "telemetry.tlog").read_bytes(), 0, []
    while at < len(data):
        (stamp_us,) = struct.unpack_from(">Q", data, at)
        length = data[at + 9]
        signature = 13 if data[at + 10] & 1 else 0
        size = 12 + length + signature if data[at + 8] == 0xFD else 8 + length
        out.append((stamp_us / 1e6, data[at + 8 : at + 8 + size]))
        at += 8 + size
    return out


def pictures_of(session: Path, is_marked: bool) -> list[NDArray[np.uint8]]:
    """A session's pictures in order, numbered in their upper edge if asked."""
    found = []
    for number, path in enumerate(sorted((session / "frames").iterdir())):
        image = np.asarray(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), np.uint8)
        found.append(marked(image, number) if is_marked else image)
    return found


def write_mask(path: Path, size_px: tuple[int, int]) -> Path:
    """Black where `marked` writes."""
    mask = np.full((size_px[1], size_px[0]), 255, np.uint8)
    mask[: MARK_PX + 2, : MARK_PX * BITS + 2] = 0
    assert cv2.imwrite(str(path), mask)
    return path


class StreamedFlight:
    """Serves pictures at once; the flight, and with it the telemetry, begins with the first client."""

    def __init__(
        self, session: Path, folder: Path, rate_hz: float, udp_port: int, is_marked: bool = False, **keys: object
    ) -> None:
        with (session / "stamps.csv").open(newline="") as stream:
            self._first_unix_s = float(next(csv.DictReader(stream))["unix_time_s"])
        self._messages = telemetry_of(session)
        self._to = ("127.0.0.1", udp_port)
        self.server = RtspServer(folder, pictures_of(session, is_marked), rate_hz, **keys)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._send, daemon=True)

    def _send(self) -> None:
        began_ns = self.server.wait_for_client(PATIENCE_S)
        if began_ns is None:
            return
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as radio:
            for unix_s, message in self._messages:
                due_s = began_ns / 1e9 + unix_s - self._first_unix_s
                if due_s < time.monotonic() - 1.0:
                    continue  # before the first picture: a link that just came up
                if self._ended.wait(max(due_s - time.monotonic(), 0.0)):
                    return
                radio.sendto(message, self._to)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended.set()
        self._thread.join(PATIENCE_S)
        self.server.__exit__(kind, error, trace)
