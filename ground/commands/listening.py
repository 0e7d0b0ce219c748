"""Options, files and endings of the commands that listen until they are ended: `spots`, `track` and `seen`.

Exit status of each: 0 something was found, followed or seen; 3 nothing was, by an aircraft that was received or in a
recording; 2 wrong usage, a recording that cannot be read, no such aircraft, or none received. Live, Ctrl-C and SIGTERM
end it as the time given does.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Collection, Sequence
from pathlib import Path

from contract.errors import InputError, LinkError
from contract.whole_file import save
from ground.commands.sources import add_source_arguments
from ground.commands.values import positive
from ground.link_options import UsageError
from ground.mavlink_endpoint import SCHEME

PATIENCE_S = 5.0  # without a message until it is reported; zenoh looks for the other end every second


def add_listening_arguments(
    parser: argparse.ArgumentParser, formats: Collection[str], vehicle: str = "only this aircraft (default: all)"
) -> None:
    """`--json`, `--seconds`, `--out` and the source's."""
    parser.add_argument("--json", action="store_true", help="JSON instead of lines for people")
    parser.add_argument("--seconds", metavar="S", type=positive, help="live: end after so long (default: Ctrl-C)")
    parser.add_argument(
        "--out", metavar="FILE", type=Path, action="append", default=[],
        help=f"written at the end: {', '.join(sorted(formats))}; may be repeated",
    )  # fmt: skip
    add_source_arguments(parser, vehicle)


def check_listening(args: argparse.Namespace, formats: Collection[str], unsent: str = "") -> None:
    """Raise UsageError or InputError for options that cannot be, before anything is listened to.

    `unsent`: what of this command does not cross an autopilot's radio.
    """
    check_files("--out", args.out, formats)
    if args.recording is not None and args.seconds is not None:
        raise UsageError("--seconds is for a live aircraft")
    if unsent and str(args.connect or "").startswith(SCHEME):
        raise UsageError(f"{unsent} the autopilot's radio: name the aircraft's own link with --connect")


def check_files(option: str, paths: Sequence[Path], suffixes: Collection[str]) -> None:
    """Raise UsageError for a name with another ending, InputError where there is no such folder."""
    for path in paths:
        if path.suffix.lower() not in suffixes:
            raise UsageError(f"{option} {path}: the name must end in {', '.join(sorted(suffixes))}")
        if not path.parent.is_dir():
            raise InputError(f"{option} {path}: there is no folder {path.parent}")


def write_out(args: argparse.Namespace, path: Path, content: str | bytes) -> None:
    """Write a file of `--out`, and its name in a line unless JSON is printed. Raises InputError."""
    save(path, content)
    if not args.json:
        print(f"written: {path}")


class Received:
    """The record that something of an aircraft came: without a link nothing is found either, and that is no finding."""

    def __init__(self, endpoint: str, vehicle: str | None) -> None:
        self._endpoint, self._vehicle = endpoint, vehicle
        self._began_s = time.monotonic()
        self._is_there = self._is_reported = False

    def take(self, key: str, payload: bytes) -> None:
        self._is_there = True

    def report(self, vehicles: Sequence[str]) -> None:
        """State once on standard error that nothing comes; `vehicles` of which sets came."""
        self._is_there = self._is_there or bool(vehicles)
        if not (self._is_there or self._is_reported) and time.monotonic() - self._began_s > PATIENCE_S:
            self._is_reported = True
            print(f"pc-ground: warning: {self._missing}; waiting", file=sys.stderr)

    def check(self, vehicles: Sequence[str]) -> None:
        """Raise LinkError if nothing came until the end."""
        if not (self._is_there or vehicles):
            raise LinkError(self._missing)

    @property
    def _missing(self) -> str:
        who = "an aircraft" if self._vehicle is None else f"aircraft {self._vehicle!r}"
        return (
            f"nothing received from {who} at {self._endpoint}: does pc-onboard run there, and does its link.listen "
            f"open it?"
        )
