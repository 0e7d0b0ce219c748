"""The motion of the scene from one picture to the next, over the whole flight: small pictures, matched descriptors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from onboard.geometry.plane_homography import move, pixel_grid
from onboard.vision.contrast_normalisation import Picture, prepare
from onboard.vision.descriptor_matching import Described, describe, motion_between

Array = NDArray[np.float64]

MOST_PAIRS = 80  # of a long flight, evenly spread: each costs two pictures to decode
APART_NS = 600_000_000  # at least: less motion than a log is off by determines nothing
GRID = (9, 7)
MIN_OVERLAP = 9  # of the grid's points that both pictures see


@dataclass(frozen=True, eq=False)
class Pairs:
    """K pairs of pictures: moments (K, 2), ns by the camera's clock; four directions in the first picture and where
    the second has the same ground, normalised (K, 4, 2) both.
    """

    moments_ns: NDArray[np.int64]
    at: Array
    to: Array

    def __len__(self) -> int:
        return len(self.moments_ns)

    def with_others(self, others: Pairs) -> Pairs:
        """Return these and others."""
        return Pairs(
            np.concatenate([self.moments_ns, others.moments_ns]),
            np.concatenate([self.at, others.at]),
            np.concatenate([self.to, others.to]),
        )


def chosen_pairs(stamps_ns: Sequence[int]) -> list[tuple[int, int]]:
    """Pairs of pictures about `APART_NS` apart or next to each other: one after the other, of long flights some."""
    pairs, first = [], 0
    for second in range(1, len(stamps_ns)):
        if stamps_ns[second] - stamps_ns[first] >= APART_NS:
            pairs.append((first, second))
            first = second
    if len(pairs) <= MOST_PAIRS:
        return pairs
    return [pairs[i] for i in sorted({round(i) for i in np.linspace(0, len(pairs) - 1, MOST_PAIRS)})]


def measure(
    camera: Camera,
    stamps_ns: Sequence[int],
    chosen: Sequence[tuple[int, int]],
    picture: Callable[[int], Picture | None],
) -> Pairs:
    """Return the chosen pairs whose motion is found. `picture(i)` decodes one, of any size; each is asked for once,
    in order. A picture that cannot be decoded has no pair.
    """
    moments, at, to = [], [], []
    held: tuple[int, Described | None, tuple[int, int]] = (-1, None, (0, 0))
    for first, second in chosen:
        one = held if held[0] == first else _described(first, picture)
        held = other = _described(second, picture)
        if one[1] is None or other[1] is None:
            continue
        H = motion_between(one[1], other[1], one[2][0])
        found = None if H is None else _directions(camera, H, one[2])
        if found is not None:
            moments.append((stamps_ns[first], stamps_ns[second]))
            at.append(found[0])
            to.append(found[1])
    return Pairs(
        np.array(moments, np.int64).reshape(-1, 2), np.array(at).reshape(-1, 4, 2), np.array(to).reshape(-1, 4, 2)
    )


def _described(index: int, picture: Callable[[int], Picture | None]) -> tuple[int, Described | None, tuple[int, int]]:
    image = picture(index)
    return (index, None, (0, 0)) if image is None else (index, describe(prepare(image)), image.shape[1::-1])


def _directions(camera: Camera, H: Array, size_px: tuple[int, int]) -> tuple[Array, Array] | None:
    """Four points of the part that both pictures see, in each; None where that is too little."""
    grid = pixel_grid(size_px, GRID)
    moved = move(H, grid)
    seen = ((moved > 0.0) & (moved < np.array(size_px) - 1.0)).all(axis=1)
    if np.count_nonzero(seen) < MIN_OVERLAP:
        return None
    middle, spread = grid[seen].mean(axis=0), grid[seen].std(axis=0)
    box = middle + spread * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    scale = np.array(camera.size_px) / np.array(size_px)
    rays, valid = camera.unproject((np.concatenate([box, move(H, box)]) + 0.5) * scale - 0.5)
    if not valid.all():
        return None
    directions = rays[:, :2] / rays[:, 2:]
    return directions[:4], directions[4:]
