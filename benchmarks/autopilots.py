"""Answers with real autopilot software: recorded telemetry, simulated ground, truth known.

    python -m benchmarks.autopilots [--recordings plane_clean,...] [--mounts nadir,...] [--sensors full,...]
                                    [--faults none,...] [--seconds 200] [--draws 1] [--seed 0] [--position-error 1.5]

Position, velocity and attitude are what ArduPilot or PX4 sent, with all of its errors, none of which we chose; a
sampled Gauss-Markov error is added to the position, for one flight is only one sample of its GPS, and simulators of
receivers hold none that lasts; every draw of every recording has one of its own. Where a recording holds such an
error (its .events.json, horizontal), only the part that it lacks is added. Features are points of simulated ground
with pixel noise (`sampled_flight`), so that a flight of minutes takes seconds. Printed for every
scene: the share answered, median and 90 % error next to what the flat ray gives (the autopilot's own pose, the true
mount, level ground at home's height), the share inside the 90 % ellipse by bank, inside the 99 % ellipse, the worst
error over its 90 % ellipse, both medians beyond what the position was off by at that moment, and what was estimated of
mount and clocks; then, of the same clicks, sharpness (`click_score`) and coverage by bank and by minute of flight, and
which part of the goal (sharpness 0.85 to 1.1 pooled, 0.7 to 1.15 for each flight after its first minute, coverage 85
to 96 %) is missed.
"""

from __future__ import annotations

import argparse
import functools
import itertools
import json
import multiprocessing
import time
import zlib
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.click_score import FLIGHT_GOAL, POOLED_GOAL, Score, add, clicks, row, sharpness_header, sharpness_row
from benchmarks.machine import describe
from benchmarks.platform_faults import BELIEVED, FAULTS, LENS
from benchmarks.sampled_flight import Ground, Mask, SampledTracker, replace_section
from benchmarks.sensor_faults import Disturbance, disturbed, moved
from contract.camera import Camera
from contract.feature_set import FeatureSet
from contract.geodesy import LocalFrame
from contract.rotations import R_ENU_NED, exp_so3, matrix_from_quaternion, mount_rotation
from onboard.config.schema import Config, parse_config
from onboard.events.types import Attitude, Event, Frame, GpsQuality, PositionFix
from onboard.pipeline.pipeline import Pipeline
from onboard.telemetry.telemetry_log import TelemetryLog
from onboard.telemetry.tlog_reader import read_tlog
from onboard.vision.klt_tracker import Tracks
from simulation.flight import find_recording
from simulation.moved_optics import stabilised, zoomed
from simulation.rows import RowsOf
from simulation.trajectory import RecordedTruth, Trajectory

Array = NDArray[np.float64]

MAX_RANGE = 12.0  # of a feature, in heights above ground: farther ones have no texture of their own
LEAD_NS, TAIL_NS = 30_000_000_000, 3_000_000_000
CLICKS = 3
GROUND_AMSL_M = {"quad": 489.4}
HOME_AMSL_M = 100.0  # of all others


def ground_amsl_m(name: str) -> float:
    """The level of the ground under a recording."""
    return GROUND_AMSL_M.get(name, HOME_AMSL_M)


@dataclass(frozen=True)
class Scene:
    """One recorded flight as it is replayed. Angles and offsets are the truth; the configuration knows none."""

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
    ground: type[Ground] = Ground  # `Valley`: the slope on either side of a line through the first place
    disturbances: tuple[Disturbance, ...] = ()
    position_error_m: float = 1.5
    pixel_sigma_px: float = 0.3
    outlier_share: float = 0.03
    camera: Camera = field(default_factory=lambda: LENS)
    camera_file: Camera | None = None  # what is passed to the daemon; None: the truth, as known for sure
    readout_s: float = 0.0  # of the rows, as it is; the configuration may specify something else
    stabilised_s: float | None = None  # over which electronic stabilisation smooths rotation; None: there is none
    zoom: tuple[float, float, float] | None = None  # factor, from and until (s)


@functools.lru_cache(maxsize=8)
def recording(name: str) -> tuple[TelemetryLog, RecordedTruth]:
    """A recording's telemetry and truth."""
    log, truth = find_recording(name)
    return read_tlog(log), RecordedTruth.read(truth)


OWN_ERROR = "gps_wander_m_and_time_s"  # an entry of .events.json
VERTICAL = 1.6  # times as large an error of positions is vertically


def own_error_m(name: str) -> float:
    """One sigma of the correlated horizontal error that a recording's simulated receiver had; 0 if it had none."""
    log, _ = find_recording(name)
    settings = log.with_suffix(".events.json")
    stated = json.loads(settings.read_text()) if settings.is_file() else {}
    # A list has what was changed in flight, by parameters, which such an error is not.
    return float(stated[OWN_ERROR][0]) if isinstance(stated, dict) and OWN_ERROR in stated else 0.0


class ReplayedFlight:
    """Recorded telemetry with features of simulated ground; offers `SampledTracker` what `SampledFlight` does."""

    def __init__(self, scene: Scene, seed: int) -> None:
        self.spec = scene
        self.rng = rng = np.random.default_rng([seed, 911])
        log, truth = recording(scene.recording)
        self._log = log
        first = float(truth.unix_time_s[0])
        self.begin_s = first + scene.start_s
        self.place = LocalFrame(float(truth.lat_deg[0]), float(truth.lon_deg[0]), ground_amsl_m(scene.recording))
        end_s = min(self.begin_s + scene.seconds, float(truth.unix_time_s[-1]) - 1.0)
        self.trajectory: Trajectory = truth.trajectory(self.place, self.begin_s, 0.0)
        self.times_s = np.arange(0.0, end_s - self.begin_s, 1.0 / scene.rate_hz)
        mount = scene.config.mount
        R_body_cam = mount_rotation(mount.roll_deg, mount.pitch_deg, mount.yaw_deg)
        self.R_body_cam = R_body_cam @ exp_so3(np.radians(scene.mount_error_deg))
        self._rows = RowsOf(self.trajectory, self.R_body_cam, scene.readout_s)
        self.cameras = _cameras(scene, self.trajectory, self.R_body_cam, self.times_s)
        poses = [self.trajectory.camera_pose(float(t), self.R_body_cam) for t in self.times_s]
        self.R_enu_cam = np.stack([p.R_enu_cam for p in poses])
        self.centres_enu_m = np.stack([p.centre_m for p in poses])
        uphill = np.radians(scene.rises_towards_deg)
        slope = np.tan(np.radians(scene.slope_deg)) * np.array([np.sin(uphill), np.cos(uphill)])
        self.ground = scene.ground(rng, slope, scene.relief_sigma_m, 200.0)
        down = self.trajectory.R_enu_body(self.times_s)[:, :, 2]
        self.bank_deg = np.degrees(np.arccos(np.clip(-down[:, 2], -1.0, 1.0)))

    def ground_points(self, frame: int, uv_px: Array) -> Array:
        """The ground (N, 3) that pixels (N, 2) of a picture show; nan where they show none."""
        rays, centre = self._rows.rays(self.cameras[frame], float(self.times_s[frame]), uv_px)
        downward = rays[:, 2] < -0.06 * np.linalg.norm(rays, axis=1)
        points = self.ground.meet(centre, np.where(downward[:, None], rays, [0.0, 0.0, -1.0]))
        height = centre[:, 2] - self.ground.height_m(centre[:, :2])
        near = np.linalg.norm(points - centre, axis=1) < MAX_RANGE * height
        return np.where((downward & near)[:, None], points, np.nan)

    def pixels(self, frame: int, points: Array) -> tuple[Array, Mask]:
        """Pixels (N, 2) of points (N, 3) in a picture, and whether they are on it."""
        return self._rows.pixels(self.cameras[frame], float(self.times_s[frame]), points)

    def events(self) -> Iterator[Event]:
        """Telemetry by arrival and pictures by stamp; a picture's image holds nothing but its own number."""
        begin_ns = round(self.begin_s * 1e9)
        end_ns = begin_ns + round((self.times_s[-1]) * 1e9) + TAIL_NS
        stamps_ns = begin_ns + np.round((self.times_s + self.spec.stamps_late_s) * 1e9).astype(np.int64)
        pictures: list[tuple[int, Event]] = [
            (int(t), Frame(int(t), k, np.full((1, 1), k, np.uint16).view(np.uint8))) for k, t in enumerate(stamps_ns)
        ]
        asked_m, own_m = self.spec.position_error_m, own_error_m(self.spec.recording)
        sigmas_m = float(np.sqrt(max(asked_m**2 - own_m**2, 0.0))), VERTICAL * asked_m
        drift = self.drift = CorrelatedError(self.rng, self.place, begin_ns - LEAD_NS, end_ns, sigmas_m)
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
            telemetry.append((arrival_ns, drift.added(event)))
        for _, event in sorted([*telemetry, *pictures], key=lambda pair: pair[0]):
            yield event


def _cameras(scene: Scene, trajectory: Trajectory, R_body_cam: Array, times_s: Array) -> list[Camera]:
    """The camera as it is at each picture."""
    if scene.stabilised_s is not None:
        return stabilised(scene.camera, trajectory, R_body_cam, times_s, scene.stabilised_s)
    if scene.zoom is not None:
        return zoomed(scene.camera, times_s, *scene.zoom)
    return [scene.camera] * len(times_s)


class CorrelatedError:
    """A Gauss-Markov error of 60 s, sampled once a second, added to positions; its sigmas horizontal and vertical."""

    def __init__(
        self, rng: np.random.Generator, place: LocalFrame, begin_ns: int, end_ns: int, sigmas_m: tuple[float, float]
    ) -> None:
        self._place, self._begin_ns = place, begin_ns
        n = (end_ns - begin_ns) // 1_000_000_000 + 3
        keep = np.exp(-1.0 / 60.0)
        x = np.empty((n, 3))
        x[0] = rng.standard_normal(3)
        for k in range(1, n):
            x[k] = keep * x[k - 1] + np.sqrt(1.0 - keep**2) * rng.standard_normal(3)
        self._x = x * np.array([sigmas_m[0], sigmas_m[0], sigmas_m[1]])

    def at(self, stamp_ns: int) -> Array:
        """(3,) ENU metres."""
        s = (stamp_ns - self._begin_ns) / 1e9
        k = min(max(int(s), 0), len(self._x) - 2)
        out: Array = self._x[k] + (s - k) * (self._x[k + 1] - self._x[k])
        return out

    def added(self, event: Event) -> Event:
        """The message with the error added, to the filter's position and to the receiver's."""
        if isinstance(event, PositionFix):
            return self._added(event)
        if isinstance(event, GpsQuality) and event.fix is not None:
            return replace(event, fix=self._added(event.fix))
        return event

    def _added(self, fix: PositionFix) -> PositionFix:
        by_m = self.at(fix.stamp_ns)
        above = None if fix.height_above_home_m is None else fix.height_above_home_m + float(by_m[2])
        return replace(moved(fix, self._place, by_m), height_above_home_m=above)


class ReplayedTracker(SampledTracker):
    """A simulated tracker that has no feature where the picture shows no ground."""

    def promote(self, tracks: Tracks) -> tuple[NDArray[np.int64], Array]:
        """The last picture becomes the keyframe; what showed no ground is no feature."""
        super().promote(tracks)
        bad = np.any(~np.isfinite(self._points), axis=1)
        self._points[bad] = [0.0, 0.0, 1e7]
        ok = ~bad[self._ids]
        self._ids, self._uv = self._ids[ok], self._uv[ok]
        return self._ids, self._uv


def judge(scene: Scene, seed: int, warm_s: float = 30.0) -> Score:
    """Fly the scene and ask `CLICKS` clicks of every picture after `warm_s`."""
    flight = ReplayedFlight(scene, seed)
    pipeline = Pipeline(scene.config, scene.camera_file or scene.camera, None)
    pipeline.tracker = ReplayedTracker(flight)
    sets: dict[int, FeatureSet] = {}
    for event in flight.events():
        sets.update({out.frame: out for out in pipeline.handle(event)})
    sets.update({out.frame: out for out in pipeline.finish()})
    spent = pipeline.summary.stage_seconds
    score = Score(processor_s=sum(seconds for stage, seconds in spent.items() if stage != "tracking"))
    for click in clicks(flight, sets, scene.camera.size_px, CLICKS, warm_s, seed):
        if add(score, flight, click):
            error = click.error_m(flight.place)
            ray, off = _flat(scene, flight, click.frame, click.uv_px[None])
            by_ray = (ray[0] - click.where_m)[:2]
            score.flat_m.append(float(np.hypot(*by_ray)))
            score.beyond_m.append(float(np.hypot(*(error - off))))
            score.flat_beyond_m.append(float(np.hypot(*(by_ray - off))))
    alignment = pipeline.window.alignment
    mean, sigma = alignment.platform.mean, pipeline.window.platform.sigma
    score.learned_values = (mean, sigma)
    score.learned = " ".join(
        f"{m * 180 / np.pi:+.2f}±{s * 180 / np.pi:.2f}" for m, s in zip(mean[:3], sigma[:3], strict=True)
    )
    score.learned += " deg " + " ".join(f"{m:+.3f}±{s:.3f}" for m, s in zip(mean[3:], sigma[3:], strict=True))
    return score


def _flat(scene: Scene, flight: ReplayedFlight, k: int, uv: Array) -> tuple[Array, Array]:
    """Meet level ground at home's height with the pixel's ray, from the autopilot's pose through the true mount.

    Also what the autopilot's position is off by at that moment, (2,) east and north.
    """
    log = _raw(scene.recording)
    t_ns = round((flight.begin_s + flight.times_s[k]) * 1e9)
    p = np.array([np.interp(t_ns, log[0], log[1][:, i]) for i in range(3)])
    p = p + flight.drift.at(t_ns)
    j = min(max(int(np.searchsorted(log[2], t_ns)), 1), len(log[2]) - 1)
    R_ned_body = log[3][j if abs(log[2][j] - t_ns) < abs(log[2][j - 1] - t_ns) else j - 1]
    rays, _ = scene.camera.unproject(uv)
    rays = rays @ (R_ENU_NED @ R_ned_body @ flight.R_body_cam).T
    depth = -p[2] / np.minimum(rays[:, 2], -1e-3)
    return p + rays * depth[:, None], (p - flight.centres_enu_m[k])[:2]


@functools.lru_cache(maxsize=8)
def _raw(name: str) -> tuple[Array, Array, Array, Array]:
    log, truth = recording(name)
    place = LocalFrame(float(truth.lat_deg[0]), float(truth.lon_deg[0]), ground_amsl_m(name))
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
    "qp_transition": 0.0,
    "quad": 10.0,
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
    asked = (args.recordings.split(","), args.mounts, args.sensors, args.faults)
    jobs = []
    for name, mount, sensors, fault in itertools.product(*asked):
        config = replace_section(replace_section(base, "mount", **MOUNTS[mount]), "solve", **SENSORS[sensors])
        config = replace_section(config, "camera", **BELIEVED.get(fault, {}))
        start_s = STARTS[name] if args.start is None else args.start
        scene = Scene(name, config, start_s, args.seconds, position_error_m=args.position_error)
        scene = replace(scene, **FAULTS[fault])
        seeds = range(seed_of(name, args.seed), seed_of(name, args.seed) + args.draws)
        jobs += [(f"{name} {mount} {sensors} {fault}", scene, seed) for seed in seeds]
    return jobs


def seed_of(name: str, seed: int) -> int:
    """The seed of a recording's first draw: its own, so that not all recordings get the same error of positions."""
    return seed + 1000 * (zlib.crc32(Path(name).name.encode()) % 1000)


LEGEND = """\
answ, bank: clicks answered, %; of those asked above 30 degrees of bank. med, 90%: error, m; flat: the flat ray's. Then
coverage of the 90 % ellipse by bank (degrees) and of all, of the 99 % ellipse, the worst error over its 90 % ellipse;
beyond, flat: both medians beyond the position's own error, and their ratio. Of a single flight also processor time and
what was estimated: boresight (deg), delays of stamps, position and velocity (s), the heading's error by the heading's
cosine and sine (rad); and the refusals."""


def report(results: Iterable[tuple[str, Score, float]]) -> None:
    """Print a row for every scene as it comes, and one for each set of sensors."""
    print(f"{describe()}\n")
    print(f"{LEGEND}\n")
    columns = "answ bank | med   90%  | flat med 90% | 0-5  5-15 15-30 >30 | all  in99 worst | beyond flat ratio"
    print(f"{'scene':<38} {columns}")
    scenes: dict[str, list[Score]] = {}
    pooled: dict[str, list[Score]] = {}
    for name, score, seconds in results:
        print(row(name, [score]), f"{seconds:5.0f} s", score.learned, score.refused, flush=True)
        scenes.setdefault(name, []).append(score)
        pooled.setdefault(f"pooled {name.split()[2]}", []).append(score)
    for name, scores in pooled.items():
        print(row(name, scores))
    print(f"\n{sharpness_header()}")
    for group, goal in ((scenes, FLIGHT_GOAL), (pooled, POOLED_GOAL)):
        for name, scores in group.items():
            print(sharpness_row(name, scores, goal))


def some_of(known: Collection[str]) -> Callable[[str], list[str]]:
    """Reads names joined by commas, each of them known."""

    def names(text: str) -> list[str]:
        out = text.split(",")
        if unknown := [name for name in out if name not in known]:
            raise argparse.ArgumentTypeError(f"{', '.join(unknown)} not among {', '.join(known)}")
        return out

    return names


def arguments(argv: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--recordings", default="plane_clean,plane_wind_noise,plane_breeze,plane_log")
    parser.add_argument("--mounts", type=some_of(MOUNTS), default="nadir")
    parser.add_argument("--sensors", type=some_of(SENSORS), default="full,gps")
    parser.add_argument("--faults", type=some_of(FAULTS), default="none")
    parser.add_argument("--seconds", type=float, default=200.0)
    parser.add_argument("--start", type=float, default=None)
    parser.add_argument("--draws", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--position-error", type=float, default=Scene.position_error_m, help="one sigma of positions, m; 0: as recorded"
    )
    parser.add_argument("--set", default="", help="TOML put over the defaults")
    parser.add_argument("--jobs", type=int, default=1)
    return parser.parse_args(argv)


def main() -> None:
    """Print the table."""
    args = arguments()
    jobs = jobs_of(args)
    if args.jobs == 1:
        report(map(_work, jobs))
        return
    with multiprocessing.get_context("fork").Pool(args.jobs) as pool:
        report(pool.imap(_work, jobs))


if __name__ == "__main__":
    main()
