"""`pc-ground mavlink`: a camera component on the ground's MAVLink network, for clicks in QGroundControl's video.

With the aircraft's own `mavlink_camera` this is not needed. docs/mavlink-camera.md.
"""

from __future__ import annotations

import argparse
import sys
import time

from contract.mavlink_camera.messages import Stream
from contract.topics import DEFAULT_ENDPOINT
from ground.commands import ANSWERED
from ground.commands.until_ended import until_ended
from ground.commands.values import finite, positive, whole
from ground.link_options import UsageError, add_tls_arguments, endpoint_of, tls_of
from ground.mavlink_endpoint import SCHEME, MavlinkEndpoint

EXAMPLES = """\
examples:
  pc-ground mavlink udpin:127.0.0.1:14560 --vehicle uav1                by an end of mavlink-router's (-e)
  pc-ground mavlink tcp:127.0.0.1:5760 --vehicle uav1 --connect tcp/10.0.0.7:7447 --video h264:5600
"""
SHOWN_S = 1.0  # between looks at how it goes


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `mavlink`."""
    parser.add_argument(
        "wire", metavar="WIRE", help="udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT or serial:DEV:BAUD"
    )
    parser.add_argument("--vehicle", metavar="NAME", required=True, help="the aircraft whose sets answer")
    parser.add_argument("--connect", metavar="ENDPOINT", help=f"zenoh endpoint (default {DEFAULT_ENDPOINT})")
    parser.add_argument(
        "--system",
        metavar="N",
        type=lambda t: whole(t, "system"),
        help="its MAVLink number (default: the only autopilot's)",
    )
    parser.add_argument(
        "--component", metavar="N", type=lambda t: whole(t, "component"), default=100, help="the camera's (default 100)"
    )
    parser.add_argument(
        "--video", metavar="URI", help="rtsp://..., tcp://..., h264:PORT, h265:PORT or mpegts:PORT, for ground stations"
    )
    parser.add_argument(
        "--delay", metavar="S", type=finite, default=0.5, help="from exposure to the click (default 0.5)"
    )
    parser.add_argument("--sigma-delay", metavar="S", type=finite, default=0.3, help="one sigma of that (default 0.3)")
    parser.add_argument("--seconds", metavar="S", type=positive, help="end after so long")
    add_tls_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Answer until ended. Raises PointclickError."""
    if not (0.0 <= args.delay <= 10.0 and 0.0 <= args.sigma_delay <= 5.0):
        raise UsageError("--delay is 0 to 10 s, --sigma-delay 0 to 5 s")
    if not 100 <= args.component <= 105 or (args.system is not None and not 1 <= args.system <= 255):
        raise UsageError("--component is 100 to 105, --system 1 to 255")
    tls = tls_of(args)
    endpoint = endpoint_of(args, tls)
    if endpoint.startswith(SCHEME):
        raise UsageError(
            "--connect is a zenoh endpoint: sets that come by the autopilot's radio are too few to click on"
        )
    stream = None if args.video is None else Stream.parse(args.video)
    from ground.mavlink_camera import CameraOptions, GroundCamera  # noqa: PLC0415  zenoh is loaded only where there is a link

    options = CameraOptions(args.system, args.component, stream, args.delay, args.sigma_delay)
    camera = GroundCamera(MavlinkEndpoint.parse(args.wire), endpoint, args.vehicle, tls=tls, options=options)
    until_s = None if args.seconds is None else time.monotonic() + args.seconds
    shown, shown_s = "", 0.0
    with camera, until_ended():
        while until_s is None or time.monotonic() < until_s:
            camera.look()
            if time.monotonic() - shown_s >= SHOWN_S and (state := camera.state) != shown:
                shown, shown_s = state, time.monotonic()
                print(f"pc-ground mavlink: {state}", file=sys.stderr)
    return ANSWERED
