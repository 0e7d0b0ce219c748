"""`pc-ground look`: an aircraft's camera is sent to look at what is at a pixel, once that place is confirmed.

With --circle the aircraft is then sent to circle about it, once place and height are confirmed again.

Exit status: 0 the autopilot has accepted it; 3 refused with the reason, or not confirmed; 2 wrong usage.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from contextlib import closing
from typing import TYPE_CHECKING

from contract.answer import DEGREES, Fix, decimals
from contract.circular_error import ce90_m
from contract.look import AskCircle, AskLook, Offer
from contract.topics import DEFAULT_ENDPOINT
from ground.commands import ANSWERED, REFUSED
from ground.commands.sources import Clicker, LinkSource
from ground.commands.values import finite, frame_number
from ground.freshness import MAX_AGE_S
from ground.link_options import UsageError, add_tls_arguments, endpoint_of, tls_of

if TYPE_CHECKING:
    from ground.look_link import LookLink

EXAMPLES = """\
examples:
  pc-ground look 480 120 --credentials keys/anna                the newest picture of the aircraft on this machine
  pc-ground look 480 120 --frame 1234 --connect tls/10.0.0.7:7447 --credentials keys/anna
  pc-ground look 480 120 --circle --credentials keys/anna       and have the aircraft circle about it
  pc-ground look --ahead --credentials keys/anna                look there no longer

The place is printed as the aircraft has found it, and asked for once more before anything moves. The aircraft must name
your certificate in link.pointers (docs/look-there.md).
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `look`."""
    parser.add_argument("u", metavar="U", nargs="?", type=finite, help="pixel column of the place to look at")
    parser.add_argument("v", metavar="V", nargs="?", type=finite, help="pixel row")
    parser.add_argument(
        "--frame", metavar="N", type=frame_number, help="the picture that was clicked (default: newest)"
    )
    parser.add_argument(
        "--circle", action="store_true", help="then have the aircraft circle about the place, once that is confirmed"
    )
    parser.add_argument("--ahead", action="store_true", help="look there no longer; without U and V")
    parser.add_argument("--yes", action="store_true", help="do not ask for the place to be confirmed")
    parser.add_argument("--vehicle", metavar="NAME", help="the aircraft, where there are several")
    parser.add_argument("--connect", metavar="ENDPOINT", help=f"zenoh endpoint (default {DEFAULT_ENDPOINT}, with tls)")
    add_tls_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Ask, have it confirmed, and print what the autopilot made of it. Raises PointclickError."""
    if (args.u is None) != (args.v is None) or (args.u is None) != args.ahead:
        raise UsageError("look needs U and V of a place, or --ahead to look there no longer")
    if args.ahead and (args.frame is not None or args.yes or args.circle):
        raise UsageError("--frame, --yes and --circle go with U and V")
    if args.circle and args.yes:
        raise UsageError("a circle is confirmed by a person: --circle goes without --yes")
    if args.u is not None and not args.yes and not _is_someone_there():
        raise UsageError(
            "no one is there to read and confirm the place: input and output must be a terminal, or --yes does without"
        )
    from ground.look_link import LookLink  # noqa: PLC0415  zenoh is loaded only where there is a link
    from ground.put_request import RequestRefused  # noqa: PLC0415

    tls = tls_of(args)
    with LookLink(endpoint_of(args, tls), args.vehicle, tls) as link:
        try:
            return _ahead(link) if args.ahead else _look(link, args)
        except RequestRefused as error:
            print(error, file=sys.stderr)
            return REFUSED


def _ahead(link: LookLink) -> int:
    link.end()
    print(f"{link.vehicle}: accepted by the autopilot: the camera looks ahead again; the aircraft flies on as it does")
    return ANSWERED


def _look(link: LookLink, args: argparse.Namespace) -> int:
    args.vehicle = link.vehicle
    with closing(LinkSource(args)) as source:
        is_newest = args.frame is None
        clicker = Clicker(source, MAX_AGE_S if is_newest else math.inf, is_measured=True)
        answer, locator = clicker.click(args.u, args.v, frame=args.frame)
    if not isinstance(answer, Fix) or locator is None:
        print(answer.to_text(), file=sys.stderr)
        return REFUSED
    radius_m = ce90_m(answer.covariance_enu_m2[:2, :2])
    session = locator.feature_set.session
    asked = AskLook(session, answer.frame, args.u, args.v, answer.lat_deg, answer.lon_deg, radius_m)
    ticket = _confirmed(link, asked, is_asked=not args.yes)
    if ticket and args.circle:
        ticket = _confirmed(link, AskCircle(ticket), is_asked=True)
    return ANSWERED if ticket else REFUSED


def _confirmed(link: LookLink, asked: AskLook | AskCircle, *, is_asked: bool) -> str:
    """Have an offer printed, confirmed and done. Returns its ticket; empty where it was not confirmed."""
    is_circle = isinstance(asked, AskCircle)
    question = "Have the aircraft circle there?" if is_circle else "Have the camera look there?"
    left = "no circle was sent; the camera still looks there" if is_circle else "nothing was sent"
    offer = link.ask(asked)
    came_s = time.monotonic()
    print(f"{link.vehicle}: {in_words(offer)}", flush=True)
    if is_asked and not _is_yes(question):
        print(f"not confirmed: {left}", file=sys.stderr)
        return ""
    try:
        link.confirm(offer, time.monotonic() - came_s)
    except KeyboardInterrupt:
        print("interrupted after it was confirmed: it may have been done or not", file=sys.stderr)
        raise
    print(f"{link.vehicle}: accepted by the autopilot", flush=True)
    return offer.ticket


def in_words(offer: Offer) -> str:
    """The place that is to be confirmed, with as many digits as its radius gives meaning to."""
    digits = decimals(*DEGREES, offer.ce90_m)
    circle = offer.circle
    if circle is not None:
        return (
            f"circle about {offer.lat_deg:.{digits}f} {offer.lon_deg:.{digits}f}, {circle.height_amsl_m:.0f} m above "
            f"sea level, {circle.above_place_m:.0f} m above the place, radius {circle.radius_m:.0f} m "
            f"(90 % within {offer.ce90_m:.1f} m)"
        )
    return (
        f"look at {offer.lat_deg:.{digits}f} {offer.lon_deg:.{digits}f}, {offer.height_amsl_m:.0f} m above sea level "
        f"(90 % within {offer.ce90_m:.1f} m; picture {offer.age_s:.1f} s old)"
    )


def _is_someone_there() -> bool:
    """Return whether a person reads what is printed, and answers."""
    return all(stream is not None and stream.isatty() for stream in (sys.stdin, sys.stdout))


def _forget_what_was_typed() -> None:
    """Drop what waits in the terminal: a key pressed before a question was there to be read answers none."""
    if sys.platform == "win32":
        import msvcrt  # noqa: PLC0415

        while msvcrt.kbhit():
            msvcrt.getwch()
    else:
        import termios  # noqa: PLC0415  Windows has none

        termios.tcflush(sys.stdin, termios.TCIFLUSH)


def _is_yes(question: str) -> bool:
    _forget_what_was_typed()
    try:
        return input(f"{question} [y/N] ").strip().lower() in ("y", "yes")
    except EOFError:
        return False
