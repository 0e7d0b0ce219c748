"""A display burned into every picture of a flight: it is found, and the clicks are those of the clean pictures."""

from pathlib import Path
from shutil import copytree

import cv2
import numpy as np
import pytest

from simulation.flight import DescribedSpec
from simulation.ordinary import ordinary
from simulation.paths import PathSpec
from simulation.session import SessionSpec
from tests.on_screen_display import display_parts, displayed
from tests.scenarios.flights import CAMERA, Outcome, play, simulated

RATE_HZ, SECONDS = 5.0, 30.0
SPEC = SessionSpec(
    DescribedSpec(PathSpec("turns", leg_m=150.0, height_m=150.0), ordinary(5), seed=5),
    camera=CAMERA,
    seconds=SECONDS,
    rate_hz=RATE_HZ,
)


def with_display(session: Path, folder: Path) -> Path:
    """A copy of a session with the display in every picture."""
    copytree(session, folder)
    for number, path in enumerate(sorted((folder / "frames").iterdir())):
        image = np.asarray(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), np.uint8)
        assert cv2.imwrite(str(path), displayed(image, number / RATE_HZ))
    return folder


def standing(outcome: Outcome) -> float:
    return outcome.pipeline.summary.left_out.standing


@pytest.mark.long
def test_a_display_is_found_in_flight_and_costs_nothing(tmp_path: Path) -> None:
    session = simulated(SPEC)
    clean, shown = play(session), play(with_display(session, tmp_path / "shown"))
    assert standing(clean) == 0.0
    assert 0.05 < standing(shown) < 0.25
    last = shown.sets[max(shown.sets)]
    at = np.rint(last.uv_px).astype(int)
    assert len(at) > 20
    assert not display_parts(CAMERA.size_px, SECONDS - 1.0 / RATE_HZ)[at[:, 1], at[:, 0]].any()
    assert shown.solved > 0.9 * clean.solved and clean.solved > 0.7
    assert np.median(shown.errors_m) < 1.15 * np.median(clean.errors_m) + 0.1
    assert shown.inside_99 > clean.inside_99 - 0.03
