"""A small MAVLink router on the loopback interface, by the rules that ArduPilot, PX4 and mavlink-router have.

Whoever is received on a link is reached there; a packet with a target goes to that link alone, one without to all
others.
"""

import select
import socket
import threading
from types import TracebackType
from typing import Any, Self

import serial
from pymavlink.dialects.v20 import ardupilotmega as mavlink


class Udp:
    """A link to one program that listens at a port."""

    def __init__(self, port: int) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.connect(("127.0.0.1", port))
        self.socket.setblocking(False)

    def fileno(self) -> int:
        return self.socket.fileno()

    def read(self) -> bytes:
        try:
            return self.socket.recv(65536)
        except OSError:  # no one listens there now
            return b""

    def write(self, packet: bytes) -> None:
        try:
            self.socket.send(packet)
        except OSError:
            return

    def close(self) -> None:
        self.socket.close()


class Line:
    """The autopilot's serial line, by `telemetry.url`."""

    def __init__(self, url: str) -> None:
        self.port = serial.Serial(url.split(":")[1], timeout=0)

    def fileno(self) -> int:
        return int(self.port.fileno())

    def read(self) -> bytes:
        return bytes(self.port.read(65536))

    def write(self, packet: bytes) -> None:
        self.port.write(packet)

    def close(self) -> None:
        self.port.close()


class Router:
    """Runs while entered. `passed`: type, sender and receivers (numbers of links) of every packet."""

    def __init__(self, *links: Udp | Line) -> None:
        self.links = links
        self.passed: list[tuple[Any, int, list[int]]] = []
        self._seen: list[set[tuple[int, int]]] = [set() for _ in links]
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._stop.set()
        self._thread.join(5.0)
        for link in self.links:
            link.close()

    def _run(self) -> None:
        parsers = [mavlink.MAVLink(None) for _ in self.links]
        for parser in parsers:
            parser.robust_parsing = True
        while not self._stop.is_set():
            readable, _, _ = select.select(self.links, [], [], 0.05)
            for number, link in enumerate(self.links):
                if link in readable:
                    for message in parsers[number].parse_buffer(link.read()) or ():
                        if message.get_type() != "BAD_DATA":
                            self._route(message, number)

    def _route(self, message: Any, came: int) -> None:
        self._seen[came].add((message.get_srcSystem(), message.get_srcComponent()))
        to = [number for number in range(len(self.links)) if number != came and self._is_for(message, number)]
        self.passed.append((message, came, to))
        for number in to:
            self.links[number].write(bytes(message.get_msgbuf()))

    def _is_for(self, message: Any, number: int) -> bool:
        system, component = getattr(message, "target_system", 0), getattr(message, "target_component", 0)
        seen = self._seen[number]
        return system == 0 or (system, component) in seen or (component == 0 and system in {s for s, _ in seen})
