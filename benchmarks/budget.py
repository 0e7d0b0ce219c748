"""What a picture costs, as counts that carry over to other computers: stage by stage over one raw Lucas-Kanade call of
the same picture, and in instructions.

    python -m benchmarks.budget [--pictures 240] [--sizes 640x480 ...] [--features 100 ...] [--instructions]

The flight is the one that `pc-onboard bench` makes up. Raw LK is `cv2.calcOpticalFlowPyrLK` of consecutive pictures at
100 points on a lattice, window 21, three levels, timed at every picture between the pipeline's calls, so that both have
the same conditions. "Standing" is the part of tracking that looks for what stands still in the picture, as the mean of
all pictures and of those that are compared with an earlier one. `--instructions` runs twice under valgrind, once with
more pictures, and divides the difference of the instructions by that of the pictures: start and imports fall out. By
stage they are not counted: perf has no counters in a virtual machine, and valgrind does not see Python's functions.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path
from typing import ClassVar
from unittest import mock

from benchmarks.machine import describe, load, table

# isort: split
import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.pipeline import resident_bytes
from contract.camera import Camera
from onboard.config.schema import Config
from onboard.events.types import Event, Frame
from onboard.replay.load import WARM_UP, Load, measure
from onboard.replay.made_flight import MadeFlight
from onboard.vision import klt_tracker
from onboard.vision.contrast_normalisation import Picture
from onboard.vision.klt_tracker import LEVELS, WINDOW_PX
from onboard.vision.standing_parts import StandingParts

Array = NDArray[np.float64]

STAGES = ("navigation", "tracking", "georeference", "solve", "encode", "other")
LK_POINTS = (10, 10)
FIELD_OF_VIEW_DEG = 60.0
INSTRUCTION_PICTURES = (120, 60)
_REFERENCES = re.compile(r"I +refs: +([\d,]+)")


class RawLk:
    """Passes events on, and times raw LK of each picture and the one before."""

    def __init__(self, camera: Camera) -> None:
        u, v = (np.linspace(0.1, 0.9, n) * size for n, size in zip(LK_POINTS, camera.size_px, strict=True))
        self._points = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 1, 2).astype(np.float32)
        self.times_us: list[float] = []

    def between(self, events: Iterator[tuple[int, Event]]) -> Iterator[tuple[int, Event]]:
        """The same events."""
        before = None
        for moment_ns, event in events:
            if isinstance(event, Frame) and event.image is not None:
                if before is not None:
                    began = time.thread_time_ns()
                    window = (WINDOW_PX, WINDOW_PX)
                    cv2.calcOpticalFlowPyrLK(
                        before, event.image, self._points, self._points.copy(), winSize=window, maxLevel=LEVELS
                    )
                    self.times_us.append((time.thread_time_ns() - began) / 1e3)
                before = event.image
            yield moment_ns, event


class TimedStandingParts(StandingParts):
    """Looks for what stands still: of each picture the time, us, and whether it was compared with an earlier one."""

    seen: ClassVar[list[tuple[float, bool]]] = []

    def see(self, image: Picture, motions: Sequence[Array | None]) -> bool:
        """Take the picture as the base class does, and note the time."""
        before, began = self._reference, time.thread_time_ns()
        out = super().see(image, motions)
        self.seen.append(((time.thread_time_ns() - began) / 1e3, self._reference is not before))
        return out

    @classmethod
    def mean_us(cls) -> tuple[float, float]:
        """The mean times of all pictures, and of those that were compared (NaN if none was)."""
        times, compared = (np.array(column) for column in zip(*cls.seen[WARM_UP:], strict=True))
        return float(times.mean()), float(times[compared.astype(bool)].mean()) if compared.any() else float("nan")


def prepared(size_px: tuple[int, int], features: int) -> tuple[MadeFlight, Camera]:
    """A flight with so large pictures and so many features."""
    camera = Camera.from_field_of_view(*size_px, FIELD_OF_VIEW_DEG)
    config = Config()
    config = config.model_copy(update={"tracking": config.tracking.model_copy(update={"features": features})})
    return MadeFlight(config, camera), camera


def simulated(size_px: tuple[int, int], features: int, pictures: int) -> tuple[Load, float, float]:
    """A flight's load, the median of raw LK, us, and this process's memory at the end, MB (with simulated ground)."""
    made, camera = prepared(size_px, features)
    lk = RawLk(camera)
    TimedStandingParts.seen.clear()
    with mock.patch.object(klt_tracker, "StandingParts", TimedStandingParts):
        found = measure(made.config, camera, lk.between(made.events()), lambda n: n >= pictures)
    return found, float(np.median(lk.times_us[WARM_UP:])), resident_bytes() / 1e6


def report(sizes: Sequence[tuple[int, int]], features: Sequence[int], pictures: int) -> str:
    """The table, a row for each size and number of features."""
    rows = []
    for size_px, count in product(sizes, features):
        found, lk_us, memory_mb = simulated(size_px, count, pictures)
        ratios = [1e3 * found.stage_ms.get(stage, 0.0) / lk_us for stage in STAGES]
        standing = (us / lk_us for us in TimedStandingParts.mean_us())
        rows.append(
            [
                f"{size_px[0]}x{size_px[1]}, {count}",
                f"{lk_us / 1e3:.2f}",
                *(f"{ratio:.2f}" for ratio in ratios),
                f"{1e3 * found.picture_ms / lk_us:.2f}",
                *(f"{ratio:.2f}" for ratio in standing),
                f"{found.solved}/{found.replayed}",
                f"{memory_mb:.0f}",
            ]
        )
    heads = ["picture, features", "raw LK, ms", *STAGES, "all", "standing", "a pair", "solved", "memory, MB"]
    return table(heads, rows)


def instructions(size_px: tuple[int, int], features: int) -> float:
    """Millions a picture, both threads, without what draws it. Raises FileNotFoundError without valgrind."""
    if shutil.which("valgrind") is None:
        raise FileNotFoundError("valgrind is not there: apt-get install valgrind")
    size = f"{size_px[0]}x{size_px[1]}"
    more, few = INSTRUCTION_PICTURES
    simulated, sampled = (
        _counted(work, size, features, more) - _counted(work, size, features, few) for work in ("fly", "draw")
    )
    return (simulated - sampled) / (more - few) / 1e6


def _counted(work: str, size: str, features: int, pictures: int) -> int:
    asked = ["--only", work, "--sizes", size, "--features", str(features), "--pictures", str(pictures)]
    command = ["valgrind", "--tool=cachegrind", "--cache-sim=no", "--cachegrind-out-file=/dev/null", sys.executable]
    done = subprocess.run(
        [*command, "-m", "benchmarks.budget", *asked],
        cwd=Path(__file__).resolve().parents[1], capture_output=True, text=True, check=True,
    )  # fmt: skip
    found = _REFERENCES.search(done.stderr)
    if found is None:
        raise ValueError(f"valgrind said: {done.stderr[-500:]}")
    return int(found[1].replace(",", ""))


def only(work: str, size_px: tuple[int, int], features: int, pictures: int) -> None:
    """Do the work that valgrind counts: fly some pictures, or only draw them."""
    made, camera = prepared(size_px, features)
    if work == "fly":
        measure(made.config, camera, made.events(), lambda n: n >= pictures)
        return
    for _, event in made.events():
        if isinstance(event, Frame) and event.index + 1 >= pictures:
            return


def _pair(text: str) -> tuple[int, int]:
    width, height = text.split("x")
    return int(width), int(height)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pictures", type=int, default=240)
    parser.add_argument("--sizes", type=_pair, nargs="+", default=[(640, 480), (1280, 960), (1920, 1080)])
    parser.add_argument("--features", type=int, nargs="+", default=[50, 100, 200])
    parser.add_argument("--instructions", action="store_true", help="with valgrind: some minutes a size")
    parser.add_argument("--only", choices=["fly", "draw"], help=argparse.SUPPRESS)
    args = parser.parse_args()
    cv2.setNumThreads(1)
    if args.only:
        only(args.only, args.sizes[0], args.features[0], args.pictures)
        return
    print(f"{describe()}; {load()}\n")
    print(report(args.sizes, args.features, args.pictures))
    if args.instructions:
        millions = instructions(args.sizes[0], args.features[0])
        print(f"\ninstructions a picture, first size and number of features: {millions:.0f} million")


if __name__ == "__main__":
    main()
