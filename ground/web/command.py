"""`pc-ground web`: serve the page. What needs the extra `web` is imported when it runs."""

from __future__ import annotations

import argparse
import importlib.util
from pathlib import Path

from contract.errors import InputError
from contract.stated_values import number_or_nan
from contract.topics import DEFAULT_ENDPOINT
from ground.link_options import add_tls_arguments, tls_of
from ground.web.startup import WebError, check_installed, tokens_of

PORT = 8080
EXAMPLES = """examples:
  pc-ground web --connect tcp/192.168.1.20:7447            the aircraft on the link, on this machine's own screen
  pc-ground web --from FLIGHT.mcap --pins search.sqlite    a recorded flight
  pc-ground web --connect tcp/10.0.0.7:7447 --video rtsp://10.0.0.9/live    with the downlink's video as pictures
  pc-ground web --share-listen tcp/0.0.0.0:7448            share pins: others use --share-connect tcp/THIS:7448
  pc-ground web --host 0.0.0.0                             for tablets on this network, with a token and a QR code
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `web`."""
    source = parser.add_mutually_exclusive_group()
    source.add_argument(
        "--connect",
        metavar="ENDPOINT",
        action="append",
        help=f"zenoh endpoint, may be given several times (default {DEFAULT_ENDPOINT})",
    )
    source.add_argument("--from", dest="recording", metavar="SESSION.mcap|DIR", type=Path, help="a recorded session")
    add_tls_arguments(parser)
    parser.add_argument(
        "--video",
        metavar="SOURCE",
        help="pictures from a video of the downlink: FILE, rtsp://..., http://..., /dev/videoN",
    )
    parser.add_argument("--video-vehicle", metavar="NAME", help="whose video it is (default: the only vehicle's)")
    parser.add_argument(
        "--video-delay",
        type=_seconds,
        metavar="S",
        help="by which it is late (of a recording: how far into the file its first picture is); default: measured",
    )
    parser.add_argument(
        "--host", default="127.0.0.1", metavar="ADDRESS", help="address to serve on (default 127.0.0.1)"
    )
    add_page_arguments(parser)
    parser.set_defaults(port=PORT)
    parser.add_argument("--store", metavar="URL", help="pins in a PostgreSQL server: postgresql://USER@HOST/DATABASE")
    parser.add_argument("--browser", action="store_true", help="open the page in this machine's browser")
    parser.add_argument(
        "--journal",
        type=Path,
        metavar="DIR",
        help="where what crosses the link is kept, so that a restart forgets nothing (default: next to the pins)",
    )
    parser.add_argument("--no-journal", action="store_true", help="keep nothing of the link")
    for name, meaning in (("listen", "others connect to"), ("connect", "another server shares at")):
        parser.add_argument(
            f"--share-{name}",
            metavar="ENDPOINT",
            action="append",
            default=[],
            help=f"share the pins with other servers: zenoh endpoint that {meaning}; repeatable",
        )
    parser.add_argument(
        "--token",
        metavar="TOKEN",
        nargs="?",
        const="",
        help="ask browsers for a token; without one given, one is made. Always so on addresses that others reach",
    )
    parser.add_argument(
        "--viewer-token",
        metavar="TOKEN",
        nargs="?",
        const="",
        help="another token, with which one looks and changes nothing; without one given, one is made",
    )
    parser.add_argument(
        "--pointer-token",
        metavar="TOKEN",
        nargs="?",
        const="",
        help="another token, with which one may also have cameras look somewhere (docs/look-there.md)",
    )
    parser.add_argument("--tak", metavar="URL", help="where Hand off sends a pin: tls://HOST:PORT, tcp:// or udp://")
    parser.add_argument("--tak-ca", metavar="FILE.pem", type=Path, help="with tls: that server's authority")
    parser.add_argument("--tak-certificate", metavar="FILE.pem", type=Path, help="with tls: ours")
    parser.add_argument("--tak-key", metavar="FILE.pem", type=Path, help="with tls: its private key")
    parser.add_argument("--name", action="append", default=[], metavar="NAME", help="a host name that browsers may use")
    parser.add_argument("--tls-certificate", type=Path, metavar="FILE.pem", help="serve https with this certificate")
    parser.add_argument("--tls-key", type=Path, metavar="FILE.pem", help="and this private key")


def add_page_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments that `open` takes too."""
    parser.add_argument("--port", type=_port, metavar="N", help=f"port to serve on (default {PORT}; 0: any)")
    parser.add_argument("--pins", type=Path, metavar="FILE", help="where pins are kept (default: with your other data)")
    parser.add_argument("--tiles", metavar="FILE|URL", help="base map: FILE.pmtiles, FILE.mbtiles or a URL")
    parser.add_argument("--tiles-attribution", metavar="TEXT", default="", help="whose tiles they are, for the map")


def run(args: argparse.Namespace) -> int:
    """Serve until a signal ends it. Raises PointclickError before anything is served."""
    check_installed()
    if args.video is None and (args.video_vehicle is not None or args.video_delay is not None):
        raise WebError("--video-vehicle and --video-delay go with --video")
    if args.pointer_token is not None and (args.recording is not None or tls_of(args) is None):
        raise WebError("--pointer-token is for a live link with --credentials (docs/look-there.md)")
    if args.recording is not None and args.journal is not None:
        raise WebError("--journal is for a live link: a recording is one already")
    if args.video is not None and importlib.util.find_spec("cv2") is None:
        raise WebError("--video needs opencv-python-headless: install pointclick with its extra [video] too (README)")
    if (args.tls_certificate is None) != (args.tls_key is None):
        raise WebError("--tls-certificate and --tls-key go together")
    for file in (args.tls_certificate, args.tls_key):
        if file is not None and not file.is_file():
            raise InputError(f"{file}: there is no such file")
    from ground.web.serve import serve  # noqa: PLC0415  the extra `web` is needed from here on

    return serve(args, tokens_of(args), tls_of(args))


def _port(text: str) -> int:
    if not text.isdecimal() or int(text) > 65535:
        raise argparse.ArgumentTypeError(f"{text!r} is not a port (0 to 65535)")
    return int(text)


def _seconds(text: str) -> float:
    value = number_or_nan(text)
    if not abs(value) < 1e6:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of seconds")
    return value
