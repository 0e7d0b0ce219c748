"""How long a click takes: located in a cached set, and `pc-ground click` from nothing, recorded and live.

    python -m benchmarks.click [--sets 10000] [--clicks 4000] [--runs 15]

Sets of 100 features from a simulated flight. The command is started as a user starts it, a new process each time, by
the wall clock: interpreter, imports, looking the picture up, decoding, kriging, printing. The live peer is a
`Publisher` in a process of its own with the same sets in its history.
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from benchmarks.machine import describe, load, table, verdict

# isort: split
import numpy as np

from benchmarks.short_flight import leg, sets_of
from contract.feature_set import FeatureSet
from contract.locate import Locator
from onboard.link.publisher import Publisher, Rate
from onboard.storage.mcap_writer import SessionRecorder
from tests.onboard.link.ports import free_endpoint

GOAL_CACHED_MS, GOAL_COLD_S = 1.0, 0.5
PERIOD_NS = 1_000_000_000 // 30
READY = "ready"
START_TIMEOUT_S = 30.0


def many(sets: Sequence[FeatureSet], count: int) -> Iterator[FeatureSet]:
    """`count` sets of one session, frames and captures counted on, made of a few."""
    first = sets[0]
    for frame in range(count):
        yield replace(
            sets[frame % len(sets)],
            session=first.session,
            frame=frame,
            capture_unix_ns=first.capture_unix_ns + frame * PERIOD_NS,
        )


def cached_us(sets: Sequence[FeatureSet], clicks: int) -> tuple[list[float], list[float]]:
    """Processor microseconds of each click on a set already seen, and of the first click on one that is not."""
    rng = np.random.default_rng(0)
    first, later = [], []
    per_set = max(clicks // len(sets), 1)
    for s in sets:
        pixels = rng.uniform([0, 0], np.subtract(s.camera.size_px, 1), (per_set + 1, 2))
        began = time.process_time_ns()
        locator = Locator(s)
        locator.locate(pixels[0])
        first.append((time.process_time_ns() - began) / 1e3)
        for pixel in pixels[1:]:
            began = time.process_time_ns()
            locator.locate(pixel)
            later.append((time.process_time_ns() - began) / 1e3)
    return later, first


def command_s(*arguments: str) -> float:
    """Wall seconds of one `pc-ground click`. Raises RuntimeError if it gives no answer."""
    began = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", "ground", "click", *arguments],
        cwd=Path(__file__).resolve().parents[1],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    took = time.perf_counter() - began
    if done.returncode != 0:
        raise RuntimeError(f"pc-ground click {' '.join(arguments)}: exit {done.returncode}: {done.stderr}{done.stdout}")
    return took


def record(path: Path, sets: Sequence[FeatureSet], count: int) -> None:
    """A recording of `count` sets."""
    with SessionRecorder(path, sets[0].vehicle) as recorder:
        for s in many(sets, count):
            recorder.write_set(s)


@contextmanager
def peer(recording: Path) -> Iterator[str]:
    """A process that publishes the sets of a recording and answers queries; its endpoint."""
    endpoint = free_endpoint()
    command = [sys.executable, "-m", "benchmarks.click", "--serve", str(recording), endpoint]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stdin=subprocess.PIPE, text=True) as served:
        assert served.stdout is not None and served.stdin is not None
        if served.stdout.readline().strip() != READY:
            raise RuntimeError("the live peer did not start")
        try:
            yield endpoint
        finally:
            served.stdin.close()  # it serves until then
            served.wait(START_TIMEOUT_S)


def serve(recording: Path, endpoint: str) -> None:
    """Publish the recording's last thousand sets until stdin ends: the live peer."""
    from ground.recording import Recording  # noqa: PLC0415

    held = Recording(recording)
    vehicle = held.vehicles[0]
    with Publisher(vehicle, [endpoint], rate=Rate(max_bit_rate=1e8)) as publisher:  # a click's own time
        for frame in held.frames(vehicle)[-1000:]:
            s = held.by_frame(vehicle, frame)
            assert s is not None
            publisher.publish(s)
        print(READY, flush=True)
        sys.stdin.read()


def report(sets: Sequence[FeatureSet], recorded: int, clicks: int, runs: int) -> str:
    """The table."""
    later, first = cached_us(sets, clicks)
    taken: dict[str, list[float]] = {}
    with tempfile.TemporaryDirectory() as scratch:
        recording = Path(scratch) / "flight.mcap"
        record(recording, sets, recorded)
        with peer(recording) as endpoint:
            picture = str(recorded - 1 - min(recorded - 1, 100))
            cases = {
                f"recording of {recorded} sets": ("--from", str(recording), "--frame", picture),
                "live peer, that picture": ("--connect", endpoint, "--frame", picture),
                "live peer, newest": ("--connect", endpoint, "--max-age", "inf"),
            }
            width, height = sets[0].camera.size_px
            for _ in range(runs + 1):
                for name, arguments in cases.items():
                    seconds = command_s(str(width // 2), str(height // 2), *arguments)
                    taken.setdefault(name, []).append(seconds)
    rows = [
        [name, f"{np.quantile(us, 0.5):.0f}", f"{np.quantile(us, 0.99):.0f}", f"{max(us):.0f}"]
        for name, us in (("a click on a set seen before", later), ("the first click on a set", first))
    ]
    cold = [
        # The first of each filled the disk's cache.
        [name, f"{statistics.median(s[1:]):.3f}", f"{min(s[1:]):.3f}", f"{max(s[1:]):.3f}"]
        for name, s in taken.items()
    ]
    p99_ms, cold_s = float(np.quantile(later, 0.99)) / 1e3, max(statistics.median(s[1:]) for s in taken.values())
    return "\n".join(
        [
            table(["located, us of processor", "p50", "p99", "longest"], rows),
            "",
            table(["`pc-ground click`, s by the clock", "median", "least", "most"], cold),
            "",
            f"p99 {p99_ms:.2f} ms (goal {GOAL_CACHED_MS:.0f}): {verdict(p99_ms < GOAL_CACHED_MS)}",
            f"cold {cold_s:.2f} s, median of the slowest case (goal {GOAL_COLD_S}): {verdict(cold_s < GOAL_COLD_S)}",
        ]
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sets", type=int, default=10000)
    parser.add_argument("--clicks", type=int, default=4000)
    parser.add_argument("--runs", type=int, default=15)
    parser.add_argument("--serve", nargs=2, metavar=("RECORDING", "ENDPOINT"), help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.serve:
        serve(Path(args.serve[0]), args.serve[1])
        return
    print(f"{describe()}; {load()}\n")
    print(report(sets_of(leg(), 100), args.sets, args.clicks, args.runs))


if __name__ == "__main__":
    main()
