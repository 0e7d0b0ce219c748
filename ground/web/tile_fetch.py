"""Tiles from the address that was configured, over one connection; each is checked before it is kept."""

from __future__ import annotations

import contextlib
import gzip
import http.client
import json
import socket
import ssl
import threading
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any
from urllib.parse import SplitResult, urljoin, urlsplit

from contract.errors import InputError
from ground.web.guard import origin_of
from ground.web.tiles import LAST_ZOOM, Tiles

USER_AGENT = "pointclick (offline map of one area, one connection)"
MAX_TILE_BYTES = 2_000_000
MAX_TILEJSON_BYTES = 1_000_000
SILENCE_S, ANSWER_S = 10.0, 30.0  # of a server: without a byte, and from question to last byte
PAUSE_S = 1.0  # before one more try
TRIES = 3
MOST_REDIRECTS = 3
MOST_LAYERS = 1000  # of a vector tile: a map has some ten
DEEPEST = 19  # of an address that does not state it: where most servers end
_LIMITED, _FORBIDDEN, _GAPS = 429, 403, (204, 404, 410)
_LAYERS, _LENGTH_DELIMITED = 3, 2  # of a vector tile's message: its only field, and how that is written


class FetchError(InputError):
    """The address gave no tile, and asking on is of no use."""


@dataclass(frozen=True)
class Description:
    """The tiles that an address has. `max_zoom` None: it does not state it. `is_tms`: its rows count from the south."""

    template: str
    min_zoom: int = 0
    max_zoom: int | None = None
    attribution: str = ""
    is_tms: bool = False

    def url(self, z: int, x: int, y: int) -> str:
        """The URL of one tile, whose row counts from the north."""
        text = self.template
        row = (1 << z) - 1 - y if self.is_tms else y
        for name, value in (("{z}", z), ("{x}", x), ("{y}", row), ("{ratio}", "")):
            text = text.replace(name, str(value))
        return text


class Fetcher:
    """One connection to the configured address. No other origin is ever asked, whatever the answers name."""

    def __init__(self, url: str, tries: int = TRIES) -> None:
        self._origin, self._tries = origin_of(url), tries
        self._at: SplitResult = urlsplit(url)
        self.host = self._at.hostname or ""
        self._stop = threading.Event()
        self._connection: http.client.HTTPConnection | None = None

    def tile(self, about: Description, z: int, x: int, y: int) -> bytes | None:
        """A checked tile, a vector tile packed by gzip; None where the address has none. Raises FetchError."""
        content = self.get(about.url(z, x, y), MAX_TILE_BYTES)
        if not content:
            return None
        checked = checked_tile(content)
        if checked is None:
            raise FetchError(f"{self.host} sent no map tile for {z}/{x}/{y} (not PNG, JPEG, WebP or a vector tile)")
        return checked

    def get(self, url: str, most: int) -> bytes | None:
        """Return the content at a URL of the address, of at most so many bytes; None: nothing. Raises FetchError."""
        reason = ""
        for attempt in range(self._tries):
            if attempt and self._stop.wait(PAUSE_S):
                break
            try:
                status, content = self._follow(url, most)
            except (OSError, http.client.HTTPException, ValueError) as error:  # ValueError: of a URL that is none
                self.close()
                reason = f"{self.host} is not reachable ({_words(error)})"
                continue
            if status < 500:
                return self._judged(status, content)
            reason = f"{self.host} answers with an error ({status})"
        raise FetchError(reason or f"{self.host} was not asked")

    def _judged(self, status: int, content: bytes) -> bytes | None:
        if status == _LIMITED:
            raise FetchError(f"{self.host} asks for no more now (429): wait, or use a server of your own")
        if status == _FORBIDDEN:
            raise FetchError(f"{self.host} forbids it (403): use a server of your own or one that allows downloading")
        if status in _GAPS:
            return None
        if status != 200:
            raise FetchError(f"{self.host} answers {status}")
        return content

    def _follow(self, url: str, most: int) -> tuple[int, bytes]:
        for _ in range(MOST_REDIRECTS + 1):
            if origin_of(url) != self._origin:
                raise FetchError(f"{self.host} sends on to another host ({urlsplit(url).hostname}): refused")
            status, content, location = self._ask(url, most)
            if status not in (301, 302, 303, 307, 308):
                return status, content
            url = urljoin(url, location)
        raise FetchError(f"{self.host} sends on and on")

    def _ask(self, url: str, most: int) -> tuple[int, bytes, str]:
        """Ask once; hung up after ANSWER_S, whatever still comes: also the lines before a body can have no end."""
        is_late = threading.Event()

        def hang_up() -> None:
            is_late.set()
            self._shut()

        timer = threading.Timer(ANSWER_S, hang_up)
        timer.daemon = True
        timer.start()
        try:
            return self._asked(url, most, is_late)
        except (OSError, http.client.HTTPException) as error:
            if is_late.is_set():
                raise TimeoutError from error
            raise
        finally:
            timer.cancel()

    def _asked(self, url: str, most: int, is_late: threading.Event) -> tuple[int, bytes, str]:
        parts = urlsplit(url)
        target = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
        for is_reused in (self._connection is not None, False):
            connection = self._connected()
            try:
                connection.request("GET", target, headers={"User-Agent": USER_AGENT, "Accept": "*/*"})
                answer = connection.getresponse()
                break
            except (ConnectionError, http.client.RemoteDisconnected):
                self.close()
                # The server ends connections that it has kept open, and may do so at any time.
                if not is_reused or is_late.is_set():
                    raise
        content = bytearray()
        while part := answer.read1(65536):
            content += part
            if len(content) > most:
                raise FetchError(f"{self.host} sends more than {most / 1e6:.0f} MB for one tile")
        if is_late.is_set():
            raise TimeoutError
        if answer.length:  # it hung up before the end
            raise ConnectionResetError
        answer.close()  # the connection stays, for the next tile
        return answer.status, bytes(content), answer.headers.get("location", "")

    def _connected(self) -> http.client.HTTPConnection:
        if self._stop.is_set():
            raise ConnectionAbortedError
        if self._connection is None:
            if self._at.scheme == "https":
                self._connection = http.client.HTTPSConnection(self.host, self._at.port, timeout=SILENCE_S)
            else:
                self._connection = http.client.HTTPConnection(self.host, self._at.port, timeout=SILENCE_S)
        return self._connection

    def abort(self) -> None:
        """End it from another thread, also while it waits."""
        self._stop.set()
        self._shut()

    def _shut(self) -> None:
        held = None if self._connection is None else self._connection.sock
        if held is not None:
            with contextlib.suppress(OSError):
                held.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        if self._connection is not None:
            self._connection.close()
            self._connection = None


def described(tiles: Tiles, fetcher: Fetcher) -> Description:
    """The tiles of a template, or of a TileJSON document, which is fetched. Raises FetchError."""
    if tiles.kind == "template":
        return Description(tiles.url, attribution=tiles.attribution)
    content = fetcher.get(tiles.url, MAX_TILEJSON_BYTES)
    try:
        about = json.loads(content or b"")
        template = urljoin(tiles.url, str(about["tiles"][0]))
        least, most = int(about.get("minzoom", 0)), int(about.get("maxzoom", DEEPEST))
        scheme = about.get("scheme", "xyz")
    except (ValueError, TypeError, LookupError, AttributeError, OverflowError, RecursionError) as error:
        raise FetchError(f"{fetcher.host} sends no TileJSON there") from error
    is_usable = all(f"{{{axis}}}" in template for axis in "zxy") and 0 <= least <= most <= LAST_ZOOM
    if not is_usable or scheme not in ("xyz", "tms"):
        raise FetchError(f"{fetcher.host} sends a TileJSON whose tiles, zooms or scheme cannot be used")
    if origin_of(template) != tiles.origin:
        raise FetchError(f"the TileJSON's tiles are at another host ({urlsplit(template).hostname}): refused")
    return Description(template, least, most, tiles.attribution or _text(about.get("attribution")), scheme == "tms")


def image_format(content: bytes) -> str:
    """The format of a tile as MBTiles names it: png, jpg, webp, or pbf for what is packed; empty if it is none."""
    if content.startswith(b"\x89PNG\r\n\x1a\n"):
        return "png"
    if content.startswith(b"\xff\xd8\xff"):
        return "jpg"
    if content.startswith(b"RIFF") and content[8:12] == b"WEBP":
        return "webp"
    return "pbf" if content.startswith(b"\x1f\x8b") else ""


def checked_tile(content: bytes) -> bytes | None:
    """An image as it is, a vector tile packed by gzip as MBTiles has it; None for anything else."""
    if content.startswith(b"\x1f\x8b"):
        packed = zlib.decompressobj(wbits=31)
        try:
            content = packed.decompress(content, MAX_TILE_BYTES * 5)
        except zlib.error:
            return None
        if not packed.eof:
            return None
    if image_format(content) in ("png", "jpg", "webp"):
        return content
    return gzip.compress(content, mtime=0) if _is_vector_tile(content) else None


def _is_vector_tile(content: bytes) -> bool:
    """Return whether the bytes are layers of a vector tile one after the other, to the last byte."""
    at = 0
    for _ in range(MOST_LAYERS):
        if at >= len(content):
            break
        key, at = _varint(content, at)
        length, at = _varint(content, at)
        if key != (_LAYERS << 3 | _LENGTH_DELIMITED) or length < 0:
            return False
        at += length
    return at == len(content) > 0


def _varint(content: bytes, at: int) -> tuple[int, int]:
    """A number and where it ends; -1 if it does not."""
    value = 0
    for shift in range(0, 35, 7):
        if at >= len(content):
            break
        value |= (content[at] & 127) << shift
        at += 1
        if content[at - 1] < 128:
            return value, at
    return -1, at


def _text(value: Any) -> str:
    return value[:300] if isinstance(value, str) else ""


def _words(error: Exception) -> str:
    if isinstance(error, ssl.SSLError):
        return f"TLS: {error.reason or error}"
    if isinstance(error, TimeoutError):
        return "no answer in time"
    return (error.strerror if isinstance(error, OSError) else "") or type(error).__name__


@contextlib.contextmanager
def fetching(url: str, tries: int) -> Iterator[Fetcher]:
    """A connection for some questions, closed after them."""
    fetcher = Fetcher(url, tries)
    try:
        yield fetcher
    finally:
        fetcher.close()
