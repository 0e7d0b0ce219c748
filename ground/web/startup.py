"""The conditions under which the page's server may start, checked without the extra `web`: parts, tokens, address."""

from __future__ import annotations

import argparse
import importlib.util
import ipaddress
import secrets
import sys
from dataclasses import dataclass
from pathlib import Path

from contract.errors import PointclickError

NEEDED = ("fastapi", "uvicorn", "websockets", "PIL", "segno", "mcap")
MIN_TOKEN = 16
STATIC = Path(__file__).parent / "static"


class WebError(PointclickError):
    """The server cannot be started as it was asked."""


def check_installed() -> None:
    """Raise WebError if the page cannot be served here, with what to install."""
    missing = [name for name in NEEDED if importlib.util.find_spec(name) is None]
    if missing:
        raise WebError(
            f"the page needs {', '.join(missing)}: install pointclick with its extra [web] or [open] (README)"
        )
    if not (STATIC / "index.html").is_file():
        raise WebError(
            f"the page is not in {STATIC}: it was not built; run make web in the checkout, and install again"
        )


@dataclass(frozen=True)
class Tokens:
    """Tokens of operators, of viewers and of pointers; empty: operators need none, or there is none for that role."""

    operator: str
    viewer: str
    pointer: str = ""


def tokens_of(args: argparse.Namespace) -> Tokens:
    """Raises WebError for a token that is easy to guess, or one for two roles."""
    from ground.web.guard import is_loopback  # noqa: PLC0415

    others = args.viewer_token, args.pointer_token
    is_asked = not is_loopback(args.host) or others != (None, None)
    asked = "" if args.token is None and is_asked else args.token
    operator, viewer = _token("--token", asked), _token("--viewer-token", args.viewer_token)
    pointer = _token("--pointer-token", args.pointer_token)
    given = [token for token in (operator, viewer, pointer) if token]
    if len(set(given)) < len(given):
        raise WebError("--token, --viewer-token and --pointer-token must differ")
    return Tokens(operator, viewer, pointer)


def _token(option: str, given: str | None) -> str:
    if not given:
        return "" if given is None else secrets.token_urlsafe(18)
    if len(given) < MIN_TOKEN or not given.isascii() or not given.replace("-", "").replace("_", "").isalnum():
        raise WebError(f"{option} must have at least {MIN_TOKEN} letters, digits, - or _; leave it out and one is made")
    return given


def link_host(host: str) -> str:
    """The address that goes into a link: of all addresses, the one that leads out."""
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return host
    if not address.is_unspecified:
        return f"[{host}]" if address.version == 6 else host
    import socket  # noqa: PLC0415

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # nothing is sent: the system only chooses the way
            return str(probe.getsockname()[0])
        except OSError:
            print("pc-ground: warning: this machine has no address that others reach", file=sys.stderr)
            return "127.0.0.1"
