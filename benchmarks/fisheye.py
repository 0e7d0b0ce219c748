"""Clicks through a fisheye of 110 and 150 degrees, rows read in turn, against a 60 degree pinhole's of the same flight.

    python -m benchmarks.fisheye [--flights 8] [--seconds 16] [--lenses 60,110,150] [--off 0,0.03]

Rendered flights with turns, 640x480, five pictures a second: tracked, adjusted and clicked as in the air, the sets over
the wire. The lower the wider the lens is, so that a pixel in the picture's middle is as large on the ground as the
pinhole's from 100 m. `off`: by how much the camera file's focal length is wrong, either way, which is its one sigma.

Printed for each row: median and 90 % error, the median relative to the pinhole's, the share inside the 90 % ellipse
with one sigma of it between flights, the share answered of what shows ground, and by how many of its sigmas the focal
length that was found is off, root mean square. Goal: 85 to 96 % inside, ratio at most 1.2, sigmas about 1.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from benchmarks.scatter import mean_and_sigma
from contract.answer import CHI2_2, Fix
from contract.camera import Camera
from contract.feature_set import FeatureSet
from contract.lens import FISHEYE
from contract.locate import Locator
from contract.wire.codec import decode, encode
from onboard.config.schema import load_config
from onboard.estimation.platform_states import STATES
from onboard.pipeline.pipeline import Pipeline
from onboard.replay.runner import Flight
from simulation.flight import DescribedSpec
from simulation.paths import PathSpec
from simulation.session import SessionSpec, fly
from simulation.terrain import TerrainSpec
from simulation.texture import TextureSpec
from simulation.truth import Truth

SIZE_PX, PINHOLE_DEG, HEIGHT_M, SPEED_M_S, RATE_HZ, READOUT_S = (640, 480), 60.0, 100.0, 12.0, 5.0, 0.02
DISTORTION = (0.02, -0.01, 0.003, -0.0005)
FILE_SIGMA = (0.03, 0.002, 0.002, 0.05, 0.02)
AFTER_S, CLICKS = 6.0, 6


@dataclass
class Result:
    """Results of flights: errors (m), squared errors over their covariances by flight, clicks asked, focal lengths."""

    error_m: list[float] = field(default_factory=list)
    chi2: list[list[float]] = field(default_factory=list)
    asked: int = 0
    focal_sigmas: list[float] = field(default_factory=list)


def lens(wide_deg: float, size_px: tuple[int, int] = SIZE_PX) -> tuple[Camera, float]:
    """A lens, and the height (m) at which its middle has the pinhole's ground sample distance."""
    pinhole = Camera.from_field_of_view(*size_px, PINHOLE_DEG)
    if wide_deg == PINHOLE_DEG:
        return pinhole, HEIGHT_M
    focal_px = 0.5 * size_px[0] / np.radians(0.5 * wide_deg)
    camera = replace(pinhole, fx_px=focal_px, fy_px=focal_px, distortion=DISTORTION, model=FISHEYE)
    return camera, HEIGHT_M * camera.fx_px / pinhole.fx_px


def spec_of(
    wide_deg: float, off: float, seed: int, seconds: float, size_px: tuple[int, int] = SIZE_PX
) -> tuple[SessionSpec, float]:
    """A flight, and the relative error of its camera file's focal length."""
    camera, height_m = lens(wide_deg, size_px)
    wrong = off * float(np.random.default_rng([seed, 915]).choice([-1.0, 1.0]))
    filed = replace(camera, fx_px=camera.fx_px * (1 + wrong), fy_px=camera.fy_px * (1 + wrong), stated_sigma=FILE_SIGMA)
    spec = SessionSpec(
        DescribedSpec(PathSpec("turns", speed_m_s=SPEED_M_S, height_m=height_m), seed=seed),
        seconds=seconds,
        rate_hz=RATE_HZ,
        camera=camera,
        filed_camera=filed,
        terrain=TerrainSpec(relief_m=4.0, seed=seed),
        texture=TextureSpec("land", seed=seed),
        readout_s=READOUT_S,
        seed=seed,
    )
    return spec, wrong


def judge(spec: SessionSpec, wrong: float, into: Result, after_s: float = AFTER_S) -> None:
    """Render and fly once, and click."""
    with tempfile.TemporaryDirectory() as folder:
        flight = Path(folder) / "flight"
        truth = fly(spec, flight)
        config, camera = load_config(flight / "config.toml"), Camera.from_json(flight / "camera.json")
        recorded = Flight.open(config, camera, flight / "frames", flight / "telemetry.tlog", flight / "stamps.csv")
        pipeline, sets = Pipeline(config, recorded.camera), dict[int, FeatureSet]()
        for _, event in recorded.events():
            sets |= {s.frame: s for s in pipeline.handle(event)}
        sets |= {s.frame: s for s in pipeline.finish()}
    rng, chi2 = np.random.default_rng([spec.seed, 916]), list[float]()
    for frame in range(round(after_s * spec.rate_hz), len(truth)):
        uv = rng.uniform(0.05, 0.95, (CLICKS, 2)) * (np.array(spec.camera.size_px) - 1)
        click(truth, frame, uv, sets.get(frame), into, chi2)
    into.chi2.append(chi2)
    platform = pipeline.window.alignment.platform
    into.focal_sigmas.append((platform.mean[STATES] + np.log1p(wrong)) / platform.sigma[STATES])


def click(truth: Truth, frame: int, uv_px: np.ndarray, s: FeatureSet | None, into: Result, chi2: list[float]) -> None:
    """Click a picture's pixels (N, 2) that show ground."""
    ground = truth.ground(frame, uv_px)
    locator = None if s is None or not s.is_ok else Locator(decode(encode(s)))
    for uv, at, is_valid in zip(uv_px, ground.enu_m, ground.is_valid, strict=True):
        into.asked += bool(is_valid)
        answer = locator.locate(uv) if locator is not None and is_valid else None
        if isinstance(answer, Fix):
            assert answer.height_ellipsoid_m is not None
            error = (truth.origin.to_enu(answer.lat_deg, answer.lon_deg, answer.height_ellipsoid_m) - at)[:2]
            into.error_m.append(float(np.hypot(*error)))
            chi2.append(float(error @ np.linalg.solve(answer.covariance_enu_m2[:2, :2], error)))


def row(name: str, result: Result, first: Result) -> str:
    """One line of the table; `first` is what is compared with."""
    median, ninth = np.quantile(result.error_m, [0.5, 0.9])
    share, spread = mean_and_sigma([float(np.mean(np.array(chi2) < CHI2_2)) for chi2 in result.chi2 if chi2])
    return (
        f"{name:<24}{median:6.2f} {ninth:6.2f}  {median / np.median(first.error_m):5.2f} |"
        f" {100 * share:5.1f} +-{100 * spread:4.1f} % | {100 * len(result.error_m) / result.asked:6.1f} % |"
        f" {np.sqrt(np.mean(np.square(result.focal_sigmas))):5.2f}"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--flights", type=int, default=8)
    parser.add_argument("--seconds", type=float, default=16.0)
    parser.add_argument("--lenses", default="60,110,150")
    parser.add_argument("--off", default="0,0.03")
    args = parser.parse_args()
    print(f"{'lens, file off':<24}median  90 %  ratio | inside 90 %    | answered | focal length, sigmas")
    for off in (float(each) for each in args.off.split(",")):
        first: Result | None = None
        for wide_deg in (float(each) for each in args.lenses.split(",")):
            result = Result()
            for seed in range(args.flights):
                judge(*spec_of(wide_deg, off, seed, args.seconds), result)
            first = first or result
            print(row(f"{wide_deg:.0f} deg, {100 * off:.0f} %", result, first), flush=True)


if __name__ == "__main__":
    main()
