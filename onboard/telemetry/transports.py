"""The wires a telemetry link may run over: serial (pyserial), UDP, TCP. Bytes in, bytes out; OSError when broken.

None of them reopens itself: its user closes it and opens another.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
from dataclasses import dataclass
from typing import Protocol

import serial

from contract.errors import ConfigError

CHUNK = 4096
CONNECT_S = 0.7
WRITE_S = 0.2
SCHEMES = "serial:/dev/NAME:BAUD, udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT"


class Wire(Protocol):
    """An open wire."""

    speaks_first: bool  # the other end sends only to an address it has received from
    may_die_silently: bool  # it can be dead without an error: to be opened again after long silence

    def read(self, timeout_s: float) -> bytes:
        """Return data that has come in, waiting at most that long; empty if none has. Raises OSError when broken."""

    def write(self, data: bytes) -> bool:
        """Send; return whether it went out: what has no receiver is lost. Raises OSError when broken."""

    def confirm(self) -> None:
        """Confirm that the data read last came from the vehicle: answers go there."""

    def close(self) -> None:
        """The end of it."""


@dataclass(frozen=True)
class Address:
    """The address of a wire: `place` is a device or a host, `number` a baud rate or a port."""

    scheme: str
    place: str
    number: int

    @classmethod
    def parse(cls, url: str, schemes: tuple[str, ...] = ("serial", "udpin", "udpout", "tcp")) -> Address:
        """Return the address that a URL names. Raises ConfigError, one line, for what can never be opened."""
        scheme, _, rest = url.partition(":")
        place, _, number = rest.rpartition(":")
        if scheme not in schemes:
            raise ConfigError(f"telemetry.url {url!r}: unknown kind {scheme!r}; one of {SCHEMES}, nmea:, tlog:")
        if not place or not number.isdecimal():
            what = "DEVICE:BAUD" if scheme in ("serial", "nmea") else "HOST:PORT"
            raise ConfigError(f"telemetry.url {url!r}: write {scheme}:{what}")
        if scheme in ("serial", "nmea"):
            if not 300 <= int(number) <= 12_500_000:
                raise ConfigError(f"telemetry.url {url!r}: a baud rate of {number} is none a serial line has")
        elif not 0 < int(number) < 65536:
            raise ConfigError(f"telemetry.url {url!r}: port {number} is outside 1 to 65535")
        return cls(scheme, place.strip("[]"), int(number))

    def open(self) -> Wire:
        """Raises OSError where it cannot be opened now."""
        if self.scheme in ("serial", "nmea"):
            return _Serial(self.place, self.number)
        if self.scheme == "tcp":
            return _Tcp(self.place, self.number)
        return _Udp(self.place, self.number, listens=self.scheme == "udpin")


class _Serial:
    speaks_first = False
    may_die_silently = True

    def __init__(self, device: str, baud: int) -> None:
        try:
            self._port = serial.Serial(device, baud, timeout=0, write_timeout=WRITE_S, exclusive=True)
        except serial.SerialException as error:  # its text repeats the device and wraps the system's
            raise OSError(error.errno, os.strerror(error.errno) if error.errno else str(error)) from error
        except ValueError as error:  # a rate this driver does not have
            raise OSError(0, str(error)) from error
        self._port.reset_input_buffer()  # what waited there has lost its time

    def read(self, timeout_s: float) -> bytes:
        # Not pyserial's own waiting: it returns at its time-out even when bytes came at once.
        ready, _, _ = select.select([self._port.fileno()], [], [], timeout_s)
        return bytes(self._port.read(CHUNK)) if ready else b""

    def write(self, data: bytes) -> bool:
        try:
            self._port.write(data)
        except serial.SerialTimeoutException:
            self._port.reset_output_buffer()
            return False
        return True

    def confirm(self) -> None:
        """There is one other end."""

    def close(self) -> None:
        self._port.close()


class _Tcp:
    speaks_first = False
    may_die_silently = True

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.create_connection((host, port), timeout=CONNECT_S)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.setblocking(False)

    def read(self, timeout_s: float) -> bytes:
        ready, _, _ = select.select([self._socket], [], [], timeout_s)
        if not ready:
            return b""
        data = self._socket.recv(CHUNK)
        if not data:
            raise ConnectionError("the other end has closed the connection")
        return data

    def write(self, data: bytes) -> bool:
        try:
            sent = self._socket.send(data)
        except BlockingIOError:
            return False
        if sent < len(data):
            raise ConnectionError("the other end takes nothing any more")  # half a packet is out: start over
        return True

    def confirm(self) -> None:
        """There is one other end."""

    def close(self) -> None:
        self._socket.close()


class _Udp:
    may_die_silently = False

    def __init__(self, host: str, port: int, listens: bool) -> None:
        kind, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
        self._socket = socket.socket(kind, socket.SOCK_DGRAM)
        self.speaks_first = not listens
        self._peer = None if listens else address
        self._last = self._peer
        try:
            if listens:
                self._socket.bind(address)
        except OSError:
            self._socket.close()
            raise
        self._socket.setblocking(False)

    def read(self, timeout_s: float) -> bytes:
        ready, _, _ = select.select([self._socket], [], [], timeout_s)
        if not ready:
            return b""
        try:
            data, self._last = self._socket.recvfrom(65536)
        except (BlockingIOError, ConnectionRefusedError):  # no receiver yet
            return b""
        return data

    def write(self, data: bytes) -> bool:
        if self._peer is not None:
            with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
                self._socket.sendto(data, self._peer)
                return True
        return False

    def confirm(self) -> None:
        self._peer = self._last

    def close(self) -> None:
        self._socket.close()
