"""Motion that shows no depth, mounts that look aside, telemetry that is thin, late or lost."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from contract.feature_set import Status
from contract.geodesy import LocalFrame
from onboard.estimation.sliding_window import Window
from onboard.events.types import Event, GpsQuality
from onboard.geometry.terrain_grid import Terrain
from simulation.flight import DescribedSpec
from simulation.paths import PathSpec
from simulation.session import SessionSpec
from simulation.telemetry import TelemetrySpec
from simulation.texture import TextureSpec
from tests.rest_long import rest_long
from tests.scenarios.flights import CAMERA, play, simulated
from tests.scenarios.test_degenerate_ground import LARGE, LEG, holds, refuses

HOVER = replace(LEG, flight=DescribedSpec(PathSpec("hover", height_m=100.0)), rate_hz=2.0, seconds=9.0)
# Yaw at 0.2 rad/s within a circle of one metre.
ROTATION = replace(HOVER, flight=DescribedSpec(PathSpec("orbit", height_m=100.0, speed_m_s=0.1, radius_m=0.5)))


class LevelTerrain:
    """An elevation model that is right: level at the simulated ground's height."""

    def __init__(self, height_amsl_m: float = 100.0) -> None:
        self.height_amsl_m = height_amsl_m

    def around(
        self, frame: LocalFrame, centre_enu_m: np.ndarray, radius_m: float, spacing_m: float, undulation_m: float
    ) -> Terrain:
        n = 2 * int(radius_m / spacing_m) + 1
        west, south = centre_enu_m[:2] - radius_m
        return Terrain(west, south, spacing_m, np.full((n, n), self.height_amsl_m - frame.height_m))


@pytest.mark.parametrize("spec", [HOVER, ROTATION], ids=["hover", "rotation"])
def test_standing_still_has_no_parallax(spec: SessionSpec) -> None:
    """Hover, and yaw on the spot: low parallax."""
    refuses(play(simulated(spec)), Status.LOW_PARALLAX)


def test_a_hover_is_low_parallax_and_stays_so() -> None:
    """Low, where wind and receiver move the position by a tenth of the height: it was `starting` again and again."""
    low = replace(HOVER, flight=DescribedSpec(PathSpec("hover", height_m=20.0)), seconds=14.0)
    outcome = play(simulated(low))
    statuses = [outcome.sets[k].status for k in sorted(outcome.sets)]
    begin = statuses.index(Status.LOW_PARALLAX)
    assert begin <= 10, outcome.reported
    assert set(statuses[:begin]) == {Status.STARTING} and set(statuses[begin:]) == {Status.LOW_PARALLAX}, statuses


def test_pictures_after_a_window_without_parallax_have_its_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    """Between keyframes too, however far telemetry says that it has moved."""
    monkeypatch.setattr(Window, "adopt", lambda window, outcome, clock: Status.LOW_PARALLAX)
    outcome = play(simulated(LEG))
    statuses = [outcome.sets[k].status for k in sorted(outcome.sets)]
    assert Status.STARTING not in statuses[statuses.index(Status.LOW_PARALLAX) :], statuses
    assert statuses.count(Status.LOW_PARALLAX) > 0.7 * len(statuses), statuses


@pytest.mark.long  # short: HOVER above, and water that can be tracked of tests/scenarios/test_degenerate_ground.py
@pytest.mark.parametrize("style", ["water", "sea"])
def test_waves_under_a_hover_are_no_parallax(style: str) -> None:
    """What moves in the pictures is the ground, not the aircraft: never a depth.

    Refused as featureless where waves are off each other, and starting again in between.
    """
    spec = replace(LARGE, flight=HOVER.flight, texture=TextureSpec(style))
    outcome = play(simulated(spec))
    assert not len(outcome.errors_m), outcome.reported
    reasons = {Status.LOW_PARALLAX, Status.POOR_FIT, Status.FEATURELESS}
    assert set(outcome.statuses) <= {*reasons, Status.STARTING}, outcome.reported
    assert outcome.statuses[Status.STARTING] < 0.6 * len(outcome.sets), outcome.reported


@pytest.mark.parametrize(
    "spec", [pytest.param(HOVER, id="hover"), pytest.param(ROTATION, id="rotation", marks=pytest.mark.long)]
)
def test_standing_still_over_known_terrain_is_answered(spec: SessionSpec) -> None:
    """The same with an elevation model: OK by method terrain, but for the picture's rim outside the outermost rays.

    While it turns, features move, but a window has no parallax of its own: terrain gives its depths and not its tilt.
    """
    outcome = play(simulated(spec), terrain=LevelTerrain())
    holds(outcome, max_median_m=5.0)
    assert outcome.methods["terrain"] > 0.7 * outcome.methods.total()


def test_standing_still_over_level_ground_is_answered_where_allowed() -> None:
    """The same over home's level: OK by method plane if the configuration allows, with the radius it deserves."""
    outcome = play(simulated(HOVER), ("solve.home_level", True))
    holds(outcome, max_median_m=5.0)
    assert set(outcome.methods) == {"plane"}
    terrain = play(simulated(HOVER), terrain=LevelTerrain())
    assert np.median(outcome.semi_m) > np.median(terrain.semi_m)


@pytest.mark.long  # short, with a little shake: a planar scene of tests/scenarios/test_degenerate_ground.py
def test_an_exactly_straight_path_is_solved() -> None:
    """Collinear centres, no shake: rotation about the path is seen by attitude and level ground alone. OK."""
    calm = PathSpec("straight", wobble_deg=0.0)
    holds(play(simulated(replace(LEG, flight=DescribedSpec(calm)))))


MOUNTS_DEG = ((0.0, -45.0, 0.0), (0.0, -60.0, 90.0), (0.0, -60.0, 0.0), (0.0, -90.0, 90.0), (0.0, -90.0, 180.0))


@pytest.mark.parametrize("mount_deg", rest_long([(mount,) for mount in MOUNTS_DEG]))
def test_a_mount_may_point_any_way(mount_deg: tuple[float, float, float]) -> None:
    """Oblique and turned mounts: OK."""
    holds(play(simulated(replace(LEG, mount_deg=mount_deg, clicks_per_frame=8))), max_median_m=12.0)


def test_telemetry_at_two_hertz_is_enough() -> None:
    """Position, receiver and attitude twice a second: OK."""
    thin = TelemetrySpec(position_hz=2.0, gps_hz=2.0, attitude_hz=2.0)
    holds(play(simulated(replace(LEG, flight=DescribedSpec(PathSpec("straight"), thin)))), solved=0.8)


def test_a_log_without_attitude_is_solved_by_the_seeds_sensors() -> None:
    """No attitude message at all: OK from travel, level ground and pictures, with a wider radius."""
    silent = replace(LEG, flight=DescribedSpec(PathSpec("straight"), TelemetrySpec(attitude_hz=0.0)))
    level = ("solve.level_ground", True)
    outcome = play(simulated(silent), level)
    holds(outcome, solved=0.7, max_median_m=15.0)
    assert np.median(outcome.semi_m) > np.median(play(simulated(LEG), level).semi_m)


def test_a_log_without_attitude_over_ground_of_unknown_slope_is_solved_and_too_wide_to_answer() -> None:
    """As before, but the ground may slope: nothing shows roll. The pictures have sets, whose ellipses are too long."""
    silent = replace(LEG, flight=DescribedSpec(PathSpec("straight"), TelemetrySpec(attitude_hz=0.0)))
    outcome = play(simulated(silent))
    assert outcome.solved > 0.7, outcome.reported
    assert outcome.is_honest(), outcome.reported
    assert outcome.refusals[Status.UNCERTAIN] > 0.9 * (len(outcome.chi2) + outcome.refusals.total()), outcome.reported


@pytest.mark.long  # short: a delay is covered by the ellipse, tests/test_platform_errors.py
def test_late_stamps_widen_but_hold() -> None:
    """Stamps 0.3 s late on a straight leg, where a delay is a shift along the path. OK inside three of its sigmas."""
    late = replace(LEG, camera_delay_s=0.3)
    holds(play(simulated(late), ("camera.sigma_latency_s", 0.3)), max_median_m=10.0)


def test_an_outage_of_gps_is_refused_and_recovers_by_itself() -> None:
    """The receiver loses its fix for three seconds in the middle: no GPS, then OK again."""
    folder = simulated(replace(LEG, seconds=16.0, rate_hz=2.0))

    def lose(event: Event, since_s: float) -> Event:
        return replace(event, fix_type=1) if isinstance(event, GpsQuality) and 5.0 < since_s < 8.0 else event

    outcome = play(folder, spoil=lose)
    statuses = [outcome.sets[k].status for k in sorted(outcome.sets)]
    assert statuses[12:16] == [Status.NO_GPS] * 4, outcome.reported
    assert statuses[-6:] == [Status.OK] * 6, outcome.reported
    assert statuses[:9] == [Status.OK] * 9, outcome.reported
    assert outcome.inside_99 >= 0.97, outcome.reported


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
    assert outcome.pipeline is not None
    platform = outcome.pipeline.window.alignment.platform
    boresight = np.degrees(platform.mean[:3]) - [3.0, -1.0, 1.5]
    assert np.abs(boresight).max() < 0.3 + 3.0 * np.degrees(platform.sigma[2]), (boresight, np.degrees(platform.sigma))
    assert np.abs(boresight[:2]).max() < 0.3, boresight
    assert abs(platform.mean[3] + 0.3) < 0.03, platform.mean[3]
    assert outcome.inside_99 >= 0.95, outcome.reported
