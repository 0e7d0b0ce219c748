"""Poses by sensors whose stamps are off, and positions seconds behind. Stamps cut to the second: test_scenarios.py."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from contract.camera import Camera
from contract.rotations import R_ENU_NED, matrix_from_euler
from onboard.config.schema import Config, parse_config
from onboard.estimation.sliding_window import Window
from onboard.events.types import Event, PositionFix
from onboard.navigation.navigator import NavState
from onboard.pipeline.pipeline import Pipeline
from onboard.replay.runner import Flight, replay
from onboard.telemetry.telemetry_log import TelemetryLog
from simulation.flight import DescribedSpec
from simulation.paths import PathSpec
from simulation.session import SessionSpec
from tests.scenarios.flights import CAMERA, Outcome, _Sets, click, play, simulated
from tests.scenarios.sessions import WIDE, photographs


@pytest.mark.parametrize("is_measured", [True, False])
@pytest.mark.parametrize("jitter_s", [0.003, 0.3])
def test_a_pose_by_sensors_alone_owns_up_to_its_stamp(jitter_s: float, is_measured: bool) -> None:
    """Along the track, by the speed, which positions show where it is not measured; not across it."""
    window = Window(Config.model_validate({"camera": {"sigma_jitter_s": jitter_s}}), WIDE)
    R_enu_body = R_ENU_NED @ matrix_from_euler(0.0, 0.0, 0.0)
    velocity = np.array([0.0, 14.0, 0.0])
    measured, by_path = (velocity, None) if is_measured else (None, velocity)
    nav = NavState(0, np.zeros(3), measured, R_enu_body, 1.5, 2.5, 0.3, 0.0, 150.0, path_velocity_enu_m_s=by_path)
    pose = window.sensor_pose(nav)
    east, north = np.sqrt(np.diag(pose.white)[:2])
    assert east == pytest.approx(0.3)
    assert north == pytest.approx(np.hypot(0.3, 14.0 * jitter_s))


def late(folder: Path, behind_s: float, declared_s: float) -> Outcome:
    """Positions that come `behind_s` later, stamped when they come."""
    config = parse_config((folder / "config.toml").read_text() + f"\n[gps]\nlatency_s = {declared_s}\n")
    camera = Camera.from_json(folder / "camera.json")
    flight = Flight.open(config, camera, folder / "frames", folder / "telemetry.tlog", folder / "stamps.csv")
    ns = round(behind_s * 1e9)
    pairs = [
        (t + ns, replace(e, stamp_ns=e.stamp_ns + ns)) if isinstance(e, PositionFix) else (t, e)
        for t, e in zip(flight.telemetry.arrival_ns, flight.telemetry.events, strict=True)
    ]
    pairs.sort(key=lambda pair: pair[0])
    log = TelemetryLog([event for _, event in pairs], [arrival for arrival, _ in pairs])
    pipeline, sink = Pipeline(config, camera), _Sets()
    replay(replace(flight, telemetry=log), pipeline, [sink])
    return click(folder, sink.by_frame, pipeline)


@pytest.mark.long
def test_late_positions_without_velocities_lie_in_their_ellipse() -> None:
    """A video's subtitles and tracks have none: no clock's sigma reached an ellipse, and 0 to 14 % were within 90 %."""
    spec = SessionSpec(
        DescribedSpec(PathSpec(heading_deg=0.0, height_m=100.0, speed_m_s=15.0)), seconds=20.0, rate_hz=2.0,
        camera=CAMERA, attitude="none", velocity=False, level_ground=True, clicks_per_frame=6,
    )  # fmt: skip

    def late_by(event: Event, _: float) -> Event:
        if not isinstance(event, PositionFix):
            return event
        return replace(event, velocity_ned_m_s=None, stamp_ns=event.stamp_ns + 500_000_000)

    outcome = play(simulated(spec), ("gps.sigma_latency_s", 0.3), spoil=late_by)
    assert outcome.solved > 0.8 and outcome.inside_99 >= 0.97, outcome.reported
    assert np.median(outcome.errors_m) > 4.0 and np.median(outcome.semi_m) < 25.0, outcome.reported


@pytest.mark.long
def test_positions_seconds_behind_their_stamps_are_waited_for() -> None:
    folder = simulated(photographs(0))
    prompt, behind = late(folder, 0.0, 0.0), late(folder, 4.0, 4.0)
    assert prompt.solved == 1.0, prompt.reported
    assert behind.solved == 1.0, behind.reported
    assert behind.inside_99 >= 0.97, behind.reported
    assert np.median(behind.errors_m) == pytest.approx(np.median(prompt.errors_m), abs=0.05)


@pytest.mark.parametrize(("key", "most"), [("camera.sigma_jitter_s", 1.0), ("gps.latency_s", 5.0)])
def test_the_configuration_takes_them(key: str, most: float) -> None:
    section, name = key.split(".")
    config = parse_config(f"[{section}]\n{name} = {most}\n")
    assert getattr(getattr(config, section), name) == most
    with pytest.raises(Exception, match=f"{name} = {most + 0.1} is not usable"):
        parse_config(f"[{section}]\n{name} = {most + 0.1}\n")
