"""The command `pc-onboard import-photos`: a folder of survey photographs becomes a flight that `replay` reads."""

from __future__ import annotations

import argparse
import csv
import io
import itertools
import math
import shutil
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from contract.errors import InputError
from onboard.camera.file_stamps import read_stamps, spread_within_seconds, stamp_from_name
from onboard.camera.photo_metadata import Focal, PhotoMetadata, read_photo
from onboard.camera.picture_files import PICTURE_SUFFIXES
from onboard.camera.rig_bands import one_band
from onboard.commands.camera_clock import against_log, clock_of, clock_row
from onboard.commands.flight_folder import log_of, next_to, picture_folder
from onboard.commands.imported_flight import (
    SIGMA_GIMBAL_DEG,
    SIGMA_MOUNT_DEG,
    SIGMA_STAMPS_S,
    ImportedFlight,
    Optics,
    Row,
    check_out,
    config_text,
    log_rows,
    mount_by_log,
    optics_of,
    options_of,
    rolling_shutter,
    sections_of,
    settings_of,
    shots_in_folder,
)
from onboard.config.schema import Gps, parse_config
from onboard.foreign_clock.clock_search import Stated
from onboard.replay.photo_steps import doubt_text, east_north_m, small_pictures, without_steps
from onboard.replay.photo_telemetry import datum_sigma_m, gap_to_join_s, height_amsl, photo_telemetry, side_lacking
from onboard.replay.runner import check_overlap
from onboard.telemetry.geo_reader import GeoPlace, read_geo
from onboard.telemetry.log_files import format_of, read_logs
from onboard.telemetry.log_formats import SUFFIXES
from onboard.telemetry.telemetry_log import NS_PER_S, TelemetryLog

Array = NDArray[np.float64]

MIN_PHOTOS = 3
# Of a flight's folder, next to its pictures or above them.
STAMPS, CONFIG, GEO = "stamps.csv", "config.toml", "geo.txt"
SIGMA_READOUT_S = 0.003  # of a line's time that a picture states, times its rows
SIGMA_TAG_S = 0.1  # of the moment of a tagged position: receivers give five to ten a second
WHOLE_SECOND_S = 0.29  # evenly within a second
TURNED_BACK = 2.0  # steps that two legs in opposite directions differ by
WITHIN_S = 0.01  # of a photograph's own position, which has its own time
SIGMA_STAMP_S, HALF_NS = 0.03, 500_000_000  # of a stamp with fractions; of one cut to the second, on average
SIGMA_FIX_S = 0.5  # by which the time of a receiver's last fix is before the exposure, or after it
MOST_OF = 0.5  # of the photographs, that must state such a time
SPREAD_S = 60.0  # of times of fixes against the camera's, beyond which they are not those of the exposures
POSITION_FIELDS = ("unix_time_s", "lat_deg", "lon_deg", "height_amsl_m", "height_above_home_m")
ANGLE_FIELDS = (
    *("roll_deg", "pitch_deg", "yaw_deg"),
    *("gimbal_roll_deg", "gimbal_pitch_deg", "gimbal_yaw_deg"),
)
OTHER_FIELDS = (
    *("velocity_north_m_s", "velocity_east_m_s", "sigma_horizontal_m", "sigma_vertical_m"),
    "sigma_datum_m",
)


@dataclass(frozen=True)
class _Times:
    """The photographs' capture times, in order, and where they are from."""

    stamps_ns: list[int]
    is_whole: bool  # cut to the second
    source: str
    is_of_flight: bool = False  # they are its own, made for its log

    @property
    def moments_ns(self) -> list[int]:
        """The likeliest exposure: half a second after what was cut to the second."""
        return [stamp_ns + HALF_NS * self.is_whole for stamp_ns in self.stamps_ns]

    @property
    def sigma_s(self) -> float:
        return WHOLE_SECOND_S if self.is_whole else SIGMA_STAMP_S

    def moved(self, offset_s: float) -> _Times:
        return replace(self, stamps_ns=[stamp_ns + round(offset_s * 1e9) for stamp_ns in self.stamps_ns])


def run(arguments: argparse.Namespace) -> int:
    """Make the flight and print what was assumed. Everything is read and checked before anything is written."""
    settings = settings_of(arguments.set)
    folder = picture_folder(arguments.folder)
    photos, rig = one_band(_photos(folder))
    _check_one_camera(folder, photos)
    out: Path = arguments.out
    check_out(out)
    if arguments.stamps is not None and _by_table(photos, arguments.stamps) is None:
        raise InputError(f"stamps {arguments.stamps}: of fewer than {MIN_PHOTOS} pictures in {folder}")
    photos, times = _in_order(photos, arguments.utc_offset, arguments.stamps or next_to(folder, STAMPS))
    optics = optics_of(photos[0].size_px, _focal(photos), folder, settings)
    photos, geo = _placed(photos, arguments.telemetry, next_to(folder, GEO))
    paths, log = ((), None) if geo is not None else _log(arguments, folder, photos, times)
    stated = _stated(photos, times, arguments.clock_offset)
    if log is not None and not times.is_of_flight:
        stated = against_log(stated, log, arguments.clock_offset is not None)
    config = None if log is None else _config_in(arguments.folder, folder)
    if config is not None:
        sections, assumed = sections_of(config), [("configuration", f"{config}, nothing guessed")]
    elif log is None:
        times = times.moved(0.0 if stated is None else stated.offset_s)
        sections, assumed = _by_photos(photos, times)
        mended = without_steps(photos, folder, optics.camera, Gps())
        photos, assumed = mended.photos, assumed + [("step", words) for words in mended.steps]
        sections["gps"] |= {"glitch_m": f"{_turn_m(photos):.0f}.0"}
        if mended.doubt_m:
            assumed.append(("places", doubt_text(mended.doubt_m)))
            sections["gps"] |= {"correlation_time_s": f"{mended.correlation_time_s:.0f}.0"}
    else:
        sections, assumed = _by_log(log, times)
    if config is None:
        assumed += _rows_of(photos[0], optics, sections) + _thermal_rows(photos[0], sections)
    if log is not None:
        if config is None or not times.is_of_flight:
            settled = parse_config(config_text(sections, settings))
            pictures = small_pictures([folder / photo.name for photo in photos])
            clock = clock_of(log, settled, optics.camera, times.moments_ns, times.sigma_s, pictures, stated)
            times = times.moved(clock.offset_s)
            sections.setdefault("camera", {})["sigma_latency_s"] = f"{clock.sigma_s:.3f}"
            assumed.append(clock_row(clock))
        check_overlap(times.stamps_ns, log)
    frames = out / "frames"
    flight = ImportedFlight(
        out, frames, paths or (out / "telemetry.csv",), optics,
        ["file,unix_time_s", *(f"{p.name},{t / 1e9:.6f}" for p, t in zip(photos, times.stamps_ns, strict=True))],
        sections,
    )  # fmt: skip
    where = "copied" if arguments.copy else f"links to {folder.resolve()}"
    flight.rows = [
        ("pictures", f"{len(photos)} of {photos[0].model or 'an unnamed camera'}, {where}"),
        *([("band", rig)] if rig else []),
        ("times", _times_text(times)),
        ("camera", optics.text),
        *([] if log is None else log_rows(paths, log)),
        *([("places", str(geo))] if geo is not None else []),
        *assumed,
    ]
    if log is not None and arguments.home_amsl_m is not None:
        flight.replay += ["--home-amsl-m", f"{arguments.home_amsl_m:g}"]
    flight.write(settings)
    frames.mkdir()
    for photo in photos:
        _place(folder / photo.name, frames / photo.name, arguments.copy)
    if log is None:
        (out / "telemetry.csv").write_text(_telemetry_table(photos, times))
    flight.print_assumed()
    return 0


def _config_in(named: Path, folder: Path) -> Path | None:
    """The configuration of a flight's own folder, where that is what was named: nothing has to be guessed then."""
    found = next_to(folder, CONFIG)
    return found if found is not None and named.resolve() in found.resolve().parents else None


def _rows_of(photo: PhotoMetadata, optics: Optics, sections: dict[str, dict[str, str]]) -> list[Row]:
    """Into the configuration: in what time rows are read, as the pictures state it, or guessed of an unknown camera."""
    if photo.readout_s is not None:
        readout = {"readout_s": f"{photo.readout_s:.4f}", "sigma_readout_s": f"{SIGMA_READOUT_S}"}
        sections.setdefault("camera", {}).update(readout)
        return []
    return [] if optics.is_known else [rolling_shutter(sections)]


def _thermal_rows(photo: PhotoMetadata, sections: dict[str, dict[str, str]]) -> list[Row]:
    """Into the configuration: pictures with counts are a thermal camera's; what a count is in kelvin none states."""
    if not photo.counts:
        return []
    sections["thermal"] = {"enabled": "true"}
    return [("thermal", f"the counts in each {photo.counts}, uncalibrated: hot spots by contrast, no temperatures")]


def _log(
    arguments: argparse.Namespace, folder: Path, photos: list[PhotoMetadata], times: _Times
) -> tuple[tuple[Path, ...], TelemetryLog | None]:
    """The log or the two that were named; else none if the pictures state where they were; else one that lies with
    them.
    """
    paths: tuple[Path, ...] = tuple(arguments.telemetry)
    if not paths:
        if any(photo.lat_deg is not None for photo in photos):
            photo_telemetry(photos, times.stamps_ns, None)  # whether it is complete
            return (), None
        found = log_of(folder, arguments.folder)
        paths = () if found is None else (found,)
    if not paths:
        raise InputError(
            f"{folder}: no GPS position with a height in {photos[0].name}{side_lacking(photos[0])} and the others, and "
            f"no log next to them: give a log of the flight ({', '.join(SUFFIXES)})"
        )
    log = read_logs(paths, options_of(arguments.home_amsl_m, settings_of(arguments.set)))
    return paths, log if log.shots_ns else replace(log, shots_ns=shots_in_folder(folder))


def _placed(
    photos: list[PhotoMetadata], named: list[Path], found: Path | None
) -> tuple[list[PhotoMetadata], Path | None]:
    """The photographs where a file of positions has them, and that file: the one that was named, else one that lies
    with them, which replaces what they state, as OpenDroneMap takes it. Raises InputError where it lacks some of them.
    """
    path = found
    if named:
        form = format_of(named[0]) if len(named) == 1 else None
        path = named[0] if form is not None and form.key == "geo" else None
    if path is None:
        return photos, None
    places = read_geo(path)
    without = [photo.name for photo in photos if photo.name not in places]
    if len(without) == len(photos) and not named:
        return photos, None  # of other pictures
    if without:
        raise InputError(f"positions {path}: none of {without[0]}, nor of {len(without) - 1} more of the photographs")
    return [_placed_at(photo, places[photo.name]) for photo in photos], path


def _placed_at(photo: PhotoMetadata, place: GeoPlace) -> PhotoMetadata:
    return replace(
        photo,
        lat_deg=place.lat_deg,
        lon_deg=place.lon_deg,
        height_amsl_m=place.height_m,
        height_is_ellipsoidal=False,
        height_is_barometric=False,
        height_origin_is_unnamed=True,
        above_home_m=None,
        sigma_horizontal_m=place.sigma_horizontal_m,
        sigma_vertical_m=place.sigma_vertical_m,
        place_lacks_side=False,
        places_apart_m=0.0,
    )


def _stated(photos: list[PhotoMetadata], times: _Times, given: tuple[float, float] | None) -> Stated | None:
    """The offset of the camera's clock: as a person states, else by a receiver's time in the photographs."""
    if given is not None:
        return Stated(-given[0], math.hypot(given[1], WHOLE_SECOND_S * times.is_whole), "--clock-offset")
    if times.is_of_flight:
        return Stated(0.0, SIGMA_STAMPS_S, times.source)
    if times.source == "EXIF" and all(photo.stamp_is_utc for photo in photos):
        return Stated(0.0, SIGMA_TAG_S, "the pictures' UTC")
    apart_s = sorted(
        (photo.gps_ns + HALF_NS * (photo.gps_ns % NS_PER_S == 0) - moment_ns) / 1e9
        for photo, moment_ns in zip(photos, times.moments_ns, strict=True)
        if photo.gps_ns is not None
    )
    if len(apart_s) <= MOST_OF * len(photos):
        return None
    low_s, middle_s, high_s = (apart_s[round(share * (len(apart_s) - 1))] for share in (0.16, 0.5, 0.84))
    spread_s = 0.5 * (high_s - low_s)
    if spread_s > SPREAD_S:
        return None
    return Stated(middle_s, math.hypot(SIGMA_FIX_S, spread_s), "the GPS time in EXIF")


def _photos(folder: Path) -> list[PhotoMetadata]:
    names = sorted(e.name for e in folder.iterdir() if e.suffix.lower() in PICTURE_SUFFIXES and e.is_file())
    if len(names) < MIN_PHOTOS:
        raise InputError(
            f"{folder}: {len(names)} pictures in it or below it; at least {MIN_PHOTOS} of one flight are needed"
        )
    return [read_photo(folder / name) for name in names]


def _check_one_camera(folder: Path, photos: list[PhotoMetadata]) -> None:
    """Raise InputError for photographs of several cameras."""
    (serial, _), *_ = Counter(photo.serial for photo in photos if photo.serial).most_common(1) or [("", 0)]
    for what, values in (
        ("size", [photo.size_px for photo in photos]),
        ("camera", [photo.model for photo in photos]),
        ("kind of counts", [photo.counts for photo in photos]),
        ("camera's serial number", [photo.serial or serial for photo in photos]),
    ):
        usual, _ = Counter(values).most_common(1)[0]
        odd = next((p for p, v in zip(photos, values, strict=True) if v != usual), None)
        if odd is not None:
            raise InputError(
                f"{folder}: {odd.name} has another {what} than most; keep the pictures of one camera in one folder"
            )


def _in_order(
    photos: list[PhotoMetadata], utc_offset_h: float, table: Path | None
) -> tuple[list[PhotoMetadata], _Times]:
    """Return the photographs in order of capture time, and these times.

    The times are those of a table next to them, else EXIF's, else those in the names. Times cut to the second are
    spread within it. Raises InputError where a photograph has no time, or two have the same.
    """
    if table is not None and (by_table := _by_table(photos, table)) is not None:
        return by_table
    stamps, source = [photo.stamp_ns for photo in photos], "EXIF"
    if all(stamp is None for stamp in stamps):
        stamps, source = [stamp_from_name(photo.name) for photo in photos], "the names"
    known = [stamp - round(utc_offset_h * 3600e9) for stamp in stamps if stamp is not None]
    if len(known) < len(photos):
        without = photos[stamps.index(None)].name
        raise InputError(
            f"photograph {without}: no DateTimeOriginal in its EXIF and no UTC time in its name; "
            "give pictures as they were taken"
        )
    is_whole = all(stamp % 1_000_000_000 == 0 for stamp in known)
    is_whole |= source == "EXIF" and any(photo.stamp_is_whole_s for photo in photos)
    pairs = sorted(zip(known, photos, strict=True), key=lambda pair: (pair[0], pair[1].name))
    ordered, found = [photo for _, photo in pairs], [stamp for stamp, _ in pairs]
    if is_whole:
        return ordered, _Times(spread_within_seconds([t - t % 1_000_000_000 for t in found]), True, source)
    for (a, one), (b, other) in itertools.pairwise(pairs):
        if a == b:
            raise InputError(f"photographs {one.name} and {other.name} have the same capture time; remove the copy")
    return ordered, _Times(found, False, source)


def _by_table(photos: list[PhotoMetadata], table: Path) -> tuple[list[PhotoMetadata], _Times] | None:
    """The photographs that a table has a time for, in order, as exact as they are written; None if it is of others."""
    stamps = read_stamps(table, "file")
    found = sorted((stamps[photo.name], photo.name, photo) for photo in photos if photo.name in stamps)
    if len(found) < MIN_PHOTOS:
        return None
    times = _Times([stamp for stamp, _, _ in found], False, str(table), is_of_flight=True)
    return [photo for _, _, photo in found], times


def _focal(photos: list[PhotoMetadata]) -> Focal | None:
    """Return the focal length that all photographs state; None where none states one.

    Raises InputError where only some state it, or where they differ by more than 1 %.
    """
    known = [photo.focal for photo in photos if photo.focal is not None]
    if not known:
        return None
    if len(known) < len(photos):
        raise InputError(
            f"photograph {next(p.name for p in photos if p.focal is None)}: no focal length in EXIF (FocalLength with "
            "FocalPlaneXResolution, or FocalLengthIn35mmFilm), unlike the others; keep one camera's together"
        )
    if max(f.fx_px for f in known) > 1.01 * min(f.fx_px for f in known):
        raise InputError("the photographs' focal lengths differ by more than 1 %: it was zoomed; a flight has one")
    return known[0]


def _by_log(log: TelemetryLog, times: _Times) -> tuple[dict[str, dict[str, str]], list[Row]]:
    """The configuration with a log of the flight, and what it assumes."""
    sections, mount = mount_by_log(log)
    sections["camera"] = {}
    if times.is_whole:
        sections["camera"] = {"latency_s": "-0.5", "sigma_jitter_s": f"{WHOLE_SECOND_S}"}
    return sections, [mount]


def _by_photos(photos: list[PhotoMetadata], times: _Times) -> tuple[dict[str, dict[str, str]], list[Row]]:
    """The configuration where the pictures alone state where they were, and what it assumes."""
    gap_s = gap_to_join_s(times.stamps_ns)
    mount, solve, gps = {"pitch_deg": "-90.0"}, {}, {}
    if all(photo.gimbal_deg is not None for photo in photos):
        mount |= {"gimbal": '"always"', "sigma_deg": f"{SIGMA_GIMBAL_DEG}"}
        how = f"the gimbal's angles as the pictures state, +-{SIGMA_GIMBAL_DEG:g} deg"
    elif all(photo.body_deg is not None for photo in photos):
        mount["sigma_deg"] = f"{SIGMA_MOUNT_DEG}"
        how = f"fixed, straight down, top towards the nose, +-{SIGMA_MOUNT_DEG:g} deg"
    else:
        mount["sigma_deg"] = f"{SIGMA_MOUNT_DEG}"
        solve = {"attitude": '"none"', "level_ground": "true"}
        how = "no angles in the pictures: looking straight down, over ground level on average"
    gps = {"max_gap_s": f"{max(gap_s, 1.5)}", "latency_s": "0.0", "sigma_latency_s": f"{SIGMA_TAG_S}"}
    horizontal = [photo.sigma_horizontal_m for photo in photos if photo.sigma_horizontal_m is not None]
    if len(horizontal) == len(photos):
        gps["sigma_correlated_horizontal_m"] = f"{max(horizontal):.3f}"
    sections = {
        "mount": mount, "camera": {"sigma_latency_s": f"{WITHIN_S}"}, "solve": solve, "gps": gps,
        "telemetry": {"max_attitude_gap_s": f"{gap_s}"},
    }  # fmt: skip
    return sections, [("mount", how), ("positions", _positions_text(photos))]


def _turn_m(photos: list[PhotoMetadata]) -> float:
    """Return by how much two steps in a row may differ where the aircraft turned back: that is no jump yet."""
    longest_m = float(np.linalg.norm(np.diff(east_north_m(photos), axis=0), axis=1).max())
    return min(max(TURNED_BACK * longest_m, 10.0), 1000.0)


def _positions_text(photos: list[PhotoMetadata]) -> str:
    height_sigma_m = max(math.hypot(height_amsl(p, None)[1] or 0.0, datum_sigma_m(p, None) or 0.0) for p in photos)
    stated = [photo.sigma_horizontal_m for photo in photos if photo.sigma_horizontal_m is not None]
    accuracy = f"+-{max(stated):.2g} m as they state" if stated else "+-1.5 m assumed"
    what = "from the ellipsoid (set gps.undulation_m)" if photos[0].height_is_ellipsoidal else "above sea level"
    what += " by barometer" if photos[0].height_is_barometric else ""
    what = "of an unnamed origin" if photos[0].height_origin_is_unnamed else what
    return f"each picture's own, {accuracy}; heights {what}, +-{height_sigma_m:.3g} m"


def _times_text(times: _Times) -> str:
    apart_s = sorted((b - a) / 1e9 for a, b in itertools.pairwise(times.stamps_ns))
    cut = "cut to the second, evenly spread within it" if times.is_whole else "with fractions of a second"
    return f"of {times.source}, {cut}; {apart_s[len(apart_s) // 2]:.1f} s apart"


def _telemetry_table(photos: list[PhotoMetadata], times: _Times) -> str:
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow([*POSITION_FIELDS, *ANGLE_FIELDS, *OTHER_FIELDS])
    for photo, stamp_ns in zip(photos, times.stamps_ns, strict=True):
        height_m, sigma_m = height_amsl(photo, None)
        velocity = (None, None) if times.is_whole or photo.velocity_ne_m_s is None else photo.velocity_ne_m_s
        cells: list[object] = [f"{stamp_ns / 1e9:.6f}", f"{photo.lat_deg:.9f}", f"{photo.lon_deg:.9f}"]
        cells += [f"{height_m:.3f}", photo.above_home_m]
        cells += [*(photo.body_deg or (None,) * 3), *(photo.gimbal_deg or (None,) * 3), *velocity]
        table.writerow([*cells, photo.sigma_horizontal_m, sigma_m, datum_sigma_m(photo, None)])
    return text.getvalue()


def _place(photo: Path, target: Path, copy: bool) -> None:
    try:
        if copy:
            shutil.copyfile(photo, target)
        else:
            target.symlink_to(photo.resolve())
    except OSError as error:
        raise InputError(f"{target}: {error.strerror}; where links cannot be made, give --copy") from error
