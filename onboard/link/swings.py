"""The camera's turning since the set that was sent before, which a set takes along over a link that carries few."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from contract.feature_set import FeatureSet, Swing
from contract.rotations import log_so3
from onboard.link.set_selection import MEMORY_NS

STEP_S = 0.2  # a fifth of the fastest nodding that recorded planes show: what lies between is interpolated well
MOST_S = 2.0  # of a gap between sets of which anything is stated
KEPT_NS = MEMORY_NS + round(MOST_S * 1e9)  # older pictures than that are not sent


class Swings:
    """The orientations of the last pictures of a session, and what of them a set takes along."""

    def __init__(self) -> None:
        self._session = -1
        self._kept: dict[int, tuple[int, NDArray[np.float64]]] = {}  # capture, R_enu_cam, by frame

    def add(self, s: FeatureSet) -> None:
        """Keep a picture's orientation, the newest revision of it."""
        if s.session != self._session:
            self._session, self._kept = s.session, {}
        if s.is_ok:
            self._kept[s.frame] = s.capture_unix_ns, s.R_enu_cam
            oldest_ns = max(capture_ns for capture_ns, _ in self._kept.values()) - KEPT_NS
            self._kept = {frame: kept for frame, kept in self._kept.items() if kept[0] >= oldest_ns}

    def since(self, sent_ns: int, s: FeatureSet) -> Swing | None:
        """The camera's orientations between the picture that was sent before and this one, evenly; None where both are
        so near that nothing is needed, or no picture between them has a pose.
        """
        gap_s = min((s.capture_unix_ns - sent_ns) / 1e9, MOST_S)
        count = round(gap_s / STEP_S) - 1
        if not s.is_ok or count < 1:
            return None
        kept = [((s.capture_unix_ns - capture_ns) / 1e9, R) for capture_ns, R in self._kept.values()]
        between = sorted(
            ((before_s, R) for before_s, R in kept if 0.5 * STEP_S < before_s < gap_s), key=lambda entry: entry[0]
        )
        if not between:
            return None
        moments_s = np.array([before_s for before_s, _ in between])
        wanted_s = gap_s * np.arange(1, count + 1) / (count + 1)
        chosen = np.unique(np.argmin(np.abs(moments_s - wanted_s[:, None]), axis=1))
        turned = [log_so3(s.R_enu_cam.T @ between[k][1]) for k in chosen]
        return Swing(moments_s[chosen], np.array(turned))
