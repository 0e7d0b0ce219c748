"""`pc-ground click`: one click or a table of them, from a live aircraft or a recording.

Exit status: 0 answered, 3 refused with the reason, 2 wrong usage (a file, an endpoint, an argument). A batch ends
with 0 once every click was processed: its refusals are answers, each with its status.
"""

from __future__ import annotations

import argparse
import csv
import math
import sys
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from contract.errors import InputError, PointclickError
from contract.feature_set import Status
from contract.link_config import CA_FILE, CERTIFICATE_FILE, KEY_FILE, Tls
from contract.topics import ANY_VEHICLE, DEFAULT_ENDPOINT, TIME_TOLERANCE_S
from ground.answer import Answer, Refusal
from ground.freshness import MAX_AGE_S, Later, Reply, aged
from ground.locate import Locator
from ground.recording import Recording

ANSWERED, WRONG_USAGE, REFUSED = 0, 2, 3
_PICTURE = ("frame", "file")  # the column that says which picture: one of them


class UsageError(PointclickError):
    """Arguments that do not go together."""


class Click(NamedTuple):
    """One row of a batch; the picture by its number in capture order, or by its file's name."""

    picture: int | str
    u_px: float
    v_px: float


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `click`."""
    parser.add_argument(
        "u", metavar="U", nargs="?", type=_finite, help="pixel column; 0 is the leftmost pixel's centre"
    )
    parser.add_argument("v", metavar="V", nargs="?", type=_finite, help="pixel row; 0 is the topmost pixel's centre")
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--frame", metavar="N", type=_frame_number, help="picture N in capture order, from 0")
    which.add_argument("--file", metavar="NAME", help="the picture with this file name (from a recording)")
    which.add_argument("--time", metavar="UNIX_S", type=_finite, help="the picture captured nearest, within 0.5 s")
    which.add_argument(
        "--batch", metavar="CLICKS.csv", type=Path, help="columns frame,u,v or file,u,v: one JSON line a click"
    )
    parser.add_argument("--vehicle", metavar="ID", help="needed where several answer")
    source = parser.add_mutually_exclusive_group()
    source.add_argument("--connect", metavar="ENDPOINT", help=f"zenoh endpoint (default {DEFAULT_ENDPOINT})")
    source.add_argument("--from", dest="recording", metavar="SESSION.mcap", type=Path, help="a recorded session")
    add_tls_arguments(parser)
    parser.add_argument(
        "--max-age",
        metavar="S",
        type=_age,
        help=f"refuse the newest picture if it is older; inf: never (default {MAX_AGE_S:g}, of a recording inf)",
    )
    parser.add_argument("--format", choices=("text", "json"), help="default: text, a batch always json")


def add_tls_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of an encrypted link, alike for every command that has one."""
    parser.add_argument(
        "--credentials",
        metavar="DIR",
        type=Path,
        help=f"folder with {CA_FILE}, {CERTIFICATE_FILE} and {KEY_FILE}, from pc-onboard make-credentials",
    )
    for name, meaning in (("ca", "the authority's certificate"), ("certificate", "ours"), ("key", "its private key")):
        parser.add_argument(f"--{name}", metavar="FILE.pem", type=Path, help=f"{meaning}, in place of --credentials")


def tls_of(args: argparse.Namespace) -> Tls | None:
    """The certificates that are to be shown; None for a plain link. Raises PointclickError."""
    if args.credentials is None:
        return Tls.of(args.ca, args.certificate, args.key)
    if args.ca or args.certificate or args.key:
        raise UsageError("--credentials names the folder of all three files: leave --ca, --certificate and --key out")
    return Tls.in_folder(args.credentials)


def run(args: argparse.Namespace) -> int:
    """Do it; returns the exit status. Raises PointclickError for wrong usage."""
    if args.batch is not None:
        return _run_batch(args)
    if args.u is None or args.v is None:
        raise UsageError("click needs U and V, or --batch CLICKS.csv")
    is_newest = args.frame is None and args.file is None and args.time is None
    if args.max_age is not None and not is_newest:
        raise UsageError("--max-age is about the newest picture: leave it out with --frame, --file or --time")
    reply = _from_recording(args) if args.recording else _from_link(args)
    usual_s = MAX_AGE_S if is_newest and not args.recording else math.inf
    found = reply.fresh(usual_s if args.max_age is None else args.max_age)
    answer = found if isinstance(found, Refusal) else aged(Locator(found).locate((args.u, args.v)), reply.age_s)
    is_refused = isinstance(answer, Refusal)
    if args.format == "json":
        print(answer.to_json())
    else:
        print(answer.to_text(), file=sys.stderr if is_refused else sys.stdout)
    return REFUSED if is_refused else ANSWERED


def _run_batch(args: argparse.Namespace) -> int:
    if args.u is not None or not args.recording or args.format == "text" or args.max_age is not None:
        raise UsageError("--batch goes with --from SESSION.mcap, without U, V and --max-age, and writes JSON")
    clicks = read_clicks(args.batch)
    recording = _opened(args.recording)
    vehicle = _vehicle(args, recording.vehicles)

    @lru_cache(maxsize=64)
    def locator(picture: int | str) -> Locator | Refusal:
        frame = _frame_of(recording, vehicle, picture)
        if isinstance(frame, Refusal):
            return frame
        feature_set = recording.by_frame(vehicle, frame)
        return _unknown_frame(recording, vehicle, frame) if feature_set is None else Locator(feature_set)

    for click in clicks:
        known = locator(click.picture)
        answer: Answer
        if isinstance(known, Refusal):
            answer = known
        else:
            answer = aged(known.locate((click.u_px, click.v_px)), recording.age_s(known.feature_set))
        sys.stdout.write(answer.to_json() + "\n")
    return ANSWERED


def read_clicks(path: Path) -> list[Click]:
    """All rows of a batch, checked before the first is answered. Raises InputError with the line's number."""
    clicks: list[Click] = []
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            rows = csv.DictReader(stream, skipinitialspace=True, strict=True)
            header = rows.fieldnames or ()
            which = next((name for name in _PICTURE if name in header), None)
            missing = [*([] if which else ["frame or file"]), *(name for name in ("u", "v") if name not in header)]
            if which is None or missing:
                raise InputError(f"{path}, line 1: no column {', '.join(missing)}; a batch needs frame,u,v or file,u,v")
            for row in rows:
                texts = [row[name] or "" for name in (which, "u", "v")]
                try:
                    picture = _frame_number(texts[0]) if which == "frame" else _file_name(texts[0])
                    clicks.append(Click(picture, _finite(texts[1]), _finite(texts[2])))
                except (ValueError, argparse.ArgumentTypeError) as error:
                    raise InputError(f"{path}, line {rows.line_num}: {error}") from error
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from error
    except (csv.Error, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not a CSV file ({error})") from error
    return clicks


def _from_recording(args: argparse.Namespace) -> Reply:
    recording = _opened(args.recording)
    vehicle = _vehicle(args, recording.vehicles)
    frame, later = args.frame, None
    if args.file is not None:
        frame = _frame_of(recording, vehicle, args.file)
        if isinstance(frame, Refusal):
            return Reply(frame)
    # A refused set has no features and so is false: compare with None.
    if frame is not None:
        found = recording.by_frame(vehicle, frame)
        if found is None:
            return Reply(_unknown_frame(recording, vehicle, frame))
    elif args.time is not None:
        found = recording.by_time(vehicle, args.time)
        if found is None:
            detail = f"no picture was taken within {TIME_TOLERANCE_S} s of {args.time!r}"
            return Reply(Refusal(Status.UNKNOWN_FRAME, vehicle=vehicle, detail=detail))
    else:
        found, latest = recording.newest(vehicle), recording.newest_picture(vehicle)
        if found is None or latest is None:
            return Reply(Refusal(Status.STARTING, vehicle=vehicle))
        if latest.frame != found.frame:
            later = Later(latest.status, latest.frame, recording.age_s(latest))
    return Reply(found, recording.age_s(found), later)


def _opened(path: Path) -> Recording:
    """A recording; what of it is damaged is said on standard error, and the rest is there."""
    recording = Recording(path)
    for line in recording.damage:
        print(f"pc-ground: warning: {line}", file=sys.stderr)
    return recording


def _frame_of(recording: Recording, vehicle: str, picture: int | str) -> int | Refusal:
    """The number of a picture named by its number or by its file, with folders or without."""
    if isinstance(picture, int):
        return picture
    names = dict.fromkeys((picture, Path(picture).name))
    found = next((f for n in names if (f := recording.frame_of_file(vehicle, n)) is not None), None)
    if found is None:
        return Refusal(Status.UNKNOWN_FRAME, vehicle=vehicle, detail=f"no picture is named {picture!r}")
    return found


def _unknown_frame(recording: Recording, vehicle: str, frame: int) -> Refusal:
    frames = recording.frames(vehicle)
    detail = f"no set of frame {frame}; the recording holds {len(frames)} sets of frames {frames[0]} to {frames[-1]}"
    return Refusal(Status.UNKNOWN_FRAME, frame, vehicle=vehicle, detail=detail)


def _from_link(args: argparse.Namespace) -> Reply:
    if args.file is not None:
        raise UsageError("--file needs --from SESSION.mcap: picture names do not cross the link; use --frame or --time")
    from ground.client import inquire  # noqa: PLC0415  zenoh is loaded only where there is a link

    tls = tls_of(args)
    endpoint = args.connect or (DEFAULT_ENDPOINT if tls is None else DEFAULT_ENDPOINT.replace("tcp/", "tls/", 1))
    try:
        replies = inquire(endpoint, args.vehicle or ANY_VEHICLE, frame=args.frame, unix_s=args.time, tls=tls)
    except ValueError as error:
        raise UsageError(str(error)) from error
    reply = replies[_vehicle(args, sorted(replies))]
    if isinstance(reply.answer, Refusal):
        return replace(reply, answer=replace(reply.answer, frame=args.frame))
    return reply


def _vehicle(args: argparse.Namespace, vehicles: list[str]) -> str:
    """The one that is meant."""
    if args.vehicle is not None:
        if args.vehicle not in vehicles:
            raise UsageError(f"no vehicle {args.vehicle!r}; there is {', '.join(vehicles)}")
        return str(args.vehicle)
    if len(vehicles) > 1:
        raise UsageError(f"several vehicles answer: {', '.join(vehicles)}; choose one with --vehicle")
    return vehicles[0]


def _finite(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text.strip()!r} is not a finite number")
    return value


def _age(text: str) -> float:
    value = math.inf if text.strip() == "inf" else _finite(text)
    if value < 0.0:
        raise argparse.ArgumentTypeError(f"{text.strip()!r} is not an age in seconds")
    return value


def _file_name(text: str) -> str:
    if not text.strip():
        raise argparse.ArgumentTypeError("no file name")
    return text.strip()


def _frame_number(text: str) -> int:
    stripped = text.strip()
    if not (stripped.isascii() and stripped.isdecimal() and len(stripped) <= 10):
        raise argparse.ArgumentTypeError(f"{stripped!r} is not a frame number (0, 1, 2, ...)")
    return int(stripped)
