"""Ground that is hard or impossible to track: answered with an ellipse that holds, or refused with the right reason."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from contract.feature_set import Status
from simulation.flight import DescribedSpec
from simulation.paths import PathSpec
from simulation.renderer import SensorSpec
from simulation.session import SessionSpec
from simulation.terrain import TerrainSpec
from simulation.texture import TextureSpec
from tests.scenarios.flights import CAMERA, Outcome, flown, play

LEG = SessionSpec(DescribedSpec(PathSpec("straight")), seconds=8.0, rate_hz=3.0, camera=CAMERA)


def holds(outcome: Outcome, solved: float = 0.9, max_median_m: float = 8.0) -> None:
    """Answered, nearly everywhere, near enough, and inside what was claimed."""
    assert outcome.solved >= solved, outcome.told
    assert outcome.inside_99 >= 0.97, outcome.told
    assert np.median(outcome.errors_m) < max_median_m, outcome.told
    assert 0.5 < np.median(outcome.semi_m) < 40.0, outcome.told


def refuses(outcome: Outcome, *reasons: Status) -> None:
    """No click is answered, and the reasons are these; the first pictures may still be starting."""
    assert not len(outcome.errors_m), outcome.told
    assert set(outcome.statuses) <= {*reasons, Status.STARTING}, outcome.told
    assert outcome.statuses[Status.STARTING] < 0.5 * len(outcome.sets), outcome.told


def honest(outcome: Outcome, *reasons: Status) -> None:
    """Either of both: what is answered holds, what is refused has one of these reasons."""
    assert outcome.inside_99 >= 0.97, outcome.told
    assert set(outcome.statuses) <= {*reasons, Status.STARTING, Status.OK}, outcome.told


def test_a_planar_scene_is_solved() -> None:
    """Straight leg, level ground: every point in one plane. OK."""
    holds(play(flown(LEG)))


def test_relief_is_solved() -> None:
    """Hills of 40 m under a leg at 250 m: not a plane. OK."""
    holds(play(flown(replace(LEG, terrain=TerrainSpec(relief_m=40.0)))))


def test_featureless_ground_is_refused() -> None:
    """A plain without texture: featureless."""
    refuses(play(flown(replace(LEG, texture=TextureSpec("plain")))), Status.FEATURELESS)


def test_water_is_refused_or_its_ellipse_holds() -> None:
    """Waves that move: nothing fixed to track. Featureless, poor fit or a wide ellipse."""
    for seed in (0, 7):
        outcome = play(flown(replace(LEG, texture=TextureSpec("water", seed=seed), seed=seed)))
        honest(outcome, Status.FEATURELESS, Status.POOR_FIT, Status.LOW_PARALLAX)


def test_stripes_are_refused_or_their_ellipse_holds() -> None:
    """Rows that repeat exactly every few metres: a lock may slip by one. Answered rightly or refused."""
    outcome = play(flown(replace(LEG, texture=TextureSpec("stripes"))))
    honest(outcome, Status.FEATURELESS, Status.POOR_FIT, Status.LOW_PARALLAX)


def test_vehicles_do_not_pull_the_ground_along() -> None:
    """Lorries at 42 km/h on a twentieth of the ground, and on a quarter of the tracks. OK: they are outliers."""
    holds(play(flown(replace(LEG, texture=TextureSpec("traffic")))))


def test_low_contrast_is_solved_or_featureless() -> None:
    """Brightness differences of a tenth under sensor noise: featureless, or an answer that holds."""
    honest(play(flown(replace(LEG, texture=TextureSpec(contrast=0.1)))), Status.FEATURELESS, Status.POOR_FIT)


def test_half_the_contrast_is_enough() -> None:
    """Brightness differences of a third: OK."""
    holds(play(flown(replace(LEG, texture=TextureSpec(contrast=0.35)))))


def test_an_exposure_that_hunts_is_solved() -> None:
    """Brightness swings by 3.5 between pictures: OK."""
    holds(play(flown(replace(LEG, sensor=SensorSpec(exposure_swing=3.5)))))


@pytest.mark.parametrize("exposure_s", [0.03, 0.08])
def test_motion_blur_is_solved(exposure_s: float) -> None:
    """Shutter open for 0.6 m and 1.6 m of ground: one and three pixels. OK."""
    holds(play(flown(replace(LEG, sensor=SensorSpec(exposure_s=exposure_s)))))
