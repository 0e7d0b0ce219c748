"""A net's look at one thermal picture: what resembles a person, a vehicle or another thing, and how much. (25.13)

The net is a file in ONNX with a model card (`weights/MODEL_CARD.md`); OpenCV runs it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from contract.spot import ThingKind

Image = NDArray[np.float32]

WEIGHTS = Path(__file__).parent / "weights"
NET = WEIGHTS / "thermal_things.onnx"
KINDS = ThingKind.PERSON, ThingKind.VEHICLE, ThingKind.OTHER  # of the net's first three maps
STRIDE, MULTIPLE = 4, 16  # pixels of the picture to a cell of a map; both sides of what the net is given
LOCAL_PX = 33  # of the part about each pixel that it is compared with
LOCAL_FLOOR, LARGEST = 0.1, 6.0  # of a part's spread, in the picture's own; of what the net is given
PEAK_CELLS = 5  # to the side of the part of which a peak is the greatest
SIZE_UNIT_PX = 16.0
EDGE = cv2.BORDER_REFLECT_101


@dataclass(frozen=True)
class Peak:
    """A thing that one picture may show: its middle and size, pixels; `score`: how much it resembles one, 0 to 1."""

    kind: ThingKind
    score: float
    u_px: float
    v_px: float
    width_px: float
    height_px: float


class ThingNet:
    """For one thread. `least_score`: what resembles a thing less is left out."""

    def __init__(self, least_score: float, net: Path = NET) -> None:
        self._net = cv2.dnn.readNetFromONNX(str(net))
        self._least = least_score

    def peaks(self, values: NDArray[np.uint16] | Image) -> list[Peak]:
        """Return the peaks of a picture (H, W) of any unit, gain and offset, the most likely first."""
        height, width = values.shape
        self._net.setInput(given(values)[None])
        maps = np.asarray(self._net.forward(), np.float32)[0]
        found = []
        for kind, scores in zip(KINDS, maps, strict=False):
            for row, column in np.argwhere(are_peaks(scores) & (scores > self._least)):
                right, down, log_width, log_height = (float(c) for c in maps[len(KINDS) :, row, column])
                u, v = ((cell + by + 0.5) * STRIDE - 0.5 for cell, by in ((column, right), (row, down)))
                if not (-0.5 <= u < width - 0.5 and -0.5 <= v < height - 0.5):
                    continue
                size = (SIZE_UNIT_PX * float(np.exp(min(log, 6.0))) for log in (log_width, log_height))
                found.append(Peak(kind, float(scores[row, column]), float(u), float(v), *size))
        return sorted(found, key=lambda peak: -peak.score)


def are_peaks(scores: Image) -> NDArray[np.bool_]:
    """Return which cells of a map (h, w) are the greatest of the PEAK_CELLS to a side about them."""
    out: NDArray[np.bool_] = scores >= np.asarray(cv2.dilate(scores, np.ones((PEAK_CELLS, PEAK_CELLS), np.uint8)))
    return out


def given(values: NDArray[np.uint16] | Image) -> Image:
    """The two channels (2, h, w) that the net is given of a picture (H, W): nothing is left of its gain and offset.

    The picture over its own spread, and how far each pixel is from the part about it over that part's spread. The
    sides are multiples of MULTIPLE: the picture is mirrored beyond its right and lower edges.
    """
    height, width = values.shape
    whole = values.astype(np.float32)
    mean, spread = float(whole.mean(dtype=np.float64)), float(whole.std(dtype=np.float64))
    whole = (whole - np.float32(mean)) / np.float32(max(spread, 1e-6))
    below, right = -height % MULTIPLE, -width % MULTIPLE
    return channels(np.asarray(cv2.copyMakeBorder(whole, 0, below, 0, right, EDGE), np.float32))


def channels(whole: Image) -> Image:
    """Return both channels (2, H, W) of a picture (H, W) over its own mean and spread. (25.13)"""
    part = LOCAL_PX, LOCAL_PX
    away = whole - np.asarray(cv2.blur(whole, part, borderType=EDGE), np.float32)
    variance = np.asarray(cv2.blur(away * away, part, borderType=EDGE), np.float32)
    local = away / (np.sqrt(np.maximum(variance, 0.0)) + np.float32(LOCAL_FLOOR))
    out: Image = np.clip(np.stack([whole, local]), -LARGEST, LARGEST)
    return out
