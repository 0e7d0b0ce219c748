"""What a photograph says of itself: EXIF, and the XMP that drones add (DJI's names, in any namespace).

Read with Pillow, which decodes the pictures anyway; XMP is XML, read by the standard library from its root element
on, before which alone a document type could stand.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from xml.etree import ElementTree

from PIL import ExifTags, Image

from contract.errors import InputError
from onboard.camera.file_stamps import exif_moment
from onboard.camera.pixel_formats import UNDECODABLE

FULL_FRAME_DIAGONAL_MM = 43.2666
MM_OF_UNIT = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}  # FocalPlaneResolutionUnit
# One sigma of a focal length, as a share. DJI's dewarping data come from a calibration of the very lens, its
# "calibrated" focal length is the design's; a focal length in mm is rounded and leaves out what focusing changes;
# its equivalent to 35 mm film is a whole number, and makers differ in what they hold equal (diagonal or width).
SIGMA_DEWARP, SIGMA_DESIGN, SIGMA_MM, SIGMA_EQUIVALENT = 0.003, 0.015, 0.02, 0.03

Angles = tuple[float, float, float]


@dataclass(frozen=True)
class Focal:
    """A focal length in pixels, its one sigma, and where it is from; with principal point and distortion if known."""

    fx_px: float
    fy_px: float
    sigma_px: float
    source: str
    centre_px: tuple[float, float] | None = None
    distortion: tuple[float, float, float, float, float] | None = None  # OpenCV's k1, k2, p1, p2, k3


@dataclass(frozen=True)
class PhotoMetadata:
    """One photograph's own words; None where it does not say. Angles are roll, pitch, yaw against north-east-down."""

    name: str
    size_px: tuple[int, int]
    model: str
    stamp_ns: int | None  # UTC, as far as the photograph tells
    stamp_is_whole_s: bool  # to the second only, the fraction cut off
    lat_deg: float | None
    lon_deg: float | None
    height_amsl_m: float | None
    height_is_ellipsoidal: bool
    above_home_m: float | None
    sigma_horizontal_m: float | None
    sigma_vertical_m: float | None
    gimbal_deg: Angles | None
    body_deg: Angles | None
    velocity_ne_m_s: tuple[float, float] | None
    focal: Focal | None


def read_photo(path: Path) -> PhotoMetadata:
    """Read one photograph's header; raises InputError, one line, for what is no picture."""
    try:
        with Image.open(path) as image:
            exif = image.getexif()
            details = dict(exif.get_ifd(ExifTags.IFD.Exif))
            gps = dict(exif.get_ifd(ExifTags.IFD.GPSInfo))
            xmp = _xmp(image)
            size_px = image.size
    except UNDECODABLE as error:
        why = " ".join(str(error).split()).replace(str(path), path.name)
        raise InputError(f"photograph {path}: cannot be read ({why})") from error
    stamp_ns, is_whole_s = _stamp(details, xmp)
    lat_deg, lon_deg = _place(gps, xmp)
    height_m = _number(xmp.get("AbsoluteAltitude"))
    is_ellipsoidal = height_m is not None and xmp.get("AltitudeType") == "RtkAlt"
    if height_m is None:
        height_m, is_ellipsoidal = _gps_height(gps)
    sides = [_number(xmp.get(name)) for name in ("RtkStdLat", "RtkStdLon")]
    horizontal_m = _norm(sides[0], sides[1])
    north, east = _number(xmp.get("FlightXSpeed")), _number(xmp.get("FlightYSpeed"))
    return PhotoMetadata(
        path.name,
        size_px,
        " ".join(str(exif.get(tag, "")).strip("\0 ") for tag in (ExifTags.Base.Make, ExifTags.Base.Model)).strip(),
        stamp_ns,
        is_whole_s,
        lat_deg,
        lon_deg,
        height_m,
        is_ellipsoidal,
        _number(xmp.get("RelativeAltitude")),
        horizontal_m or _number(gps.get(ExifTags.GPS.GPSHPositioningError)) or None,
        _number(xmp.get("RtkStdHgt")) or None,
        _angles(xmp, "Gimbal"),
        _angles(xmp, "Flight"),
        None if north is None or east is None else (north, east),
        _focal(details, xmp, size_px),
    )


def _xmp(image: Image.Image) -> dict[str, str]:
    """Attributes and elements by their names without namespace."""
    packet = image.info.get("xmp", b"")
    packet = packet.encode() if isinstance(packet, str) else packet
    start, end = packet.find(b"<x:xmpmeta"), packet.rfind(b"</x:xmpmeta>")
    if start < 0 or end < 0:
        return {}
    try:
        root = ElementTree.fromstring(packet[start : end + len(b"</x:xmpmeta>")])
    except ElementTree.ParseError:
        return {}
    found: dict[str, str] = {}
    for node in root.iter():
        if node.text and node.text.strip():
            found[node.tag.rpartition("}")[2]] = node.text.strip()
        found |= {name.rpartition("}")[2]: value.strip() for name, value in node.attrib.items()}
    return found


def _number(value: object) -> float | None:
    """A finite number, or None. EXIF's ratios may be 0/0."""
    if value is None or isinstance(value, bytes):
        return None
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if math.isfinite(number) else None


def _norm(a: float | None, b: float | None) -> float | None:
    """One sigma of a horizontal axis from those of both."""
    return None if a is None or b is None else math.hypot(a, b) / math.sqrt(2.0)


def _stamp(details: dict[int, object], xmp: dict[str, str]) -> tuple[int | None, bool]:
    """The exposure (Unix ns) and whether it is cut to the second: the XMP's UTC, else EXIF's."""
    utc = re.fullmatch(r"(\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d)(?:\.(\d{1,9}))?Z?", xmp.get("UTCAtExposure", ""))
    if utc is not None:
        try:
            whole = datetime.fromisoformat(utc[1]).replace(tzinfo=UTC)
            return int(whole.timestamp()) * 1_000_000_000 + int((utc[2] or "0").ljust(9, "0")), utc[2] is None
        except ValueError:
            pass
    return exif_moment(details)


def _place(gps: dict[int, object], xmp: dict[str, str]) -> tuple[float | None, float | None]:
    """Latitude and longitude in degrees; DJI's XMP has more digits than its EXIF, and one letter too many."""
    lat = _number(xmp.get("GpsLatitude", xmp.get("Latitude")))
    lon = _number(xmp.get("GpsLongitude", xmp.get("GpsLongtitude", xmp.get("Longitude"))))
    if lat is None or lon is None:
        lat = _sexagesimal(gps.get(ExifTags.GPS.GPSLatitude), gps.get(ExifTags.GPS.GPSLatitudeRef), "S")
        lon = _sexagesimal(gps.get(ExifTags.GPS.GPSLongitude), gps.get(ExifTags.GPS.GPSLongitudeRef), "W")
    usable = lat is not None and lon is not None and abs(lat) <= 90.0 and abs(lon) <= 180.0
    return (lat, lon) if usable and (lat, lon) != (0.0, 0.0) else (None, None)


def _sexagesimal(value: object, reference: object, negative: str) -> float | None:
    if not isinstance(value, tuple | list) or len(value) != 3:
        return None
    degrees, minutes, seconds = (_number(part) for part in value)
    if degrees is None or minutes is None or seconds is None:
        return None
    angle = degrees + minutes / 60.0 + seconds / 3600.0
    return -angle if str(reference).strip("\0 ").upper() == negative else angle


def _gps_height(gps: dict[int, object]) -> tuple[float | None, bool]:
    """EXIF's altitude, and whether it counts from the ellipsoid (EXIF 3: references 2 and 3)."""
    height_m, reference = _number(gps.get(ExifTags.GPS.GPSAltitude)), gps.get(ExifTags.GPS.GPSAltitudeRef, 0)
    code = reference[0] if isinstance(reference, bytes) and reference else reference
    if height_m is not None and code in (1, 3):
        height_m = -height_m
    return height_m, code in (2, 3)


def _angles(xmp: dict[str, str], who: str) -> Angles | None:
    roll, pitch, yaw = (_number(xmp.get(f"{who}{angle}Degree")) for angle in ("Roll", "Pitch", "Yaw"))
    return None if roll is None or pitch is None or yaw is None else (roll, pitch, yaw)


def _focal(details: dict[int, object], xmp: dict[str, str], size_px: tuple[int, int]) -> Focal | None:
    """The best of what the photograph says of its lens."""
    dewarp = [_number(part) for part in xmp.get("DewarpData", "").rpartition(";")[2].split(",")]
    if len(dewarp) == 9 and None not in dewarp:
        fx, fy, cx, cy, *rest = (float(part) for part in dewarp if part is not None)
        k1, k2, p1, p2, k3 = rest
        middle = ((size_px[0] - 1) / 2.0, (size_px[1] - 1) / 2.0)
        if min(fx, fy) > 0.0:
            centre = middle[0] + cx, middle[1] + cy
            if xmp.get("DewarpFlag", "0").strip() == "1":  # the picture has been straightened already
                k1 = k2 = p1 = p2 = k3 = 0.0
            return Focal(fx, fy, SIGMA_DEWARP * fx, "DewarpData", centre, (k1, k2, p1, p2, k3))
    design = _number(xmp.get("CalibratedFocalLength"))
    if design is not None and design > 0.1 * max(size_px):  # older firmware gives it in mm
        return Focal(design, design, SIGMA_DESIGN * design, "CalibratedFocalLength")
    focal_mm = _number(details.get(ExifTags.Base.FocalLength))
    resolution = _number(details.get(ExifTags.Base.FocalPlaneXResolution))
    unit = MM_OF_UNIT.get(int(_number(details.get(ExifTags.Base.FocalPlaneResolutionUnit)) or 2))
    if focal_mm and resolution and unit:
        focal_px = focal_mm * resolution / unit
        if 0.2 * max(size_px) < focal_px < 50.0 * max(size_px):
            return Focal(focal_px, focal_px, SIGMA_MM * focal_px, "FocalLength and FocalPlaneXResolution")
    equivalent_mm = _number(details.get(ExifTags.Base.FocalLengthIn35mmFilm))
    if equivalent_mm:
        focal_px = equivalent_mm / FULL_FRAME_DIAGONAL_MM * math.hypot(*size_px)
        sigma = math.hypot(SIGMA_EQUIVALENT, 1.0 / 12.0**0.5 / equivalent_mm) * focal_px
        return Focal(focal_px, focal_px, sigma, "FocalLengthIn35mmFilm")
    return None
