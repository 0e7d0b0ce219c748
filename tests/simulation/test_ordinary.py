"""An ordinary autopilot's errors: each is found again in the telemetry that has it, and sampled as was measured."""

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from contract.geodesy import LocalFrame
from contract.rotations import R_ENU_NED, euler_from_matrix, matrix_from_quaternion
from onboard.events.types import Attitude, PositionFix
from onboard.telemetry.tlog_reader import read_tlog
from simulation.autopilot_errors import AutopilotErrors
from simulation.flight import DescribedSpec
from simulation.fly import session_spec
from simulation.ordinary import ordinary
from simulation.paths import PathSpec, fly_path
from simulation.telemetry import TelemetrySpec, write_tlog
from simulation.trajectory import Trajectory
from tests.simulation.test_telemetry import PERFECT

pytestmark = pytest.mark.xdist_group("ordinary")  # one worker: what they share is made once

Array = NDArray[np.float64]

ORIGIN = LocalFrame(-43.38, 172.4, 111.0)
QUIET = replace(PERFECT, attitude_message="quaternion")


@dataclass(frozen=True, eq=False)
class Reported:
    """Reported less true: positions and velocities (N, 3), ENU, and roll, pitch, heading (M, 3), deg."""

    position_s: Array
    position_m: Array
    velocity_m_s: Array
    attitude_s: Array
    attitude_deg: Array
    truth: Trajectory

    def acceleration_m_s2(self, time_s: Array) -> Array:
        """True, (N, 3) ENU."""
        return (self.truth.velocity_enu_m_s(time_s + 0.25) - self.truth.velocity_enu_m_s(time_s - 0.25)) / 0.5

    @property
    def heading_rad(self) -> Array:
        """True, of the attitudes."""
        return euler_from_matrix(R_ENU_NED.T @ self.truth.R_enu_body(self.attitude_s))[:, 2]


@cache
def path(kind: str, seconds: float) -> Trajectory:
    """Level legs joined by turns of 25 degrees' bank, or a straight leg."""
    return fly_path(PathSpec(kind, leg_m=200.0), seconds, seed=2)


def reported(
    folder: Path, errors: AutopilotErrors, kind: str = "turns", seconds: float = 300.0, **spec: float
) -> Reported:
    """What a log with these errors says, against the truth at its own stamps."""
    truth = path(kind, seconds)
    log, epoch = write_tlog(truth, ORIGIN, 11.0, replace(QUIET, errors=errors, **spec), seed=5)  # type: ignore[arg-type]
    (folder / "log.tlog").write_bytes(log)
    events = read_tlog(folder / "log.tlog").events
    inside = [e for e in events if truth.start_s + 2.0 < e.stamp_ns / 1e9 - epoch < truth.end_s - 2.0]
    fixes = [e for e in inside if isinstance(e, PositionFix)]
    attitudes = [e for e in inside if isinstance(e, Attitude)]
    t = np.array([e.stamp_ns / 1e9 - epoch for e in fixes])
    place = ORIGIN.to_enu(
        np.array([e.lat_deg for e in fixes]),
        np.array([e.lon_deg for e in fixes]),
        np.array([e.height_amsl_m for e in fixes]) + 11.0,
    )
    velocity = np.array([e.velocity_ned_m_s for e in fixes]) @ R_ENU_NED.T
    u = np.array([e.stamp_ns / 1e9 - epoch for e in attitudes])
    angles = euler_from_matrix(matrix_from_quaternion(np.array([e.q_ned_body for e in attitudes])))
    wrong = np.degrees(angles - euler_from_matrix(R_ENU_NED.T @ truth.R_enu_body(u)))
    return Reported(
        t,
        place - truth.position_enu_m(t),
        velocity - truth.velocity_enu_m_s(t),
        u,
        (wrong + 180.0) % 360.0 - 180.0,
        truth,
    )


def slope(x: Array, y: Array) -> float:
    """Of y over x, through 0."""
    return float(np.sum(x * y) / np.sum(x * x))


def test_no_errors_are_none(tmp_path: Path) -> None:
    """The log that is declared is not touched by what an ordinary autopilot's would have."""
    messages = reported(tmp_path, AutopilotErrors(), seconds=60.0)
    assert np.abs(messages.position_m).max() < 0.03
    assert np.abs(messages.velocity_m_s).max() < 0.02
    assert np.abs(messages.attitude_deg).max() < 0.03


@pytest.mark.parametrize(("position_s", "velocity_s"), [(0.15, 0.08), (-0.2, -0.11)])
def test_position_lags_along_the_track_and_velocity_by_less(
    position_s: float, velocity_s: float, tmp_path: Path
) -> None:
    errors = AutopilotErrors(position_lag_s=position_s, velocity_lag_s=velocity_s)
    messages = reported(tmp_path, errors, attitude_hz=1.0)
    v, a = messages.truth.velocity_enu_m_s(messages.position_s), messages.acceleration_m_s2(messages.position_s)
    assert slope(v, messages.position_m) == pytest.approx(-position_s, abs=0.001)
    assert np.abs(messages.position_m + position_s * v).max() < 0.04, "a lag, and in a turn no older place"
    assert slope(a, messages.velocity_m_s) == pytest.approx(-velocity_s, abs=0.003)


@pytest.mark.long
def test_level_is_trimmed_wrong_and_tilts_with_acceleration(tmp_path: Path) -> None:
    messages = reported(tmp_path, AutopilotErrors(trim_deg=(0.9, -1.2), tilt_per_m_s2_deg=(0.05, -0.04)))
    right = np.stack([np.cos(messages.heading_rad), -np.sin(messages.heading_rad)], axis=1)
    ahead = np.stack([np.sin(messages.heading_rad), np.cos(messages.heading_rad)], axis=1)
    acceleration = messages.acceleration_m_s2(messages.attitude_s)[:, :2]
    aside = np.sum(acceleration * right, axis=1)
    level = np.abs(aside) < 0.3
    assert np.mean(messages.attitude_deg[level], axis=0)[:2] == pytest.approx([0.9, -1.2], abs=0.03)
    assert np.polyfit(aside, messages.attitude_deg[:, 0], 1)[0] == pytest.approx(0.05, abs=0.01)
    # There is hardly any acceleration ahead at constant speed: pitch must not follow that to the side by itself.
    assert np.abs(np.sum(acceleration * ahead, axis=1)).max() < 1.0
    slowly = reported(tmp_path, AutopilotErrors(tilt_deg=0.8, tilt_time_s=3.0), "straight", 600.0, attitude_hz=5.0)
    sampling = 1.0 / np.sqrt(2.0 * 600.0 / (2.0 * 3.0))  # of a sigma, relative
    assert messages.attitude_deg.shape[1] == 3
    assert slowly.attitude_deg[:, :2].std(axis=0) == pytest.approx([0.8, 0.8], rel=3.0 * sampling)


def test_heading_is_wrong_by_heading_and_drifts(tmp_path: Path) -> None:
    errors = AutopilotErrors(heading_deg=0.7, heading_cos_deg=3.0, heading_sin_deg=-1.5)
    messages = reported(tmp_path, errors, "orbit", 120.0)
    h = messages.heading_rad
    assert np.ptp(np.cos(h)) > 1.9 and np.ptp(np.sin(h)) > 1.9, "all directions"
    found, *_ = np.linalg.lstsq(
        np.stack([np.ones(len(h)), np.cos(h), np.sin(h)], axis=1), messages.attitude_deg[:, 2], rcond=None
    )
    assert found == pytest.approx([0.7, 3.0, -1.5], abs=0.03)
    drift = AutopilotErrors(heading_drift_deg=1.5, heading_time_s=3.0)
    drifts = reported(tmp_path, drift, "straight", 600.0, attitude_hz=5.0)
    heading = drifts.attitude_deg[:, 2]
    assert heading.std() == pytest.approx(1.5, rel=3.0 / np.sqrt(600.0 / 3.0))
    lag = 3 * 5
    later = float(np.mean(heading[lag:] * heading[:-lag]) / heading.var())
    assert later == pytest.approx(np.exp(-1.0), abs=0.25), "one time constant on"
    assert np.abs(drifts.attitude_deg[:, :2]).max() < 0.1


def test_velocity_errs_with_acceleration(tmp_path: Path) -> None:
    errors = AutopilotErrors(velocity_m_s=0.1, velocity_per_m_s2=0.12, velocity_time_s=1.0)
    messages = reported(tmp_path, errors, attitude_hz=1.0)
    size = np.linalg.norm(messages.acceleration_m_s2(messages.position_s), axis=1)
    level, turning = size < 0.3, size > 3.5
    assert messages.velocity_m_s[level].std() == pytest.approx(0.105, rel=0.25)
    expected = float(np.sqrt(np.mean(0.1**2 + (0.12 * size[turning]) ** 2)))
    assert expected > 0.4
    assert messages.velocity_m_s[turning].std() == pytest.approx(expected, rel=0.25)


def test_the_filter_follows_a_glitch_and_comes_back(tmp_path: Path) -> None:
    errors = AutopilotErrors(
        glitch_m=(20.0, 0.0, 0.0), glitch_start_share=0.5, glitch_s=12.0, glitch_follow_s=2.0, glitch_in_velocity=0.3
    )
    messages = reported(tmp_path, errors, "straight", 60.0)
    began_s = 0.5 * (messages.truth.start_s + messages.truth.end_s)
    off = np.interp([-0.2, 2.0, 11.0, 14.0, 30.0], messages.position_s - began_s, messages.position_m[:, 0])
    assert off == pytest.approx(20.0 * np.array([0.0, 1 - np.exp(-1.0), 1 - np.exp(-5.5), np.exp(-1.0), 0.0]), abs=0.3)
    assert np.abs(messages.position_m[:, 1]).max() < 0.05
    stated = np.interp(2.0, messages.position_s - began_s, messages.velocity_m_s[:, 0])
    assert stated == pytest.approx(0.3 * 20.0 / 2.0 * np.exp(-1.0), abs=0.1)


@pytest.mark.long
def test_position_drifts_as_sampled(tmp_path: Path) -> None:
    messages = reported(
        tmp_path, AutopilotErrors(), "straight", 900.0, slow_horizontal_m=2.0, slow_time_constant_s=5.0, attitude_hz=1.0
    )
    assert messages.position_m[:, :2].std(axis=0) == pytest.approx([2.0, 2.0], rel=3.0 / np.sqrt(900.0 / 5.0))


def test_autopilots_are_sampled_as_they_were_measured() -> None:
    """Over many seeds every error has its distribution, and both signs; none is the same for all."""
    from scipy.stats import binomtest, kstest  # noqa: PLC0415  a second of processor time for each worker

    sampled = [ordinary(seed) for seed in range(1500)]
    errors = [spec.errors for spec in sampled]
    lag = np.array([e.position_lag_s for e in errors])
    assert kstest(lag[np.abs(lag) < 0.25] / 0.1, "truncnorm", (-2.5, 2.5)).pvalue > 1e-3
    assert np.abs(lag).max() <= 0.25 and 0.45 < np.mean(lag > 0) < 0.55
    share = np.array([e.velocity_lag_s for e in errors]) / lag
    assert kstest(share, "uniform", (0.4, 0.3)).pvalue > 1e-3
    for name, sigma in (("trim_deg", 0.7), ("tilt_per_m_s2_deg", 0.04)):
        assert kstest(np.array([getattr(e, name) for e in errors]).ravel() / sigma, "norm").pvalue > 1e-3
    by_heading = np.array([(e.heading_cos_deg, e.heading_sin_deg) for e in errors])
    assert kstest(np.linalg.norm(by_heading, axis=1), "uniform", (0.0, 5.0)).pvalue > 1e-3
    assert kstest(np.arctan2(*by_heading.T), "uniform", (-np.pi, 2.0 * np.pi)).pvalue > 1e-3
    for name, low, high in (("tilt_deg", 0.15, 1.2), ("heading_drift_deg", 0.2, 2.0)):
        values = np.log([getattr(e, name) / low for e in errors]) / np.log(high / low)
        assert kstest(values, "uniform").pvalue > 1e-3, name
    for name, low, high in (("velocity_m_s", 0.06, 0.25), ("velocity_per_m_s2", 0.01, 0.12)):
        assert kstest([getattr(e, name) for e in errors], "uniform", (low, high - low)).pvalue > 1e-3, name
    glitches = np.array([np.linalg.norm(e.glitch_m[:2]) for e in errors])
    assert binomtest(int(np.count_nonzero(glitches)), len(errors), 0.3).pvalue > 1e-3
    assert kstest(glitches[glitches > 0.0], "uniform", (5.0, 30.0)).pvalue > 1e-3
    assert {spec.attitude_hz for spec in sampled} >= {2.0, 3.3, 10.0, 50.0}
    assert {spec.position_hz for spec in sampled} >= {2.0, 10.0}
    wander = np.log([spec.slow_horizontal_m / 0.5 for spec in sampled]) / np.log(5.0)
    assert kstest(wander, "uniform").pvalue > 1e-3


def test_the_same_seed_is_the_same_autopilot() -> None:
    truth = path("turns", 30.0)
    first, again, other = (write_tlog(truth, ORIGIN, 11.0, ordinary(seed), seed)[0] for seed in (3, 3, 4))
    assert first == again
    assert first != other
    assert ordinary(3) == ordinary(3) and ordinary(3) != ordinary(4)


def test_the_command_line_flies_either(tmp_path: Path) -> None:
    for words, expected in (
        ("", TelemetrySpec()),
        ("--autopilot declared", TelemetrySpec()),
        ("--autopilot ordinary", ordinary(7)),
        ("--autopilot ordinary --attitude-hz 50", replace(ordinary(7), attitude_hz=50.0)),
    ):
        spec, _ = session_spec(f"--path turns --seed 7 {words} --out {tmp_path}".split())
        assert isinstance(spec.flight, DescribedSpec)
        assert spec.flight.telemetry == expected
