"""Pictures that are mirror images, by a flip in the camera or a mirror before it: in level flight they fit as well.

Their clicks were up to 9 ellipses (200 m) off, six of ten beyond two, without a word.
"""

from collections import Counter
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.sampled_flight import SampledFlight, SampledSpec, fly, replace_section
from contract.feature_set import Status
from onboard.config.delay_prior import NETWORK_PRIOR_S
from onboard.config.schema import parse_config
from onboard.pipeline.pipeline import Pipeline
from simulation.paths import PathSpec
from tests.sampled_clicks import chi2_of, located

CONFIG = parse_config("")
SIDEWAYS = replace_section(CONFIG, "mount", yaw_deg=90.0)  # the picture's top is towards the right wing
LEVEL = SampledSpec(CONFIG, PathSpec("straight"), 8.0, 1.5)
STREAM = replace_section(CONFIG, "camera", sigma_latency_s=NETWORK_PRIOR_S[1])
TURNS = SampledSpec(CONFIG, PathSpec("turns", leg_m=120.0), 16.0, 1.5)
PIXELS = np.array([[120.0, 100.0], [330.0, 250.0], [560.0, 400.0]])


class FlippedFlight(SampledFlight):
    """A simulated flight whose pictures are flipped along an image axis from one of them on."""

    def __init__(self, spec: SampledSpec, seed: int, axis: int, begin: int = 0) -> None:
        super().__init__(spec, seed)
        self._axis, self._begin = axis, begin

    def _flipped(self, frame: int, uv_px: NDArray[np.float64]) -> NDArray[np.float64]:
        uv = np.array(uv_px)
        if frame >= self._begin:
            uv[:, self._axis] = self.spec.camera.size_px[self._axis] - 1.0 - uv[:, self._axis]
        return uv

    def ground_points(self, frame: int, uv_px: NDArray[np.float64]) -> NDArray[np.float64]:
        return super().ground_points(frame, self._flipped(frame, uv_px))

    def pixels(self, frame: int, points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        uv, seen = super().pixels(frame, points)
        return self._flipped(frame, uv), seen


def outcome_of(flight: SampledFlight) -> tuple[Counter[Status], list[Any], Pipeline]:
    """The pictures' statuses by their last sets, and errors of all clicks in ellipses."""
    sets, pipeline = fly(flight)
    ratios = [
        chi2_of(*each) ** 0.5 / 4.6052**0.5 for s in sets.values() if s.is_ok for each in located(flight, s, PIXELS)
    ]
    return Counter(s.status for s in sets.values()), ratios, pipeline


@pytest.mark.parametrize(
    ("spec", "axis", "seed"),
    [
        (LEVEL, 0, 3),
        pytest.param(LEVEL, 0, 4, marks=pytest.mark.long),
        pytest.param(SampledSpec(SIDEWAYS, LEVEL.path, 8.0, 1.5), 1, 3, marks=pytest.mark.long),
        pytest.param(TURNS, 0, 3, marks=pytest.mark.long),
        pytest.param(SampledSpec(CONFIG, LEVEL.path, 8.0, 1.5, has_terrain=True), 0, 3, marks=pytest.mark.long),
        pytest.param(SampledSpec(STREAM, LEVEL.path, 12.0, 2.0, offset_s=0.3), 0, 3, marks=pytest.mark.long),
    ],
    ids=["level", "level, another", "across", "turns", "over a terrain model", "a stream"],
)
def test_mirror_images_are_called_that_and_answer_nothing(spec: SampledSpec, axis: int, seed: int) -> None:
    statuses, ratios, pipeline = outcome_of(FlippedFlight(spec, seed, axis))
    assert not ratios and not statuses[Status.OK]
    assert statuses[Status.MIRRORED] > 0.6 * statuses.total(), statuses
    assert pipeline.window.is_mirrored
    shortfall = pipeline.summary.shortfall
    assert shortfall is not None and "flip" in shortfall.remedy


@pytest.mark.parametrize(
    ("spec", "seed"),
    [
        (LEVEL, 3),
        pytest.param(LEVEL, 4, marks=pytest.mark.long),
        pytest.param(SampledSpec(SIDEWAYS, LEVEL.path, 8.0, 1.5), 3, marks=pytest.mark.long),
        pytest.param(TURNS, 3, marks=pytest.mark.long),
    ],
    ids=["level", "level, another", "across", "turns"],
)
def test_pictures_as_the_camera_sees_are_known_for_that_and_answered(spec: SampledSpec, seed: int) -> None:
    statuses, ratios, pipeline = outcome_of(SampledFlight(spec, seed))
    assert statuses == {Status.OK: statuses.total()}
    assert max(ratios) < 2.0
    assert pipeline.window.is_mirrored is False  # later windows are not asked again


@pytest.mark.long
@pytest.mark.parametrize("offset_s", [-0.45, 0.45])
def test_a_stream_that_is_late_or_early_is_not_called_mirrored_for_long(offset_s: float) -> None:
    """Half a gust late the vehicle tilts the other way than the pictures: the first turn shows otherwise."""
    path = PathSpec("turns", leg_m=200.0)
    statuses, _, pipeline = outcome_of(SampledFlight(SampledSpec(STREAM, path, 20.0, 2.0, offset_s=offset_s), 3))
    assert statuses[Status.MIRRORED] < 0.2 * statuses.total() < 0.7 * statuses.total() < statuses[Status.OK], statuses
    assert pipeline.window.is_mirrored is False
