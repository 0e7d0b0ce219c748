"""The report of the daemon on itself, once a second: one type that `status`, `doctor` and Prometheus share.

Requested over the link it travels as JSON (docs/wire-format.md, section 10, `detail`). A reader takes keys it does not
know as those of a later version and ignores them; what an earlier version did not send has the default below.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, TypeAdapter, ValidationError

from contract.errors import LinkError
from contract.supervised_thread import ThreadReport
from contract.vehicle_status import VehicleStatus
from onboard.events.source import SourceStatus
from onboard.events.tunnel import RadioReport
from onboard.events.types import GpsQuality
from onboard.pipeline.summary import Budget, Contradiction, Estimate, LeftOut, SensorError, Summary
from onboard.service.vehicle_state import Finding, GpsReport

BLACK, WHITE = 2, 253  # grey levels up to which and from which a pixel holds no information
EVERY = 8  # pixels looked at for the brightness, in both directions


@dataclass(frozen=True)
class Brightness:
    """Mean grey (0 to 255) of a picture and the shares (0 to 1) of it that are black and white."""

    mean: float
    black: float
    white: float

    @classmethod
    def of(cls, image: NDArray[np.uint8]) -> Brightness:
        """Return the brightness of a grey picture (H, W), from every eighth pixel of every eighth row."""
        sample = image[::EVERY, ::EVERY]
        return cls(float(sample.mean()), float((sample <= BLACK).mean()), float((sample >= WHITE).mean()))


@dataclass(frozen=True)
class PictureCounts:
    """The outcomes of the session's pictures; each counts by its latest revision, `refused` by reason."""

    handled: int = 0
    keyframes: int = 0
    solved: int = 0
    refused: Mapping[str, int] = field(default_factory=dict)
    reprojection_px: float = 0.0
    unencodable: int = 0  # sets that had no encoding and were left out
    left_out: LeftOut = field(default_factory=LeftOut)  # of the newest picture

    @classmethod
    def of(cls, summary: Summary, unencodable: int) -> PictureCounts:
        """Return the counts of the pipeline's statistics."""
        s = summary
        return cls(s.frames, s.keyframes, s.solved, dict(s.refused), s.reprojection_px, unencodable, s.left_out)


def gps_report(quality: GpsQuality | None, now_ns: int) -> GpsReport | None:
    """The receiver's newest report and how old it is at `now_ns` (session clock); None before the first."""
    q = quality
    if q is None:
        return None
    age_s = (now_ns - q.stamp_ns) / 1e9
    return GpsReport(q.fix_type, age_s, q.satellites, q.sigma_horizontal_m, q.sigma_vertical_m)


@dataclass(frozen=True)
class RecordingReport:
    """The state of the recording: whether there is one, and why not if there should be."""

    is_on: bool = False
    fault: str = ""


@dataclass(frozen=True)
class ClockReport:
    """The distance that the host's Unix clock has moved away from the session's since the start."""

    host_step_s: float = 0.0


@dataclass(frozen=True)
class Report:
    """One moment of the daemon. `findings` is everything that is not well, its cause first: see `vehicle_state`."""

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(ser_json_inf_nan="strings")

    status: VehicleStatus
    camera: SourceStatus
    telemetry: SourceStatus
    findings: tuple[Finding, ...] = ()
    brightness: Brightness | None = None  # of the newest picture that was looked at; None before the first
    gps: GpsReport | None = None
    pictures: PictureCounts = PictureCounts()
    estimates: tuple[Estimate, ...] = ()
    sensor_errors: tuple[SensorError, ...] = ()
    contradictions: tuple[Contradiction, ...] = ()
    threads: tuple[ThreadReport, ...] = ()
    recording: RecordingReport = RecordingReport()
    clock: ClockReport = ClockReport()
    unconfirmed: tuple[Estimate, ...] = ()  # found, but too far from the prior to be adopted by itself
    budget: Budget | None = None  # of a click in the middle of the newest picture; None while it is not known
    thermal_camera: SourceStatus | None = None  # a second camera next to the first; None where there is none
    radio: RadioReport | None = None  # the autopilot's, where link.mavlink is on

    def estimate(self, name: str) -> Estimate | None:
        return next((e for e in self.estimates if e.name == name), None)

    def to_json(self) -> bytes:
        """One line. Numbers that are not finite are the texts "NaN" and "Infinity", which JSON has no numbers for."""
        return _ADAPTER.dump_json(self)

    @classmethod
    def from_json(cls, payload: bytes) -> Report:
        """Raises LinkError for what is no report."""
        try:
            return _ADAPTER.validate_json(payload)
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(str(part) for part in first["loc"]) or "it"
            raise LinkError(
                f"the daemon's report cannot be read ({where}: {first['msg']}); is it of another version?"
            ) from error


_ADAPTER: TypeAdapter[Report] = TypeAdapter(Report)
