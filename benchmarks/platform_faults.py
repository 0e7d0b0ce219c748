"""Faults, by name, of the platform of a flight in `benchmarks.autopilots`, and what is passed to the daemon."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from benchmarks.sampled_flight import HillCountry, Hills, Valley
from benchmarks.sensor_faults import EVERY_MINUTE
from contract.camera import UNKNOWN_SIGMA, Camera
from onboard.config.delay_prior import NETWORK_PRIOR_S

LENS = Camera.from_field_of_view(640, 480, 40.0)

FAULTS: dict[str, dict[str, Any]] = {
    "none": {},
    "late": {"stamps_late_s": 0.2, "mount_error_deg": (2.0, 1.5, 0.0)},
    # A network stream, of whose delay nothing is known but that it is up to a second: nearly the shortest, the longest.
    "stream early": {"stamps_late_s": -0.45},
    "stream late": {"stamps_late_s": 0.45},
    "1hz": {"attitude_hz": 1.0},
    "slope": {"slope_deg": 9.8},
    # The camera file states nothing about its errors: it is right all the same, or 3 % and 0.1 wrong.
    "unsure lens": {"camera_file": replace(LENS, stated_sigma=UNKNOWN_SIGMA)},
    "wrong lens": {
        "camera_file": replace(
            LENS,
            fx_px=1.03 * LENS.fx_px,
            fy_px=1.03 * LENS.fy_px,
            distortion=(0.1, 0.0, 0.0, 0.0, 0.0),
            stated_sigma=UNKNOWN_SIGMA,
        )
    },
    # Rows read in 30 ms: as the configuration states, to 20 ms, for sure; and stated to be a global shutter, wrongly.
    **{f"rolling{how}": {"readout_s": 0.03} for how in ("", " unsure", " found", " ignored")},
    # Electronic stabilisation that smooths over half a second, and over two; a lens that zooms and comes back.
    "stabilised": {"stabilised_s": 0.5},
    "stabilised 2 s": {"stabilised_s": 2.0},
    "zoom": {"zoom": (1.25, 45.0, 75.0)},
    "zoom 5 %": {"zoom": (1.05, 45.0, 75.0)},
    "slope-east": {"slope_deg": 9.8, "rises_towards_deg": 90.0},
    "slope-north": {"slope_deg": 9.8, "rises_towards_deg": 0.0},
    "slope-4": {"slope_deg": 4.0, "rises_towards_deg": 300.0},
    "valley": {"slope_deg": 9.8, "rises_towards_deg": 36.9, "ground": Valley},
    "hills": {"ground": Hills},
    # Steeper than declared: short hills of 6 m on these, and hills of all lengths.
    "rough": {"ground": Hills, "relief_sigma_m": 6.0},
    "hill country": {"ground": HillCountry},
    **{name: {"disturbances": every} for name, every in EVERY_MINUTE.items()},
}


# What is passed to the daemon about a stream, and about the rows, where that is not a global shutter.
BELIEVED: dict[str, dict[str, float]] = {
    "stream early": {"sigma_latency_s": NETWORK_PRIOR_S[1]},
    "stream late": {"sigma_latency_s": NETWORK_PRIOR_S[1]},
    "rolling": {"readout_s": 0.03},
    "rolling unsure": {"readout_s": 0.03, "sigma_readout_s": 0.02},
    "rolling found": {"sigma_readout_s": 0.02},
}
