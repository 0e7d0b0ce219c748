"""Cursor on Target on the network: UDP to one or to a group, TCP and TLS as streams that are opened again."""

from __future__ import annotations

import contextlib
import ipaddress
import socket
import ssl
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from urllib.parse import urlsplit

from contract.errors import InputError, LinkError

CONNECT_TIMEOUT_S = 10.0
MAX_DATAGRAM = 65_000


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

    @classmethod
    def of(
        cls, url: str, ca: Path | None = None, certificate: Path | None = None, key: Path | None = None, ttl: int = 1
    ) -> Target:
        """Parse a URL. Raises InputError that shows what a valid one looks like."""
        wanted = "write udp://239.2.3.1:6969, tcp://HOST:8087 or tls://HOST:8089"
        try:
            parts = urlsplit(url)
            host, port = parts.hostname, parts.port
        except ValueError as error:
            raise InputError(f"--to {url}: {error}; {wanted}") from error
        if parts.scheme not in ("udp", "tcp", "tls") or not host or not port or parts.path.strip("/") or parts.query:
            raise InputError(f"--to {url}: {wanted}")
        if parts.scheme != "tls" and (ca or certificate or key):
            raise InputError(f"--to {url}: certificates go with tls://")
        if (certificate is None) != (key is None):
            raise InputError("--to-certificate and --to-key go together")
        return cls(parts.scheme, host, port, ca, certificate, key, ttl)


class CotSender:
    """Sends events; a stream that broke is opened again by the next call."""

    def __init__(self, target: Target) -> None:
        self._target = target
        self._socket: socket.socket | None = None

    def send(self, events: Sequence[str]) -> None:
        """All of them. Raises LinkError; what was handed to the system before is not taken back."""
        if self._socket is None:
            self._socket = self._opened()
        try:
            for event in events:
                data = event.encode("utf-8")
                if self._target.scheme == "udp":
                    if len(data) <= MAX_DATAGRAM:
                        self._socket.send(data)
                else:
                    self._socket.sendall(data + b"\n")
        except OSError as error:
            self.close()
            raise LinkError(f"cannot send to {self._name}: {error.strerror or error}") from error

    def close(self) -> None:
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.close()
            self._socket = None

    def __enter__(self) -> CotSender:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    @property
    def _name(self) -> str:
        return f"{self._target.scheme}://{self._target.host}:{self._target.port}"

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
        if t.scheme == "tcp":
            return plain
        try:
            context = ssl.create_default_context(cafile=None if t.ca is None else str(t.ca))
            if t.certificate is not None and t.key is not None:
                context.load_cert_chain(t.certificate, t.key)
            return context.wrap_socket(plain, server_hostname=t.host)
        except (OSError, ValueError) as error:
            plain.close()
            raise LinkError(f"cannot open {self._name}: {error}: is --to-ca the server's authority?") from error
