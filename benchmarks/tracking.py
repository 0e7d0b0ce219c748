"""A whole tracking step against raw Lucas-Kanade, 640x480, 100 features, one thread.

    python -m benchmarks.tracking [--seconds 14] [--passes 3]

Ours is `Tracker.track` (normalising, starting values, LK, verification) plus `Tracker.promote` shared out over the
pictures between keyframes. Raw is `cv2.calcOpticalFlowPyrLK` of the same pair of pictures, the same points, window and
levels, plus `cv2.goodFeaturesToTrack` as often as we make keyframes. Two more rows make raw LK cheaper than a tracker
could have it: consecutive pictures instead of keyframe and picture, and our own starting values given away.
All are timed in turn on every picture; processor time, medians.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from benchmarks.machine import describe, load, table, verdict

# isort: split
import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.short_flight import leg
from onboard.geometry.plane_homography import move
from onboard.pipeline.keyframes import wants_keyframe
from onboard.vision.klt_tracker import LEVELS, MIN_EIGENVALUE, MIN_QUALITY, WINDOW_PX, Tracker, Tracks

Picture = NDArray[np.uint8]
FEATURES = 100
GOAL = 1.6
_CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 20, 0.01)


@dataclass
class Times:
    """Microseconds of each picture, by what was done; `keyframes` counts promotions."""

    step: list[float] = field(default_factory=list)
    promote: list[float] = field(default_factory=list)
    same_pair: list[float] = field(default_factory=list)
    guessed: list[float] = field(default_factory=list)
    consecutive: list[float] = field(default_factory=list)
    detect: list[float] = field(default_factory=list)
    tracks: list[int] = field(default_factory=list)

    @property
    def per_picture(self) -> float:
        """Keyframes a picture."""
        return len(self.promote) / max(len(self.step), 1)


def _us(run: Callable[[], object]) -> float:
    began = time.process_time_ns()
    run()
    return (time.process_time_ns() - began) / 1e3


def raw(first: Picture, second: Picture, at: NDArray[np.float32], guess: NDArray[np.float32] | None) -> None:
    """Plain LK of a pair with our window, levels and criteria."""
    cv2.calcOpticalFlowPyrLK(
        first,
        second,
        at,
        at.copy() if guess is None else guess.copy(),
        winSize=(WINDOW_PX, WINDOW_PX),
        maxLevel=LEVELS,
        criteria=_CRITERIA,
        flags=0 if guess is None else cv2.OPTFLOW_USE_INITIAL_FLOW,
        minEigThreshold=MIN_EIGENVALUE,
    )


def measure(pictures: Sequence[Picture], passes: int) -> Times:
    """Follow the pictures `passes` times over, everything timed in turn on each."""
    out = Times()
    height, width = pictures[0].shape
    for _ in range(passes):
        tracker = Tracker((width, height), FEATURES)
        tracker.track(pictures[0], None)
        tracker.promote(tracker.nothing())
        key = before = pictures[0]
        motion = np.eye(3)
        for picture in pictures[1:]:
            at = tracker.keyframe_features[1]
            points = at.astype(np.float32)
            found: list[Tracks] = []
            out.step.append(_us(lambda p=picture, t=tracker, f=found: f.append(t.track(p, None))))  # type: ignore[misc]
            tracks = found[0]
            guess = move(motion, at).astype(np.float32)
            out.same_pair.append(_us(lambda a=key, b=picture, p=points: raw(a, b, p, None)))  # type: ignore[misc]
            out.guessed.append(_us(lambda a=key, b=picture, p=points, g=guess: raw(a, b, p, g)))  # type: ignore[misc]
            here = tracks.uv_px.astype(np.float32)
            out.consecutive.append(_us(lambda a=before, b=picture, p=here: raw(a, b, p, None)))  # type: ignore[misc]
            out.tracks.append(len(tracks))
            before, motion = picture, tracks.motion
            if not len(tracks) or wants_keyframe(tracks, (width, height)):
                out.promote.append(_us(lambda t=tracker, f=tracks: t.promote(f)))  # type: ignore[misc]
                spacing = tracker.min_distance_px
                out.detect.append(
                    _us(lambda p=picture, s=spacing: cv2.goodFeaturesToTrack(p, FEATURES, MIN_QUALITY, s, blockSize=7))  # type: ignore[misc]
                )
                key, motion = picture, np.eye(3)
    return out


def report(pictures: Sequence[Picture], rates: Sequence[tuple[str, int]], passes: int = 1) -> str:
    """The table: for each rate (its name, and every how many pictures), costs and ratios."""
    rows, verdicts = [], []
    for name, stride in rates:
        times = measure(pictures[::stride], passes)
        share = times.per_picture
        ours = float(np.median(times.step)) + share * float(np.mean(times.promote or [0.0]))
        detect = share * float(np.mean(times.detect or [0.0]))
        mean_ours = float(np.mean(times.step)) + share * float(np.mean(times.promote or [0.0]))
        for label, raw_us in (
            ("raw LK, same pair", times.same_pair),
            ("raw LK, same pair, our start", times.guessed),
            ("raw LK, picture to picture", times.consecutive),
        ):
            theirs = float(np.median(raw_us)) + detect
            mean = mean_ours / (float(np.mean(raw_us)) + detect)
            rows.append([f"{name}: {label}", f"{theirs:.0f}", f"{ours:.0f}", f"{ours / theirs:.2f}", f"{mean:.2f}"])
            if raw_us is times.same_pair:
                verdicts.append(
                    f"{name}: {ours / theirs:.2f} x raw LK of the same pair (goal {GOAL:.1f}): "
                    f"{verdict(ours / theirs <= GOAL)}; {np.median(times.tracks):.0f} tracks, "
                    f"a keyframe every {1 / share if share else float('inf'):.1f} pictures"
                )
    head = ["against", "raw, us", "ours, us", "ratio of medians", "of means"]
    return table(head, rows) + "\n\n" + "\n".join(verdicts)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=14.0)
    parser.add_argument("--passes", type=int, default=3)
    args = parser.parse_args()
    print(f"{describe()}; {load()}\n")
    print(report(leg(args.seconds).images, [("30 Hz", 1), ("5 Hz", 6)], args.passes))


if __name__ == "__main__":
    main()
