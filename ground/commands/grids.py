"""`--crs` and `--local`: coordinates in another system."""

from __future__ import annotations

import argparse
import sys

from ground.commands.values import origin
from ground.formats.coordinates import Grid, LocalGrid, Projection


def add_grid_arguments(parser: argparse.ArgumentParser) -> None:
    """One of the two."""
    which = parser.add_mutually_exclusive_group()
    which.add_argument(
        "--crs", metavar="EPSG:N", help="coordinates in this system too, as EPSG:2193 (needs pointclick[geo])"
    )
    which.add_argument("--local", metavar="LAT,LON", type=origin, help="metres east and north of this place too")


def grid_of(args: argparse.Namespace) -> Grid | None:
    """The coordinate system that was chosen, if any; warns of one less accurate than the best. Raises InputError for an
    unknown one.
    """
    if args.local is not None:
        return LocalGrid(*args.local)
    if args.crs is None:
        return None
    found = Projection(args.crs)
    if not found.is_best:
        accuracy = "unknown" if found.accuracy_m is None else f"{found.accuracy_m:g} m"
        print(
            f"pc-ground: warning: the best way to {found.name} ({found.title}) needs a grid file that is not here; "
            f"this one's accuracy is {accuracy}",
            file=sys.stderr,
        )
    return found
