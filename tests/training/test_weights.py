"""The net that is installed, its calibration and its model card belong together."""

import hashlib
import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.rest_long import rest_long
from training.labelled_pictures import KINDS
from training.model_card import card
from training.peaks import peaks_of
from training.run_onnx import OnnxNet

WEIGHTS = Path(__file__).resolve().parents[2] / "onboard" / "spots" / "weights"
NET = WEIGHTS / "thermal_things.onnx"


@pytest.fixture(scope="module")
def stated() -> dict[str, Any]:
    read: dict[str, Any] = json.loads((WEIGHTS / "thermal_things.json").read_text(encoding="utf-8"))
    return read


def test_the_calibration_and_the_card_are_those_of_the_net(stated: dict[str, Any]) -> None:
    assert stated["sha256"] == hashlib.sha256(NET.read_bytes()).hexdigest()
    assert (WEIGHTS / "MODEL_CARD.md").read_text(encoding="utf-8") == card(stated)
    assert NET.stat().st_size < 4e6


def test_a_higher_score_is_never_less_likely_a_thing(stated: dict[str, Any]) -> None:
    assert list(stated["kinds"]) == list(KINDS)
    for of in stated["kinds"].values():
        edges, found, false = (np.array(of[name]) for name in ("edges", "found", "false_per_mpx"))
        assert len(edges) == len(found) + 1 == len(false) + 1
        assert 15 <= len(found) <= 40
        assert edges[-1] == 1.0
        assert (np.diff(edges) > 0).all()
        assert (false > 0).all()
        assert all(a <= b * 1.001 for a, b in pairwise(found / false))
        assert found.sum() + of["missed"] == pytest.approx(1.0, abs=0.02)
        for again in (of["found_again"], of["false_again"]):
            assert 0.0 <= again["shared"] < 1.0
            assert 0.0 <= again["lost"] < 1.0


@pytest.mark.parametrize(("height", "width"), rest_long([(256, 320), (512, 640)]))
def test_the_net_finds_warm_shapes_of_people_first_in_pictures_of_either_size(height: int, width: int) -> None:
    ground = cv2.GaussianBlur(np.random.default_rng(0).normal(0.0, 1.0, (height, width)), (0, 0), 3.0)
    grey = 90.0 + 60.0 * ground / ground.std() / 3
    people = [(60, 80), (200, 120), (130, 200)]
    for u, v in people:
        cv2.ellipse(grey, (u, v), (4, 8), 0.0, 0.0, 360.0, 230.0, -1)
    maps = OnnxNet(NET).maps(np.clip(cv2.GaussianBlur(grey, (0, 0), 1.0), 0, 255).astype(np.uint8))
    assert maps.shape == (7, height // 4, width // 4)
    peaks = peaks_of(maps, 0.1)
    strongest = np.argsort(np.where(peaks.kind == 0, -peaks.score, 0.0))[: len(people)]
    at = peaks.middle_px[strongest]
    assert all(np.linalg.norm(at - person, axis=1).min() < 4.0 for person in people)
