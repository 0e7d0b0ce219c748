"""Photographs as cameras on aircraft write them: the pictures of a simulated flight as JPEGs with EXIF and XMP."""

import csv
import math
from dataclasses import dataclass
from datetime import UTC, datetime
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import ExifTags, Image
from PIL.TiffImagePlugin import IFDRational

from contract.camera import Camera
from contract.geodesy import LocalFrame
from contract.rotations import R_ENU_NED, euler_from_matrix, matrix_from_quaternion

Array = NDArray[np.float64]

# Camera axes (right, down, forward) in a gimbal's (forward, right, down).
R_GIMBAL_CAM = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
XMP = (
    '<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?><x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF '
    'xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><rdf:Description rdf:about="" '
    'xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" {attributes}/></rdf:RDF></x:xmpmeta><?xpacket end="w"?>'
)


@dataclass(frozen=True)
class Style:
    """What a camera writes, and how wrong."""

    whole_seconds: bool = False
    gps: bool = True
    sides: bool = True  # the letters N or S, E or W of a position in EXIF
    angles: bool = True  # in DJI's XMP
    focal: str = "design"  # "design" (XMP), "plane" (EXIF), "equivalent" (EXIF), "none"
    focal_error: float = 0.0
    rtk: bool = False
    offset_m: tuple[float, float, float] = (0.8, -0.6, 12.0)  # east, north, up: of all positions
    white_m: float = 0.2
    step_m: tuple[float, float, float] = (0.0, 0.0, 0.0)  # more, of the positions of some pictures
    stepped: range = range(0)
    gps_time_s: float | None = None  # by which a receiver's time in EXIF differs from the camera's


def write_photographs(session: Path, out: Path, style: Style, seed: int = 0) -> None:
    """The frames of a simulated session (`simulation.session.fly`) as photographs in a new folder."""
    camera = Camera.from_json(session / "camera.json")
    rng = np.random.default_rng(seed)
    out.mkdir()
    with (session / "truth.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    for number, row in enumerate(rows):
        place = LocalFrame(float(row["lat_deg"]), float(row["lon_deg"]), float(row["height_amsl_m"]))
        lat, lon, height = place.to_geodetic(_error_m(style, number, rng))
        R_enu_cam = matrix_from_quaternion([float(row[f"q_enu_cam_{c}"]) for c in "wxyz"])
        roll, pitch, yaw = np.degrees(euler_from_matrix(R_ENU_NED.T @ R_enu_cam @ R_GIMBAL_CAM.T)).tolist()
        exif, attributes = Image.Exif(), {}
        exif[ExifTags.Base.Make], exif[ExifTags.Base.Model] = "DJI", "FC7303"
        details: dict[int, object] = _times(float(row["unix_time_s"]), style)
        details |= _lens(camera, style, attributes)
        if number % 2 == 0:  # not all pictures of one camera need state it
            details[ExifTags.Base.BodySerialNumber] = "1581F4AAA"
        if style.gps:
            exif._ifds[ExifTags.IFD.GPSInfo] = _gps(float(lat), float(lon), float(height))
            if not style.sides:
                for tag in (ExifTags.GPS.GPSLatitudeRef, ExifTags.GPS.GPSLongitudeRef):
                    del exif._ifds[ExifTags.IFD.GPSInfo][tag]
        if style.gps_time_s is not None:
            moment = datetime.fromtimestamp(float(row["unix_time_s"]) + style.gps_time_s, UTC)
            exif._ifds[ExifTags.IFD.GPSInfo] |= {
                ExifTags.GPS.GPSDateStamp: moment.strftime("%Y:%m:%d"),
                ExifTags.GPS.GPSTimeStamp: (moment.hour, moment.minute, moment.second),
            }
        if style.gps and style.angles:
            attributes |= {"GpsLatitude": f"{lat:+.9f}", "GpsLongitude": f"{lon:+.9f}"}
            attributes |= {"AbsoluteAltitude": f"{height:+.2f}", "RelativeAltitude": f"{height - 112.0:+.2f}"}
        if style.angles:
            turned = (roll, pitch + 0.3, yaw + 1.0)
            attributes |= {
                f"Gimbal{a}Degree": f"{v:+.2f}" for a, v in zip(("Roll", "Pitch", "Yaw"), turned, strict=True)
            }
            attributes |= {
                f"Flight{a}Degree": f"{v:+.2f}" for a, v in zip(("Roll", "Pitch", "Yaw"), (4, -9, yaw), strict=True)
            }
        if style.rtk:
            attributes |= {"RtkFlag": "50", "RtkStdLat": "0.012", "RtkStdLon": "0.012", "RtkStdHgt": "0.03"}
        exif._ifds[ExifTags.IFD.Exif] = details
        words = " ".join(f'drone-dji:{name}="{value}"' for name, value in attributes.items())
        with Image.open(session / "frames" / row["file"]) as image:
            image.save(out / f"DJI_{number + 1:04d}.JPG", "JPEG", quality=92, exif=exif,
                       xmp=XMP.format(attributes=words).encode() if words else b"")  # fmt: skip


def _error_m(style: Style, number: int, rng: np.random.Generator) -> Array:
    step_m = np.array(style.step_m) if number in style.stepped else np.zeros(3)
    out: Array = np.array(style.offset_m) + style.white_m * rng.standard_normal(3) + step_m
    return out


def _times(unix_s: float, style: Style) -> dict[int, object]:
    moment = datetime.fromtimestamp(unix_s, UTC)
    out: dict[int, object] = {ExifTags.Base.DateTimeOriginal: moment.strftime("%Y:%m:%d %H:%M:%S")}
    if not style.whole_seconds:
        out[ExifTags.Base.SubsecTimeOriginal] = f"{moment.microsecond // 1000:03d}"
    return out


def _lens(camera: Camera, style: Style, attributes: dict[str, str]) -> dict[int, object]:
    focal_px, (width, height) = camera.fx_px * (1.0 + style.focal_error), camera.size_px
    if style.focal == "design":
        attributes["CalibratedFocalLength"] = f"{focal_px:.6f}"
    if style.focal == "plane":
        return {
            ExifTags.Base.FocalLength: IFDRational(45, 10),
            ExifTags.Base.FocalPlaneXResolution: IFDRational(Fraction(focal_px / 4.5 * 10.0).limit_denominator(10000)),
            ExifTags.Base.FocalPlaneResolutionUnit: 3,
        }
    if style.focal == "equivalent":
        return {ExifTags.Base.FocalLengthIn35mmFilm: round(focal_px * 43.2666 / math.hypot(width, height))}
    return {}


def _gps(lat: float, lon: float, height: float) -> dict[int, object]:
    return {
        ExifTags.GPS.GPSLatitudeRef: "N" if lat >= 0 else "S",
        ExifTags.GPS.GPSLatitude: _sexagesimal(lat),
        ExifTags.GPS.GPSLongitudeRef: "E" if lon >= 0 else "W",
        ExifTags.GPS.GPSLongitude: _sexagesimal(lon),
        ExifTags.GPS.GPSAltitudeRef: b"\x00",
        ExifTags.GPS.GPSAltitude: IFDRational(round(height * 1000), 1000),
    }


def _sexagesimal(angle: float) -> tuple[IFDRational, IFDRational, IFDRational]:
    degrees, rest = divmod(abs(angle), 1.0)
    minutes, rest = divmod(rest * 60.0, 1.0)
    return IFDRational(int(degrees)), IFDRational(int(minutes)), IFDRational(round(rest * 60e6), 1000000)
