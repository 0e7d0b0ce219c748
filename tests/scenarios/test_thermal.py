"""A thermal camera's flight: bland ground, a strong fixed pattern, a shutter event; places as honest as any others."""

from __future__ import annotations

import pytest

from contract.camera import Camera
from contract.feature_set import Status
from simulation.flight import DescribedSpec
from simulation.paths import PathSpec
from simulation.session import SessionSpec
from simulation.terrain import TerrainSpec
from simulation.texture import TextureSpec
from simulation.thermal import ThermalSpec
from tests.scenarios.flights import play, simulated

pytestmark = pytest.mark.long
RATE_HZ, SECONDS, CLOSED_S, FROZEN_S = 8.0, 14.0, 7.0, 0.4
SPEC = SessionSpec(
    DescribedSpec(PathSpec("turns", height_m=100.0, speed_m_s=12.0, leg_m=150.0), seed=5),
    seconds=SECONDS,
    rate_hz=RATE_HZ,
    camera=Camera.from_field_of_view(160, 120, 57.0),
    terrain=TerrainSpec(relief_m=6.0),
    texture=TextureSpec(seed=5),
    thermal=ThermalSpec(pattern_k=0.3, shutter_s=(CLOSED_S,), freeze_s=FROZEN_S),
)


def test_a_lepton_flies_through_its_fixed_pattern_and_a_shutter_event() -> None:
    outcome = play(simulated(SPEC))
    frozen = {frame for frame, s in outcome.sets.items() if s.status is Status.BAD_PICTURE}
    closed = {k for k in range(round(SECONDS * RATE_HZ)) if CLOSED_S <= k / RATE_HZ < CLOSED_S + FROZEN_S}
    assert frozen == closed, outcome.reported
    after = [s.is_ok for frame, s in outcome.sets.items() if frame >= (CLOSED_S + FROZEN_S + 2.0) * RATE_HZ]
    assert sum(after) >= 0.9 * len(after), outcome.reported  # goes on within two seconds of the jump
    assert 0.8 < outcome.solved < 0.98 and outcome.inside_99 >= 0.97, outcome.reported
    assert outcome.statuses[Status.FEATURELESS] <= 3, outcome.reported


def test_without_the_counts_the_same_flight_is_lost_in_the_pattern() -> None:
    outcome = play(simulated(SPEC), ("thermal.enabled", False))
    assert outcome.solved < 0.6, outcome.reported
