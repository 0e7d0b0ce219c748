"""`python -m benchmarks.recording`: what recording costs a flight at thirty pictures a second of 640x480.

Processor time of the thread that records, bytes a second, and how long the disk takes to take them in earnest.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.machine import describe, load
from benchmarks.short_flight import Leg, leg, out_and_back, sets_of
from contract.feature_set import FeatureSet
from onboard.events.types import Frame
from onboard.storage.mcap_writer import SessionRecorder

RATE_HZ = 30.0


def measured(simulated: Leg, sets: Sequence[FeatureSet], pictures: str, seconds: float, folder: Path) -> str:
    """One row: every event and two sets a picture, as the pipeline makes them."""
    path = folder / f"{pictures}.mcap"
    syncs: list[float] = []
    began = time.thread_time()
    with SessionRecorder(path, "uav", pictures=pictures) as out:
        frames = 0
        for event in out_and_back(simulated, round(seconds * RATE_HZ)):
            out.write_event(event)
            if isinstance(event, Frame):
                for revision in (0, 1):
                    s = sets[frames % len(sets)]
                    out.write_set(replace(s, frame=frames, revision=revision, capture_unix_ns=event.stamp_ns))
                frames += 1
                if frames % round(RATE_HZ / 2.0) == 0:
                    at = time.perf_counter()
                    out.sync()
                    syncs.append(time.perf_counter() - at)
        took_s = time.thread_time() - began
        size = out.size_bytes
    share, rate = took_s / seconds, size / seconds / 1e6
    middle, worst = 1e3 * statistics.median(syncs), 1e3 * max(syncs)
    return f"| {pictures} | {share:.1%} of a core | {rate:.2f} MB/s | {middle:.0f} ms, at most {worst:.0f} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0, help="of flight")
    parser.add_argument("--folder", type=Path, help="on which disk; a temporary folder if not given")
    arguments = parser.parse_args()
    with TemporaryDirectory(dir=arguments.folder) as scratch:
        simulated = leg(3.0, 8.0, Path(scratch))
        sets = sets_of(simulated, 40)
        print(f"{describe()}; {load()}\n")
        print("| pictures | processor | written | to the disk, twice a second |\n|---|---|---|---|")
        for pictures in ("none", "jpeg", "lossless"):
            print(measured(simulated, sets, pictures, arguments.seconds, Path(scratch)), flush=True)


if __name__ == "__main__":
    main()
