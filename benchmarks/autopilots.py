"""Answers beside real autopilot software: recorded telemetry, drawn ground, truth known.

    python -m benchmarks.autopilots [--recordings plane_clean,...] [--mounts nadir,...] [--sensors full,...]
                                    [--faults none,...] [--seconds 200] [--draws 1] [--seed 0]

Position, velocity and attitude are what ArduPilot sent, with all of its errors, none of which we chose; a drawn
Gauss-Markov error is added to the position, for one flight is only one draw of its GPS. Features are points of drawn
ground with pixel noise (`drawn_flight`), so that a flight of minutes takes seconds. Printed for every scene: the share
answered, median and 90 % error beside what the flat ray gives (the autopilot's own pose, the true mount, level ground
at home's height), the share inside the 90 % ellipse by bank, inside the 99 % ellipse, the worst error over its 90 %
ellipse, both medians beyond what the position was off by at that moment, and what was estimated of mount and clocks.
"""

from __future__ import annotations

import argparse
import functools
import itertools
import multiprocessing
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.drawn_flight import DrawnTracker, Ground, Mask, Valley, replace_section
from benchmarks.sensor_faults import EVERY_MINUTE, Disturbance, disturbed
from contract.camera import UNKNOWN_SIGMA, Camera
from contract.feature_set import FeatureSet
from contract.geodesy import LocalFrame
from contract.rotations import R_ENU_NED, exp_so3, matrix_from_quaternion, mount_rotation
from contract.wire.codec import decode, encode
from ground.answer import CHI2_2, Fix
from ground.locate import Locator
from onboard.config.schema import Config, parse_config
from onboard.events.types import Attitude, Event, Frame, PositionFix
from onboard.pipeline.pipeline import Pipeline
from onboard.telemetry.telemetry_log import TelemetryLog
from onboard.telemetry.tlog_reader import read_tlog
from onboard.vision.klt_tracker import Tracks
from simulation.flight import find_recording
from simulation.trajectory import RecordedTruth, Trajectory

Array = NDArray[np.float64]

GROUND_AMSL_M = 100.0
MAX_RANGE = 12.0  # of a feature, in heights above ground: farther ones have no texture of their own
BANKS_DEG = (0.0, 5.0, 15.0, 30.0, 180.0)
CHI2_99 = -2.0 * np.log(0.01)
LEAD_NS, TAIL_NS = 30_000_000_000, 3_000_000_000
CLICKS = 3


LENS = Camera.from_field_of_view(640, 480, 40.0)


@dataclass(frozen=True)
class Scene:
    """One recorded flight as it is flown again. Angles and offsets are the truth; the configuration knows none."""

    recording: str
    config: Config
    start_s: float
    seconds: float
    mount_error_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    stamps_late_s: float = 0.0
    attitude_hz: float | None = None
    rate_hz: float = 2.0
    relief_sigma_m: float = 2.0
    slope_deg: float = 0.0
    rises_towards_deg: float = 36.9  # counted from north
    is_valley: bool = False  # the slope on either side of a line through the first place, falling towards it
    disturbances: tuple[Disturbance, ...] = ()
    wander_m: float = 1.5
    pixel_sigma_px: float = 0.3
    outlier_share: float = 0.03
    camera: Camera = field(default_factory=lambda: LENS)
    camera_file: Camera | None = None  # what the daemon is told; None: the truth, as known for sure


@functools.lru_cache(maxsize=8)
def recording(name: str) -> tuple[TelemetryLog, RecordedTruth]:
    """A recording's telemetry and truth."""
    log, truth = find_recording(name)
    return read_tlog(log), RecordedTruth.read(truth)


class ReplayedFlight:
    """Recorded telemetry with features of drawn ground; offers `DrawnTracker` what `DrawnFlight` does."""

    def __init__(self, scene: Scene, seed: int) -> None:
        self.spec = scene
        self.rng = rng = np.random.default_rng([seed, 911])
        log, truth = recording(scene.recording)
        self._log = log
        first = float(truth.unix_time_s[0])
        self.begin_s = first + scene.start_s
        self.place = LocalFrame(float(truth.lat_deg[0]), float(truth.lon_deg[0]), GROUND_AMSL_M)
        end_s = min(self.begin_s + scene.seconds, float(truth.unix_time_s[-1]) - 1.0)
        self.trajectory: Trajectory = truth.trajectory(self.place, self.begin_s, 0.0)
        self.times_s = np.arange(0.0, end_s - self.begin_s, 1.0 / scene.rate_hz)
        mount = scene.config.mount
        R_body_cam = mount_rotation(mount.roll_deg, mount.pitch_deg, mount.yaw_deg)
        self.R_body_cam = R_body_cam @ exp_so3(np.radians(scene.mount_error_deg))
        poses = [self.trajectory.camera_pose(float(t), self.R_body_cam) for t in self.times_s]
        self.R_enu_cam = np.stack([p.R_enu_cam for p in poses])
        self.centres_enu_m = np.stack([p.centre_m for p in poses])
        uphill = np.radians(scene.rises_towards_deg)
        slope = np.tan(np.radians(scene.slope_deg)) * np.array([np.sin(uphill), np.cos(uphill)])
        self.ground = (Valley if scene.is_valley else Ground)(rng, slope, scene.relief_sigma_m, 200.0)
        down = self.trajectory.R_enu_body(self.times_s)[:, :, 2]
        self.bank_deg = np.degrees(np.arccos(np.clip(-down[:, 2], -1.0, 1.0)))

    def ground_points(self, frame: int, uv_px: Array) -> Array:
        """The ground (N, 3) that pixels (N, 2) of a picture show; nan where they show none."""
        rays, _ = self.spec.camera.unproject(uv_px)
        rays = rays @ self.R_enu_cam[frame].T
        centre = self.centres_enu_m[frame]
        downward = rays[:, 2] < -0.06 * np.linalg.norm(rays, axis=1)
        points = self.ground.meet(centre, np.where(downward[:, None], rays, [0.0, 0.0, -1.0]))
        height = centre[2] - self.ground.height_m(centre[None, :2])[0]
        near = np.linalg.norm(points - centre, axis=1) < MAX_RANGE * height
        return np.where((downward & near)[:, None], points, np.nan)

    def pixels(self, frame: int, points: Array) -> tuple[Array, Mask]:
        """Pixels (N, 2) of points (N, 3) in a picture, and whether they are on it."""
        return self.spec.camera.project((points - self.centres_enu_m[frame]) @ self.R_enu_cam[frame])

    def events(self) -> Iterator[Event]:
        """Telemetry by arrival and pictures by stamp; a picture's image holds nothing but its own number."""
        begin_ns = round(self.begin_s * 1e9)
        end_ns = begin_ns + round((self.times_s[-1]) * 1e9) + TAIL_NS
        stamps_ns = begin_ns + np.round((self.times_s + self.spec.stamps_late_s) * 1e9).astype(np.int64)
        pictures: list[tuple[int, Event]] = [
            (int(t), Frame(int(t), k, np.full((1, 1), k, np.uint16).view(np.uint8))) for k, t in enumerate(stamps_ns)
        ]
        wander = self.wander = Wander(self.rng, self.place, begin_ns - LEAD_NS, end_ns, self.spec.wander_m)
        telemetry: list[tuple[int, Event]] = []
        last_attitude_ns = 0
        for arrival_ns, said in zip(self._log.arrival_ns, self._log.events, strict=True):
            if not begin_ns - LEAD_NS <= said.stamp_ns <= end_ns:
                continue
            if isinstance(said, Attitude) and self.spec.attitude_hz is not None:
                if said.stamp_ns - last_attitude_ns < 0.98e9 / self.spec.attitude_hz:
                    continue
                last_attitude_ns = said.stamp_ns
            event = disturbed(said, begin_ns, self.spec.disturbances, self.place)
            telemetry.append((arrival_ns, wander(event) if isinstance(event, PositionFix) else event))
        for _, event in sorted([*telemetry, *pictures], key=lambda pair: pair[0]):
            yield event


class Wander:
    """A Gauss-Markov error of 60 s, drawn once a second, added to positions; 1.6 times as large vertically."""

    def __init__(self, rng: np.random.Generator, place: LocalFrame, begin_ns: int, end_ns: int, sigma_m: float) -> None:
        self._place, self._begin_ns = place, begin_ns
        n = (end_ns - begin_ns) // 1_000_000_000 + 3
        keep = np.exp(-1.0 / 60.0)
        x = np.empty((n, 3))
        x[0] = rng.standard_normal(3)
        for k in range(1, n):
            x[k] = keep * x[k - 1] + np.sqrt(1.0 - keep**2) * rng.standard_normal(3)
        self._x = x * sigma_m * np.array([1.0, 1.0, 1.6])

    def at(self, stamp_ns: int) -> Array:
        """(3,) ENU metres."""
        s = (stamp_ns - self._begin_ns) / 1e9
        k = min(max(int(s), 0), len(self._x) - 2)
        out: Array = self._x[k] + (s - k) * (self._x[k + 1] - self._x[k])
        return out

    def __call__(self, fix: PositionFix) -> PositionFix:
        """The same message with the error added."""
        east, north, up = self.at(fix.stamp_ns)
        p = self._place.to_enu(fix.lat_deg, fix.lon_deg, fix.height_amsl_m) + [east, north, up]
        lat, lon, height = (float(c) for c in self._place.to_geodetic(p))
        above = None if fix.height_above_home_m is None else fix.height_above_home_m + up
        return replace(fix, lat_deg=lat, lon_deg=lon, height_amsl_m=height, height_above_home_m=above)


class ReplayedTracker(DrawnTracker):
    """As drawn, but no feature where the picture shows no ground."""

    def track(self, image: NDArray[np.uint8], predicted: Array | None) -> Tracks:
        """As drawn; nothing where fewer are in sight than a motion needs."""
        self._frame = int(image.view(np.uint16)[0, 0])
        if self._key and len(self._ids):
            _, seen = self._flight.pixels(self._frame, self._points[self._ids])
            if np.count_nonzero(seen) < 6:
                return self.nothing()
        return super().track(image, predicted)

    def promote(self, tracks: Tracks) -> tuple[NDArray[np.int64], Array]:
        """The last picture becomes the keyframe; what showed no ground is no feature."""
        super().promote(tracks)
        bad = np.any(~np.isfinite(self._points), axis=1)
        self._points[bad] = [0.0, 0.0, 1e7]
        ok = ~bad[self._ids]
        self._ids, self._uv = self._ids[ok], self._uv[ok]
        return self._ids, self._uv


@dataclass
class Score:
    """What one scene says, one entry a click."""

    chi2: list[float] = field(default_factory=list)
    error_m: list[float] = field(default_factory=list)
    ratio: list[float] = field(default_factory=list)
    semi_m: list[float] = field(default_factory=list)
    bank_deg: list[float] = field(default_factory=list)
    flat_m: list[float] = field(default_factory=list)
    # The same two without what the position was off by at that moment, which no picture tells.
    beyond_m: list[float] = field(default_factory=list)
    flat_beyond_m: list[float] = field(default_factory=list)
    moment_s: list[float] = field(default_factory=list)
    asked: dict[str, int] = field(default_factory=lambda: {"all": 0, "bank": 0})
    answered: dict[str, int] = field(default_factory=lambda: {"all": 0, "bank": 0})
    refused: dict[str, int] = field(default_factory=dict)
    learned: str = ""
    learned_values: tuple[Array, Array] | None = None


def judge(scene: Scene, seed: int, warm_s: float = 30.0) -> Score:
    """Fly the scene and ask `CLICKS` clicks of every picture after `warm_s`."""
    flight = ReplayedFlight(scene, seed)
    pipeline = Pipeline(scene.config, scene.camera_file or scene.camera, None)
    pipeline.tracker = ReplayedTracker(flight)
    sets: dict[int, FeatureSet] = {}
    for event in flight.events():
        sets.update({out.frame: out for out in pipeline.handle(event)})
    sets.update({out.frame: out for out in pipeline.finish()})
    score = Score()
    rng = np.random.default_rng([seed, 912])
    for k, t in enumerate(flight.times_s):
        if t < warm_s:
            continue
        uv = rng.uniform(0.05, 0.95, (CLICKS, 2)) * (np.array(scene.camera.size_px) - 1)
        truth = flight.ground_points(k, uv)
        good = np.isfinite(truth).all(axis=1)
        uv, truth = uv[good], truth[good]
        if not len(uv):
            continue
        bins = ["all"] + (["bank"] if flight.bank_deg[k] > 30.0 else [])
        for b in bins:
            score.asked[b] += len(uv)
        s = sets.get(k)
        if s is None or not s.is_ok:
            reason = "none" if s is None else s.status.value
            score.refused[reason] = score.refused.get(reason, 0) + len(uv)
            continue
        locator = Locator(decode(encode(s)))
        flat, off = _flat(scene, flight, k, uv)
        for one, where, ray in zip(uv, truth, flat, strict=True):
            answer = locator.locate(one)
            if not isinstance(answer, Fix):
                score.refused["click " + answer.status.value] = score.refused.get("click " + answer.status.value, 0) + 1
                continue
            for b in bins:
                score.answered[b] += 1
            assert answer.height_amsl_m is not None
            error = (flight.place.to_enu(answer.lat_deg, answer.lon_deg, answer.height_amsl_m) - where)[:2]
            C = answer.covariance_enu_m2[:2, :2]
            chi2 = float(error @ np.linalg.solve(C, error))
            score.chi2.append(chi2)
            score.ratio.append(float(np.sqrt(chi2 / CHI2_2)))
            score.error_m.append(float(np.hypot(*error)))
            score.semi_m.append(answer.ellipse.semi_major_m)
            score.bank_deg.append(float(flight.bank_deg[k]))
            score.moment_s.append(float(t))
            score.flat_m.append(float(np.hypot(*(ray - where)[:2])))
            score.beyond_m.append(float(np.hypot(*(error - off))))
            score.flat_beyond_m.append(float(np.hypot(*((ray - where)[:2] - off))))
    alignment = pipeline.window.alignment
    mean, sigma = alignment.belief.mean, pipeline.window.belief.sigma
    score.learned_values = (mean, sigma)
    score.learned = " ".join(
        f"{m * 180 / np.pi:+.2f}±{s * 180 / np.pi:.2f}" for m, s in zip(mean[:3], sigma[:3], strict=True)
    )
    score.learned += " deg " + " ".join(f"{m:+.3f}±{s:.3f}" for m, s in zip(mean[3:], sigma[3:], strict=True)) + " s"
    return score


def _flat(scene: Scene, flight: ReplayedFlight, k: int, uv: Array) -> tuple[Array, Array]:
    """Where the pixel's ray from the autopilot's pose through the true mount meets level ground at home's height.

    Also what the autopilot's position is off by at that moment, (2,) east and north.
    """
    log = _raw(scene.recording)
    t_ns = round((flight.begin_s + flight.times_s[k]) * 1e9)
    p = np.array([np.interp(t_ns, log[0], log[1][:, i]) for i in range(3)])
    p = p + flight.wander.at(t_ns)
    j = min(max(int(np.searchsorted(log[2], t_ns)), 1), len(log[2]) - 1)
    R_ned_body = log[3][j if abs(log[2][j] - t_ns) < abs(log[2][j - 1] - t_ns) else j - 1]
    rays, _ = scene.camera.unproject(uv)
    rays = rays @ (R_ENU_NED @ R_ned_body @ flight.R_body_cam).T
    depth = -p[2] / np.minimum(rays[:, 2], -1e-3)
    return p + rays * depth[:, None], (p - flight.centres_enu_m[k])[:2]


@functools.lru_cache(maxsize=8)
def _raw(name: str) -> tuple[Array, Array, Array, Array]:
    log, truth = recording(name)
    place = LocalFrame(float(truth.lat_deg[0]), float(truth.lon_deg[0]), GROUND_AMSL_M)
    fixes = sorted((e for e in log.events if isinstance(e, PositionFix)), key=lambda e: e.stamp_ns)
    attitudes = sorted((e for e in log.events if isinstance(e, Attitude)), key=lambda e: e.stamp_ns)
    return (
        np.array([e.stamp_ns for e in fixes], float),
        np.array([place.to_enu(e.lat_deg, e.lon_deg, e.height_amsl_m) for e in fixes]),
        np.array([e.stamp_ns for e in attitudes], float),
        np.array([matrix_from_quaternion(e.q_ned_body) for e in attitudes]),
    )


MOUNTS: dict[str, dict[str, float]] = {
    "nadir": {},
    "180": {"yaw_deg": 180.0},
    "-90": {"yaw_deg": -90.0},
    "tilted": {"pitch_deg": -60.0},
}
SENSORS: dict[str, dict[str, Any]] = {"full": {}, "gps": {"attitude": "none", "velocity": False}}
STARTS = {
    "plane_clean": 60.0,
    "plane_gps_outage": 60.0,
    "plane_wind_noise": 60.0,
    "plane_breeze": 45.0,
    "plane_log": 40.0,
    "copter_survey": 30.0,
}
FAULTS: dict[str, dict[str, Any]] = {
    "none": {},
    "late": {"stamps_late_s": 0.2, "mount_error_deg": (2.0, 1.5, 0.0)},
    "1hz": {"attitude_hz": 1.0},
    "slope": {"slope_deg": 9.8},
    # The camera file says nothing of its errors: it is right all the same, or 3 % and 0.1 wrong.
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
    "slope-east": {"slope_deg": 9.8, "rises_towards_deg": 90.0},
    "slope-north": {"slope_deg": 9.8, "rises_towards_deg": 0.0},
    "slope-4": {"slope_deg": 4.0, "rises_towards_deg": 300.0},
    "valley": {"slope_deg": 9.8, "rises_towards_deg": 36.9, "is_valley": True},
    **{name: {"disturbances": every} for name, every in EVERY_MINUTE.items()},
}


Job = tuple[str, Scene, int]


def _work(job: Job) -> tuple[str, Score, float]:
    name, scene, seed = job
    begin = time.perf_counter()
    score = judge(scene, seed)
    return name, score, time.perf_counter() - begin


def jobs_of(args: argparse.Namespace) -> list[Job]:
    """Every combination that was asked for: its name, the scene, the seed."""
    base = parse_config(args.set.replace(";", "\n"))
    asked = (args.recordings, args.mounts, args.sensors, args.faults)
    jobs = []
    for name, mount, sensors, fault in itertools.product(*(names.split(",") for names in asked)):
        config = replace_section(replace_section(base, "mount", **MOUNTS[mount]), "solve", **SENSORS[sensors])
        start_s = STARTS[name] if args.start is None else args.start
        scene = replace(Scene(name, config, start_s, args.seconds), **FAULTS[fault])
        jobs += [(f"{name} {mount} {sensors} {fault}", scene, args.seed + draw) for draw in range(args.draws)]
    return jobs


def report(results: Iterable[tuple[str, Score, float]]) -> None:
    """Print a row for every scene as it comes, and one for each set of sensors."""
    columns = "answ bank | med   90%  | flat med 90% | 0-5  5-15 15-30 >30 | all  in99 worst | beyond flat ratio"
    print(f"{'scene':<38} {columns}")
    pooled: dict[str, list[Score]] = {}
    for name, score, seconds in results:
        print(row(name, [score]), f"{seconds:5.0f} s", score.learned, score.refused, flush=True)
        pooled.setdefault(name.split()[2], []).append(score)
    for sensors, scores in pooled.items():
        print(row(f"pooled {sensors}", scores))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--recordings", default="plane_clean,plane_wind_noise,plane_breeze,plane_log")
    parser.add_argument("--mounts", default="nadir")
    parser.add_argument("--sensors", default="full,gps")
    parser.add_argument("--faults", default="none")
    parser.add_argument("--seconds", type=float, default=200.0)
    parser.add_argument("--start", type=float, default=None)
    parser.add_argument("--draws", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--set", default="", help="TOML put over the defaults")
    parser.add_argument("--jobs", type=int, default=1)
    args = parser.parse_args()
    jobs = jobs_of(args)
    if args.jobs == 1:
        report(map(_work, jobs))
        return
    with multiprocessing.get_context("fork").Pool(args.jobs) as pool:
        report(pool.imap(_work, jobs))


def share_inside(scores: list[Score]) -> list[float | None]:
    """Share of errors inside the 90 % ellipse in each bin of bank; None where hardly any were asked."""
    chi2 = np.concatenate([s.chi2 for s in scores])
    bank = np.concatenate([s.bank_deg for s in scores])
    out: list[float | None] = []
    for low, high in itertools.pairwise(BANKS_DEG):
        here = (bank >= low) & (bank < high)
        out.append(float(np.mean(chi2[here] < CHI2_2)) if here.sum() > 5 else None)
    return out


def row(name: str, scores: list[Score]) -> str:
    """One line of the table."""
    chi2 = np.concatenate([s.chi2 for s in scores])
    error = np.concatenate([s.error_m for s in scores])
    flat = np.concatenate([s.flat_m for s in scores])
    ratio = np.concatenate([s.ratio for s in scores])
    if not len(chi2):
        return f"{name:<38} nothing"
    asked = {b: sum(s.asked[b] for s in scores) for b in ("all", "bank")}
    answered = {b: sum(s.answered[b] for s in scores) for b in ("all", "bank")}
    beyond = [np.median(np.concatenate(x)) for x in ([s.beyond_m for s in scores], [s.flat_beyond_m for s in scores])]
    shares = ["   -" if share is None else f"{100 * share:4.0f}" for share in share_inside(scores)]
    answered_bank = 100 * answered["bank"] / max(asked["bank"], 1)
    q = np.quantile
    return (
        f"{name:<38} {100 * answered['all'] / max(asked['all'], 1):4.0f} {answered_bank:4.0f} |"
        f"{q(error, 0.5):5.2f} {q(error, 0.9):6.2f} | {q(flat, 0.5):5.2f} {q(flat, 0.9):6.2f} |{' '.join(shares)} |"
        f" {100 * np.mean(chi2 < CHI2_2):4.0f} {100 * np.mean(chi2 < CHI2_99):5.1f} {ratio.max():5.1f}"
        f" | {beyond[0]:5.2f} {beyond[1]:5.2f} {beyond[0] / beyond[1]:4.2f}"
    )


if __name__ == "__main__":
    main()
