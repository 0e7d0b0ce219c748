"""Clicks within the features' hull and beyond it: is the ellipse right where the ground is extrapolated?

    python -m benchmarks.beyond [--flights 5] [--shared ../shared/data]

Simulated flights with all sensors over hills, each as `sampled_flight` has it; clicks anywhere on every picture.
Printed apart for clicks within the convex hull of the features and beyond it, with and without (9.19): the share
answered of all clicks asked, the share inside the 90 % ellipse, the shares farther off than one and a half, two and
three ellipses, the 90 % error, and the median semi-major axis. Then features of real flights in `--shared`: the
outermost fifth in each of six directions is left out and predicted by the others; inside is within 1.645 sigmas.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from benchmarks.machine import describe
from benchmarks.real_flight import run
from benchmarks.sampled_flight import PLACE, SampledFlight, SampledSpec, fly, replace_section
from contract.answer import CHI2_2, Fix
from contract.camera import Camera
from contract.feature_set import FeatureSet
from contract.kriging import Kriging, convex_hull, distances_outside
from contract.locate import Locator
from ground.recording import Recording
from onboard.config.schema import parse_config
from onboard.estimation.ground_roughness import plane_and_roughness
from simulation.paths import PathSpec

Array = NDArray[np.float64]

CLICKS, WARM_S = 12, 10.0  # a picture; clicks from then on
SIGMA_90 = 1.645
OUTERMOST, DIRECTIONS = 0.2, 6
REAL: dict[str, dict[str, str]] = {
    "caliterra": {"--config": "config.toml", "--stamps": "stamps.csv"},
    "cmac_2018": {},
}


def flights() -> dict[str, SampledSpec]:
    """Kinds of flight by name."""

    def over(sigma_m: float, length_m: float, path: PathSpec, pitch_deg: float, field_deg: float) -> SampledSpec:
        config = replace_section(parse_config(""), "gps", sigma_latency_s=0.02)
        return SampledSpec(
            replace_section(config, "mount", pitch_deg=pitch_deg),
            path,
            40.0,
            2.0,
            relief_sigma_m=sigma_m,
            relief_wavelength_m=length_m,
            camera=Camera.from_field_of_view(640, 480, field_deg),
        )

    straight = PathSpec(speed_m_s=15.0, height_m=150.0)
    turns = PathSpec("turns", speed_m_s=18.0, height_m=100.0, bank_deg=40.0, leg_m=200.0)
    return {
        "hills 25 m, 800 m long, 45 deg down": over(25.0, 800.0, straight, -45.0, 50.0),
        "hills 15 m, 300 m long, 60 deg down": over(15.0, 300.0, straight, -60.0, 65.0),
        "hills 15 m, 300 m long, turns": over(15.0, 300.0, turns, -90.0, 65.0),
        "hills 3 m, 200 m long, 60 deg down": over(3.0, 200.0, straight, -60.0, 65.0),
    }


def clicked(
    flight: SampledFlight, sets: dict[int, FeatureSet], seed: int
) -> Iterator[tuple[float, bool, float, float]]:
    """Error over the own 90 % ellipse (nan: refused), whether beyond the hull, error and semi-major axis (m)."""
    size = np.array(flight.spec.camera.size_px) - 1
    for frame, found in sets.items():
        if not found.is_ok or flight.times_s[frame] < WARM_S:
            continue
        locator = Locator(found)
        uv = np.random.default_rng([seed, frame]).uniform(0.02, 0.98, (CLICKS, 2)) * size
        features, here = (found.camera.unproject(at)[0][:, :2] for at in (found.uv_px, uv))
        beyond = distances_outside(convex_hull(features), here) > 0.0
        for pixel, place, out in zip(uv, flight.ground_points(frame, uv), beyond.tolist(), strict=True):
            answer = locator.locate(pixel)
            if not isinstance(answer, Fix) or answer.height_amsl_m is None:
                yield np.nan, out, np.nan, np.nan
                continue
            off = (PLACE.to_enu(answer.lat_deg, answer.lon_deg, answer.height_amsl_m) - place)[:2]
            chi2 = float(off @ np.linalg.solve(answer.covariance_enu_m2[:2, :2], off))
            yield float(np.sqrt(chi2 / CHI2_2)), out, float(np.hypot(*off)), answer.ellipse.semi_major_m


def switched(is_on: bool) -> AbstractContextManager[object]:
    """Switch (9.19) on, or off: as if the outermost features were always as far off as stated."""
    return nullcontext() if is_on else patch.object(Kriging, "_shown_beyond", lambda _: 1.0)


def row(name: str, count: int) -> Iterator[str]:
    """Lines of one kind of flight: within the hull, and beyond it without and with (9.19)."""
    simulated = [
        (flight, fly(flight)[0], seed) for seed in range(count) for flight in [SampledFlight(flights()[name], seed)]
    ]
    for where, is_on in (("within", True), ("beyond, without", False), ("beyond", True)):
        with switched(is_on):
            found = np.array([c for flight, sets, seed in simulated for c in clicked(flight, sets, seed)])
        asked = found[found[:, 1] == (where != "within")]
        q, _, error_m, semi_m = asked[np.isfinite(asked[:, 0])].T
        far = " ".join(f"{100 * np.mean(q > limit):5.2f}" for limit in (1.5, 2.0, 3.0))
        yield (
            f"{name:<36} {where:<15} {len(asked):6d} {100 * len(q) / len(asked):6.1f} {100 * np.mean(q < 1.0):6.1f}  "
            f"{far}  {np.quantile(error_m, 0.9):6.1f} {np.median(semi_m):6.1f}"
        )


def real_sets(folder: Path, more: dict[str, str]) -> list[FeatureSet]:
    """The sets of a real flight, as `pc-onboard replay` records them."""
    given = {"--frames": "frames", "--telemetry": "telemetry.tlog", "--camera": "camera.json", **more}
    with tempfile.TemporaryDirectory() as out:
        recording = Path(out) / "session.mcap"
        files = [word for option, name in given.items() for word in (option, str(folder / name))]
        run("onboard", "replay", "--out", str(recording), *files)
        session = Recording(recording)
        [vehicle] = session.vehicles
        found = [session.by_frame(vehicle, frame) for frame in session.frames(vehicle)]
        return [s for s in found if s is not None and s.is_ok and len(s) > 30]


def left_out(found: FeatureSet) -> Iterator[float]:
    """Errors, in sigmas, of outermost features as all others of the set predict them."""
    xy = found.camera.unproject(found.uv_px)[0][:, :2]
    H = np.concatenate([np.ones((len(xy), 1)), xy], axis=1)
    w, relative = found.inverse_depth_per_m, (found.sigma_inverse_depth_per_m / found.inverse_depth_per_m) ** 2
    for angle in 2.0 * np.pi / DIRECTIONS * np.arange(DIRECTIONS):
        along = xy @ [np.cos(angle), np.sin(angle)]
        out = along > np.quantile(along, 1.0 - OUTERMOST)
        plane, spread, slope = plane_and_roughness(H[~out], w[~out], relative[~out])
        r, nugget = w / (H @ plane) - 1.0, relative * (w / (H @ plane)) ** 2
        predicted, variance = Kriging(xy[~out], r[~out], nugget[~out], plane, slope, spread).predict_each(xy[out])
        yield from ((r[out] - predicted) / np.sqrt(variance + nugget[out])).tolist()


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--flights", type=int, default=5, help="of each kind")
    parser.add_argument("--shared", type=Path, default=Path("../shared/data"))
    args = parser.parse_args()
    print(f"{describe()}; {args.flights} flights a row\n")
    print(f"{'flights':<36} {'clicks':<15} {'asked':>6} {'answ':>6} {'in':>6}   >1.5    >2    >3   90 % m semi m")
    for name in flights():
        print("\n".join(row(name, args.flights)), flush=True)
    print(f"\n{'features of a real flight, outermost':<36} {'(9.19)':<15} {'left out':>8} {'in':>6} {'> 3 sigmas':>10}")
    for name, more in REAL.items():
        if not (args.shared / name).is_dir():
            print(f"{name}: NOT measured, no {args.shared / name}")
            continue
        sets = real_sets(args.shared / name, more)
        for is_on in (False, True):
            with switched(is_on):
                z = np.abs([error for found in sets for error in left_out(found)])
            words = f"{name:<36} {'with' if is_on else 'without':<15} {len(z):8d}"
            print(f"{words} {100 * np.mean(z < SIGMA_90):6.1f} {100 * np.mean(z > 3.0):10.2f}", flush=True)


if __name__ == "__main__":
    main()
