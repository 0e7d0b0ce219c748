"""A log that was written with a video, and a video: whether it is that one, whole.

Its own time is the video's as it was taken. Of one that was cut, or of another, it is not.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from onboard.telemetry.telemetry_log import TelemetryLog

# By how much a video's last frame may be before what was last written with it, or after that has ended: of frames that
# a camera still wrote, and of its length, by frame rates that are rounded (30 for 29.97).
SLACK_S, SLACK_SHARE = 0.5, 0.002


def extent_s(times_s: Sequence[float]) -> tuple[float, float] | None:
    """Return the last of times on a video's own (s), in order, and their usual spacing; None without any."""
    if not times_s:
        return None
    apart_s = sorted(later - earlier for earlier, later in itertools.pairwise(times_s))
    return times_s[-1], apart_s[len(apart_s) // 2] if apart_s else 0.0


def another_length(log: TelemetryLog, last_s: float) -> str:
    """Return in words why a video whose last frame is shown at `last_s` is not the one, whole, that a log was written
    with; empty where it may be, or the log was written with none.

    The last text of a file that was cut off is left out, so that one spacing more may be missing.
    """
    if log.video_epoch_ns is None or log.video_s is None:
        return ""
    written_s, apart_s = log.video_s
    slack_s = SLACK_S + SLACK_SHARE * written_s
    if written_s - slack_s <= last_s <= written_s + 2.0 * apart_s + slack_s:
        return ""
    return f"its log is of a video of {written_s + apart_s:.1f} s and it has {last_s:.1f} s: it was cut, or is another"
