"""The looks of a thing that are remembered, and how well a place looks like them. (24.7), (24.21) to (24.23)

Two comparisons. By correlation, with the ground about the thing as it was; and as a picture put together: the thing
over the ground that is behind it now, against that ground alone. The second one holds where the ground changes from
dark to bright below it, and needs to know both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from onboard.tracks.backdrop import CERTAIN, Change, Patch

Array = NDArray[np.float64]
Image = NDArray[np.float32]

LEARNED = 0.3  # of what the newest picture shows of a pixel's cover, where thing and ground differ
OTHER_GREY = 64.0  # one sigma of another thing's grey levels about the ground's
OWN_SHARE = 0.5  # of pixels, that are news of their own: the lens has blurred neighbours together
TURNED_SHARE = 0.15  # of its size: how far a part of a thing may be from where it should, if it has turned
RIM_PX = 0.8  # of the lens and of what the cover was learned from
LEAST_COVER_PX = 2.0  # area of a thing, below which it is not put together


@dataclass(frozen=True, eq=False)
class Look:
    """The look of a thing: a patch about its place, how it went, and how that picture's ground has turned since.

    `cover`, of the same pixels as the patch: the share, 0 to 1, of each that is the thing's; 0 where that is not known.
    """

    stamp_ns: int
    patch: Patch
    uv_px: Array
    velocity: Array  # (2,), against the ground, px/s; 0 where its direction is not known
    turned: Array  # (2, 2): pixels then -> now
    cover: Image

    def warped(self, half: int, velocity: Array) -> tuple[Image, Image]:
        """Return how the thing and its cover should look now that it goes at `velocity`, (2 half + 1) squared."""
        back = np.linalg.inv(rotation(self.turned @ self.velocity, velocity) @ self.turned)
        middle = self.uv_px - self.patch.corner
        M = np.column_stack([back, middle - back @ np.array([half, half])])
        size = 2 * half + 1
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        image = cv2.warpAffine(self.patch.image, M, (size, size), flags=flags, borderMode=cv2.BORDER_REPLICATE)
        cover = cv2.warpAffine(self.cover, M, (size, size), flags=flags, borderValue=0.0)
        return np.asarray(image, np.float32), np.asarray(cover, np.float32)


@dataclass(frozen=True, eq=False)
class Wanted:
    """What is looked for, (2 half + 1) squared: the window's weights, which sum to 1, the kernel of the correlation
    with all looks (linear, so that one pass serves), the thing's own grey levels, and its cover. `spread`: one sigma of
    those levels from picture to picture.
    """

    mask: Image
    kernel: Image
    grey: Image
    cover: Image
    spread: float

    @classmethod
    def of(cls, looks: Sequence[Look], half: int, size_px: float, velocity: Array, spread: float) -> Wanted:
        """Return what a thing of `size_px` that goes at `velocity` should look like, by its looks."""
        axis = np.arange(2 * half + 1) - half
        soft = np.exp(-0.5 * (axis / max(0.45 * size_px, 1.2)) ** 2)
        mask = np.outer(soft, soft).astype(np.float32)
        mask /= mask.sum()
        kernel, grey, cover = np.zeros_like(mask), np.zeros_like(mask), np.zeros_like(mask)
        covered = 0
        for look in looks:
            image, its_cover = look.warped(half, velocity)
            grey += its_cover * image
            cover += its_cover
            covered += float(its_cover.sum()) >= LEAST_COVER_PX
            image = image - float((mask * image).sum())
            kernel += mask * image / np.sqrt(max(float((mask * image * image).sum()), 0.25))
        grey /= np.maximum(cover, np.float32(1e-6))
        cover /= np.float32(max(covered, 1))
        return cls(mask, kernel / np.float32(max(len(looks), 1)), grey, cover, spread)

    def likeness(self, search: Image) -> Image:
        """Return the correlation with every place, the mean of the looks; 0 where there is nothing to compare."""
        half = self.mask.shape[0] // 2
        whole = [
            cv2.filter2D(part, cv2.CV_32F, self.mask)[half:-half, half:-half] for part in (search, search * search)
        ]
        spread = np.sqrt(np.maximum(whole[1] - whole[0] ** 2, 0.25))
        out: Image = cv2.filter2D(search, cv2.CV_32F, self.kernel)[half:-half, half:-half] / spread
        return out

    def log_evidence(self, like: float) -> float:
        """Return the logarithm of how much likelier a correlation is of the thing than of another. (24.32)"""
        count = OWN_SHARE / float((self.mask * self.mask).sum())
        return -0.5 * count * float(np.log(max(1.0 - like * like, 1e-3))) if like > 0.0 else 0.0

    def others(self, surely: Image, at: Array) -> float:
        """Return how many other things of this size a square pixel of a patch shows, by what differs away from `at`."""
        half = self.mask.shape[0] // 2
        column, row = (int(n) for n in at)
        here = surely[max(row - half, 0) : row + half + 1, max(column - half, 0) : column + half + 1]
        away = surely.size - here.size
        return float(surely.sum() - here.sum()) / away / max(float(self.cover.sum()), 1.0) if away else 0.0

    @cached_property
    def has_cover(self) -> bool:
        """Return whether enough of the thing's cover is known."""
        return float(self.cover.sum()) >= LEAST_COVER_PX

    @cached_property
    def inside(self) -> tuple[Image, Image, Image]:
        """The share of each pixel that is the thing's, one sigma of it, and the thing's own grey there. (24.23)

        A pixel that is the thing's in part differs as surely as one that is it whole: near the rim the share is not
        known, and the grey is that of the rest of it.
        """
        soft = np.asarray(cv2.GaussianBlur(self.cover, (0, 0), RIM_PX, borderType=cv2.BORDER_CONSTANT), np.float32)
        share = np.clip(2.0 * soft - 1.0, 0.0, 1.0)
        usual = float((share * self.grey).sum()) / max(float(share.sum()), 1e-6)
        return share, 2.0 * soft * (1.0 - soft), share * self.grey + (1.0 - share) * np.float32(usual)

    @cached_property
    def likes(self) -> list[tuple[Image, Image, Image, float]]:
        """`inside` and one sigma of its grey; and of a thing so large that a part of it may be elsewhere than it
        should, because it has turned: with its usual grey all over it. (24.33)
        """
        share, rim, grey = self.inside
        out = [(share, rim, grey, self.spread)]
        away_px = TURNED_SHARE * float(np.sqrt(self.cover.sum()))
        if away_px > RIM_PX:
            total = max(float(share.sum()), 1e-6)
            usual = float((share * grey).sum()) / total
            spread = float(np.hypot(self.spread, np.sqrt((share * (grey - usual) ** 2).sum() / total)))
            soft = np.asarray(cv2.GaussianBlur(self.cover, (0, 0), away_px, borderType=cv2.BORDER_CONSTANT), np.float32)
            out.append((soft, 2.0 * soft * (1.0 - soft), np.full_like(grey, usual), spread))
        return out

    def log_ratio(self, image: Image, behind: Image, sigma: Image, known: Image | float = 1.0) -> float:
        """Return the logarithm of how much likelier the thing there is than another, or than the ground alone. (24.23),
        (24.33)

        All (2 half + 1) squared, about the place; `known`: 1 where a pixel speaks for any of them, 0 where it does not.
        -inf where the thing's cover is not known.
        """
        if not self.has_cover:
            return -np.inf
        off, noise, level = image - behind, sigma * sigma, float(behind.mean())

        def missed(cover: Image, grey: Image | float, variance: Image) -> float:
            return float((known * ((off - cover * (grey - behind)) ** 2 / variance + np.log(variance))).sum())

        its, others = [], []
        for cover, rim, grey, spread in self.likes:
            its.append(missed(cover, grey, noise + (cover * spread) ** 2 + (rim * (grey - behind)) ** 2))
            others.append(missed(cover, level, noise + OTHER_GREY**2 * (cover**2 + rim**2)))
        ground = float((known * (off * off / noise + np.log(noise))).sum())
        return 0.5 * OWN_SHARE * (min(*others, ground) - min(its))


def cover_of(patch: Patch, changed: Change | None, wanted: Wanted | None, uv_px: Array) -> Image:
    """Return the cover of a new look: what `wanted` had at `uv_px`, and what differs now where thing and ground do.

    Beyond what `changed` is of, and without it, the cover stays as it was.
    """
    size = patch.image.shape[0]

    def on_patch(values: Image, by: NDArray[Any], fill: float) -> Image:
        M = np.column_stack([np.eye(2), by])
        return np.asarray(cv2.warpAffine(values, M, (size, size), borderValue=fill), np.float32)

    surely = np.zeros((size, size), np.float32)
    if changed is not None:
        moved = changed.corner - patch.corner
        surely = on_patch(changed.surely, moved, 0.0)
    if wanted is None or not wanted.has_cover:
        return surely
    shift = uv_px - patch.corner - wanted.mask.shape[0] // 2
    before = on_patch(wanted.cover, shift, 0.0)
    if changed is None:
        return before
    M = np.column_stack([np.eye(2), shift])
    grey = cv2.warpAffine(wanted.inside[2], M, (size, size), borderMode=cv2.BORDER_REPLICATE)
    shows = np.abs(grey - on_patch(changed.behind, moved, 0.0)) > CERTAIN * on_patch(changed.sigma, moved, 1e6)
    return np.where(shows | (before < surely), before + np.float32(LEARNED) * (surely - before), before)


def rotation(before: Array, now: Array) -> Array:
    """Return the rotation (2, 2) from one direction (2,) to another; none where one of them is 0. (24.21)"""
    turn = complex(*now) * complex(*before).conjugate()
    if turn == 0.0:
        return np.eye(2)
    c, s = turn.real / abs(turn), turn.imag / abs(turn)
    return np.array([[c, -s], [s, c]])
