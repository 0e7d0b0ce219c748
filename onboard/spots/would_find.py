"""The share of a picture's ground on which a person would be found now. (25.23)"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from contract.spot import PERSON_K, PERSON_M2
from onboard.spots.contrast import Contrast, contrast
from onboard.spots.regions import LENS_PX

Array = NDArray[np.float64]

FINER = 8  # parts to the side of a pixel, of which a person's picture is made
PLACES = 2  # to the side of a pixel, at which a person may stand in it
SIDE_PX = 96  # of that picture
PIXEL_STEP = 0.05  # of a pixel, by which sizes differ that are computed by themselves


def share_found(contrasts: Sequence[Contrast], thresholds: Mapping[float, float], pixel_m: float) -> float:
    """The share of the ground on which PERSON_K above it and PERSON_M2 large is found by any of the sizes.

    `contrasts` are a calibrated picture's, by size; `thresholds` what each size must have, in sigmas of the clutter.
    """
    found = None
    stepped_m = float(np.exp(round(np.log(pixel_m) / PIXEL_STEP) * PIXEL_STEP))
    for c in contrasts:
        excess = PERSON_K * _excess(c.side_m, stepped_m)
        share = np.where(c.is_ground, ndtr(excess / c.clutter - thresholds[c.side_m]), np.nan)
        coarse = np.asarray(cv2.resize(share, contrasts[0].clutter.shape[::-1], interpolation=cv2.INTER_NEAREST), float)
        found = coarse if found is None else np.fmax(found, coarse)
    return 0.0 if found is None or not np.isfinite(found).any() else float(np.nanmean(found))


@lru_cache(maxsize=256)
def _excess(side_m: float, pixel_m: float) -> float:
    """Return how far a person of 1 K stands out of level ground, K, for things of `side_m`. (25.3)

    The mean over where in a pixel it stands.
    """
    side_px = np.sqrt(PERSON_M2) / pixel_m
    excess = []
    is_ground = np.ones((4, 4), bool)
    for at in np.ndindex(PLACES, PLACES):
        middle = 0.5 * SIDE_PX + (np.array(at) + 0.5) / PLACES
        edges = (np.arange(SIDE_PX * FINER) + 0.5) / FINER
        inside = [np.abs(edges - m) < 0.5 * side_px for m in middle]
        fine = np.outer(*inside).astype(np.float32)
        pixels = fine.reshape(SIDE_PX, FINER, SIDE_PX, FINER).mean(axis=(1, 3))
        seen = np.asarray(cv2.GaussianBlur(pixels, (0, 0), LENS_PX), np.float32)
        excess.append(float(contrast(seen, is_ground, side_m, pixel_m).excess.max()))
    return float(np.mean(excess))
