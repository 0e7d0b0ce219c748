"""A set as one packet: thinned until it fits, if it must be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from contract.feature_set import FeatureSet
from contract.wire.codec import encode

# Within one packet on every kind of link, quic's being the smallest (1250 B measured).
MAX_PAYLOAD = 1250
STEP = 4  # features dropped at a time


def one_packet(feature_set: FeatureSet, payload: bytes | None = None, max_bytes: int = MAX_PAYLOAD) -> bytes:
    """The payload of a set in at most `max_bytes`; `payload` if the set is already encoded. Raises ValueError.

    Where all features do not fit, those nearest to another go first: the ground between loses least by them, and the
    hull, within which clicks are answered, next to nothing. A set without features always fits.
    """
    if payload is None:
        payload = encode(feature_set)
    thinned = feature_set
    while len(payload) > max_bytes and len(thinned):
        keep = _without_the_crowded(thinned.uv_px, min(STEP, len(thinned)))
        thinned = replace(
            thinned,
            uv_px=thinned.uv_px[keep],
            inverse_depth_per_m=thinned.inverse_depth_per_m[keep],
            sigma_inverse_depth_per_m=thinned.sigma_inverse_depth_per_m[keep],
        )
        payload = encode(thinned)
    return payload


def _without_the_crowded(uv_px: np.ndarray, count: int) -> np.ndarray:
    """Return a mask (N,) of the pixels (N, 2) that stay when the `count` nearest to another go, one by one."""
    keep = np.ones(len(uv_px), bool)
    squared = np.sum((uv_px[:, None] - uv_px[None]) ** 2, axis=2)
    np.fill_diagonal(squared, np.inf)
    for _ in range(count):
        crowded = int(np.argmin(np.where(keep, squared.min(axis=1), np.inf)))
        keep[crowded] = False
        squared[crowded, :] = squared[:, crowded] = np.inf
    return keep
