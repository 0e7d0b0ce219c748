"""What no row of test_scenarios.py can express: windows without parallax, and what turns show of the mount."""

import numpy as np
import pytest

from contract.feature_set import Status
from onboard.estimation.sliding_window import Window
from simulation.flight import DescribedSpec
from simulation.paths import PathSpec
from simulation.session import SessionSpec
from simulation.telemetry import TelemetrySpec
from tests.scenarios.flights import CAMERA, play, simulated
from tests.scenarios.sessions import LEG


def test_pictures_after_a_window_without_parallax_have_its_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    """Between keyframes too, however far telemetry says that it has moved."""
    monkeypatch.setattr(Window, "adopt", lambda window, outcome, clock: Status.LOW_PARALLAX)
    outcome = play(simulated(LEG))
    statuses = [outcome.sets[k].status for k in sorted(outcome.sets)]
    assert Status.STARTING not in statuses[statuses.index(Status.LOW_PARALLAX) :], statuses
    assert statuses.count(Status.LOW_PARALLAX) > 0.7 * len(statuses), statuses


@pytest.mark.long
def test_boresight_and_time_offset_are_learned_in_turns() -> None:
    """Mount 3 degrees off and stamps 0.3 s late, undeclared: found to 0.3 degrees and 0.03 s. OK throughout."""
    good = TelemetrySpec(slow_attitude_deg=0.2, slow_horizontal_m=0.8)
    turns = PathSpec("turns", leg_m=120.0, speed_m_s=20.0)
    spec = SessionSpec(
        DescribedSpec(turns, good), seconds=70.0, rate_hz=2.5, camera=CAMERA, boresight_deg=(3.0, -1.0, 1.5),
        camera_delay_s=0.3, clicks_per_frame=3,
    )  # fmt: skip
    outcome = play(simulated(spec), ("mount.sigma_deg", 3.0), ("camera.sigma_latency_s", 0.3))
    platform = outcome.pipeline.window.alignment.platform
    boresight = np.degrees(platform.mean[:3]) - [3.0, -1.0, 1.5]
    assert np.abs(boresight).max() < 0.3 + 3.0 * np.degrees(platform.sigma[2]), (boresight, np.degrees(platform.sigma))
    assert np.abs(boresight[:2]).max() < 0.3, boresight
    assert abs(platform.mean[3] + 0.3) < 0.03, platform.mean[3]
    assert outcome.inside_99 >= 0.95, outcome.reported
