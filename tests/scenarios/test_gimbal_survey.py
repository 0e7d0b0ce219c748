"""Photographs 1.4 s apart from a camera that a gimbal holds level: "auto" finds the gimbal and loses no picture."""

import math
import tomllib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from contract.camera import Camera
from contract.feature_set import Status
from contract.rotations import matrix_from_euler, matrix_from_quaternion, quaternion_from_matrix
from contract.wire.codec import encode
from onboard.config.schema import Config
from onboard.estimation.solver_executor import Worker
from onboard.events.types import Attitude, Event, GimbalAttitude, NavEvent
from onboard.navigation.gimbal import MountHypothesis
from onboard.pipeline.pipeline import Pipeline
from onboard.replay.runner import Flight, replay, summary_text
from onboard.telemetry.telemetry_log import TelemetryLog
from simulation.flight import DescribedSpec
from simulation.paths import PathSpec
from simulation.session import SessionSpec
from tests.scenarios.flights import Outcome, _Sets, click, simulated

WIDE = Camera.from_field_of_view(320, 240, 70.0)
APART_S, PICTURES = 1.4, 18
LEVEL = matrix_from_euler(0.0, -np.pi / 2, 0.0)
Lean = Callable[[float], tuple[float, float, float]]


def q(R: np.ndarray) -> tuple[float, float, float, float]:
    w, x, y, z = quaternion_from_matrix(R).tolist()
    return w, x, y, z


def played(
    folder: Path,
    gimbal: str,
    events: Callable[[Attitude, float], list[NavEvent]],
    pitch_off: float = 0.0,
    worker: Worker | None = None,
) -> Outcome:
    """A session whose attitudes are exchanged for other events, given the time (s) since the first picture."""
    table = tomllib.loads((folder / "config.toml").read_text())
    table["mount"]["gimbal"] = gimbal
    table["mount"]["pitch_deg"] += pitch_off
    config, camera = Config.model_validate(table), Camera.from_json(folder / "camera.json")
    flight = Flight.open(config, camera, folder / "frames", folder / "telemetry.tlog", folder / "stamps.csv")
    pairs: list[tuple[int, NavEvent]] = []
    for arrival_ns, event in zip(flight.telemetry.arrival_ns, flight.telemetry.events, strict=True):
        t = (event.stamp_ns - flight.stamps_ns[0]) / 1e9
        pairs += [(arrival_ns, e) for e in (events(event, t) if isinstance(event, Attitude) else [event])]
    log = TelemetryLog([event for _, event in pairs], [arrival for arrival, _ in pairs])
    pipeline, sink = Pipeline(config, camera, worker=worker), _Sets()
    replay(replace(flight, telemetry=log), pipeline, [sink])
    return click(folder, sink.by_frame, pipeline)


def held_level(lean: Lean) -> Callable[[Attitude, float], list[NavEvent]]:
    """The camera's own attitude as a gimbal's, and a vehicle that leans under it."""

    def events(event: Event, t: float) -> list[NavEvent]:
        R_ned_level = matrix_from_quaternion(event.q_ned_body)
        body = R_ned_level @ matrix_from_euler(*lean(t))
        heading = math.atan2(body[1, 0], body[0, 0])
        gimbal = matrix_from_euler(0.0, 0.0, heading).T @ R_ned_level @ LEVEL
        return [Attitude(event.stamp_ns, q(body)), GimbalAttitude(event.stamp_ns, q(gimbal), "vehicle")]

    return events


def only_the_gimbal(event: Attitude, t: float) -> list[NavEvent]:
    """What a camera drone's pictures say."""
    return [GimbalAttitude(event.stamp_ns, q(matrix_from_quaternion(event.q_ned_body) @ LEVEL), "earth")]


def survey(speed_m_s: float, height_m: float, wobble_deg: float = 0.3, pictures: int = PICTURES) -> Path:
    path = PathSpec("straight", speed_m_s=speed_m_s, height_m=height_m, wobble_deg=wobble_deg, pitch_deg=0.0)
    return simulated(
        SessionSpec(
            DescribedSpec(path), seconds=pictures * APART_S, rate_hz=1.0 / APART_S, camera=WIDE, clicks_per_frame=8
        )
    )


LEANS: dict[str, tuple[float, float, Lean]] = {
    "gusts": (10.0, 120.0, lambda t: (0.06 * math.sin(0.7 * t), -0.14 + 0.05 * math.sin(1.1 * t), 0.0)),
    "leaning far": (10.0, 100.0, lambda t: (0.05 * math.sin(0.9 * t), -0.26, 0.0)),
    "rolling slowly": (15.0, 120.0, lambda t: (0.1 * math.sin(0.5 * t), 0.05 * math.sin(0.3 * t), 0.0)),
}


@pytest.mark.long  # short: its summary, below
@pytest.mark.parametrize("lean", LEANS)
def test_auto_solves_no_fewer_pictures_than_always_where_the_gimbal_tells_the_truth(lean: str) -> None:
    speed, height, leaning = LEANS[lean]
    folder = survey(speed, height)
    always, auto = (played(folder, mode, held_level(leaning)) for mode in ("always", "auto"))
    assert always.statuses[Status.OK] == PICTURES, always.reported
    assert auto.statuses[Status.OK] >= always.statuses[Status.OK], auto.reported
    assert auto.inside_99 >= 0.97, auto.reported
    assert np.median(auto.errors_m) < 1.3 * np.median(always.errors_m) + 0.2, auto.reported
    assert np.median(auto.semi_m) < 1.2 * np.median(always.semi_m), auto.reported
    assert auto.pipeline.mount_selection.verdict is MountHypothesis.GIMBAL
    assert "camera carried by" in summary_text(auto.pipeline.summary)
    assert auto.pipeline.summary.mounted_on == "gimbal, as the pictures show"


@pytest.mark.long  # short, of windows: a thread of their own in tests/onboard/pipeline/test_pipeline.py
def test_trials_in_a_thread_give_the_same_bytes() -> None:
    speed, height, leaning = LEANS["gusts"]
    folder = survey(speed, height)
    inline = played(folder, "auto", held_level(leaning))
    with ThreadPoolExecutor(1) as worker:
        threaded = played(folder, "auto", held_level(leaning), worker=worker)
    assert [encode(s) for s in inline.sets.values()] == [encode(s) for s in threaded.sets.values()]


@pytest.mark.long
@pytest.mark.parametrize(
    ("wobble_deg", "pitch_off"), [(4.0, 4.0), (1.5, 0.0), (1.5, 4.0), (1.5, 8.0), (4.0, 0.0), (4.0, 8.0)]
)
def test_a_gimbal_that_is_not_there_is_never_accepted(wobble_deg: float, pitch_off: float) -> None:
    """A fixed camera, whose mount may be declared some degrees wrong, and a gimbal's messages of always level."""
    folder = survey(14.0, 150.0, wobble_deg)

    def events(event: Attitude, t: float) -> list[NavEvent]:
        return [event, GimbalAttitude(event.stamp_ns, q(LEVEL), "vehicle")]

    never, auto = (played(folder, mode, events, pitch_off) for mode in ("never", "auto"))
    assert auto.pipeline.mount_selection.verdict is not MountHypothesis.GIMBAL
    assert auto.pipeline.summary.mounted_on.startswith(("fixed mount", "gimbal by joint angles"))
    assert auto.statuses[Status.OK] >= never.statuses[Status.OK] - 2, auto.reported
    assert auto.inside_99 >= 0.97, auto.reported


@pytest.mark.long
def test_the_summary_says_what_carried_the_camera_and_why() -> None:
    folder = survey(10.0, 120.0, pictures=8)
    always = played(folder, "always", held_level(lambda t: (0.0, -0.1, 0.0))).pipeline
    never = played(folder, "never", held_level(lambda t: (0.0, 0.0, 0.0))).pipeline
    alone = played(folder, "auto", only_the_gimbal).pipeline
    none = played(folder, "auto", lambda e, t: []).pipeline
    assert always.summary.mounted_on == 'gimbal, as mount.gimbal = "always" specifies'
    assert never.summary.mounted_on == "fixed mount"
    assert alone.summary.mounted_on == "gimbal, as no attitude of the vehicle is received"
    assert none.summary.mounted_on == "unknown: no attitude is used"
