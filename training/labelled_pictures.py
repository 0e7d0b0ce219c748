"""Pictures with labels of HIT-UAV, and which of them train, calibrate and test.

HIT-UAV: Suo et al., Scientific Data 10, 227 (2023), CC BY 4.0, https://github.com/suojiashun/HIT-UAV-Infrared-Thermal-Dataset;
its folder `normal_xml` is read. A name is `day or night (0, 1) _ height m _ camera angle deg _ weather _ number`.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Grey = NDArray[np.uint8]

KINDS = ("person", "vehicle", "other")
KIND_OF = {"Person": 0, "Car": 1, "OtherVehicle": 1, "Bicycle": 2}  # what has another name is left open
FOCAL_PX = 2000.0  # assumed: the data do not state it
# Numbers of pictures, first and last. Two whole flights test; the stretches that calibrate lie in the other flights, by
# day and night, low and high, with each kind. Neighbours show the same ground: what is nearer is not trained on.
TEST = ((281, 726), (8067, 9883))
CALIBRATION = ((1066, 1256), (1712, 1824), (2562, 2751), (4465, 4778), (5776, 5953), (6440, 6568), (9949, 10170))
UNTOUCHED_PART = ((281, 470), (8067, 8900))  # of both flights that test: calibrates a net that was trained elsewhere
APART = 15

BETWEEN_FLIGHTS = 60

Ranges = Sequence[tuple[int, int]]


@dataclass(frozen=True, eq=False)
class Labelled:
    """A picture's file and labels.

    `things` (N, 5): kind (an index of `KINDS`), middle u and v, width and height in pixels. `left_open` (M, 4): left,
    top, right and bottom of areas where the labels do not state what is there.
    """

    path: Path
    number: int
    is_day: bool
    height_m: float
    depression_rad: float
    things: Array
    left_open: Array

    def grey(self) -> Grey:
        """Return the picture, (H, W)."""
        grey = cv2.imread(str(self.path), cv2.IMREAD_GRAYSCALE)
        if grey is None:
            raise ValueError(f"{self.path} is no picture that can be read")
        return np.asarray(grey, dtype=np.uint8)

    def ground_m2(self, pixels: int) -> float:
        """Return the level ground that so many pixels around the middle cover."""
        sine = math.sin(self.depression_rad)
        return pixels * (self.height_m / sine / FOCAL_PX) ** 2 / sine


class Split(NamedTuple):
    """Pictures by what they are for."""

    training: list[Labelled]
    calibration: list[Labelled]
    test: list[Labelled]


def read_labels(file: Path, pictures: Path) -> Labelled:
    """Read one file of labels; its picture lies in the folder `pictures`."""
    things, left_open = [], []
    for labelled in ET.parse(file).iter("object"):
        box = labelled.find("bndbox")
        if box is None:
            raise ValueError(f"{file}: an object without a box")
        left, top, right, bottom = (float(box.findtext(side, "nan")) for side in ("xmin", "ymin", "xmax", "ymax"))
        kind = KIND_OF.get(labelled.findtext("name", ""))
        if kind is None:
            left_open.append((left, top, right, bottom))
        else:
            things.append((kind, (left + right) / 2, (top + bottom) / 2, right - left, bottom - top))
    night, height, angle, _, number = file.stem.split("_")
    return Labelled(
        path=pictures / f"{file.stem}.jpg", number=int(number), is_day=night == "0", height_m=float(height),
        depression_rad=math.radians(float(angle)), things=np.array(things, dtype=np.float64).reshape(-1, 5),
        left_open=np.array(left_open, dtype=np.float64).reshape(-1, 4),
    )  # fmt: skip


def read_all(folder: Path) -> list[Labelled]:
    """Read the labels of every picture of `normal_xml`, in the order in which they were taken."""
    files = sorted((folder / "Annotations").glob("*.xml"))
    if not files:
        raise ValueError(f"{folder} has no Annotations/*.xml: name the folder normal_xml of HIT-UAV")
    return sorted((read_labels(file, folder / "JPEGImages") for file in files), key=lambda p: p.number)


def split(pictures: Sequence[Labelled], calibration: Ranges = CALIBRATION, test: Ranges = TEST) -> Split:
    """Separate what trains from what calibrates and tests, with `APART` numbers between.

    Where `calibration` has a part of the flights that test, those parts do not test the calibration.
    """

    def within(picture: Labelled, ranges: Ranges, margin: int = 0) -> bool:
        return any(first - margin <= picture.number <= last + margin for first, last in ranges)

    return Split(
        training=[p for p in pictures if not within(p, [*calibration, *test], APART)],
        calibration=[p for p in pictures if within(p, calibration)],
        test=[p for p in pictures if within(p, test) and not within(p, calibration)],
    )


def stretches(pictures: Sequence[Labelled]) -> NDArray[np.int64]:
    """Return which stretch of a flight each picture is of (P,): one that looks at the same ground from the same height.

    A new one begins with another height or camera angle, or where many numbers are left out: the data do not state
    where a flight ends.
    """
    begins = [
        (a.is_day, a.height_m, a.depression_rad) != (b.is_day, b.height_m, b.depression_rad)
        or b.number - a.number > BETWEEN_FLIGHTS
        for a, b in pairwise(pictures)
    ]
    return np.concatenate([[0], np.cumsum(begins)]).astype(np.int64)
