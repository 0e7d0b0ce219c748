"""Cameras whose field of view is stated somewhere: where a camera file begins that no calibration has made yet.

Each entry has its source, read on 2026-11-23. A picture that is a part of the sensor sees less, so the sigma is wide.
Drivers name the sensor: where one comes behind several lenses (IMX708, IMX477, IMX296), the lens must be named by who
flies it. What has no source is not here, but asked for: Logitech's C922, the C270 (two sources that differ by a fifth),
SIYI's gimbals. DJI's and other photographs state it themselves (`photo_lens`).
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace

from contract.camera import UNKNOWN_SIGMA, Camera

STATED_SIGMA = 0.05  # of the focal length, by a data sheet; the mode may crop
GIVEN_SIGMA = 0.1  # by somebody's word
_ASPECT = 16.0 / 9.0
_PI = "raspberrypi/documentation@0510938, accessories/camera/camera_hardware.adoc"
_PI_LENSES = "raspberrypi/documentation@3d5bb1c, accessories/camera/lens.adoc"


def _across(diagonal_deg: float) -> float:
    """Horizontal field of view of a 16:9 picture with this diagonal one."""
    share = _ASPECT / math.hypot(_ASPECT, 1.0)
    return math.degrees(2.0 * math.atan(share * math.tan(math.radians(diagonal_deg) / 2.0)))


@dataclass(frozen=True)
class Lens:
    """A camera and what it sees left to right. `part` of a driver's name (small letters) is its own; empty: none."""

    part: str
    name: str
    hfov_deg: float
    source: str
    sigma: float = STATED_SIGMA


LENSES = (
    Lens("ov5647", "Raspberry Pi Camera Module 1", 53.5, _PI),
    Lens("imx219", "Raspberry Pi Camera Module 2", 62.2, _PI),
    Lens("", "Raspberry Pi Camera Module 3", 66.0, _PI),
    Lens("", "Raspberry Pi Camera Module 3 Wide", 102.0, _PI),
    Lens("imx500", "Raspberry Pi AI Camera", 66.0, _PI),
    Lens("", "Raspberry Pi HQ Camera with 6 mm lens", 55.0, _PI_LENSES),
    Lens("", "Raspberry Pi HQ Camera with 16 mm lens", 22.2, _PI_LENSES),
    Lens("", "Raspberry Pi HQ Camera with 8 mm M12 lens", 49.0, _PI_LENSES),
    Lens("", "Raspberry Pi HQ Camera with 25 mm M12 lens", 14.4, _PI_LENSES),
    Lens("", "Raspberry Pi Global Shutter Camera with 6 mm lens", 45.0, _PI_LENSES),
    Lens("", "Raspberry Pi Global Shutter Camera with 16 mm lens", 17.8, _PI_LENSES),
    Lens(
        "",
        "Arducam B0196 (USB, IMX219)",
        62.2,
        "Arducam's B0196.pdf, cdn.shopify.com/s/files/1/0176/3274/files/B0196.pdf",
    ),
    Lens(
        "c920",
        "Logitech C920",
        _across(78.0),
        "78 deg, diagonal: gist.github.com/khancyr/b0a417f407251c01b7b2740c383cb02b",
    ),
    Lens(
        "b910",
        "Logitech B910",
        70.0,
        "measured, 16:9: android.googlesource.com/device/generic/goldfish, commit 4211948",
    ),
)


def known_lens(name: str) -> Lens | None:
    """The lens of a camera whose driver calls it this; None if the table does not have it."""
    return next((lens for lens in LENSES if lens.part and lens.part in name.lower()), None)


def named_lens(words: str) -> Lens:
    """The lens with this name, or the only one with all these words in it. Raises ValueError with those that fit."""
    wanted = words.lower().split()
    found = [lens for lens in LENSES if lens.name.lower().split() == wanted]
    found = found or [lens for lens in LENSES if wanted and set(wanted) <= set(lens.name.lower().split())]
    if len(found) != 1:
        fit = "; ".join(lens.name for lens in found or LENSES)
        raise ValueError(f"{'several fit' if found else 'none is called that'}: {fit}")
    return found[0]


def first_camera_file(size_px: tuple[int, int], hfov_deg: float, source: str, sigma: float) -> str:
    """A camera file to begin with: a pinhole with this field of view, as unsure as that."""
    camera = Camera.from_field_of_view(*size_px, hfov_deg)
    known = json.loads(replace(camera, stated_sigma=(sigma, *UNKNOWN_SIGMA[1:])).to_json())
    known["calibration"]["verdict"] = f"guessed from {source}, not calibrated"
    return json.dumps(known, indent=1) + "\n"
