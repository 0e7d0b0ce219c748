"""`pc-ground seen`: which ground was seen, when, how often and how finely; and what was not. docs/seen.md.

Exit status: ground/commands/listening.py.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path

from contract.camera import Camera
from contract.errors import InputError
from contract.feature_set import FeatureSet
from contract.spot import SpotReport
from contract.topics import ANY_VEHICLE, SPOTS, STATUS
from contract.wire.message import SPOT_REPORTS
from ground.commands import ANSWERED, REFUSED
from ground.commands.listening import Received, add_listening_arguments, check_files, check_listening, write_out
from ground.commands.sources import opened, vehicles_of
from ground.commands.until_ended import until_ended
from ground.commands.values import positive, share
from ground.link_options import UsageError, endpoint_of, tls_of
from ground.seen.area import read_sectors, read_woods
from ground.seen.cells import LEAST_CELL_M, MOST_CELL_M
from ground.seen.coverage import Coverage, coverage
from ground.seen.detection import detection
from ground.seen.export import WRITERS, time_text, write
from ground.seen.flight_rows import MOST_OVERLAP, OVERLAP, rows_over
from ground.seen.missions import FORMATS
from ground.seen.searched import BELOW, Searched, area_text, gap_dict, share_text
from ground.seen.tally import SeenGround

EXAMPLES = """\
examples:
  pc-ground seen --from SESSION.mcap                             how much was seen, and the largest gaps
  pc-ground seen --from SESSION.mcap --polygon area.geojson --out seen.tif --out seen.geojson
  pc-ground seen --from SESSION.mcap --pod --polygon sectors.kml --woods woods.geojson --out gaps.kml
  pc-ground seen --from SESSION.mcap --pod --below 0.8 --fly gaps.plan --fly gaps.waypoints --overlap 0.3
  pc-ground seen --connect tcp/10.0.0.7:7447 --seconds 600 --cell 5 --out seen.geojson
"""
GAPS_LISTED = 5
REPORT_EVERY_S = 10.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `seen`."""
    parser.add_argument(
        "--polygon", metavar="AREA", type=Path, help="searched areas, .geojson, .kml or .kmz (default: hull)"
    )
    parser.add_argument(
        "--cell", metavar="M", type=positive, help="side of a cell (default: a hundredth of the height)"
    )
    pod = parser.add_argument_group("probability of detection (docs/seen.md)")
    pod.add_argument("--pod", action="store_true", help="who would have been found, in each area of --polygon")
    pod.add_argument("--by", choices=("machine", "operator"), help="gaps are its (default: machine, if it searched)")
    pod.add_argument("--below", metavar="P", type=share, help=f"a gap is below this (default {BELOW:g})")
    pod.add_argument(
        "--woods", metavar="WOODS.geojson", type=Path, help="areas with the share `canopy` hidden by trees"
    )
    pod.add_argument("--look", metavar="S", type=positive, help="an operator's time for a picture (default: till next)")
    fly = parser.add_argument_group("gaps as something to fly, with --pod")
    fly.add_argument("--fly", metavar="FILE", type=Path, action="append", default=[], help=", ".join(sorted(FORMATS)))
    fly.add_argument("--height", metavar="M", type=positive, help="above the ground (default: what --below needs)")
    fly.add_argument("--overlap", metavar="P", type=share, help=f"of neighbouring rows (default {OVERLAP:g})")
    add_listening_arguments(parser, WRITERS)


def run(args: argparse.Namespace) -> int:
    """Count, print the summary and write the files. Raises PointclickError."""
    _check(args)
    sectors = None if args.polygon is None else read_sectors(args.polygon)
    woods = [] if args.woods is None else read_woods(args.woods)
    seen, reports, newest = SeenGround(args.cell), list[SpotReport](), list[FeatureSet]()

    def add(found: FeatureSet) -> None:
        seen.add(found)
        if found.is_ok and (not newest or found.capture_unix_ns > newest[0].capture_unix_ns):
            newest[:] = [found]

    (_live if args.recording is None else _recorded)(args, reports, add)
    shown = coverage(seen, None if sectors is None else [polygon for sector in sectors for polygon in sector.polygons])
    _warn(seen)
    if shown is None:
        print("nothing was surely seen: no set answers, or all are too uncertain", file=sys.stderr)
        return REFUSED
    searched = None
    if args.pod:
        by = detection(seen.looks(), shown, reports, woods, look_s=args.look)
        searched = Searched.of(by, shown, sectors, args.by, BELOW if args.below is None else args.below)
    if args.json:
        content = to_dict(seen, shown) | ({} if searched is None else {"detection": searched.to_dict()})
        print(json.dumps(content))
    else:
        print("\n".join([*summary(seen, shown), *([] if searched is None else searched.to_text())]))
    for path in args.out:
        write(path, seen, shown, searched)
        if not args.json:
            print(f"written: {path}")
    if args.fly and searched is not None and newest:
        _write_rows(args, searched, shown, newest[0].camera)
    return ANSWERED


def _check(args: argparse.Namespace) -> None:
    """Raise UsageError for options that need another one or cannot be, InputError for files that cannot be written."""
    if args.cell is not None and not LEAST_CELL_M <= args.cell <= MOST_CELL_M:
        raise UsageError(f"--cell must be from {LEAST_CELL_M:g} to {MOST_CELL_M:g} m")
    check_listening(args, WRITERS)
    given = [args.by, args.below, args.woods, args.look, args.height, args.overlap, args.fly or None]
    if not args.pod and any(value is not None for value in given):
        raise UsageError("--by, --below, --woods, --look, --fly, --height and --overlap go with --pod")
    if args.overlap is not None and args.overlap > MOST_OVERLAP:
        raise UsageError(f"--overlap is at most {MOST_OVERLAP:g}")
    check_files("--fly", args.fly, FORMATS)


def _write_rows(args: argparse.Namespace, searched: Searched, shown: Coverage, camera: Camera) -> None:
    """The gaps as files to fly, for the camera that took the newest picture. Raises InputError."""
    overlap = OVERLAP if args.overlap is None else args.overlap
    rows = rows_over(searched, shown, camera, args.height, overlap, args.look)
    if not args.json:
        print(rows.to_text())
    for path in args.fly:
        write_out(args, path, FORMATS[path.suffix.lower()](rows))


def _warn(seen: SeenGround) -> None:
    """Print to the error output what is left out."""
    if seen.too_large:
        print(
            f"pc-ground: warning: {seen.too_large} pictures cover too many cells: choose larger --cell", file=sys.stderr
        )
    if seen.dropped_tiles:
        print("pc-ground: warning: too large a ground: the part seen longest ago was dropped", file=sys.stderr)
    if seen.forgotten:
        print(f"pc-ground: warning: the first {seen.forgotten} pictures do not count for --pod", file=sys.stderr)


def to_dict(seen: SeenGround, found: Coverage) -> dict[str, object]:
    return {
        "pictures": seen.pictures, "vehicles": sorted({vehicle for vehicle, _ in seen.sources}),
        "first_utc": time_text(found.first_s), "last_utc": time_text(found.last_s), "cell_m": found.cells.cell_m,
        "seen_m2": round(found.seen_m2, 1), "once_m2": round(found.once_m2, 1),
        "gsd_m": [round(gsd, 4) for gsd in found.gsd_m], "is_hull": found.is_hull,
        "searched_m2": round(found.searched_m2, 1), "seen_of_searched_m2": round(found.seen_of_searched_m2, 1),
        "gaps": [gap_dict(gap) for gap in found.gaps],
    }  # fmt: skip


def summary(seen: SeenGround, found: Coverage) -> list[str]:
    """Lines for people."""
    low, middle, high = found.gsd_m
    sources = ", ".join(sorted({vehicle for vehicle, _ in seen.sources}))
    lines = [
        f"seen: {area_text(found.seen_m2)} in {seen.pictures} picture{_s(seen.pictures)} of {sources}, "
        f"{time_text(found.first_s)} to {time_text(found.last_s)}, cells of {found.cells.cell_m:g} m",
        f"seen in one picture only: {share_text(found.once_m2, found.seen_m2)}",
        f"ground sample distance: {low:.3g} to {high:.3g} m, median {middle:.3g} m",
    ]
    which = "convex hull of what was seen" if found.is_hull else "as given"
    share, count = share_text(found.seen_of_searched_m2, found.searched_m2), len(found.gaps)
    lines.append(f"searched area ({which}): {area_text(found.searched_m2)}, seen {share}, {count} gap{_s(count)}")
    for number, gap in enumerate(found.gaps[:GAPS_LISTED], 1):
        lines.append(f"gap {number}: {area_text(gap.area_m2)} about {gap.lat_deg:.5f}, {gap.lon_deg:.5f}")
    return lines


def _recorded(args: argparse.Namespace, reports: list[SpotReport], add: Callable[[FeatureSet], None]) -> None:
    """Add the sets of a recording, of one vehicle or of all, each at its latest revision; `reports` get its spots.

    Refused ones too: a picture that shows no known ground ends the time that the one before it was looked at.
    """
    recording = opened(args.recording)
    vehicles = vehicles_of(args.vehicle, recording.vehicles)
    reports += recording.reports(SPOT_REPORTS, vehicles) if args.pod else []
    reported_s = time.monotonic()
    for vehicle in vehicles:
        rows = recording.rows(vehicle)
        for k, (frame, *_) in enumerate(rows):
            if time.monotonic() - reported_s > REPORT_EVERY_S:
                reported_s = time.monotonic()
                print(f"pc-ground seen: {vehicle}: {k} of {len(rows)} pictures", file=sys.stderr)
            try:
                found = recording.by_frame(vehicle, frame)
            except InputError as error:
                print(f"pc-ground: warning: {error}", file=sys.stderr)
                continue
            if found is not None:
                add(found)


def _live(args: argparse.Namespace, reports: list[SpotReport], add: Callable[[FeatureSet], None]) -> None:
    """Add the sets that come over the link, until a signal or the time ends it; `reports` get the spots."""
    from ground.client import SetCache  # noqa: PLC0415  zenoh is loaded only where there is a link

    tls = tls_of(args)
    came: deque[FeatureSet] = deque()
    vehicle = args.vehicle or ANY_VEHICLE

    def take(key: str, payload: bytes) -> None:
        reports.extend(SPOT_REPORTS.found(key, payload))

    endpoint = endpoint_of(args, tls)
    there = Received(endpoint, args.vehicle)
    taken_by = {STATUS.key(vehicle): there.take} | ({SPOTS.key(vehicle): take} if args.pod else {})
    cache = SetCache(endpoint, vehicle, tls=tls, max_sets=1, on_set=lambda s, _: came.append(s), subscriptions=taken_by)
    until_s = None if args.seconds is None else time.monotonic() + args.seconds
    with cache, until_ended():
        while until_s is None or time.monotonic() < until_s:
            while came:
                add(came.popleft())
            there.report(cache.vehicles)
            time.sleep(0.1)
    while came:
        add(came.popleft())
    there.check(cache.vehicles)


def _s(count: int) -> str:
    return "" if count == 1 else "s"
