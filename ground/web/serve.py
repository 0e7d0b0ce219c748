"""Open the source and the pins, print where the page is, and serve it until SIGINT or SIGTERM."""

from __future__ import annotations

import argparse
import contextlib
import socket
import sys
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

import uvicorn

from contract.errors import InputError
from contract.link_config import Tls
from contract.topics import DEFAULT_ENDPOINT
from ground.cot_sender import Target
from ground.pins.file import chosen_path, chosen_store, default_path
from ground.pins.store import PinStore
from ground.web.app import create_app
from ground.web.browser import open_in_browser
from ground.web.context import ServerContext
from ground.web.gate import BACKLOG, gate_for_this_process, gated, protocol_of, quiet_logs
from ground.web.guard import Rules, is_loopback
from ground.web.recorded import RecordedSource
from ground.web.source import Source
from ground.web.startup import STATIC, Tokens, WebError, link_host
from ground.web.tile_area import area_of
from ground.web.tiles import Tiles, open_tiles

if TYPE_CHECKING:
    from ground.pins.sharing import PinSharing

SHUTDOWN_S = 2  # for what browsers still ask
MAX_MESSAGE_BYTES = 4096  # of a WebSocket message from a browser, which contains nothing that we use


def serve(args: argparse.Namespace, tokens: Tokens, tls: Tls | None) -> int:
    """Until a signal ends it. Raises PointclickError before anything is served."""
    if args.tiles_attribution and args.tiles is None:
        raise WebError("--tiles-attribution goes with --tiles")
    tiles = None if args.tiles is None else open_tiles(args.tiles, args.tiles_attribution)
    area = area_of(tiles, default_path().parent / "tiles")
    tak = None
    if args.tak is not None:
        tak = Target.of(args.tak, args.tak_ca, args.tak_certificate, args.tak_key, option="--tak")
    is_secure = args.tls_certificate is not None
    with contextlib.ExitStack() as opened:
        listening = opened.enter_context(_listen(args.host, args.port))
        source = opened.enter_context(contextlib.closing(_source(args, tls)))
        store = opened.enter_context(PinStore(chosen_store(args.pins, args.store)))
        sharing = _sharing(args, tls, store)
        if sharing is not None:
            opened.enter_context(sharing)
        gate = gate_for_this_process()

        async def sweep() -> None:
            gate.sweep()

        config = uvicorn.Config(
            create_app(
                ServerContext(source, store, STATIC, tiles, sharing, tak, area),
                _rules(args, tokens, tiles, is_secure),
            ),
            http=protocol_of(gate),
            loop="asyncio",  # whose sockets the gate can be asked for
            backlog=BACKLOG,
            callback_notify=sweep,
            timeout_notify=1,
            log_level="warning",
            access_log=False,
            ws_max_size=MAX_MESSAGE_BYTES,
            ws_ping_interval=5.0,
            ws_ping_timeout=10.0,
            timeout_graceful_shutdown=SHUTDOWN_S,
            ssl_certfile=args.tls_certificate,
            ssl_keyfile=args.tls_key,
            server_header=False,
        )
        config.load()  # what it imports now no page waits for
        quiet_logs()
        _announce(args, listening.getsockname()[1], tokens, is_secure, source, store.name)
        uvicorn.Server(config).run(sockets=[gated(listening, gate)])
    return 0


def _source(args: argparse.Namespace, tls: Tls | None) -> Source:
    if args.recording is not None:
        source = RecordedSource(args.recording)
        for line in source.damage():
            print(f"pc-ground: warning: {line}", file=sys.stderr)
        _have_measured(source, args.recording)
        if args.video is not None:
            return _with_recorded_video(source, args)
        if source.no_pictures():
            print(f"pc-ground: warning: {source.no_pictures()}", file=sys.stderr)
        return source
    from ground.web.live import LiveSource  # noqa: PLC0415  zenoh is loaded only where there is a link

    default = DEFAULT_ENDPOINT if tls is None else DEFAULT_ENDPOINT.replace("tcp/", "tls/", 1)
    pins = chosen_path(args.pins)  # also where the pins themselves are in a database
    journal = None if args.no_journal else args.journal or pins.with_suffix(".link")
    live = LiveSource(args.connect or [default], tls, journal)
    return live if args.video is None else _with_live_video(live, args)


def _have_measured(source: RecordedSource, recording: Path) -> None:
    """Start what measures clicked pixels in a recording's pictures, if there are any and it is installed."""
    if not source.has_own_pictures():
        return
    from ground.recording_server import RecordingServer  # noqa: PLC0415  zenoh is loaded only where there is a link

    try:
        source.measure_by(RecordingServer(recording))
    except InputError as error:
        print(f"pc-ground: warning: clicks are answered between measured points: {error}", file=sys.stderr)


def _with_recorded_video(source: Source, args: argparse.Namespace) -> Source:
    """A recording with the pictures of a video file. Raises InputError for a file or a vehicle that is not there."""
    from ground.web.video_file import FileFootage  # noqa: PLC0415  with the extra `video`
    from ground.web.video_frames import is_file  # noqa: PLC0415
    from ground.web.with_video import WithVideo  # noqa: PLC0415

    there = source.vehicles()
    if not is_file(args.video):
        raise InputError("--video of a recording must be a file")
    if args.video_vehicle not in (*there, None) or (args.video_vehicle is None and len(there) > 1):
        raise InputError(f"--video-vehicle must be one of {', '.join(there)}")
    return WithVideo(source, FileFootage(args.video, source, args.video_vehicle or there[0], args.video_delay))


def _with_live_video(live: Source, args: argparse.Namespace) -> Source:
    from ground.web.video_live import LiveFootage  # noqa: PLC0415
    from ground.web.with_video import WithVideo  # noqa: PLC0415

    try:
        return WithVideo(live, LiveFootage(args.video, live, args.video_vehicle, args.video_delay))
    except BaseException:
        live.close()
        raise


def _sharing(args: argparse.Namespace, tls: Tls | None, store: PinStore) -> PinSharing | None:
    if not (args.share_listen or args.share_connect):
        return None
    from ground.pins.sharing import share_pins  # noqa: PLC0415  zenoh is loaded only where there is a link

    return share_pins(store, connect=args.share_connect, listen=args.share_listen, tls=tls)


def _listen(host: str, port: int) -> socket.socket:
    """The socket, before anything else, so that a port in use is reported in one line."""
    try:
        (family, kind, protocol, _, address), *_ = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    except OSError as error:
        raise InputError(f"--host {host}: {error.strerror}") from error
    listening = socket.socket(family, kind, protocol)
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind(address)
        listening.listen(BACKLOG)
    except OSError as error:
        listening.close()
        raise WebError(f"cannot serve on {host} port {port}: {error.strerror}; choose another with --port") from error
    return listening


def _rules(args: argparse.Namespace, tokens: Tokens, tiles: Tiles | None, is_secure: bool) -> Rules:
    names = frozenset(name.lower().rstrip(".") for name in args.name)
    return Rules(
        tokens.operator, names, "" if tiles is None else tiles.origin, is_secure, tokens.viewer, tokens.pointer
    )


def _announce(args: argparse.Namespace, port: int, tokens: Tokens, is_secure: bool, source: Source, pins: str) -> None:
    """Print the page's address once, on stdout, with a code for the tablet's camera where others may reach it."""
    scheme = "https" if is_secure else "http"
    host = args.name[0] if args.name else link_host(args.host)
    page = f"{scheme}://{host}:{port}/"
    link = page + (f"?token={quote(tokens.operator)}" if tokens.operator else "")
    print(f"pc-ground web: {source.name}; pins in {pins}")
    print(f"open {link}", flush=True)
    if tokens.viewer:
        print(f"to look and change nothing: {page}?token={quote(tokens.viewer)}")
    if tokens.pointer:
        print(f"to have cameras look somewhere too: {page}?token={quote(tokens.pointer)}")
    if not is_loopback(args.host):
        import segno  # noqa: PLC0415  no page waits for it

        segno.make(link, error="m").terminal(out=sys.stdout, compact=True, border=2)
        if not is_secure:
            print(
                "NO TLS: whoever listens on this network reads the token and the pins "
                "(--tls-certificate and --tls-key encrypt)"
            )
    if args.browser:
        open_in_browser(link)
    print("end it with Ctrl-C", flush=True)
