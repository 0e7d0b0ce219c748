"""`pc-ground router`: a ground station's router for many aircraft and people, from the list of who may do what."""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from dataclasses import replace
from pathlib import Path

from contract.errors import InputError, PointclickError
from contract.fleet import FLEET_FILE, ROLES, Fleet, read_fleet
from ground.commands import ANSWERED
from ground.commands.until_ended import until_ended

EXAMPLES = f"""\
examples:
  pc-onboard make-credentials keys --router base --address 10.0.0.1 --vehicle uav1 --vehicle uav2 --operator anna
  pc-ground router --config keys/{FLEET_FILE} --listen tls/0.0.0.0:7447
  pc-ground router --config keys/{FLEET_FILE} --print-zenohd-config > zenohd.json   for zenohd --config zenohd.json
"""
LOOK_S = 1.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `router`."""
    parser.add_argument(
        "--config",
        metavar="FILE",
        type=Path,
        default=Path(FLEET_FILE),
        help=f"who may do what, or the folder with it: {FLEET_FILE} next to the certificates (make-credentials), by "
        "default in this folder; read again when it changes",
    )
    parser.add_argument(
        "--listen", metavar="ENDPOINT", action="append", help="tls/ADDRESS:PORT, in place of the file's; repeatable"
    )
    parser.add_argument(
        "--print-zenohd-config", action="store_true", help="print what zenohd (1.9 or newer) reads, and end"
    )


def run(args: argparse.Namespace) -> int:
    """Route until interrupted. Raises PointclickError."""
    from ground.router import Router, router_config  # noqa: PLC0415  zenoh is loaded only where there is a link

    path = args.config / FLEET_FILE if args.config.is_dir() else args.config
    if not path.is_file():
        raise InputError(
            f"{path}: no such list of who may do what: name it with --config; pc-onboard make-credentials writes one"
        )
    listed = ListOfFile(path, args.listen)
    fleet = listed.read()
    folder = path.parent
    if args.print_zenohd_config:
        print(json.dumps(router_config(fleet, folder), indent=2))
        return ANSWERED
    with Router(fleet, folder) as router, until_ended():
        print(f"pc-ground router: {', '.join(fleet.listen)}; {in_a_line(fleet)}", flush=True)
        while True:
            time.sleep(LOOK_S)
            try:
                changed = listed.changed()
                if changed is not None and changed != router.fleet:
                    router.replace(changed)
                    print(f"pc-ground router: {path} read again; {in_a_line(changed)}", flush=True)
            except PointclickError as error:
                print(f"pc-ground router: warning: {error}; the list from before stays", file=sys.stderr, flush=True)
    return ANSWERED


class ListOfFile:
    """The list of a file, read again when the file is another."""

    def __init__(self, path: Path, listen: list[str] | None) -> None:
        self._path, self._listen = path, listen
        self._seen: tuple[int, ...] | None = None

    def read(self) -> Fleet:
        """The list now. Raises InputError."""
        self._seen = self._stamp()
        fleet = read_fleet(self._path)
        return replace(fleet, listen=tuple(self._listen)) if self._listen else fleet

    def changed(self) -> Fleet | None:
        """The list, if the file is not the one read last. Raises InputError, once for each state of the file."""
        return None if self._stamp() == self._seen else self.read()

    def _stamp(self) -> tuple[int, ...] | None:
        try:
            about = os.stat(self._path)  # noqa: PTH116  of a name that may be missing for a moment
        except OSError:
            return None
        return about.st_ino, about.st_size, about.st_mtime_ns


def in_a_line(fleet: Fleet) -> str:
    """The number of participants of each kind, in a line."""
    words = {"pins": "share pins"}
    return ", ".join(f"{len(getattr(fleet, role))} {words.get(role, role)}" for role in ROLES)
