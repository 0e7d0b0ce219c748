"""Zoom as the camera's own log states it. Digital: the camera file is for none, an enlarged picture has longer focal
lengths about its middle. Optical: a focal length that changes during a video is a zoom that is reported.
"""

from __future__ import annotations

import bisect
import itertools
import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace

from contract.camera import Camera
from onboard.camera.photo_lens import FULL_FRAME_DIAGONAL_MM
from onboard.camera.picture_files import FrameSource
from onboard.events.types import Frame, Zoom

MIN_CHANGE = 1e-3  # of the ratio
SIGMA_EQUIVALENT = 0.06  # of a focal length by its equivalent to film, which holds for a photograph, as a share
MOST_OFF, SAME = 0.15, 1e-3  # logarithms of a camera file's focal length, off what an equivalent gives
EVERY_NS = 250_000_000  # of reports while the lens stands


@dataclass(frozen=True)
class OfOneZoom:
    """The frames of a source that were taken at one zoom ratio. Serves `FrameSource`."""

    source: FrameSource
    kept: list[int]  # their places in the source, increasing
    notes: tuple[str, ...]

    @property
    def stamps_ns(self) -> list[int]:
        """Capture times in order."""
        stamps = self.source.stamps_ns
        return [stamps[i] for i in self.kept]

    @property
    def names(self) -> list[str]:
        """The frames' names, in the same order."""
        names = self.source.names
        return [names[i] for i in self.kept]

    def frames(self) -> Iterator[Frame]:
        """The kept frames, under the source's own numbers."""
        wanted = set(self.kept)
        return (frame for place, frame in enumerate(self.source.frames()) if place in wanted)


def enlarged(camera: Camera, ratio: float) -> Camera:
    """The camera whose pictures are the middle of `camera`'s, enlarged `ratio` times to the same size."""
    middle = (camera.width_px - 1) / 2.0, (camera.height_px - 1) / 2.0
    return replace(
        camera,
        fx_px=ratio * camera.fx_px,
        fy_px=ratio * camera.fy_px,
        cx_px=middle[0] + ratio * (camera.cx_px - middle[0]),
        cy_px=middle[1] + ratio * (camera.cy_px - middle[1]),
        stated_sigma=camera.sigma,
    )


def equivalent_px(equivalent_mm: float, size_px: tuple[int, int]) -> float:
    """Return the focal length, px, that an equivalent to 35 mm film means of a video, to `SIGMA_EQUIVALENT`: between
    that along the width, where a frame is the sensor's whole width, and that along the diagonal, where it is a part
    as high as a photograph.
    """
    width, height = size_px
    by_diagonal = equivalent_mm / FULL_FRAME_DIAGONAL_MM * math.hypot(width, height)
    by_width = equivalent_mm / 36.0 * width
    return 0.5 * (by_diagonal + by_width)


def optical_zoom(
    camera: Camera, focal_mm: tuple[tuple[int, float], ...], digital: tuple[tuple[int, float], ...], end_ns: int
) -> tuple[list[Zoom], tuple[str, ...]]:
    """Return reports of a focal length that changes, and notes: `focal_mm` and `digital` from which moment (ns) on
    which held, until `end_ns`. The camera file is for the one of them that its own focal length is.

    None where it does not change, where the digital zoom does too, for then it may be in both, and where the file is
    for none of them.
    """
    lengths = sorted({length for _, length in focal_mm})
    if len(lengths) < 2:
        return [], ()
    words = f"focal_len changes from {lengths[0]:g} to {lengths[-1]:g} mm"
    if len(digital) > 1:
        return [], (f"{words}, and the digital zoom too: it is not taken for a zoom of the lens",)
    off = {length: abs(math.log(camera.fx_px / equivalent_px(length, camera.size_px))) for length in lengths}
    of_file = min(lengths, key=lambda length: off[length])
    if off[of_file] > MOST_OFF:
        return [], (f"{words}, but the camera file's {camera.fx_px:.0f} px is none of these: the zoom is not followed",)
    # A file of another's may be for a length next to it; that of an import is for the one that it names.
    rivals = [length for length in lengths if length != of_file and abs(math.log(length / of_file)) < MOST_OFF]
    unsure = SIGMA_EQUIVALENT if rivals and off[of_file] > SAME else 0.0
    out: list[Zoom] = []
    for (start_ns, length), (next_ns, _) in itertools.pairwise([*focal_mm, (end_ns, 0.0)]):
        value = camera.fx_px * length / of_file
        # Until just before it moves.
        moments = [
            *range(start_ns, max(next_ns, start_ns + 1), EVERY_NS),
            *([next_ns - 1] if next_ns > start_ns + 1 else []),
        ]
        out += [Zoom(moment_ns, value, "focal_px", math.sqrt(12.0) * unsure * value) for moment_ns in moments]
    return out, (f"{words}: followed as a zoom that is reported; the camera file is taken for {of_file:g} mm",)


def at_one_zoom(
    camera: Camera, source: FrameSource, steps: tuple[tuple[int, float], ...]
) -> tuple[Camera, FrameSource]:
    """The camera and the frames at the ratio that most frames have; `steps`: from which moment (ns) on which held.

    Frames at another ratio are left out, and a note states it: a camera file describes one focal length.
    """
    if not steps:
        return camera, source
    starts = [start for start, _ in steps]
    ratios = [steps[max(bisect.bisect_right(starts, stamp) - 1, 0)][1] for stamp in source.stamps_ns]
    usual, _ = Counter(ratios).most_common(1)[0]
    kept = [place for place, ratio in enumerate(ratios) if abs(ratio / usual - 1.0) <= MIN_CHANGE]
    if usual == 1.0 and len(kept) == len(ratios):
        return camera, source
    notes = [f"digital zoom {usual:g}: the camera file's focal length is multiplied by it"] if usual != 1.0 else []
    if len(kept) < len(ratios):
        others = ", ".join(f"{ratio:g}" for ratio in sorted({ratios[i] for i in range(len(ratios))} - {usual}))
        notes.append(
            f"{len(ratios) - len(kept)} of {len(ratios)} pictures at digital zoom {others} are left out; do not zoom "
            "during a flight"
        )
    return enlarged(camera, usual), OfOneZoom(source, kept, (*source.notes, *notes))
