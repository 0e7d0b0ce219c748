"""Telemetry out of the pictures themselves: each states where it was taken and, if a drone took it, where it looked.

A position here belongs to its picture whatever its clock, so even times cut to the second will do.
"""

from __future__ import annotations

import itertools
from dataclasses import replace

from contract.errors import InputError
from onboard.camera.photo_metadata import PhotoMetadata
from onboard.config.schema import Config
from onboard.events.types import Attitude, GimbalAttitude, GpsQuality, PositionFix
from onboard.telemetry.log_formats import SUFFIXES
from onboard.telemetry.row_events import SIGMA_GEOID_M, SIGMA_PRESSURE_HEIGHT_M
from onboard.telemetry.telemetry_log import MAX_GAP_S, TelemetryLog, quaternion, vouched

SIGMA_AMSL_M = 20.0  # a receiver's height counts from an unnamed geoid
MOST_APART_M = 10.0  # of two places that a photograph states: of one receiver, one of them corrected afterwards
STEP_S = 0.1  # in what is asked for, so that it reads well


def photo_telemetry(photos: list[PhotoMetadata], stamps_ns: list[int], undulation_m: float | None) -> TelemetryLog:
    """The telemetry of photographs in order of capture; `undulation_m` brings ellipsoidal heights to sea level.

    Raises InputError, one line, if a photograph has no position, or two.
    """
    without = [photo.name for photo in photos if photo.lat_deg is None or photo.height_amsl_m is None]
    if without:
        more = f" and {len(without) - 1} more" if len(without) > 1 else ""
        side = next(side_lacking(photo) for photo in photos if photo.name == without[0])
        raise InputError(
            f"telemetry exif: no GPS position with a height in {without[0]}{side}{more}; "
            f"give a log of the flight instead ({', '.join(SUFFIXES)})"
        )
    _check_places(photos)
    is_timed = not any(photo.stamp_is_whole_s for photo in photos)
    pairs = list(zip(photos, stamps_ns, strict=True))
    positions = [_position(photo, stamp_ns, is_timed, undulation_m) for photo, stamp_ns in pairs]
    events = vouched(positions, [_claim(photo, undulation_m) for photo in photos])
    for photo, stamp_ns in pairs:
        if photo.body_deg is not None:
            events.append(Attitude(stamp_ns, quaternion(photo.body_deg)))
        if photo.gimbal_deg is not None:
            events.append(GimbalAttitude(stamp_ns, quaternion(photo.gimbal_deg), "earth", is_of_camera=True))
    return replace(TelemetryLog.by_stamp(events), notes=_height_notes(photos, undulation_m))


def _check_places(photos: list[PhotoMetadata]) -> None:
    """Raise InputError where a photograph states two places: an editor has changed one, and nothing shows which."""
    odd = max(photos, key=lambda photo: photo.places_apart_m)
    if odd.places_apart_m > MOST_APART_M:
        raise InputError(
            f"photograph {odd.name} states two places {odd.places_apart_m:.0f} m apart, in its EXIF and in its XMP: "
            "one was changed afterwards; give pictures as they were taken, their places in a geo.txt, or a log of the "
            f"flight ({', '.join(SUFFIXES)})"
        )


def side_lacking(photo: PhotoMetadata) -> str:
    """Words for a position that cannot be used for want of its letters; empty where that is not why."""
    words = " (it lacks the letters N or S, E or W, without which it may be on any of four sides)"
    return words if photo.place_lacks_side else ""


def _height_notes(photos: list[PhotoMetadata], undulation_m: float | None) -> tuple[str, ...]:
    """Notes for the operator on heights whose origin is not known."""
    unsure_m = max((datum_sigma_m(photo, undulation_m) or 0.0 for photo in photos), default=0.0)
    if not unsure_m:
        return ()
    if any(photo.height_is_ellipsoidal for photo in photos):
        return (f"heights count from the ellipsoid, +-{unsure_m:.0f} m as a whole: set gps.undulation_m",)
    return (f"heights are a barometer's, +-{unsure_m:.0f} m as a whole: an elevation model (terrain.path) finds them",)


def check_gaps(config: Config, stamps_ns: list[int]) -> None:
    """Raise InputError if the configuration does not join positions as far apart as the pictures usually are."""
    apart_s = _usual_s(stamps_ns)
    if min(config.gps.max_gap_s, config.telemetry.max_attitude_gap_s) < min(apart_s, MAX_GAP_S):
        raise InputError(
            f"telemetry exif: the pictures alone state where they were, {apart_s:.1f} s apart: set gps.max_gap_s and "
            f"telemetry.max_attitude_gap_s to {gap_to_join_s(stamps_ns):.1f}, as `pc-onboard import-photos` does"
        )


def _usual_s(stamps_ns: list[int]) -> float:
    """The interval (s) between pictures that all but the longest tenth do not exceed."""
    apart_s = sorted((after - before) / 1e9 for before, after in itertools.pairwise(stamps_ns))
    return apart_s[(9 * (len(apart_s) - 1)) // 10] if apart_s else 0.0


def gap_to_join_s(stamps_ns: list[int]) -> float:
    """The value (s) of both gaps in the configuration that joins these pictures, at most the largest allowed."""
    apart_s = max(((after - before) / 1e9 for before, after in itertools.pairwise(stamps_ns)), default=0.0)
    return min(round(apart_s + STEP_S, 1), MAX_GAP_S)


def height_amsl(photo: PhotoMetadata, undulation_m: float | None) -> tuple[float, float | None]:
    """A photograph's height above sea level and its one sigma, m, without that of where it counts from."""
    assert photo.height_amsl_m is not None
    if photo.height_is_ellipsoidal:
        return photo.height_amsl_m - (undulation_m or 0.0), photo.sigma_vertical_m
    if photo.height_is_barometric:
        return photo.height_amsl_m, None
    return photo.height_amsl_m, photo.sigma_vertical_m or SIGMA_AMSL_M


def datum_sigma_m(photo: PhotoMetadata, undulation_m: float | None) -> float | None:
    """One sigma of where a photograph's height counts from, the same error in all of them; None if that is known."""
    if photo.height_is_ellipsoidal:
        return SIGMA_GEOID_M if undulation_m is None else None
    if photo.height_origin_is_unnamed:
        return SIGMA_GEOID_M
    return SIGMA_PRESSURE_HEIGHT_M if photo.height_is_barometric else None


def _position(photo: PhotoMetadata, stamp_ns: int, is_timed: bool, undulation_m: float | None) -> PositionFix:
    assert photo.lat_deg is not None and photo.lon_deg is not None
    velocity = None
    if is_timed and photo.velocity_ne_m_s is not None:
        velocity = (*photo.velocity_ne_m_s, float("nan"))
    height_m, _ = height_amsl(photo, undulation_m)
    return PositionFix(stamp_ns, photo.lat_deg, photo.lon_deg, height_m, velocity, photo.above_home_m)


def _claim(photo: PhotoMetadata, undulation_m: float | None) -> GpsQuality:
    return GpsQuality(
        *(0, 3, None, photo.sigma_horizontal_m, height_amsl(photo, undulation_m)[1]),
        undulation_m=undulation_m,
        sigma_datum_m=datum_sigma_m(photo, undulation_m),
    )
