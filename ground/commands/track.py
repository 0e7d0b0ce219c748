"""`pc-ground track`: what is at a pixel is followed by the aircraft, and each report of it is a line.

Exit status: ground/commands/listening.py; 0 too where the thing was lost in the end, 3 where the aircraft refuses.
"""

from __future__ import annotations

import argparse
import sys
import time
from typing import TYPE_CHECKING

from contract import track_age
from contract.errors import LinkError
from contract.track import ListTracks, StartTrack, StopTrack, TrackReport, TrackState, Unseen
from contract.track_age import as_of
from contract.wire.message import TRACK_REPORTS
from ground.commands import ANSWERED, REFUSED
from ground.commands.listening import add_listening_arguments, check_listening, write_out
from ground.commands.sources import opened, vehicles_of
from ground.commands.until_ended import until_ended
from ground.commands.values import finite, frame_number, whole
from ground.commands.warnings import Warnings
from ground.formats import track_path
from ground.formats.documents import one_line
from ground.link_options import UsageError, endpoint_of, tls_of

if TYPE_CHECKING:
    from ground.track_link import TrackLink

EXAMPLES = """\
examples:
  pc-ground track 480 120 --frame 1234        what is at that pixel of picture 1234, from then on, until Ctrl-C
  pc-ground track 480 120                     of the newest picture
  pc-ground track 480 120 --out car.kml      its path with times when it ends (.kml or .geojson)
  pc-ground track --connect tcp/10.0.0.7:7447 --json    every track of that aircraft, a JSON object a line
  pc-ground track --from SESSION.mcap --out all.kml     what was followed in a recorded flight
  pc-ground track --list; pc-ground track --stop 3
"""
MOST_KEPT = 200_000  # reports for --out: more than a day of one track
REPEATED_S = 0.5  # between reports that are aged
SILENT_S = 10.0  # without a report of a track that was begun


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `track`."""
    parser.add_argument("u", metavar="U", nargs="?", type=finite, help="pixel column; without U and V: listen to all")
    parser.add_argument("v", metavar="V", nargs="?", type=finite, help="pixel row")
    parser.add_argument(
        "--frame", metavar="N", type=frame_number, help="the picture that was clicked (default: newest)"
    )
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--list", action="store_true", help="the numbers of all tracks, and end")
    which.add_argument("--stop", metavar="N", type=lambda t: whole(t, "track"), help="end track N")
    parser.add_argument("--leave", action="store_true", help="the track goes on when this command ends")
    parser.add_argument("--count", metavar="N", type=lambda t: whole(t, "count"), help="end after so many reports")
    add_listening_arguments(
        parser,
        track_path.FORMATS,
        "only this aircraft (default: all of a recording; live, needed where several answer)",
    )


def run(args: argparse.Namespace) -> int:
    """Follow until ended. Raises PointclickError."""
    if (args.u is None) != (args.v is None):
        raise UsageError("track needs U and V, or neither to listen")
    if args.u is None and args.frame is not None:
        raise UsageError("--frame goes with U and V")
    if args.u is not None and (args.list or args.stop is not None):
        raise UsageError("--list and --stop go without U and V")
    check_listening(args, track_path.FORMATS, "nothing can be followed through")
    if args.recording is not None:
        return _recorded(args)
    from ground.put_request import RequestRefused  # noqa: PLC0415  zenoh is loaded only where there is a link
    from ground.track_link import TrackLink  # noqa: PLC0415

    tls = tls_of(args)
    with TrackLink(endpoint_of(args, tls), args.vehicle, tls) as link:
        try:
            if args.list or args.stop is not None:
                reply = link.ask(ListTracks() if args.list else StopTrack(args.stop))
                print(" ".join(str(number) for number in reply.get("tracks", [])))
                return ANSWERED
            number = None
            if args.u is not None:
                number = int(link.ask(StartTrack(args.u, args.v, args.frame))["track"])
        except RequestRefused as error:
            print(error, file=sys.stderr)
            return REFUSED
        except (KeyError, TypeError, ValueError) as error:
            raise LinkError(f"the aircraft's answer cannot be read: {error}") from error
        kept: list[TrackReport] = []
        with until_ended():
            _listen(link, number, args, kept)
        if number is not None and not args.leave and not (kept and kept[-1].state is TrackState.LOST):
            _stop(link, number)
        if number is None and not kept:
            link.ask(ListTracks())  # raises where there is no such aircraft
            print("nothing is followed", file=sys.stderr)
            return REFUSED
    for path in args.out:
        write_out(args, path, track_path.write(kept, path.name))
    return ANSWERED


def _recorded(args: argparse.Namespace) -> int:
    """Every report of a recording. Raises PointclickError."""
    if args.u is not None or args.list or args.stop is not None or args.leave or args.count is not None:
        raise UsageError("--from shows what was followed in flight: without U, V, --list, --stop, --leave and --count")
    recording = opened(args.recording)
    vehicles = vehicles_of(args.vehicle, recording.vehicles)
    reports = recording.reports(TRACK_REPORTS, vehicles)
    for report in reports:
        whose = f"{one_line(report.vehicle)} " if len(vehicles) > 1 else ""
        print(report.to_json() if args.json else whose + report.to_text())
    if not reports:
        print("nothing was followed in this flight", file=sys.stderr)
        return REFUSED
    for path in args.out:
        write_out(args, path, track_path.write(reports, path.name))
    return ANSWERED


def _listen(link: TrackLink, number: int | None, args: argparse.Namespace, kept: list[TrackReport]) -> None:
    """Print reports until the time is over or the track is lost."""
    until_s = None if args.seconds is None else time.monotonic() + args.seconds
    received_s, warnings, silent = time.monotonic(), Warnings(), _Silent()
    count = 0
    while (until_s is None or time.monotonic() < until_s) and count != args.count:
        report = link.next(0.2)
        for aged in silent.passed(time.monotonic(), None if report is None else report.number):
            if number in (None, aged.number):
                print(aged.to_json() if args.json else aged.to_text(), flush=True)
        if report is not None:
            silent.take(report, time.monotonic())
        if report is None or (number is not None and report.number != number):
            if number is not None and time.monotonic() - received_s > SILENT_S:
                received_s = time.monotonic()
                print(f"track {number}: nothing received for {SILENT_S:.0f} s", file=sys.stderr)
            if link.left_out:
                warnings.show([f"dropped, reports of a session that does not run: {link.left_out} messages"])
            continue
        received_s = time.monotonic()
        if not args.out or len(kept) >= MOST_KEPT:
            kept[:] = kept[: MOST_KEPT - 1 if args.out else 0]
        kept.append(report)
        count += 1
        print(report.to_json() if args.json else report.to_text(), flush=True)
        if number is not None and report.state is TrackState.LOST:
            return


class _Silent:
    """The tracks of which nothing comes any more: the last report, aged, twice a second until it is lost.

    Who stood still does not know that nothing came: what waits by then is taken first.
    """

    def __init__(self) -> None:
        self._last: dict[int, tuple[TrackReport, float]] = {}
        self._passed_s = self._looked_s = 0.0

    def take(self, report: TrackReport, now_s: float) -> None:
        self._last[report.number] = report, now_s

    def passed(self, now_s: float, received: int | None) -> list[TrackReport]:
        """Return the reports that are due; `received`: the track that has just been reported."""
        stood_still, self._looked_s = now_s - self._looked_s > REPEATED_S, now_s
        if not stood_still and now_s - self._passed_s < REPEATED_S:
            return []
        self._passed_s, out = now_s, list[TrackReport]()
        if stood_still:
            return out
        for number, (report, received_s) in list(self._last.items()):
            silent_s = now_s - received_s
            if number == received or silent_s <= track_age.SILENT_S:
                continue
            aged = as_of(report, silent_s, silent_s, Unseen.NO_REPORT)
            if aged.state is TrackState.LOST:
                del self._last[number]
            if report.state is not TrackState.LOST:
                out.append(aged)
        return out


def _stop(link: TrackLink, number: int) -> None:
    try:
        link.ask(StopTrack(number))
    except LinkError as error:
        print(f"pc-ground: warning: track {number} goes on: {error}", file=sys.stderr)
