"""The ground behind a thing, from earlier pictures when the thing was elsewhere. (24.3) to (24.5)"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from onboard.tracks.ground_steps import Grey, Pictures, Seen

Array = NDArray[np.float64]
Image = NDArray[np.float32]
Mask = NDArray[np.bool_]

AGES_S = (0.4, 0.7, 1.2, 1.9, 3.0)
SAME_S = 0.15  # pictures closer together than this count as one
STRIDE, ROUNDS = 4, 2  # of the fit: every so many pixels, so often weighed again
MISFIT_PX = 0.4  # one sigma of what is left of the misfit between two pictures
LEAST_SHIFT_PX = 0.08  # for which a layer is rendered again
LEAST_NOISE = 1.0  # grey levels
LIFT_SHARE = 1.5  # of a thing's size, within which the ground about it becomes brighter or darker as one
END_GREY = 2.0  # grey levels from a picture's darkest or brightest, within which a pixel may be clipped
NEAR_PX = 2.0  # one sigma of how far what differs about a pixel counts for one of which nothing is known
CLEAR, CERTAIN = 2.5, 6.0  # sigmas at which a pixel begins to count as something else, and at which it is
LEAST_NEAR = 0.05  # of a weight, below which a pixel has no neighbours that are known
LEAST_COMMON = 0.6  # of what a patch has of its picture: an earlier one that shows less of it does not count
AROUND = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


@dataclass(frozen=True, eq=False)
class Patch:
    """A square of a picture: its pixels (S, S), float32, and the picture's pixel that its own (0, 0) is.

    `inside` (S, S): those that the picture has, where it does not have them all; the others repeat its edge.
    """

    image: Image
    corner: NDArray[np.int64]
    inside: Mask | None = None

    @property
    def middle(self) -> int:
        """The column, and the row, of its middle."""
        return int(self.image.shape[0] - 1) // 2


def cut(seen: Seen, centre: Array, half: int) -> Patch:
    """The square of 2 half + 1 pixels about a place."""
    corner = np.rint(centre).astype(np.int64) - half
    height, width = seen.image.shape
    if (corner >= 0).all() and corner[0] + 2 * half < width and corner[1] + 2 * half < height:
        at = slice(corner[1], corner[1] + 2 * half + 1), slice(corner[0], corner[0] + 2 * half + 1)
        return Patch(seen.image[at].astype(np.float32), corner)
    along = np.arange(2 * half + 1)
    rows, columns = corner[1] + along, corner[0] + along
    image = seen.image[np.clip(rows, 0, height - 1)[:, None], np.clip(columns, 0, width - 1)]
    inside = ((rows >= 0) & (rows < height))[:, None] & ((columns >= 0) & (columns < width))
    return Patch(image.astype(np.float32), corner, inside)


def earlier(pictures: Pictures, seen: Seen) -> list[Seen]:
    """Kept pictures about AGES_S before one, newest first."""
    before = [other for other in pictures if other.stamp_ns < seen.stamp_ns and other.to_newest is not None]
    stamps = [other.stamp_ns for other in before]  # in capture order
    out: list[Seen] = []
    for age_s in AGES_S:
        wanted = seen.stamp_ns - round(age_s * 1e9)
        after = bisect_left(stamps, wanted)
        nearest = before[max(after - 1, 0) : after + 1]
        best = min(nearest, key=lambda other: abs(other.stamp_ns - wanted), default=None)
        if best is None or abs(best.stamp_ns - wanted) > 0.3e9:
            continue
        if not any(abs(best.stamp_ns - other.stamp_ns) < SAME_S * 1e9 for other in out):
            out.append(best)
    return out


@dataclass(frozen=True, eq=False)
class Change:
    """The sureness, 0 to 1, that each pixel of a patch (S, S) shows what was not there before; what was there, and one
    sigma of what it would look like now, grey levels. `corner` is the patch's. `shown` (S, S): where earlier pictures
    show the ground, where not everywhere. `unknown` (S, S): where both may be the same beyond an end of what a picture
    can show, if anywhere; `surely` is there what the pixels about it suggest.
    """

    corner: NDArray[np.int64]
    surely: Image
    behind: Image
    sigma: Image
    shown: Mask | None = None
    unknown: Mask | None = None


@dataclass(frozen=True, eq=False)
class _Clipped:
    """The pixels (S, S) at which a picture, or the ground of earlier ones, may be darker or brighter than it shows."""

    low_now: Mask
    high_now: Mask
    low_behind: Mask
    high_behind: Mask


def difference(
    pictures: Pictures, seen: Seen, patch: Patch, size_px: float, since: Seen | None = None
) -> Change | None:
    """Return what has changed in a patch, or what has `since` one picture. (24.5)

    None without at least two earlier pictures of the same ground, or that one; 0 where pictures do not reach.
    """
    layers, known, clipped = _aligned(pictures, seen, patch, earlier(pictures, seen) if since is None else [since])
    if len(layers) < (2 if since is None else 1):
        return None
    behind, shown = _middle(layers) if len(layers) > 2 else layers[-1], None
    if known is not None:
        shown = known.sum(axis=0) >= min(len(layers), 2)
        middle = np.nanmedian(np.where(known | ~shown, layers, np.nan), axis=0)
        behind = np.where(shown, middle, patch.image).astype(np.float32)
    behind = behind + _lift(patch.image - behind, size_px)
    off = np.abs(patch.image - behind)
    is_bound = None if clipped is None else _bounded(patch.image - behind, off, clipped)
    counted = off if is_bound is None or is_bound.all() else off[~is_bound]
    noise = max(1.48 * _median(counted), LEAST_NOISE)
    unknown = None
    if is_bound is not None:
        low, high = seen.ends()
        is_bound |= (behind >= high - CLEAR * noise) | (behind <= low + CLEAR * noise)
        unknown = is_bound & (off <= CLEAR * noise)
    dx, dy = cv2.Sobel(behind, cv2.CV_32F, 1, 0, scale=0.125), cv2.Sobel(behind, cv2.CV_32F, 0, 1, scale=0.125)
    sigma = np.sqrt(noise * noise + MISFIT_PX**2 * (dx * dx + dy * dy))
    surely: Image = np.clip((off / sigma - CLEAR) / (CERTAIN - CLEAR), 0.0, 1.0)
    if unknown is not None:
        surely = suggested(surely, ~unknown)
    return Change(patch.corner, surely, behind, sigma, shown, unknown)


def _lift(off: Image, size_px: float) -> Image:
    """Return how much brighter the ground is than it was, about each pixel; `off` (S, S): picture less ground. (24.31)

    Gusts through crops, and clouds, change it by areas larger than a thing. Nothing where no more varies than noise.
    """
    width = 2 * int(np.ceil(LIFT_SHARE * size_px)) + 1
    noise = max(1.48 * _median(np.abs(off)), LEAST_NOISE)
    weight = 1.0 / (1.0 + (off / (2.0 * noise)) ** 2)
    near = cv2.blur(weight * off, (width, width)) / cv2.blur(weight, (width, width))
    varies = (1.48 * _median(np.abs(near))) ** 2
    by_noise = noise * noise / (width * width)
    return np.asarray(near * np.float32(max(0.0, 1.0 - by_noise / max(varies, 1e-6))), np.float32)


def _middle(layers: Image) -> Image:
    """The median (S, S) of layers (L, S, S): so few are sorted sooner pair by pair than by NumPy."""
    rows = list(layers)
    for last in range(len(rows) - 1, (len(rows) - 1) // 2 - 1, -1):
        for i in range(last):
            rows[i], rows[i + 1] = np.minimum(rows[i], rows[i + 1]), np.maximum(rows[i], rows[i + 1])
    half = len(rows) // 2
    return np.asarray(rows[half] if len(rows) % 2 else 0.5 * (rows[half - 1] + rows[half]), np.float32)


def _median(values: Image) -> float:
    return float(np.partition(values, values.size // 2, axis=None)[values.size // 2])


def _bounded(more: Image, off: Image, clipped: _Clipped) -> Mask:
    """(24.28): make of the differences `off` (S, S) the least that they may be where a picture is clipped; return where
    that is none. `more`: picture less ground; `clipped`: where either is.
    """
    # A picture at its darkest may be darker, a ground at its brightest brighter: then it is not more.
    is_least, is_most = clipped.low_now | clipped.high_behind, clipped.high_now | clipped.low_behind
    off[(is_least & (more > 0.0)) | (is_most & (more <= 0.0))] = 0.0
    return (is_least | is_most) & (off <= END_GREY)


def suggested(surely: Image, known: Mask) -> Image:
    """How surely each pixel differs: of one that is not known the mean of those within NEAR_PX, 0 where none is."""
    weight = known.astype(np.float32)
    near, total = (cv2.GaussianBlur(one, (0, 0), NEAR_PX) for one in (weight, weight * surely))
    return np.where(known, surely, total / np.maximum(near, np.float32(LEAST_NEAR)))


def _aligned(
    pictures: Pictures, seen: Seen, patch: Patch, others: Sequence[Seen]
) -> tuple[Image, Mask | None, _Clipped | None]:
    """The patch's ground in earlier pictures (L, S, S), shifted and brightened to fit, which pixels (L, S, S) both
    pictures have, where not all, and where they are clipped, if anywhere; those that show most of what the patch has.
    """
    size = patch.image.shape[0]
    here = np.array([[1.0, 0.0, patch.corner[0]], [0.0, 1.0, patch.corner[1]], [0.0, 0.0, 1.0]])
    corners = np.column_stack([(AROUND + 1.0) * 0.5 * (size - 1), np.ones(4)])
    ways: list[tuple[Seen, Array]] = []
    reached: list[Mask | None] = []
    for other in others:
        H = pictures.between(seen, other)
        if H is None:
            continue
        to = corners @ (H @ here).T
        height, width = other.image.shape
        if (to[:, 2] <= 0.0).any():
            continue
        at = to[:, :2] / to[:, 2:]
        is_whole = (at >= 1.0).all() and (at <= (width - 2.0, height - 2.0)).all()
        both = None if is_whole and patch.inside is None else _common(H @ here, size, width, height, patch.inside)
        has = size * size if patch.inside is None else int(np.count_nonzero(patch.inside))
        if both is None or np.count_nonzero(both) >= LEAST_COMMON * has:
            ways.append((other, H @ here))
            reached.append(both)
    layers = np.zeros((len(ways), size, size), np.float32)
    if not ways:
        return layers, None, None
    known = None
    if any(both is not None for both in reached):
        known = np.stack([np.ones((size, size), bool) if both is None else both for both in reached])
    for layer, (other, M) in zip(layers, ways, strict=True):
        layer[:] = _warped(other, M, size)
    now, ends = _ends(patch.image[None], [seen]), _ends(layers, [other for other, _ in ways])
    is_clipped = bool((now[0] | now[1]).any() or (ends[0] | ends[1]).any())
    shift, gain, lift = _fit(patch.image, layers, known)
    for layer, (other, M), by in zip(layers, ways, shift, strict=True):
        if np.abs(by).max() > LEAST_SHIFT_PX:
            moved = np.array([[1.0, 0.0, by[0]], [0.0, 1.0, by[1]], [0.0, 0.0, 1.0]])
            layer[:] = _warped(other, M @ moved, size)
    clipped = None
    if is_clipped:
        low, high = (_mostly(each, known) for each in _ends(layers, [other for other, _ in ways]))
        clipped = _Clipped(now[0][0], now[1][0], low, high)
    layers *= gain[:, None, None].astype(np.float32)
    layers += lift[:, None, None].astype(np.float32)
    return layers, known, clipped


def _ends(images: Image, of: Sequence[Seen]) -> tuple[Mask, Mask]:
    """Where parts (L, S, S) of pictures may be clipped: at their darkest, and at their brightest."""
    low, high = np.array([seen.ends() for seen in of], np.float32).T[:, :, None, None]
    return images <= low + END_GREY, images >= high - END_GREY


def _mostly(ends: Mask, known: Mask | None) -> Mask:
    """Where the median of layers (L, S, S) is clipped; of two, as in `difference`, the last."""
    if len(ends) <= 2 and known is None:
        return np.asarray(ends[-1])
    count = len(ends) if known is None else known.sum(axis=0)
    return np.asarray(2 * (ends if known is None else ends & known).sum(axis=0) > count)


def _common(M: Array, size: int, width: int, height: int, inside: Mask | None) -> Mask:
    """The pixels (S, S) of a patch that its own picture and another one have; M: its pixels -> the other's."""
    columns, rows = np.meshgrid(np.arange(float(size)), np.arange(float(size)))
    u, v, w = (m[0] * columns + m[1] * rows + m[2] for m in M)
    both = (u >= w) & (u <= (width - 2.0) * w) & (v >= w) & (v <= (height - 2.0) * w)
    return np.asarray(both if inside is None else both & inside)


def _warped(other: Seen, M: Array, size: int) -> Grey:
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpPerspective(other.image, M, (size, size), flags=flags), np.uint8)


def _fit(image: Image, layers: Image, known: Mask | None) -> tuple[Array, Array, Array]:
    """(24.4): shifts (L, 2), px, gains (L,) and lifts (L,) that bring layers (L, S, S) onto an image (S, S) as well as
    may be, whatever covers a part of it; by the pixels `known`, if not all are. All at once: each alone is too small to
    be worth a call of NumPy.
    """
    inner = slice(1, -1, STRIDE)
    before, after = slice(None, -2, STRIDE), slice(2, None, STRIDE)
    count = len(layers)
    b = layers[:, inner, inner].reshape(count, -1)
    A = np.empty((count, 4, b.shape[1]), np.float32)
    np.subtract(layers[:, inner, after].reshape(count, -1), layers[:, inner, before].reshape(count, -1), out=A[:, 0])
    np.subtract(layers[:, after, inner].reshape(count, -1), layers[:, before, inner].reshape(count, -1), out=A[:, 1])
    A[:, :2] *= 0.5
    middle = b.mean(axis=1)
    np.subtract(b, middle[:, None], out=A[:, 2])
    A[:, 3] = 1.0
    off = image[inner, inner].ravel() - b
    x = np.zeros((count, 4))
    blank = None if known is None else ~known[:, inner, inner].reshape(count, -1)
    x[:, 3] = _medians(off, blank)
    for _ in range(ROUNDS):
        miss = off - np.einsum("lk,lkn->ln", x.astype(np.float32), A)
        scale = np.maximum(1.48 * _medians(np.abs(miss), blank), 0.5)
        weight = 1.0 / (1.0 + (miss / (2.0 * scale[:, None])) ** 2)
        if blank is not None:
            weight[blank] = 0.0
        W = A * weight[:, None].astype(np.float32)
        N = (W @ A.transpose(0, 2, 1)).astype(float) + 1e-3 * np.eye(4)
        x = np.linalg.solve(N, (W @ off[:, :, None].astype(np.float32)).astype(float))[..., 0]
    gain = 1.0 + x[:, 2]
    return np.clip(x[:, :2] / np.maximum(gain, 0.5)[:, None], -2.0, 2.0), gain, x[:, 3] - x[:, 2] * middle


def _medians(values: Image, blank: Mask | None) -> Array:
    """The median of each row, without what is blank."""
    if blank is None:  # a third of what NumPy's own takes of so few
        half = (values.shape[1] - 1) // 2, values.shape[1] // 2
        return np.asarray(np.partition(values, half, axis=1)[:, half].mean(axis=1), float)
    none = np.asarray(blank.all(axis=1))
    return np.where(none, 0.0, np.nanmedian(np.where(blank & ~none[:, None], np.nan, values), axis=1))
