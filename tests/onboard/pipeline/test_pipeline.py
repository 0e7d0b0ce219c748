"""A small rendered flight through the whole pipeline: every frame answered, reasons given, the same bytes again."""

from collections import defaultdict
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache

import cv2
import numpy as np
import pytest

from contract.answer import Fix
from contract.camera import Camera
from contract.feature_set import FeatureSet, Status
from contract.geodesy import LocalFrame
from contract.locate import Locator
from contract.wire.codec import encode
from onboard.config.schema import parse_config
from onboard.estimation.solver_executor import Done, Promise, Worker
from onboard.estimation.window_request import Request
from onboard.events.types import Attitude, Event, Frame, GpsQuality, PositionFix
from onboard.georeferencing.revision import MOVED, WIDENED
from onboard.pipeline.pipeline import ADOPTION_NS, Pipeline
from onboard.pipeline.placing import Placing
from onboard.telemetry.tlog_reader import read_tlog
from simulation.flight import DescribedSpec
from simulation.paths import PathSpec
from simulation.session import SessionSpec
from simulation.terrain import TerrainSpec
from simulation.truth import Truth
from tests.scenarios.flights import simulated as session_of

pytestmark = pytest.mark.xdist_group("pipeline")  # one worker: what they share is made once

SECONDS, RATE_HZ = 9.0, 3.0
CAMERA = Camera.from_field_of_view(480, 360, 40.0)
SPEC = SessionSpec(
    DescribedSpec(PathSpec(height_m=180.0, speed_m_s=20.0), seed=3),
    seconds=SECONDS,
    rate_hz=RATE_HZ,
    camera=CAMERA,
    terrain=TerrainSpec(relief_m=10.0, seed=2),
    seed=3,
)


@dataclass(frozen=True, eq=False)
class Session:
    truth: Truth
    config: str
    events: list[Event]

    def pipeline(self, worker: Worker | None = None) -> Pipeline:
        return Pipeline(parse_config(self.config), CAMERA, worker=worker)

    def run(self, events: list[Event] | None = None, worker: Worker | None = None) -> list[FeatureSet]:
        return list(outputs(self.pipeline(worker), self.events if events is None else events))


class Held:
    """A worker that works only when somebody insists on the result, and keeps count."""

    def __init__(self) -> None:
        self.submitted = self.waited = 0

    def submit(self, fn: Callable[[Request], Done], request: Request, /) -> Promise:
        self.submitted += 1
        return HeldPromise(self, fn, request)


@dataclass(frozen=True, eq=False)
class HeldPromise:
    worker: Held
    fn: Callable[[Request], Done]
    request: Request

    def result(self) -> Done:
        self.worker.waited += 1
        return self.fn(self.request)


def outputs(pipeline: Pipeline, events: list[Event]) -> Iterator[FeatureSet]:
    for event in events:
        yield from pipeline.handle(event)
    yield from pipeline.finish()


BRISK = replace(SPEC, seconds=4.5, rate_hz=12.0)  # several pictures between two keyframes


@pytest.fixture(scope="module")
def session() -> Session:
    return flown(SPEC)


@pytest.fixture(scope="module")
def brisk() -> Session:
    return flown(BRISK)


@cache
def flown(spec: SessionSpec) -> Session:
    """The same for all files that need it."""
    folder = session_of(spec)
    truth = Truth.load(folder)
    config = (folder / "config.toml").read_text()
    frames: list[Event] = [
        Frame(
            round(float(t) * 1e9),
            index,
            np.asarray(cv2.imread(str(folder / "frames" / name), cv2.IMREAD_GRAYSCALE), np.uint8),
            name,
        )
        for index, (name, t) in enumerate(zip(truth.files, truth.unix_time_s, strict=True))
    ]
    telemetry = read_tlog(folder / "telemetry.tlog", parse_config(config)).events
    events = sorted([*frames, *telemetry], key=lambda e: e.stamp_ns)
    return Session(truth, config, events)


@pytest.fixture(scope="module")
def sets(session: Session) -> list[FeatureSet]:
    return session.run()


def last(sets: list[FeatureSet]) -> dict[int, FeatureSet]:
    return {s.frame: s for s in sets}


def edit(events: list[Event], kind: type, change: object) -> list[Event]:
    """Events with those of one kind replaced by `change(event)`, left out where it is None."""
    assert callable(change)
    out = [change(e) if isinstance(e, kind) else e for e in events]
    return [e for e in out if e is not None]


def test_every_frame_is_answered_and_almost_all_have_a_pose(session: Session, sets: list[FeatureSet]) -> None:
    final = last(sets)
    assert sorted(final) == list(range(len(session.truth)))
    solved = [f for f, s in final.items() if s.is_ok]
    assert len(solved) >= 0.9 * len(final)
    assert any(not final[f].is_keyframe for f in solved)
    assert any(final[f].is_keyframe for f in solved)


def test_clicks_are_where_the_ground_is(session: Session, sets: list[FeatureSet]) -> None:
    """The full set of sensors over gentle hills: a few metres, and inside what is claimed."""
    errors, claims = [], []
    uv = np.array([[120.0, 90.0], [240.0, 180.0], [360.0, 270.0]])
    for frame, s in last(sets).items():
        if not s.is_ok:
            continue
        truth = session.truth.ground(frame, uv)
        for k, at in enumerate(uv):
            fix = Locator(s).locate(at)
            assert fix.height_ellipsoid_m is not None
            enu = session.truth.origin.to_enu(fix.lat_deg, fix.lon_deg, fix.height_ellipsoid_m)
            errors.append(np.linalg.norm(enu[:2] - truth.enu_m[k, :2]))
            claims.append(fix.ellipse.semi_major_m)
    assert 0.0 < np.median(errors) < 4.0
    assert np.mean(np.array(errors) < claims) > 0.8


def test_revisions_of_a_frame_count_up_and_do_not_take_an_answer_back(sets: list[FeatureSet]) -> None:
    by_frame: dict[int, list[FeatureSet]] = defaultdict(list)
    for s in sets:
        by_frame[s.frame].append(s)
    assert any(len(history) > 1 for history in by_frame.values())
    for history in by_frame.values():
        revisions = [s.revision for s in history]
        assert revisions == list(range(len(revisions)))
        ok = [s.is_ok for s in history]
        assert ok == sorted(ok)


@pytest.fixture(scope="module")
def at_once(brisk: Session) -> list[FeatureSet]:
    """The sets of the brisk flight, its windows solved at once."""
    return solved_at_once(brisk)


@cache
def solved_at_once(session: Session) -> list[FeatureSet]:
    return session.run()


@pytest.mark.long  # short: tracking goes on, below
def test_a_thread_beside_gives_the_same_bytes_as_solving_at_once(brisk: Session, at_once: list[FeatureSet]) -> None:
    with ThreadPoolExecutor(1) as worker:
        threaded = brisk.run(worker=worker)
    assert [encode(s) for s in threaded] == [encode(s) for s in at_once]


@pytest.mark.long
def test_a_picture_that_is_not_placed_again_has_the_answers_that_it_would_have(
    brisk: Session, at_once: list[FeatureSet], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Within a tenth of the radius, which is the same to a twentieth; and no click is lost."""
    sparing = last(at_once)
    monkeypatch.setattr(Placing, "is_needless", lambda *_: False)
    always = last(brisk.run())
    spared = [frame for frame, s in always.items() if s.revision > sparing[frame].revision]
    assert 3 <= len(spared) < 0.5 * len(always)  # here the ground under the front edge is mostly new
    answers = 0
    for frame in spared:
        had, would_have = Locator(sparing[frame]), Locator(always[frame])
        for uv in ((10.0, 10.0), (470.0, 10.0), (240.0, 180.0), (10.0, 350.0), (470.0, 350.0)):
            one, other = had.locate(uv), would_have.locate(uv)
            if isinstance(other, Fix):
                frame_m = LocalFrame(other.lat_deg, other.lon_deg, 0.0)
                apart_m = float(np.linalg.norm(frame_m.to_enu(one.lat_deg, one.lon_deg, 0.0)[:2]))
                radius_m = other.ellipse.semi_major_m
                assert apart_m < 1.2 * MOVED * radius_m
                assert abs(one.ellipse.semi_major_m / radius_m - 1.0) < 1.5 * WIDENED
                answers += 1
    assert answers >= 3 * len(spared)


def test_tracking_goes_on_while_a_window_is_solved(brisk: Session, at_once: list[FeatureSet]) -> None:
    """What is not done is not waited for until a quarter of a second of data has passed, or the next keyframe."""
    held = Held()
    pipeline = brisk.pipeline(held)
    out: list[FeatureSet] = []
    begun_ns, answered_meanwhile = 0, 0
    for event in brisk.events:
        before, sets_before = (held.submitted, held.waited), len(out)
        was_open = held.submitted > held.waited
        out.extend(pipeline.handle(event))
        if held.waited > before[1] and held.submitted == before[0]:
            assert event.stamp_ns >= begun_ns + ADOPTION_NS
        elif was_open and held.waited == before[1]:
            assert event.stamp_ns < begun_ns + ADOPTION_NS
            answered_meanwhile += len(out) - sets_before
        if held.submitted > before[0]:
            begun_ns = event.stamp_ns
    out.extend(pipeline.finish())
    assert held.submitted == held.waited == pipeline.summary.keyframes
    assert answered_meanwhile >= 5
    assert [encode(s) for s in out] == [encode(s) for s in at_once]


def test_a_keyframe_is_answered_at_once_and_again_by_the_solve_it_belongs_to(session: Session) -> None:
    held = Held()
    pipeline = session.pipeline(held)
    answered: dict[int, list[bool]] = defaultdict(list)
    for event in session.events:
        waited = held.waited
        for s in pipeline.handle(event):
            if s.is_keyframe and s.is_ok:
                answered[s.frame].append(held.waited > waited)
    assert sum(waits[:2] == [False, True] for waits in answered.values()) >= 3


def test_what_goes_wrong_beside_is_not_swallowed(session: Session) -> None:
    class Broken(Held):
        def submit(self, fn: Callable[[Request], Done], request: Request, /) -> Promise:
            def fail(request: Request) -> Done:
                raise ArithmeticError("broken")

            return super().submit(fail, request)

    with pytest.raises(ArithmeticError, match="broken"):
        session.run(worker=Broken())


def test_a_picture_that_cannot_be_decoded_is_passed_over(session: Session) -> None:
    bad = {4, 11}
    events = edit(session.events, Frame, lambda f: replace(f, image=None) if f.index in bad else f)
    final = last(session.run(events))
    assert {f for f, s in final.items() if s.status is Status.BAD_PICTURE} == bad
    assert sum(s.is_ok for s in final.values()) >= 0.8 * len(final)


def test_a_black_picture_is_refused_and_its_neighbours_are_not(session: Session) -> None:
    black = np.zeros((360, 480), np.uint8)
    events = edit(session.events, Frame, lambda f: replace(f, image=black) if f.index == 12 else f)
    final = last(session.run(events))
    assert final[12].status is Status.FEATURELESS
    assert final[11].is_ok
    assert final[13].is_ok


def test_without_telemetry_every_frame_is_refused_with_the_reason(session: Session) -> None:
    frames = [e for e in session.events if isinstance(e, Frame)]
    sets = session.run(list(frames))
    assert sorted(s.frame for s in sets) == list(range(len(frames)))
    assert {s.status for s in sets} == {Status.STARTING}


def test_a_lost_fix_is_no_gps(session: Session) -> None:
    half = session.truth.unix_time_s[len(session.truth) // 2] * 1e9
    events = edit(session.events, GpsQuality, lambda q: replace(q, fix_type=1) if q.stamp_ns > half else q)
    final = last(session.run(events))
    later = [f for f, t in enumerate(session.truth.unix_time_s) if t * 1e9 > half + 0.5e9]
    assert {final[f].status for f in later} == {Status.NO_GPS}
    earlier = [f for f, t in enumerate(session.truth.unix_time_s) if t * 1e9 < half - 0.5e9]
    assert sum(final[f].is_ok for f in earlier) >= 0.7 * len(earlier)


def test_telemetry_that_ends_is_reported_to_be_missing(session: Session) -> None:
    half = session.truth.unix_time_s[len(session.truth) // 2] * 1e9
    events = [e for e in session.events if isinstance(e, Frame) or e.stamp_ns < half]
    final = last(session.run(events))
    later = [f for f, t in enumerate(session.truth.unix_time_s) if t * 1e9 > half + 2.5e9]
    assert later
    assert all(not final[f].is_ok for f in later)
    assert {final[f].status for f in later} <= {Status.UNSYNCHRONISED, Status.NO_GPS}


def test_the_seeds_sensors_solve_the_same_flight(session: Session) -> None:
    text = session.config.replace('attitude = "autopilot"', 'attitude = "none"').replace(
        "velocity = true", "velocity = false"
    )
    text = text.replace("level_ground = false", "level_ground = true")
    assert text != session.config
    events = [e for e in session.events if not isinstance(e, Attitude)]
    pipeline = Pipeline(parse_config(text), CAMERA)
    final = last(list(outputs(pipeline, events)))
    solved = [s for s in final.values() if s.is_ok]
    assert len(solved) >= 0.8 * len(final)
    errors = []
    for s in solved:
        fix = Locator(s).locate((240.0, 180.0))
        if isinstance(fix, Fix) and fix.height_ellipsoid_m is not None:
            enu = session.truth.origin.to_enu(fix.lat_deg, fix.lon_deg, fix.height_ellipsoid_m)
            errors.append(np.linalg.norm(enu[:2] - session.truth.ground(s.frame, [[240.0, 180.0]]).enu_m[0, :2]))
    assert len(errors) >= 0.7 * len(solved)
    assert 0.0 < np.median(errors) < 15.0


def test_the_summary_counts_what_was_done(session: Session) -> None:
    pipeline = Pipeline(parse_config(session.config), CAMERA)
    final = last(list(outputs(pipeline, session.events)))
    summary = pipeline.summary
    assert summary.frames == len(session.truth)
    assert summary.solved == sum(s.is_ok for s in final.values())
    assert summary.solved + sum(summary.refused.values()) == summary.frames
    assert 3 <= summary.keyframes <= summary.frames
    assert 40 < summary.median_tracks <= 100
    assert 0.02 < summary.reprojection_px < 1.0
    assert {"navigation", "tracking", "solve", "georeference"} <= set(summary.stage_seconds)


def test_the_order_of_telemetry_within_its_delay_does_not_lose_a_frame(session: Session) -> None:
    """Positions that arrive 0.4 s late: frames wait for them."""

    def arrival(e: Event) -> float:
        return e.stamp_ns + (0.4e9 if isinstance(e, PositionFix) else 0.0)

    final = last(session.run(sorted(session.events, key=arrival)))
    assert sorted(final) == list(range(len(session.truth)))
    assert sum(s.is_ok for s in final.values()) >= 0.9 * len(final)
