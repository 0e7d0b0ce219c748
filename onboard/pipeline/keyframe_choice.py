"""When a picture becomes a keyframe: once enough has moved, turned or been lost since the last one."""

from __future__ import annotations

import numpy as np

from onboard.geometry.robust import middle
from onboard.vision.klt_tracker import Tracks

KEYFRAME_SHIFT = 0.10  # median motion, as a share of the picture's width, that makes a keyframe
KEYFRAME_TRACKS = 0.65  # share of features still followed below which a keyframe is made
KEYFRAME_TURN_RAD = 0.30


def wants_keyframe(tracks: Tracks, width_px: int) -> bool:
    """Whether the picture with these tracks should be the next keyframe."""
    shift = middle(np.linalg.norm(tracks.uv_px - tracks.keyframe_uv_px, axis=1))
    linear = tracks.motion[:2, :2]
    turn = abs(float(np.arctan2(linear[1, 0] - linear[0, 1], linear[0, 0] + linear[1, 1])))
    return (
        shift > KEYFRAME_SHIFT * width_px or len(tracks) < KEYFRAME_TRACKS * tracks.offered or turn > KEYFRAME_TURN_RAD
    )
