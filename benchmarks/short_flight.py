"""A short simulated flight at thirty pictures a second, and as long a flight as asked for made of it.

The leg is replayed out and back: pictures and the recorded autopilot's own telemetry run forwards, then backwards with
velocities and turning rates reversed, and so on. What the pipeline sees is consistent, and never ends.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.feature_set import FeatureSet
from onboard.config.schema import Config, load_config
from onboard.events.types import Attitude, Event, Frame, NavEvent, PositionFix
from onboard.pipeline.pipeline import Pipeline
from onboard.replay.runner import Flight
from simulation.flight import RecordedSpec
from simulation.session import SessionSpec, fly

RECORDING = Path(__file__).resolve().parents[1] / "tests" / "data" / "plane_turn"
START_S = 2.0  # into the recording: 25 s of it are straight
CACHE = Path(__file__).resolve().parents[1] / "out" / "bench"
TELEMETRY_DELAY_NS = 40_000_000  # messages reach the pipeline this long after the moment they report


@dataclass(frozen=True, eq=False)
class Leg:
    """A simulated leg in memory: pictures and telemetry in order of their stamps."""

    config: Config
    camera: Camera
    frames: Sequence[Frame]
    telemetry: Sequence[NavEvent]

    @property
    def images(self) -> list[NDArray[np.uint8]]:
        """The pictures (H, W), every one."""
        return [f.image for f in self.frames if f.image is not None]


def leg_folder(seconds: float = 14.0, rate_hz: float = 30.0, cache: Path = CACHE) -> Path:
    """The files of a straight leg of the recorded plane 250 m up, generated once and then kept in `cache`."""
    folder = cache / f"leg_{seconds:g}s_{rate_hz:g}hz"
    if not (folder / "world.json").is_file():  # written last
        if folder.exists():
            raise FileExistsError(f"{folder} is half a flight; remove it")
        flight = RecordedSpec(str(RECORDING), START_S, whole_log=True)
        fly(SessionSpec(flight, seconds=seconds, rate_hz=rate_hz), folder)
    return folder


def leg(seconds: float = 14.0, rate_hz: float = 30.0, cache: Path = CACHE) -> Leg:
    """Load that leg into memory."""
    folder = leg_folder(seconds, rate_hz, cache)
    config = load_config(folder / "config.toml")
    camera = Camera.from_json(folder / "camera.json")
    recorded = Flight.open(config, camera, folder / "frames", folder / "telemetry.tlog", folder / "stamps.csv")
    frames = list(recorded.frames.frames())
    first, last = frames[0].stamp_ns, frames[-1].stamp_ns
    messages = sorted(recorded.telemetry.events, key=lambda e: e.stamp_ns)
    inside = [e for e in messages if not isinstance(e, Frame) and first <= e.stamp_ns <= last]
    return Leg(config, camera, frames, inside)


def out_and_back(simulated: Leg, frames: int) -> Iterator[Event]:
    """Events of `frames` pictures in order of arrival: telemetry a little after its stamp, pictures at theirs."""
    first, last = simulated.frames[0].stamp_ns, simulated.frames[-1].stamp_ns
    period_ns = (last - first) // (len(simulated.frames) - 1)
    length_ns = last - first + period_ns
    made, turn = 0, 0
    held: list[NavEvent] = []
    while made < frames:
        is_back = turn % 2 == 1
        start_ns = first + turn * length_ns
        messages = simulated.telemetry[::-1] if is_back else simulated.telemetry
        pictures = simulated.frames[::-1] if is_back else simulated.frames
        # Messages of the last pass that have not arrived yet come first.
        held += [
            _at(e, start_ns + ((last - e.stamp_ns) if is_back else (e.stamp_ns - first)), is_back) for e in messages
        ]
        for picture in pictures:
            stamp_ns = start_ns + ((last - picture.stamp_ns) if is_back else (picture.stamp_ns - first))
            arrived = next((i for i, e in enumerate(held) if e.stamp_ns + TELEMETRY_DELAY_NS > stamp_ns), len(held))
            yield from held[:arrived]
            del held[:arrived]
            yield replace(picture, stamp_ns=stamp_ns, index=made)
            made += 1
            if made == frames:
                break
        turn += 1
    yield from held


def _at(event: NavEvent, stamp_ns: int, is_back: bool) -> NavEvent:
    """The same at another moment, in the other direction if `is_back`."""
    if is_back and isinstance(event, PositionFix) and event.velocity_ned_m_s is not None:
        north, east, down = event.velocity_ned_m_s
        return replace(event, stamp_ns=stamp_ns, velocity_ned_m_s=(-north, -east, -down))
    if is_back and isinstance(event, Attitude) and event.rate_body_rad_s is not None:
        p, q, r = event.rate_body_rad_s
        return replace(event, stamp_ns=stamp_ns, rate_body_rad_s=(-p, -q, -r))
    return replace(event, stamp_ns=stamp_ns)


def first_sets(folder: Path, config: Config) -> list[tuple[Frame, FeatureSet]]:
    """Replay a simulated flight's folder: each picture with its first set, in the order of the sets."""
    camera = Camera.from_json(folder / "camera.json")
    recorded = Flight.open(config, camera, folder / "frames", folder / "telemetry.tlog", folder / "stamps.csv")
    return list(with_first_sets((event for _, event in recorded.events()), Pipeline(config, recorded.camera)))


def with_first_sets(events: Iterable[Event], pipeline: Pipeline) -> Iterator[tuple[Frame, FeatureSet]]:
    """Each picture with its first set, when that is made, as it is sent in flight."""
    frames: dict[int, Frame] = {}
    sent: set[int] = set()
    for event in events:
        if isinstance(event, Frame):
            frames[event.index] = event
        for made in pipeline.handle(event):
            if made.frame not in sent:
                sent.add(made.frame)
                yield frames[made.frame], made


def sets_of(simulated: Leg, features: int, frames: int | None = None) -> list[FeatureSet]:
    """Latest revision of every picture's set, those of exactly `features` features; more are cut off at random.

    Raises ValueError if the leg gives none of so many.
    """
    # Every feature of a picture need not be in its set: follow more than are wanted.
    tracking = simulated.config.tracking.model_copy(update={"features": min(round(1.6 * features), 200)})
    pipeline = Pipeline(simulated.config.model_copy(update={"tracking": tracking}), simulated.camera)
    latest: dict[int, FeatureSet] = {}
    for event in out_and_back(simulated, frames or len(simulated.frames)):
        latest |= {s.frame: s for s in pipeline.handle(event)}
    latest |= {s.frame: s for s in pipeline.finish()}
    rng = np.random.default_rng(0)
    out = []
    for s in latest.values():
        if s.is_ok and len(s) >= features:
            keep = np.sort(rng.permutation(len(s))[:features])
            out.append(
                replace(
                    s,
                    uv_px=s.uv_px[keep],
                    inverse_depth_per_m=s.inverse_depth_per_m[keep],
                    sigma_inverse_depth_per_m=s.sigma_inverse_depth_per_m[keep],
                )
            )
    if not out:
        raise ValueError(f"no picture of {len(latest)} has {features} features in its set")
    return out
