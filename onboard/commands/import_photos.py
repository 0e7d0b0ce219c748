"""What `pc-onboard import-photos` does: a folder of survey photographs becomes a flight that `replay` reads."""

from __future__ import annotations

import argparse
import csv
import io
import itertools
import json
import math
import shutil
from collections import Counter
from pathlib import Path

from contract.camera import Camera
from contract.errors import InputError
from contract.geodesy import LocalFrame
from onboard.camera.file_stamps import spread_within_seconds
from onboard.camera.photo_metadata import Focal, PhotoMetadata, read_photo
from onboard.camera.picture_files import PICTURE_SUFFIXES
from onboard.config.schema import parse_config
from onboard.replay.photo_telemetry import gap_to_join_s, height_amsl, photo_telemetry
from onboard.telemetry.log_files import read_log

MIN_PHOTOS = 3
# One sigma of what nobody says: where the optical axis meets a sensor (share of its width), how straight a lens for
# mapping draws (k1 of lenses as they are sold: within some hundredths), how level a gimbal holds, how well a camera is
# screwed below an aircraft.
SIGMA_CENTRE, SIGMA_K1, SIGMA_GIMBAL_DEG, SIGMA_MOUNT_DEG = 0.01, 0.03, 1.0, 5.0
SIGMA_TAG_S = 0.1  # of the moment of a tagged position: receivers give five to ten a second
WHOLE_SECOND_S = 0.29  # evenly within a second
TURNED_BACK = 2.0  # steps that two legs in opposite directions differ by
WITHIN_S = 0.01  # of stamps with fractions
POSITION_FIELDS = ("unix_time_s", "lat_deg", "lon_deg", "height_amsl_m", "height_above_home_m")
ANGLE_FIELDS = (
    *("roll_deg", "pitch_deg", "yaw_deg"),
    *("gimbal_roll_deg", "gimbal_pitch_deg", "gimbal_yaw_deg"),
)
OTHER_FIELDS = ("velocity_north_m_s", "velocity_east_m_s", "sigma_horizontal_m", "sigma_vertical_m")


def run(arguments: argparse.Namespace) -> int:
    """Make the flight and print what was assumed. Everything is read and checked before anything is written."""
    photos = _photos(arguments.folder)
    out: Path = arguments.out
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"{out} is not an empty folder; name a new one")
    if not out.parent.is_dir():
        raise InputError(f"{out}: no such folder as {out.parent}")
    photos, stamps_ns, is_whole = _in_order(photos)
    focal = _focal(photos)
    camera = _camera(photos[0], focal)
    own = None if arguments.telemetry is not None else photo_telemetry(photos, stamps_ns, None)
    if arguments.telemetry is not None:
        read_log(arguments.telemetry)
    config, assumed = _config(photos, stamps_ns, is_whole, own is not None)
    parse_config(config)
    frames = out / "frames"
    frames.mkdir(parents=True)
    for photo in photos:
        _place(arguments.folder / photo.name, frames / photo.name, arguments.copy)
    stamp_rows = [f"{photo.name},{stamp / 1e9:.6f}" for photo, stamp in zip(photos, stamps_ns, strict=True)]
    (out / "stamps.csv").write_text("\n".join(["file,unix_time_s", *stamp_rows]) + "\n")
    (out / "camera.json").write_text(_camera_file(camera, focal))
    (out / "config.toml").write_text(config)
    telemetry = arguments.telemetry
    if telemetry is None:
        telemetry = out / "telemetry.csv"
        telemetry.write_text(_telemetry_table(photos, stamps_ns, is_whole))
    where = "copied" if arguments.copy else f"links to {arguments.folder.resolve()}"
    rows = [
        ("pictures", f"{len(photos)} of {photos[0].model or 'an unnamed camera'}, {where}"),
        ("times", _times_text(stamps_ns, is_whole)),
        ("camera", _camera_text(camera, focal)),
        *assumed,
    ]
    width = max(len(name) for name, _ in rows)
    print("\n".join(f"{name:<{width}}  {text}" for name, text in rows))
    print(
        f"written: {out}; what was assumed is in its config.toml and camera.json, to be changed where you know better"
    )
    print(
        f"pc-onboard replay --config {out / 'config.toml'} --frames {frames} --telemetry {telemetry} "
        f"--camera {out / 'camera.json'} --stamps {out / 'stamps.csv'} --record {out / 'session.mcap'}"
    )
    return 0


def _photos(folder: Path) -> list[PhotoMetadata]:
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder of photographs")
    names = sorted(e.name for e in folder.iterdir() if e.suffix.lower() in PICTURE_SUFFIXES and e.is_file())
    if len(names) < MIN_PHOTOS:
        raise InputError(f"{folder}: {len(names)} pictures in it; at least {MIN_PHOTOS} of one flight are needed")
    photos = [read_photo(folder / name) for name in names]
    for what, values in (
        ("size", [photo.size_px for photo in photos]),
        ("camera", [photo.model for photo in photos]),
    ):
        usual, _ = Counter(values).most_common(1)[0]
        odd = next((p for p, v in zip(photos, values, strict=True) if v != usual), None)
        if odd is not None:
            raise InputError(
                f"{folder}: {odd.name} has another {what} than most; keep the pictures of one camera in one folder"
            )
    return photos


def _in_order(photos: list[PhotoMetadata]) -> tuple[list[PhotoMetadata], list[int], bool]:
    """By capture time, each with its own; True if the times are cut to the second."""
    for photo in photos:
        if photo.stamp_ns is None:
            raise InputError(
                f"photograph {photo.name}: no DateTimeOriginal in its EXIF; give pictures as they were taken"
            )
    is_whole = any(photo.stamp_is_whole_s for photo in photos)
    ordered = sorted(photos, key=lambda photo: (photo.stamp_ns or 0, photo.name))
    stamps = [photo.stamp_ns or 0 for photo in ordered]
    if is_whole:
        return ordered, spread_within_seconds([stamp - stamp % 1_000_000_000 for stamp in stamps]), True
    for (a, one), (b, other) in itertools.pairwise(zip(stamps, ordered, strict=True)):
        if a == b:
            raise InputError(f"photographs {one.name} and {other.name} have the same capture time; remove the copy")
    return ordered, stamps, False


def _focal(photos: list[PhotoMetadata]) -> Focal:
    known = [photo.focal for photo in photos if photo.focal is not None]
    if len(known) < len(photos):
        raise InputError(
            f"photograph {next(p.name for p in photos if p.focal is None)}: no focal length in EXIF (FocalLength with "
            "FocalPlaneXResolution, or FocalLengthIn35mmFilm); calibrate the camera: pc-onboard calibrate"
        )
    if max(f.fx_px for f in known) > 1.01 * min(f.fx_px for f in known):
        raise InputError("the photographs' focal lengths differ by more than 1 %: it was zoomed; a flight has one")
    return known[0]


def _camera(photo: PhotoMetadata, focal: Focal) -> Camera:
    width, height = photo.size_px
    cx, cy = focal.centre_px or ((width - 1) / 2.0, (height - 1) / 2.0)
    return Camera(width, height, focal.fx_px, focal.fy_px, cx, cy, focal.distortion or (0.0, 0.0, 0.0, 0.0, 0.0))


def _camera_file(camera: Camera, focal: Focal) -> str:
    """The camera file, with sigmas where `pc-onboard calibrate` has them."""
    is_calibrated = focal.distortion is not None
    centre_px = focal.sigma_px if is_calibrated else SIGMA_CENTRE * camera.width_px
    sigma = {"fx": focal.sigma_px, "fy": focal.sigma_px, "cx": centre_px, "cy": centre_px}
    k1 = 0.1 * SIGMA_K1 if is_calibrated else SIGMA_K1
    sigma |= {"k1": k1, "k2": k1, "p1": 0.1 * k1, "p2": 0.1 * k1, "k3": k1}
    known = json.loads(camera.to_json())
    known["calibration"] = {
        "verdict": f"guessed from EXIF ({focal.source}), not calibrated",
        "sigma": {name: float(f"{value:.3g}") for name, value in sigma.items()},
    }
    return json.dumps(known, indent=1) + "\n"


def _camera_text(camera: Camera, focal: Focal) -> str:
    lens = "distortion as the picture says" if focal.distortion is not None else "no distortion known, taken as none"
    return (
        f"focal length {focal.fx_px:.0f} +-{focal.sigma_px:.0f} px from {focal.source}, "
        f"{camera.width_px} x {camera.height_px}, {lens}"
    )


def _config(
    photos: list[PhotoMetadata], stamps_ns: list[int], is_whole: bool, by_photos: bool
) -> tuple[str, list[tuple[str, str]]]:
    """The configuration's text, and what it assumes."""
    sections: dict[str, list[str]] = {"mount": ["pitch_deg = -90.0"], "camera": [], "solve": [], "gps": []}
    assumed: list[tuple[str, str]] = []
    has_gimbal = by_photos and all(photo.gimbal_deg is not None for photo in photos)
    has_body = by_photos and all(photo.body_deg is not None for photo in photos)
    if has_gimbal:
        sections["mount"] += ['gimbal = "always"', f"sigma_deg = {SIGMA_GIMBAL_DEG}"]
        assumed.append(("mount", f"the gimbal's angles as the pictures say, +-{SIGMA_GIMBAL_DEG:g} deg"))
    elif has_body or not by_photos:
        sections["mount"] += [f"sigma_deg = {SIGMA_MOUNT_DEG}"]
        assumed.append(("mount", f"fixed, straight down, top towards the nose, +-{SIGMA_MOUNT_DEG:g} deg"))
    else:
        sections["mount"] += [f"sigma_deg = {SIGMA_MOUNT_DEG}"]
        sections["solve"] += ['attitude = "none"', "level_ground = true"]
        assumed.append(("mount", "no angles in the pictures: looking straight down, over ground level on average"))
    if by_photos:
        gap_s = gap_to_join_s(stamps_ns)
        sections["telemetry"] = [f"max_attitude_gap_s = {gap_s}"]
        sections["gps"] += [f"max_gap_s = {max(gap_s, 1.5)}", "latency_s = 0.0", f"sigma_latency_s = {SIGMA_TAG_S}"]
        sections["gps"].append(f"glitch_m = {_turn_m(photos):.0f}.0")
        sections["camera"] += [f"sigma_latency_s = {WITHIN_S}"]
        assumed.append(("positions", _positions_text(photos)))
        horizontal = [photo.sigma_horizontal_m for photo in photos if photo.sigma_horizontal_m is not None]
        if len(horizontal) == len(photos):
            sections["gps"].append(f"sigma_wander_horizontal_m = {max(horizontal):.3f}")
    elif is_whole:
        sections["camera"] += ["latency_s = -0.5", f"sigma_jitter_s = {WHOLE_SECOND_S}"]
    lines = ["# Made by `pc-onboard import-photos`; what is not here is the default (config.toml of the sources)."]
    for name, keys in sections.items():
        lines += ["", f"[{name}]", *keys] if keys else []
    return "\n".join(lines) + "\n", assumed


def _turn_m(photos: list[PhotoMetadata]) -> float:
    """By how much two steps in a row may differ where the aircraft turned back between two pictures: no jump yet."""
    first = LocalFrame(photos[0].lat_deg or 0.0, photos[0].lon_deg or 0.0, 0.0)
    east_north_m = [first.to_enu(photo.lat_deg or 0.0, photo.lon_deg or 0.0, 0.0)[:2] for photo in photos]
    longest_m = max(math.dist(a, b) for a, b in itertools.pairwise(east_north_m))
    return min(max(TURNED_BACK * longest_m, 10.0), 1000.0)


def _positions_text(photos: list[PhotoMetadata]) -> str:
    height_sigma_m = max(height_amsl(photo, None)[1] or 0.0 for photo in photos)
    said = [photo.sigma_horizontal_m for photo in photos if photo.sigma_horizontal_m is not None]
    accuracy = f"+-{max(said):.2g} m as they say" if said else "+-1.5 m assumed"
    what = "from the ellipsoid (set gps.undulation_m)" if photos[0].height_is_ellipsoidal else "above sea level"
    return f"each picture's own, {accuracy}; heights {what}, +-{height_sigma_m:.2g} m"


def _times_text(stamps_ns: list[int], is_whole: bool) -> str:
    apart_s = sorted((b - a) / 1e9 for a, b in itertools.pairwise(stamps_ns))
    cut = "cut to the second, evenly spread within it" if is_whole else "EXIF's, with fractions of a second"
    return f"{cut}; {apart_s[len(apart_s) // 2]:.1f} s apart; without a zone taken as UTC"


def _telemetry_table(photos: list[PhotoMetadata], stamps_ns: list[int], is_whole: bool) -> str:
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow([*POSITION_FIELDS, *ANGLE_FIELDS, *OTHER_FIELDS])
    for photo, stamp_ns in zip(photos, stamps_ns, strict=True):
        height_m, sigma_m = height_amsl(photo, None)
        velocity = (None, None) if is_whole or photo.velocity_ne_m_s is None else photo.velocity_ne_m_s
        cells: list[object] = [f"{stamp_ns / 1e9:.6f}", f"{photo.lat_deg:.9f}", f"{photo.lon_deg:.9f}"]
        cells += [f"{height_m:.3f}", photo.above_home_m]
        cells += [*(photo.body_deg or (None,) * 3), *(photo.gimbal_deg or (None,) * 3), *velocity]
        table.writerow([*cells, photo.sigma_horizontal_m, sigma_m])
    return text.getvalue()


def _place(photo: Path, target: Path, copy: bool) -> None:
    try:
        if copy:
            shutil.copyfile(photo, target)
        else:
            target.symlink_to(photo.resolve())
    except OSError as error:
        raise InputError(f"{target}: {error.strerror}; where links cannot be made, give --copy") from error
