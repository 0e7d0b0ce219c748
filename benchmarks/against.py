"""Processor time of a picture at thirty a second, this checkout against an earlier commit, in one run.

    python -m benchmarks.against [--base 16dc944] [--turns 40] [--pictures 60] [--flight FOLDER]

Two processes fly the same pictures, one with this checkout's code and one with the commit's (`git archive`, into a
temporary folder), and take turns of a few seconds of flight: other load of the machine affects both equally. Counted is
the processor time from an event to the bytes of its sets, window solves included (`benchmarks.flight_in_turns`). Every
turn gives one ratio; printed are their median and their range. The first turns, with no window yet, do not count.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import zipfile
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

from benchmarks.machine import describe, load, table, verdict

# isort: split
import numpy as np

from benchmarks.short_flight import CACHE, leg

CHECKOUT = Path(__file__).resolve().parents[1]
BASE = "16dc944"
GOAL = 0.60  # of the base's processor time
RATE_HZ = 30.0
WARM_UP_TURNS = 5


@dataclass(frozen=True)
class Turn:
    """A few seconds of flight: processor time a picture (ms), the stages' share of it (ms), and what was answered."""

    picture_ms: float
    stages_ms: dict[str, float]
    sets: int
    answered: int


class Flying:
    """A process that flies with the code of one folder, some pictures at a time."""

    def __init__(self, code: Path, flight: Path) -> None:
        # -P: the program's own folder is not searched, so that every module is the one of `code`.
        command = [sys.executable, "-P", str(CHECKOUT / "benchmarks" / "flight_in_turns.py"), str(flight)]
        self._process = subprocess.Popen(
            command,
            cwd=code,
            env={**os.environ, "PYTHONPATH": str(code)},  # one thread each: `benchmarks.machine` has seen to that
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def fly(self, pictures: int) -> Turn:
        """So many more pictures. Raises ChildProcessError if the process has ended."""
        stdin, stdout = self._process.stdin, self._process.stdout
        assert stdin is not None and stdout is not None
        stdin.write(f"{pictures}\n")
        stdin.flush()
        line = stdout.readline()
        if not line:
            raise ChildProcessError(f"{self._process.args!r} ended with {self._process.wait()}")
        said: dict[str, Any] = json.loads(line)
        stages = {name: 1e3 * s / pictures for name, s in said["stages_s"].items()}
        return Turn(said["cpu_ns"] / 1e6 / pictures, stages, said["sets"], said["answered"])

    def end(self) -> None:
        """Let the process go."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait(30.0)


def unpacked(commit: str, folder: Path) -> Path:
    """A commit's files in `folder`."""
    packing = ["git", "archive", "--format=zip", commit]
    packed = subprocess.run(packing, cwd=CHECKOUT, capture_output=True, check=True).stdout
    with zipfile.ZipFile(BytesIO(packed)) as archive:
        archive.extractall(folder)
    return folder


def compare(base: Path, flight: Path, turns: int, pictures: int) -> tuple[list[Turn], list[Turn]]:
    """Turns of the base's code and of this checkout's, each with its pair."""
    flying = Flying(base, flight), Flying(CHECKOUT, flight)
    simulated: tuple[list[Turn], list[Turn]] = ([], [])
    try:
        for turn in range(WARM_UP_TURNS + turns):
            # Who begins changes, so that neither always has the quieter half.
            for one in (0, 1) if turn % 2 else (1, 0):
                simulated[one].append(flying[one].fly(pictures))
    finally:
        for process in flying:
            process.end()
    return simulated[0][WARM_UP_TURNS:], simulated[1][WARM_UP_TURNS:]


def report(commit: str, before: list[Turn], now: list[Turn]) -> str:
    """The processor time of both, by stage, and the ratio."""
    ratios = [b.picture_ms / a.picture_ms for a, b in zip(before, now, strict=True)]
    ratio = float(np.median(ratios))
    rows = []
    for name, of in (("in all", lambda t: t.picture_ms), *((s, _stage(s)) for s in before[0].stages_ms)):
        a, b = (float(np.median([of(t) for t in simulated])) for simulated in (before, now))
        rows.append([name, f"{a:.2f}", f"{b:.2f}", f"{b / a:.2f}"])
    counts = (
        f"{sum(t.sets for t in simulated)} sets, {sum(t.answered for t in simulated)} with an answer"
        for simulated in (before, now)
    )
    was, has = counts
    return "\n".join(
        [
            table(["processor, ms a picture", commit, "this checkout", "ratio"], rows),
            "",
            f"ratio of {len(ratios)} turns: median {ratio:.3f} ({min(ratios):.3f} to {max(ratios):.3f}), "
            f"goal {GOAL:.2f}: {verdict(ratio <= GOAL)}",
            f"of one core at {RATE_HZ:.0f} Hz: {_share(before):.1f} % before, {_share(now):.1f} % now",
            f"{commit}: {was}; this checkout: {has}",
        ]
    )


def _stage(name: str) -> Any:
    return lambda turn: turn.stages_ms.get(name, float("nan"))


def _share(turns: list[Turn]) -> float:
    return float(np.median([t.picture_ms for t in turns])) * RATE_HZ / 10.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--base", default=BASE, help=f"commit to compare with (default {BASE})")
    parser.add_argument("--turns", type=int, default=40, help="that count, of each (default 40)")
    parser.add_argument("--pictures", type=int, default=60, help="a turn (default 60)")
    parser.add_argument(
        "--flight", type=Path, help="folder of a flight at 30 Hz (default: the leg of benchmarks.short_flight)"
    )
    args = parser.parse_args()
    flight = args.flight
    if flight is None:
        leg()  # generated, if it is not there yet
        flight = CACHE / "leg_14s_30hz"
    print(f"{describe()}; {load()}\n")
    with tempfile.TemporaryDirectory(prefix="pointclick-") as folder:
        print(
            report(args.base, *compare(unpacked(args.base, Path(folder)), flight.resolve(), args.turns, args.pictures))
        )


if __name__ == "__main__":
    main()
