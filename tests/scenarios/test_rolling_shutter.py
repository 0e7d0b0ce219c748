"""Flights whose rows are read one after the other, told so or not, drawn and rendered."""

import numpy as np
import pytest

from benchmarks.ablation_scenes import ROLLING, TURNS, VibratingFlight
from benchmarks.rolling_shutter import GLOBAL, STATED, WRONG_FILE, Result, simulated_of, spec_of
from benchmarks.rolling_shutter import judge as judge_drawn
from benchmarks.sampled_flight import SampledFlight, SampledSpec, fly
from contract.feature_set import FeatureSet
from onboard.estimation import moved_optics
from simulation.flight import DescribedSpec
from simulation.paths import PathSpec
from simulation.renderer import SensorSpec
from simulation.session import SessionSpec
from simulation.telemetry import TelemetrySpec
from tests.sampled_clicks import chi2_of, located
from tests.scenarios.flights import CAMERA, CHI2_90, play
from tests.scenarios.flights import simulated as simulated_session

AFTER_S = 14.0
CHI2_99 = -2.0 * np.log(0.01)
RENDERED = SessionSpec(
    DescribedSpec(
        PathSpec("turns", speed_m_s=20.0, height_m=120.0, bank_deg=35.5, leg_m=60.0),
        TelemetrySpec(velocity_m_s=0.05, white_attitude_deg=0.05, slow_attitude_deg=0.3, attitude_hz=25.0),
        seed=2,
    ),
    seconds=11.0,
    rate_hz=3.0,
    camera=CAMERA,
    sensor=SensorSpec(exposure_s=0.0),
    readout_s=0.06,
    clicks_per_frame=8,
    seed=2,
)


def simulated(stated: dict[str, float]) -> tuple[list[float], list[float], tuple[float, float], list[FeatureSet]]:
    """Errors (m) and chi-squares of clicks in the outer rows, what was found of the readout, and the sets."""
    flight = SampledFlight(spec_of(stated, 26.0, 150.0), 1)
    sets, pipeline = fly(flight)
    rng = np.random.default_rng(5)
    errors_m, chi2 = [], []
    for k, s in sets.items():
        if flight.times_s[k] < AFTER_S or not s.is_ok:
            continue
        uv = np.column_stack([rng.uniform(20.0, 620.0, 4), rng.choice([20.0, 60.0, 420.0, 460.0], 4)])
        for error, answer in located(flight, s, uv):
            errors_m.append(float(np.hypot(*error)))
            chi2.append(chi2_of(error, answer))
    return errors_m, chi2, pipeline.window.readout, list(sets.values())


@pytest.mark.long  # the short one is of rendered rows
def test_an_undeclared_readout_is_found_and_clicks_in_outer_rows_are_right() -> None:
    found, chi2, (readout_s, sigma_s), sets = simulated(STATED["0 to 20 ms"])
    assert len(found) > 60
    assert abs(readout_s - 0.03) < 3.0 * sigma_s
    assert sigma_s < 0.003
    known, *_ = simulated(STATED["right"])
    assert np.median(found) < 1.05 * np.median(known) < 8.0
    assert np.mean(np.array(chi2) < CHI2_99) > 0.98  # one flight is one draw of what all its clicks share
    published = [s.shutter for s in sets if s.is_ok]
    assert all(shutter is not None for shutter in published)


@pytest.mark.long
@pytest.mark.parametrize("name", [GLOBAL, WRONG_FILE])
def test_short_flights_in_turns_err_as_much_as_they_claim(name: str) -> None:
    """By a draw that the autopilot's own consistency check refused, claims were five times too wide in squares."""
    result = Result()
    for seed in range(21, 24):
        judge_drawn(simulated_of(name, seed, 13.0, 150.0), seed, result, after_s=9.0)
    shares, flights = result.inside[0], [np.mean(chi2) / 2.0 for chi2 in result.chi2 if chi2]
    assert len(flights) == 3
    assert 0.35 < np.mean(flights) < 2.0
    assert shares > 0.6


def test_a_global_shutter_publishes_no_rows() -> None:
    flight = SampledFlight(spec_of({}, 5.0, 150.0), 1)
    sets, _ = fly(flight)
    assert any(s.is_ok for s in sets.values())
    assert all(s.shutter is None for s in sets.values())


@pytest.mark.long  # short: a recorded turn whose rows are read in turn
def test_rendered_rows_are_tracked_and_answered_as_truth_says() -> None:
    """Pictures rendered row by row, twice as slow as is usual, through the real tracker in turns of 20 degrees/s."""
    session = simulated_session(RENDERED)
    found = play(session, ("camera.readout_s", 0.045), ("camera.sigma_readout_s", 0.02))
    assert found.solved > 0.8 and len(found.errors_m) > 150, found.reported
    assert np.mean(found.chi2 < CHI2_90) > 0.85, found.reported
    assert np.median(found.errors_m) < 4.0
    readout_s, sigma_s = found.pipeline.window.readout
    assert sigma_s < 0.01 and abs(readout_s - RENDERED.readout_s) < 3.0 * sigma_s


@pytest.mark.long
def test_a_vibration_is_no_reason_to_look_for_optics_that_moved(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows that swing part pictures as a zoom may: for it 19 of 28 windows were adjusted, before waves came first."""
    flight = VibratingFlight(SampledSpec(ROLLING, seconds=16.0, rate_hz=2.0, path=TURNS, readout_s=0.03), 3)
    looked_for: list[int] = []
    plain = moved_optics.open_optics
    monkeypatch.setattr(moved_optics, "open_optics", lambda weighed: looked_for.append(1) or plain(weighed))
    sets, pipeline = fly(flight)
    assert pipeline.summary.keyframes > 20
    assert sum(s.is_ok for s in sets.values()) > 0.9 * len(sets)
    assert sum(looked_for) < 0.1 * pipeline.summary.keyframes
