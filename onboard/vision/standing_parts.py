"""Parts of the picture that stand still while the ground moves: a display burned in, the aircraft's nose or guards.

Two pictures between which the ground has moved are compared cell by cell. Let c(s) be the correlation of a cell with
what is moved into it from before by s times the ground's motion. Ground is like c(1), and from there c(0) and c(2) are
equally far: whatever its texture, neither is the larger more often than the other. What stands still
is like c(0). (22.1)

The evidence of independent pairs is added up in such a way that over ground it exceeds `CALLED` in one cell once in
exp(CALLED) pairs at most, (22.2). Cells without texture have both near zero, by a floor under their variance: sky,
water and dark ground are never called. Where no motion is known, or its source has followed the display itself, the
motion is found from the cells that have changed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from onboard.geometry.plane_homography import move, pixel_grid
from onboard.vision.contrast_normalisation import Picture

Array = NDArray[np.float64]
Grid = NDArray[np.float32]

WORKING_PX = 160  # of the longer side
CELL_PX = 2  # of the working picture; a cell is compared with its eight neighbours about it
MOVED_PX = 4.0  # of the working picture that the ground must have moved by, where a cell is judged
STANDS_PX = 0.5  # of the working picture, below which what is followed stands still
MIN_PEAK = 0.05  # of phase correlation
FLOOR = 3.0  # grey levels of one sigma that count as no texture
TEXTURED = 16.0  # grey levels squared of variance, from which a cell counts as changed
MARGIN = 0.1  # of correlation: the sensor's fixed pattern, and what a codec leaves standing
GAIN = 1.5
CALLED = float(np.log(1e6))
MOST = CALLED + 7.0  # of evidence that is kept: so soon is forgotten what no longer stands
REMEMBERED = 6  # pictures in the mean that c(0) is of: from it the ground fades
CHANGED, CHANGED_SHARE = 0.5, 0.15  # of the cells with texture: where fewer change, the whole picture stands still
LEAST_CELLS = 4  # that hang together
MOST_SHARE = 0.6  # of the picture, beyond which nothing is left out: it is then not the ground that moves
SAMPLED = 9, 7  # columns and rows at which a motion is looked at
GAPS = np.ones((3, 5), np.uint8)  # cells: between letters, and where digits change with every picture


class Texture:
    """A working picture with its mean and variance about each cell of a grid (columns, rows)."""

    def __init__(self, small: Grid, grid: tuple[int, int]) -> None:
        self.small, self._grid = small, grid
        self.mean = self._gathered(small)
        square = self._gathered(small * small)
        self.variance = np.maximum(square - self.mean * self.mean, 0.0).astype(np.float32)

    def _gathered(self, values: Grid) -> Grid:
        """Means over each cell and its eight neighbours."""
        cells = cv2.resize(values, self._grid, interpolation=cv2.INTER_AREA)
        return np.asarray(cv2.blur(cells, (3, 3)), np.float32)

    def part(self, cells: tuple[int, int, int, int]) -> Texture:
        """The texture of some of its cells (x, y, columns, rows), with their mean and variance."""
        x, y, columns, rows = cells
        out = object.__new__(Texture)
        out._grid = columns, rows
        out.small = self.small[CELL_PX * y : CELL_PX * (y + rows), CELL_PX * x : CELL_PX * (x + columns)]
        out.mean, out.variance = (g[y : y + rows, x : x + columns] for g in (self.mean, self.variance))
        return out

    def detail(self) -> Grid:
        """The picture beyond its mean about each cell, over its spread there."""
        size = self.small.shape[1], self.small.shape[0]
        mean, spread = (cv2.resize(g, size) for g in (self.mean, np.sqrt(self.variance + FLOOR * FLOOR)))
        return (self.small - mean) / spread

    def likeness(self, other: Texture) -> Grid:
        """Correlation with another about each cell; with FLOOR in its denominator, near 0 without texture."""
        product = self._gathered(self.small * other.small) - self.mean * other.mean
        scale = np.sqrt((self.variance + FLOOR * FLOOR) * (other.variance + FLOOR * FLOOR))
        return np.asarray(product / scale, np.float32)


@dataclass(frozen=True, eq=False)
class _Reference:
    """An earlier picture, and the motions (3, 3) from it back to the keyframe by each source that has one."""

    texture: Texture
    back: tuple[Array | None, ...]


class StandingParts:
    """Takes pictures and the ground's motion; `mask` is what has been found."""

    def __init__(self, size_px: tuple[int, int]) -> None:
        self.size_px = size_px
        share = min(1.0, WORKING_PX / max(size_px))
        columns, rows = (max(round(share * side / CELL_PX), 3) for side in size_px)
        self._grid = columns, rows
        self._working = CELL_PX * columns, CELL_PX * rows
        x, y = self._working[0] / size_px[0], self._working[1] / size_px[1]
        # Pixel centres are at whole numbers, the edges half a pixel out.
        self._reduce = np.array([[x, 0.0, 0.5 * x - 0.5], [0.0, y, 0.5 * y - 0.5], [0.0, 0.0, 1.0]])
        self._enlarge = np.linalg.inv(self._reduce)
        self._sample = pixel_grid(self._working, SAMPLED)
        self._reference: _Reference | None = None
        self._mean: Grid | None = None  # of the pictures compared, the last ones most
        self._evidence = np.zeros((rows, columns), np.float32)
        self._is_called = np.zeros((rows, columns), bool)
        self._found = np.zeros((rows, columns), bool)

    @property
    def share(self) -> float:
        """The share (0 to 1) of the picture that has been found to stand still."""
        return float(self._found.mean())

    @property
    def mask(self) -> NDArray[np.bool_]:
        """(H, W), true where something stands still."""
        large = cv2.resize(self._found.astype(np.uint8), self.size_px, interpolation=cv2.INTER_NEAREST)
        return np.asarray(large) > 0

    def see(self, image: Picture, motions: Sequence[Array | None]) -> bool:
        """Take a picture (H, W); whether `mask` has changed by it.

        `motions`: the ground's (3, 3) since the keyframe by each source that may know it, the best first, always as
        many.
        """
        was = self._reference
        if was is None:
            self._reference = _Reference(self._reduced(image), _inverse(motions))
            return False
        steps = [
            self._reduce @ now @ back @ self._enlarge
            for back, now in zip(was.back, motions, strict=True)
            if back is not None and now is not None
        ]
        moved_px = [_middle(self._moved_px(H)) for H in steps]
        if steps and STANDS_PX < max(moved_px) < MOVED_PX:
            return False
        now = self._reduced(image)
        moved = next((H for H, px in zip(steps, moved_px, strict=True) if px >= MOVED_PX), None)
        H = self._behind(was.texture, now) if moved is None else moved
        if H is None:
            return False
        self._reference = _Reference(now, _inverse(motions))
        self._compare(was.texture, now, H)
        return self._judge()

    def new_keyframe(self, motion: Array) -> None:
        """Motions count from the picture that `motion` leads to, from now on."""
        was = self._reference
        if was is not None:
            self._reference = _Reference(was.texture, tuple(None if m is None else motion @ m for m in was.back))

    def begin(self, image: Picture) -> None:
        """Motions count from this picture; how it moved since an earlier one is not known."""
        self._reference = _Reference(self._reduced(image), (np.eye(3), np.eye(3)))

    def _reduced(self, image: Picture) -> Texture:
        small = cv2.resize(_halved(image, self._working), self._working, interpolation=cv2.INTER_AREA)
        return Texture(np.asarray(small, np.float32), self._grid)

    def _moved_px(self, H: Array) -> Grid:
        """The distance, px, that the ground moves by a motion of the working picture, at each of SAMPLED."""
        columns, rows = SAMPLED
        moved = np.linalg.norm(move(H, self._sample) - self._sample, axis=1)
        out: Grid = moved.reshape(rows, columns).astype(np.float32)
        return out

    def _behind(self, was: Texture, now: Texture) -> Array | None:
        """The shift (3, 3) of the cells that have changed; None if there are too few, or they do not shift."""
        still = was.likeness(now)
        if not self._is_part(was, now, still):
            return None
        moves = cv2.resize((still < CHANGED).astype(np.float32), self._working, interpolation=cv2.INTER_NEAREST)
        hann = cv2.createHanningWindow(self._working, cv2.CV_32F)
        (u, v), peak = cv2.phaseCorrelate(was.detail() * moves, now.detail() * moves, hann)
        shift = np.array([[1.0, 0.0, u], [0.0, 1.0, v], [0.0, 0.0, 1.0]])
        return shift if peak >= MIN_PEAK and np.hypot(u, v) >= MOVED_PX else None

    def _is_part(self, was: Texture, now: Texture, still: Grid) -> bool:
        """Return whether so much of the picture has changed that the rest can be a standing part."""
        has_texture = np.minimum(was.variance, now.variance) > TEXTURED
        changed = np.count_nonzero(has_texture & ~self._is_called & (still < CHANGED))
        return bool(changed >= max(CHANGED_SHARE * np.count_nonzero(has_texture), LEAST_CELLS))

    def _compare(self, was: Texture, now: Texture, H: Array) -> None:
        """Add what a pair of pictures shows, (22.2)."""
        self._mean = was.small if self._mean is None else self._mean
        still = Texture(self._mean, self._grid).likeness(now)
        faded: Grid = self._mean + (now.small - self._mean) / np.float32(REMEMBERED)
        self._mean = faded
        if not self._is_part(was, now, still):
            return
        control = self._control(was, now, H, (0, 0, *self._grid))
        there = cv2.boundingRect(np.isnan(control).astype(np.uint8))  # the other way round, where a match lies outside
        if there[2]:
            there = self._with_neighbours(there)
            left, top, columns, rows = there
            part = control[top : top + rows, left : left + columns]
            other = self._control(now, was, np.asarray(np.linalg.inv(H), np.float64), there)
            np.copyto(part, other, where=np.isnan(part))
        judged = (cv2.resize(self._moved_px(H), self._grid) >= MOVED_PX) & ~np.isnan(control)
        x = GAIN * (still - control - MARGIN)
        gain = np.where(judged, x - 0.5 * x * x, np.float32(0.0))
        np.clip(self._evidence + gain, 0.0, MOST, out=self._evidence)

    def _with_neighbours(self, cells: Sequence[int]) -> tuple[int, int, int, int]:
        """A part of the grid (x, y, columns, rows) with the cells about it."""
        x, y, columns, rows = cells
        left, top = max(x - 1, 0), max(y - 1, 0)
        return left, top, min(x + columns + 1, self._grid[0]) - left, min(y + rows + 1, self._grid[1]) - top

    def _control(self, was: Texture, now: Texture, H: Array, cells: tuple[int, int, int, int]) -> Grid:
        """c(2) by twice the motion `H`, in a part of the grid; NaN where that needs what is outside the picture."""
        x, y, columns, rows = cells
        twice = H @ H
        to_part = np.array([[1.0, 0.0, -CELL_PX * x], [0.0, 1.0, -CELL_PX * y], [0.0, 0.0, 1.0]])
        size = CELL_PX * columns, CELL_PX * rows
        moved = cv2.warpPerspective(was.small, to_part @ twice, size, borderMode=cv2.BORDER_REPLICATE)
        out = Texture(np.asarray(moved, np.float32), (columns, rows)).likeness(now.part(cells))
        shrink = np.diag([1.0 / CELL_PX, 1.0 / CELL_PX, 1.0])
        ones = np.ones(self._grid[::-1], np.uint8)
        inside = cv2.warpPerspective(ones, shrink @ to_part @ twice @ np.linalg.inv(shrink), (columns, rows))
        out[np.asarray(inside) == 0] = np.nan
        return out

    def _judge(self) -> bool:
        """Call cells by their evidence, with hysteresis, and the gaps between them; return whether the mask changed."""
        self._is_called = (self._evidence >= CALLED) | (self._is_called & (self._evidence > 0.5 * CALLED))
        found = _large_parts(self._is_called) if self._is_called.any() else self._is_called
        if np.count_nonzero(found) > MOST_SHARE * found.size:
            found = np.zeros_like(found)
        is_new = not np.array_equal(found, self._found)
        self._found = found
        return is_new


def _inverse(motions: Sequence[Array | None]) -> tuple[Array | None, ...]:
    return tuple(None if m is None else np.asarray(np.linalg.inv(m), np.float64) for m in motions)


def _middle(values: Grid) -> float:
    """The median of an odd number of values, in a tenth of the time of NumPy's."""
    return float(np.sort(values, axis=None)[values.size // 2])


def _halved(image: Picture, least: tuple[int, int]) -> Picture:
    """Halve a picture while its sides are even and at least four times `least` (columns, rows).

    OpenCV halves quickly: 640 pixels come to 160 in a sixth of the time, 1640 in a fifteenth.
    """
    rows, columns = image.shape
    while rows % 2 == columns % 2 == 0 and columns >= 4 * least[0] and rows >= 4 * least[1]:
        rows, columns = rows // 2, columns // 2
        image = np.asarray(cv2.resize(image, (columns, rows), interpolation=cv2.INTER_AREA), np.uint8)
    return image


def _large_parts(is_called: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The called cells that form connected parts of at least LEAST_CELLS, with the gaps between them."""
    cells = cv2.morphologyEx(is_called.astype(np.uint8), cv2.MORPH_CLOSE, GAPS)
    _, names, parts, _ = cv2.connectedComponentsWithStats(cells, connectivity=8)
    is_large = parts[:, cv2.CC_STAT_AREA] >= LEAST_CELLS
    is_large[0] = False
    return np.asarray(is_large[names])
