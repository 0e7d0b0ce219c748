"""Pictures played by GStreamer's RTSP server, with the true capture time of each."""

import json
import subprocess
import sys
import threading
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray

from tests.waiting import PATIENCE_S

SYSTEM_PYTHON = "/usr/bin/python3"
SERVER = Path(__file__).with_name("rtsp_server.py")
MARK_PX, BITS = 16, 12
PACKAGES = (
    "python3-gi gir1.2-gstreamer-1.0 gir1.2-gst-plugins-base-1.0 gir1.2-gst-rtsp-server-1.0 gstreamer1.0-plugins-base "
    "gstreamer1.0-plugins-good gstreamer1.0-plugins-bad gstreamer1.0-libav gstreamer1.0-libcamera"
)
_NEEDED = (
    "import gi; gi.require_version('GstRtspServer', '1.0'); from gi.repository import Gst, GstRtspServer; "
    "Gst.init(None); "
    "names = 'rtspsrc avdec_h264 avdec_h265 openh264enc x265enc h264parse h265parse libcamerasrc'.split(); "
    "assert all(Gst.ElementFactory.find(name) for name in names)"
)


def is_installed() -> bool:
    """Whether the system's Python has GStreamer, its RTSP server and what the tests encode with."""
    done = subprocess.run([SYSTEM_PYTHON, "-I", "-c", _NEEDED], capture_output=True, check=False)
    return done.returncode == 0


def marked(image: NDArray[np.uint8], number: int) -> NDArray[np.uint8]:
    """With a picture's number as light and dark squares along the upper edge, which compression does not harm."""
    out = image.copy()
    for bit in range(BITS):
        out[:MARK_PX, MARK_PX * bit : MARK_PX * (bit + 1)] = 235 if number >> bit & 1 else 20
    return out


def number_of(image: NDArray[np.uint8]) -> int:
    """What `marked` wrote."""
    middle = MARK_PX // 2
    return sum(int(image[middle, MARK_PX * bit + middle] > 128) << bit for bit in range(BITS))


def drifting_ground(count: int, size_px: tuple[int, int]) -> list[NDArray[np.uint8]]:
    """Pictures of a textured ground that passes by, with sensor noise, numbered."""
    width, height = size_px
    rng = np.random.default_rng(3)
    ground = cv2.GaussianBlur(rng.normal(0.0, 1.0, (height, width + 2 * count)).astype(np.float32), (0, 0), 3.0)
    ground = 128.0 + 40.0 * ground / ground.std()
    pictures = []
    for k in range(count):
        seen = ground[:, 2 * k : 2 * k + width] + rng.normal(0.0, 2.0, (height, width))
        pictures.append(marked(np.clip(seen, 0, 255).astype(np.uint8), k))
    return pictures


class RtspServer:
    """Plays pictures over and over; `url()` is where. Each client gets them from the first on."""

    def __init__(self, folder: Path, pictures: Sequence[NDArray[np.uint8]], rate_hz: float, **keys: object) -> None:
        height, width = pictures[0].shape
        frames = folder / "frames.raw"
        if not frames.exists():
            frames.write_bytes(b"".join(picture.tobytes() for picture in pictures))
        spec = {"frames": str(frames), "width": width, "height": height, "rate_hz": rate_hz, "codec": "H264", **keys}
        self._process = subprocess.Popen(
            [SYSTEM_PYTHON, "-I", str(SERVER)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.write(json.dumps(spec) + "\n")
        self._process.stdin.flush()
        self.port = int(self._process.stdout.readline())
        self.clients: list[dict[int, int]] = []
        self._has_client = threading.Event()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def url(self, scheme: str = "rtsp") -> str:
        return f"{scheme}://127.0.0.1:{self.port}/flight"

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            number, captured_ns = (int(word) for word in line.split())
            if number == 0:
                self.clients.append({})
            self.clients[-1][number] = captured_ns
            self._has_client.set()

    def wait_for_client(self, within_s: float) -> int | None:
        """CLOCK_MONOTONIC (ns) of the first picture that a client gets; None if none comes."""
        return self.clients[0][0] if self._has_client.wait(within_s) else None

    def stop(self) -> list[dict[int, int]]:
        """End it: capture times (CLOCK_MONOTONIC, ns) by number, for each of its clients in turn."""
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.close()
        self._process.wait(PATIENCE_S)
        self._reader.join(PATIENCE_S)
        self._process.stdout.close()
        return self.clients

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._process.poll() is None:
            self._process.kill()
        self._process.wait(PATIENCE_S)


if __name__ == "__main__":
    sys.exit(not is_installed())
