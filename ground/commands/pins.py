"""`pc-ground pins`: pins in a file, added by clicks or coordinates, listed, tied, passed on."""

from __future__ import annotations

import argparse
import getpass
import math
import shlex
import sys
import time
from contextlib import closing
from pathlib import Path

from contract.answer import Answer, Refusal
from contract.circular_error import CE90_SIGMAS, LE90_SIGMAS
from contract.errors import InputError
from contract.locate import Locator
from contract.whole_file import save
from ground.commands import ANSWERED, REFUSED
from ground.commands.grids import add_grid_arguments, grid_of
from ground.commands.measure import text_of
from ground.commands.sources import Clicker, add_interpolated_argument, add_source_arguments, source_of
from ground.commands.until_ended import until_ended
from ground.commands.values import finite, frame_number, origin, pin_number, positive
from ground.formats import data_package, geojson
from ground.formats.documents import FORMATS, IMPORTED, one_line, read_pins, text_line
from ground.formats.mark import Mark
from ground.formats.rounded import rounded_text
from ground.freshness import MAX_AGE_S
from ground.link_options import UsageError, add_tls_arguments, tls_of
from ground.pins.already_here import without_known
from ground.pins.file import chosen_store
from ground.pins.fusion import Vector
from ground.pins.model import Category, Pin, PinClick, category_of
from ground.pins.places import Places
from ground.pins.store import PinStore
from ground.pins.ties import tie_of

EXAMPLES = """\
examples:
  pc-ground pins add 480 120 --frame 14 --from SESSION.mcap --name tent --category person
  pc-ground pins add 286 140 --frame 19 --from SESSION.mcap --to 1      the same thing in another picture
  pc-ground pins add --at -43.3801,172.4012 --ce90 5 --name gate        a place that is known
  pc-ground pins list
  pc-ground pins list --format mgrs --category person                   (needs pointclick[geo])
  pc-ground pins measure 1 2
  pc-ground pins tie 300 200 --frame 14 --from SESSION.mcap --place -43.3799,172.4020 --sigma 0.5
  pc-ground pins export pins.kml
  pc-ground pins export tent.zip --pin 1                                a TAK data package, with its pictures
  pc-ground pins import pins.geojson
  pc-ground pins undo
  pc-ground pins share --listen tcp/0.0.0.0:7448                        the other servers then connect to this one
  pc-ground pins share --connect tcp/10.0.0.5:7448
"""
PACKAGE = "tak"
MOST_LISTED = 20  # of what a file has and cannot be read
REPORT_S = 5.0  # between two lines of how sharing goes


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `pins`."""
    _add_whose(parser, None, None, _user())
    actions = parser.add_subparsers(dest="action", required=True)

    def action(name: str, meaning: str) -> argparse.ArgumentParser:
        made = actions.add_parser(name, help=meaning, description=f"{meaning[0].upper()}{meaning[1:]}.")
        _add_whose(made, *[argparse.SUPPRESS] * 3)  # what is given before the action's name is kept
        return made

    listing = action("list", "the pins, a line each")
    listing.add_argument("--format", choices=tuple(FORMATS), default="text")
    listing.add_argument("--json", dest="format", action="store_const", const="json", help="the same as --format json")
    exporting = action("export", "the pins as a file for others")
    exporting.add_argument(
        "file", metavar="FILE", nargs="?", type=Path, help="its name gives the format; - or none: here"
    )
    exporting.add_argument(
        "--format", choices=(*FORMATS, PACKAGE), help="default: by the file's name, else geojson; tak: a data package"
    )
    for command in (listing, exporting):
        command.add_argument("--category", choices=[c.value for c in Category], help="only these")
        command.add_argument("--text", default="", help="only those with this in name or note")
        command.add_argument("--pin", metavar="N", type=pin_number, action="append", help="only this one; repeatable")
        add_grid_arguments(command)
    adding = action("add", "a pin where a pixel shows, or at a coordinate")
    _add_pixel(adding)
    adding.add_argument("--at", metavar="LAT,LON", type=origin, help="a coordinate in place of a pixel")
    adding.add_argument("--ce90", metavar="M", type=positive, help="its accuracy (90 %%); without: not known")
    adding.add_argument("--height-amsl", metavar="M", type=finite, help="its height above the sea")
    adding.add_argument("--le90", metavar="M", type=positive, help="that height's accuracy (90 %%)")
    adding.add_argument("--to", metavar="N", type=pin_number, help="not a new pin: one more sighting of pin N")
    adding.add_argument("--name", default="")
    adding.add_argument("--note", default="")
    adding.add_argument("--category", choices=[c.value for c in Category], default=Category.POI.value)
    editing = action("edit", "change a pin's words")
    editing.add_argument("number", metavar="N", type=pin_number)
    for name in ("name", "note"):
        editing.add_argument(f"--{name}")
    editing.add_argument("--category", choices=[c.value for c in Category])
    action("delete", "delete a pin").add_argument("number", metavar="N", type=pin_number)
    measuring = action("measure", "distance, bearing and height difference between two pins")
    measuring.add_argument("one", metavar="N", type=pin_number)
    measuring.add_argument("two", metavar="M", type=pin_number)
    importing = action("import", "pins of a file; those that are here already only if they are newer")
    importing.add_argument("file", metavar="FILE", type=Path)
    importing.add_argument("--format", choices=IMPORTED, help="default: by the file's name")
    tying = action("tie", "a pixel shows a place of known coordinate: correct this flight's pins by it")
    _add_pixel(tying)
    tying.add_argument("--place", metavar="LAT,LON", type=origin, required=True, help="surveyed, WGS84")
    tying.add_argument("--sigma", metavar="M", type=positive, required=True, help="one sigma, along east and north")
    tying.add_argument("--height", metavar="M", type=finite, help="surveyed height, if there is one")
    tying.add_argument("--datum", choices=("amsl", "ellipsoid"), default="amsl", help="of that height")
    tying.add_argument("--sigma-height", metavar="M", type=positive)
    tying.add_argument("--name", default="")
    action("ties", "the ties there are")
    action("clear", "delete all pins (undo brings them back)")
    action("undo", "take back the last change")
    action("redo", "make it again")
    sharing = action("share", "share the pins with other servers, until Ctrl-C; each has them all")
    for name, meaning in (
        ("listen", "zenoh endpoint that others connect to"),
        ("connect", "another server's endpoint"),
    ):
        sharing.add_argument(
            f"--{name}", metavar="ENDPOINT", action="append", default=[], help=f"{meaning}; repeatable"
        )
    sharing.add_argument("--seconds", metavar="S", type=positive, help="end by itself after so long")
    add_tls_arguments(sharing)


def _add_whose(parser: argparse.ArgumentParser, pins: str | None, store: str | None, who: str) -> None:
    """Before the action's name or after it."""
    parser.add_argument(
        "--pins", metavar="FILE", type=Path, default=pins, help="the file of pins (default: the user's own)"
    )
    parser.add_argument("--store", metavar="URL", default=store, help="or a server: postgresql://USER@HOST/DATABASE")
    parser.add_argument("--who", metavar="NAME", default=who, help="who does it (default: the user)")


def _add_pixel(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("u", metavar="U", nargs="?", type=finite, help="pixel column")
    parser.add_argument("v", metavar="V", nargs="?", type=finite, help="pixel row")
    parser.add_argument("--frame", metavar="N", type=frame_number, help="the picture (default the newest)")
    add_interpolated_argument(parser)
    add_source_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Do it; returns the exit status. Raises PointclickError."""
    if args.pins is not None and args.action in _READ_ONLY and not args.pins.is_file():
        raise InputError(f"{args.pins}: there is no such file of pins; pins add and pins import make one")
    with PinStore(chosen_store(args.pins, args.store)) as store:
        return _ACTIONS[args.action](store, args)


def _marks(store: PinStore, args: argparse.Namespace) -> list[Mark]:
    places = Places(store)
    wanted = None if args.category is None else category_of(args.category)
    only = None if args.pin is None else {store.by_number(number).id for number in args.pin}
    pins = store.pins(category=wanted, text=args.text)
    return [Mark.of_pin(pin, places.place(pin)) for pin in pins if only is None or pin.id in only]


def _list(store: PinStore, args: argparse.Namespace) -> int:
    grid = grid_of(args, of_several=True)
    sys.stdout.write(FORMATS[args.format].write(_marks(store, args), grid))
    return ANSWERED


def _export(store: PinStore, args: argparse.Namespace) -> int:
    to_file = args.file is not None and str(args.file) != "-"
    by_name = {f.suffix: f.name for f in FORMATS.values() if f.suffix != ".txt"} | {".zip": PACKAGE}
    name = args.format or (by_name.get(args.file.suffix.lower()) if to_file else "geojson")
    if name is None:
        raise UsageError(
            f"{args.file}: which format? its name may end in {', '.join(sorted(by_name))}; or give --format"
        )
    grid, marks = grid_of(args, of_several=True), _marks(store, args)
    content: str | bytes
    if name == PACKAGE:
        if not to_file:
            raise UsageError("a data package is a file: give its name, pins.zip")
        content = data_package.write(marks, store.crop, time.time_ns())
    else:
        content = geojson.write(marks, grid, store.crop) if name == "geojson" else FORMATS[name].write(marks, grid)
    if isinstance(content, str) and not to_file:
        sys.stdout.write(content)
        return ANSWERED
    save(args.file, content)
    left_out = sum(not mark.is_placed for mark in marks)
    unplaced = f", {left_out} of them without a position" if left_out else ""
    print(f"{len(marks)} pins in {args.file}{unplaced}")
    return ANSWERED


def _add(store: PinStore, args: argparse.Namespace) -> int:
    click = _entered(args) if args.at is not None else _clicked(args)
    if isinstance(click, Refusal):
        print(click.to_text(), file=sys.stderr)
        return REFUSED
    if args.to is not None:
        if args.name or args.note:
            raise UsageError("--to adds a sighting to a pin: change its words with pins edit")
        pin = store.add_click(store.by_number(args.to).id, click, who=args.who)
    else:
        pin = store.add([click], name=args.name, note=args.note, category=category_of(args.category), who=args.who)
    _print_pin(store, pin)
    return ANSWERED


def _entered(args: argparse.Namespace) -> PinClick:
    if args.u is not None:
        raise UsageError("--at is in place of U and V")
    if args.le90 is not None and (args.height_amsl is None or args.ce90 is None):
        raise UsageError("--le90 goes with --height-amsl and --ce90")
    return PinClick.entered(
        *args.at, height_amsl_m=args.height_amsl, sigma_m=None if args.ce90 is None else args.ce90 / CE90_SIGMAS,
        sigma_height_m=None if args.le90 is None else args.le90 / LE90_SIGMAS, who=args.who,
    )  # fmt: skip


def _clicked(args: argparse.Namespace) -> PinClick | Refusal:
    if args.u is None or args.v is None:
        raise UsageError("which place? give U and V of a pixel, or --at LAT,LON")
    if any(value is not None for value in (args.ce90, args.le90, args.height_amsl)):
        raise UsageError("--ce90, --le90 and --height-amsl are of a coordinate, --at: a pixel's answer has its own")
    answer, locator = _answered(args)
    if isinstance(answer, Refusal) or locator is None:
        assert isinstance(answer, Refusal)
        return answer
    return PinClick.of(locator.feature_set, answer, (args.u, args.v), who=args.who, locator=locator)


def _answered(args: argparse.Namespace) -> tuple[Answer, Locator | None]:
    with closing(source_of(args)) as source:
        max_age_s = MAX_AGE_S if args.frame is None and not source.is_recorded else math.inf
        clicker = Clicker(source, max_age_s, is_measured=not args.interpolated)
        return clicker.click(args.u, args.v, frame=args.frame)


def _print_pin(store: PinStore, pin: Pin) -> None:
    print(text_line(Mark.of_pin(pin, Places(store).place(pin))))


def _edit(store: PinStore, args: argparse.Namespace) -> int:
    category = None if args.category is None else category_of(args.category)
    pin = store.edit(store.by_number(args.number).id, who=args.who, name=args.name, note=args.note, category=category)
    _print_pin(store, pin)
    return ANSWERED


def _delete(store: PinStore, args: argparse.Namespace) -> int:
    store.delete(store.by_number(args.number).id, who=args.who)
    print(f"pin {args.number} deleted; pc-ground pins undo brings it back")
    return ANSWERED


def _measure(store: PinStore, args: argparse.Namespace) -> int:
    found = Places(store).between(store.by_number(args.one), store.by_number(args.two))
    if not isinstance(found, Vector):
        print(f"one of the pins has no position: {found.reason}", file=sys.stderr)
        return REFUSED
    print(text_of(found))
    return ANSWERED


def _import(store: PinStore, args: argparse.Namespace) -> int:
    found = read_pins(args.file, args.format, args.who)
    new = without_known(found.pins, store.pins(), Places(store))
    taken = store.bring_in(new, who=args.who, crops=found.crops)
    known = len(found.pins) - taken
    notes = [f"{known} {'was' if known == 1 else 'were'} here already"] if known else []
    things = (
        "1 thing that is no point was" if found.left_out == 1 else f"{found.left_out} things that are no points were"
    )
    notes += [f"{things} left out"] if found.left_out else []
    notes += [f"{len(found.bad)} could not be read"] if found.bad else []
    print(f"{taken} {'pin' if taken == 1 else 'pins'} imported{''.join(f'; {note}' for note in notes)}")
    for line in found.bad[:MOST_LISTED]:
        print(f"not read: {one_line(line)}", file=sys.stderr)
    if len(found.bad) > MOST_LISTED:
        print(f"not read: {len(found.bad) - MOST_LISTED} more", file=sys.stderr)
    return ANSWERED


def _tie(store: PinStore, args: argparse.Namespace) -> int:
    if args.u is None or args.v is None:
        raise UsageError("which pixel shows the place? give U and V")
    answer, locator = _answered(args)
    if isinstance(answer, Refusal) or locator is None:
        print(answer.to_text(), file=sys.stderr)
        return REFUSED
    tie = tie_of(
        locator.feature_set, answer, (args.u, args.v), lat_deg=args.place[0], lon_deg=args.place[1],
        height_m=args.height, datum=args.datum, sigma_m=args.sigma, sigma_height_m=args.sigma_height, name=args.name,
        who=args.who, locator=locator,
    )  # fmt: skip
    store.add_tie(tie, who=args.who)
    moved = [pin for pin in store.pins() if tie.id in {t.id for t in Places(store).ties_of(pin)}]
    print(f"tied: {len(moved)} pins of {answer.vehicle} take part; pc-ground pins undo takes it back")
    return ANSWERED


def _ties(store: PinStore, args: argparse.Namespace) -> int:
    for tie in store.ties():
        c = tie.click
        where = rounded_text("degrees", tie.lat_deg, tie.lon_deg, CE90_SIGMAS * tie.sigma_m)
        print(
            f"{tie.id[:8]}  {one_line(tie.name) or '(no name)'}  {where} "
            f"+-{tie.sigma_m:g} m  frame {c.frame} of {c.vehicle}, session {c.session}  {one_line(tie.who)}"
        )
    return ANSWERED


def _clear(store: PinStore, args: argparse.Namespace) -> int:
    count = store.clear(who=args.who)
    print(f"{count} pins deleted; pc-ground pins undo brings them back" if count else "there are no pins")
    return ANSWERED


def _undo(store: PinStore, args: argparse.Namespace) -> int:
    what = store.undo(who=args.who)
    print(_nothing(store, "undo", "done") if what is None else f"undone: {what}")
    return ANSWERED


def _redo(store: PinStore, args: argparse.Namespace) -> int:
    what = store.redo(who=args.who)
    print(_nothing(store, "redo", "undone") if what is None else f"done again: {what}")
    return ANSWERED


def _nothing(store: PinStore, verb: str, state: str) -> str:
    """Words for no change of one's own that could be undone; another's last one is named, and left."""
    last = store.last_change(state)
    if last is None:
        return f"there is nothing to {verb}"
    what, who = last
    return f"there is nothing of yours to {verb}; the last is {what!r} by {who!r}: pins {verb} --who {shlex.quote(who)}"


def _share(store: PinStore, args: argparse.Namespace) -> int:
    if not (args.listen or args.connect):
        raise UsageError("with whom? give --listen ENDPOINT on one server and --connect ENDPOINT on the others")
    from ground.pins.sharing import PinSharing  # noqa: PLC0415  zenoh is loaded only where there is a link

    with PinSharing(store, connect=args.connect, listen=args.listen, tls=tls_of(args)) as sharing:
        until = None if args.seconds is None else time.monotonic() + args.seconds
        reported, reported_s = "", -math.inf
        with until_ended():
            while until is None or time.monotonic() < until:
                time.sleep(0.2)
                words = str(sharing.state)
                if words != reported and time.monotonic() - reported_s > REPORT_S:
                    reported, reported_s = words, time.monotonic()
                    print(words, file=sys.stderr)
        print(sharing.state)
    return ANSWERED


_ACTIONS = {
    "list": _list, "add": _add, "edit": _edit, "delete": _delete, "measure": _measure, "export": _export,
    "import": _import, "tie": _tie, "ties": _ties, "clear": _clear, "undo": _undo, "redo": _redo,
    "share": _share,
}  # fmt: skip


# What changes nothing: a named file must be there.
_READ_ONLY = ("list", "export", "measure", "ties")


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # an account without a name
        return ""
