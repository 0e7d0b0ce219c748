"""Sources of a command's pictures: a live aircraft or a recording, asked in the same way."""

from __future__ import annotations

import argparse
import math
import sys
import time
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, Protocol

from contract.answer import EXPLANATIONS, Answer, Fix, Refusal
from contract.errors import InputError, LinkError, WireError
from contract.feature_set import FeatureSet, Status
from contract.locate import Locator
from contract.recorded_pictures import PictureIndex
from contract.topics import ANY_VEHICLE, DEFAULT_ENDPOINT, TIME_TOLERANCE_S
from contract.wire.click_code import cut_name
from ground.commands.warnings import Warnings
from ground.dropped_messages import DroppedMessages
from ground.freshness import Later, Reply, aged, too_old
from ground.link_options import UsageError, add_tls_arguments, endpoint_of, tls_of
from ground.onboard_program import pc_onboard
from ground.recording import Recording
from ground.unmeasured import MOST_CHARACTERS, NOT_TRIED

if TYPE_CHECKING:
    from ground.recording_server import RecordingServer

NO_NAMES = "--file needs --from SESSION.mcap: picture names do not cross the link; use --frame or --time"


def add_source_arguments(parser: argparse.ArgumentParser, vehicle: str = "needed where several answer") -> None:
    """`--vehicle`, with its help, `--connect`, `--from` and the link's."""
    parser.add_argument("--vehicle", metavar="ID", help=vehicle)
    source = parser.add_mutually_exclusive_group()
    source.add_argument(
        "--connect",
        metavar="ENDPOINT",
        help=f"zenoh endpoint (default {DEFAULT_ENDPOINT}), or mavlink:udpin:HOST:PORT (docs/autopilot-radio.md)",
    )
    source.add_argument(
        "--from", dest="recording", metavar="SESSION.mcap", type=Path, help="a recorded session, or a folder with one"
    )
    add_tls_arguments(parser)


def add_interpolated_argument(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--interpolated",
        action="store_true",
        help="do not have a clicked pixel measured by itself, which takes up to 0.5 s",
    )


class Asked(NamedTuple):
    """A picture by its number, its file or a time, else the newest; `pixel`: of it, to be measured by itself."""

    frame: int | None = None
    file: str | None = None
    unix_s: float | None = None
    pixel: tuple[float, float] | None = None


class RecordedSource:
    """Pictures of a recording. Raises PointclickError for one that cannot be read, or for no such vehicle.

    A pixel is measured in the pictures that the recording holds, by a program that is started for the first one.
    """

    is_recorded = True

    def __init__(self, path: Path, vehicle: str | None) -> None:
        self._path = path
        self.recording = opened(path)
        self.vehicle = vehicle_of(vehicle, self.recording.vehicles)
        self._server: RecordingServer | None = None
        self.untried = ""  # why the last pixel was not looked at

    @cached_property
    def measures(self) -> bool:
        """True if it holds pictures to measure a pixel in, and there is a program that does."""
        if not PictureIndex(self._path).has_any(self.vehicle):
            return False
        try:
            pc_onboard()
        except InputError as error:
            print(f"pc-ground: warning: clicks are answered between measured points: {error}", file=sys.stderr)
            return False
        return True

    def close(self) -> None:
        if self._server is not None:
            self._server.close()

    def reply(self, asked: Asked) -> Reply:
        """The set that is asked for, with its age."""
        recording, vehicle, frame, unix_s = self.recording, self.vehicle, asked.frame, asked.unix_s
        later = None
        if asked.file is not None:
            found_frame = self.frame_of(asked.file)
            if isinstance(found_frame, Refusal):
                return Reply(found_frame)
            frame = found_frame
        # A refused set has no features and so is false: compare with None.
        if frame is not None:
            found = recording.by_frame(vehicle, frame)
            if found is None:
                return Reply(self._unknown_frame(frame))
        elif unix_s is not None:
            found = recording.by_time(vehicle, unix_s)
            if found is None:
                detail = f"no picture was taken within {TIME_TOLERANCE_S} s of {unix_s!r}"
                return Reply(Refusal(Status.UNKNOWN_FRAME, vehicle=vehicle, detail=detail))
        else:
            found, latest = recording.newest(vehicle), recording.newest_picture(vehicle)
            if found is None or latest is None:
                return Reply(Refusal(Status.STARTING, vehicle=vehicle))
            if latest.frame != found.frame:
                later = Later(latest.status, latest.frame, recording.age_s(latest))
        age_s = recording.age_s(found)
        if asked.pixel is not None and found.is_ok and found.camera.contains(asked.pixel):
            found = self._measured(found, asked.pixel)
        return Reply(found, age_s, later)

    def _measured(self, found: FeatureSet, uv_px: tuple[float, float]) -> FeatureSet:
        from ground.recording_server import RecordingServer  # noqa: PLC0415  zenoh is loaded only where there is a link

        if self._server is None:
            self._server = RecordingServer(self._path)
        try:
            return self._server.measured(found, uv_px)
        except (LinkError, WireError) as error:
            self.untried = str(error)[:MOST_CHARACTERS]
            return found

    def frame_of(self, picture: int | str) -> int | Refusal:
        """The number of a picture named by its number or by its file, with folders or without."""
        if isinstance(picture, int):
            return picture
        names = dict.fromkeys((picture, Path(picture).name))
        found = next((f for n in names if (f := self.recording.frame_of_file(self.vehicle, n)) is not None), None)
        if found is None:
            return Refusal(Status.UNKNOWN_FRAME, vehicle=self.vehicle, detail=f"no picture is named {picture!r}")
        return found

    def _unknown_frame(self, frame: int) -> Refusal:
        frames = self.recording.frames(self.vehicle)
        held = f"the recording holds {len(frames)} sets of frames {frames[0]} to {frames[-1]}"
        detail = f"no set of frame {frame}; {held}"
        return Refusal(Status.UNKNOWN_FRAME, frame, vehicle=self.vehicle, detail=detail)


class LinkSource:
    """Pictures of a live aircraft: each is asked for when it is wanted. Raises PointclickError."""

    is_recorded = False
    measures = True
    untried = NOT_TRIED

    def __init__(self, args: argparse.Namespace) -> None:
        self._tls = tls_of(args)
        self._endpoint = endpoint_of(args, self._tls)
        self._vehicle = args.vehicle

    def close(self) -> None:
        """Nothing stays open between questions."""

    def reply(self, asked: Asked) -> Reply:
        """The set that is asked for, with its age."""
        if asked.file is not None:
            raise UsageError(NO_NAMES)
        from ground.client import inquire  # noqa: PLC0415  zenoh is loaded only where there is a link

        dropped = DroppedMessages()
        try:
            replies = inquire(
                self._endpoint,
                self._vehicle or ANY_VEHICLE,
                frame=asked.frame,
                unix_s=asked.unix_s,
                pixel=asked.pixel,
                tls=self._tls,
                is_sole=self._vehicle is None,
                dropped=dropped,
            )
        except ValueError as error:
            raise UsageError(str(error)) from error
        Warnings().show(dropped.lines())
        reply = replies[vehicle_of(self._vehicle, sorted(replies))]
        if isinstance(reply.answer, Refusal):
            return replace(reply, answer=replace(reply.answer, frame=asked.frame))
        return reply


Source = RecordedSource | LinkSource


def source_of(args: argparse.Namespace) -> Source:
    """The source that `--from` or `--connect` names, to be closed. Raises PointclickError."""
    return RecordedSource(args.recording, args.vehicle) if args.recording else LinkSource(args)


class Clicker:
    """Answers clicks on a source's pictures; a set that is clicked again is not solved again.

    `is_measured`: each clicked pixel is measured by itself, where the source has who does.
    """

    def __init__(self, source: Source, max_age_s: float, *, is_measured: bool = False) -> None:
        self._source = source
        self._is_measured = is_measured and source.measures
        self._max_age_s = max_age_s
        self._solved = lru_cache(maxsize=64)(_solved)

    def click(
        self,
        u_px: float,
        v_px: float,
        *,
        frame: int | None = None,
        file: str | None = None,
        unix_s: float | None = None,
    ) -> tuple[Answer, Locator | None]:
        """The answer, and what gave it, if a set did."""
        answer, locator = self._answer(u_px, v_px, frame, file, unix_s)
        return replace(answer, is_recorded=self._source.is_recorded), locator

    def _answer(
        self, u_px: float, v_px: float, frame: int | None, file: str | None, unix_s: float | None
    ) -> tuple[Answer, Locator | None]:
        reply = self._source.reply(Asked(frame, file, unix_s, (u_px, v_px) if self._is_measured else None))
        found = reply.fresh(self._max_age_s)
        if isinstance(found, Refusal):
            return found, None
        key = found.vehicle, found.session, found.frame, found.revision, found.capture_unix_ns, found.clicked
        locator = self._solved(_Known(key, found))
        answer = aged(locator.locate((u_px, v_px)), reply.age_s)
        if self._is_measured and found.clicked is None and isinstance(answer, Fix):
            answer = replace(answer, unmeasured=self._source.untried)
        return answer, locator


class AnsweringLink(Protocol):
    """A link over which the aircraft answers clicks itself."""

    def ask(self, u_px: float, v_px: float, *, frame: int | None = None, capture_unix_ns: int | None = None) -> Answer:
        """The answer to a click, its age that of when the click was made. Raises PointclickError."""


class AskedClicker:
    """Has clicks answered on board, through the autopilot's radio. Raises PointclickError."""

    def __init__(self, link: AnsweringLink, vehicle: str | None, max_age_s: float) -> None:
        self._link, self._vehicle, self._max_age_s = link, vehicle, max_age_s

    def click(
        self,
        u_px: float,
        v_px: float,
        *,
        frame: int | None = None,
        file: str | None = None,
        unix_s: float | None = None,
    ) -> tuple[Answer, None]:
        """Ask the aircraft for the answer to a click, as `Clicker.click`, but without the locator that gave it."""
        if file is not None:
            raise UsageError(NO_NAMES)
        began_s = time.monotonic()
        answer = self._link.ask(
            u_px, v_px, frame=frame, capture_unix_ns=None if unix_s is None else round(unix_s * 1e9)
        )
        if self._vehicle is not None:  # of a long name an answer has the beginning
            vehicle_of(cut_name(self._vehicle), [answer.vehicle or ""])
            answer = replace(answer, vehicle=self._vehicle)
        # What counts is how old the picture was when it was clicked, and not how long a thin radio took to answer.
        age = "" if math.isinf(self._max_age_s) else too_old(answer.age_s, self._max_age_s)
        now_age_s = None if answer.age_s is None else answer.age_s + time.monotonic() - began_s
        if isinstance(answer, Refusal):
            reported = f"{EXPLANATIONS[answer.status]}; the aircraft reports: {answer.detail}" if answer.detail else ""
            return replace(answer, age_s=now_age_s, detail=reported), None
        if not age:
            return replace(answer, age_s=now_age_s), None
        detail = f"the newest picture that can be clicked is {age}"
        return Refusal(Status.STALE, answer.frame, answer.capture_unix_ns, answer.vehicle, detail, now_age_s), None


@dataclass(frozen=True)
class _Known:
    """A set, known by the values that identify it."""

    key: tuple[object, ...]
    feature_set: FeatureSet = field(compare=False)


def _solved(known: _Known) -> Locator:
    return Locator(known.feature_set)


def opened(path: Path) -> Recording:
    """A recording; damaged parts are reported on standard error, and the rest is there."""
    recording = Recording(path)
    for line in recording.damage:
        print(f"pc-ground: warning: {line}", file=sys.stderr)
    return recording


def vehicles_of(wanted: str | None, vehicles: list[str]) -> list[str]:
    """The one that is wanted, else all. Raises UsageError."""
    return vehicles if wanted is None else [vehicle_of(wanted, vehicles)]


def vehicle_of(wanted: str | None, vehicles: list[str]) -> str:
    """The one that is meant. Raises UsageError."""
    if wanted is not None:
        if wanted not in vehicles:
            raise UsageError(f"no vehicle {wanted!r}; there is {', '.join(vehicles)}")
        return str(wanted)
    if len(vehicles) > 1:
        raise UsageError(f"several vehicles answer: {', '.join(vehicles)}; choose one with --vehicle")
    return vehicles[0]
