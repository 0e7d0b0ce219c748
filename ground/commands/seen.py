"""`pc-ground seen`: which ground was seen, when, how often and how finely; and what was not. docs/seen.md."""

from __future__ import annotations

import argparse
import sys
import time
from collections import deque
from collections.abc import Iterator
from pathlib import Path

from contract.errors import InputError
from contract.feature_set import FeatureSet
from contract.topics import ANY_VEHICLE
from ground.commands import ANSWERED, REFUSED
from ground.commands.sources import add_source_arguments, opened, vehicle_of
from ground.commands.until_ended import until_ended
from ground.commands.values import positive
from ground.link_options import UsageError, endpoint_of, tls_of
from ground.seen.area import read_area
from ground.seen.cells import LEAST_CELL_M, MOST_CELL_M
from ground.seen.coverage import Coverage, coverage
from ground.seen.export import WRITERS, time_text, write
from ground.seen.tally import SeenGround

EXAMPLES = """\
examples:
  pc-ground seen --from SESSION.mcap                             how much was seen, and the largest gaps
  pc-ground seen --from SESSION.mcap --polygon area.geojson --out seen.tif --out seen.geojson
  pc-ground seen --connect tcp/10.0.0.7:7447 --seconds 600 --cell 5 --out seen.geojson
"""
GAPS_LISTED = 5
REPORT_EVERY_S = 10.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `seen`."""
    parser.add_argument("--polygon", metavar="AREA.geojson", type=Path, help="the searched area (default: convex hull)")
    parser.add_argument(
        "--cell", metavar="M", type=positive, help="side of a cell (default: a hundredth of the height)"
    )
    parser.add_argument(
        "--out",
        metavar="FILE",
        type=Path,
        action="append",
        default=[],
        help=f"{', '.join(sorted(WRITERS))}; may be repeated",
    )
    parser.add_argument(
        "--seconds", metavar="S", type=positive, help="live: end so long after the first set (default: Ctrl-C)"
    )
    add_source_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Count, print the summary and write the files. Raises PointclickError."""
    if args.cell is not None and not LEAST_CELL_M <= args.cell <= MOST_CELL_M:
        raise UsageError(f"--cell must be from {LEAST_CELL_M:g} to {MOST_CELL_M:g} m")
    for path in args.out:
        if path.suffix.lower() not in WRITERS:
            raise UsageError(f"--out {path}: the name must end in {', '.join(sorted(WRITERS))}")
        if not path.parent.is_dir():
            raise InputError(f"--out {path}: there is no folder {path.parent}")
    area = None if args.polygon is None else read_area(args.polygon)
    seen = SeenGround(args.cell)
    for found in _recorded(args) if args.recording is not None else _live(args):
        seen.add(found)
    shown = coverage(seen, area)
    if seen.too_large:
        print(
            f"pc-ground: warning: {seen.too_large} pictures cover too many cells: choose larger --cell", file=sys.stderr
        )
    if seen.dropped_tiles:
        print("pc-ground: warning: too large a ground: the part seen longest ago was dropped", file=sys.stderr)
    if shown is None:
        print("nothing was surely seen: no set answers, or all are too uncertain")
        return REFUSED
    print("\n".join(summary(seen, shown)))
    for path in args.out:
        write(path, seen, shown)
        print(f"written: {path}")
    return ANSWERED


def summary(seen: SeenGround, found: Coverage) -> list[str]:
    """Lines for people."""
    low, middle, high = found.gsd_m
    sources = ", ".join(sorted({vehicle for vehicle, _ in seen.sources}))
    lines = [
        f"seen: {_area(found.seen_m2)} in {seen.pictures} picture{_s(seen.pictures)} of {sources}, "
        f"{time_text(found.first_s)} to {time_text(found.last_s)}, cells of {found.cells.cell_m:g} m",
        f"seen in one picture only: {_share(found.once_m2, found.seen_m2)}",
        f"ground sample distance: {low:.3g} to {high:.3g} m, median {middle:.3g} m",
    ]
    which = "convex hull of what was seen" if found.is_hull else "as given"
    share, count = _share(found.seen_of_searched_m2, found.searched_m2), len(found.gaps)
    lines.append(f"searched area ({which}): {_area(found.searched_m2)}, seen {share}, {count} gap{_s(count)}")
    for number, gap in enumerate(found.gaps[:GAPS_LISTED], 1):
        lines.append(f"gap {number}: {_area(gap.area_m2)} about {gap.lat_deg:.5f}, {gap.lon_deg:.5f}")
    return lines


def _recorded(args: argparse.Namespace) -> Iterator[FeatureSet]:
    """The sets of a recording, of one vehicle or of all, each at its latest revision."""
    if args.seconds is not None:
        raise UsageError("--seconds is for a live aircraft")
    recording = opened(args.recording)
    vehicles = recording.vehicles if args.vehicle is None else [vehicle_of(args.vehicle, recording.vehicles)]
    reported_s = time.monotonic()
    for vehicle in vehicles:
        rows = recording.rows(vehicle)
        for k, (frame, _, _, status) in enumerate(rows):
            if time.monotonic() - reported_s > REPORT_EVERY_S:
                reported_s = time.monotonic()
                print(f"pc-ground seen: {vehicle}: {k} of {len(rows)} pictures", file=sys.stderr)
            try:
                found = recording.by_frame(vehicle, frame) if status.value == "ok" else None
            except InputError as error:
                print(f"pc-ground: warning: {error}", file=sys.stderr)
                continue
            if found is not None:
                yield found


def _live(args: argparse.Namespace) -> Iterator[FeatureSet]:
    """Yield the sets that come over the link, until a signal or the time ends it."""
    from ground.client import SetCache  # noqa: PLC0415  zenoh is loaded only where there is a link

    tls = tls_of(args)
    came: deque[FeatureSet] = deque()
    vehicle = args.vehicle or ANY_VEHICLE
    with (
        SetCache(endpoint_of(args, tls), vehicle, tls=tls, max_sets=1, on_set=lambda s, _: came.append(s)),
        until_ended(),
    ):
        until = None
        while until is None or time.monotonic() < until:
            while came:
                if until is None and args.seconds is not None:
                    until = time.monotonic() + args.seconds
                yield came.popleft()
            time.sleep(0.1)


def _s(count: int) -> str:
    return "" if count == 1 else "s"


def _area(m2: float) -> str:
    return f"{m2 / 1e6:.3f} km2" if m2 >= 1e5 else f"{m2 / 1e4:.2f} ha" if m2 >= 1e3 else f"{m2:.0f} m2"


def _share(part: float, whole: float) -> str:
    return f"{100.0 * part / whole:.1f} %" if whole > 0.0 else "0 %"
