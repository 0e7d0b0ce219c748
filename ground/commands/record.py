"""`pc-ground record`: what the link delivers, as recordings that `--from` reads. Extra `record` (mcap)."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from contract.topics import ANY_VEHICLE
from ground.commands import ANSWERED
from ground.commands.sources import add_source_arguments
from ground.commands.until_ended import until_ended
from ground.commands.values import positive
from ground.link_options import UsageError, endpoint_of, tls_of

EXAMPLES = """\
examples:
  pc-ground record --out flights/today                       until Ctrl-C; a file for each aircraft's session
  pc-ground record --out flights/today --connect tcp/10.0.0.7:7447 --seconds 600
  pc-ground click 480 120 --from flights/today/uav1-1717000000.001.mcap
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `record`."""
    parser.add_argument("--out", metavar="DIR", type=Path, required=True, help="the folder; made if it is not there")
    parser.add_argument("--seconds", metavar="S", type=positive, help="end by itself after so long")
    add_source_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Record until interrupted. Raises PointclickError."""
    if args.recording is not None:
        raise UsageError("record is for a live link: a recording is one already")
    from ground.client import SetCache  # noqa: PLC0415  zenoh is loaded only where there is a link
    from ground.link_recorder import LinkRecorder  # noqa: PLC0415  with mcap, of an extra

    tls = tls_of(args)
    vehicle = args.vehicle or ANY_VEHICLE
    with LinkRecorder(args.out) as recorder:
        with SetCache(endpoint_of(args, tls), vehicle, tls=tls, subscriptions={f"pc/{vehicle}/*": recorder.take}):
            until = None if args.seconds is None else time.monotonic() + args.seconds
            reported_s = time.monotonic()
            with until_ended():
                while until is None or time.monotonic() < until:
                    time.sleep(0.2)
                    recorder.sync()
                    if time.monotonic() - reported_s > 60.0:
                        reported_s = time.monotonic()
                        print(f"pc-ground record: {recorder.words}", file=sys.stderr)
        print(recorder.words)
    return ANSWERED
