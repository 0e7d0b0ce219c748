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
from typing import Any
from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import HTTPConnection
from starlette.responses import PlainTextResponse, RedirectResponse
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
        self._headers = {
            "content-security-policy": rules.content_security_policy(),
            "x-content-type-options": "nosniff",
            "referrer-policy": "no-referrer",
            "cross-origin-opener-policy": "same-origin",
            "cross-origin-resource-policy": "same-origin",
            "permissions-policy": "camera=(), microphone=(), geolocation=(self)",
        }

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on a request that is allowed."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        asking, send = HTTPConnection(scope), self._with_headers(scope, send)
        if (refusal := self._refusal(scope, asking.headers)) is not None:
            await self._refuse(scope, receive, send, *refusal)
            return
        if scope["type"] == "http" and scope["path"] == "/":
            asked = asking.query_params.get("token", "")
            if asked and self._role_of(asked):
                await self._welcome(asked)(scope, receive, send)
                return
        role = self._role(asking)
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
        await self._app(scope, receive, send)

    def _refusal(self, scope: Scope, headers: Headers) -> tuple[int, str] | None:
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

    def _role(self, asking: HTTPConnection) -> str:
        """The role whose token a request has; empty for none. Where no token is asked for everybody is an operator."""
        if not self._rules.token:
            return OPERATOR
        scheme, _, token = asking.headers.get("authorization", "").partition(" ")
        if scheme.lower() == "bearer" and (role := self._role_of(token.strip())):
            return role
        return self._role_of(asking.cookies.get(COOKIE, ""))

    def _role_of(self, given: str) -> str:
        rules = self._rules
        for role, token in ((OPERATOR, rules.token), (VIEWER, rules.viewer_token), (POINTER, rules.pointer_token)):
            if token and hmac.compare_digest(given.encode(), token.encode()):
                return role
        return ""

    def _welcome(self, token: str) -> RedirectResponse:
        """The link was opened: the token becomes a cookie that no script reads, and leaves the address bar."""
        answer = RedirectResponse("/", 303)
        secure = self._rules.is_secure
        answer.set_cookie(COOKIE, token, max_age=2_592_000, secure=secure, httponly=True, samesite="strict")
        return answer

    async def _refuse(self, scope: Scope, receive: Receive, send: Send, status: int, reason: str) -> None:
        if scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": 1008, "reason": reason[:120]})
            return
        await PlainTextResponse(f"{reason}\n", status, {"cache-control": "no-store"})(scope, receive, send)

    def _with_headers(self, scope: Scope, send: Send) -> Send:
        is_api = str(scope["path"]).startswith(("/api/", "/ogc"))

        async def sending(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                headers.update(self._headers)
                if is_api:
                    headers.setdefault("cache-control", "no-store")
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
