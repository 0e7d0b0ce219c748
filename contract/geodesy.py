"""WGS84 geodetic <-> ECEF <-> local east-north-up. Arrays of many; angles in degrees, lengths in metres.

Sources: NIMA TR8350.2 (WGS84 constants); Bowring 1985 for the inverse, iterated twice, which is exact to well under a
micrometre below 100 km.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Angle = TypeVar("Angle", float, NDArray[np.float64])

WGS84_A_M = 6378137.0
EARTH_RADIUS_M = 6.371e6  # mean
WGS84_F = 1.0 / 298.257223563
_B_M = WGS84_A_M * (1.0 - WGS84_F)
_E2 = WGS84_F * (2.0 - WGS84_F)
_EP2 = _E2 / (1.0 - _E2)


def geodetic_to_ecef(lat_deg: ArrayLike, lon_deg: ArrayLike, height_m: ArrayLike) -> Array:
    """Ellipsoidal coordinates -> ECEF metres, shape (..., 3). Heights are above the ellipsoid."""
    lat, lon = np.radians(np.asarray(lat_deg, float)), np.radians(np.asarray(lon_deg, float))
    height = np.asarray(height_m, float)
    sin_lat, cos_lat = np.sin(lat), np.cos(lat)
    normal_m = WGS84_A_M / np.sqrt(1.0 - _E2 * sin_lat**2)
    return np.stack(
        [
            (normal_m + height) * cos_lat * np.cos(lon),
            (normal_m + height) * cos_lat * np.sin(lon),
            (normal_m * (1.0 - _E2) + height) * sin_lat,
        ],
        axis=-1,
    )


def ecef_to_geodetic(xyz_ecef_m: ArrayLike) -> Array:
    """ECEF metres (..., 3) -> latitude deg, longitude deg, ellipsoidal height m, shape (..., 3)."""
    xyz = np.asarray(xyz_ecef_m, float)
    if xyz.ndim == 1:
        return np.array(_geodetic_of_one(*xyz.tolist()))
    x, y, z = np.moveaxis(xyz, -1, 0)
    p = np.hypot(x, y)
    beta = np.arctan2(z * WGS84_A_M, p * _B_M)
    lat = beta
    for _ in range(2):
        lat = np.arctan2(z + _EP2 * _B_M * np.sin(beta) ** 3, p - _E2 * WGS84_A_M * np.cos(beta) ** 3)
        beta = np.arctan2((1.0 - WGS84_F) * np.sin(lat), np.cos(lat))
    sin_lat, cos_lat = np.sin(lat), np.cos(lat)
    height = p * cos_lat + z * sin_lat - WGS84_A_M * np.sqrt(1.0 - _E2 * sin_lat**2)
    return np.stack([np.degrees(lat), np.degrees(np.arctan2(y, x)), height], axis=-1)


def _geodetic_of_one(x: float, y: float, z: float) -> tuple[float, float, float]:
    """`ecef_to_geodetic` of one place in plain numbers, in a twentieth of the time."""
    p = math.hypot(x, y)
    beta = lat = math.atan2(z * WGS84_A_M, p * _B_M)
    for _ in range(2):
        lat = math.atan2(z + _EP2 * _B_M * math.sin(beta) ** 3, p - _E2 * WGS84_A_M * math.cos(beta) ** 3)
        beta = math.atan2((1.0 - WGS84_F) * math.sin(lat), math.cos(lat))
    sin_lat = math.sin(lat)
    height_m = p * math.cos(lat) + z * sin_lat - WGS84_A_M * math.sqrt(1.0 - _E2 * sin_lat**2)
    return math.degrees(lat), math.degrees(math.atan2(y, x)), height_m


def metres_per_degree(lat_deg: ArrayLike) -> tuple[Array, Array]:
    """Lengths on the ellipsoid of a degree northwards and a degree eastwards, m, of latitudes (...)."""
    lat = np.radians(np.asarray(lat_deg, float))
    w2 = 1.0 - _E2 * np.sin(lat) ** 2
    degree = np.pi / 180.0 * WGS84_A_M / np.sqrt(w2)
    return degree * (1.0 - _E2) / w2, degree * np.cos(lat)


def within_180(degrees: Angle) -> Angle:
    """Return the same angle in [-180, 180) degrees."""
    return (degrees + 180.0) % 360.0 - 180.0


def distance_m(one: tuple[float, float], other: tuple[float, float]) -> float:
    """The horizontal distance of two places (latitude, longitude, degrees), m, within some kilometres."""
    north_m, east_m = (float(scale) for scale in metres_per_degree(one[0]))
    return math.hypot((other[0] - one[0]) * north_m, within_180(other[1] - one[1]) * east_m)


def level_ground_m(east_m: ArrayLike, north_m: ArrayLike) -> Array:
    """Height of level ground above the plane that touches it at the origin, of places (...) within some kilometres."""
    return -(np.square(east_m) + np.square(north_m)) / (2.0 * EARTH_RADIUS_M)


def rotation_enu_ecef(lat_deg: float, lon_deg: float) -> Array:
    """R_enu_ecef (3, 3) at a point of the ellipsoid."""
    lat, lon = np.radians(lat_deg), np.radians(lon_deg)
    sl, cl, so, co = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    return np.array([[-so, co, 0.0], [-sl * co, -sl * so, cl], [cl * co, cl * so, sl]])


@dataclass(frozen=True)
class LocalFrame:
    """East-north-up axes at a latitude and longitude (deg) and a height (m, in the datum its user keeps to)."""

    lat_deg: float
    lon_deg: float
    height_m: float
    R_enu_ecef: Array = field(init=False, repr=False, compare=False)
    origin_ecef_m: Array = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "R_enu_ecef", rotation_enu_ecef(self.lat_deg, self.lon_deg))
        object.__setattr__(self, "origin_ecef_m", geodetic_to_ecef(self.lat_deg, self.lon_deg, self.height_m))

    def to_enu(self, lat_deg: ArrayLike, lon_deg: ArrayLike, height_m: ArrayLike) -> Array:
        """Geodetic -> ENU metres, shape (..., 3)."""
        return (geodetic_to_ecef(lat_deg, lon_deg, height_m) - self.origin_ecef_m) @ self.R_enu_ecef.T

    def to_geodetic(self, enu_m: ArrayLike) -> Array:
        """ENU metres (..., 3) -> latitude deg, longitude deg, height m, shape (..., 3)."""
        return ecef_to_geodetic(np.asarray(enu_m, float) @ self.R_enu_ecef + self.origin_ecef_m)
