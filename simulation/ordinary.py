"""The preset "ordinary": telemetry with the errors of ordinary autopilots, each sampled from its own distribution.

The distributions hold what was measured of recorded flights (`../shared/data/sitl`, and others of the same software):

| error | sampled | measured |
|---|---|---|
| position's lag | normal, 0.10 s, at most 0.25 | -0.22 to +0.19 s; five recordings -0.03, 0.03, 0.04, 0.05, 0.15 |
| velocity's lag | 0.4 to 0.7 of position's | 0.41 to 0.71 |
| trim of roll and pitch | normal, 0.7 deg each | 0.0 to 1.2 deg |
| slow tilt | log-uniform, 0.15 to 1.2 deg | 0.1 to 1.3 deg |
| tilt by acceleration | normal, 0.04 deg per m/s2 | -0.04 to 0.05, gusts to 0.12 |
| heading by heading | 0 to 5 deg, cosine and sine of any phase | 0.2 to 3.2 deg |
| heading, constant; drift | normal, 0.5 deg; log-uniform, 0.2 to 2 deg | -0.4 to 0.8; 0.2 to 2.4 |
| velocity, level | uniform, 0.06 to 0.25 m/s | 0.05 to 0.26 |
| velocity by acceleration | uniform, 0.01 to 0.12 m/s per m/s2 | 0.01 to 0.13 |
| GPS, correlated error | log-uniform, 0.5 to 2.5 m, 30 to 120 s; 1.6 times up | 0.8 to 1.5 m, 60 s |
| GPS glitch, on three flights of ten | 5 to 35 m for 8 to 25 s | 33 m for 12 s, 8 m for 20 s |
| rates | attitude 2 to 50 Hz, position 2 to 10, receiver 2 to 10 | 3.3, 3.7 and 4.0 on a real flight |
"""

from __future__ import annotations

import numpy as np

from simulation.autopilot_errors import AutopilotErrors
from simulation.telemetry import TelemetrySpec

POSITION_LAG_S, MAX_POSITION_LAG_S = 0.10, 0.25
VELOCITY_LAG_SHARE = (0.4, 0.7)
TRIM_DEG = 0.7
TILT_DEG = (0.15, 1.2)
TILT_PER_M_S2_DEG = 0.04
HEADING_DEG, MAX_HEADING_BY_HEADING_DEG = 0.5, 5.0
HEADING_DRIFT_DEG = (0.2, 2.0)
VELOCITY_M_S, VELOCITY_PER_M_S2 = (0.06, 0.25), (0.01, 0.12)
SLOW_M, SLOW_TIME_S, VERTICAL_SHARE = (0.5, 2.5), (30.0, 120.0), 1.6
GLITCH_SHARE, GLITCH_M, GLITCH_S = 0.3, (5.0, 35.0), (8.0, 25.0)
ATTITUDE_HZ = (2.0, 3.3, 4.0, 10.0, 10.0, 25.0, 25.0, 50.0)
POSITION_HZ = (2.0, 3.3, 4.0, 5.0, 10.0)
GPS_HZ = (2.0, 4.0, 5.0, 5.0, 10.0)


def ordinary(seed: int) -> TelemetrySpec:
    """One autopilot with sampled errors; the same seed is the same autopilot."""
    rng = np.random.default_rng([seed, 607])

    def log_uniform(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    lag_s = float(np.clip(POSITION_LAG_S * rng.standard_normal(), -MAX_POSITION_LAG_S, MAX_POSITION_LAG_S))
    by_heading, phase = rng.uniform(0.0, MAX_HEADING_BY_HEADING_DEG), rng.uniform(0.0, 2.0 * np.pi)
    bearing, size_m = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(*GLITCH_M) * (rng.uniform() < GLITCH_SHARE)
    trim, by_acceleration = TRIM_DEG * rng.standard_normal(2), TILT_PER_M_S2_DEG * rng.standard_normal(2)
    errors = AutopilotErrors(
        position_lag_s=lag_s,
        velocity_lag_s=lag_s * rng.uniform(*VELOCITY_LAG_SHARE),
        trim_deg=(float(trim[0]), float(trim[1])),
        tilt_deg=log_uniform(*TILT_DEG),
        tilt_per_m_s2_deg=(float(by_acceleration[0]), float(by_acceleration[1])),
        heading_deg=HEADING_DEG * float(rng.standard_normal()),
        heading_cos_deg=float(by_heading * np.cos(phase)),
        heading_sin_deg=float(by_heading * np.sin(phase)),
        heading_drift_deg=log_uniform(*HEADING_DRIFT_DEG),
        velocity_m_s=rng.uniform(*VELOCITY_M_S),
        velocity_per_m_s2=rng.uniform(*VELOCITY_PER_M_S2),
        glitch_m=(float(size_m * np.sin(bearing)), float(size_m * np.cos(bearing)), float(0.5 * size_m)),
        glitch_start_share=rng.uniform(0.1, 0.9),
        glitch_s=rng.uniform(*GLITCH_S),
        glitch_follow_s=rng.uniform(1.0, 4.0),
        glitch_in_velocity=rng.uniform(0.0, 0.5),
    )
    slow_m = log_uniform(*SLOW_M)
    return TelemetrySpec(
        position_hz=float(rng.choice(POSITION_HZ)),
        gps_hz=float(rng.choice(GPS_HZ)),
        attitude_hz=float(rng.choice(ATTITUDE_HZ)),
        slow_horizontal_m=slow_m,
        slow_vertical_m=VERTICAL_SHARE * slow_m,
        slow_time_constant_s=rng.uniform(*SLOW_TIME_S),
        velocity_m_s=0.05,
        slow_attitude_deg=0.0,
        jitter_s=log_uniform(0.005, 0.05),
        errors=errors,
    )
