"""The parser of `pc-onboard`: wrong usage in one line, values checked while they are parsed, lost output recognised."""

from __future__ import annotations

import argparse
import errno
import math
import os
import re
import select
import sys
from datetime import UTC, datetime
from typing import NoReturn

from contract.near_word import in_usage, options_of
from contract.stated_values import number_or_nan

ABOVE_0 = math.ulp(0.0)


class Parser(argparse.ArgumentParser):
    """Wrong usage is one line, as every other error."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog.split()[0]}: error: {in_usage(message, options_of(self))} (see {self.prog} --help)\n")


class Version(argparse.Action):
    """`--version`, looked up only when it is asked for."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        """Print it and exit."""
        from contract.version import version_line  # noqa: PLC0415

        print(version_line(parser.prog))
        parser.exit(0)


def is_output_lost(error: OSError) -> bool:
    """Return whether writing to a full or broken standard output raised it: errors of our files have names."""
    return error.filename is None and error.errno in (errno.ENOSPC, errno.EIO, errno.EDQUOT, errno.EFBIG)


def is_reader_gone() -> bool:
    """Return whether our output is no longer read; what it still holds is dropped then."""
    output = select.poll()
    output.register(sys.stdout.fileno(), 0)
    if not output.poll(0):
        return False
    drop_output()
    return True


def drop_output() -> None:
    """Drop what is still to be written."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, sys.stdout.fileno())
    os.close(nowhere)


def within(text: str, low: float, high: float, what: str) -> float:
    """A number from `low` to `high`; `what` ends the sentence that begins with the text and "is"."""
    number = number_or_nan(text)
    if not low <= number <= high:
        raise argparse.ArgumentTypeError(f"{text!r} is {what}")
    return number


def speed(text: str) -> float | None:
    """'max' -> None; a positive number, how many times the recorded speed."""
    if text == "max":
        return None
    return within(text, ABOVE_0, 1000.0, "neither 'max' nor a number above 0, at most 1000")


def finite(text: str) -> float:
    """A number that is one."""
    number = number_or_nan(text)
    if not math.isfinite(number):
        raise argparse.ArgumentTypeError(f"{text!r} is not a finite number")
    return number


def seconds(text: str) -> float:
    return within(text, 0.0, 86400.0, "no number of seconds from 0 to 86400")


def days(text: str) -> float:
    return within(text, ABOVE_0, 36500.0, "no number of days above 0, at most 36500")


def rate(text: str) -> float:
    return within(text, 0.1, 240.0, "no number of pictures a second from 0.1 to 240")


def pair(text: str) -> tuple[int, int]:
    """'640x480' -> (640, 480)."""
    found = re.fullmatch(r"([1-9]\d{0,5})[xX]([1-9]\d{0,5})", text)
    if found is None:
        raise argparse.ArgumentTypeError(f"{text!r} is not two whole numbers as in 640x480")
    return int(found[1]), int(found[2])


def clicked(text: str) -> tuple[int, float, float]:
    """'14,480,120.5' -> frame and pixel."""
    found = re.fullmatch(r"(\d{1,9}),(\d{1,4}(?:\.\d*)?),(\d{1,4}(?:\.\d*)?)", text)
    if found is None:
        raise argparse.ArgumentTypeError(f"{text!r} is not a picture's number and a pixel as in 14,480,120")
    return int(found[1]), float(found[2]), float(found[3])


def degrees_wide(text: str) -> float:
    return within(text, 5.0, 150.0, "no field of view from 5 to 150 degrees")


def angles(text: str) -> tuple[float, float, float]:
    """'0,-90,0' -> roll, pitch, yaw, degrees."""
    found = [number_or_nan(part) for part in text.split(",")]
    if len(found) != 3 or not all(map(math.isfinite, found)):
        raise argparse.ArgumentTypeError(f"{text!r} is not ROLL,PITCH,YAW in degrees, as 0,-90,0")
    return found[0], found[1], found[2]


def hours(text: str) -> float:
    return within(text, -15.0, 15.0, "no number of hours from -15 to 15")


def precise(text: str) -> tuple[float, float]:
    """A number and one sigma of it: as in 12.4+-0.5, else one unit of its last digit."""
    number, _, sigma = text.partition("+-")
    value, one = finite(number), _last_digit(number) if not sigma else finite(sigma)
    if one <= 0.0:
        raise argparse.ArgumentTypeError(f"{text!r}: what follows +- is above 0")
    return value, one


def _last_digit(text: str) -> float:
    """One unit of the last digit that a number of seconds is given to."""
    digits = re.search(r"\.(\d+)", text)
    return 1.0 if digits is None else float(10.0 ** -len(digits[1]))


def precise_moment(text: str) -> tuple[int, float]:
    """ISO 8601, UTC without a zone -> Unix ns, and one sigma (s): one unit of its last digit."""
    return moment(text), _last_digit(text)


def moment(text: str) -> int:
    """ISO 8601, UTC without a zone -> Unix ns."""
    try:
        moment = datetime.fromisoformat(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text!r} is no time as 2026-06-12T10:15:23.4Z") from error
    moment = moment if moment.tzinfo is not None else moment.replace(tzinfo=UTC)
    since = moment - datetime(1970, 1, 1, tzinfo=UTC)
    return (since.days * 86_400 + since.seconds) * 1_000_000_000 + since.microseconds * 1000
