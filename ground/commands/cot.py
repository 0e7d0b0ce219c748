"""`pc-ground cot`: pins, aircraft, what they follow and find as Cursor on Target, to a TAK server or to everybody."""

from __future__ import annotations

import argparse
import contextlib
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from contract.errors import LinkError
from contract.feature_set import FeatureSet
from contract.topics import ANY_VEHICLE
from contract.track import TrackReport
from contract.track_age import LOST_AFTER_S
from ground.commands import ANSWERED
from ground.commands.sources import add_source_arguments, opened
from ground.commands.values import positive, whole
from ground.commands.warnings import Warnings
from ground.cot_sender import CotSender, Target
from ground.formats import cot
from ground.formats.mark import Mark
from ground.link_options import endpoint_of, tls_of
from ground.pins.file import chosen_store
from ground.pins.machine import decision, decisions
from ground.pins.places import Places
from ground.pins.store import PinStore
from ground.received_tracks import ReceivedTracks
from ground.report_view import subscriptions
from ground.spots.found_thing import FoundThing
from ground.spots.received import ReceivedSpots

EXAMPLES = """\
examples:
  pc-ground cot --to udp://239.2.3.1:6969                    everybody on the network (ATAK listens there)
  pc-ground cot --to tcp://10.0.0.5:8087 --once              a TAK server, once
  pc-ground cot --to tls://tak.example.org:8089 --to-ca ca.pem --to-certificate me.pem --to-key me.key
  pc-ground cot --to udp://239.2.3.1:6969 --only-pins        without a link to any aircraft
"""
STALE_PERIODS = 3.0  # an event that was not sent again for so many periods is stale
LEAST_STALE_S = 30.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `cot`."""
    parser.add_argument(
        "--to", metavar="URL", required=True, help="udp://HOST:PORT, tcp://HOST:PORT or tls://HOST:PORT"
    )
    parser.add_argument("--to-ca", metavar="FILE.pem", type=Path, help="with tls: the server's authority")
    parser.add_argument("--to-certificate", metavar="FILE.pem", type=Path, help="with tls: ours")
    parser.add_argument("--to-key", metavar="FILE.pem", type=Path, help="with tls: its private key")
    parser.add_argument(
        "--ttl", metavar="N", type=lambda t: whole(t, "hop"), default=1, help="multicast hops (default 1)"
    )
    parser.add_argument("--pins", metavar="FILE", type=Path, help="the file of pins (default: the user's own)")
    parser.add_argument("--store", metavar="URL", help="or a server: postgresql://USER@HOST/DATABASE")
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--only-pins", action="store_true", help="no aircraft, and no link to any")
    which.add_argument("--only-aircraft", action="store_true", help="no pins")
    parser.add_argument("--period", metavar="S", type=positive, default=10.0, help="all is sent again (default 10)")
    parser.add_argument("--once", action="store_true", help="send it once and end")
    add_source_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Send until interrupted, or once. Raises PointclickError for what cannot work from the start."""
    target = Target.of(args.to, args.to_ca, args.to_certificate, args.to_key, args.ttl)
    store = None if args.only_aircraft else PinStore(chosen_store(args.pins, args.store))
    places = None if store is None else Places(store)
    aircraft = _no_aircraft if args.only_pins else _aircraft(args, _stale_s(args.period))
    with contextlib.ExitStack() as opened_links, CotSender(target) as sender:
        if isinstance(aircraft, _aircraft):
            opened_links.callback(aircraft.close)
        shown, warnings = "", Warnings()
        while True:
            try:
                sender.connect()  # before anything is computed: without a link there is no one to compute it for
                events = _events(store, places, aircraft, args.period)
                sender.send(events)
                if args.once:
                    sender.finish()
                words = f"{len(events)} events to {args.to}{sender.ended and f'; the last stream {sender.ended}'}"
            except LinkError as error:
                if args.once:
                    raise
                words = str(error)  # the next period tries again
            if isinstance(aircraft, _aircraft):
                warnings.show(aircraft.dropped())
            if words != shown:
                print(f"pc-ground cot: {words}", file=sys.stderr)
                shown = words
            if args.once:
                return ANSWERED
            sender.pause(args.period)


def _events(
    store: PinStore | None, places: Places | None, aircraft: _aircraft | Callable[[], list[FeatureSet]], period_s: float
) -> list[str]:
    """Everything as it is now: what an outage kept back is in it, once, and as it is by then."""
    now_ns, stale_s = time.time_ns(), _stale_s(period_s)
    marks = [] if store is None or places is None else [Mark.of_pin(p, places.place(p)) for p in store.pins()]
    sets = aircraft()
    tracks = aircraft.tracks() if isinstance(aircraft, _aircraft) else []
    found = aircraft.found() if isinstance(aircraft, _aircraft) else []
    decided = {} if store is None else decisions(store.everything())
    marks += [Mark.of_found(thing) for thing in found if decision(thing, decided) is None]
    events = (
        *(cot.event(mark, now_ns, stale_s) for mark in marks),
        *(event for s in sets for event in cot.aircraft_events(s, now_ns, stale_s)),
        *(cot.track_event(report, now_ns, period_s + LOST_AFTER_S) for report in tracks),
    )
    return [event for event in events if event is not None]


def _stale_s(period_s: float) -> float:
    return max(STALE_PERIODS * period_s, LEAST_STALE_S)


def _no_aircraft() -> list[FeatureSet]:
    return []


class _aircraft:  # noqa: N801  called like a function
    """The newest set of every aircraft that answers, live or of a recording."""

    WAIT_S = 3.0  # for the first, so that `--once` has something to send

    def __init__(self, args: argparse.Namespace, stale_s: float) -> None:
        self._vehicle, self._stale_s = args.vehicle, stale_s
        self._tracks, self._spots = ReceivedTracks(), ReceivedSpots()
        self._recording = None if args.recording is None else opened(args.recording)
        if self._recording is not None:
            self._spots.read(self._recording, self._recording.vehicles)
        else:
            from ground.client import SetCache  # noqa: PLC0415  zenoh is loaded only where there is a link

            tls, vehicle = tls_of(args), args.vehicle or ANY_VEHICLE
            filled = subscriptions(vehicle, self._tracks, self._spots)
            self._cache = SetCache(endpoint_of(args, tls), vehicle, tls=tls, subscriptions=filled)
            until = time.monotonic() + self.WAIT_S
            while time.monotonic() < until and not self():
                time.sleep(0.05)

    def close(self) -> None:
        if self._recording is None:
            self._cache.close()

    def tracks(self) -> list[TrackReport]:
        """The newest report of every track that is still being reported, as of now by this computer's clock."""
        if self._recording is not None:
            return []
        return [replace(r, capture_unix_ns=time.time_ns()) for r in self._tracks.newest(self._cache.stamped_ago_s)]

    def dropped(self) -> list[str]:
        """The messages that were not accepted, a line for each reason."""
        if self._recording is not None:
            return []
        doubts = [f"{name}: {doubt}" for name in self._cache.vehicles if (doubt := self._cache.doubt(name))]
        return [*self._cache.dropped.lines(), *doubts]

    def found(self) -> list[FoundThing]:
        """The things that more than one picture shows as a hot spot."""
        return [thing for thing in self._spots.things() if thing.is_sure]

    def __call__(self) -> list[FeatureSet]:
        source = self._cache if self._recording is None else self._recording
        names = [n for n in source.vehicles if self._vehicle in (None, n)]
        sets = [s for s in (source.newest(name) for name in names) if s is not None]
        if self._recording is None:  # an event states where something is now
            sets = [s for s in sets if self._cache.stamped_ago_s(s.vehicle, s.capture_unix_ns) <= self._stale_s]
        return sets
