"""The machine that figures were measured on, one thread for everything, and medians of interleaved repeats.

Import this module before NumPy and OpenCV: how many threads they use is decided when they load.
"""

from __future__ import annotations

import os
import platform
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from importlib import metadata
from pathlib import Path

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"):
    os.environ[_variable] = "1"

_CPUINFO = Path("/proc/cpuinfo")
_NAMED = ("numpy", "opencv-python-headless", "scipy", "eclipse-zenoh")


def describe() -> str:
    """Processor, cores, system and versions, one line."""
    versions = ", ".join(f"{name} {metadata.version(name)}" for name in _NAMED)
    return (
        f"{_processor()}, {os.cpu_count()} cores, {platform.system()} {platform.machine()}, "
        f"Python {platform.python_version()}, {versions}; one thread"
    )


def load() -> str:
    """The machine's load by other things, for the reader of a table."""
    return f"load of the last minute {os.getloadavg()[0]:.1f}"


def _processor() -> str:
    if _CPUINFO.exists():
        for line in _CPUINFO.read_text().splitlines():
            # "model name" of a PC, "Model" of a Raspberry Pi; "model" of a PC is a bare number.
            if line.startswith(("model name", "Model")):
                return line.split(":", 1)[1].strip()
    return platform.processor() or "unknown processor"


def interleaved_us(
    runs: Mapping[str, Callable[[], object]], repeat: int, clock: Callable[[], int] = time.process_time_ns
) -> dict[str, float]:
    """Median microseconds of each run, the runs taken in turn so that all run on the machine in the same state.

    `clock` counts nanoseconds; the default is processor time, which others on the machine do not lengthen by waiting.
    """
    for run in runs.values():
        run()  # once to warm up
    taken: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(repeat):
        for name, run in runs.items():
            began = clock()
            run()
            taken[name].append((clock() - began) / 1e3)
    return {name: statistics.median(times) for name, times in taken.items()}


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table, aligned for a terminal too; the first column to the left, the others to the right."""
    cells = [list(head), *map(list, rows)]
    width = [max(len(row[i]) for row in cells) for i in range(len(head))]

    def line(row: Sequence[str]) -> str:
        inner = [c.ljust(w) if i == 0 else c.rjust(w) for i, (c, w) in enumerate(zip(row, width, strict=True))]
        return f"| {' | '.join(inner)} |"

    rule = [("-" * w) if i == 0 else "-" * (w - 1) + ":" for i, w in enumerate(width)]
    return "\n".join([line(cells[0]), line(rule), *map(line, cells[1:])])


def verdict(is_reached: bool) -> str:
    return "reached" if is_reached else "NOT reached"
