"""The autopilot's end of a wire: UDP, TCP, or a pseudo terminal in place of a serial line. Never blocks.

What has no receiver is lost, as on a UART: a full buffer drops the packet.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
import tty
from pathlib import Path
from typing import Protocol

from contract.errors import ConfigError

CHUNK = 4096


class Wire(Protocol):
    """One end of a link."""

    url: str  # what the other end opens

    def send(self, packet: bytes) -> None:
        """Pass on one packet; dropped where there is no receiver."""

    def receive(self, timeout_s: float) -> bytes:
        """Return the bytes that have come in, waiting at most that long for them; empty if none have."""

    def unplug(self) -> None:
        """Break the link as a pulled cable would."""

    def plug(self) -> None:
        """Put it back."""

    def close(self) -> None:
        """The end of it."""


def open_wire(url: str) -> Wire:
    """`udpout:HOST:PORT`, `udpin:HOST:PORT`, `tcpin:HOST:PORT` (port 0: any free one), `pty` or `pty:LINK`.

    Raises ConfigError for anything else, OSError where it cannot be opened.
    """
    scheme, _, rest = url.partition(":")
    if scheme == "pty":
        return _Pty(Path(rest) if rest else None)
    host, _, port = rest.rpartition(":")
    if scheme not in {"udpout", "udpin", "tcpin"} or not host or not port.isdecimal() or int(port) > 65535:
        raise ConfigError(f"no such link: {url!r}; udpout:HOST:PORT, udpin:HOST:PORT, tcpin:HOST:PORT, pty or pty:LINK")
    if scheme == "tcpin":
        return _TcpServer(host, int(port))
    return _Udp(host, int(port), listens=scheme == "udpin")


class _Udp:
    def __init__(self, host: str, port: int, listens: bool) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._peer: tuple[str, int] | None = None
        if listens:
            self._socket.bind((host, port))
            self.url = f"udpout:{host}:{self._socket.getsockname()[1]}"
        else:
            self._socket.bind(("", 0))
            self._peer = (host, port)
            self.url = f"udpin:{host}:{port}"
        self._learns = listens
        self._plugged = True
        self._socket.setblocking(False)

    def send(self, packet: bytes) -> None:
        if self._peer is not None and self._plugged:
            with contextlib.suppress(OSError):
                self._socket.sendto(packet, self._peer)

    def receive(self, timeout_s: float) -> bytes:
        select.select([self._socket], [], [], timeout_s)
        try:
            data, peer = self._socket.recvfrom(CHUNK)
        except OSError:
            return b""
        if self._learns:
            self._peer = peer
        return data if self._plugged else b""

    def unplug(self) -> None:
        self._plugged = False

    def plug(self) -> None:
        self._plugged = True

    def close(self) -> None:
        self._socket.close()


class _TcpServer:
    """One client at a time; a new one replaces the old."""

    def __init__(self, host: str, port: int) -> None:
        self._address = (host, port)
        self._client: socket.socket | None = None
        self._listener: socket.socket | None = None
        self.plug()
        assert self._listener is not None
        self._address = (host, self._listener.getsockname()[1])
        self.url = f"tcp:{host}:{self._address[1]}"

    def send(self, packet: bytes) -> None:
        if self._client is not None:
            try:
                # All of a packet or nothing: a stream whose buffer is full would cut it.
                self._client.send(packet)
            except BlockingIOError:
                pass
            except OSError:
                self._drop()

    def receive(self, timeout_s: float) -> bytes:
        waiting = [s for s in (self._listener, self._client) if s is not None]
        ready, _, _ = select.select(waiting, [], [], timeout_s)
        if self._listener in ready and self._listener is not None:
            self._drop()
            self._client, _ = self._listener.accept()
            self._client.setblocking(False)
            self._client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        elif self._client is not None and self._client in ready:
            try:
                data = self._client.recv(CHUNK)
            except BlockingIOError:
                return b""
            except OSError:
                data = b""
            if not data:
                self._drop()
            return data
        return b""

    def _drop(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None

    def unplug(self) -> None:
        self._drop()
        if self._listener is not None:
            self._listener.close()
            self._listener = None

    def plug(self) -> None:
        if self._listener is None:
            self._listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
            self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._listener.bind(self._address)
            self._listener.listen(1)
            self._listener.setblocking(False)

    def close(self) -> None:
        self.unplug()


class _Pty:
    """A pseudo terminal. With a link its name stays the same when it is plugged in again, as udev's names do."""

    def __init__(self, link: Path | None) -> None:
        self._link = link
        self._master: int | None = None
        self._slave: int | None = None
        self.device = ""
        self.plug()
        self.url = f"serial:{link or self.device}:115200"

    def send(self, packet: bytes) -> None:
        if self._master is not None:
            with contextlib.suppress(OSError):
                os.write(self._master, packet)

    def receive(self, timeout_s: float) -> bytes:
        ready, _, _ = select.select([] if self._master is None else [self._master], [], [], timeout_s)
        if self._master is None or not ready:
            return b""
        try:
            return os.read(self._master, CHUNK)
        except OSError:
            return b""

    def unplug(self) -> None:
        for end in (self._master, self._slave):
            if end is not None:
                os.close(end)
        self._master = self._slave = None
        if self._link is not None:
            self._link.unlink(missing_ok=True)

    def plug(self) -> None:
        if self._master is not None:
            return
        # The slave is held open too, or the master reads an error for as long as no program has opened it.
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.device = os.ttyname(self._slave)
        if self._link is not None:
            self._link.unlink(missing_ok=True)
            self._link.symlink_to(self.device)

    def close(self) -> None:
        self.unplug()
