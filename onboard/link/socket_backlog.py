"""The sent bytes that the system still holds: the only sign of a cut or a slow radio that this end can see.

A stream (tcp, tls) keeps what it could not deliver and delivers it first when the link is back, however old. After a
cut of 9 s a link of 40 kbit/s took more than 12 s to bring the newest set; 2.8 s since sending waits while much is
unacknowledged. Linux reports how much is (SIOCOUTQ, tcp(7)). Datagrams are never held; other systems do not report it.
"""

from __future__ import annotations

import errno
import fcntl
import re
import socket
import struct
import termios
from collections.abc import Iterable
from pathlib import Path

_STREAM = re.compile(r"^(?:tcp|tls)/(.*):(\d+)$")
_DESCRIPTORS = Path("/proc/self/fd")
_GONE = {errno.EBADF, errno.ENOTSOCK, errno.ENOTCONN, errno.ENOTTY, errno.EINVAL, errno.ENOENT, errno.EOPNOTSUPP}


class Backlog:
    """Looks after the sockets of the links that a zenoh session names. Not for use by several threads."""

    def __init__(self) -> None:
        self._peers: tuple[str, ...] = ()
        self._descriptors: dict[str, int | None] = {}

    def unacknowledged(self, peers: Iterable[str]) -> int:
        """Bytes that wait for the ground where least wait; `peers` are the links' far ends, such as tcp/10.0.0.9:51234.

        The least, so that a ground that is cut off does not silence the aircraft for one that is not. 0 without peers,
        and where it cannot be known.
        """
        now = tuple(sorted(peers))
        if now != self._peers:
            self._peers = now
            self._descriptors = {peer: _descriptor(peer) for peer in now}
        waiting = [_waiting(descriptor, peer) for peer, descriptor in self._descriptors.items()]
        return min(waiting, default=0)


def _address(peer: str) -> tuple[str, int] | None:
    found = _STREAM.match(peer)
    return None if found is None else (found[1].strip("[]"), int(found[2]))


def _descriptor(peer: str) -> int | None:
    """The descriptor of this process's stream to a far end."""
    address = _address(peer)
    if address is None or not _DESCRIPTORS.is_dir():
        return None
    for entry in _DESCRIPTORS.iterdir():
        if _peer_of(int(entry.name)) == address:
            return int(entry.name)
    return None


def _peer_of(descriptor: int) -> tuple[str, int] | None:
    """The address a descriptor is connected to; None if it is no such socket. It stays its owner's and stays open."""
    try:
        stream = socket.socket(fileno=descriptor)
    except OSError as error:
        if error.errno in _GONE:
            return None
        raise
    try:
        if stream.family not in (socket.AF_INET, socket.AF_INET6) or stream.type != socket.SOCK_STREAM:
            return None
        host, port = stream.getpeername()[:2]
        return host, port
    except OSError as error:
        if error.errno in _GONE:
            return None
        raise
    finally:
        stream.detach()


def _waiting(descriptor: int | None, peer: str) -> int:
    if descriptor is None or _peer_of(descriptor) != _address(peer):
        return 0
    try:
        (count,) = struct.unpack("i", fcntl.ioctl(descriptor, termios.TIOCOUTQ, struct.pack("i", 0)))
    except OSError as error:
        if error.errno in _GONE:  # it was closed this very moment
            return 0
        raise
    return int(count)
