"""A flight through the pipeline, as many pictures at a time as standard input asks for; run by `benchmarks.against`.

    python -P benchmarks/flight_in_turns.py FOLDER

It must run with the code of earlier commits too, so it takes from it only what has been there since: the flight, the
leg out and back, the pipeline, `encode`. A line on standard input is a number of pictures; the answer is a line of
JSON.
"""

from __future__ import annotations

import json
import sys
import time
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from contract.camera import Camera
from contract.wire.codec import encode
from onboard.config.schema import load_config
from onboard.events.types import Frame
from onboard.pipeline.pipeline import Pipeline
from onboard.replay.runner import Flight

ENDLESS = 1_000_000
# The leg out and back, by the name that its module had until 59c1c5b too.
short_flight = import_module("benchmarks.short_flight" if find_spec("benchmarks.short_flight") else "benchmarks.flown")


def read(folder: Path) -> Any:  # a `Leg`
    """A simulated flight, pictures and telemetry between the first picture and the last."""
    config, camera = load_config(folder / "config.toml"), Camera.from_json(folder / "camera.json")
    flight = Flight.open(config, camera, folder / "frames", folder / "telemetry.tlog", folder / "stamps.csv")
    frames = list(flight.frames.frames())
    first, last = frames[0].stamp_ns, frames[-1].stamp_ns
    stated = sorted(flight.telemetry.events, key=lambda e: e.stamp_ns)
    inside = [e for e in stated if not isinstance(e, Frame) and first <= e.stamp_ns <= last]
    return short_flight.Leg(config, camera, frames, inside)


def main() -> None:
    simulated = read(Path(sys.argv[1]))
    pipeline = Pipeline(simulated.config, simulated.camera)
    events = short_flight.out_and_back(simulated, ENDLESS)
    before: dict[str, float] = {}
    for line in sys.stdin:
        left = int(line)
        spent_ns = encode_ns = sets = answered = 0
        while left > 0:
            event = next(events)
            left -= isinstance(event, Frame)
            began = time.process_time_ns()
            made = pipeline.handle(event)
            handled = time.process_time_ns()
            for s in made:
                encode(s)
            done = time.process_time_ns()
            spent_ns, encode_ns = spent_ns + done - began, encode_ns + done - handled
            sets, answered = sets + len(made), answered + sum(s.is_ok for s in made)
        stages = dict(pipeline.summary.stage_seconds)
        stages_s = {name: s - before.get(name, 0.0) for name, s in stages.items()} | {"encode": encode_ns / 1e9}
        before = stages
        print(json.dumps({"cpu_ns": spent_ns, "stages_s": stages_s, "sets": sets, "answered": answered}), flush=True)


if __name__ == "__main__":
    main()
