"""`pc-ground click`: one click, a table of them, or line after line, from a live aircraft or a recording.

Exit status: 0 answered, 3 refused with the reason, 2 wrong usage (a file, an endpoint, an argument). A batch, and
clicks from standard input, end with 0 once every click was processed: refusals are answers, each with its status.
"""

from __future__ import annotations

import argparse
import math
import re
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path
from typing import NamedTuple

from contract.answer import Answer, Refusal
from contract.errors import InputError, PointclickError
from ground.commands import ANSWERED, REFUSED, WRONG_USAGE
from ground.commands.grids import add_grid_arguments, grid_of
from ground.commands.picture_rows import read_picture_rows
from ground.commands.sources import (
    AskedClicker,
    Clicker,
    RecordedSource,
    add_interpolated_argument,
    add_source_arguments,
    source_of,
)
from ground.commands.values import age, finite, frame_number
from ground.formats.coordinates import Grid
from ground.formats.documents import FORMATS, Format
from ground.formats.mark import Mark
from ground.formats.table import header
from ground.freshness import MAX_AGE_S
from ground.link_options import UsageError, tls_of
from ground.mavlink_endpoint import SCHEME, MavlinkEndpoint
from ground.mavlink_link import MavlinkLink

EXAMPLES = """\
examples:
  pc-ground click 480 120                                    the newest picture of the aircraft on this machine
  pc-ground click 480 120 --connect tcp/10.0.0.7:7447        over a link
  pc-ground click 480 120 --connect mavlink:udpin:0.0.0.0:14551  by the autopilot's radio (docs/autopilot-radio.md)
  pc-ground click 480 120 --frame 14 --from SESSION.mcap     a picture of a recording
  pc-ground click 480 120 --from SESSION.mcap --format mgrs  as an MGRS square (needs pointclick[geo])
  pc-ground click --from SESSION.mcap --format kml < clicks.txt > clicks.kml    lines of U V, or FRAME U V
"""

_WITH_COMMAS = re.compile(r"[^\s,]+((,[^\s,]+)*|(\s*,\s+[^\s,]+)*)")  # between all numbers, in one way

AnyClicker = Clicker | AskedClicker


class Click(NamedTuple):
    """One row of a batch, or one line; the picture by its number in capture order, by its file, or the newest."""

    picture: int | str | None
    u_px: float
    v_px: float


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `click`."""
    parser.add_argument(
        "u", metavar="U", nargs="?", type=finite, help="pixel column; 0 is the leftmost pixel's centre; "
        "without U and V lines of `U V` or `FRAME U V` are read from standard input",
    )  # fmt: skip
    parser.add_argument("v", metavar="V", nargs="?", type=finite, help="pixel row; 0 is the topmost pixel's centre")
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--frame", metavar="N", type=frame_number, help="picture N in capture order, from 0")
    which.add_argument("--file", metavar="NAME", help="the picture with this file name (from a recording)")
    which.add_argument("--time", metavar="UNIX_S", type=finite, help="the picture captured nearest, within 0.5 s")
    which.add_argument(
        "--batch", metavar="CLICKS.csv", type=Path, help="columns frame,u,v or file,u,v: one JSON line a click"
    )
    add_source_arguments(parser)
    parser.add_argument(
        "--max-age",
        metavar="S",
        type=age,
        help=f"refuse the newest picture if it is older; inf: never (default {MAX_AGE_S:g}, of a recording inf)",
    )
    add_interpolated_argument(parser)
    parser.add_argument("--format", choices=tuple(FORMATS), help="default: text, a batch always json")
    parser.add_argument("--json", dest="format", action="store_const", const="json", help="the same as --format json")
    add_grid_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Do it; returns the exit status. Raises PointclickError for wrong usage."""
    if args.batch is not None:
        return _run_batch(args)
    if (args.u is None) != (args.v is None):
        raise UsageError("click needs U and V, or --batch CLICKS.csv")
    is_newest = args.frame is None and args.file is None and args.time is None
    if args.max_age is not None and not is_newest:
        raise UsageError("--max-age is about the newest picture: leave it out with --frame, --file or --time")
    if args.u is None:
        return _run_lines(args)
    grid = grid_of(args)
    with _clickers(args) as (clicker, _):
        answer, _ = clicker.click(args.u, args.v, frame=args.frame, file=args.file, unix_s=args.time)
    mark = Mark.of_answer(answer, (args.u, args.v))
    chosen = FORMATS[args.format or "text"]
    is_refused = isinstance(answer, Refusal)
    if is_refused and chosen.name not in ("json", "geojson", "csv"):
        print(answer.to_text(), file=sys.stderr)
    else:
        sys.stdout.write(chosen.write([mark], grid))
    return REFUSED if is_refused else ANSWERED


@contextmanager
def _clickers(args: argparse.Namespace) -> Iterator[tuple[AnyClicker, AnyClicker]]:
    """Yield one clicker for the picture that the options mean and one for clicks that name their own.

    --max-age is about the newest picture. Raises PointclickError.
    """
    is_newest = args.frame is None and args.file is None and args.time is None
    usual_s = MAX_AGE_S if is_newest and not args.recording else math.inf
    max_age_s = usual_s if args.max_age is None else args.max_age
    if args.connect and args.connect.startswith(SCHEME):
        if tls_of(args) is not None:
            raise UsageError("--credentials are for zenoh: leave them out with mavlink:...")
        if args.interpolated:
            raise UsageError(
                "--interpolated is for zenoh: through the radio the aircraft answers with what it measured"
            )
        with MavlinkLink(MavlinkEndpoint.parse(args.connect)) as link:
            yield AskedClicker(link, args.vehicle, max_age_s), AskedClicker(link, args.vehicle, math.inf)
    else:
        with closing(source_of(args)) as source:
            clicker = partial(Clicker, source, is_measured=not args.interpolated)
            yield clicker(max_age_s), clicker(math.inf)


def _run_batch(args: argparse.Namespace) -> int:
    if args.u is not None or not args.recording or args.format not in (None, "json") or args.max_age is not None:
        raise UsageError("--batch goes with --from SESSION.mcap, without U, V and --max-age, and writes JSON")
    clicks = read_clicks(args.batch)
    grid = grid_of(args, of_several=True)
    with closing(RecordedSource(args.recording, args.vehicle)) as source:
        clicker = Clicker(source, math.inf, is_measured=not args.interpolated)
        for click in clicks:
            mark = Mark.of_answer(_answered(clicker, click), (click.u_px, click.v_px))
            sys.stdout.write(FORMATS["json"].write([mark], grid))
    return ANSWERED


def _answered(clicker: AnyClicker, click: Click) -> Answer:
    frame = click.picture if isinstance(click.picture, int) else None
    file = click.picture if isinstance(click.picture, str) else None
    return clicker.click(click.u_px, click.v_px, frame=frame, file=file)[0]


def _run_lines(args: argparse.Namespace) -> int:
    """A click a line of standard input; each is answered at once where the format is lines."""
    if sys.stdin is None or sys.stdin.isatty():
        raise UsageError("click needs U and V, or --batch CLICKS.csv, or lines of U V or FRAME U V on standard input")
    chosen, grid = FORMATS[args.format or "text"], grid_of(args, of_several=True)
    with _clickers(args) as (clicker, by_frame):
        return _answer_lines(args, chosen, grid, clicker, by_frame)


def _answer_lines(
    args: argparse.Namespace, chosen: Format, grid: Grid | None, clicker: AnyClicker, by_frame: AnyClicker
) -> int:
    marks: list[Mark] = []
    status = ANSWERED
    if chosen.name == "csv":
        sys.stdout.write(header(grid))
    count = 0
    for number, line in enumerate(sys.stdin, 1):
        if not line.split("#")[0].strip():
            continue
        count += 1
        try:
            click = line_click(line)
            if click.picture is not None and (args.frame is not None or args.file is not None or args.time is not None):
                raise InputError("a line of FRAME U V goes without --frame, --file and --time")
            if click.picture is not None:
                answer = _answered(by_frame, click)
            else:
                answer = clicker.click(click.u_px, click.v_px, frame=args.frame, file=args.file, unix_s=args.time)[0]
            mark = Mark.of_answer(answer, (click.u_px, click.v_px), None if chosen.line is not None else len(marks) + 1)
            marks.append(mark)
            _print_answer(chosen, mark, grid)
        except PointclickError as error:
            print(f"pc-ground: error: line {number}: {error}", file=sys.stderr)
            status = WRONG_USAGE
    if not count:
        raise UsageError("click needs U and V, or --batch CLICKS.csv, or lines of U V or FRAME U V on standard input")
    if chosen.line is None and chosen.name != "csv":
        sys.stdout.write(chosen.write(marks, grid))
    return status


def _print_answer(chosen: Format, mark: Mark, grid: Grid | None) -> None:
    """One answer of a stream, where its format does not wait for the last."""
    if not mark.is_placed and chosen.name not in ("json", "geojson", "csv"):
        assert mark.answer is not None
        print(f"{mark.title}: {mark.answer.to_text()}", file=sys.stderr)
    elif chosen.name == "csv":
        sys.stdout.write(chosen.write([mark], grid).split("\r\n", 1)[1])
    elif chosen.line is not None:
        sys.stdout.write(chosen.write([mark], grid))
    sys.stdout.flush()


def line_click(line: str) -> Click:
    """`U V` or `FRAME U V`, by blanks or commas; what follows a # is left out. Raises InputError."""
    text = line.split("#", maxsplit=1)[0].strip()
    if "," in text and not _WITH_COMMAS.fullmatch(text):
        raise InputError(f"{text[:60]!r}: are these commas decimal? write points, or commas between all numbers")
    parts = re.split(r"[\s,]+", text)
    if len(parts) not in (2, 3):
        raise InputError(f"{line.strip()[:60]!r} is not U V or FRAME U V")
    try:
        picture = frame_number(parts[0]) if len(parts) == 3 else None
        return Click(picture, finite(parts[-2]), finite(parts[-1]))
    except argparse.ArgumentTypeError as error:
        raise InputError(str(error)) from error


def read_clicks(path: Path) -> list[Click]:
    """All rows of a batch, checked before the first is answered. Raises InputError with the line's number."""
    return read_picture_rows(
        path,
        ("u", "v"),
        lambda row, picture, _number: Click(picture, finite(row["u"]), finite(row["v"])),
        "a batch needs frame,u,v or file,u,v",
    )
