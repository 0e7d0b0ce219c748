"""Clicks of a camera that reads its rows in 30 ms, at 20 m/s and 20 degrees a second: by what is told of the rows.

    python -m benchmarks.rolling_shutter [--flights 6] [--seconds 90] [--height 150]

Drawn flights with turns; clicks are asked from one minute on, all over the picture. Printed for each row: median and
90 % error, the first beside that of the right readout, the share inside the 90 % ellipse, the share answered, and the
readout that was found with its sigma, averaged over flights.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, field, replace

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
TOLD: dict[str, dict[str, float]] = {
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


def spec_of(told: dict[str, float], seconds: float, height_m: float) -> DrawnSpec:
    """The flight, told so of its rows."""
    config = replace_section(parse_config(""), "camera", **told)
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


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--flights", type=int, default=6)
    parser.add_argument("--seconds", type=float, default=90.0)
    parser.add_argument("--height", type=float, default=150.0)
    parser.add_argument("--told", default=",".join(TOLD))
    args = parser.parse_args()
    print(f"{'told':<26} median  90 %   ratio | inside 90 % | answered | readout found, ms")
    right = None
    for name in args.told.split(","):
        spec, result = spec_of(TOLD[name], args.seconds, args.height), Result()
        for seed in range(args.flights):
            judge(replace(spec), seed, result)
        median, ninth = np.quantile(result.error_m, [0.5, 0.9])
        right = median if right is None else right
        found, sigma = 1e3 * np.mean(result.readout_s, axis=0)
        inside = np.mean(np.array(result.chi2) < CHI2_2)
        print(
            f"{name:<26}{median:6.2f} {ninth:6.2f}  {median / right:5.2f} | {100 * inside:8.1f} % |"
            f" {100 * len(result.chi2) / result.asked:6.1f} % | {found:.2f} +-{sigma:.2f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
