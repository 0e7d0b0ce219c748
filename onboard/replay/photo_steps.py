"""Photographs whose own positions step in flight, joined as far as the pictures show it. (28.14) to (28.21)"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from contract.answer import CHI2_2
from contract.camera import Camera
from contract.geodesy import LocalFrame
from contract.rotations import R_ENU_NED, matrix_from_euler, mount_rotation
from onboard.camera.photo_metadata import PhotoMetadata
from onboard.camera.pixel_formats import UNDECODABLE
from onboard.config.schema import Gps
from onboard.foreign_clock.picture_pairs import measure
from onboard.foreign_clock.position_steps import Step, bridging, intervals, joined, steps

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

SMALL_PX = 640
ONE_SIDED = 1.2816  # sigmas, which nine in ten errors along one direction stay below
LONGEST_S = 1e5  # that positions may share an error, by the configuration


@dataclass(frozen=True)
class Mended:
    """Photographs without their steps; words for each step; how far all may be off together (m), and for how long their
    positions share that error (s): as the configuration has it where none steps.
    """

    photos: list[PhotoMetadata]
    steps: tuple[str, ...]
    doubt_m: float
    correlation_time_s: float


def without_steps(photos: list[PhotoMetadata], folder: Path, camera: Camera, gps: Gps) -> Mended:
    """Return photographs in order of capture, with the steps of their own positions that their motion contradicts taken
    out, and the positions doubted by as much.
    """
    claims_m = [photo.sigma_horizontal_m or gps.sigma_correlated_horizontal_m for photo in photos]
    found = _steps(photos, folder, camera, claims_m)
    if not found:
        return Mended(photos, (), 0.0, gps.correlation_time_s)
    whole = joined(len(photos), found, max(claims_m))
    sigmas_m = [_doubted_m(math.hypot(*both), whole.doubt_m) for both in zip(claims_m, whole.sigma_m, strict=True)]
    moved = [_moved(*each) for each in zip(photos, whole.add_m.tolist(), sigmas_m, strict=True)]
    words = tuple(
        f"of {abs(step.moved_m):.0f} m in the positions from {photos[at].name} to {photos[at + 1].name}, which the "
        "pictures do not show: taken out"
        for at, step in found.items()
    )
    slower = max(max(sigmas_m) / gps.sigma_correlated_horizontal_m, 1.0) ** 2 if whole.doubt_m else 1.0  # (28.21)
    return Mended(moved, words, whole.doubt_m, min(gps.correlation_time_s * slower, LONGEST_S))


def doubt_text(doubt_m: float) -> str:
    """Words for how far all positions may be off."""
    return f"all may be off by {doubt_m:.0f} m: which side of a step is right, nothing shows"


def _steps(photos: list[PhotoMetadata], folder: Path, camera: Camera, claims_m: list[float]) -> dict[int, Step]:
    """The steps by the picture before."""
    numbers = range(len(photos))
    pictures = small_pictures([folder / photo.name for photo in photos])
    R_enu_cam = [_attitude(photo) for photo in photos]
    pairs = measure(camera, numbers, list(itertools.pairwise(numbers)), pictures)
    if all(R is not None for R in R_enu_cam):  # two pictures with little in common show their own tilt badly
        farther = bridging(intervals(pairs, R_enu_cam))
        pairs = pairs.with_others(measure(camera, numbers, farther, pictures))
    return steps(east_north_m(photos), intervals(pairs, R_enu_cam), np.array(claims_m))


def _attitude(photo: PhotoMetadata) -> Array | None:
    """R_enu_cam (3, 3) as a photograph states it; None where it states none."""
    if photo.gimbal_deg is None and photo.body_deg is None:
        return None
    R_cam = mount_rotation(0.0, 0.0 if photo.gimbal_deg is not None else -90.0, 0.0)
    roll, pitch, yaw = np.radians(photo.gimbal_deg or photo.body_deg or (0.0, 0.0, 0.0)).tolist()
    return np.asarray(R_ENU_NED @ matrix_from_euler(roll, pitch, yaw) @ R_cam, np.float64)


def _doubted_m(sigma_m: float, doubt_m: float) -> float:
    """One sigma of positions that all are off by a doubt to one side, whatever else is uncertain: nine tenths of the
    errors along that line stay below the radius of the 90 % circle. (28.20)
    """
    return math.hypot(sigma_m, doubt_m / math.sqrt(CHI2_2 - ONE_SIDED**2))


def _moved(photo: PhotoMetadata, east_north: complex, sigma_m: float) -> PhotoMetadata:
    place = LocalFrame(photo.lat_deg or 0.0, photo.lon_deg or 0.0, 0.0)
    lat_deg, lon_deg, _ = place.to_geodetic(np.array([east_north.real, east_north.imag, 0.0]))
    return replace(photo, lat_deg=float(lat_deg), lon_deg=float(lon_deg), sigma_horizontal_m=sigma_m)


def east_north_m(photos: list[PhotoMetadata]) -> Array:
    """The photographs' positions (N, 2) from the first one."""
    first = LocalFrame(photos[0].lat_deg or 0.0, photos[0].lon_deg or 0.0, 0.0)
    return np.array([first.to_enu(photo.lat_deg or 0.0, photo.lon_deg or 0.0, 0.0)[:2] for photo in photos])


def small_pictures(paths: Sequence[Path]) -> Callable[[int], Picture | None]:
    """Small grey copies of photographs; a JPEG is decoded at a part of its size."""

    def small(index: int) -> Picture | None:
        try:
            with Image.open(paths[index]) as image:
                width, height = image.size
                image.draft("L", (SMALL_PX, max(SMALL_PX * height // width, 1)))
                return np.array(image.convert("L"), np.uint8)
        except UNDECODABLE:
            return None

    return small
