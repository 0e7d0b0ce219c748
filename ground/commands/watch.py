"""`pc-ground watch`: a line an aircraft, again and again: how it is, how old its picture, how good its answers.

And a line for each thing that it follows, and for each hot spot that was seen recently.
"""

from __future__ import annotations

import argparse
import json
import sys
import threading
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from contract.error_sources import in_a_line
from contract.errors import WireError
from contract.feature_set import FeatureSet
from contract.locate import Locator
from contract.spot import person_text
from contract.topics import ANY_VEHICLE, STATUS
from contract.track import TrackReport, Unseen
from contract.track_age import as_of
from contract.vehicle_status import VehicleStatus
from contract.wire.message import TRACK_REPORTS, read_status
from ground.commands import ANSWERED
from ground.commands.sources import add_source_arguments, opened
from ground.commands.values import positive, whole
from ground.commands.warnings import Warnings
from ground.formats.documents import one_line
from ground.formats.mark import Mark
from ground.freshness import MAX_AGE_S, is_of_now, span, stamped_elsewhen
from ground.last_received import LastReceived
from ground.link_options import endpoint_of, tls_of
from ground.received_tracks import SILENT_S, ReceivedTracks
from ground.recording import Recording
from ground.report_view import subscriptions
from ground.spots.found_thing import FoundThing
from ground.spots.received import ReceivedSpots

EXAMPLES = """\
examples:
  pc-ground watch                                     the aircraft on this machine, once a second
  pc-ground watch --connect tcp/10.0.0.7:7447 --json | jq .ce90_m
  pc-ground watch --from SESSION.mcap                 how a recording ended
"""
RATE_SPAN_S = 5.0
SPOTS_SPAN_S = 30.0  # before the newest: hot spots that were seen since then
_COLUMNS = ("vehicle", "state", "age", "rate", "position", "tracks", "CE90", "reason")
_WIDTHS = (12, 15, 8, 7, 24, 6, 8, 0)


@dataclass(frozen=True)
class Row:
    """One aircraft at one moment; None where it is not known. CE90 is at the picture's centre."""

    vehicle: str
    state: str
    reason: str
    age_s: float | None
    rate_hz: float | None
    lat_deg: float | None
    lon_deg: float | None
    height_amsl_m: float | None
    tracks: int | None
    ce90_m: float | None
    frame: int | None
    cpu_c: float | None
    radius: str = ""  # what the ellipse is mostly from, and what would make it smaller; empty: not known
    look: str = ""  # who had its camera look where last
    heat: str = ""  # the state of a second camera, for hot spots, that is not well
    fix: int | None = None  # MAVLink's GPS_FIX_TYPE; this and the next four are as the aircraft reports them now
    satellites: int | None = None
    battery_percent: int | None = None
    battery_v: float | None = None
    mode: str = ""
    aircraft: str = ""  # the same in words
    person_found: float | None = None  # share of the ground in view on which the search for heat finds a person

    def to_json(self) -> str:
        """One line."""
        digits = {"lat_deg": 7, "lon_deg": 7}
        return json.dumps({k: round(v, digits.get(k, 3)) if isinstance(v, float) else v for k, v in vars(self).items()})

    def cells(self) -> tuple[str, ...]:
        """Return the columns of its line in the table."""
        looked = f"camera: {self.look}" if self.look else ""
        searched = "" if self.person_found is None else person_text(self.person_found)
        return (
            one_line(self.vehicle), one_line(self.state), "-" if self.age_s is None else span(self.age_s),
            "-" if self.rate_hz is None else f"{self.rate_hz:.1f}/s",
            "-" if self.lat_deg is None else f"{self.lat_deg:.5f} {self.lon_deg:.5f}",
            "-" if self.tracks is None else str(self.tracks), "-" if self.ce90_m is None else f"{self.ce90_m:.1f} m",
            one_line("; ".join(text for text in (self.reason, self.aircraft, self.radius, searched, looked) if text)),
        )  # fmt: skip


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `watch`."""
    add_source_arguments(parser)
    parser.add_argument("--json", action="store_true", help="a JSON object a line instead of a table")
    parser.add_argument("--period", metavar="S", type=positive, default=1.0, help="between two tables (default 1)")
    parser.add_argument("--count", metavar="N", type=lambda t: whole(t, "count"), help="end after so many tables")


def run(args: argparse.Namespace) -> int:
    """Until interrupted. Raises PointclickError."""
    if args.recording is not None:
        recording = opened(args.recording)
        names = [args.vehicle] if args.vehicle in recording.vehicles else recording.vehicles
        rows = [_row(name, recording.newest_picture(name), None, None, None) for name in names]
        followed = [report for name in names for report in _last_followed(recording, name)]
        found = ReceivedSpots()
        found.read(recording, names)
        _show(rows, followed, found, args.json, False)
        return ANSWERED
    from ground.client import SetCache  # noqa: PLC0415  zenoh is loaded only where there is a link

    tls = tls_of(args)
    vehicle = args.vehicle or ANY_VEHICLE
    received, tracks, found = _Received(), ReceivedTracks(), ReceivedSpots()
    filled = {STATUS.key(vehicle): received.status, **subscriptions(vehicle, tracks, found)}
    cache = SetCache(endpoint_of(args, tls), vehicle, tls=tls, subscriptions=filled, on_set=received.set)
    is_screen = sys.stdout.isatty() and not args.json
    warnings = Warnings()
    with cache:
        shown = 0
        while args.count is None or shown < args.count:
            time.sleep(args.period)
            rows, link_amiss = [], cache.link_error or cache.unreached
            for name in sorted({*cache.vehicles, *received.states}):
                reply = cache.reply(name)
                newest = None
                if reply is not None and isinstance(reply.answer, FeatureSet):
                    newest = reply.answer if reply.later is None else cache.by_frame(name, reply.later.frame)
                state = received.states.get(name)
                if state is not None and not cache.is_of_now(name, state.session):
                    state = None  # it came before the sets of a later session
                age_s, rate_hz, doubt = cache.age_s(name), received.rate_hz(name), cache.doubt(name)
                if age_s is None and state is not None and (when := stamped_elsewhen(state.unix_s, time.time())):
                    doubt = f"the status is {when}: it is old, or a clock is wrong"
                amiss = "; ".join(text for text in (doubt, link_amiss) if text)
                silent_s = received.silent_s(name)
                silence = _Silence(received.set_silent_s(name), silent_s)
                row = _row(name, newest, state, age_s, rate_hz, amiss, cache.is_certain(name), silence)
                rows.append(_reporting(row, newest, state, silent_s))
            if not rows and not args.json:
                print(f"nothing received yet{f': {link_amiss}' if link_amiss else ''}", file=sys.stderr)
            _show(rows, tracks.newest(cache.stamped_ago_s), found, args.json, is_screen)
            warnings.show(cache.dropped.lines(), always=is_screen)
            shown += 1
    return ANSWERED


@dataclass(eq=False)
class _OfVehicle:
    """The last status of one vehicle, and when its sets came."""

    state: VehicleStatus | None = None
    state_s: float = 0.0  # when it came
    times: deque[float] = field(default_factory=lambda: deque(maxlen=1000))


class _Received:
    """Status and rates of the vehicles; filled from zenoh's thread."""

    def __init__(self) -> None:
        self._vehicles = LastReceived(lambda _: _OfVehicle())
        self._lock = threading.Lock()

    @property
    def states(self) -> dict[str, VehicleStatus]:
        with self._lock:
            held = {name: self._vehicles.get(name) for name in self._vehicles}
        return {name: one.state for name, one in held.items() if one is not None and one.state is not None}

    def status(self, key: str, payload: bytes) -> None:
        try:
            vehicle, status = read_status(key, payload)
        except (ValueError, WireError):
            return
        with self._lock:
            held = self._vehicles.of(vehicle)
            held.state, held.state_s = status, time.monotonic()

    def set(self, feature_set: FeatureSet, size: int) -> None:
        with self._lock:
            self._vehicles.of(feature_set.vehicle).times.append(time.monotonic())

    def silent_s(self, vehicle: str) -> float:
        """Seconds since its last status; infinite before the first."""
        with self._lock:
            held = self._vehicles.get(vehicle)
        return float("inf") if held is None or held.state is None else time.monotonic() - held.state_s

    def set_silent_s(self, vehicle: str) -> float:
        """Seconds since its last set came, however old; infinite before the first."""
        with self._lock:
            held = self._vehicles.get(vehicle)
        return float("inf") if held is None or not held.times else time.monotonic() - held.times[-1]

    def rate_hz(self, vehicle: str) -> float | None:
        with self._lock:
            held = self._vehicles.get(vehicle)
            times = [] if held is None else list(held.times)
        since = time.monotonic() - RATE_SPAN_S
        return sum(t >= since for t in times) / RATE_SPAN_S if times else None


@dataclass(frozen=True)
class _Silence:
    """Seconds since a set of a vehicle came, and since a status did."""

    set_s: float = float("inf")
    status_s: float = float("inf")

    def of_old(self, age_s: float) -> tuple[str, str]:
        """The state of a vehicle whose newest picture is so old, and what there is of it, in words."""
        silent_s = min(self.set_s, self.status_s)
        if silent_s > MAX_AGE_S:
            return "no link", f"nothing received for {span(min(silent_s, age_s))}"
        if self.set_s <= MAX_AGE_S:
            return "late", f"its sets are of pictures {span(age_s)} old"
        return "no sets", f"its status comes, and no set for {span(age_s)}"


def _row(
    vehicle: str,
    newest: FeatureSet | None,
    status: VehicleStatus | None,
    age_s: float | None,
    rate_hz: float | None,
    doubt: str = "",
    is_certain: bool = True,
    silence: _Silence = _Silence(),
) -> Row:
    state, reason = ("", "") if status is None else (status.state, status.reason)
    ce90 = None
    if newest is not None:
        c = newest.camera
        centre = ((c.width_px - 1) / 2.0, (c.height_px - 1) / 2.0)
        mark = Mark.of_answer(Locator(newest).locate(centre))
        ce90 = mark.ce90_m
        state = state or newest.status.value
        reason = reason or ("" if mark.is_placed else mark.reason)
    if age_s is not None and age_s > MAX_AGE_S:
        word, words = silence.of_old(age_s) if is_certain else ("old?", "")
        last = "picture" if status is None else "it reports" if silence.status_s <= MAX_AGE_S else "last"
        report = f"{state}: {reason}" if reason and word != "no link" else state
        parts = [words, doubt, f"{last}: {report}" if state else ""]
        state = word
    else:
        parts = [reason, doubt, "" if status is None else status.amiss]
    reason = "; ".join(text for text in parts if text)
    is_placed = newest is not None and newest.is_ok
    height = None
    if newest is not None and is_placed:
        known = newest.camera_height_m
        height = known if newest.height_datum.value == "amsl" else known - newest.undulation_m
        height = None if height != height else height  # noqa: PLR0124  not a number: the undulation is not known
    return Row(
        vehicle, state or "unknown", reason, age_s, rate_hz,
        newest.camera_lat_deg if newest is not None and is_placed else None,
        newest.camera_lon_deg if newest is not None and is_placed else None, height,
        status.tracks if status is not None else len(newest) if newest is not None else None, ce90,
        None if newest is None else newest.frame, None if status is None else status.cpu_c,
        "" if status is None or not is_placed else in_a_line(status.fractions),
        "" if status is None else status.look, "" if status is None else status.heat,
    )  # fmt: skip


def _reporting(row: Row, newest: FeatureSet | None, status: VehicleStatus | None, silent_s: float) -> Row:
    """Return a row with what its aircraft reports of receiver, battery and mode, where that is of now."""
    if status is None or not is_of_now(status, newest, silent_s):
        return row
    battery, mode = status.battery_words, status.mode
    words = (status.gps_words, battery and f"battery {battery}", mode and f"mode {mode}")
    reported = {name: getattr(status, name) for name in ("fix", "satellites", "battery_percent", "battery_v", "mode")}
    return replace(row, aircraft="; ".join(text for text in words if text), **reported)


def _last_followed(recording: Recording, vehicle: str) -> list[TrackReport]:
    """The last report of every thing that was followed when a recording ended, as of its end, by number."""
    newest, reports = recording.newest_picture(vehicle), recording.reports(TRACK_REPORTS, [vehicle])
    end_ns = max(0 if newest is None else newest.capture_unix_ns, *(r.capture_unix_ns for r in reports), 0)
    held = {r.number: (r, (end_ns - r.capture_unix_ns) / 1e9) for r in reports}
    recent = [held[number] for number in sorted(held) if held[number][1] <= SILENT_S]
    return [as_of(report, age_s, age_s, Unseen.NO_REPORT) for report, age_s in recent]


def _recent(spots: ReceivedSpots) -> list[FoundThing]:
    """The things that hot spots are of that more than one picture shows, seen recently."""
    return [thing for thing in spots.recent(SPOTS_SPAN_S) if thing.is_sure]


def _show(
    rows: list[Row], followed: Sequence[TrackReport], found: ReceivedSpots, as_json: bool, is_screen: bool
) -> None:
    rows = [replace(row, person_found=None if row.heat else found.person_found(row.vehicle)) for row in rows]
    things: list[TrackReport | FoundThing] = [*followed, *_recent(found)]
    if as_json:
        for line in [*(row.to_json() for row in rows), *(thing.to_json() for thing in things)]:
            print(line)
    else:
        if is_screen:
            print("\033[H\033[2J", end="")
        print(_line(_COLUMNS))
        for row in rows:
            print(_line(row.cells()))
        for thing in things:
            of = f"{thing.vehicle} " if isinstance(thing, TrackReport) else ""
            print(f"  {one_line(of + thing.to_text())}")
    sys.stdout.flush()


def _line(cells: tuple[str, ...]) -> str:
    return " ".join(f"{cell:<{width}}" for cell, width in zip(cells, _WIDTHS, strict=True)).rstrip()
