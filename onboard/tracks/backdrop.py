"""What lies behind a thing: the same ground in earlier pictures, when the thing was elsewhere. (22.3) to (22.5)"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from onboard.tracks.ground_steps import Pictures, Seen

Array = NDArray[np.float64]
Image = NDArray[np.float32]

AGES_S = (0.4, 0.7, 1.2, 1.9, 3.0)
SAME_S = 0.15  # pictures closer together than this count as one
STRIDE, ROUNDS = 4, 2  # of the fit: every so many pixels, so often weighed again
MISFIT_PX = 0.4  # one sigma of what is left of the misfit between two pictures
LEAST_NOISE = 1.0  # grey levels
CLEAR, CERTAIN = 2.5, 6.0  # sigmas at which a pixel begins to count as something else, and at which it is
AROUND = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


@dataclass(frozen=True, eq=False)
class Patch:
    """A square of a picture: its pixels (S, S), float32, and the picture's pixel that its own (0, 0) is."""

    image: Image
    corner: NDArray[np.int64]


def cut(seen: Seen, centre: Array, half: int) -> Patch | None:
    """The square of 2 half + 1 pixels about a place; None where it is not all on the picture."""
    corner = np.rint(centre).astype(np.int64) - half
    height, width = seen.image.shape
    if (corner < 0).any() or corner[0] + 2 * half >= width or corner[1] + 2 * half >= height:
        return None
    at = slice(corner[1], corner[1] + 2 * half + 1), slice(corner[0], corner[0] + 2 * half + 1)
    return Patch(seen.image[at].astype(np.float32), corner)


def earlier(pictures: Pictures, seen: Seen) -> list[Seen]:
    """Kept pictures about AGES_S before one, newest first."""
    before = [other for other in pictures if other.stamp_ns < seen.stamp_ns and other.to_newest is not None]
    out: list[Seen] = []
    for age_s in AGES_S:
        wanted = seen.stamp_ns - round(age_s * 1e9)
        best = min(before, key=lambda other: abs(other.stamp_ns - wanted), default=None)
        if best is None or abs(best.stamp_ns - wanted) > 0.3e9:
            continue
        if not any(abs(best.stamp_ns - other.stamp_ns) < SAME_S * 1e9 for other in out):
            out.append(best)
    return out


def difference(pictures: Pictures, seen: Seen, patch: Patch) -> Image | None:
    """How surely each pixel of a patch (S, S) shows something that was not there before, 0 to 1. (22.5)

    None without at least two earlier pictures of the same ground.
    """
    found = [_aligned(pictures, seen, other, patch) for other in earlier(pictures, seen)]
    layers = [layer for layer in found if layer is not None]
    if len(layers) < 2:
        return None
    behind = np.median(np.stack(layers), axis=0) if len(layers) > 2 else layers[-1]
    off = patch.image - behind
    noise = max(1.48 * float(np.median(np.abs(off))), LEAST_NOISE)
    dx, dy = cv2.Sobel(behind, cv2.CV_32F, 1, 0, scale=0.125), cv2.Sobel(behind, cv2.CV_32F, 0, 1, scale=0.125)
    sigma = np.sqrt(noise * noise + MISFIT_PX**2 * (dx * dx + dy * dy))
    out: Image = np.clip((np.abs(off) / sigma - CLEAR) / (CERTAIN - CLEAR), 0.0, 1.0).astype(np.float32)
    return out


def _aligned(pictures: Pictures, seen: Seen, other: Seen, patch: Patch) -> Image | None:
    """The patch's ground in another picture, shifted and brightened to fit; None where that does not show all of it."""
    H = pictures.between(seen, other)
    if H is None:
        return None
    size = patch.image.shape[0]
    M = H @ np.array([[1.0, 0.0, patch.corner[0]], [0.0, 1.0, patch.corner[1]], [0.0, 0.0, 1.0]])
    corners = np.column_stack([(AROUND + 1.0) * 0.5 * (size - 1), np.ones(4)]) @ M.T
    height, width = other.image.shape
    if (corners[:, 2] <= 0.0).any():
        return None
    at = corners[:, :2] / corners[:, 2:]
    if (at < 1.0).any() or (at > (width - 2.0, height - 2.0)).any():
        return None
    behind = _warped(other, M, size)
    shift, gain, lift = _fit(patch.image, behind)
    if np.abs(shift).max() > 0.08:
        M = M @ np.array([[1.0, 0.0, shift[0]], [0.0, 1.0, shift[1]], [0.0, 0.0, 1.0]])
        behind = _warped(other, M, size)
    return np.asarray(np.float32(gain) * behind + np.float32(lift), np.float32)


def _warped(other: Seen, M: Array, size: int) -> Image:
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpPerspective(other.image, M, (size, size), flags=flags), np.float32)


def _fit(image: Image, behind: Image) -> tuple[Array, float, float]:
    """(22.4): the shift (px) of `behind`, its gain and lift, that bring it onto `image`, whatever covers a part."""
    b = behind[1:-1:STRIDE, 1:-1:STRIDE].ravel()
    dx = 0.5 * (behind[1:-1:STRIDE, 2::STRIDE] - behind[1:-1:STRIDE, :-2:STRIDE]).ravel()
    dy = 0.5 * (behind[2::STRIDE, 1:-1:STRIDE] - behind[:-2:STRIDE, 1:-1:STRIDE]).ravel()
    target = image[1:-1:STRIDE, 1:-1:STRIDE].ravel()
    middle = float(b.mean())
    A = np.stack([dx, dy, b - middle, np.ones_like(b)], axis=1).astype(float)
    off = (target - b).astype(float)
    x = np.array([0.0, 0.0, 0.0, float(np.median(off))])
    for _ in range(ROUNDS):
        miss = off - A @ x
        scale = max(1.48 * float(np.median(np.abs(miss))), 0.5)
        weight = 1.0 / (1.0 + (miss / (2.0 * scale)) ** 2)
        W = A * weight[:, None]
        x = np.linalg.solve(W.T @ A + 1e-3 * np.eye(4), W.T @ off)
    gain = 1.0 + x[2]
    return np.clip(x[:2] / max(gain, 0.5), -2.0, 2.0), gain, float(x[3] - x[2] * middle)
