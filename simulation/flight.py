"""A flight: true motion and its telemetry, on one clock.

A recorded flight takes both from a recording (`NAME.truth.csv` next to `NAME.tlog`); a described one (`paths`) has its
motion computed and its telemetry written by `telemetry`.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from contract.errors import InputError
from contract.geodesy import LocalFrame
from simulation import tlog
from simulation.paths import PathSpec, fly_path
from simulation.telemetry import TelemetrySpec, write_tlog
from simulation.trajectory import RecordedTruth, Trajectory

ROOT = Path(__file__).resolve().parent.parent
RECORDINGS = (ROOT / "tests" / "data", *(ROOT.parent / "shared" / "data" / folder for folder in ("sitl", "px4")))
SMOOTHING_MARGIN_S = 1.0


@dataclass(frozen=True, eq=False)
class Flight:
    """`trajectory` runs in seconds since `epoch_unix_s`; `origin` has an ellipsoidal height, at the ground's level."""

    trajectory: Trajectory
    telemetry: bytes
    origin: LocalFrame
    undulation_m: float  # ellipsoidal minus above-mean-sea-level height
    epoch_unix_s: float
    start_s: float  # when the first picture is taken, after the epoch


@dataclass(frozen=True)
class RecordedSpec:
    """A part of a recording.

    `recording` is a name in tests/data or ../shared/data/sitl, or a path to either file.
    `start_s` counts from the truth's first row; None begins once the aircraft has reached its usual height. With
    `whole_log` off, the log is cut to the flight and `log_margin_s` about it.
    """

    recording: str
    start_s: float | None = None
    ground_amsl_m: float = 100.0
    undulation_m: float = 0.0
    whole_log: bool = True
    log_margin_s: float = 10.0


@dataclass(frozen=True)
class DescribedSpec:
    """A path to fly and the telemetry to write of it, over ground at a place."""

    path: PathSpec = field(default_factory=PathSpec)
    telemetry: TelemetrySpec = field(default_factory=TelemetrySpec)
    lat_deg: float = -43.38
    lon_deg: float = 172.40
    ground_amsl_m: float = 100.0
    undulation_m: float = 11.0
    seed: int = 0


def find_recording(name: str) -> tuple[Path, Path]:
    """Paths of the log and the truth of a recording; raises InputError that states where it looked."""
    stem = name
    for ending in (".truth.csv", ".tlog"):
        stem = stem.removesuffix(ending)
    places = [Path(stem)] if "/" in stem else [Path(stem), *(folder / stem for folder in RECORDINGS)]
    for place in places:
        log, truth = place.with_name(place.name + ".tlog"), place.with_name(place.name + ".truth.csv")
        if log.is_file() and truth.is_file():
            return log, truth
    known = sorted(
        {path.name.removesuffix(".truth.csv") for f in RECORDINGS if f.is_dir() for path in f.glob("*.truth.csv")}
    )
    looked = ", ".join(str(place.parent) for place in places)
    raise InputError(
        f"recording {name!r}: no NAME.tlog with NAME.truth.csv in {looked}; known: {', '.join(known) or 'none'}"
    )


def least_delay_s(log: bytes) -> float:
    """Unix time of arrival minus autopilot boot time, of the least delayed stamped packet of a log."""
    delays = [arrival - boot for arrival, boot in _boot_stamps(log)]
    if not delays:
        raise InputError(
            "the telemetry log holds no ATTITUDE, GLOBAL_POSITION_INT or SYSTEM_TIME to take the time from"
        )
    return min(delays)


def _boot_stamps(log: bytes) -> Iterator[tuple[float, float]]:
    for packet in tlog.packets(log):
        payload = packet.record[18:-2] if packet.record[8] == 0xFD else packet.record[14:-2]
        if packet.message in (tlog.ATTITUDE, tlog.GLOBAL_POSITION_INT):
            yield packet.arrival_unix_s, struct.unpack("<I", payload[:4].ljust(4, b"\0"))[0] * 1e-3
        elif packet.message == tlog.SYSTEM_TIME:
            yield packet.arrival_unix_s, struct.unpack("<I", payload[8:12].ljust(4, b"\0"))[0] * 1e-3


def recorded_flight(spec: RecordedSpec, seconds: float) -> Flight:
    """A stretch of a recording; raises InputError where it does not cover the stretch."""
    log_path, truth_path = find_recording(spec.recording)
    truth = RecordedTruth.read(truth_path)
    first, last = float(truth.unix_time_s[0]), float(truth.unix_time_s[-1])
    if spec.start_s is None:
        usual_m = float(np.median(truth.height_amsl_m))
        start = float(truth.unix_time_s[np.argmax(truth.height_amsl_m > usual_m - 2.0)]) - first
    else:
        start = spec.start_s
    if start < 0.0 or first + start + seconds > last:
        raise InputError(
            f"recording {spec.recording}: it lasts {last - first:.0f} s; "
            f"{seconds:g} s from {start:.0f} s on is not within it"
        )
    begin = first + start
    log = tlog.read(log_path)
    shift = 0.0
    if not spec.whole_log:
        whole = least_delay_s(log)
        log = tlog.cut(log, begin - spec.log_margin_s, begin + seconds + spec.log_margin_s)
        # Boot clock and log clock drift apart, so a part of a log has a least delay of its own. Truth keeps to the
        # clock that a reader of this log will find.
        shift = least_delay_s(log) - whole
    part = truth.between(begin - SMOOTHING_MARGIN_S, begin + seconds + SMOOTHING_MARGIN_S)
    lowest = float(part.height_amsl_m.min())
    if lowest <= spec.ground_amsl_m + 5.0:
        raise InputError(
            f"recording {spec.recording}: from {start:.0f} s on the aircraft is "
            f"{lowest - spec.ground_amsl_m:.0f} m above the ground at {spec.ground_amsl_m:g} m; "
            "start later, once it flies"
        )
    middle = len(part.lat_deg) // 2
    origin = LocalFrame(
        round(float(part.lat_deg[middle]), 4),
        round(float(part.lon_deg[middle]), 4),
        spec.ground_amsl_m + spec.undulation_m,
    )
    epoch = begin
    return Flight(part.trajectory(origin, epoch, spec.undulation_m), log, origin, spec.undulation_m, epoch + shift, 0.0)


def described_flight(spec: DescribedSpec, seconds: float) -> Flight:
    """A computed flight of at least `seconds`, with its telemetry."""
    origin = LocalFrame(spec.lat_deg, spec.lon_deg, spec.ground_amsl_m + spec.undulation_m)
    trajectory = fly_path(spec.path, seconds, spec.seed)
    log, epoch = write_tlog(trajectory, origin, spec.undulation_m, spec.telemetry, spec.seed)
    return Flight(trajectory, log, origin, spec.undulation_m, epoch, 0.0)
