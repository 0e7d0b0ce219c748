"""Cameras whose field of view their makers state: where a camera file begins that no calibration has made yet.

| camera | stated | by |
|---|---|---|
| Raspberry Pi Camera Module 1 (OV5647) | 53.50 deg, horizontal | raspberrypi/documentation, camera_hardware.adoc |
| Raspberry Pi Camera Module 2 (IMX219) | 62.2 deg, horizontal | the same |
| Logitech C920, C922 | 78 deg, diagonal of 16:9 | Logitech's data sheets |
| Logitech C270 | 55 deg, diagonal of 16:9 | Logitech's data sheet |

A picture that is a part of the sensor sees less, so the sigma is wide. Modules with interchangeable lenses, or of which
one sensor comes behind several lenses (IMX477, IMX708), are not in the table: ask.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace

from contract.camera import UNKNOWN_SIGMA, Camera

STATED_SIGMA = 0.05  # of the focal length, by a data sheet; the mode may crop
GIVEN_SIGMA = 0.1  # by somebody's word
_ASPECT = 16.0 / 9.0


def _across(diagonal_deg: float) -> float:
    """Horizontal field of view of a 16:9 picture with this diagonal one."""
    share = _ASPECT / math.hypot(_ASPECT, 1.0)
    return math.degrees(2.0 * math.atan(share * math.tan(math.radians(diagonal_deg) / 2.0)))


@dataclass(frozen=True)
class Lens:
    """A camera as drivers name it (a part of the name, small letters), and what it sees from left to right."""

    part: str
    name: str
    hfov_deg: float


LENSES = (
    Lens("ov5647", "Raspberry Pi Camera Module 1", 53.5),
    Lens("imx219", "Raspberry Pi Camera Module 2", 62.2),
    Lens("c920", "Logitech C920", _across(78.0)),
    Lens("c922", "Logitech C922", _across(78.0)),
    Lens("c270", "Logitech C270", _across(55.0)),
)


def known_lens(name: str) -> Lens | None:
    """The lens of a camera that calls itself this; None if the table does not have it."""
    return next((lens for lens in LENSES if lens.part in name.lower()), None)


def first_camera_file(size_px: tuple[int, int], hfov_deg: float, source: str, sigma: float) -> str:
    """A camera file to begin with: a pinhole with this field of view, as unsure as that."""
    camera = Camera.from_field_of_view(*size_px, hfov_deg)
    known = json.loads(replace(camera, stated_sigma=(sigma, *UNKNOWN_SIGMA[1:])).to_json())
    known["calibration"]["verdict"] = f"guessed from {source}, not calibrated"
    return json.dumps(known, indent=1) + "\n"
