"""A foreign camera's clock where the log has positions only: is it found, and is it off by as much as its sigma states?

    python -m benchmarks.foreign_clock [--flights 10] [--seed 200] [--kinds straight,turns,survey] [--rates 1,5,10]

Sampled flights of 30 to 90 s at 50 to 150 m and 6 to 16 m/s, in gusts, with a crab angle; the camera is fixed or on a
gimbal, five pictures a second. Of the log only positions: late, by a low pass of the receiver's, with slow and short
errors, rounded to 6 to 8 decimals of a degree, heights above the take-off. Camera and ground are misstated too: clock
by up to 30 s, mount, focal length, height and slope of the ground, relief. No picture is rendered; what each pair
would show comes from the geometry, and what follows is the import's own search. (28.1) to (28.13)

The error is against the positions, as (28.9) states it. Goals: rms error over rms sigma 0.8 to 1.2, 85 to 96 % inside
1.64 sigmas, the worst below 3 sigmas; fewer than 20 answers are not judged. `clock`: rms of the error against the log's
clock itself, which has the age of the positions besides. Straight legs at constant speed and circles determine next to
nothing, and are to be refused.
"""

from __future__ import annotations

import argparse
import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from benchmarks.machine import describe, load, table, verdict
from benchmarks.scatter import mean_and_sigma
from contract.camera import Camera
from contract.geodesy import LocalFrame
from contract.rotations import R_ENU_NED, exp_so3, matrix_from_euler, mount_rotation
from onboard.commands.camera_clock import evidence_of
from onboard.config.schema import parse_config
from onboard.events.types import PositionFix
from onboard.foreign_clock.clock_search import Unknown, search
from onboard.foreign_clock.picture_pairs import chosen_pairs
from onboard.telemetry.telemetry_log import NS_PER_S, TelemetryLog
from simulation.paths import PathSpec, disturbance, fly_path
from simulation.trajectory import Pose, Trajectory
from tests.onboard.foreign_clock import recorded_motion

Array = NDArray[np.float64]

KINDS, RATES_HZ = ("straight", "turns", "survey", "orbit"), (1, 5, 10)
CONFIG = parse_config('[mount]\npitch_deg = -90.0\nsigma_deg = 5.0\n[solve]\nattitude = "none"')
CAMERA = Camera.from_field_of_view(640, 480, 58.0)
HOME = LocalFrame(-43.38, 172.4, 100.0)
EPOCH_S = 1_700_000_000.0
STEP_S = 0.02  # of what is continuous
BEFORE_S, AFTER_S = 10.0, 15.0  # at most, the first and after the last picture, that the log reaches
PICTURE_S, STAMP_SIGMA_S, STAMP_CLAIMED_S = 0.2, 0.003, 0.01
GOAL_RATIO, GOAL_INSIDE, GOAL_WORST = (0.8, 1.2), (0.85, 0.96), 3.0
INSIDE = 1.64  # sigmas
JUDGED = 20  # answers at least, for a verdict


@dataclass(frozen=True)
class Receiver:
    """The errors of positions: their age and a low pass (s), errors that are slow (3, m), short and white (m)."""

    late_s: float
    low_pass_s: float
    slow_m: Array
    slow_s: float
    short_m: float
    white_m: float
    decimals: int

    SHORT_S: ClassVar[float] = 2.0
    SMOOTH_S: ClassVar[float] = 3.0  # of slow errors, twice: a receiver's own filter

    @classmethod
    def sampled(cls, rng: np.random.Generator) -> Receiver:
        gps, scale = CONFIG.gps, rng.uniform(0.5, 2.0)
        return cls(
            late_s=rng.normal(gps.latency_s, gps.sigma_latency_s),
            low_pass_s=rng.uniform(STEP_S, 0.4),
            slow_m=scale * np.array([1.0, 1.0, 2.0]),
            slow_s=rng.uniform(15.0, 60.0),
            short_m=rng.uniform(0.0, 0.08),
            white_m=rng.uniform(0.01, 0.08),
            decimals=int(rng.choice([6, 7, 8])),
        )

    def errors_m(self, count: int, step_s: float, rng: np.random.Generator) -> Array:
        """(N, 3)."""
        slow = gauss_markov(rng, count, step_s, self.slow_s)
        for _ in range(2):
            slow = low_passed(slow, step_s, self.SMOOTH_S)
        short = gauss_markov(rng, count, step_s, self.SHORT_S)
        return self.slow_m * slow + self.short_m * short + self.white_m * rng.normal(size=(count, 3))


@dataclass(frozen=True, eq=False)
class Motion:
    """A flight whose speed wavers: at s it is where its even path is `early_s` later."""

    path: Trajectory
    time_s: Array
    early_s: Array

    @classmethod
    def sampled(cls, kind: str, seconds: float, rng: np.random.Generator) -> Motion:
        speed_m_s = rng.uniform(6.0, 16.0)
        spec = PathSpec(
            kind,
            speed_m_s=speed_m_s,
            height_m=rng.uniform(50.0, 150.0),
            heading_deg=rng.uniform(0.0, 360.0),
            crab_deg=rng.normal(0.0, 5.0),
            pitch_deg=rng.normal(0.0, 3.0),
            wobble_deg=rng.uniform(0.3, 1.5),
            bank_deg=rng.uniform(10.0, 30.0),
            leg_m=rng.uniform(8.0, 20.0) * speed_m_s,
            spacing_m=rng.uniform(30.0, 80.0),
            radius_m=rng.uniform(40.0, 120.0),
        )
        time_s = np.arange(-BEFORE_S, seconds + AFTER_S + BEFORE_S, STEP_S)
        return cls(
            fly_path(spec, seconds + AFTER_S, int(rng.integers(2**31))),
            time_s,
            rng.uniform(0.02, 0.1) * disturbance(rng, time_s, 10.0, 40.0),
        )

    def along_s(self, time_s: Array) -> Array:
        """Moments of the even path, no farther than it goes."""
        return np.clip(time_s + np.interp(time_s, self.time_s, self.early_s), self.path.start_s, self.path.end_s)

    def position_m(self, time_s: Array) -> Array:
        """(N, 3) ENU."""
        return self.path.position_enu_m(self.along_s(time_s))


@dataclass(frozen=True)
class Score:
    """A flight's error against the positions and against the log's clock, and its sigma (s); or the reason of none."""

    kind: str
    rate_hz: int
    carried: str
    error_s: float = np.nan
    clock_error_s: float = np.nan
    sigma_s: float = np.nan
    reason: str = ""


def low_passed(values: Array, step_s: float, time_s: float) -> Array:
    """(N, 3) by a filter of first order, which makes them late by its time."""
    from scipy.signal import lfilter  # noqa: PLC0415  with scipy.stats behind it, a second of processor time

    share = step_s / (step_s + time_s)
    out, _ = lfilter([share], [1.0, share - 1.0], values, axis=0, zi=(1.0 - share) * values[:1])
    return np.asarray(out, np.float64)


def gauss_markov(rng: np.random.Generator, count: int, step_s: float, time_s: float) -> Array:
    """(N, 3) of unit variance, stationary from the first on."""
    from scipy.signal import lfilter  # noqa: PLC0415  as above

    kept = np.exp(-step_s / time_s)
    first, white = rng.normal(size=(1, 3)), rng.normal(size=(count, 3))
    out, _ = lfilter([np.sqrt(1.0 - kept**2)], [1.0, -kept], white, axis=0, zi=kept * first)
    return np.asarray(out, np.float64)


def log_of(motion: Motion, receiver: Receiver, seconds: float, rate_hz: int, rng: np.random.Generator) -> TelemetryLog:
    """Return the positions of a flight, and nothing else."""
    times_s = np.arange(0.0, seconds + AFTER_S, 1.0 / rate_hz)
    fine_s = np.arange(-BEFORE_S, seconds + AFTER_S + BEFORE_S, STEP_S)
    filtered = low_passed(motion.position_m(fine_s), STEP_S, receiver.low_pass_s)
    true_s = times_s - (receiver.late_s - receiver.low_pass_s)  # the filter adds its own
    places = np.stack([np.interp(true_s, fine_s, column) for column in filtered.T], axis=1)
    places += receiver.errors_m(len(times_s), 1.0 / rate_hz, rng)
    fixes = [
        PositionFix(
            stamp_ns(time_s),
            round(float(lat_deg), receiver.decimals),
            round(float(lon_deg), receiver.decimals),
            float(height_m),
            height_above_home_m=float(up_m),
        )
        for time_s, (lat_deg, lon_deg, height_m), up_m in zip(
            times_s, HOME.to_geodetic(places), places[:, 2], strict=True
        )
    ]
    return TelemetryLog.by_stamp(fixes)


def stamp_ns(time_s: float) -> int:
    return round((EPOCH_S + time_s) * NS_PER_S)


def poses_of(motion: Motion, taken_s: Array, is_gimbal: bool, mount_deg: Array, rng: np.random.Generator) -> list[Pose]:
    """A camera that looks down from a vehicle whose nose turns earlier or later than its path does, or from a gimbal
    that follows the nose and stays level, nearly.
    """
    along_s = motion.along_s(taken_s)
    R_enu_body = motion.path.R_enu_body(np.maximum(along_s - rng.normal(0.0, 0.2), motion.path.start_s))
    if is_gimbal:
        yaw_rad = np.arctan2(R_enu_body[:, 0, 0], R_enu_body[:, 1, 0])
        wander = np.stack([disturbance(rng, taken_s, 3.0, 15.0) for _ in range(3)], axis=1)
        R_enu_body = R_ENU_NED @ matrix_from_euler(0.0, 0.0, yaw_rad) @ exp_so3(np.radians(0.3) * wander)
    R_body_cam = mount_rotation(0.0, -90.0, 0.0) @ exp_so3(np.radians(mount_deg))
    centres_m = motion.path.position_enu_m(along_s)
    return [Pose(centre_m, R) for centre_m, R in zip(centres_m, R_enu_body @ R_body_cam, strict=True)]


def judge(kind: str, rate_hz: int, seed: int) -> Score:
    """Sample a flight, its log and what its pictures show, and search the camera's clock."""
    rng = np.random.default_rng([seed, 928, KINDS.index(kind), rate_hz])
    seconds = rng.uniform(30.0, 90.0)
    begin_s, ahead_s, is_gimbal = rng.uniform(3.0, BEFORE_S), rng.uniform(-30.0, 30.0), bool(rng.random() < 0.5)
    motion, receiver = Motion.sampled(kind, BEFORE_S + seconds, rng), Receiver.sampled(rng)
    log = log_of(motion, receiver, BEFORE_S + seconds, rate_hz, rng)
    wrong = recorded_motion.Camera(
        boresight_deg=(rng.normal(0.0, 2.0), rng.normal(0.0, 2.0), rng.normal(0.0, 2.0)),
        ground_m=rng.normal(0.0, 5.0),
        focal=rng.normal(0.0, 0.01),
        slope=(np.tan(np.radians(rng.normal(0.0, 2.0))), np.tan(np.radians(rng.normal(0.0, 2.0)))),
    )
    taken_s = np.arange(begin_s, begin_s + seconds, PICTURE_S)
    poses = poses_of(motion, taken_s, is_gimbal, np.array(wrong.boresight_deg), rng)
    stamped_s = taken_s + ahead_s + rng.normal(0.0, STAMP_SIGMA_S, len(taken_s))
    stamps_ns = [stamp_ns(float(time_s)) for time_s in stamped_s]
    pairs = recorded_motion.seen_pairs(poses, stamps_ns, chosen_pairs(stamps_ns), wrong, rng)
    found = search(evidence_of(log, CONFIG, CAMERA, stamps_ns, STAMP_CLAIMED_S, pairs), None)
    carried = "gimbal" if is_gimbal else "fixed"
    if isinstance(found, Unknown):
        return Score(kind, rate_hz, carried, reason=found.reason)
    off_s = found.offset_s + ahead_s
    older_s = receiver.late_s - CONFIG.gps.latency_s
    return Score(kind, rate_hz, carried, off_s - older_s, off_s, found.sigma_s)


def row(name: str, scores: Sequence[Score]) -> tuple[str, ...]:
    """One line of the table."""
    answers = [score for score in scores if not score.reason]
    answered = f"{len(answers)} of {len(scores)}"
    if not answers:
        return (name, answered, *"------", "")
    error_s, clock_s, sigma_s = np.array([(s.error_s, s.clock_error_s, s.sigma_s) for s in answers]).T
    ratio, worst = rms(error_s) / rms(sigma_s), float(np.abs(error_s / sigma_s).max())
    share, spread = mean_and_sigma((np.abs(error_s) < INSIDE * sigma_s).astype(float))
    is_right = GOAL_RATIO[0] <= ratio <= GOAL_RATIO[1] and GOAL_INSIDE[0] <= share <= GOAL_INSIDE[1]
    return (
        name,
        answered,
        f"{rms(error_s):.3f}",
        f"{rms(sigma_s):.3f}",
        f"{ratio:.2f}",
        f"{share:.0%} +- {spread:.0%}",
        f"{worst:.2f}",
        f"{rms(clock_s):.3f}",
        verdict(is_right and worst < GOAL_WORST) if len(answers) >= JUDGED else "",
    )


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def report(scores: Sequence[Score]) -> str:
    """Return the table, by kind of flight and rate of the log, by each alone and by the mount; and why of refusals."""
    by: tuple[Callable[[Score], str], ...] = (
        lambda score: f"{score.kind}, {score.rate_hz} Hz",
        lambda score: score.kind,
        lambda score: f"{score.rate_hz} Hz",
        lambda score: score.carried,
        lambda _: "all",
    )
    rows = []
    for group in by:
        names = list(dict.fromkeys(map(group, scores)))
        rows += [row(name, [score for score in scores if group(score) == name]) for name in names]
    head = (
        "flights",
        "answered",
        "rms error, s",
        "rms sigma, s",
        "ratio",
        "in 1.64 sigmas",
        "worst, sigmas",
        "clock, s",
    )
    reasons = Counter((s.kind, re.sub(r"[+-]*\d+\.\d+", "T", s.reason)) for s in scores if s.reason)
    refused = "\n".join(f"{kind}, {count} refused: {reason}" for (kind, reason), count in reasons.most_common())
    return "\n\n".join(filter(None, (table((*head, ""), rows), refused)))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--flights", type=int, default=10, help="of each kind and rate")
    parser.add_argument("--seed", type=int, default=200)
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--rates", default=",".join(map(str, RATES_HZ)))
    args = parser.parse_args()
    print(f"{describe()}; {load()}; {args.flights} flights of each kind and rate, seed {args.seed}\n")
    scores = [
        judge(kind, int(rate_hz), seed)
        for kind in args.kinds.split(",")
        for rate_hz in args.rates.split(",")
        for seed in range(args.seed, args.seed + args.flights)
    ]
    print(report(scores))


if __name__ == "__main__":
    main()
