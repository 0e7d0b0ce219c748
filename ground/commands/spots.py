"""`pc-ground spots`: hot spots as things, a line for each that is new or has changed (docs/hot-spots.md).

Exit status: ground/commands/listening.py.
"""

from __future__ import annotations

import argparse
import json
import sys
import time

from contract.geodesy import distance_m
from contract.spot import person_text
from contract.topics import ANY_VEHICLE, STATUS
from ground.commands import ANSWERED, REFUSED
from ground.commands.listening import Received, add_listening_arguments, check_listening, write_out
from ground.commands.sources import opened, vehicles_of
from ground.commands.until_ended import until_ended
from ground.commands.values import finite, positive
from ground.formats import fire_area
from ground.formats.documents import FORMATS, one_line
from ground.formats.mark import Mark
from ground.link_options import UsageError, endpoint_of, tls_of
from ground.report_view import subscriptions
from ground.spots.fire import HOT_C, Fire
from ground.spots.found_thing import FoundThing
from ground.spots.received import ReceivedSpots

EXAMPLES = """\
examples:
  pc-ground spots --from SESSION.mcap                       what was found in a flight, a line each
  pc-ground spots --connect tcp/10.0.0.7:7447               as it is found, until Ctrl-C
  pc-ground spots --connect tcp/10.0.0.7:7447 --json --out found.geojson --seconds 600
  pc-ground spots --from SESSION.mcap --all --out all.kml  also what only one picture shows
  pc-ground spots --fire --minutes 10 --out fire.kml       where it burned, how sure that is, how fast it spreads
"""
SAVED = {".geojson": "geojson", ".json": "geojson", ".kml": "kml", ".gpx": "gpx", ".csv": "csv"}
HOTTER_K, SMALLER, ELSEWHERE = 1.0, 0.8, 1.0  # of a change that is reported: kelvin, of the ellipse, ellipses' axes
LOOK_S, FIRE_S = 0.2, 5.0
MINUTES = 5.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `spots`."""
    parser.add_argument("--all", action="store_true", help="also what one picture alone shows, and every change")
    fire = parser.add_argument_group("a fire instead of single things")
    fire.add_argument("--fire", action="store_true", help="the area that burned: .geojson or .kml with --out")
    fire.add_argument("--minutes", metavar="M", type=positive, help=f"in the last minutes (default {MINUTES:g})")
    fire.add_argument(
        "--above", metavar="C", type=finite, help=f"degrees Celsius above which it burns (default {HOT_C:g})"
    )
    add_listening_arguments(parser, SAVED)


def run(args: argparse.Namespace) -> int:
    """Print what is found. Raises PointclickError."""
    check_listening(args, fire_area.FORMATS if args.fire else SAVED, "hot spots do not cross")
    if not args.fire and (args.minutes is not None or args.above is not None):
        raise UsageError("--minutes and --above go with --fire")
    if args.fire:
        return _fire(args)
    received = _recorded(args) if args.recording is not None else _live(args)
    found = [thing for thing in received.things() if args.all or thing.is_sure]
    if received.unplaced:
        print(f"spots without a place, where a click has no answer either: {received.unplaced}", file=sys.stderr)
    if received.false_stamps:
        print(f"pictures stamped unlike those of their session, left out: {received.false_stamps}", file=sys.stderr)
    if received.mean_person_found is not None:
        print(f"in the mean of {received.pictures} pictures {person_text(received.mean_person_found)}", file=sys.stderr)
    if not found:
        why = "" if received.pictures else "; none is without a thermal camera (docs/hot-spots.md)"
        print(f"no hot spot found; pictures searched: {received.pictures}{why}", file=sys.stderr)
        return REFUSED
    marks = [Mark.of_found(thing) for thing in found]
    for path in args.out:
        write_out(args, path, FORMATS[SAVED[path.suffix.lower()]].write(marks, None))
    return ANSWERED


def _fire(args: argparse.Namespace) -> int:
    """The area that burned: of a recording's last minutes, or again and again while it burns."""
    received = ReceivedSpots(HOT_C if args.above is None else args.above)
    if args.recording is not None:
        _read(received, args)
        fire = _report_fire(received, args)
    else:
        fire = _live_fire(received, args)
    if fire is None:
        print("no picture shows a fire with its outline", file=sys.stderr)
        return REFUSED
    for path in args.out:
        write_out(args, path, fire_area.write(fire, path.name))
    return ANSWERED


def _report_fire(received: ReceivedSpots, args: argparse.Namespace) -> Fire | None:
    fire = received.fire(MINUTES if args.minutes is None else args.minutes)
    if fire is not None:
        print(json.dumps(fire_area.features(fire)) if args.json else fire.to_text(), flush=True)
    return fire


def _live_fire(received: ReceivedSpots, args: argparse.Namespace) -> Fire | None:
    """Print the fire every FIRE_S by what came over the link, until a signal or the time ends it; the last one."""
    from ground.client import SetCache  # noqa: PLC0415  zenoh is loaded only where there is a link

    tls, vehicle = tls_of(args), args.vehicle or ANY_VEHICLE
    endpoint = endpoint_of(args, tls)
    there = Received(endpoint, args.vehicle)
    fire: Fire | None = None
    began_s = time.monotonic()
    taken_by = {STATUS.key(vehicle): there.take, **subscriptions(vehicle, received)}
    with SetCache(endpoint, vehicle, tls=tls, max_sets=1, subscriptions=taken_by) as cache, until_ended():
        while args.seconds is None or time.monotonic() < began_s + args.seconds:
            time.sleep(FIRE_S if args.seconds is None else min(FIRE_S, args.seconds))
            there.report(cache.vehicles)
            fire = _report_fire(received, args)
    there.check(cache.vehicles)
    return fire


def _read(received: ReceivedSpots, args: argparse.Namespace) -> None:
    """Take the reports of one vehicle in a recording, or of all."""
    recording = opened(args.recording)
    received.read(recording, vehicles_of(args.vehicle, recording.vehicles))


def _recorded(args: argparse.Namespace) -> ReceivedSpots:
    """Print the spots found in a recorded flight, as they were known at the end."""
    received = ReceivedSpots()
    _read(received, args)
    for thing in received.things():
        if args.all or thing.is_sure:
            _print_thing(thing, args)
    return received


def _live(args: argparse.Namespace) -> ReceivedSpots:
    """Print the spots that come over the link, until a signal or the time ends it."""
    from ground.client import SetCache  # noqa: PLC0415  zenoh is loaded only where there is a link

    tls, vehicle, received = tls_of(args), args.vehicle or ANY_VEHICLE, ReceivedSpots()
    endpoint = endpoint_of(args, tls)
    there = Received(endpoint, args.vehicle)
    until_s = None if args.seconds is None else time.monotonic() + args.seconds
    reported: dict[int, FoundThing] = {}
    version = 0
    filled = {STATUS.key(vehicle): there.take, **subscriptions(vehicle, received)}
    with SetCache(endpoint, vehicle, tls=tls, max_sets=1, subscriptions=filled) as cache, until_ended():
        while until_s is None or time.monotonic() < until_s:
            there.report(cache.vehicles)
            version, changed = received.since(version)
            for thing in changed:
                if args.all or (thing.is_sure and is_news(thing, reported.get(thing.number))):
                    reported[thing.number] = thing
                    _print_thing(thing, args)
            time.sleep(LOOK_S)
    there.check(cache.vehicles)
    return received


def is_news(thing: FoundThing, before: FoundThing | None) -> bool:
    """Return whether a thing differs from its last report by more than a person would overlook."""
    if before is None or (before.course is None) != (thing.course is None):
        return True
    if thing.course is not None and before.course is not None and thing.course.is_moving != before.course.is_moving:
        return True
    if abs(thing.above_ground_k or 0.0) > abs(before.above_ground_k or 0.0) + HOTTER_K:
        return True
    old, new = before.place, thing.place
    if new.ellipse.semi_major_m < SMALLER * old.ellipse.semi_major_m:
        return True
    away_m = distance_m((old.lat_deg, old.lon_deg), (new.lat_deg, new.lon_deg))
    return away_m > ELSEWHERE * max(old.ellipse.semi_major_m, 1.0)


def _print_thing(thing: FoundThing, args: argparse.Namespace) -> None:
    print(thing.to_json() if args.json else one_line(thing.to_text()), flush=True)
