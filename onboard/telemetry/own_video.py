"""A log that was written with a video, and a video: whether it is that one, whole.

Its own time is the video's as it was taken. Of one that was cut, or of another, it is not.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from pathlib import Path

from onboard.telemetry.mp4_container import first_picture_s
from onboard.telemetry.telemetry_log import NS_PER_S, TelemetryLog

# By how much a video's last frame may be before what was last written with it, or after that has ended: of frames that
# a camera still wrote, and of its length, by frame rates that are rounded (30 for 29.97).
SLACK_S, SLACK_SHARE = 0.5, 0.002


def extent_s(times_s: Sequence[float]) -> tuple[float, float] | None:
    """Return the last of times on a video's own (s), in order, and their usual spacing; None without any."""
    if not times_s:
        return None
    apart_s = sorted(later - earlier for earlier, later in itertools.pairwise(times_s))
    return times_s[-1], apart_s[len(apart_s) // 2] if apart_s else 0.0


def began_ns(log: TelemetryLog, paths: Sequence[Path | str], video: Path | str) -> int | None:
    """Return when the first picture of a video was taken, by the log from `paths` that was written with it (Unix ns);
    None of a log that was written with none.

    Subtitles next to it count from where its own time begins, tracks in it from its first picture.
    """
    if log.video_epoch_ns is None or all(Path(path) == Path(video) for path in paths):
        return log.video_epoch_ns
    return log.video_epoch_ns + round(first_picture_s(Path(video)) * NS_PER_S)


def cut_sigma_s(log: TelemetryLog, end_s: float) -> float:
    """Return one sigma, s, of what may have been cut off the beginning of a video that lasts until `end_s`, by the log
    that was written with it: anything up to what it lacks of this, evenly.
    """
    if log.video_epoch_ns is None or log.video_s is None:
        return 0.0
    return max(log.video_s[0] - end_s, 0.0) / math.sqrt(3.0)


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
