"""Cursor on Target on the network: UDP to one or to a group, TCP and TLS as streams that are opened again.

A server sends to whoever sends to it: other clients' events, and of TLS 1.3 tickets before any event. What is not read
fills a buffer until the server ends the connection, and a socket that is closed before it is read makes the system
reset the connection, which discards at the server what it has not read yet. So a stream is read while nothing is sent,
and at its end until the server has closed it too.

Nothing is queued here: the next period's events are newer. The system's own queue is bounded in time: what a link that
is gone has not acknowledged after UNACKNOWLEDGED_S is discarded with the connection, and never comes late.
"""

from __future__ import annotations

import contextlib
import ipaddress
import socket
import ssl
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

from contract.closing import Closing
from contract.errors import InputError, LinkError

CONNECT_TIMEOUT_S = 10.0
UNACKNOWLEDGED_S = 30.0  # as long as the shortest time for which an event is valid
RETRY_S = 10.0  # between attempts to open a stream: what a server forgot with it need not wait for a long period
CLOSING_S = 5.0  # for a server to read what it was sent, and to close
MAX_DATAGRAM = 65_000
READ_BYTES = 65_536


@dataclass(frozen=True)
class Target:
    """The destination of events."""

    scheme: str
    host: str
    port: int
    ca: Path | None = None
    certificate: Path | None = None
    key: Path | None = None
    ttl: int = 1
    option: str = "--to"  # by which it was given, for messages

    @property
    def name(self) -> str:
        return f"{self.scheme}://{self.host}:{self.port}"

    @classmethod
    def of(
        cls,
        url: str,
        ca: Path | None = None,
        certificate: Path | None = None,
        key: Path | None = None,
        ttl: int = 1,
        option: str = "--to",
    ) -> Target:
        """Parse a URL. Raises InputError that shows what a valid one looks like."""
        wanted = "write udp://239.2.3.1:6969, tcp://HOST:8087 or tls://HOST:8089"
        try:
            parts = urlsplit(url)
            host, port = parts.hostname, parts.port
        except ValueError as error:
            raise InputError(f"{option} {url}: {error}; {wanted}") from error
        if parts.scheme not in ("udp", "tcp", "tls") or not host or not port or parts.path.strip("/") or parts.query:
            raise InputError(f"{option} {url}: {wanted}")
        if parts.scheme != "tls" and (ca or certificate or key):
            raise InputError(f"{option} {url}: certificates go with tls://")
        if (certificate is None) != (key is None):
            raise InputError(f"{option}-certificate and {option}-key go together")
        return cls(parts.scheme, host, port, ca, certificate, key, ttl, option)


class CotSender(Closing):
    """Sends events; a stream that broke is opened again by `connect`, and `ended` states why the last one did."""

    def __init__(self, target: Target) -> None:
        self._target = target
        self._socket: socket.socket | None = None
        self._is_stream = target.scheme != "udp"
        self.ended = ""

    def connect(self) -> None:
        """Open the stream unless it is open. Raises LinkError."""
        self._read_for(0.0)
        if self._socket is None:
            self._socket = self._opened()
        else:
            self.ended = ""

    def send(self, events: Sequence[str]) -> None:
        """All of them, once connected. Raises LinkError; what was handed to the system before is not taken back."""
        if self._socket is None:
            raise LinkError(f"{self._name} is not open")
        try:
            for event in events:
                data = event.encode("utf-8")
                if self._is_stream:
                    self._socket.sendall(data + b"\n")
                elif len(data) <= MAX_DATAGRAM:
                    self._socket.send(data)
        except OSError as error:
            self._drop()
            raise LinkError(f"cannot send to {self._name}: {self._reason(error)}") from error

    def pause(self, seconds: float) -> None:
        """Wait, and discard what the server sends; without a stream, or once it has ended, RETRY_S at most."""
        began_s = time.monotonic()
        self._read_for(seconds)
        wait_s = min(seconds, RETRY_S) if self._socket is None else seconds
        time.sleep(max(began_s + wait_s - time.monotonic(), 0.0))

    def finish(self) -> None:
        """End the stream once the server has read all of it, or after CLOSING_S. Raises LinkError if it refused it.

        With TLS 1.3 a server refuses a certificate only after we have sent.
        """
        is_refused = self._read_for(0.0)
        if self._socket is not None and self._is_stream:
            with contextlib.suppress(OSError):
                if isinstance(self._socket, ssl.SSLSocket):
                    self._socket.setblocking(False)
                    with contextlib.suppress(OSError):  # sends that no more comes; the answer is not waited for
                        self._socket.unwrap()
                self._socket.shutdown(socket.SHUT_WR)  # of TLS too: what comes now is read as bytes
            is_refused = self._read_for(CLOSING_S)
        self._drop(self.ended)
        if is_refused:
            raise LinkError(f"{self._name} {self.ended}")

    def close(self) -> None:
        with contextlib.suppress(LinkError):
            self.finish()

    def _read_for(self, seconds: float) -> bool:
        """Discard what the server sends; drop a stream that it ends. Returns whether that was by an error."""
        until_s = time.monotonic() + seconds
        left_s = seconds
        while self._socket is not None and self._is_stream:
            try:
                self._socket.settimeout(left_s)  # 0: what is here already
                if not self._socket.recv(READ_BYTES):
                    self._drop("was closed by the server")
                    return False
            except (TimeoutError, BlockingIOError, ssl.SSLWantReadError):
                pass
            except OSError as error:
                self._drop(f"was ended by the server: {self._reason(error)}")
                return True
            self._socket.settimeout(CONNECT_TIMEOUT_S)
            left_s = until_s - time.monotonic()
            if left_s <= 0.0:
                break
        return False

    def _reason(self, error: OSError) -> str:
        accepted = f": does it accept {self._target.option}-certificate?" if self._target.scheme == "tls" else ""
        return f"{error.strerror or error}{accepted}"

    def _drop(self, why: str = "") -> None:
        self.ended = why
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.close()
            self._socket = None

    @property
    def _name(self) -> str:
        return self._target.name

    def _opened(self) -> socket.socket:
        t = self._target
        try:
            if t.scheme == "udp":
                family, kind, proto, _, address = socket.getaddrinfo(t.host, t.port, type=socket.SOCK_DGRAM)[0]
                found = socket.socket(family, kind, proto)
                if ipaddress.ip_address(address[0]).is_multicast:
                    if family == socket.AF_INET6:
                        found.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_MULTICAST_HOPS, t.ttl)
                    else:
                        found.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, t.ttl)
                found.connect(address)
                return found
            plain = socket.create_connection((t.host, t.port), timeout=CONNECT_TIMEOUT_S)
        except OSError as error:
            raise LinkError(
                f"cannot open {self._name}: {error.strerror or error}: does somebody listen there?"
            ) from error
        if hasattr(socket, "TCP_USER_TIMEOUT"):  # Linux
            plain.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, round(1000 * UNACKNOWLEDGED_S))
        if t.scheme == "tcp":
            return plain
        try:
            context = ssl.create_default_context(cafile=None if t.ca is None else str(t.ca))
            if t.certificate is not None and t.key is not None:
                context.load_cert_chain(t.certificate, t.key)
            return context.wrap_socket(plain, server_hostname=t.host)
        except (OSError, ValueError) as error:
            plain.close()
            raise LinkError(f"cannot open {self._name}: {error}: is {t.option}-ca the server's authority?") from error
