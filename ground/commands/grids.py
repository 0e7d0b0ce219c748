"""`--crs` and `--local`: coordinates in another system."""

from __future__ import annotations

import argparse

from contract.errors import InputError
from ground.commands.values import origin
from ground.commands.warnings import Warnings
from ground.formats.coordinates import Grid, LocalGrid, Projected, Projection
from ground.formats.documents import one_line
from ground.formats.mark import Mark


def add_grid_arguments(parser: argparse.ArgumentParser) -> None:
    """One of the two."""
    which = parser.add_mutually_exclusive_group()
    which.add_argument(
        "--crs", metavar="EPSG:N", help="coordinates in this system too, as EPSG:2193 (needs pointclick[geo])"
    )
    which.add_argument("--local", metavar="LAT,LON", type=origin, help="metres east and north of this place too")


def grid_of(args: argparse.Namespace, *, of_several: bool = False) -> Grid | None:
    """The coordinate system that was chosen, if any; it warns where the change of datum adds to an error. Raises
    InputError for an unknown one.

    `of_several`: a mark that it does not reach is named in a warning, and the others have their coordinates.
    """
    if args.local is not None:
        return LocalGrid(*args.local)
    return None if args.crs is None else _WarningProjection(args.crs, of_several)


class _WarningProjection(Projection):
    """A projection that prints what its changes of datum add to the error, each sentence once."""

    def __init__(self, code: str, of_several: bool) -> None:
        super().__init__(code)
        self._warnings, self._of_several = Warnings(), of_several

    def found(self, mark: Mark) -> Projected | None:
        try:
            return self.of(mark)
        except InputError as error:
            if not self._of_several:
                raise
            self._warnings.show([f"{one_line(mark.title)}, in degrees: {error}"])
            return None

    def project(self, lat_deg: float, lon_deg: float) -> Projected:
        found = super().project(lat_deg, lon_deg)
        self._warnings.show([f"{self.name} ({self.title}), {found.doubt}"] if found.doubt else [])
        return found
