"""A flight for the bench: telemetry of tests/data, pictures rendered along it, both played in time with each other."""

import csv
import json
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from simulation.autopilot.fake import FakeAutopilot
from simulation.flight import RecordedSpec
from simulation.session import SessionSpec, fly
from simulation.terrain import TerrainSpec
from tests.bench.image import cache
from tests.bench.image.root import CHECKOUT
from tests.bench.machine import GUEST_CHECKOUT, INSIDE, PYTHON, SHARE, Job, Machine

BEGIN_S = 5.0
"""Into the recording: the autopilot is received for a while before the first picture."""
SECONDS = 30.0
RATE_HZ = 10
MOUNT_DEG = (0.0, -90.0, -90.0)
DELAY_NS = 15_000_000
"""From exposure to hand-over, as a camera reads out and transfers."""
LATE_S = 0.5


@dataclass(frozen=True)
class Flight:
    """A session's folder: what `pc-onboard replay` would read, with truth."""

    folder: Path
    stamps_unix_ns: NDArray[np.int64]
    """When each picture was taken, on the clock of the recording."""

    @property
    def pictures(self) -> list[NDArray[np.uint8]]:
        files = sorted((self.folder / "frames").iterdir())
        return [np.asarray(cv2.imread(str(file), cv2.IMREAD_GRAYSCALE), np.uint8) for file in files]


def rendered() -> Flight:
    """Fly it: 250 m above gentle hills at 20 m/s, straight for 20 s, then into a left turn.

    Kept in the bench's cache, under all that it is made from.
    """
    spec = SessionSpec(
        RecordedSpec("plane_turn", BEGIN_S),
        seconds=SECONDS,
        rate_hz=RATE_HZ,
        mount_deg=MOUNT_DEG,
        terrain=TerrainSpec(relief_m=10.0),
    )
    sources = [CHECKOUT / "tests" / "data" / "plane_turn.tlog", CHECKOUT / "tests" / "data" / "plane_turn.truth.csv"]
    sources += sorted([*(CHECKOUT / "simulation").glob("*.py"), *(CHECKOUT / "contract").glob("*.py")])
    key = cache.key_of(repr(spec), *(source.read_bytes() for source in sources))

    def build(work: Path) -> None:
        fly(spec, work / "session")

    folder = cache.artefact("flight", key, build) / "session"
    rows = list(csv.DictReader((folder / "stamps.csv").open()))
    return Flight(folder, np.array([round(float(row["unix_time_s"]) * 1e9) for row in rows]))


def as_format(grey: NDArray[np.uint8], fourcc: str) -> bytes:
    """A grey picture as a camera of this format hands it out."""
    if fourcc == "GREY":
        return grey.tobytes()
    if fourcc == "YUYV":
        return np.stack([grey, np.full_like(grey, 128)], axis=-1).tobytes()
    if fourcc == "NV12":
        return grey.tobytes() + bytes([128]) * (grey.size // 2)
    if fourcc == "Y16 ":
        return (grey.astype("<u2") * 257).tobytes()
    if fourcc == "MJPG":
        return cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_QUALITY, 90])[1].tobytes()
    raise ValueError(f"no such format here: {fourcc!r}")


def load(machine: Machine, flight: Flight, fourcc: str = "GREY") -> None:
    """Put the pictures where the guest's player reads them."""
    pictures = [as_format(picture, fourcc) for picture in flight.pictures]
    height_px, width_px = flight.pictures[0].shape
    (machine.share / "flight.raw").write_bytes(b"".join(pictures))
    description = {
        "fourcc": fourcc,
        "size_px": [width_px, height_px],
        "rate_hz": RATE_HZ,
        "bytes": [len(picture) for picture in pictures],
        "after_ns": (flight.stamps_unix_ns - flight.stamps_unix_ns[0]).tolist(),
        "delay_ns": DELAY_NS,
        "late_s": LATE_S,
    }
    (machine.share / "flight.json").write_text(json.dumps(description))


def play(machine: Machine, flight: Flight, autopilot: FakeAutopilot, device: str) -> tuple[Job, int]:
    """Start the pictures in time with an autopilot that plays already.

    Returns the player's job and when the first picture is taken, on the guest's CLOCK_MONOTONIC in ns.
    """
    here_ns, log_ns = autopilot.log_ns
    first_ns = here_ns + int(flight.stamps_unix_ns[0]) - log_ns + machine.clock_offset_ns()
    argv = [PYTHON, "-m", "tests.bench.guest.play", device, f"{SHARE}/flight.json", str(first_ns)]
    return machine.start(argv, timeout_s=120.0, cwd=GUEST_CHECKOUT, env=INSIDE), first_ns
