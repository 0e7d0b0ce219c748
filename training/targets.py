"""The maps that the net is to return for labelled things: heat at their middles, and at those offset and size."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from onboard.spots.thing_net import SIZE_UNIT_PX, STRIDE
from training.labelled_pictures import KINDS

Array = NDArray[np.float64]

SIGMA_OF_SIZE, SIGMA_CELLS = 0.18, (0.7, 4.0)  # of the square root of a box's area; the least and the greatest
LEAST_SIZE = 0.1  # of SIZE_UNIT_PX, of which sizes are logarithms of multiples


class Targets(NamedTuple):
    """Heat (3, h, w), 1 at a thing's cell; those cells (N, 2) by row and column; what they are to state (N, 4)."""

    heat: NDArray[np.float32]
    cells: NDArray[np.int64]
    shapes: NDArray[np.float32]


def targets_of(things: Array, rows: int, columns: int) -> Targets:
    """Return the targets of things (N, 5: kind, u, v, width, height in px) for an output of rows x columns cells.

    A shape is the offset x, y of the middle from its cell, in cells, and the logarithms of width and height over 16 px.
    """
    heat = np.zeros((len(KINDS), rows, columns), dtype=np.float32)
    middles = (things[:, 1:3] + 0.5) / STRIDE - 0.5
    cells = np.clip(np.rint(middles), 0, [columns - 1, rows - 1]).astype(np.int64)
    sigmas = np.clip(SIGMA_OF_SIZE * np.sqrt(np.maximum(things[:, 3] * things[:, 4], 1.0)) / STRIDE, *SIGMA_CELLS)
    for kind, (x, y), sigma in zip(things[:, 0].astype(int), cells, sigmas, strict=True):
        reach = int(np.ceil(3.5 * sigma))
        up, down = max(y - reach, 0), min(y + reach + 1, rows)
        left, right = max(x - reach, 0), min(x + reach + 1, columns)
        squares = (np.arange(up, down)[:, None] - y) ** 2 + (np.arange(left, right)[None] - x) ** 2
        part = heat[kind, up:down, left:right]
        np.maximum(part, np.exp(-squares / (2.0 * sigma**2)), out=part, casting="same_kind")
    sizes = np.log(np.maximum(things[:, 3:5] / SIZE_UNIT_PX, LEAST_SIZE))
    return Targets(heat, cells[:, ::-1].copy(), np.hstack([middles - cells, sizes]).astype(np.float32))
