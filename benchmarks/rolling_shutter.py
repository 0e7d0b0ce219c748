"""Clicks of a camera that reads its rows in 30 ms, at 20 m/s and 20 degrees a second, and of one whose file is wrong.

    python -m benchmarks.rolling_shutter [--flights 24] [--seconds 66] [--height 150] [--sensors full,gps] [--told A,B]

Simulated flights with turns, compared with the same flights with a global shutter and the right file. A flight's
clicks share its slow errors and are one sample of them, so there are many flights, and only the pictures after one
minute are clicked, all over the picture. Everything is sampled as it is declared. The autopilot's age of positions is
known to 20 ms: with the default of 100 ms its filter would be off by 0.7 m/s in these turns, (5.16), and position and
velocity, sampled separately, would contradict each other as they do while a receiver is jammed, which is refused and
widens every later answer.

Printed for each row: median and 90 % error, the median relative to that of the first row, the share inside the 90 %
ellipse with one sigma of it between flights, the mean of squared errors over what was claimed (1 if honest), the share
answered, the readout that was found with its sigma, averaged over flights, and processor time without tracking,
relative to the first row's. Goal: 85 to 96 % inside, ratio at most 1.3.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.sampled_flight import PLACE, SampledFlight, SampledSpec, fly, replace_section
from benchmarks.scatter import mean_and_sigma
from contract.answer import CHI2_2, Fix
from contract.camera import Camera
from contract.locate import Locator
from contract.wire.codec import decode, encode
from onboard.config.schema import parse_config
from simulation.paths import PathSpec

Array = NDArray[np.float64]

READOUT_S = 0.03
GLOBAL = "global shutter"
RIGHT_TO_S = 0.02  # of the age of positions, as declared and sampled
# One sigma of the camera file's focal length, principal point, k1 and k2: it is off by the first and the fourth.
FILE_SIGMA = (0.03, 0.002, 0.002, 0.1, 0.01)
WRONG_FILE, UNSURE_FILE = "wrong file", "right file but unsure"
STATED: dict[str, dict[str, float]] = {
    GLOBAL: {},
    "right": {"readout_s": READOUT_S},
    "right to 20 ms": {"readout_s": READOUT_S, "sigma_readout_s": 0.02},
    "0 to 20 ms": {"sigma_readout_s": 0.02},
    "10 ms too long": {"readout_s": READOUT_S + 0.01},
    "ignored": {},
}
FILES = (WRONG_FILE, UNSURE_FILE)  # of a global shutter
BANK_DEG = 35.5  # turns by 20 degrees a second at 20 m/s
AFTER_S = 60.0
CLICKS = 4


@dataclass
class Result:
    """Results of flights: errors (m), squared errors over their covariances by flight, clicks asked, readouts."""

    error_m: list[float] = field(default_factory=list)
    chi2: list[list[float]] = field(default_factory=list)
    asked: int = 0
    readout_s: list[tuple[float, float]] = field(default_factory=list)
    processor_s: float = 0.0

    @property
    def inside(self) -> tuple[float, float]:
        """The share inside the 90 % ellipse, a flight as one sample, and one sigma of it."""
        return mean_and_sigma([float(np.mean(np.array(chi2) < CHI2_2)) for chi2 in self.chi2 if chi2])


SENSORS: dict[str, dict[str, Any]] = {"full": {}, "gps": {"attitude": "none", "velocity": False}}


def spec_of(stated: dict[str, float], seconds: float, height_m: float, sensors: str = "full") -> SampledSpec:
    """The flight, with this configuration of its rows."""
    config = replace_section(parse_config(""), "camera", **stated)
    config = replace_section(config, "solve", **SENSORS[sensors])
    config = replace_section(config, "gps", sigma_latency_s=RIGHT_TO_S)
    path = PathSpec("turns", speed_m_s=20.0, height_m=height_m, bank_deg=BANK_DEG, leg_m=160.0)
    return SampledSpec(config, path, seconds, 3.0, readout_s=READOUT_S, gyro_sigma_deg_s=0.5)


def filed(camera: Camera, name: str, seed: int) -> Camera:
    """The camera as its file has it: off by one sigma of focal length and k1, either way, or right and as unsure."""
    if name == UNSURE_FILE:
        return replace(camera, stated_sigma=FILE_SIGMA)
    focal, k1 = np.random.default_rng([seed, 914]).choice([-1.0, 1.0], 2) * [FILE_SIGMA[0], FILE_SIGMA[3]]
    fx_px, fy_px = camera.fx_px * (1.0 + focal), camera.fy_px * (1.0 + focal)
    return replace(camera, fx_px=fx_px, fy_px=fy_px, distortion=(k1, 0.0, 0.0, 0.0, 0.0), stated_sigma=FILE_SIGMA)


def simulated_of(name: str, seed: int, seconds: float, height_m: float, sensors: str = "full") -> SampledSpec:
    """The flight of a row of the table."""
    spec = spec_of(STATED.get(name, {}), seconds, height_m, sensors)
    if name in FILES:
        return replace(spec, readout_s=0.0, camera_file=filed(spec.camera, name, seed))
    return replace(spec, readout_s=0.0) if name == GLOBAL else spec


def judge(spec: SampledSpec, seed: int, into: Result, after_s: float = AFTER_S) -> None:
    """Fly once and click, the sets over the wire."""
    flight = SampledFlight(spec, seed)
    sets, pipeline = fly(flight)
    rng, chi2 = np.random.default_rng([seed, 913]), list[float]()
    for k, t in enumerate(flight.times_s):
        if t < after_s:
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
                chi2.append(float(error @ np.linalg.solve(answer.covariance_enu_m2[:2, :2], error)))
    into.chi2.append(chi2)
    into.readout_s.append(pipeline.window.readout)
    into.processor_s += sum(seconds for stage, seconds in pipeline.summary.stage_seconds.items() if stage != "tracking")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--flights", type=int, default=24)
    parser.add_argument("--seconds", type=float, default=66.0)
    parser.add_argument("--height", type=float, default=150.0)
    parser.add_argument("--told", dest="stated", default=",".join([*STATED, *FILES]))
    parser.add_argument("--sensors", default="full,gps")
    args = parser.parse_args()
    unknown = {*args.stated.split(","), *args.sensors.split(",")} - {*STATED, *FILES, *SENSORS}
    if unknown:
        parser.error(
            f"unknown: {', '.join(sorted(unknown))}; --told {', '.join([*STATED, *FILES])}; --sensors full, gps"
        )
    print(f"{'sensors, told':<26} median  90 %   ratio | inside 90 %, chi2 | answered | readout found, ms | processor")
    for sensors in args.sensors.split(","):
        first: Result | None = None
        for name in args.stated.split(","):
            result = Result()
            for seed in range(args.flights):
                judge(simulated_of(name, seed, args.seconds, args.height, sensors), seed, result)
            first = first or result
            print(row(f"{sensors}, {name}", result, first), flush=True)


def row(name: str, result: Result, first: Result) -> str:
    """One line of the table; `first` is what is compared with."""
    if not result.error_m:
        return f"{name:<26} nothing"
    median, ninth = np.quantile(result.error_m, [0.5, 0.9])
    found, sigma = 1e3 * np.mean(result.readout_s, axis=0)
    share, spread = result.inside
    answered = np.concatenate(result.chi2)
    return (
        f"{name:<26}{median:6.2f} {ninth:6.2f}  {median / np.median(first.error_m):5.2f} |"
        f" {100 * share:5.1f} +-{100 * spread:4.1f} %  {np.mean(answered) / 2.0:4.2f} |"
        f" {100 * len(answered) / result.asked:6.1f} % |"
        f" {found:8.2f} +-{sigma:5.2f} | {result.processor_s / max(first.processor_s, 1e-9):5.2f}"
    )


if __name__ == "__main__":
    main()
