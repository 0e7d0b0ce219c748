"""`pc-ground vehicles`: which aircraft are there, how they are, when each last sent anything. No aircraft is asked."""

from __future__ import annotations

import argparse
import json
import sys
import time

from contract.topics import DEFAULT_ENDPOINT
from ground.commands import ANSWERED
from ground.commands.until_ended import until_ended
from ground.commands.values import positive
from ground.formats.documents import one_line
from ground.freshness import stamped_elsewhen
from ground.link_options import add_tls_arguments, endpoint_of, tls_of
from ground.presence import Presence, Present

EXAMPLES = """\
examples:
  pc-ground vehicles --connect tls/10.0.0.1:7447 --credentials keys/anna
  pc-ground vehicles --follow          who comes and who goes, until Ctrl-C
  pc-ground vehicles --json | jq -r 'select(.state == "no_gps").vehicle'
"""
NONE_THERE = 1
LOOK_S = 0.1
_HEADS = ("vehicle", "link", "state", "last seen", "pictures", "reason")
_WIDTHS = (16, 6, 16, 10, 9, 0)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `vehicles`."""
    parser.add_argument("--connect", metavar="ENDPOINT", help=f"zenoh endpoint (default {DEFAULT_ENDPOINT})")
    add_tls_arguments(parser)
    parser.add_argument("--json", action="store_true", help="a JSON object a line instead of a table")
    parser.add_argument("--follow", action="store_true", help="go on: a line whenever one comes, goes or changes state")
    parser.add_argument(
        "--wait", metavar="S", type=positive, default=2.5, help="for the states, sent once a second (%(default)g)"
    )


def run(args: argparse.Namespace) -> int:
    """List once, or until interrupted; 1 if there is none. Raises PointclickError."""
    from ground.client import open_link  # noqa: PLC0415  zenoh is loaded only where there is a link

    tls = tls_of(args)
    session = open_link("client", endpoint_of(args, tls), tls)
    try:
        presence = Presence(session)
        until_s = time.monotonic() + args.wait
        while time.monotonic() < until_s:
            time.sleep(LOOK_S)
            there = presence.now()
            if there and all(one.status is not None for one in there):
                break
        found = presence.now()
        _show(found, args.json, with_heads=True)
        if args.follow:
            _follow(presence, found, args.json)
    finally:
        session.close()
    if not found:
        print("no aircraft is there", file=sys.stderr)
    return ANSWERED if found else NONE_THERE


def _follow(presence: Presence, found: list[Present], as_json: bool) -> None:
    known = {one.vehicle: _kind(one) for one in found}
    with until_ended():
        while True:
            time.sleep(LOOK_S)
            changed = [one for one in presence.now() if known.get(one.vehicle) != _kind(one)]
            known.update((one.vehicle, _kind(one)) for one in changed)
            _show(changed, as_json, with_heads=False)


def _kind(one: Present) -> tuple[bool, str]:
    return one.is_there, "" if one.status is None else one.status.state


def _show(found: list[Present], as_json: bool, *, with_heads: bool) -> None:
    lines = [_json(one) if as_json else _line(_cells(one)) for one in found]
    if lines and with_heads and not as_json:
        lines.insert(0, _line(_HEADS))
    if lines:
        print("\n".join(lines), flush=True)


def _cells(one: Present) -> tuple[str, ...]:
    status = one.status
    link = "up" if one.is_there else "gone"
    if status is None or one.status_age_s is None:
        return one_line(one.vehicle), link, "-", "-", "-", ""
    seen, rate = f"{one.status_age_s:.1f} s", f"{status.ok_hz:.1f}/s"
    reason = "; ".join(text for text in (status.reason, _stamped(one)) if text)
    return one_line(one.vehicle), link, one_line(status.state), seen, rate, one_line(reason)


def _stamped(one: Present) -> str:
    """The time between a status's stamp and now, in words, where it is old or a clock is wrong; empty if neither."""
    if one.status is None or one.status_age_s is None:
        return ""
    return stamped_elsewhen(one.status.unix_s, time.time() - one.status_age_s)


def _json(one: Present) -> str:
    status = one.status
    age_s = None if one.status_age_s is None else round(one.status_age_s, 1)
    about = {"vehicle": one.vehicle, "link": "up" if one.is_there else "gone", "last_seen_s": age_s}
    if status is not None:
        about |= {"state": status.state, "reason": status.reason, "ok_hz": status.ok_hz, "frame": status.frame}
        about["stamped"] = _stamped(one)
    return json.dumps(about)


def _line(cells: tuple[str, ...]) -> str:
    return " ".join(f"{cell:<{width}}" for cell, width in zip(cells, _WIDTHS, strict=True)).rstrip()
