"""Reports of spots with truth: places with errors that a session, a picture's neighbours and no one else share."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from contract.answer import Ellipse, Place
from contract.feature_set import Status
from contract.geodesy import LocalFrame
from contract.spot import Spot, SpotReport
from ground.spots.motion import PICTURE_TIME_S

Array = NDArray[np.float64]
HOME = LocalFrame(-43.5, 172.5, 0.0)
START_NS = 1_700_000_000_000_000_000
ROOT_CHI2 = math.sqrt(-2.0 * math.log(0.1))


def covariance(major_m: float, minor_m: float, azimuth_deg: float) -> Array:
    a = math.radians(azimuth_deg)
    along, across = np.array([math.sin(a), math.cos(a)]), np.array([math.cos(a), -math.sin(a)])
    return major_m**2 * np.outer(along, along) + minor_m**2 * np.outer(across, across)


def place_at(east_m: float, north_m: float, cov: Array, height_m: float = 20.0) -> Place:
    lat, lon, _ = (float(c) for c in HOME.to_geodetic((east_m, north_m, 0.0)))
    return Place(lat, lon, height_m, height_m + 10.0, Ellipse.from_covariance(cov), 2.0)


def spot_at(east_m: float, north_m: float, cov: Array, **more: object) -> Spot:
    words = {"contrast": 12.0, "temperature_c": 31.0, "above_ground_k": 8.0, "area_m2": 0.4, "sigma_area_m2": 0.1}
    return Spot(320.0, 240.0, status=Status.OK, place=place_at(east_m, north_m, cov), **{**words, **more})


@dataclass(eq=False)
class Flight:
    """Pictures of one session. `things(t)`: true places (N, 2) at a time."""

    rng: np.random.Generator
    cov: Array = field(default_factory=lambda: covariance(1.6, 1.2, 30.0))
    picture_share: float = 0.8
    session_share: float = 0.6
    interval_s: float = 0.5
    vehicle: str = "uav-1"
    session: int = 1
    begin_s: float = 0.0

    def reports(self, things: Callable[[float], Sequence[Sequence[float]]], pictures: int) -> Iterator[SpotReport]:
        values, vectors = np.linalg.eigh(self.cov)
        root = vectors * np.sqrt(values) @ vectors.T
        common, slow = self.rng.normal(size=2), self.rng.normal(size=2)
        decay = math.exp(-self.interval_s / PICTURE_TIME_S)
        shares = (self.session_share, self.picture_share - self.session_share, 1.0 - self.picture_share)
        s, p, o = (math.sqrt(share) for share in shares)
        for k in range(pictures):
            at_s = self.begin_s + k * self.interval_s
            spots = []
            for number, true in enumerate(things(at_s)):
                east, north = np.asarray(true) + root @ (s * common + p * slow + o * self.rng.normal(size=2))
                spots.append(replace(spot_at(float(east), float(north), self.cov), u_px=100.0 + 50.0 * number))
            yield SpotReport(
                self.session, k, START_NS + round(at_s * 1e9), True, tuple(spots), 0, self.picture_share,
                self.session_share, self.vehicle,
            )  # fmt: skip
            slow = decay * slow + math.sqrt(1.0 - decay**2) * self.rng.normal(size=2)


def offset_m(place: Place, true: Sequence[float]) -> Array:
    east, north, _ = HOME.to_enu(place.lat_deg, place.lon_deg, 0.0)
    return np.array([float(east), float(north)]) - np.asarray(true, float)


def is_inside(place: Place, true: Sequence[float]) -> bool:
    e = place.ellipse
    inverse = np.linalg.inv(covariance(e.semi_major_m / ROOT_CHI2, e.semi_minor_m / ROOT_CHI2, e.azimuth_deg))
    away = offset_m(place, true)
    return float(away @ inverse @ away) <= ROOT_CHI2**2
