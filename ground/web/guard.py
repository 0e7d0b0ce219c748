"""Access to the server: Host and Origin are checked, a token is asked for, and every answer has its headers.

A page of another origin in the same browser, and a name that is made to resolve to this machine (DNS rebinding), are
refused before anything is read. Addresses and `localhost` cannot be rebound and are allowed as hosts; names only if
they were named at the start.
"""

from __future__ import annotations

import hmac
import ipaddress
import re
from dataclasses import dataclass
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs, urlsplit

from starlette.types import ASGIApp, Message, Receive, Scope, Send

COOKIE = "pointclick_token"
OPERATOR, VIEWER, POINTER = "operator", "viewer", "pointer"
POINTING = "/api/look"  # what only a pointer may post to: it has a camera turned
LOOKING = frozenset({"/api/click", "/api/place"})  # what a viewer may post: it is answered, and nothing is kept
MAX_BODY_BYTES = 4_000_000
IMPORT_PATH, MAX_IMPORT_BYTES = "/api/import", 200_000_000  # ten thousand pins with their pictures
_HOST = re.compile(r"^(\[[0-9a-fA-F:.]+\]|[A-Za-z0-9._-]+)(?::(\d{1,5}))?$")


@dataclass(frozen=True)
class Rules:
    """`token` empty: none is asked for. `viewer_token`: with that one only looks; empty for none. `pointer_token`: with
    that one may do what an operator may, and have cameras look somewhere; empty: no one may.

    `names`: host names that are allowed in addition to addresses and localhost.

    `tile_origin`: the one other origin that the page may load from, the base map's; empty for none.
    """

    token: str = ""
    names: frozenset[str] = frozenset()
    tile_origin: str = ""
    is_secure: bool = False
    viewer_token: str = ""
    pointer_token: str = ""

    def content_security_policy(self) -> str:
        """Nothing from anywhere but here, and the tiles' origin."""
        tiles = f" {self.tile_origin}" if self.tile_origin else ""
        return (
            "default-src 'none'; script-src 'self'; worker-src 'self'; style-src 'self'; font-src 'self'; "
            f"manifest-src 'self'; img-src 'self' data: blob:{tiles}; connect-src 'self'{tiles}; base-uri 'none'; "
            "form-action 'self'; frame-ancestors 'none'"
        )

    def allows_host(self, header: str) -> bool:
        """Return whether a Host header has an allowed name of this server, not another name that leads to it."""
        found = _HOST.match(header)
        if found is None:
            return False
        name = found[1].strip("[]").lower().rstrip(".")
        if name == "localhost" or name in self.names:
            return True
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return False
        return True


class Guard:
    """ASGI middleware around everything."""

    def __init__(self, app: ASGIApp, rules: Rules) -> None:
        self._app, self._rules = app, rules
        self._headers = [
            (b"content-security-policy", rules.content_security_policy().encode()),
            (b"x-content-type-options", b"nosniff"),
            (b"referrer-policy", b"no-referrer"),
            (b"cross-origin-opener-policy", b"same-origin"),
            (b"cross-origin-resource-policy", b"same-origin"),
            (b"permissions-policy", b"camera=(), microphone=(), geolocation=(self)"),
        ]

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on a request that is allowed."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = {name.decode("latin-1").lower(): value.decode("latin-1") for name, value in scope["headers"]}
        refusal = self._refusal(scope, headers)
        if refusal is not None:
            await self._refuse(scope, receive, send, *refusal)
            return
        if scope["type"] == "http" and scope["path"] == "/":
            asked = parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token", [""])[0]
            if asked and self._role_of(asked):
                await self._welcome(send, asked)
                return
        role = self._role(headers)
        if not role:
            await self._refuse(scope, receive, send, 401, "a token is needed: open the link that pc-ground web printed")
            return
        if role == VIEWER and scope["type"] == "http" and not _only_looks(scope):
            await self._refuse(scope, receive, send, 403, "with this token one only looks: a viewer changes nothing")
            return
        if role != POINTER and scope["type"] == "http" and scope["method"] == "POST" and _points(scope["path"]):
            await self._refuse(scope, receive, send, 403, "with this token no camera is sent anywhere")
            return
        scope.setdefault("state", {})["role"] = role
        await self._app(scope, receive, self._with_headers(scope, send))

    def _refusal(self, scope: Scope, headers: dict[str, str]) -> tuple[int, str] | None:
        host = headers.get("host", "")
        if not self._rules.allows_host(host):
            return 421, "this server does not go by that name; use its address, or start it with --name"
        origin = headers.get("origin")
        if origin is not None and urlsplit(origin).netloc.lower() != host.lower():
            return 403, "requests from other origins are refused"
        is_navigation = scope["type"] == "http" and headers.get("sec-fetch-mode") == "navigate"
        if headers.get("sec-fetch-site", "none") == "cross-site" and not (is_navigation and scope["method"] == "GET"):
            return 403, "requests from other sites are refused"
        length = headers.get("content-length", "0")
        most = MAX_IMPORT_BYTES if scope["path"] == IMPORT_PATH else MAX_BODY_BYTES
        if not length.isdecimal() or int(length) > most:
            return 413, f"at most {most} bytes"
        # A body without a length could be endless, and no client of ours sends one.
        if "transfer-encoding" in headers:
            return 411, "state the body's length"
        return None

    def _role(self, headers: dict[str, str]) -> str:
        """The role whose token a request has; empty for none. Where no token is asked for everybody is an operator."""
        if not self._rules.token:
            return OPERATOR
        scheme, _, token = headers.get("authorization", "").partition(" ")
        if scheme.lower() == "bearer" and (role := self._role_of(token.strip())):
            return role
        try:
            cookies: SimpleCookie = SimpleCookie(headers.get("cookie", ""))
        except CookieError:
            return ""
        return self._role_of(cookies[COOKIE].value) if COOKIE in cookies else ""

    def _role_of(self, given: str) -> str:
        rules = self._rules
        for role, token in ((OPERATOR, rules.token), (VIEWER, rules.viewer_token), (POINTER, rules.pointer_token)):
            if token and hmac.compare_digest(given.encode(), token.encode()):
                return role
        return ""

    async def _welcome(self, send: Send, token: str) -> None:
        """The link was opened: the token becomes a cookie that no script reads, and leaves the address bar."""
        secure = "; Secure" if self._rules.is_secure else ""
        cookie = f"{COOKIE}={token}; Path=/; HttpOnly; SameSite=Strict; Max-Age=2592000{secure}"
        headers = [*self._headers, (b"location", b"/"), (b"set-cookie", cookie.encode()), (b"content-length", b"0")]
        await send({"type": "http.response.start", "status": 303, "headers": headers})
        await send({"type": "http.response.body", "body": b""})

    async def _refuse(self, scope: Scope, receive: Receive, send: Send, status: int, reason: str) -> None:
        if scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": 1008, "reason": reason[:120]})
            return
        body = (reason + "\n").encode()
        headers = [
            *self._headers,
            (b"content-type", b"text/plain; charset=utf-8"),
            (b"content-length", str(len(body)).encode()),
            (b"cache-control", b"no-store"),
        ]
        await send({"type": "http.response.start", "status": status, "headers": headers})
        await send({"type": "http.response.body", "body": body})

    def _with_headers(self, scope: Scope, send: Send) -> Send:
        is_api = str(scope["path"]).startswith(("/api/", "/ogc"))

        async def sending(message: Message) -> None:
            if message["type"] == "http.response.start":
                present: list[tuple[bytes, bytes]] = list(message.get("headers", []))
                named = {name.lower() for name, _ in present}
                present += self._headers
                if is_api and b"cache-control" not in named:
                    present.append((b"cache-control", b"no-store"))
                message = {**message, "headers": present}
            await send(message)

        return sending


def _only_looks(scope: Scope) -> bool:
    return scope["method"] in ("GET", "HEAD") or (scope["method"] == "POST" and scope["path"] in LOOKING)


def _points(path: str) -> bool:
    return path == POINTING or path.startswith(f"{POINTING}/")


def is_loopback(address: str) -> bool:
    """Return whether only this machine reaches an address."""
    if address == "localhost":
        return True
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        return False


def origin_of(url: str) -> str:
    """Scheme, host and port of a URL of tiles."""
    parts: Any = urlsplit(url)
    return f"{parts.scheme}://{parts.netloc}"
