"""The whole pipeline at thirty 640x480 pictures a second: processor, memory, stalls, and where the time goes.

    python -m benchmarks.pipeline [--minutes 4 | --hour] [--profile]

A straight leg of the recorded plane is replayed out and back for as long as asked (benchmarks.short_flight), faster
than real time, as the daemon does it: one thread tracks, another solves windows. Counted is everything from an event to
the bytes of its feature sets, window solves included; not the camera's driver, not the link. Times of calls and lags
are the tracking thread's own processor time: every event is taken to arrive when it would live, and waits until the
events before it are done with. A solve holds that up only if it takes longer than the data leave it
(pipeline.ADOPTION_NS).
"""

from __future__ import annotations

import argparse
import cProfile
import gc
import os
import pstats
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.machine import describe, load, table, verdict

# isort: split
import numpy as np

from benchmarks.short_flight import TELEMETRY_DELAY_NS, Leg, leg, out_and_back
from contract.wire.codec import encode
from onboard.estimation.solver_executor import Done, Promise
from onboard.estimation.window_request import Request
from onboard.events.types import Frame
from onboard.pipeline.pipeline import ADOPTION_NS, Pipeline

RATE_HZ = 30.0
GOAL_CORE, GOAL_GROWTH = 0.35, 0.05
WARM_UP_FRAMES = 3600
HOUR_FRAMES = 108_000
_PAGE = os.sysconf("SC_PAGE_SIZE")


@dataclass
class Run:
    """The cost of a flight."""

    call_ms: list[float] = field(default_factory=list)  # of each call of `handle` that gave sets, processor time
    lag_ms: list[float] = field(default_factory=list)  # of each call from its event's arrival to its sets' bytes
    cpu_s: float = 0.0
    memory_bytes: list[tuple[int, int]] = field(default_factory=list)  # pictures so far, resident without the leg's own
    frames: int = 0
    sets: int = 0
    set_bytes: int = 0
    solved: int = 0
    stages: dict[str, float] = field(default_factory=dict)
    solve_ms: list[float] = field(default_factory=list)  # processor time of each, in its own thread

    @property
    def core_share(self) -> float:
        """Seconds of processor a second of flight."""
        return self.cpu_s / (self.frames / RATE_HZ)

    @property
    def growth(self) -> float | None:
        """Memory at the end over memory after warm-up, less 1; None for a run that is hardly longer than that."""
        warm = [size for frames, size in self.memory_bytes if frames >= WARM_UP_FRAMES]
        return warm[-1] / warm[0] - 1.0 if len(warm) > 1 else None


def resident_bytes() -> int:
    """This process's resident memory."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * _PAGE


def fly(simulated: Leg, frames: int) -> Run:
    """Put `frames` pictures through a new pipeline."""
    out = Run()
    with ThreadPoolExecutor(1) as threads:
        _fly(
            simulated, frames, Pipeline(simulated.config, simulated.camera, worker=_Beside(threads, out.solve_ms)), out
        )
    return out


@dataclass(frozen=True)
class _Beside:
    """A worker in a thread of its own, which notes how long each solve takes."""

    threads: ThreadPoolExecutor
    solve_ms: list[float]

    def submit(self, fn: Callable[[Request], Done], request: Request, /) -> Promise:
        """Begin a solve."""

        def noted() -> Done:
            done = fn(request)
            self.solve_ms.append(1e3 * done.processor_s)
            return done

        return self.threads.submit(noted)


def _fly(simulated: Leg, frames: int, pipeline: Pipeline, out: Run) -> None:
    gc.collect()
    held_bytes = sum(image.nbytes for image in simulated.images)
    free_ns = 0  # when, by the flight's own clock, all events so far are done with
    for event in out_and_back(simulated, frames):
        arrived_ns = event.stamp_ns + (0 if isinstance(event, Frame) else TELEMETRY_DELAY_NS)
        began = time.thread_time_ns()
        sets = pipeline.handle(event)
        payloads = [encode(s) for s in sets]
        took_ns = time.thread_time_ns() - began
        free_ns = max(free_ns, arrived_ns) + took_ns
        out.cpu_s += took_ns / 1e9
        out.sets += len(sets)
        out.set_bytes += sum(map(len, payloads))
        if sets:
            out.call_ms.append(took_ns / 1e6)
            out.lag_ms.append((free_ns - arrived_ns) / 1e6)
        if isinstance(event, Frame):
            out.frames += 1
            if out.frames % 1200 == 0:
                out.memory_bytes.append((out.frames, resident_bytes() - held_bytes))
    summary = pipeline.summary
    out.solved, out.stages = summary.solved, summary.stage_seconds
    out.cpu_s += sum(out.solve_ms) / 1e3


def hot_spots(simulated: Leg, frames: int, count: int = 18) -> str:
    """Share of processor time by file, and the functions that take most."""
    profiler = cProfile.Profile(time.process_time)
    pipeline = Pipeline(simulated.config, simulated.camera)
    profiler.enable()
    for event in out_and_back(simulated, frames):
        for s in pipeline.handle(event):
            encode(s)
    profiler.disable()
    stats = pstats.Stats(profiler).stats  # type: ignore[attr-defined]
    total = sum(own for _, _, own, _, _ in stats.values())
    rows = []
    for (file, line, name), (_, calls, own, cumulative, _) in sorted(stats.items(), key=lambda kv: -kv[1][2])[:count]:
        where = name if file == "~" else f"{Path(file).parent.name}/{Path(file).name}:{line} {name}"
        rows.append(
            [where[:80], f"{calls / frames:.1f}", f"{100 * own / total:.1f} %", f"{100 * cumulative / total:.1f} %"]
        )
    return table(["function", "calls a picture", "own time", "with callees"], rows)


def report(simulated: Leg, frames: int) -> str:
    """Replay and report."""
    run = fly(simulated, frames)
    lines = [
        f"{frames} pictures ({frames / RATE_HZ:.0f} s of flight), {run.solved} solved, {run.sets} sets of "
        f"{run.set_bytes / max(run.sets, 1):.0f} bytes",
        f"processor: {100 * run.core_share:.1f} % of one core (goal {100 * GOAL_CORE:.0f} %): "
        f"{verdict(run.core_share <= GOAL_CORE)}",
    ]
    if run.growth is None:
        lines.append("memory: too short a run to say how it grows")
    else:
        first = next(size for n, size in run.memory_bytes if n >= WARM_UP_FRAMES)
        lines.append(
            f"memory: {first / 1e6:.1f} MB after {WARM_UP_FRAMES} pictures, {run.memory_bytes[-1][1] / 1e6:.1f} MB "
            f"after {run.memory_bytes[-1][0]}: {100 * run.growth:+.1f} % (goal under {100 * GOAL_GROWTH:.0f} %): "
            f"{verdict(run.growth < GOAL_GROWTH)}"
        )
    rows = [
        [name, *(f"{np.quantile(ms, q):.1f}" for q in (0.5, 0.9, 0.99)), f"{max(ms):.1f}"]
        for name, ms in (
            ("one call of `handle` that gives sets", run.call_ms),
            ("lag behind its event", run.lag_ms),
            (f"window solve, beside (may take {ADOPTION_NS / 1e6:.0f})", run.solve_ms),
        )
    ]
    busy = sum(run.stages.values())
    return "\n".join(
        [
            *lines,
            "",
            table(["ms", "p50", "p90", "p99", "longest"], rows),
            "",
            f"{run.frames / max(len(run.call_ms), 1):.1f} pictures a call: they wait for the position after them. "
            "The longest call is the first: the pictures taken before any position came.",
            "by stage: " + ", ".join(f"{stage} {100 * s / busy:.0f} %" for stage, s in run.stages.items()),
        ]
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    length = parser.add_mutually_exclusive_group()
    length.add_argument("--minutes", type=float, default=4.0, help="of flight (default 4)")
    length.add_argument("--hour", action="store_true", help="108,000 pictures")
    parser.add_argument("--profile", action="store_true", help="where the time goes, by function")
    args = parser.parse_args()
    simulated = leg()
    print(f"{describe()}; {load()}\n")
    print(report(simulated, HOUR_FRAMES if args.hour else round(args.minutes * 60 * RATE_HZ)))
    if args.profile:
        print("\n" + hot_spots(simulated, 1200))


if __name__ == "__main__":
    main()
