"""Pictures from a network stream next to the raw pictures of the same flight: times, clicks, answers.

    python -m benchmarks.sources [--seconds 75] [--streams 1000:0.15,250:0.4] [--jitter 0.03] [--seeds 2,6] [--devices]

Simulated flights with turns, 400x300 at 6 Hz, are played by GStreamer's RTSP server as H.264 over TCP, in real time,
with the autopilot's messages over UDP. `--streams`: kbit/s and the seconds between a picture's capture and its way into
the network, for each stream; every picture's delay differs by up to `--jitter` either way. Nothing of the delay is
stated: the prior is 0 to 1 s. What camera and telemetry delivered is then put through the pipeline, so that the load of
this computer changes no answer.

Printed: how far stamps scatter about their mean delay; the time offset found after 60 s (or at the end) less the true
one, with its stated sigma; clicks after the first 20 s against the truth, the share of them inside the 90 % ellipse,
and the share answered. A flight's clicks share its slow errors: one flight is one sample of them.

`--devices` (root; docs/test-bench.md) measures cameras that are devices, in the test bench's guest: a sensor of the
kernel's is switched between two brightnesses at known moments, and what pictures show bounds how far their stamps lie
behind the moment at which the driver begins to draw them.
"""

from __future__ import annotations

import argparse
import json
import threading
import time
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.errors import InputError
from contract.feature_set import FeatureSet
from onboard.camera.factory import open_camera
from onboard.camera.picture_mask import read_mask
from onboard.config.schema import Config
from onboard.estimation.platform_states import OFFSET
from onboard.events.session_clock import SessionClock
from onboard.events.source import Source
from onboard.events.types import Event, Frame
from onboard.pipeline.pipeline import Pipeline
from onboard.telemetry.factory import open_telemetry
from simulation.flight import DescribedSpec
from simulation.ordinary import ordinary
from simulation.paths import PathSpec
from simulation.session import SessionSpec
from simulation.terrain import TerrainSpec
from tests.onboard.link.ports import free_udp_port
from tests.rtsp import is_installed, number_of
from tests.scenarios.flights import CHI2_90, Outcome, click, play, simulated
from tests.streamed_flight import StreamedFlight, write_mask

Array = NDArray[np.float64]

SIZE_PX = (400, 300)
RATE_HZ = 6.0
SETTLED_S, LEARNED_S = 20.0, 60.0
DEVICES = (
    ("V4L2, vivid", "/dev/video0", (320, 180), ()),
    ("V4L2, vivid", "/dev/video0", (640, 480), ()),
    ("libcamera, vimc", "libcamera:", (288, 144), ("--sensor", "Sensor B")),
    ("libcamera, vimc", "libcamera:", (636, 480), ("--sensor", "Sensor B")),
)


@dataclass(frozen=True)
class Received:
    """The content of a stream: events in order of arrival, and when each numbered picture was taken (session clock)."""

    events: list[tuple[int, Event]]
    captured_ns: dict[int, int]


@dataclass(frozen=True)
class Streamed:
    """The pipeline's result from a stream."""

    outcome: Outcome
    scatter_ms: float
    offset_s: float
    offset_sigma_s: float
    true_offset_s: float


def flight_spec(seconds: float, seed: int) -> SessionSpec:
    """Turns over relief, with an ordinary autopilot."""
    return SessionSpec(
        DescribedSpec(PathSpec("turns", leg_m=120.0), ordinary(seed), seed=seed),
        camera=Camera.from_field_of_view(*SIZE_PX, 60.0),
        seconds=seconds,
        rate_hz=RATE_HZ,
        terrain=TerrainSpec(relief_m=20.0, wavelength_m=250.0),
    )


def receive(session: Path, folder: Path, config: Config, camera: Camera, seconds: float, **stream: Any) -> Received:
    """Fly in real time, and keep what camera and telemetry hand out."""
    clock = SessionClock.start()
    events: list[tuple[int, Event]] = []
    lock, stop = threading.Lock(), threading.Event()

    def take(arrival_ns: int, event: Event) -> None:
        with lock:
            events.append((arrival_ns, event))

    port = int(config.telemetry.url.rpartition(":")[2])
    with StreamedFlight(session, folder, RATE_HZ, port, is_marked=True, **stream) as flight:
        device = config.camera.model_copy(update={"device": flight.server.url("rtspt")})
        running = config.model_copy(update={"camera": device})
        sources: list[Source] = [open_telemetry(running, clock), open_camera(running, camera, clock)]
        threads = [threading.Thread(target=source.run, args=(take, stop)) for source in sources]
        for thread in threads:
            thread.start()
        if flight.server.wait_for_client(20.0) is None:
            stop.set()
            raise InputError("no picture of the stream has come")
        time.sleep(seconds)
        stop.set()
        for thread in threads:
            thread.join(5.0)
        (captured, *_) = flight.server.stop()
    count = round(seconds * RATE_HZ)
    captured_ns = {k: clock.from_monotonic_ns(ns) for k, ns in captured.items() if k < count}
    return Received(sorted(events, key=lambda pair: pair[0]), captured_ns)


def fly(received: Received, session: Path, config: Config, camera: Camera) -> Streamed:
    """Put what came through the pipeline, and click."""
    pipeline = Pipeline(config, camera, burned_in=read_mask(config.camera.mask, camera.size_px))
    numbers: dict[int, int] = {}
    late_ns: list[int] = []
    sets: dict[int, FeatureSet] = {}
    offset_s, sigma_s, newest = 0.0, float("nan"), -1
    first_ns = min(received.captured_ns.values())
    for _, event in received.events:
        if isinstance(event, Frame):
            number = -1 if event.image is None else number_of(event.image)
            if number not in received.captured_ns or number < newest:
                continue  # the server has begun again
            newest = number
            numbers[event.index] = number
            late_ns.append(event.stamp_ns - received.captured_ns[number])
            if event.stamp_ns - first_ns <= LEARNED_S * 1e9:
                platform = pipeline.window.alignment.platform
                offset_s, sigma_s = float(platform.mean[OFFSET]), float(platform.sigma[OFFSET])
        for output in pipeline.handle(event):
            sets[numbers.get(output.frame, -1)] = output
    for output in pipeline.finish():
        sets[numbers.get(output.frame, -1)] = output
    settled = {k: s for k, s in sets.items() if k >= SETTLED_S * RATE_HZ}
    # A session's capture times count from the least delay of its messages, as `Arrivals` does.
    true_s = -float(np.median(late_ns)) / 1e9
    steady = np.array(late_ns[len(late_ns) // 4 :], float) / 1e6
    return Streamed(click(session, settled, pipeline), float(np.std(steady)), offset_s, sigma_s, true_s)


def raw_outcome(session: Path) -> Outcome:
    """The same flight's pictures as the camera had them, at their true times."""
    outcome = play(session)
    settled = {k: s for k, s in outcome.sets.items() if k >= SETTLED_S * RATE_HZ}
    return click(session, settled, outcome.pipeline)


def cells(outcomes: Sequence[Outcome]) -> str:
    """Median and 90 % error, share inside the 90 % ellipse, shares of pictures and clicks that are answered."""
    errors_m, chi2 = (np.concatenate([getattr(o, name) for o in outcomes]) for name in ("errors_m", "chi2"))
    answered, asked = len(errors_m), len(errors_m) + sum(o.refusals.total() for o in outcomes)
    solved = 100.0 * float(np.mean([o.solved for o in outcomes]))
    if not answered:
        return f"- | - | - | {solved:.0f} % | 0 %"
    middle, most = np.quantile(errors_m, [0.5, 0.9])
    inside = 100.0 * float(np.mean(chi2 < CHI2_90))
    shares = f"{solved:.0f} % | {100.0 * answered / asked:.0f} %"
    return f"{middle:.2f} m | {most:.2f} m | {inside:.0f} % | {shares}"


def devices() -> str:
    """The table of cameras that are devices. Raises BenchError where no guest can be booted."""
    from tests.bench import cameras  # noqa: PLC0415  (what boots a guest is asked for only here)
    from tests.bench.machine import GUEST_CHECKOUT, INSIDE, PYTHON, boot  # noqa: PLC0415

    rows = ["| camera | pictures | stamp less the beginning of its picture |", "|---|---|---|"]
    with boot() as guest:
        cameras.load(guest)
        cameras.load_vimc(guest)
        for name, device, (width, height), words in DEVICES:
            argv = [PYTHON, "-m", "tests.bench.known_moments", device, f"{width}x{height}", *words]
            done = guest.run(*argv, timeout_s=150.0, cwd=GUEST_CHECKOUT, env=INSIDE)
            found = json.loads(done.ok().splitlines()[-1])
            between = f"{found['least_ms']:+.2f} to {found['most_ms']:+.2f} ms"
            rows.append(f"| {name} | {width}x{height} | {between} |")
    return "\n".join(rows)


def main(argv: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=75.0)
    parser.add_argument("--streams", default="1000:0.15,250:0.4", help="kbit/s and delay in s of each stream")
    parser.add_argument("--jitter", type=float, default=0.03, help="s")
    parser.add_argument("--seeds", default="2,6", help="of the flights")
    parser.add_argument("--devices", action="store_true", help="cameras that are devices, in the test bench's guest")
    arguments = parser.parse_args(argv)
    if arguments.devices:
        print(devices())
        return
    if not is_installed():
        parser.error("GStreamer is not installed: make gstreamer")
    seeds = [int(word) for word in arguments.seeds.split(",")]
    sessions = {seed: simulated(flight_spec(arguments.seconds, seed)) for seed in seeds}
    size, jitter_ms = "x".join(map(str, SIZE_PX)), 1e3 * arguments.jitter
    print(
        f"{len(seeds)} flights of {arguments.seconds:g} s with turns, {size} at {RATE_HZ:g} Hz, jitter +-{jitter_ms:g} "
        f"ms; nothing stated of the delay\n"
    )
    print(
        "| pictures | stamps scatter | time offset found less true | median | 90 % | inside 90 % | pictures answered "
        "| clicks answered |"
    )
    print("|---|---|---|---|---|---|---|---|")
    print(f"| raw | - | - | {cells([raw_outcome(session) for session in sessions.values()])} |", flush=True)
    for text in arguments.streams.split(","):
        kbit, delay = (float(word) for word in text.split(":"))
        stream = {"bit_rate": round(1000 * kbit), "delay_s": delay, "jitter_s": arguments.jitter}
        flights = [streamed(session, arguments.seconds, stream) for session in sessions.values()]
        scatter = ", ".join(f"{done.scatter_ms:.1f}" for done in flights)
        offsets = ", ".join(
            f"{1e3 * (done.offset_s - done.true_offset_s):+.0f} +-{1e3 * done.offset_sigma_s:.0f}" for done in flights
        )
        true_ms = ", ".join(f"{1e3 * done.true_offset_s:+.0f}" for done in flights)
        print(
            f"| H.264, {kbit:g} kbit/s, {1e3 * delay:g} ms late | {scatter} ms | {offsets} ms (of {true_ms}) "
            f"| {cells([done.outcome for done in flights])} |",
            flush=True,
        )


def streamed(session: Path, seconds: float, stream: dict[str, Any]) -> Streamed:
    """Play a session as a stream, receive it, and put it through the pipeline."""
    camera = Camera.from_json(session / "camera.json")
    with TemporaryDirectory() as name:
        folder = Path(name)
        config = stream_config(session / "config.toml", folder)
        received = receive(session, folder, config, camera, seconds, **stream)
        return fly(received, session, config, camera)


def stream_config(path: Path, folder: Path) -> Config:
    """A session's configuration for a stream of which nothing is stated, with the numbers in the pictures left out."""
    table = tomllib.loads(path.read_text())
    mask = write_mask(folder / "mask.png", SIZE_PX)
    table["camera"] = {"device": "rtsp://127.0.0.1/flight", "rate_hz": RATE_HZ, "mask": str(mask)}
    table["telemetry"] = {"url": f"udpin:127.0.0.1:{free_udp_port()}"}
    return Config.model_validate(table)


if __name__ == "__main__":
    main()
