"""Coordinates for people: to as many digits as their accuracy gives meaning to, and as they are read over the radio."""

from __future__ import annotations

import math

from contract.answer import DEGREES, ROUNDED_SHARE
from contract.answer import decimals as as_few_as_mean_something
from contract.errors import InputError
from ground.formats.coordinates import latlon_text, mgrs_text, utm_text

UNKNOWN_M = 5.0  # radius that is taken where none is known: digits of a metre or so
# Metres that one of each form's last whole unit is at most, and the most decimals that are written.
_UNITS = {"degrees": DEGREES, "minutes": (1_862.0, 5), "seconds": (31.1, 3), "utm": (1.0, 1)}
_LETTERS = (
    "Alfa Bravo Charlie Delta Echo Foxtrot Golf Hotel India Juliett Kilo Lima Mike November Oscar Papa Quebec Romeo "
    "Sierra Tango Uniform Victor Whiskey X-ray Yankee Zulu"
)
_SPELT = {word[0]: word for word in _LETTERS.split()}


def decimals(form: str, ce90_m: float | None) -> int:
    """The decimals of degrees, minutes, seconds or UTM: moved by at most ROUNDED_SHARE of the 90 % radius."""
    return as_few_as_mean_something(*_UNITS[form], UNKNOWN_M if ce90_m is None else ce90_m)


def rounded_text(form: str, lat_deg: float, lon_deg: float, ce90_m: float | None) -> str:
    """A place in one of the forms degrees, minutes, seconds, utm or mgrs. Raises InputError where there is none."""
    if form == "mgrs":
        return spaced_mgrs(lat_deg, lon_deg, ce90_m)
    if form == "utm":
        return utm_text(lat_deg, lon_deg, decimals("utm", ce90_m))
    return latlon_text(lat_deg, lon_deg, form, decimals(form, ce90_m))


def spaced_mgrs(lat_deg: float, lon_deg: float, ce90_m: float | None) -> str:
    """Zone, square, easting, northing: 59G MM 01234 56789. A square is named by its corner, so digits are cut, not
    rounded: as many are left out as move a place by at most ROUNDED_SHARE of its radius, but two.
    """
    whole = mgrs_text(lat_deg, lon_deg)
    zone, square, digits = whole[:-12], whole[-12:-10], whole[-10:]
    allowed_m = ROUNDED_SHARE * (UNKNOWN_M if ce90_m is None else ce90_m)
    count = next((n for n in (2, 3, 4) if math.sqrt(2.0) * 10.0 ** (5 - n) <= allowed_m), 5)
    return f"{zone} {square} {digits[:count]} {digits[5 : 5 + count]}".strip()


def spoken_mgrs(lat_deg: float, lon_deg: float, ce90_m: float | None) -> str:
    """The same for the radio: 5 9 Golf, Mike Mike, 0 1 2 3 4, 5 6 7 8 9. Empty where there is none."""
    try:
        groups = spaced_mgrs(lat_deg, lon_deg, ce90_m).split()
    except InputError:
        return ""
    return ", ".join(" ".join(_SPELT.get(letter, letter) for letter in group) for group in groups)
