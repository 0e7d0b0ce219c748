"""Values of the command line, checked while they are parsed."""

from __future__ import annotations

import argparse
import math

from contract.errors import InputError
from contract.stated_values import number_or_nan
from ground.formats.coordinate_text import read_coordinate


def finite(text: str) -> float:
    """A number that is one."""
    value = number_or_nan(text)
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text.strip()!r} is not a finite number")
    return value


def positive(text: str) -> float:
    """A number above zero."""
    value = finite(text)
    if value <= 0.0:
        raise argparse.ArgumentTypeError(f"{text.strip()!r} is not above 0")
    return value


def share(text: str) -> float:
    """A number from 0 to 1."""
    value = finite(text)
    if not 0.0 <= value <= 1.0:
        raise argparse.ArgumentTypeError(f"{text.strip()!r} is not from 0 to 1")
    return value


def age(text: str) -> float:
    """Seconds, or inf."""
    value = math.inf if text.strip() == "inf" else finite(text)
    if value < 0.0:
        raise argparse.ArgumentTypeError(f"{text.strip()!r} is not an age in seconds")
    return value


def file_name(text: str) -> str:
    """A name, not empty."""
    if not text.strip():
        raise argparse.ArgumentTypeError("no file name")
    return text.strip()


def whole(text: str, what: str) -> int:
    """A whole number from 0 of at most ten digits."""
    stripped = text.strip()
    if not (stripped.isascii() and stripped.isdecimal() and len(stripped) <= 10):
        raise argparse.ArgumentTypeError(f"{stripped!r} is not a {what} number (0, 1, 2, ...)")
    return int(stripped)


def frame_number(text: str) -> int:
    return whole(text, "frame")


def pin_number(text: str) -> int:
    return whole(text, "pin")


def origin(text: str) -> tuple[float, float]:
    """A coordinate in any form that `read_coordinate` takes: latitude and longitude in degrees."""
    try:
        place = read_coordinate(text)
    except InputError as error:
        raise argparse.ArgumentTypeError(str(error)) from error
    return place.lat_deg, place.lon_deg
