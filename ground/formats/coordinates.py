"""Coordinates in other forms: degrees and minutes, MGRS, UTM, any EPSG system, metres from an origin.

MGRS, UTM and EPSG are the libraries' (extra `geo`: mgrs and pyproj); the rest needs NumPy alone.
"""

from __future__ import annotations

import math
import warnings
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

from contract.errors import InputError
from contract.geodesy import LocalFrame
from ground.formats.mark import Mark

USUAL_M = 1.0  # the accuracy that EPSG states for systems that differ from WGS84 by the drift of continents alone
_DECIMALS = {"degrees": 7, "minutes": 5, "seconds": 3}


def latlon_text(lat_deg: float, lon_deg: float, form: str = "degrees", decimals: int | None = None) -> str:
    """Both for people: `degrees` (-43.3801234 172.4012345), `minutes` (43 22.80740 S ...) or `seconds`.

    `decimals` of the last unit; default: those that 0.1 m takes, or less.
    """
    places = _DECIMALS[form] if decimals is None else decimals
    if form == "degrees":
        return f"{lat_deg:.{places}f} {lon_deg:.{places}f}"
    text = {"minutes": _minutes, "seconds": _seconds}[form]
    return f"{text(lat_deg, 2, 'NS', places)} {text(lon_deg, 3, 'EW', places)}"


def _minutes(value_deg: float, digits: int, letters: str, decimals: int) -> str:
    # Rounded first, so that no minute is ever 60.
    unit = 10**decimals
    degrees, rest = divmod(round(abs(value_deg) * 60.0 * unit), 60 * unit)
    return f"{degrees:0{digits}d}°{_padded(rest / unit, decimals)}'{letters[int(value_deg < 0.0)]}"


def _seconds(value_deg: float, digits: int, letters: str, decimals: int) -> str:
    unit = 10**decimals
    degrees, rest = divmod(round(abs(value_deg) * 3600.0 * unit), 3600 * unit)
    minutes, seconds = divmod(rest, 60 * unit)
    return f"{degrees:0{digits}d}°{minutes:02d}'{_padded(seconds / unit, decimals)}\"{letters[int(value_deg < 0.0)]}"


def _padded(value: float, decimals: int) -> str:
    return f"{value:0{3 + decimals if decimals else 2}.{decimals}f}"


def mgrs_text(lat_deg: float, lon_deg: float) -> str:
    """The MGRS square metre that the point is in, as USNG writes it too (WGS84): 59GMM0123456789; polar squares too."""
    mgrs = library("mgrs")
    try:
        # Its own rounding takes 60 minutes for what it is given as degrees; a longitude of 180 is one of -180.
        found = mgrs.MGRS().toMGRS(lat_deg, lon_deg if lon_deg < 180.0 else -180.0, MGRSPrecision=5)
    except mgrs.core.MGRSError as error:
        raise InputError(f"no MGRS square at {lat_deg:.6f} {lon_deg:.6f}: {error}") from error
    return str(found)


def has_utm(lat_deg: float) -> bool:
    """Return whether a latitude is not so near a pole that UTM has ended."""
    return -80.0 <= lat_deg < 84.0


def utm_text(lat_deg: float, lon_deg: float, decimals: int = 1) -> str:
    """Zone with its band, easting and northing in metres: 59G 412345.7 5197654.3. Raises InputError at the poles."""
    if not has_utm(lat_deg):
        raise InputError(f"UTM ends at 80 S and 84 N, this is at {lat_deg:.4f}: use mgrs, or --crs EPSG:32661 or 32761")
    square = mgrs_text(lat_deg, lon_deg)
    zone = square[:-12]  # 1 or 2 digits and the band, before two letters and ten digits
    number, band = int(zone[:-1]), zone[-1]
    found = Projection(f"EPSG:{(32600 if band >= 'N' else 32700) + number}").project(lat_deg, lon_deg)
    return f"{number}{band} {found.x:.{decimals}f} {found.y:.{decimals}f}"


def utm_to_latlon(zone: int, is_north: bool, easting_m: float, northing_m: float) -> tuple[float, float]:
    """WGS84 degrees of a place in a UTM zone. Raises InputError for one that the projection does not hold."""
    pyproj = library("pyproj")
    code = f"EPSG:{(32600 if is_north else 32700) + zone}"
    lon, lat = pyproj.Transformer.from_crs(code, "EPSG:4326", always_xy=True).transform(easting_m, northing_m)
    if not (math.isfinite(lat) and math.isfinite(lon)):
        raise InputError(f"UTM zone {zone} does not reach {easting_m:.0f} {northing_m:.0f}")
    return float(lat), float(lon)


@dataclass(frozen=True)
class Projected:
    """A position in another system, east before north, each with the name that its axis has there."""

    crs: str
    x: float
    y: float
    x_name: str
    y_name: str
    is_degrees: bool
    accuracy_m: float | None  # of the change of datum; None: not known
    is_best: bool = True  # no better change of datum is known there, whose grid file is not here

    @property
    def text(self) -> str:
        """Both with their names, to the millimetre, and what the change of datum may add to their error."""
        digits = 9 if self.is_degrees else 3
        doubt = f" ({self.doubt})" if self.doubt else ""
        return f"{self.x_name} {self.x:.{digits}f} {self.y_name} {self.y:.{digits}f}{doubt}"

    @property
    def doubt(self) -> str:
        """The error of the change of datum, in words; empty where it is no more than that of any."""
        if self.accuracy_m is None:
            words = "no change of datum is known: may be hundreds of metres off"
        elif self.accuracy_m > USUAL_M:
            words = f"+-{self.accuracy_m:g} m by the change of datum"
        else:
            return ""
        return words if self.is_best else f"{words}; a better one needs a grid file that is not here"


class Grid(ABC):
    """A coordinate system into which marks are converted."""

    name: str

    @abstractmethod
    def of(self, mark: Mark) -> Projected:
        """Convert a mark that has a position. Raises InputError for one that the system does not reach."""

    def found(self, mark: Mark) -> Projected | None:
        """The same for one of several marks; None for one that must not cost the others theirs."""
        return self.of(mark)


class LocalGrid(Grid):
    """Metres east and north of an origin."""

    def __init__(self, lat_deg: float, lon_deg: float) -> None:
        if not (-90.0 <= lat_deg <= 90.0 and -180.0 <= lon_deg <= 180.0):
            raise InputError(f"--local {lat_deg:g},{lon_deg:g}: latitude is -90 to 90, longitude -180 to 180")
        self.name = f"local {lat_deg:.9f},{lon_deg:.9f}"
        self._at = lat_deg, lon_deg

    def of(self, mark: Mark) -> Projected:
        """Convert at the height of the mark, so that a metre is a metre there."""
        lat, lon = mark.position
        height = mark.height_ellipsoid_m if mark.height_ellipsoid_m is not None else mark.height_amsl_m or 0.0
        east, north, _ = (float(c) for c in LocalFrame(*self._at, height).to_enu(lat, lon, height))
        return Projected(self.name, east, north, "east", "north", False, 0.0)


class Projection(Grid):
    """A coordinate reference system by its code (`EPSG:2193`). Raises InputError for one that is not in pyproj."""

    def __init__(self, code: str) -> None:
        pyproj = library("pyproj")
        try:
            crs = pyproj.CRS.from_user_input(code)
        except pyproj.exceptions.CRSError as error:
            raise InputError(f"--crs {code}: no system that pyproj knows; give a code like EPSG:2193") from error
        if crs.is_geocentric or len(crs.axis_info) not in (2, 3) or crs.is_vertical:
            raise InputError(f"--crs {code}: {crs.name} is no system of two horizontal coordinates")
        self.name = ":".join(crs.to_authority() or ()) or code
        self.title = crs.name
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that a better way needs a grid: `Projected.is_best`
            group = pyproj.transformer.TransformerGroup("EPSG:4326", crs, always_xy=True)
        if not group.transformers:
            raise InputError(f"--crs {code}: no way from WGS84 to {crs.name}")
        # The ways that are here, and those whose grid files are not: each with its accuracy and where it is good.
        self._ways = [(way, _accuracy_m(way), way.area_of_use) for way in group.transformers]
        self._missing = [(_accuracy_m(way), way.area_of_use) for way in group.unavailable_operations]
        # As the system lists its axes, which may be north first; a name without a direction is known by its position.
        first, second = ((axis.abbrev or axis.name, axis.direction) for axis in crs.axis_info[:2])
        is_north_first = first[1] in ("north", "south") and second[1] not in ("north", "south")
        self._x_name, self._y_name = (second[0], first[0]) if is_north_first else (first[0], second[0])
        self._is_degrees = bool(crs.is_geographic)
        self._area = crs.area_of_use

    def of(self, mark: Mark) -> Projected:
        return self.project(*mark.position)

    def project(self, lat_deg: float, lon_deg: float) -> Projected:
        """Raises InputError for a place where the system does not hold."""
        if not self._reaches(lat_deg, lon_deg):
            raise InputError(f"{self.name} ({self.title}) does not reach {lat_deg:.6f} {lon_deg:.6f}")
        way, accuracy_m = self._way(lat_deg, lon_deg)
        x, y = (float(c) for c in way.transform(lon_deg, lat_deg)[:2])
        if not (math.isfinite(x) and math.isfinite(y)):
            raise InputError(f"{self.name} ({self.title}) does not reach {lat_deg:.6f} {lon_deg:.6f}")
        missing = (better_m for better_m, area in self._missing if _holds(area, lat_deg, lon_deg))
        is_best = min(missing, default=math.inf) >= accuracy_m
        accuracy = accuracy_m if math.isfinite(accuracy_m) else None
        return Projected(self.name, x, y, self._x_name, self._y_name, self._is_degrees, accuracy, is_best)

    def _way(self, lat_deg: float, lon_deg: float) -> tuple[Any, float]:
        """The change of datum that is most accurate at a place, and its accuracy, m. They differ by country."""
        there = [way for way in self._ways if _holds(way[2], lat_deg, lon_deg)] or self._ways
        # Of two that are as good the one for the smaller area: the box about Italy's mainland holds Sardinia too.
        way, accuracy_m, _ = min(there, key=lambda way: (way[1], _size_deg2(way[2])))
        return way, accuracy_m

    def _reaches(self, lat_deg: float, lon_deg: float) -> bool:
        """Return whether the system was made for this place, or for one within 3 degrees of it."""
        return _holds(self._area, lat_deg, lon_deg, margin_deg=3.0)


def _accuracy_m(way: Any) -> float:
    """The stated accuracy of a change of datum; infinite where none is, as of one that leaves the datum as it is."""
    return math.inf if way.accuracy is None or way.accuracy < 0.0 else float(way.accuracy)


def _size_deg2(area: Any) -> float:
    if area is None:
        return math.inf
    _, south, _, north = area.bounds
    return _width_deg(area) * float(north - south)


def _width_deg(area: Any) -> float:
    """The width of an area of use, which may reach over the date line."""
    west, _, east, _ = area.bounds
    return float((east - west) % 360.0 or 360.0)


def _holds(area: Any, lat_deg: float, lon_deg: float, margin_deg: float = 0.0) -> bool:
    """Return whether an area of use holds a place, or is within a margin of it; None is everywhere."""
    if area is None:
        return True
    west, south, _, north = area.bounds
    is_between = (lon_deg - west + margin_deg) % 360.0 <= min(_width_deg(area) + 2.0 * margin_deg, 360.0)
    return bool(is_between and south - margin_deg <= lat_deg <= north + margin_deg)


def library(name: str) -> Any:
    """A package of the extra `geo`."""
    try:
        if name == "mgrs":
            import mgrs  # noqa: PLC0415

            return mgrs
        import pyproj  # noqa: PLC0415
        import pyproj.transformer  # noqa: PLC0415

        return pyproj
    except ImportError as error:
        raise InputError(f"this needs the package {name}: install pointclick with its extra [geo] (README)") from error


def projected(mark: Mark, grid: Grid | None) -> Projected | None:
    """A mark's place in another system; None without one, without a position, and where the system does not reach."""
    return grid.found(mark) if grid is not None and mark.is_placed else None


def shape_values(mark: Mark, grid: Grid | None) -> dict[str, object]:
    """A mark's ellipse and its place in another system, by name; empty if it has none."""
    values: dict[str, object] = {}
    if mark.ellipse is not None:
        e = mark.ellipse
        values |= {"semi_major_m": figure(e.semi_major_m), "semi_minor_m": figure(e.semi_minor_m)}
        values["azimuth_deg"] = f"{e.azimuth_deg:.2f}"
    if (p := projected(mark, grid)) is not None:
        values |= {"crs": p.crs, "x": coordinate(p, p.x), "y": coordinate(p, p.y)}
    return values


def coordinate(place: Projected, value: float) -> str:
    """One of a place's two, to the millimetre as `Projected.text`."""
    return f"{value:.{9 if place.is_degrees else 3}f}"


def figure(metres: float | None) -> str | None:
    """The length to the millimetre; None stays."""
    return None if metres is None else f"{metres:.3f}"
