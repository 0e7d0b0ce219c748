"""Ground that is hard or impossible to track: answered with an ellipse that holds, or refused with the right reason."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest

from contract.camera import Camera
from contract.feature_set import Status
from onboard.vision.contrast_normalisation import Picture
from simulation.flight import DescribedSpec
from simulation.paths import PathSpec
from simulation.renderer import SensorSpec
from simulation.session import SessionSpec
from simulation.terrain import TerrainSpec
from simulation.texture import TextureSpec
from tests.rest_long import rest_long
from tests.scenarios.flights import CAMERA, Outcome, play, retouched, simulated

LEG = SessionSpec(DescribedSpec(PathSpec("straight")), seconds=8.0, rate_hz=3.0, camera=CAMERA, clicks_per_frame=6)
LARGE = replace(LEG, camera=Camera.from_field_of_view(640, 480, 40.0), rate_hz=5.0, seconds=7.0)
LOW = DescribedSpec(PathSpec("straight", height_m=100.0, speed_m_s=12.0))
FAST = DescribedSpec(PathSpec("straight", speed_m_s=35.0))


def holds(outcome: Outcome, solved: float = 0.9, max_median_m: float = 8.0) -> None:
    """Answered, nearly everywhere, near enough, and inside what was claimed."""
    assert outcome.solved >= solved, outcome.reported
    assert outcome.inside_99 >= 0.97, outcome.reported
    assert np.median(outcome.errors_m) < max_median_m, outcome.reported
    assert 0.5 < np.median(outcome.semi_m) < 40.0, outcome.reported


def refuses(outcome: Outcome, *reasons: Status) -> None:
    """No click is answered, and the reasons are these; the first pictures may still be starting."""
    assert not len(outcome.errors_m), outcome.reported
    assert set(outcome.statuses) <= {*reasons, Status.STARTING}, outcome.reported
    assert outcome.statuses[Status.STARTING] < 0.5 * len(outcome.sets), outcome.reported


def honest(outcome: Outcome, *reasons: Status) -> None:
    """Either of both: what is answered holds, what is refused has one of these reasons."""
    assert outcome.is_honest(), outcome.reported
    assert set(outcome.statuses) <= {*reasons, Status.STARTING, Status.OK}, outcome.reported


def test_a_planar_scene_is_solved() -> None:
    """Straight leg, level ground: every point in one plane. OK."""
    holds(play(simulated(LEG)))


@pytest.mark.long  # short, hills of 20 m and of 10: tests/test_end_to_end.py
def test_relief_is_solved() -> None:
    """Hills of 40 m under a leg at 250 m: not a plane. OK."""
    holds(play(simulated(replace(LEG, terrain=TerrainSpec(relief_m=40.0)))))


def test_featureless_ground_is_refused() -> None:
    """A plain without texture: featureless."""
    refuses(play(simulated(replace(LEG, texture=TextureSpec("plain")))), Status.FEATURELESS)


@pytest.mark.parametrize("seed", rest_long([0, 7]))
def test_water_in_small_pictures_is_refused_or_its_ellipse_holds(seed: int) -> None:
    """Waves that move: nothing fixed to track. Featureless, poor fit or a wide ellipse."""
    outcome = play(simulated(replace(LEG, texture=TextureSpec("water", seed=seed), seed=seed)))
    honest(outcome, Status.FEATURELESS, Status.POOR_FIT, Status.LOW_PARALLAX)


@pytest.mark.parametrize(
    ("flight", "least_m", "style"),
    [
        pytest.param(LOW, 7.0, "water", id="100m-water"),
        pytest.param(LOW, 7.0, "sea", id="100m-sea", marks=pytest.mark.long),
        pytest.param(LARGE.flight, 16.0, "water", id="250m-water", marks=pytest.mark.long),
        pytest.param(LARGE.flight, 16.0, "sea", id="250m-sea", marks=pytest.mark.long),
    ],
)
def test_water_that_can_be_tracked_is_a_poor_fit_or_wide(style: str, flight: DescribedSpec, least_m: float) -> None:
    """Waves that persist from picture to picture, moving as a whole at 2 to 3 m/s. Refused, or wide.

    Nothing but the disagreement of coarse and fine flow shows it: taken for land, up to four fifths of the clicks are
    outside their 99 % ellipse.
    """
    outcome = play(simulated(replace(LARGE, flight=flight, texture=TextureSpec(style))))
    honest(outcome, Status.POOR_FIT, Status.FEATURELESS)
    assert outcome.statuses[Status.POOR_FIT] + outcome.statuses[Status.FEATURELESS] > 0, outcome.reported
    assert not len(outcome.semi_m) or np.median(outcome.semi_m) > least_m, outcome.reported


@pytest.mark.long
def test_water_under_a_fast_aircraft_is_wide() -> None:
    """At 35 m/s the waves' own motion is a tenth of what is seen: OK, with twice the radius of land."""
    spec = replace(LARGE, flight=FAST, texture=TextureSpec("sea"))
    wide, land = play(simulated(spec)), play(simulated(replace(spec, texture=TextureSpec())))
    holds(land)
    honest(wide, Status.POOR_FIT, Status.FEATURELESS)
    assert len(wide.errors_m) > 0, wide.reported
    assert np.median(wide.semi_m) > 1.5 * np.median(land.semi_m), (wide.reported, land.reported)


@pytest.mark.parametrize(
    "spec", [pytest.param(LEG, id="small"), pytest.param(LARGE, id="large", marks=pytest.mark.long)]
)
def test_stripes_are_distinguished_by_telemetry(spec: SessionSpec) -> None:
    """Rows that repeat exactly every 8 m, 4 to 7 m between pictures. OK: telemetry is better than half a row."""
    holds(play(simulated(replace(spec, texture=TextureSpec("stripes")))))


@pytest.mark.parametrize("rate_hz", rest_long([1.0, 3.0]))
def test_stripes_without_attitude_are_called_what_they_are(rate_hz: float) -> None:
    """Nothing says by how many rows the picture moved (answered, it was 140 to 340 m off): repetitive."""
    spec = replace(LARGE, rate_hz=rate_hz, texture=TextureSpec("stripes"))
    refuses(play(simulated(spec), ("solve.attitude", "none"), ("solve.level_ground", True)), Status.REPETITIVE)


@pytest.mark.long  # short: a picture a second without attitude, above
def test_stripes_far_apart_in_time_are_called_what_they_are() -> None:
    """Two and a half rows between pictures, more than telemetry predicts to half a row: repetitive."""
    spec = replace(LARGE, rate_hz=1.0, seconds=12.0, texture=TextureSpec("stripes"))
    refuses(play(simulated(spec)), Status.REPETITIVE)


@pytest.mark.long
def test_few_vehicles_cost_nothing() -> None:
    """Lorries on three hundredths of the ground: OK, with the radius of an empty road."""
    empty = play(simulated(LARGE))
    few = play(simulated(replace(LARGE, texture=TextureSpec("traffic", vehicle_spacing_m=128))))
    holds(empty)
    holds(few)
    assert np.median(few.semi_m) < 1.2 * np.median(empty.semi_m), (few.reported, empty.reported)


@pytest.mark.parametrize("seed", rest_long([0, 7]))
def test_a_convoy_is_not_taken_for_the_ground(seed: int) -> None:
    """Lorries on a fifth of the ground, with nearly all of the tracks: the scene moves with them. Poor fit."""
    convoy = TextureSpec("traffic", seed=seed, vehicle_spacing_m=16)
    refuses(play(simulated(replace(LARGE, seed=seed, texture=convoy))), Status.POOR_FIT)


def test_vehicles_do_not_pull_the_ground_along() -> None:
    """Lorries at 42 km/h on a twentieth of the ground, and on a quarter of the tracks. OK: they are outliers."""
    holds(play(simulated(replace(LEG, texture=TextureSpec("traffic")))))


@pytest.mark.long  # short: none is refused, above, and a third is answered, below
def test_low_contrast_is_solved_or_featureless() -> None:
    """Brightness differences of a tenth under sensor noise: featureless, or an answer that holds."""
    honest(play(simulated(replace(LEG, texture=TextureSpec(contrast=0.1)))), Status.FEATURELESS, Status.POOR_FIT)


def test_half_the_contrast_is_enough() -> None:
    """Brightness differences of a third: OK."""
    holds(play(simulated(replace(LEG, texture=TextureSpec(contrast=0.35)))))


def test_an_exposure_that_hunts_is_solved() -> None:
    """Brightness swings by 3.5 between pictures: OK."""
    holds(play(simulated(replace(LEG, sensor=SensorSpec(exposure_swing=3.5)))))


@pytest.mark.long
@pytest.mark.parametrize("exposure_s", [0.08, 0.03])
def test_motion_blur_is_solved(exposure_s: float) -> None:
    """Shutter open for 0.6 m and 1.6 m of ground: one and three pixels. OK. By more: test_degraded_pictures."""
    holds(play(simulated(replace(LEG, sensor=SensorSpec(exposure_s=exposure_s)))))


def defocused(image: Picture) -> Picture:
    """A lens that is far out of focus: 8 px at 320."""
    return np.asarray(cv2.GaussianBlur(image, (0, 0), 8.0), np.uint8)


@pytest.mark.long  # short: "defocused" below, and a blur of 12 from the start in test_degraded_pictures.py
def test_pictures_out_of_focus_are_refused_or_their_ellipse_holds() -> None:
    """Blurred from the first picture to the last: featureless, or an answer that holds."""
    outcome = play(retouched(simulated(LEG), defocused))
    honest(outcome, Status.FEATURELESS, Status.POOR_FIT, Status.LOW_PARALLAX)


@pytest.mark.parametrize(
    "blinded",
    [np.zeros_like, lambda image: np.full_like(image, 255), defocused],
    ids=["black", "white", "defocused"],
)
def test_blind_pictures_are_featureless_and_pass(blinded: Callable[[Picture], Picture]) -> None:
    """Two seconds without a usable picture in the middle: featureless, then OK again."""
    outcome = play(retouched(simulated(LEG), blinded, range(9, 15)))
    assert outcome.inside_99 >= 0.97, outcome.reported
    statuses = [outcome.sets[frame].status for frame in range(24)]
    if blinded is not defocused:
        assert statuses[9:15] == [Status.FEATURELESS] * 6, outcome.reported
    assert set(statuses) <= {Status.FEATURELESS, Status.STARTING, Status.OK}, outcome.reported
    assert statuses[:9] == [Status.OK] * 9, outcome.reported
    assert statuses[19:] == [Status.OK] * 5, outcome.reported
