"""The camera's turning before its picture <-> bytes: section 6.2 of docs/wire-format.md."""

from __future__ import annotations

import math
import struct

import numpy as np

from contract.errors import CorruptPayload
from contract.feature_set import Swing
from contract.wire.byte_cursor import ByteCursor

MOST = 31  # moments
MOMENT_STEP_S = 0.008
MOST_STEPS = 255  # from one moment to the next
MOST_TURNED = 127  # steps, in each component
FINEST_RAD = 2.0**-11  # step of code 0; each code doubles it, so that what is rounded keeps its code
MOST_CODE = 7

_HEAD = struct.Struct("<B")  # how many moments, and in the three high bits the code of the step
_MOMENT = struct.Struct("<B3b")


def encode_swing(swing: Swing) -> bytes:
    """Raises ValueError."""
    before_s, turned_rad = np.asarray(swing.before_s, float), np.asarray(swing.turned_cam_rad, float)
    count = len(before_s)
    if not (1 <= count <= MOST and turned_rad.shape == (count, 3) and np.all(np.isfinite(turned_rad))):
        raise ValueError(f"a swing has 1 to {MOST} moments with three finite numbers each, not {turned_rad.tolist()}")
    moments = np.rint(before_s / MOMENT_STEP_S) if np.all(np.isfinite(before_s)) else np.zeros(count)
    apart = np.diff(moments, prepend=0.0)
    if not np.all((apart >= 1.0) & (apart <= MOST_STEPS)):
        most_s = MOMENT_STEP_S * MOST_STEPS
        raise ValueError(f"a swing's moments must rise by {MOMENT_STEP_S} to {most_s} s, not {before_s.tolist()}")
    largest = float(np.max(np.abs(turned_rad))) / (MOST_TURNED * FINEST_RAD)
    code = max(math.ceil(math.log2(largest)), 0) if largest > 0.0 else 0
    if code > MOST_CODE:
        raise ValueError(f"a swing turns by {MOST_TURNED * FINEST_RAD * 2**MOST_CODE:.1f} rad at most")
    steps = np.rint(turned_rad / (FINEST_RAD * 2.0**code)).astype(int)
    rows = zip(apart.astype(int).tolist(), steps.tolist(), strict=True)
    return _HEAD.pack(count | code << 5) + b"".join(_MOMENT.pack(moment, *turned) for moment, turned in rows)


def decode_swing(cursor: ByteCursor) -> Swing | None:
    """Inverse of `encode_swing`; None where there is none. Raises CorruptPayload."""
    (head,) = cursor.unpack(_HEAD)
    rows = np.array([cursor.unpack(_MOMENT) for _ in range(head & MOST)], float)
    if not len(rows):
        return None
    if not np.all(rows[:, 0]):
        raise CorruptPayload("two moments of a swing are the same")
    return Swing(np.cumsum(rows[:, 0]) * MOMENT_STEP_S, rows[:, 1:] * (FINEST_RAD * 2.0 ** (head >> 5)))
