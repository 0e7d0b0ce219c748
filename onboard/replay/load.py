"""The load of pictures on this computer: the pipeline on events, with the processor's time by stage.

As in the daemon, one thread does everything from an event to the bytes of its feature sets, another solves windows.
Processor time is counted, not wall time; the source of the events (a decoder, a simulated flight) is left out.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial

import numpy as np

from contract.camera import Camera
from contract.feature_set import FeatureSet
from contract.wire.codec import encode
from onboard.config.schema import Config
from onboard.events.types import Event, Frame
from onboard.pipeline.pipeline import Pipeline

SHARE = 0.5
"""The share of a core that pictures may take: driver, decoder, telemetry, link and recording need as much again, and
all of it runs in one Python, which works on one core at a time."""
WARM_UP = 30  # pictures, not counted: caches fill, and the first window begins


@dataclass(frozen=True)
class Load:
    """The measured load. `stage_ms`: processor time of a picture by stage; `solve` runs in a thread of its own."""

    replayed: int  # pictures
    solved: int  # of those
    pictures: int  # that were counted: without the first
    seconds: float  # of flight
    stage_ms: dict[str, float]
    lag_ms: tuple[float, float]  # p50 and p95 from an event's arrival to its sets' bytes, at the rate of the replay
    early_ms: float  # a picture, in the first quarter ...
    late_ms: float  # ... and in the last: a processor that gets hot slows down

    @property
    def picture_ms(self) -> float:
        return sum(self.stage_ms.values())

    @property
    def rate_hz(self) -> float:
        return self.pictures / self.seconds if self.seconds else 0.0

    @property
    def sustainable_hz(self) -> float:
        """Pictures a second that take `SHARE` of a core, by the slower of the first and the last quarter."""
        worst_ms = max(self.picture_ms, self.picture_ms * self.late_ms / self.early_ms if self.early_ms else 0.0)
        return 1e3 * SHARE / worst_ms if worst_ms else 0.0


def measure(
    config: Config, camera: Camera, events: Iterable[tuple[int, Event]], is_over: Callable[[int], bool]
) -> Load:
    """Fly until the events end or `is_over`, asked after each picture with how many there were."""
    with ThreadPoolExecutor(1, "solver") as solver:
        return _measure(Pipeline(config, camera, worker=solver), events, is_over)


def _measure(pipeline: Pipeline, events: Iterable[tuple[int, Event]], is_over: Callable[[int], bool]) -> Load:
    stamps_ns: list[int] = []
    costs_ms: list[float] = []  # since the picture before, by this thread
    lags_ms: list[float] = []
    spent_ns = encoding_ns = free_ns = 0
    encoding_before_ns, stages_before = 0, dict[str, float]()
    for moment_ns, event in events:
        has_sets, took_ns, of_it_encoding_ns = _timed(partial(pipeline.handle, event))
        encoding_ns += of_it_encoding_ns
        spent_ns += took_ns
        free_ns = max(free_ns, moment_ns) + took_ns
        if has_sets and len(stamps_ns) > WARM_UP:
            lags_ms.append((free_ns - moment_ns) / 1e6)
        if isinstance(event, Frame):
            stamps_ns.append(event.stamp_ns)
            costs_ms.append(spent_ns / 1e6)
            spent_ns = 0
            if len(stamps_ns) == WARM_UP:
                encoding_before_ns, stages_before = encoding_ns, pipeline.summary.stage_seconds
            if is_over(len(stamps_ns)):
                break
    # Pictures that still wait to be placed count for all that were replayed, not for the last one.
    _, finish_ns, of_it_encoding_ns = _timed(pipeline.finish)
    encoding_ns += of_it_encoding_ns
    summary = pipeline.summary
    pictures = len(stamps_ns) - WARM_UP if len(stamps_ns) > WARM_UP else len(stamps_ns)
    counted = costs_ms[-pictures:] if pictures else []
    per = max(pictures, 1)
    stages = {
        name: 1e3 * (seconds - stages_before.get(name, 0.0)) / per for name, seconds in summary.stage_seconds.items()
    }
    stages["encode"] = (encoding_ns - encoding_before_ns) / 1e6 / per
    in_this_thread = sum(ms for name, ms in stages.items() if name != "solve")
    stages["other"] = max((sum(counted) + finish_ns / 1e6) / per - in_this_thread, 0.0)
    quarter = max(len(counted) // 4, 1)
    return Load(
        len(stamps_ns),
        summary.solved,
        pictures,
        (stamps_ns[-1] - stamps_ns[-pictures]) / 1e9 * per / max(per - 1, 1) if pictures else 0.0,
        stages,
        (_quantile(lags_ms, 0.5), _quantile(lags_ms, 0.95)),
        float(np.mean(counted[:quarter])) if counted else 0.0,
        float(np.mean(counted[-quarter:])) if counted else 0.0,
    )


def _timed(make: Callable[[], list[FeatureSet]]) -> tuple[bool, int, int]:
    """Make sets and encode them: whether there were any, what both took this thread, ns, and encoding alone."""
    began = time.thread_time_ns()
    sets = make()
    made = time.thread_time_ns()
    for s in sets:
        encode(s)
    ended = time.thread_time_ns()
    return bool(sets), ended - began, ended - made


def _quantile(values: list[float], share: float) -> float:
    return float(np.quantile(values, share)) if values else 0.0
