"""Train, judge and calibrate the net that finds people, vehicles and other things in thermal pictures.

    python -m training.thermal_things DATA OUT [--minutes 60] [--seed 0]
    python -m training.thermal_things DATA OUT --onnx FILE --trained "how, for the model card"

DATA is the folder `normal_xml` of HIT-UAV. Into OUT go `thermal_things.onnx`, its calibration and figures
`thermal_things.json`, `MODEL_CARD.md`, and while it trains `thermal_things.pt`. With `--onnx` nothing is trained: that
net, from elsewhere, is judged and calibrated; only the two flights that test are known not to have trained it, so that
a part of them calibrates it and the other part tests the calibration.
"""

from __future__ import annotations

import argparse
import hashlib
import json
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from onboard.spots.thing_net import LARGEST, LOCAL_FLOOR, LOCAL_PX, PEAK_CELLS, SIZE_UNIT_PX, STRIDE
from training.again import again, described, flights
from training.calibration import counted, reliability, tables
from training.labelled_pictures import KINDS, UNTOUCHED_PART, Grey, Labelled, Split, read_all, split, stretches
from training.model_card import card
from training.net_input import LEAST_SPREAD
from training.peaks import LEAST_SCORE
from training.repeats import moved_pairs, pairs_of
from training.run_onnx import OnnxNet
from training.score import Looks, figures, joined, look_at, of_pictures

FORMAT = 1
NAME = "thermal_things"


def milliseconds(net: OnnxNet, grey: Grey) -> float:
    """Return how long a look takes on one thread: the least of several, as others may use the processor."""
    net.seconds.clear()
    for _ in range(8):
        net.maps(grey)
    return round(1e3 * min(net.seconds), 1)


def judged(net: OnnxNet, pictures: Sequence[Labelled], looks: Looks, half: Looks) -> dict[str, object]:
    """Return the figures of pictures that training has not seen."""
    is_day = np.array([p.is_day for p in pictures])
    black_hot = look_at(pictures, lambda grey: net.maps(np.asarray(255 - grey, dtype=np.uint8)))
    sets = {
        "all": looks, "day": of_pictures(looks, is_day), "night": of_pictures(looks, ~is_day), "black_hot": black_hot,
        "half_size": half,
    }  # fmt: skip
    grey = pictures[0].grey()
    small = np.asarray(cv2.resize(grey, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    return {
        "pictures": len(pictures),
        **{name: {kind: figures(looks, k) for k, kind in enumerate(KINDS)} for name, looks in sets.items()},
        "milliseconds_640x512": milliseconds(net, grey), "milliseconds_320x256": milliseconds(net, small),
    }  # fmt: skip


def calibrated(path: Path, data: Split, training: str, is_trained_here: bool) -> dict[str, object]:
    """Return what `thermal_things.json` states: the input, the calibration by kind, and how far both can be trusted.

    The calibration is of all pictures that training has not seen, because flights differ by more than a flight's own
    pictures show. How far that of one part of them holds on the other is stated. For a net from elsewhere both parts
    are of the flights that test, and its figures are those of all of them.
    """
    net = OnnxNet(path)
    looks, test = (look_at(pictures, net.maps_once) for pictures in (data.calibration, data.test))
    half, test_half = (look_at(pictures, net.maps, shrink=2) for pictures in (data.calibration, data.test))
    unseen, every, every_half = [*data.calibration, *data.test], joined(looks, test), joined(half, test_half)
    pairs = [*pairs_of(data.calibration, net.maps_once), *pairs_of(data.test, net.maps_once)]
    kinds = tables(every, every_half)
    for k, name in enumerate(KINDS):
        kinds[name] |= again(counted(every, k), pairs, k) | {"flights": flights(every, k, stretches(unseen))}
    judged_on = (data.test, test, test_half) if is_trained_here else (unseen, every, every_half)
    figures_of = judged(net, *judged_on)
    return {
        "format": FORMAT, "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
        "input": {
            "box_px": LOCAL_PX, "least_spread": LEAST_SPREAD, "least_local_spread": LOCAL_FLOOR, "most": LARGEST,
        },
        "output": {"stride_px": STRIDE, "size_px": SIZE_UNIT_PX, "peak_cells": PEAK_CELLS, "least_score": LEAST_SCORE},
        "bytes": path.stat().st_size, "training": training, "calibration_pictures": len(data.calibration),
        "calibration_test_pictures": len(data.test),
        "kinds": kinds,
        "pairs": {"all": described(pairs), "moved": described(moved_pairs(pairs))},
        "test": figures_of,
        "reliability": {name: reliability(counted(looks, k), test, k) for k, name in enumerate(KINDS)},
        "reliability_half_size": {name: reliability(counted(looks, k), test_half, k) for k, name in enumerate(KINDS)},
    }  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("data", type=Path, help="folder normal_xml of HIT-UAV")
    parser.add_argument("out", type=Path, help="folder for the net and its calibration")
    parser.add_argument("--minutes", type=float, default=60.0, help="time to train")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--onnx", type=Path, help="judge and calibrate this net instead of training one")
    parser.add_argument("--trained", default="not stated.", help="how the net of --onnx was trained")
    given = parser.parse_args(arguments)
    cv2.setNumThreads(1)
    given.out.mkdir(parents=True, exist_ok=True)
    pictures = read_all(given.data)
    data = split(pictures) if given.onnx is None else split(pictures, calibration=UNTOUCHED_PART)
    path, training = given.onnx, given.trained
    if path is None:
        from training.train import trained  # noqa: PLC0415  (PyTorch, which judging a net does without)

        path = given.out / f"{NAME}.onnx"
        training = trained(data, path, given.minutes, given.seed)
    stated = calibrated(path, data, training, given.onnx is None)
    (given.out / f"{NAME}.json").write_text(json.dumps(stated, indent=1) + "\n", encoding="utf-8")
    (given.out / "MODEL_CARD.md").write_text(card(stated), encoding="utf-8")
    print(json.dumps(stated["test"], indent=1))


if __name__ == "__main__":
    main()
