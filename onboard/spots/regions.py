"""Regions with outlines from pixels that stand out."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from onboard.spots.contrast import BLUR_PX, Contrast, Image

Array = NDArray[np.float64]

FINER, OUTLINE_PX = 4, 256  # an outline is traced up to so many times finer than pixels, on at most about so many
LEAST_APART_PX = 2
MOST_REGIONS = 24
MOST_POINTS, ROUGHEST_PX = 120, 0.25
REACH_SIDES, LEAST_SIDE = 1.5, 0.5  # a thing is no farther about its peak and no smaller, in sides of its size
FILLED = 0.5  # of a region, above half of its height: of several things apart it is less, (25.3) has blurred them
LENS_PX = 0.6  # one sigma of a thermal camera's blur; a pixel's own width comes on top


@dataclass(frozen=True, eq=False)
class Region:
    """A region that stands out, in pixels of the picture: its middle (2,), outline (N, 2), and contrast in sigmas.

    `hottest`: its largest value; `above`: by how much that exceeds its ground's. `significance`: contrast over the
    least that it must have, to compare regions by. `is_part`: of a thing that the picture's border cuts off.
    """

    uv_px: Array
    outline_px: Array
    contrast: float
    hottest: float
    above: float
    is_cut: bool
    significance: float = 0.0
    pixels: float = 1.0  # to the side of a pixel of the picture that it was found in
    is_part: bool = False
    blur_px: float = 0.0  # one sigma of what has blurred it, where its outline is that at half of its height


@dataclass(frozen=True, eq=False)
class Part:
    """A part of a picture from row `up` and column `left` on; `level` (h, w) is above 0 in what is meant."""

    level: Image
    up: int
    left: int

    def holds(self, row: int, column: int) -> bool:
        """Return whether a pixel of the picture belongs to it."""
        height, width = self.level.shape
        i, j = row - self.up, column - self.left
        return 0 <= i < height and 0 <= j < width and bool(self.level[i, j] > 0.0)


def peaks(c: Contrast, least: float, most: int) -> NDArray[np.int64]:
    """Rows and columns (N, 2) of the `most` greatest local maxima of contrast above `least`, the greatest first."""
    size = 2 * LEAST_APART_PX + 1
    top = np.asarray(cv2.dilate(c.in_clutter, np.ones((size, size), np.uint8)))
    at = np.argwhere((c.in_clutter >= top) & (c.in_clutter > max(least, 0.0)))
    order = np.argsort(c.in_clutter[at[:, 0], at[:, 1]])[::-1][:most]
    return np.asarray(at[order], np.int64)


def size_limits(c: Contrast, pixel_m: float) -> tuple[int, float]:
    """The limits of a thing of the size of `c`, in its pixels: its reach about its peak, and how many it has at least.

    `pixel_m` is the ground that the usual pixel of the whole picture shows.
    """
    side_px = c.side_m / (pixel_m * c.times)
    return max(int(np.ceil(REACH_SIDES * side_px)), 3), (LEAST_SIDE * side_px) ** 2


def about_peak(whole: Image, peak: tuple[int, int], reach_px: int, least_px: float) -> Part | None:
    """Return the part within half of a peak's excess and joined to it, of the excess (H, W) of a picture.

    None if it is of another size: it reaches farther than `reach_px` or has fewer than `least_px` pixels.
    """
    row, column = peak
    height, width = whole.shape
    up, left = max(row - reach_px, 0), max(column - reach_px, 0)
    excess = whole[up : row + reach_px + 1, left : column + reach_px + 1]
    level = 0.5 * float(whole[row, column])
    _, labels = cv2.connectedComponents((excess > level).astype(np.uint8), connectivity=8)
    inside = labels == labels[row - up, column - left]
    rows, columns = np.nonzero(inside)
    down, right = inside.shape[0] - 1, inside.shape[1] - 1
    is_at_reach = (
        (rows.min() == 0 and up > 0) or (columns.min() == 0 and left > 0)
        or (rows.max() == down and up + down < height - 1) or (columns.max() == right and left + right < width - 1)
    )  # fmt: skip
    if is_at_reach or level <= 0.0 or len(rows) < least_px:
        return None
    return Part(np.where(inside, excess - level, np.minimum(excess - level, 0.0)), up, left)


def is_cut_off(c: Contrast, largest: Contrast, peak: tuple[int, int], reach_px: int) -> bool:
    """Return whether the picture's border cuts off what is joined to a peak of `c` within `reach_px`.

    Joined is what is above half of its height over the ground about the `largest` things: a small thing's own
    surroundings may be filled by the rest of a large one.
    """
    row, column = peak
    height, width = c.values.shape
    up, left = max(row - reach_px, 0), max(column - reach_px, 0)
    down, right = min(row + reach_px, height - 1), min(column + reach_px, width - 1)
    sides = np.array([up == 0, left == 0, down == height - 1, right == width - 1])
    if not sides.any():
        return False
    values = c.values[up : down + 1, left : right + 1]
    rows, columns = largest.background.shape
    ground = largest.background[row * rows // height, column * columns // width]
    half = 0.5 * float(c.values[row, column] + ground)
    _, labels = cv2.connectedComponents((values > half).astype(np.uint8), connectivity=8)
    own = labels[row - up, column - left]
    ends = np.array([np.any(line == own) for line in (labels[0], labels[:, 0], labels[-1], labels[:, -1])])
    return bool(own != 0 and np.any(sides & ends))


def region_of(c: Contrast, part: Part, contrast: float) -> Region | None:
    """A part of the picture of `c`, in pixels of the picture as it was."""
    height, width = part.level.shape
    ground = c.background[part.up : part.up + height, part.left : part.left + width]
    region = region_in(c.values, ground, part)
    if region is None:
        return None
    uv, outline = ((px + 0.5) * c.times - 0.5 for px in (region.uv_px, region.outline_px))
    # The lens; in the coarser picture a pixel's width and its smoothing.
    blur_px = float(np.sqrt(LENS_PX**2 + c.times**2 * (1.0 / 12.0 + BLUR_PX**2)))
    return replace(region, uv_px=uv, outline_px=outline, contrast=contrast, pixels=c.times, blur_px=blur_px)


def is_filled(region: Region, values: Image) -> bool:
    """Return whether most of a region's outline, in a picture (H, W), holds what is above half of its height."""
    low = np.maximum(np.floor(region.outline_px.min(axis=0)), 0.0).astype(int)
    right, down = np.ceil(region.outline_px.max(axis=0)).astype(int) + 1
    part = values[low[1] : down, low[0] : right]
    inside = np.zeros(part.shape, np.uint8)
    cv2.fillPoly(inside, [np.round(region.outline_px - low).astype(np.int32)], 1)
    return float(np.mean(part[inside > 0] > region.hottest - 0.5 * region.above)) > FILLED


def above(values: Image, ground: float, contrast: Image, level: Image, least_px: float) -> list[Region]:
    """Every region of a picture (H, W) where `level` (H, W) is above 0, the largest first: whatever its size.

    `contrast` (H, W) is in sigmas of the whole picture, `ground` its usual value.
    """
    count, labels, stats, _ = cv2.connectedComponentsWithStats((level > 0.0).astype(np.uint8), connectivity=8)
    found = []
    for label in sorted(range(1, count), key=lambda k: -stats[k, cv2.CC_STAT_AREA])[:MOST_REGIONS]:
        if stats[label, cv2.CC_STAT_AREA] < least_px:
            break
        left, up, width, height = (int(n) for n in stats[label, :4])
        right, down = left + width + 1, up + height + 1
        left, up = max(left - 1, 0), max(up - 1, 0)
        inside = labels[up:down, left:right] == label
        near = level[up:down, left:right]
        part = Part(np.where(inside, near, np.minimum(near, 0.0)), up, left)
        region = region_in(values, np.full(inside.shape, ground, np.float32), part)
        if region is not None:
            size = float(contrast[up:down, left:right][inside].max())
            found.append(replace(region, contrast=size, significance=float("inf")))
    return found


def region_in(values: Image, ground: Image, part: Part) -> Region | None:
    """Return the region of a part of a picture (H, W), without contrast; `ground` (h, w) is about it."""
    height, width = values.shape
    level, up, left = part.level, part.up, part.left
    rows, columns = np.nonzero(level > 0.0)
    outline = _outline(level, int(np.clip(OUTLINE_PX // max(level.shape), 1, FINER)))
    if outline is None or not len(rows):
        return None
    outline = np.clip(outline + (left, up), -0.5, (width - 0.5, height - 0.5))
    inside = values[rows + up, columns + left]
    weight = np.maximum(level[rows, columns], 1e-6).astype(float)
    middle = np.array([weight @ (columns + left), weight @ (rows + up)]) / weight.sum()
    hottest = int(np.argmax(inside))
    is_cut = min(rows.min() + up, columns.min() + left) == 0 or rows.max() + up == height - 1
    is_cut |= columns.max() + left == width - 1
    above = float(inside[hottest] - ground[rows[hottest], columns[hottest]])
    return Region(middle, outline, 0.0, float(inside[hottest]), above, bool(is_cut))


def _outline(level: Image, finer: int) -> Array | None:
    """The outer outline (N, 2) of what is above 0, in pixels of `level`."""
    border = np.pad(level.astype(np.float32), 1, mode="edge")
    if finer > 1:
        size = (border.shape[1] * finer, border.shape[0] * finer)
        border = np.asarray(cv2.resize(border, size, interpolation=cv2.INTER_LINEAR), np.float32)
    contours, _ = cv2.findContours((border > 0.0).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not contours:
        return None
    largest = max(contours, key=cv2.contourArea)
    rough = ROUGHEST_PX * finer
    while len(largest) > MOST_POINTS:
        largest, rough = cv2.approxPolyDP(largest, rough, True), 1.5 * rough
    if len(largest) < 3:
        return None
    at = _on_level(border, np.asarray(largest[:, 0], np.int32))
    return np.asarray((at + 0.5) / finer - 0.5 - 1.0, np.float64)


def _on_level(level: Image, at: NDArray[np.int32]) -> Array:
    """Return points (N, 2) where `level` (H, W) is 0, near its pixels (N, 2) just inside.

    A contour of pixels' middles is half a pixel small: one step of Newton along the gradient, of a pixel at most.
    """
    column, row = at.T
    height, width = level.shape
    value = level[row, column].astype(float)
    left, right = np.maximum(column - 1, 0), np.minimum(column + 1, width - 1)
    up, down = np.maximum(row - 1, 0), np.minimum(row + 1, height - 1)
    slope = np.stack(
        [
            (level[row, right] - level[row, left]) / (right - left),
            (level[down, column] - level[up, column]) / (down - up),
        ],
        axis=1,
    ).astype(float)
    step = -value[:, None] * slope / np.maximum(np.sum(slope**2, axis=1, keepdims=True), 1e-12)
    size = np.hypot(*step.T)[:, None]
    return np.asarray(at + step / np.maximum(size, 1.0), float)
