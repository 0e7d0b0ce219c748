"""Clicks of a camera that reads its rows in 30 ms, at 20 m/s and 20 degrees a second, beside a global shutter.

    python -m benchmarks.rolling_shutter [--flights 6] [--seconds 90] [--height 150] [--sensors full,gps]

Drawn flights with turns; clicks are asked from one minute on, all over the picture. Printed for each row: median and
90 % error, the median beside that of a global shutter on the same flights, the share inside the 90 % ellipse, the share
answered, the readout that was found with its sigma, averaged over flights, and processor time of the pipeline without
tracking (tracks are drawn), beside that of the global shutter.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.drawn_flight import PLACE, DrawnFlight, DrawnSpec, fly, replace_section
from contract.wire.codec import decode, encode
from ground.answer import CHI2_2, Fix
from ground.locate import Locator
from onboard.config.schema import parse_config
from simulation.paths import PathSpec

Array = NDArray[np.float64]

READOUT_S = 0.03
GLOBAL = "global shutter"
TOLD: dict[str, dict[str, float]] = {
    GLOBAL: {},
    "right": {"readout_s": READOUT_S},
    "right to 20 ms": {"readout_s": READOUT_S, "sigma_readout_s": 0.02},
    "0 to 20 ms": {"sigma_readout_s": 0.02},
    "10 ms too long": {"readout_s": READOUT_S + 0.01},
    "ignored": {},
}
BANK_DEG = 35.5  # turns by 20 degrees a second at 20 m/s
AFTER_S = 60.0
CLICKS = 4


@dataclass
class Result:
    """Of several flights: errors (m), squared errors in units of the covariance, clicks asked, readouts found."""

    error_m: list[float] = field(default_factory=list)
    chi2: list[float] = field(default_factory=list)
    asked: int = 0
    readout_s: list[tuple[float, float]] = field(default_factory=list)
    processor_s: float = 0.0


SENSORS: dict[str, dict[str, Any]] = {"full": {}, "gps": {"attitude": "none", "velocity": False}}


def spec_of(told: dict[str, float], seconds: float, height_m: float, sensors: str = "full") -> DrawnSpec:
    """The flight, told so of its rows."""
    config = replace_section(parse_config(""), "camera", **told)
    config = replace_section(config, "solve", **SENSORS[sensors])
    path = PathSpec("turns", speed_m_s=20.0, height_m=height_m, bank_deg=BANK_DEG, leg_m=160.0)
    return DrawnSpec(
        config, path, seconds, 3.0, relief_sigma_m=2.0, offset_s=0.0, readout_s=READOUT_S, gyro_sigma_deg_s=0.5
    )


def judge(spec: DrawnSpec, seed: int, into: Result) -> None:
    """Fly once and click, the sets over the wire."""
    flight = DrawnFlight(spec, seed)
    sets, pipeline = fly(flight)
    rng = np.random.default_rng([seed, 913])
    for k, t in enumerate(flight.times_s):
        if t < AFTER_S:
            continue
        pixels = rng.uniform(0.03, 0.97, (CLICKS, 2)) * (np.array(spec.camera.size_px) - 1)
        into.asked += CLICKS
        if k not in sets or not sets[k].is_ok:
            continue
        locator = Locator(decode(encode(sets[k])))
        for uv, truth in zip(pixels, flight.ground_points(k, pixels), strict=True):
            answer = locator.locate(uv)
            if isinstance(answer, Fix):
                assert answer.height_amsl_m is not None
                error = (PLACE.to_enu(answer.lat_deg, answer.lon_deg, answer.height_amsl_m) - truth)[:2]
                into.error_m.append(float(np.hypot(*error)))
                into.chi2.append(float(error @ np.linalg.solve(answer.covariance_enu_m2[:2, :2], error)))
    into.readout_s.append(pipeline.window.readout)
    into.processor_s += sum(seconds for stage, seconds in pipeline.summary.stage_seconds.items() if stage != "tracking")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--flights", type=int, default=6)
    parser.add_argument("--seconds", type=float, default=90.0)
    parser.add_argument("--height", type=float, default=150.0)
    parser.add_argument("--told", default=",".join(TOLD))
    parser.add_argument("--sensors", default="full,gps")
    args = parser.parse_args()
    print(f"{'sensors, told':<26} median  90 %   ratio | inside 90 % | answered | readout found, ms | processor time")
    for sensors in args.sensors.split(","):
        first: Result | None = None
        for name in args.told.split(","):
            spec, result = spec_of(TOLD[name], args.seconds, args.height, sensors), Result()
            if name == GLOBAL:
                spec = replace(spec, readout_s=0.0)
            for seed in range(args.flights):
                judge(spec, seed, result)
            first = first or result
            print(row(f"{sensors}, {name}", result, first), flush=True)


def row(name: str, result: Result, first: Result) -> str:
    """One line of the table; `first` is what is compared with."""
    if not result.error_m:
        return f"{name:<26} nothing"
    median, ninth = np.quantile(result.error_m, [0.5, 0.9])
    found, sigma = 1e3 * np.mean(result.readout_s, axis=0)
    return (
        f"{name:<26}{median:6.2f} {ninth:6.2f}  {median / np.median(first.error_m):5.2f} |"
        f" {100 * np.mean(np.array(result.chi2) < CHI2_2):8.1f} % | {100 * len(result.chi2) / result.asked:6.1f} % |"
        f" {found:8.2f} +-{sigma:5.2f} | {result.processor_s / max(first.processor_s, 1e-9):5.2f}"
    )


if __name__ == "__main__":
    main()
