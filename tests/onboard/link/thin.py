"""A thin, lossy, cuttable link in user space: what a radio does to TCP and UDP, on the loopback interface.

Each way has a bit rate and a queue without end, as a radio's; a cut loses datagrams and holds streams (TCP sends again
what was lost, so nothing else is seen of a cut above it); loss is for datagrams only. Bytes are counted on the way.
"""

import contextlib
import random
import select
import socket
import threading
import time
from collections import deque
from dataclasses import dataclass, field
from types import TracebackType
from typing import Self

# What each chunk of a stream costs below: IP and TCP headers with time stamps.
STREAM_HEADERS, DATAGRAM_HEADERS = 52, 28


@dataclass
class Way:
    queue: deque[bytes] = field(default_factory=deque)
    free_at_s: float = 0.0


class ThinLink:
    """Listens at `endpoint` and passes everything on to `target` (both zenoh endpoints, tcp/ or udp/)."""

    def __init__(
        self, target: str, *, bit_rate: float = 1e9, loss: float = 0.0, delay_s: float = 0.0, seed: int = 1
    ) -> None:
        self.is_stream = target.startswith("tcp/") or target.startswith("tls/")
        host, port = target.split("/", 1)[1].rsplit(":", 1)
        self._target = host, int(port)
        self.bit_rate, self.loss, self.delay_s = bit_rate, loss, delay_s
        self.is_cut = False
        self.down: list[tuple[float, int]] = []  # when, and bytes with headers, from the target
        self.lost = 0
        self._random = random.Random(seed)
        self._stop = threading.Event()
        kind = socket.SOCK_STREAM if self.is_stream else socket.SOCK_DGRAM
        self._socket = socket.socket(socket.AF_INET, kind)
        self._socket.bind(("127.0.0.1", 0))
        if self.is_stream:
            self._socket.listen()
        self.endpoint = f"{target.split('/', 1)[0]}/127.0.0.1:{self._socket.getsockname()[1]}"
        self._threads: list[threading.Thread] = []
        self._start(self._accept if self.is_stream else self._datagrams)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._stop.set()
        for thread in self._threads:
            thread.join(5.0)
        self._socket.close()

    def cut(self, seconds: float) -> None:
        """Nothing passes for so long; returns when the link is back."""
        self.is_cut = True
        time.sleep(seconds)
        self.is_cut = False

    def most_in(self, window_s: float, since_s: float = 0.0) -> int:
        """The most bytes from the target in any window of time."""
        most = first = total = 0
        for last, (at_s, size) in enumerate(self.down):
            if at_s < since_s:
                first = last + 1
                continue
            total += size
            while at_s - self.down[first][0] > window_s:
                total -= self.down[first][1]
                first += 1
            most = max(most, total)
        return most

    def _start(self, work: object, *args: object) -> None:
        thread = threading.Thread(target=work, args=args, daemon=True)
        thread.start()
        self._threads.append(thread)

    def _accept(self) -> None:
        self._socket.settimeout(0.1)
        while not self._stop.is_set():
            try:
                near, _ = self._socket.accept()
            except TimeoutError:
                continue
            self._start(self._stream, near)

    def _stream(self, near: socket.socket) -> None:
        """One connection. While cut, bytes stay in the sockets; a connection begun then waits for its answer."""
        far = socket.socket()
        with near, far:
            while self.is_cut and not self._stop.is_set():
                time.sleep(0.02)
            far.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)  # a cut is felt at the sender at once
            try:
                far.connect(self._target)
            except OSError:
                return
            for end in (near, far):
                end.setblocking(False)
            ways = {near: Way(), far: Way()}
            other = {near: far, far: near}
            while not self._stop.is_set():
                if self.is_cut:
                    time.sleep(0.02)
                    continue
                readable, _, _ = select.select([end for end in ways if not ways[end].queue], [], [], 0.005)
                for end in readable:
                    try:
                        chunk = end.recv(1400)
                    except OSError:
                        return
                    if not chunk:
                        return
                    self._charge(ways[end], len(chunk) + STREAM_HEADERS, is_down=end is far)
                    ways[end].queue.append(chunk)
                for end, way in ways.items():
                    if way.queue and time.monotonic() >= way.free_at_s:
                        try:
                            sent = other[end].send(way.queue[0])
                        except BlockingIOError:
                            continue
                        except OSError:
                            return
                        if sent == len(way.queue[0]):
                            way.queue.popleft()
                        else:
                            way.queue[0] = way.queue[0][sent:]

    def _datagrams(self) -> None:
        """Every ground gets a socket of its own towards the target, as through an address translator."""
        queue: deque[tuple[float, socket.socket, bytes, tuple[str, int]]] = deque()
        far: dict[tuple[str, int], socket.socket] = {}
        near_of: dict[socket.socket, tuple[str, int]] = {}
        up, down = Way(), Way()
        while not self._stop.is_set():
            readable, _, _ = select.select([self._socket, *near_of], [], [], 0.005)
            for end in readable:
                try:
                    data, sender = end.recvfrom(65536)
                except OSError:
                    continue
                is_down = end is not self._socket
                if not is_down and sender not in far:
                    far[sender] = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
                    far[sender].connect(self._target)
                    near_of[far[sender]] = sender
                if self.is_cut or self._random.random() < self.loss:
                    self.lost += is_down
                    continue
                way = down if is_down else up
                self._charge(way, len(data) + DATAGRAM_HEADERS, is_down=is_down)
                out, to = (self._socket, near_of[end]) if is_down else (far[sender], self._target)
                queue.append((way.free_at_s, out, data, to))
            for _ in range(len(queue)):
                due_s, out, data, to = queue.popleft()
                if due_s > time.monotonic():
                    queue.append((due_s, out, data, to))
                    continue
                with contextlib.suppress(OSError):
                    out.send(data) if out is not self._socket else out.sendto(data, to)
        for end in near_of:
            end.close()

    def _charge(self, way: Way, size: int, *, is_down: bool) -> None:
        now_s = time.monotonic()
        way.free_at_s = max(way.free_at_s, now_s + self.delay_s) + 8.0 * size / self.bit_rate
        if is_down:
            self.down.append((now_s, size))
