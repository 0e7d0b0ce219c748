"""Flights of a lens that zooms, with what is reported of it: in time, late, in steps, or not at all."""

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.sampled_flight import EPOCH_NS, SampledFlight, SampledSpec
from contract.camera import Camera
from contract.zoom_table import ZoomTable
from onboard.config.schema import parse_config
from onboard.events.types import Event, Zoom
from simulation.paths import PathSpec

Array = NDArray[np.float64]
WIDE = Camera.from_field_of_view(640, 480, 70.0)
LEVEL = PathSpec("straight", speed_m_s=10.0, height_m=200.0)
TURNS = PathSpec("turns", speed_m_s=15.0, height_m=200.0, bank_deg=45.0, leg_m=60.0)
TABLE_SIGMA = 0.005  # of each row's focal length
RATE_HZ = 10.0  # of what is reported

# (time, magnification): straight in the logarithm between.
STEPS = ((0.0, 1.0), (14.0, 1.0), (14.3, 2.5), (36.0, 2.5), (36.3, 6.0), (70.0, 6.0))
Profile = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class ZoomSpec(SampledSpec):
    """A simulated flight whose lens follows a profile."""

    profile: Profile = STEPS


class ZoomFlight(SampledFlight):
    """The lens as it is at each picture, and a table that errs by what it states."""

    spec: ZoomSpec

    def times_at(self, moment_s: Array) -> Array:
        at, times = np.array(self.spec.profile).T
        return np.exp(np.interp(moment_s, at, np.log(times)))

    def _cameras(self, R_body_cam: Array) -> list[Camera]:
        grown = self.times_at(self.times_s).tolist()
        return [replace(WIDE, fx_px=WIDE.fx_px * g, fy_px=WIDE.fy_px * g) for g in grown]

    def camera_file(self) -> Camera:
        """The widest view and a table of six rows, each off by its own draw."""
        rng = np.random.default_rng([self.seed, 313])
        off = np.exp(TABLE_SIGMA * rng.standard_normal(6))
        position = (1.0, 1.5, 2.5, 3.5, 5.0, 6.0)
        focal = tuple(WIDE.focal_px * p * o for p, o in zip(position, off.tolist(), strict=True))
        same = tuple([0.0] * 6)
        table = ZoomTable("times", position, focal, (WIDE.cx_px,) * 6, (WIDE.cy_px,) * 6, same)
        sigma = (TABLE_SIGMA, 0.002, 0.002, 0.002, 0.002)
        return replace(WIDE, fx_px=focal[0], fy_px=focal[0], stated_sigma=sigma, stated_zoom=table)

    def moves(self) -> list[tuple[float, float]]:
        p = self.spec.profile
        return [(a[0], b[0]) for a, b in itertools.pairwise(p) if a[1] != b[1]]

    def stands(self, frame: int) -> bool:
        t = float(self.times_s[frame])
        return not any(a < t < b for a, b in self.moves())


@dataclass(frozen=True)
class Telling:
    """How the zoom is reported: `late_s` behind the lens, in steps of the magnification, each with which share lost."""

    late_s: float = 0.02
    step: float = 0.0
    lost: float = 0.0
    bad: tuple[float, ...] = field(default=())  # reported between the others


def stated(flight: ZoomFlight, telling: Telling) -> Iterator[Event]:
    """The flight's events with reports of its zoom, stamped when they come."""
    rng = np.random.default_rng([flight.seed, 414])
    moments = np.arange(-3.0, flight.spec.seconds + 3.0, 1.0 / RATE_HZ)
    times = flight.times_at(moments - telling.late_s)
    if telling.step:
        times = np.round(times / telling.step) * telling.step
    reports = [
        Zoom(EPOCH_NS + round(t * 1e9), value, "times", telling.step)
        for t, value in zip(moments, times.tolist(), strict=True)
        if rng.uniform() >= telling.lost
    ]
    reports += [Zoom(EPOCH_NS + round((t + 0.05) * 1e9), bad, "times") for t in moments[::3] for bad in telling.bad]
    yield from sorted([*flight.events(), *reports], key=lambda event: event.stamp_ns)


def zoom_flight(path: PathSpec, profile: Profile, seed: int = 0, seconds: float | None = None) -> ZoomFlight:
    """A flight with four pictures a second."""
    spec = ZoomSpec(
        parse_config(""), path, seconds or profile[-1][0], 4.0, relief_sigma_m=3.0, camera=WIDE,
        profile=profile,
    )  # fmt: skip
    return ZoomFlight(spec, seed)


def magnification_error(focal_px: float, flight: ZoomFlight, moment_s: float) -> float:
    """How far a focal length is from the truth, as a share."""
    return abs(math.log(focal_px / (WIDE.focal_px * float(flight.times_at(np.array([moment_s]))[0]))))
