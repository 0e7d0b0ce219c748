"""Boot time -> Unix time by the GPS time that a receiver reported, for logs that have no stamps of another clock.

A report of a fix is logged later than the fix was true, never earlier: as with messages over a link, the least delayed
report gives the offset but for the least delay. That delay, 0.05 to 0.2 s, is the receiver's own; it is estimated from
the receiver's track against the filter's, which has allowed for it.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from onboard.clocks.boot_clock import BootClock, Mode

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Filtered = tuple[Ints, Array]

NS_PER_S = 1_000_000_000
METRES_A_DEGREE = 111_320.0
GPS_EPOCH_UNIX_S = 315_964_800  # 1980-01-06
WEEK_S = 604_800
# GPS minus UTC, from Unix second on (IERS Bulletin C; none has been announced since 2017).
LEAP_SECONDS = ((1_483_228_800, 18), (1_435_708_800, 17), (1_341_100_800, 16), (1_230_768_000, 15), (0, 14))

LAG_S, SIGMA_LAG_S = 0.12, 0.08  # of receivers, before the tracks are compared
SIGMA_BIAS_M = 5.0  # constant offset of filter and receiver
SIGMA_TRACK_M = 1.0  # of their difference otherwise
TRACK_TIME_S = 5.0  # over which that keeps its value
MAX_LAG_S = 1.0


def unix_ns_of_gps(week: int, time_of_week_ms: int) -> int:
    """GPS week and its milliseconds -> Unix ns."""
    gps_ms = GPS_EPOCH_UNIX_S * 1000 + week * WEEK_S * 1000 + time_of_week_ms
    return (gps_ms - leap_seconds(gps_ms / 1000) * 1000) * 1_000_000


def leap_seconds(gps_s: float) -> int:
    """Return GPS minus UTC, s, at a GPS time that is counted as Unix time is."""
    return next(leap for since, leap in LEAP_SECONDS if gps_s - leap >= since)


class GpsClock:
    """Boot time -> Unix time. Feed all reports first."""

    def __init__(self, mode: Mode) -> None:
        # A crystal drifts by 0.1 s in an hour at 30 ppm: too little to distinguish from a link's queues, but no link
        # is here.
        self._clock = BootClock("drift" if mode == "auto" else mode)
        self._origin_ns: int | None = None
        self.lag_s = 0.0

    @property
    def is_set(self) -> bool:
        return self._origin_ns is not None

    def add(self, boot_ns: int, unix_ns: int) -> None:
        """A fix that was true at `unix_ns` and reported at `boot_ns`."""
        if self._origin_ns is None:
            self._origin_ns = unix_ns - boot_ns
        self._clock.add(boot_ns, 2 * boot_ns + self._origin_ns - unix_ns)

    def to_unix_ns(self, boot_ns: int) -> int:
        """Boot time on Unix time; raises LookupError before the first `add`."""
        if self._origin_ns is None:
            raise LookupError("no report has given the time yet")
        delay_ns = self._clock.to_host_ns(boot_ns) - boot_ns
        return boot_ns + self._origin_ns - delay_ns + round(self.lag_s * 1e9)

    @property
    def segments(self) -> int:
        """The number of times that boot time began, or GPS time stepped."""
        return self._clock.segments


def receiver_lag_s(clock: GpsClock, boot_us: Ints, unix_ns: list[int], fixes_deg: Array, filtered: Filtered) -> float:
    """Return how long, in s, after it was true a receiver's fix is reported, with the least delayed as time so far.

    The receiver's track, `fixes_deg` (N, 2), true at `unix_ns` and reported at `boot_us`, is compared with a filter's,
    boot time in us (M,) and (M, 2); both are latitude, longitude in degrees.
    Least squares for the lag and a constant offset of both tracks, with a prior at the usual values. The estimate stays
    at what is usual where the aircraft did not move, or flew only straight on.
    """
    metres = METRES_A_DEGREE * np.array([1.0, math.cos(math.radians(float(fixes_deg[0, 0])))])
    receiver_ne_m, filter_ne_m = ((degrees - fixes_deg[0]) * metres for degrees in (fixes_deg, filtered[1]))
    pairs = zip((boot_us * 1000).tolist(), unix_ns, strict=True)
    reported_s = np.array([(boot_ns + true_ns - clock.to_unix_ns(boot_ns)) / 1e9 for boot_ns, true_ns in pairs])
    filter_s = filtered[0].astype(float) * 1e-6
    lag = LAG_S
    if len(filter_s) < 10:
        return lag
    inside = (reported_s > filter_s[0] + MAX_LAG_S) & (reported_s < filter_s[-1])
    inside &= np.isfinite(receiver_ne_m).all(axis=1)
    times, seen = reported_s[inside], receiver_ne_m[inside]
    if len(times) < 10:
        return lag
    spacing_s = float(np.median(np.diff(times)))
    sigma_m = SIGMA_TRACK_M * np.sqrt(max(TRACK_TIME_S / max(spacing_s, 1e-3), 1.0))
    prior = np.diag([1.0 / SIGMA_LAG_S**2, 1.0 / SIGMA_BIAS_M**2, 1.0 / SIGMA_BIAS_M**2])
    for _ in range(5):
        at, before = (_track(filter_s, filter_ne_m, times - lag - h) for h in (0.0, 0.1))
        speed = (at - before) / 0.1
        J = np.zeros((len(times), 2, 3))
        J[:, :, 0] = -speed
        J[:, 0, 1] = J[:, 1, 2] = 1.0
        A, b = J.reshape(-1, 3) / sigma_m, (seen - at).ravel() / sigma_m
        weight = 1.0 / np.maximum(np.abs(b), 1.0)  # a glitch is no lag
        normal = A.T @ (A * weight[:, None]) + prior
        step = np.linalg.solve(normal, A.T @ (b * weight) + prior[:, 0] * (LAG_S - lag))
        lag = float(np.clip(lag + step[0], 0.0, MAX_LAG_S))
    return lag


def _track(times: Array, ne_m: Array, at: Array) -> Array:
    return np.stack([np.interp(at, times, ne_m[:, i]) for i in (0, 1)], axis=-1)
