"""The states estimated of the platform and of its camera: one table, from which every state's index follows.

Each quantity takes as many states as it has components, in the order of the table. A camera that is known for sure has
none of its own, one whose rows' readout is known for sure has no last one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contract.error_sources import Cause

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Quantity:
    """One quantity: its name, unit (as Prometheus writes it) and label, and which states it is."""

    name: str
    unit: str
    label: str
    components: int
    walk: float  # what it may do by itself: one sigma of each component after a minute, (10.1)
    source: Cause  # what its error is called where errors are listed by source
    most: float  # what can be: a stored estimate beyond it is none


QUANTITIES = (
    Quantity(
        "boresight", "radians", "boresight", 3, np.radians(0.03), Cause.MOUNT, np.radians(45.0)
    ),  # about camera x, y, z
    Quantity("camera_time_offset", "seconds", "time offset", 1, 0.002, Cause.STAMPS, 10.0),
    Quantity("position_delay", "seconds", "position delay", 1, 0.005, Cause.DELAYS, 10.0),  # beyond `gps.latency_s`
    Quantity("velocity_delay", "seconds", "velocity delay", 1, 0.005, Cause.DELAYS, 10.0),
    # Times the cosine and the sine of the heading.
    Quantity(
        "heading_error_by_heading", "radians", "heading error", 2, np.radians(0.1), Cause.COMPASS, np.radians(90.0)
    ),
    # Of the camera, counted from its file, `camera_states`: a lens warms up or cools down.
    Quantity("focal_length_error", "ratio", "focal length", 1, 1e-4, Cause.LENS, 0.7),
    Quantity("principal_point_error", "ratio", "principal point", 2, 1e-4, Cause.LENS, 0.5),  # in focal lengths
    Quantity("radial_distortion_error", "ratio", "distortion", 2, 3e-4, Cause.LENS, 100.0),
    Quantity("readout_error", "seconds", "readout", 1, 1e-5, Cause.LENS, 0.5),  # beyond `camera.readout_s`
)
_ENDS = np.cumsum([q.components for q in QUANTITIES]).tolist()
PLACES = {q.name: slice(end - q.components, end) for q, end in zip(QUANTITIES, _ENDS, strict=True)}
MOST: Array = np.repeat([q.most for q in QUANTITIES], [q.components for q in QUANTITIES])
WALK: Array = np.repeat([q.walk for q in QUANTITIES], [q.components for q in QUANTITIES])

BORESIGHT, HEADING = PLACES["boresight"], PLACES["heading_error_by_heading"]
OFFSET, DELAY, VELOCITY_DELAY = (PLACES[n].start for n in ("camera_time_offset", "position_delay", "velocity_delay"))
STATES: int = HEADING.stop  # of the platform; those of the camera follow
PLANE = 3  # the ground's height, slope east, slope north follow those of a window


def present(count: int) -> tuple[tuple[Quantity, slice], ...]:
    """The quantities that so many states hold, and which of them each is."""
    return tuple((q, PLACES[q.name]) for q in QUANTITIES if PLACES[q.name].stop <= count)
