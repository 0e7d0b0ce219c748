"""Ports of the loopback interface that no one has, and that no one is given before the test takes them.

The system gives whoever names no port one of its own range. These lie below it, each is given once, and where the next
one is looked for differs from process to process.
"""

import random
import socket

FIRST, LAST = 20_000, 32_000  # below net.ipv4.ip_local_port_range, above what services listen at
_given: set[int] = set()
_chance = random.SystemRandom()


def free_port(kind: socket.SocketKind = socket.SOCK_STREAM) -> int:
    while True:
        port = _chance.randrange(FIRST, LAST)
        if port in _given:
            continue
        with socket.socket(socket.AF_INET, kind) as probe:
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
        _given.add(port)
        return port


def free_endpoint() -> str:
    return f"tcp/127.0.0.1:{free_port()}"


def free_udp_port() -> int:
    return free_port(socket.SOCK_DGRAM)
