"""The values that a run and a daemon report of a flight.

They import nothing that estimates, so that `pc-onboard status` answers at once.

The estimates of the platform and the sensors' errors (`estimates` makes them), and the outcomes of the pictures
(`statistics` counts them).
"""

from __future__ import annotations

from dataclasses import dataclass, field

from onboard.georeferencing.budget import Budget
from onboard.navigation.limits import FORGOTTEN

__all__ = ["Budget", "Contradiction", "Estimate", "LeftOut", "SensorError", "Shortfall", "Summary"]


@dataclass(frozen=True)
class Estimate:
    """One quantity that is estimated in flight: a name, its unit, and as many values as it has components."""

    name: str
    unit: str  # as Prometheus writes it: radians, seconds, meters, ...
    values: tuple[float, ...]
    sigmas: tuple[float, ...]


@dataclass(frozen=True)
class SensorError:
    """One sigma of one part of the sensors' errors: as estimated in flight, and as configured."""

    name: str  # one of `sensor_table.PARTS`
    unit: str  # deg, m/s, m, s
    sigma: float
    declared: float

    def __str__(self) -> str:
        return f"{self.name.replace('_', ' ')} {self.sigma:.2g} {self.unit}, declared {self.declared:g}"


@dataclass(frozen=True)
class Contradiction:
    """A sensor that contradicts all others, or did: how it counts, and since when it does so without a pause."""

    name: str  # position, velocity, tilt or heading
    sigma_times: float  # what its sigma counts as many times of; 1 once it agrees again
    duration_s: float  # from the first to the last window of its newest failure
    windows: int  # in which it failed since the start

    @property
    def is_now(self) -> bool:
        """True while it is taken to be wrong."""
        return self.sigma_times**2 > FORGOTTEN

    def __str__(self) -> str:
        if self.is_now:
            for_s = f" for {self.duration_s:.0f} s" if self.duration_s >= 1.0 else ""
            times = f"{self.sigma_times:.2g} times its sigma"
            return f"{self.name} contradicts the other sensors{for_s} and counts with {times}"
        return f"{self.name} contradicted the other sensors in {self.windows} windows"


@dataclass(frozen=True)
class Shortfall:
    """The likely reason why no picture has an answer, and its remedy, one line each."""

    reason: str
    remedy: str


@dataclass(frozen=True)
class LeftOut:
    """Shares (0 to 1) of the picture where no features are taken."""

    masked: float = 0.0  # by `camera.mask`
    standing: float = 0.0  # found in flight: it stands still while the ground moves

    def __str__(self) -> str:
        """Empty if nothing is left out."""
        why = "found: stands still while the ground moves (a display, or the aircraft itself)"
        parts = ((self.masked, "by camera.mask"), (self.standing, why))
        return ", ".join(f"{100.0 * share:.0f} % {what}" for share, what in parts if share > 0.0)


@dataclass
class Summary:
    """Outcomes of the pictures. `refused` counts reasons; `stage_seconds` is processor time by stage."""

    frames: int = 0
    shortfall: Shortfall | None = None  # why nothing was solved, where nothing was
    keyframes: int = 0
    solved: int = 0
    refused: dict[str, int] = field(default_factory=dict)
    refused_windows: dict[str, int] = field(default_factory=dict)  # by what spoke against them
    median_tracks: float = 0.0
    reprojection_px: float = 0.0
    estimates: tuple[Estimate, ...] = ()  # of the platform; empty before the first update
    sensor_errors: tuple[SensorError, ...] = ()  # how large they are, as estimated and as configured
    unconfirmed: tuple[Estimate, ...] = ()  # found, but too far from the prior to be adopted by itself
    contradictions: tuple[Contradiction, ...] = ()  # sensors that contradict the others, or did
    terrain_doubt: str = ""  # how far the terrain model, which answers nothing then, is off; empty: it is not
    mounted_on: str = ""  # what the camera was assumed to be mounted on
    left_out: LeftOut = field(default_factory=LeftOut)
    stage_seconds: dict[str, float] = field(default_factory=dict)
