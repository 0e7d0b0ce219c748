"""Digital zoom as the camera's own log states it: the camera file is for none, an enlarged picture has longer focal
lengths about its middle.
"""

from __future__ import annotations

import bisect
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace

from contract.camera import Camera
from onboard.camera.picture_files import FrameSource
from onboard.events.types import Frame

MIN_CHANGE = 1e-3  # of the ratio


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
