"""Heights that count from no one knows where, as a barometer's in a camera's subtitles: all too low by 130 m."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.sampled_flight import PLACE, SampledFlight, SampledSpec, fly
from contract.answer import Fix
from contract.locate import Locator
from onboard.config.schema import parse_config
from onboard.events.types import Event, GpsQuality, PositionFix
from simulation.paths import PathSpec

DATUM_M, SIGMA_M = -130.0, 100.0
SPEC = SampledSpec(parse_config(""), PathSpec("turns", leg_m=250.0), seconds=30.0, rate_hz=2.0)
CLICKS = np.array([[160.0, 120.0], [320.0, 240.0], [480.0, 360.0]])


class LowFlight(SampledFlight):
    """Its log states heights `DATUM_M` off, and by how much they may be off as a whole."""

    def __init__(self, spec: SampledSpec, seed: int, sigma_m: float | None = SIGMA_M) -> None:
        super().__init__(spec, seed)
        self._sigma_m = sigma_m

    def events(self) -> Iterator[Event]:
        for event in super().events():
            if isinstance(event, PositionFix):
                yield replace(event, height_amsl_m=event.height_amsl_m + DATUM_M)
                yield GpsQuality(event.stamp_ns, 3, undulation_m=0.0, sigma_datum_m=self._sigma_m)
            elif not isinstance(event, GpsQuality):
                yield event


def clicked(flight: SampledFlight) -> tuple[float, np.ndarray, np.ndarray, np.ndarray]:
    """Share answered; horizontal squared errors in sigmas, height errors (m) and their sigmas."""
    sets, _ = fly(flight)
    rows, asked = [], 0
    for frame, found in sets.items():
        truth = flight.ground_points(frame, CLICKS)
        for at, place in zip(CLICKS, truth, strict=True):
            asked += 1
            answer = Locator(found).locate(at)
            if isinstance(answer, Fix):
                assert answer.height_amsl_m is not None
                error = PLACE.to_enu(answer.lat_deg, answer.lon_deg, answer.height_amsl_m) - place
                chi2 = error[:2] @ np.linalg.solve(answer.covariance_enu_m2[:2, :2], error[:2])
                rows.append((float(chi2), float(error[2]), answer.sigma_height_m))
    chi2s, heights_m, sigmas_m = np.array(rows).T
    return len(rows) / asked, chi2s, heights_m, sigmas_m


@pytest.mark.long
@pytest.mark.parametrize("seed", [2, 5])
def test_clicks_are_as_good_on_the_map_and_their_heights_say_how_far_off_they_may_be(seed: int) -> None:
    share, chi2s, heights_m, sigmas_m = clicked(LowFlight(SPEC, seed))
    assert share > 0.8
    assert np.mean(chi2s < 9.21) > 0.95  # 99 %
    assert 110.0 < np.median(np.abs(heights_m)) < 150.0
    assert np.all(np.abs(heights_m) < 2.0 * sigmas_m) and np.median(sigmas_m) < 1.2 * SIGMA_M


@pytest.mark.long  # short, without a model: above
def test_an_elevation_model_finds_the_height() -> None:
    share, chi2s, heights_m, sigmas_m = clicked(LowFlight(replace(SPEC, has_terrain=True), 2))
    assert share > 0.7
    assert np.mean(chi2s < 9.21) > 0.9
    assert np.median(np.abs(heights_m)) < 15.0 and np.mean(np.abs(heights_m) < 3.0 * sigmas_m) > 0.9


@pytest.mark.long
def test_not_stated_the_same_heights_would_be_promised() -> None:
    """So the first test can fail."""
    _, _, heights_m, sigmas_m = clicked(LowFlight(SPEC, 2, sigma_m=None))
    assert np.mean(np.abs(heights_m) < 3.0 * sigmas_m) < 0.1
