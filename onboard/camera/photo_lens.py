"""The lens as a photograph states it: focal length, principal point, distortion, and how well each is known."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from PIL import ExifTags

from contract.camera import is_nearly_square

FULL_FRAME_DIAGONAL_MM = 43.2666
MM_OF_UNIT = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}  # FocalPlaneResolutionUnit
# One sigma of a focal length, as a share. DJI's dewarping data, Skydio's and the rigs' come from a calibration of the
# very lens, DJI's "calibrated" focal length is the design's; one in mm is rounded and leaves out what focusing changes;
# the equivalent to 35 mm film is a whole number, and makers differ in what they hold equal (diagonal or width).
SIGMA_CALIBRATED, SIGMA_DESIGN, SIGMA_MM, SIGMA_EQUIVALENT = 0.003, 0.015, 0.02, 0.03
# The equivalent is the whole sensor's; a picture of another shape is a part of it, of which a maker may have cut more
# than the shape asks for. A sensor of unknown shape is 4:3 or 3:2, and cutting 16:9 out of either differs by 4 %.
SIGMA_CROPPED = 0.05
# Without the size of a pixel in mm: by the principal point, which lies this near to the middle (share of the width).
SIGMA_PITCH = 0.02
# What a photograph states in pixels is of the size that the camera took. If it was made smaller the equivalent to 35 mm
# film, which no size changes, is apart by more than this factor; where that is not stated, a lens narrower than 15
# degrees is rather a larger picture's.
ANOTHER_SIZE, MOST_UNCONFIRMED = 1.25, 3.8
SAME_SHAPE = 0.02  # shapes that are the same
FOUR_THIRDS, THREE_HALVES = 4.0 / 3.0, 1.5
# Cameras of drones whose sensor is not 4:3, as drones' mostly are (their data sheets: 1 inch, and full frame).
THREE_HALVES_MODELS = ("FC6310", "FC6510", "L1D-20c", "FC3411", "ZenmuseP1")

Distortion = tuple[float, float, float, float, float]


@dataclass(frozen=True)
class Focal:
    """A focal length in pixels, its one sigma, and where it is from; with principal point and distortion if known."""

    fx_px: float
    fy_px: float
    sigma_px: float
    source: str
    centre_px: tuple[float, float] | None = None
    distortion: Distortion | None = None  # OpenCV's k1, k2, p1, p2, k3

    def resized(self, scale: float) -> Focal:
        """The same of a picture that was made so many times as large; pixel (0, 0) is the centre of the first."""
        if scale == 1.0:
            return self
        x, y = self.centre_px or (0.0, 0.0)
        centre = None if self.centre_px is None else (scale * (x + 0.5) - 0.5, scale * (y + 0.5) - 0.5)
        return replace(
            self, fx_px=scale * self.fx_px, fy_px=scale * self.fy_px, sigma_px=scale * self.sigma_px, centre_px=centre
        )


def number(value: object) -> float | None:
    """A finite number, or None. EXIF's ratios may be 0/0."""
    if value is None or isinstance(value, bytes):
        return None
    try:
        found = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return found if math.isfinite(found) else None


def numbers(text: str) -> list[float]:
    """Numbers between commas; empty if any is none."""
    found = [number(part) for part in text.split(",")] if text else []
    return [] if None in found else [value for value in found if value is not None]


def focal_of(
    details: Mapping[int, object], xmp: Mapping[str, str], size_px: tuple[int, int], model: str
) -> Focal | None:
    """The best of what the photograph states about its lens. None also for a fisheye, another kind of lens."""
    if xmp.get("Camera:ModelType", "perspective").lower() == "fisheye":
        return None
    full_px = full_size(details, size_px)
    found = (
        _dewarp(xmp, full_px)
        or _skydio(details, xmp, full_px)
        or _perspective(details, xmp, full_px)
        or _design(xmp, full_px)
        or _by_plane(details, full_px)
    )
    equivalent = _by_equivalent(details, size_px, model)
    if found is None or not is_nearly_square(found.fx_px, found.fy_px):  # no photograph's pixels are squeezed
        return equivalent
    found = found.resized(size_px[0] / full_px[0])
    if equivalent is None:
        return found if found.fx_px < MOST_UNCONFIRMED * size_px[0] else None
    if max(found.fx_px / equivalent.fx_px, equivalent.fx_px / found.fx_px) < ANOTHER_SIZE:
        return found
    return replace(equivalent, source=f"{equivalent.source}, as {found.source} is of another size of picture")


def full_size(details: Mapping[int, object], size_px: tuple[int, int]) -> tuple[int, int]:
    """The picture's size before it was made smaller, which programs that do so leave in EXIF; else its own."""
    sides = [number(details.get(tag)) or 0.0 for tag in (ExifTags.Base.ExifImageWidth, ExifTags.Base.ExifImageHeight)]
    full_px = int(sides[0]), int(sides[1])
    is_larger = min(full_px) > 0 and full_px[0] > size_px[0] and full_px[1] > size_px[1]
    if not is_larger or abs(full_px[0] * size_px[1] / (full_px[1] * size_px[0]) - 1.0) > SAME_SHAPE:
        return size_px
    return full_px


def _dewarp(xmp: Mapping[str, str], size_px: tuple[int, int]) -> Focal | None:
    """DJI's, in pixels about the middle."""
    dewarp = numbers(xmp.get("DewarpData", "").rpartition(";")[2])
    if len(dewarp) != 9 or min(dewarp[:2]) <= 0.0:
        return None
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = dewarp
    middle = ((size_px[0] - 1) / 2.0, (size_px[1] - 1) / 2.0)
    if xmp.get("DewarpFlag", "0").strip() == "1":  # the picture has been straightened already
        k1 = k2 = p1 = p2 = k3 = 0.0
    centre = middle[0] + cx, middle[1] + cy
    return Focal(fx, fy, SIGMA_CALIBRATED * fx, "DewarpData", centre, (k1, k2, p1, p2, k3))


def _skydio(details: Mapping[int, object], xmp: Mapping[str, str], size_px: tuple[int, int]) -> Focal | None:
    """Skydio's calibration, in pixels without the digital zoom, which EXIF has; three radial coefficients."""
    known = [
        number(xmp.get(f"{what}/{axis}"))
        for what in ("CalibratedFocalLength", "CalibratedOpticalCenter")
        for axis in "XY"
    ]
    radial = numbers(xmp.get("DewarpData", ""))
    if None in known or len(radial) != 3:
        return None
    fx, fy, cx, cy = (value for value in known if value is not None)
    if min(fx, fy) <= 0.0:
        return None
    zoom = number(details.get(ExifTags.Base.DigitalZoomRatio)) or 1.0
    middle = ((size_px[0] - 1) / 2.0, (size_px[1] - 1) / 2.0)
    centre = middle[0] + zoom * (cx - middle[0]), middle[1] + zoom * (cy - middle[1])
    return Focal(
        *(zoom * fx, zoom * fy, SIGMA_CALIBRATED * zoom * fx, "CalibratedFocalLength"),
        *(centre, (radial[0], radial[1], 0.0, 0.0, radial[2])),
    )


def _perspective(details: Mapping[int, object], xmp: Mapping[str, str], size_px: tuple[int, int]) -> Focal | None:
    """Pix4D's namespace (MicaSense, Parrot, Sentera): millimetres; R1, R2, R3, T1, T2."""
    focal_mm, centre_mm = (
        number(xmp.get("Camera:PerspectiveFocalLength")),
        numbers(xmp.get("Camera:PrincipalPoint", "")),
    )
    units = xmp.get("Camera:PerspectiveFocalLengthUnits", "mm").lower()
    if not focal_mm or units not in ("mm", "millimeters", "millimetres"):
        return None
    per_mm, sigma = _pixels_per_mm(details), SIGMA_CALIBRATED
    if per_mm is None and len(centre_mm) == 2 and centre_mm[0] > 0.0:
        per_mm, sigma = 0.5 * size_px[0] / centre_mm[0], SIGMA_PITCH
    if per_mm is None:
        return None
    focal_px = focal_mm * per_mm
    if not 0.2 * max(size_px) < focal_px < 50.0 * max(size_px):
        return None
    centre = (centre_mm[0] * per_mm - 0.5, centre_mm[1] * per_mm - 0.5) if len(centre_mm) == 2 else None
    pix4d = numbers(xmp.get("Camera:PerspectiveDistortion", ""))
    distortion = None
    if len(pix4d) == 5:
        k1, k2, k3, p1, p2 = pix4d
        distortion = k1, k2, p1, p2, k3
    return Focal(focal_px, focal_px, sigma * focal_px, "PerspectiveFocalLength", centre, distortion)


def _pixels_per_mm(details: Mapping[int, object]) -> float | None:
    resolution = number(details.get(ExifTags.Base.FocalPlaneXResolution))
    unit = MM_OF_UNIT.get(int(number(details.get(ExifTags.Base.FocalPlaneResolutionUnit)) or 2))
    return resolution / unit if resolution and unit else None


def _design(xmp: Mapping[str, str], size_px: tuple[int, int]) -> Focal | None:
    design = number(xmp.get("CalibratedFocalLength"))
    if design is None or design <= 0.1 * max(size_px):  # older firmware gives it in mm
        return None
    return Focal(design, design, SIGMA_DESIGN * design, "CalibratedFocalLength")


def _by_plane(details: Mapping[int, object], size_px: tuple[int, int]) -> Focal | None:
    focal_mm, per_mm = number(details.get(ExifTags.Base.FocalLength)), _pixels_per_mm(details)
    if not focal_mm or per_mm is None:
        return None
    focal_px = focal_mm * per_mm
    if not 0.2 * max(size_px) < focal_px < 50.0 * max(size_px):
        return None
    return Focal(focal_px, focal_px, SIGMA_MM * focal_px, "FocalLength and FocalPlaneXResolution")


def _by_equivalent(details: Mapping[int, object], size_px: tuple[int, int], model: str) -> Focal | None:
    """Return the focal length by the 35 mm equivalent; None without one.

    The equivalent is that of the whole sensor, of which a picture of another shape is a part.
    """
    equivalent_mm = number(details.get(ExifTags.Base.FocalLengthIn35mmFilm))
    if not equivalent_mm:
        return None
    long_px, short_px = max(size_px), min(size_px)
    shape = long_px / short_px
    is_three_halves = any(word.startswith(THREE_HALVES_MODELS) for word in model.split())
    sensor = THREE_HALVES if is_three_halves else FOUR_THIRDS
    if not is_three_halves and abs(shape / THREE_HALVES - 1.0) < SAME_SHAPE:
        sensor = THREE_HALVES
    is_whole = abs(shape / sensor - 1.0) < SAME_SHAPE
    # One of the whole sensor's two sides is the picture's.
    across_px = long_px if shape >= sensor else short_px * sensor
    diagonal_px = math.hypot(long_px, short_px) if is_whole else across_px * math.hypot(1.0, 1.0 / sensor)
    focal_px = equivalent_mm / FULL_FRAME_DIAGONAL_MM * diagonal_px
    shares = SIGMA_EQUIVALENT, 0.0 if is_whole else SIGMA_CROPPED, 1.0 / 12.0**0.5 / equivalent_mm
    part = "" if is_whole else f", a part of a sensor taken for {'3:2' if is_three_halves else '4:3'}"
    return Focal(focal_px, focal_px, math.hypot(*shares) * focal_px, f"FocalLengthIn35mmFilm{part}")
