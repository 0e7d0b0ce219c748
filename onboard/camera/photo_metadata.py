"""Metadata of a photograph: EXIF, and the XMP that drones add.

The XMP has DJI's names, Pix4D's (which MicaSense, Parrot and senseFly write), Parrot's and Skydio's own.

Read with Pillow, which decodes the pictures anyway.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from PIL import ExifTags, Image

from contract.errors import InputError
from contract.geodesy import distance_m
from contract.rotations import euler_from_matrix, matrix_from_euler
from onboard.camera.file_stamps import exif_moment
from onboard.camera.photo_lens import Focal, focal_of, full_size, number
from onboard.camera.pixel_formats import UNDECODABLE
from onboard.camera.radiometric_jpeg import radiometric
from onboard.camera.xmp_packet import read_xmp

__all__ = ["Focal", "PhotoMetadata", "read_photo"]

DJI_SOURCES = ("WideCamera", "ZoomCamera", "InfraredCamera")  # of one payload, in the order in which one is taken
RTK_FLAGS = {"34", "50"}  # DJI's RtkFlag: float, fixed
MIN_READOUT_S, MAX_READOUT_S = 1e-3, 0.2  # of a whole picture

Angles = tuple[float, float, float]


@dataclass(frozen=True)
class PhotoMetadata:
    """The statements of one photograph; None where it has none. Angles are roll, pitch, yaw against north-east-down."""

    name: str
    size_px: tuple[int, int]
    model: str
    stamp_ns: int | None  # UTC, as far as the photograph states it
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
    height_is_barometric: bool = False  # a height in the standard atmosphere, as drones without RTK write it
    readout_s: float | None = None  # of a rolling shutter, all rows
    band: tuple[int, str] | None = None  # of a rig of cameras that expose together: number and name
    stamp_is_utc: bool = False  # by a receiver's time, not by the camera's own clock
    gps_ns: int | None = None  # a receiver's time of its last fix (UTC), to the second as most cameras write it
    height_origin_is_unnamed: bool = False  # above the sea, a geoid or the ellipsoid: its source does not state which
    place_lacks_side: bool = False  # a latitude and longitude without what side of the equator and of Greenwich
    counts: str = ""  # the kind of R-JPEG whose sixteen bit counts are the picture, of `size_px`; empty for others
    serial: str = ""  # of the camera's body
    places_apart_m: float = 0.0  # of two that it states, in XMP and in EXIF: who edits one leaves the other as it was


def read_photo(path: Path) -> PhotoMetadata:
    """Read one photograph's header; raises InputError, one line, for what is no picture."""
    try:
        with Image.open(path) as image:
            exif = image.getexif()
            details = dict(exif.get_ifd(ExifTags.IFD.Exif))
            gps = dict(exif.get_ifd(ExifTags.IFD.GPSInfo))
            packet = image.info.get("xmp", b"") or exif.get(ExifTags.Base.XMLPacket, b"")
            xmp = read_xmp(packet.encode() if isinstance(packet, str) else bytes(packet))
            counts, size_px = radiometric(image) or ("", image.size)
            shown_px = image.size
    except UNDECODABLE as error:
        why = " ".join(str(error).split()).replace(str(path), path.name)
        raise InputError(f"photograph {path}: cannot be read ({why})") from error
    if counts and ExifTags.Base.ExifImageWidth not in details:  # a lens in pixels is of the picture for people
        sides = (ExifTags.Base.ExifImageWidth, ExifTags.Base.ExifImageHeight)
        details |= dict(zip(sides, shown_px, strict=True))
    make, kind = (str(exif.get(tag, "")).strip("\0 ") for tag in (ExifTags.Base.Make, ExifTags.Base.Model))
    model = f"{make} {kind}".strip()
    stamp_ns, is_whole_s = _stamp(details, xmp)
    lat_deg, lon_deg = _place(gps, xmp)
    lacks_side = lat_deg is None and ExifTags.GPS.GPSLatitude in gps and not _has_sides(gps)
    height_m, is_ellipsoidal, is_barometric = _height(gps, xmp, make)
    north, east = number(xmp.get("FlightXSpeed")), number(xmp.get("FlightYSpeed"))
    return PhotoMetadata(
        path.name,
        size_px,
        model,
        stamp_ns,
        is_whole_s,
        lat_deg,
        lon_deg,
        height_m,
        is_ellipsoidal,
        number(xmp.get("RelativeAltitude")),
        _sigma_horizontal(gps, xmp),
        _first(xmp, "RtkStdHgt", "Camera:GPSZAccuracy", "GpsVerticalAccuracy"),
        _camera_angles(xmp, make),
        _angles(xmp, "Flight{}Degree", "Drone{}Degree", "VehicleOrientationNED/{}"),
        None if north is None or east is None else (north, east),
        focal_of(details, xmp, size_px, model),
        height_is_barometric=is_barometric,
        readout_s=_readout(xmp, full_size(details, size_px)),
        band=_band(xmp),
        stamp_is_utc=bool(stamp_ns) and _utc_at_exposure(xmp) is not None,
        gps_ns=_gps_time(gps),
        place_lacks_side=lacks_side,
        counts=counts,
        places_apart_m=_places_apart_m(gps, xmp),
        serial=(str(details.get(ExifTags.Base.BodySerialNumber, "")) or xmp.get("CameraSerialNumber", "")).strip("\0 "),
    )


def _norm(a: float | None, b: float | None) -> float | None:
    """One sigma of a horizontal axis from those of both."""
    return None if a is None or b is None else math.hypot(a, b) / math.sqrt(2.0)


def _first(xmp: Mapping[str, str], *names: str) -> float | None:
    """The first of these that is a number other than 0."""
    return next((value for name in names if (value := number(xmp.get(name)))), None)


def _sigma_horizontal(gps: Mapping[int, object], xmp: Mapping[str, str]) -> float | None:
    rtk = _norm(number(xmp.get("RtkStdLat")), number(xmp.get("RtkStdLon")))
    stated = rtk or _first(xmp, "Camera:GPSXYAccuracy", "GpsHorizontalAccuracy")
    return stated or number(gps.get(ExifTags.GPS.GPSHPositioningError)) or None


def _stamp(details: dict[int, object], xmp: Mapping[str, str]) -> tuple[int | None, bool]:
    """The exposure (Unix ns) and whether it is cut to the second: the XMP's UTC, else EXIF's."""
    return _utc_at_exposure(xmp) or exif_moment(details)


def _utc_at_exposure(xmp: Mapping[str, str]) -> tuple[int, bool] | None:
    utc = re.fullmatch(r"(\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d)(?:\.(\d{1,9}))?Z?", xmp.get("UTCAtExposure", ""))
    if utc is None:
        return None
    try:
        whole = datetime.fromisoformat(utc[1]).replace(tzinfo=UTC)
    except ValueError:
        return None
    return int(whole.timestamp()) * 1_000_000_000 + int((utc[2] or "0").ljust(9, "0")), utc[2] is None


def _gps_time(gps: Mapping[int, object]) -> int | None:
    """GPSDateStamp and GPSTimeStamp, which are UTC -> Unix ns."""
    parts = gps.get(ExifTags.GPS.GPSTimeStamp)
    text = str(gps.get(ExifTags.GPS.GPSDateStamp, "")).strip("\0 ")
    if not isinstance(parts, tuple | list) or len(parts) != 3:
        return None
    hours, minutes, seconds = (number(part) for part in parts)
    if hours is None or minutes is None or seconds is None:
        return None
    try:
        day = datetime.strptime(text, "%Y:%m:%d").replace(tzinfo=UTC)
    except ValueError:
        return None
    return int(day.timestamp()) * 1_000_000_000 + round((hours * 3600.0 + minutes * 60.0 + seconds) * 1e9)


def _place(gps: Mapping[int, object], xmp: Mapping[str, str]) -> tuple[float | None, float | None]:
    """Latitude and longitude in degrees; DJI's XMP has more digits than its EXIF, and one letter too many."""
    lat, lon = _xmp_place(xmp)
    if lat is None or lon is None:
        lat, lon = _exif_place(gps)
    return (lat, lon) if _is_place(lat, lon) else (None, None)


def _xmp_place(xmp: Mapping[str, str]) -> tuple[float | None, float | None]:
    lat = number(xmp.get("GpsLatitude", xmp.get("Latitude")))
    return lat, number(xmp.get("GpsLongitude", xmp.get("GpsLongtitude", xmp.get("Longitude"))))


def _exif_place(gps: Mapping[int, object]) -> tuple[float | None, float | None]:
    lat = _sexagesimal(gps.get(ExifTags.GPS.GPSLatitude), gps.get(ExifTags.GPS.GPSLatitudeRef), "NS")
    return lat, _sexagesimal(gps.get(ExifTags.GPS.GPSLongitude), gps.get(ExifTags.GPS.GPSLongitudeRef), "EW")


def _is_place(lat: float | None, lon: float | None) -> bool:
    is_on_earth = lat is not None and lon is not None and abs(lat) <= 90.0 and abs(lon) <= 180.0
    return is_on_earth and (lat, lon) != (0.0, 0.0)


def _places_apart_m(gps: Mapping[int, object], xmp: Mapping[str, str]) -> float:
    (lat, lon), (other_lat, other_lon) = _xmp_place(xmp), _exif_place(gps)
    if not (_is_place(lat, lon) and _is_place(other_lat, other_lon)):
        return 0.0
    assert lat is not None and lon is not None and other_lat is not None and other_lon is not None
    return distance_m((lat, lon), (other_lat, other_lon))


def _side(reference: object, sides: str) -> str:
    """The reference letter, of the positive side first; empty where it is neither."""
    text = reference.decode("ascii", "replace") if isinstance(reference, bytes) else str(reference or "")
    letter = text.strip("\0 ").upper()[:1]
    return letter if letter in sides else ""


def _has_sides(gps: Mapping[int, object]) -> bool:
    of_lat, of_lon = gps.get(ExifTags.GPS.GPSLatitudeRef), gps.get(ExifTags.GPS.GPSLongitudeRef)
    return bool(_side(of_lat, "NS") and _side(of_lon, "EW"))


def _sexagesimal(value: object, reference: object, sides: str) -> float | None:
    """Degrees; None also without a letter, which alone states the side of the equator or of Greenwich."""
    side = _side(reference, sides)
    if not side or not isinstance(value, tuple | list) or len(value) != 3:
        return None
    degrees, minutes, seconds = (number(part) for part in value)
    if degrees is None or minutes is None or seconds is None:
        return None
    angle = degrees + minutes / 60.0 + seconds / 3600.0
    return -angle if side == sides[1] else angle


def _height(gps: Mapping[int, object], xmp: Mapping[str, str], make: str) -> tuple[float | None, bool, bool]:
    """The height, whether it counts from the ellipsoid, and whether it is a barometer's.

    DJI's RTK counts from the ellipsoid, which newer aircraft state (AltitudeType) and the Phantom 4 RTK does not; so
    does Skydio always, and Pix4D's namespace states it.
    """
    height_m, kind = number(xmp.get("AbsoluteAltitude")), xmp.get("AltitudeType", "")
    gps_height_m, is_ellipsoidal = _gps_height(gps)
    is_ellipsoidal |= "ellips" in xmp.get("Camera:VertCS", "").lower() or make == "Skydio"
    if height_m is None:
        return gps_height_m, is_ellipsoidal and gps_height_m is not None, make == "DJI" and not is_ellipsoidal
    has_rtk = xmp.get("RtkFlag", "").strip() in RTK_FLAGS or bool(number(xmp.get("RtkStdHgt")))
    is_rtk = kind == "RtkAlt" or (not kind and has_rtk)
    is_from_ellipsoid = is_rtk or make == "Skydio"
    return height_m, is_from_ellipsoid, not is_from_ellipsoid and kind != "GpsFusionAlt"


def _gps_height(gps: Mapping[int, object]) -> tuple[float | None, bool]:
    """EXIF's altitude, and whether it counts from the ellipsoid (EXIF 3: references 2 and 3)."""
    height_m, reference = number(gps.get(ExifTags.GPS.GPSAltitude)), gps.get(ExifTags.GPS.GPSAltitudeRef, 0)
    code = reference[0] if isinstance(reference, bytes) and reference else reference
    if height_m is not None and code in (1, 3):
        height_m = -height_m
    return height_m, code in (2, 3)


def _angles(xmp: Mapping[str, str], *patterns: str) -> Angles | None:
    for pattern in patterns:
        roll, pitch, yaw = (number(xmp.get(pattern.format(angle))) for angle in ("Roll", "Pitch", "Yaw"))
        if roll is not None and pitch is not None and yaw is not None:
            return roll, pitch, yaw
    return None


def _camera_angles(xmp: Mapping[str, str], make: str) -> Angles | None:
    """Return the angles of the optical axis, pitch -90 looking down; None if there are none.

    DJI's, Parrot's and Skydio's are taken as they are, Pix4D's are turned.
    """
    stated = _angles(xmp, "Gimbal{}Degree", "Camera{}Degree", "CameraOrientationNED/{}")
    if stated is not None:
        return stated
    nadir = _angles(xmp, "Camera:{}")
    if nadir is None:
        return None
    # Pix4D counts from looking straight down with the picture's top to the north; senseFly has roll the other way.
    roll, pitch, yaw = nadir if make.lower() != "sensefly" else (-nadir[0], *nadir[1:])
    R_ned_camera = matrix_from_euler(*np.radians([roll, pitch, yaw])) @ matrix_from_euler(0.0, -math.pi / 2.0, 0.0)
    roll, pitch, yaw = np.degrees(euler_from_matrix(R_ned_camera)).tolist()
    return roll, pitch, yaw


def _readout(xmp: Mapping[str, str], size_px: tuple[int, int]) -> float | None:
    """Return the read-out time of all rows, s, by the time of one; None if it is not stated or impossible.

    Its unit is the one of s, ms, us, ns that makes a picture possible.
    """
    line = number(xmp.get("Camera:LineReadoutTime"))
    if not line or line < 0.0:
        return None
    in_s = (line * size_px[1] * unit_s for unit_s in (1.0, 1e-3, 1e-6, 1e-9))
    return next((readout_s for readout_s in in_s if MIN_READOUT_S < readout_s < MAX_READOUT_S), None)


def _band(xmp: Mapping[str, str]) -> tuple[int, str] | None:
    """Return the camera of a rig and its band, if the picture states that it is of one."""
    index, source = number(xmp.get("Camera:RigCameraIndex")), xmp.get("ImageSource", "")
    if index is not None:
        return int(index), xmp.get("Camera:BandName", "")
    return (DJI_SOURCES.index(source), source) if source in DJI_SOURCES else None
