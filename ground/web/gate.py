"""Limits on how many connections are held, and how long one may send nothing: slow clients must not use up descriptors.

A connection waits while its request is not complete. Of those that wait the oldest is closed where an address or the
server has too many, so that a client that asks at once is always answered, from the same address too.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
import sys
import time
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol

HEADERS_S = 10.0  # from connecting, or from the last answer, to the end of a request's headers
BODY_S = 60.0  # and from there to the end of its body
WAITING_OF_ONE = 64  # of one address; a browser holds six
AT_ONCE_S = 0.5  # in which a client that asks at once has asked, however many come in one turn of the event loop
BACKLOG = 100  # accepted in one turn of the event loop
RESERVED = 156  # descriptors for files, links and what is being closed
LOG_AGAIN_S = 60.0

Peer = tuple[Any, ...]


@dataclass(eq=False)
class _Held:
    connection: socket.socket
    since_s: float
    until_s: float | None  # None: it does not wait


@dataclass(eq=False)
class Gate:
    """The connections of one server. For the event loop's thread."""

    most: int
    waiting_of_one: int = WAITING_OF_ONE
    closed: int = 0  # that waited too long, or were too many
    _held: dict[Peer, _Held] = field(default_factory=dict)  # in the order they came
    _logged_s: float = -LOG_AGAIN_S

    def __len__(self) -> int:
        return len(self._held)

    def admit(self, connection: socket.socket, peer: Peer) -> bool:
        """Hold one more, in place of one that waits where there are too many; whether there was room."""
        now_s = time.monotonic()
        waiting = [p for p, held in self._held.items() if held.until_s is not None]
        of_one = [p for p in waiting if p[0] == peer[0]]
        if len(of_one) >= self.waiting_of_one and now_s - self._held[of_one[0]].since_s > AT_ONCE_S:
            self._close(of_one[0])
        elif len(self._held) >= self.most:
            if not waiting:
                return False
            ((most_of, _),) = Counter(p[0] for p in waiting).most_common(1)
            self._close(next(p for p in waiting if p[0] == most_of))
        self._held[peer] = _Held(connection, now_s, now_s + HEADERS_S)
        return True

    def expect(self, peer: Peer, within_s: float | None) -> None:
        """The rest of a connection's request must come within so many seconds; None: nothing is missing."""
        held = self._held.get(peer)
        if held is not None:
            held.until_s = None if within_s is None else time.monotonic() + within_s

    def gone(self, connection: socket.socket, peer: Peer) -> None:
        """A connection was closed."""
        held = self._held.get(peer)
        if held is not None and held.connection is connection:
            del self._held[peer]

    def sweep(self) -> None:
        """Close those that have waited too long."""
        now_s = time.monotonic()
        for peer in [p for p, held in self._held.items() if held.until_s is not None and held.until_s < now_s]:
            self._close(peer)

    def _close(self, peer: Peer) -> None:
        """Shut a connection down and count it no more; its descriptor is freed when the event loop sees its end."""
        held = self._held.pop(peer)
        self.closed += 1
        now_s = time.monotonic()
        if now_s - self._logged_s >= LOG_AGAIN_S:
            self._logged_s = now_s
            print(
                f"pc-ground web: connections of {peer[0]} that ask nothing are closed ({self.closed} so far)",
                file=sys.stderr, flush=True,
            )  # fmt: skip
        with contextlib.suppress(OSError):  # the other side has left already
            held.connection.shutdown(socket.SHUT_RDWR)


class _Connection(socket.socket):
    """One that was accepted; the gate gets a call at its end."""

    gate: Gate
    peer: Peer

    def close(self) -> None:
        self.gate.gone(self, self.peer)
        super().close()


class Listener(socket.socket):
    """A listening socket behind a gate, TLS or not: asyncio accepts through it."""

    gate: Gate

    def accept(self) -> tuple[socket.socket, Any]:
        """One that the gate admits. Raises ConnectionAbortedError instead of returning another."""
        plain, peer = super().accept()
        connection = _Connection(plain.family, plain.type, plain.proto, fileno=plain.detach())
        connection.gate, connection.peer = self.gate, peer
        if not self.gate.admit(connection, peer):
            connection.close()
            raise ConnectionAbortedError("no room")
        return connection, peer


class GatedProtocol(H11Protocol):
    """uvicorn's HTTP protocol, which reports to the gate whether it waits for its client."""

    gate: Gate  # of a subclass made for one server: uvicorn makes the instances
    _phase: tuple[object, str] = (None, "headers")

    def data_received(self, data: bytes) -> None:
        """Extend uvicorn's method: note how far the request is."""
        super().data_received(data)
        self._note()

    def on_response_complete(self) -> None:
        """Extend uvicorn's method: the connection waits for the next request from now on."""
        super().on_response_complete()
        self._note()

    def _note(self) -> None:
        cycle = self.cycle
        if self.transport.get_protocol() is not self:
            phase, within_s = "web socket", None
        elif cycle is None or cycle.response_complete:
            phase, within_s = "headers", HEADERS_S
        else:
            phase, within_s = ("body", BODY_S) if cycle.more_body else ("answer", None)
        # Only a new phase gives more time: single bytes do not.
        if self._phase != (cycle, phase):
            self._phase = cycle, phase
            self.gate.expect(self.transport.get_extra_info("peername"), within_s)


class LoggedOnce(logging.Filter):
    """Each message at most once in LOG_AGAIN_S: messages that any client can cause must not fill a disk."""

    def __init__(self) -> None:
        super().__init__()
        self._logged_s: dict[object, float] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Return whether to write the record: the same message at most once in LOG_AGAIN_S."""
        key, now_s = str(record.msg)[:80], time.monotonic()
        if now_s - self._logged_s.get(key, -LOG_AGAIN_S) < LOG_AGAIN_S:
            return False
        if len(self._logged_s) > 1000:
            self._logged_s.clear()
        self._logged_s[key] = now_s
        return True


def gate_for_this_process() -> Gate:
    """Make a gate for as many connections as the process has descriptors for, 4000 at most."""
    try:
        import resource  # noqa: PLC0415  not on Windows
    except ImportError:
        return Gate(400)
    limit, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if limit == resource.RLIM_INFINITY:
        limit = 65_536
    return Gate(max(min(limit - RESERVED - BACKLOG, 4000), 16))


def gated(listening: socket.socket, gate: Gate) -> Listener:
    """The same socket behind the gate."""
    made = Listener(listening.family, listening.type, listening.proto, fileno=listening.detach())
    made.gate = gate
    return made


def protocol_of(gate: Gate) -> type[asyncio.Protocol]:
    return type("GatedProtocol", (GatedProtocol,), {"gate": gate})


def quiet_logs() -> None:
    for name in ("uvicorn.error", "asyncio"):
        logger = logging.getLogger(name)
        if not any(isinstance(one, LoggedOnce) for one in logger.filters):
            logger.addFilter(LoggedOnce())
