"""Part that `pc-ground open` and `live` share: a page that opens."""

from __future__ import annotations

import argparse
import socket
from collections.abc import Sequence

from ground.web import command as web


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The page's options, and that no browser is to be opened."""
    parser.add_argument("--no-browser", action="store_true", help="only print where the page is")
    web.add_page_arguments(parser)


def web_options(args: argparse.Namespace, shown: Sequence[str]) -> argparse.Namespace:
    """The options of `pc-ground web` for this page; `shown` are the words that describe what is shown."""
    parser = argparse.ArgumentParser()
    web.add_arguments(parser)
    words = [*shown, "--port", str(_free_port(args.port))]
    words += [] if args.pins is None else ["--pins", str(args.pins)]
    words += [] if args.tiles is None else ["--tiles", args.tiles, "--tiles-attribution", args.tiles_attribution]
    words += [] if args.no_browser else ["--browser"]
    return parser.parse_args(words)


def _free_port(asked: int | None) -> int:
    """The port that was asked for; else the page's own, or 0 (any) where that is taken."""
    if asked is not None:
        return asked
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", web.PORT))
        except OSError:
            return 0
    return web.PORT
