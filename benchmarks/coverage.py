"""Is the stated 90 % ellipse right? Share of true errors inside it, over flights sampled from the configured errors.

    python -m benchmarks.coverage [--flights 100] [--seed 0] [--rows TEXT]

Each flight goes through the whole onboard pipeline but for the tracker (`sampled_flight`), its feature sets through the
ground's locator. Counted, horizontally: single clicks; the vector between two clicks of one set; between clicks of two
sets a second or two apart, and farther apart. NEES is the mean squared error over the claimed covariance, 1 if honest:
of the pose (six states), of clicks (two), of heights. One flight is one sample of mount, offset and slow GPS error: the
last column gives one sigma of the first from the finite number of flights. Goal: 85 to 95 %.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.machine import describe
from benchmarks.sampled_flight import PLACE, SampledFlight, SampledSpec, fly, replace_section
from benchmarks.scatter import mean_and_sigma
from contract.answer import CHI2_2, Fix
from contract.feature_set import FeatureSet
from contract.geodesy import rotation_enu_ecef
from contract.locate import Locator
from contract.rotations import log_so3
from contract.wire.codec import decode, encode
from ground.two_sets import difference_covariance
from onboard.config.schema import Config, parse_config
from simulation.paths import PathSpec

Array = NDArray[np.float64]

PICTURES = 4  # asked of each flight
CLICKS = 4  # asked of each picture
FAR_S = 6.0


@dataclass
class Counts:
    """The figures of one flight: squared normalised errors, and a few errors in metres."""

    clicks: list[float] = field(default_factory=list)  # chi-square, 2
    one_set: list[float] = field(default_factory=list)
    two_near: list[float] = field(default_factory=list)
    two_far: list[float] = field(default_factory=list)
    pose: list[float] = field(default_factory=list)  # chi-square, 6
    height: list[float] = field(default_factory=list)  # chi-square, 1
    error_m: list[float] = field(default_factory=list)
    semi_m: list[float] = field(default_factory=list)
    asked: int = 0


def base() -> Config:
    """The defaults, every alarm armed."""
    return parse_config("")


def rows() -> dict[str, SampledSpec]:
    """Rows of the table by name."""
    full = base()

    def sensors(**solve: object) -> Config:
        return replace_section(full, "solve", **solve)

    seed = sensors(attitude="none", velocity=False)
    spec = SampledSpec(full)
    turns = PathSpec("turns", leg_m=160.0)
    oblique = replace_section(full, "mount", pitch_deg=-60.0)
    return {
        "seed (GPS + camera + level)": replace(spec, config=seed),
        "seed + velocity": replace(spec, config=sensors(attitude="none")),
        "attitude": replace(spec, config=sensors(velocity=False)),
        "attitude + velocity": spec,
        "attitude + velocity, no level": replace(spec, config=sensors(level_ground=False)),
        "attitude + velocity + terrain": replace(spec, has_terrain=True),
        "full, flat": replace(spec, relief_sigma_m=0.0),
        "full, relief 10 m": replace(spec, relief_sigma_m=10.0),
        "full, 20 % outliers": replace(spec, outlier_share=0.2),
        "full, tracks of 0.1 px": replace(spec, pixel_sigma_px=0.1),
        "full, oblique -60": replace(spec, config=oblique),
        "full, 100 m at 10 m/s": replace(spec, path=PathSpec(height_m=100.0, speed_m_s=10.0), relief_sigma_m=2.0),
        "full, 40 s with turns": replace(spec, path=turns, seconds=40.0),
        "hover over terrain": replace(spec, path=PathSpec("hover"), has_terrain=True),
        "errors 0.4 of those stated (no goal)": replace(spec, errors=0.4, relief_sigma_m=2.0),
    }


def judge(spec: SampledSpec, seed: int) -> Counts | None:
    """Fly once and compare; None where too little was solved."""
    flight = SampledFlight(spec, seed)
    sets, _ = fly(flight)
    solved = [k for k, s in sets.items() if s.is_ok and len(s) > 0 and k > 0.4 * len(flight.times_s)]
    if len(solved) < PICTURES:
        return None
    rng = np.random.default_rng([seed, 910])
    counts = Counts()
    answers: list[tuple[FeatureSet, Fix, Array]] = []
    # Two neighbours and two at the far ends.
    first = int(rng.integers(0, len(solved) - 3))
    for k in sorted({solved[0], solved[first + 1], solved[min(first + 3, len(solved) - 1)], solved[-1]}):
        s = decode(encode(sets[k]))  # as the ground receives it
        locator = Locator(s)
        counts.pose.append(_pose_nees(flight, k, s))
        clicks = rng.uniform(0.08, 0.92, (CLICKS, 2)) * (np.array(spec.camera.size_px) - 1)
        inside: list[tuple[Array, Fix, Array]] = []
        for uv in clicks:
            counts.asked += 1
            answer = locator.locate(uv)
            if not isinstance(answer, Fix):
                continue
            truth = flight.ground_points(k, uv[None])[0]
            error = _enu(answer) - truth
            inside.append((uv, answer, error))
            counts.clicks.append(_chi2(error[:2], answer.covariance_enu_m2[:2, :2]))
            counts.height.append(float(error[2] ** 2 / answer.covariance_enu_m2[2, 2]))
            counts.error_m.append(float(np.hypot(*error[:2])))
            counts.semi_m.append(answer.ellipse.semi_major_m)
        for (uv1, _, e1), (uv2, _, e2) in zip(inside[::2], inside[1::2], strict=False):
            between = locator.difference_covariance(uv1, uv2)
            if between is not None:
                counts.one_set.append(_chi2((e1 - e2)[:2], between[:2, :2]))
        answers += [(s, answer, error) for _, answer, error in inside[:2]]
    for i, (s1, a1, e1) in enumerate(answers):
        for s2, a2, e2 in answers[i + 1 :]:
            if s1.frame != s2.frame:
                apart_s = abs(s1.capture_unix_ns - s2.capture_unix_ns) / 1e9
                kind = counts.two_near if apart_s < 2.0 else counts.two_far if apart_s > FAR_S else None
                if kind is not None:
                    kind.append(_chi2((e1 - e2)[:2], difference_covariance(s1, a1, s2, a2)[:2, :2]))
    return counts if counts.clicks else None


def _chi2(error: Array, covariance: Array) -> float:
    # A claim of no error at all in some direction is a claim too: a micrometre keeps it finite.
    return float(error @ np.linalg.solve(covariance + 1e-12 * np.eye(len(error)), error))


def _enu(answer: Fix) -> Array:
    assert answer.height_amsl_m is not None
    return PLACE.to_enu(answer.lat_deg, answer.lon_deg, answer.height_amsl_m)


def _pose_nees(flight: SampledFlight, frame: int, s: FeatureSet) -> float:
    """The squared normalised error of the six pose states, over six."""
    centre = PLACE.to_enu(s.camera_lat_deg, s.camera_lon_deg, s.camera_height_m)
    R_place_here = PLACE.R_enu_ecef @ rotation_enu_ecef(s.camera_lat_deg, s.camera_lon_deg).T
    turn = log_so3(flight.R_enu_cam[frame] @ (R_place_here @ s.R_enu_cam).T)
    error = np.concatenate([flight.centres_enu_m[frame] - centre, turn])
    return _chi2(error, s.common_cov[:6, :6]) / 6.0


def _share(per_flight: list[Counts], pick: Callable[[Counts], list[float]], limit: float) -> tuple[float, float]:
    """Share under a limit and one sigma of it from the dispersion between flights."""
    shares = np.array([np.mean(np.array(pick(c)) < limit) for c in per_flight if pick(c)])
    return mean_and_sigma(shares)


def _mean(per_flight: list[Counts], pick: Callable[[Counts], list[float]]) -> float:
    """Mean over flights of each flight's mean, the worst hundredth of flights left out."""
    means = np.sort([np.mean(pick(c)) for c in per_flight if pick(c)])
    return float(means[: max(round(0.99 * len(means)), 1)].mean()) if len(means) else float("nan")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--flights", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--rows", default="", help="only rows whose name holds this text")
    args = parser.parse_args()
    print(f"{describe()}; {args.flights} flights a row, seed {args.seed}\n")
    print(
        f"{'sensors':<38} {'one click':>10} {'pair':>6} {'2 sets <2 s':>12} {'>6 s':>6}   {'NEES pose':>9} {'click':>6}"
        f" {'height':>7} {'answered':>9} {'error m':>8} {'semi m':>7} {'unsolved':>9} {'s':>5}  +-"
    )
    for name, spec in rows().items():
        if args.rows not in name:
            continue
        begin = time.perf_counter()
        judged = [judge(spec, args.seed + k) for k in range(args.flights)]
        flights = [c for c in judged if c is not None]
        if not flights:
            print(f"{name:<38} nothing was solved")
            continue
        single, spread = _share(flights, lambda c: c.clicks, CHI2_2)
        pair = _share(flights, lambda c: c.one_set, CHI2_2)[0]
        near, far = (_share(flights, pick, CHI2_2)[0] for pick in (lambda c: c.two_near, lambda c: c.two_far))
        nees = (
            _mean(flights, lambda c: c.pose),
            _mean(flights, lambda c: c.clicks) / 2,
            _mean(flights, lambda c: c.height),
        )
        answered = sum(len(c.clicks) for c in flights) / sum(c.asked for c in flights)
        error = float(np.median(np.concatenate([c.error_m for c in flights])))
        semi = float(np.median(np.concatenate([c.semi_m for c in flights])))
        print(
            f"{name:<38} {100 * single:9.1f}% {100 * pair:5.1f}% {100 * near:11.1f}% {100 * far:5.1f}%  "
            f" {nees[0]:9.2f} {nees[1]:6.2f} {nees[2]:7.2f} {100 * answered:8.0f}% {error:8.2f} {semi:7.2f}"
            f" {args.flights - len(flights):9d} {time.perf_counter() - begin:5.0f}  {100 * spread:.1f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
