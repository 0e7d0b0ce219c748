"""After a spin in hover over textured ground: no depth for want of motion, which is not a want of features."""

import numpy as np
import pytest

from benchmarks.sampled_flight import SampledFlight, SampledSpec, fly
from contract.feature_set import Status
from contract.rotations import R_ENU_NED, matrix_from_euler
from onboard.config.schema import parse_config
from simulation.paths import PathSpec
from simulation.trajectory import Trajectory

STOP_S, SPIN_S, STILL_S, END_S = 12.0, 15.0, 24.0, 38.0


def stop_and_spin(spec: PathSpec, seconds: float, seed: int) -> Trajectory:
    """North at 10 m/s, a stop, a turn and a half on the spot within nine seconds, and hover."""
    time = np.arange(-6.0, seconds + 6.0, 0.1)
    north = 10.0 * np.where(time < STOP_S, time, STOP_S + 1.0 - np.exp(-np.maximum(time - STOP_S, 0.0)))
    yaw = 3.0 * np.pi * np.clip((time - SPIN_S) / (STILL_S - SPIN_S), 0.0, 1.0)
    sway = 0.01 * np.sin(0.8 * time)
    R = R_ENU_NED @ matrix_from_euler(sway, 0.7 * sway, yaw)
    return Trajectory(time, np.column_stack([0.3 * np.sin(0.4 * time), north, np.full(len(time), 100.0)]), R)


@pytest.mark.long
def test_hover_after_a_spin_is_low_parallax(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmarks.sampled_flight.fly_path", stop_and_spin)
    spec = SampledSpec(
        parse_config("[mount]\npitch_deg = -45.0\n[gps]\nsigma_latency_s = 0.01"), seconds=END_S, rate_hz=3.0
    )
    sets, _ = fly(SampledFlight(spec, 4))
    statuses = {k / spec.rate_hz: sets[k].status for k in sorted(sets)}
    assert np.mean([s is Status.OK for t, s in statuses.items() if 6.0 < t < STOP_S]) > 0.9
    after = [s for t, s in statuses.items() if t > STILL_S + 0.5]
    # A picture or two may be taken for a wrong lock, by ground known only where it was seen before the spin.
    assert np.mean([s is Status.FEATURELESS for s in after]) < 0.1, statuses
    later = [s for t, s in statuses.items() if t > STILL_S + 4.0]
    assert np.mean([s is Status.LOW_PARALLAX for s in later]) > 0.8, statuses
