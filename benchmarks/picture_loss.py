"""`python -m benchmarks.picture_loss`: a picture sent whole, or in pieces, over a lossy radio.

The reason for how `contract.wire.picture_code` cuts pictures. Real zenoh sessions with our configuration in two network
namespaces (needs root, or user namespaces), joined by two tunnels between which every IP packet is lost by chance and
carried at a bit rate; so a datagram that IP had to cut is lost with any of its fragments.
"""

from __future__ import annotations

import argparse
import fcntl
import json
import os
import random
import select
import socket
import statistics
import struct
import subprocess
import sys
import threading
import time
from collections import defaultdict, deque
from pathlib import Path

import zenoh

from contract.link_config import link_config
from contract.topics import FEATURES, PICTURE, Topic
from contract.wire.parity import groups_of

PORT = 17448
AIRCRAFT, GROUND = "10.77.0.1", "10.77.0.2"
MTU = 1500
PIECE_BYTES = 1150  # of a picture, in a packet of 1250
SET_BYTES, SET_HZ = 600, 5.0
SIZES = (1000, 3000, 6000, 12000, 24000)
WAYS = ("one message", "pieces", "pieces and parity")  # the last is what `contract.wire.picture_code` does
HEAD = struct.Struct("<BHBBd")  # way, picture, piece, pieces without parity, when it was sent
REST_BYTES = 30  # of a piece's head, that HEAD leaves
_TUNSETIFF, _IFF_TUN_WITHOUT_HEAD = 0x400454CA, 0x1001


def tunnel(name: str, address: str, far: str) -> int:
    """A tunnel of this namespace: its descriptor, from which whole IP packets are read."""
    descriptor = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    fcntl.ioctl(descriptor, _TUNSETIFF, struct.pack("16sH22x", name.encode(), _IFF_TUN_WITHOUT_HEAD))
    for words in (
        "link set lo up",
        f"addr add {address} peer {far} dev {name}",
        f"link set {name} mtu {MTU} up",
    ):
        subprocess.run(["ip", *words.split()], check=True)
    return descriptor


class Radio:
    """Carries packets between two tunnels: each way loses some and has a bit rate and a queue."""

    def __init__(self, aircraft: int, ground: int, loss: float, bit_rate: float) -> None:
        self._ends, self.loss, self._bit_rate = (aircraft, ground), loss, bit_rate
        self.carried = [0, 0]  # bytes that came in from the aircraft, and from the ground
        self._random, self._stop = random.Random(1), threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        queues: list[deque[tuple[float, bytes]]] = [deque(), deque()]
        free_s = [0.0, 0.0]
        while not self._stop.is_set():
            waiting = [queue[0][0] for queue in queues if queue]
            wait_s = max(min(waiting) - time.monotonic(), 0.0) if waiting else 0.05
            readable, _, _ = select.select(self._ends, [], [], min(wait_s, 0.05))
            now_s = time.monotonic()
            for end in readable:
                way = self._ends.index(end)
                packet = os.read(end, 2048)
                if packet[0] >> 4 != 4:
                    continue
                self.carried[way] += len(packet)
                free_s[way] = max(free_s[way], now_s) + 8.0 * len(packet) / self._bit_rate
                if self._random.random() >= self.loss:
                    queues[way].append((free_s[way], packet))
            for way, queue in enumerate(queues):
                while queue and queue[0][0] <= time.monotonic():
                    os.write(self._ends[1 - way], queue.popleft()[1])

    def close(self) -> None:
        """Carry nothing more."""
        self._stop.set()
        self._thread.join(2.0)


def listen(kind: str, descriptor: int) -> None:
    """The ground, in a namespace of its own: writes down what comes until its input ends."""
    with socket.socket(fileno=descriptor) as way_back:
        made = tunnel("ground", GROUND, AIRCRAFT)
        socket.send_fds(way_back, [b"."], [made])
    found: list[tuple[int, int, int, int, float]] = []
    delays_s: list[float] = []

    def received(sample: zenoh.Sample) -> None:
        way, number, piece, needed, sent_s = HEAD.unpack_from(sample.payload.to_bytes())
        late_s = time.monotonic() - sent_s
        if str(sample.key_expr).endswith("features"):
            delays_s.append(late_s)
        else:
            found.append((way, number, piece, needed, late_s))

    config = link_config("peer", connect=[f"{kind}/{AIRCRAFT}:{PORT}"])
    with opened(config) as session:
        subscribers = [session.declare_subscriber(f"pc/uav/{name}", received) for name in ("picture", "features")]
        sys.stdin.read()
        assert subscribers
    json.dump({"pieces": found, "delays_s": delays_s}, sys.stdout)


def opened(text: str) -> zenoh.Session:
    """A session of ours that does not pass large messages through the memory that both ends share here."""
    config = zenoh.Config.from_json5(text)
    config.insert_json5("transport/shared_memory/enabled", "false")
    return zenoh.open(config)


def declared(session: zenoh.Session, topic: Topic) -> zenoh.Publisher:
    """Declare a publisher as the aircraft's does."""
    qos = topic.qos
    return session.declare_publisher(
        topic.key("uav"),
        congestion_control=getattr(zenoh.CongestionControl, qos.congestion_control),
        priority=getattr(zenoh.Priority, qos.priority),
        express=qos.express,
        reliability=getattr(zenoh.Reliability, qos.reliability),
    )


def is_received(publisher: zenoh.Publisher) -> bool:
    """Return whether the publisher has a subscriber."""
    return bool(getattr(publisher.matching_status, "matching", False))


def messages(way: int, number: int, size: int) -> list[bytes]:
    """A picture of `size` bytes as one of WAYS sends it."""
    if way == 0:
        return [HEAD.pack(way, number, 0, 1, time.monotonic()) + os.urandom(size)]
    needed = -(-size // PIECE_BYTES)
    more = groups_of(needed) if way == 2 else 0
    return [
        HEAD.pack(way, number, piece, needed, time.monotonic()) + os.urandom(-(-size // needed) + REST_BYTES)
        for piece in range(needed + more)
    ]


def is_whole(came: dict[int, float], needed: int) -> bool:
    """Return whether the pieces that came make the picture."""
    groups = max(groups_of(needed), 1)
    return all(
        sum(i not in came for i in range(group, needed, groups)) <= (needed + group in came) for group in range(groups)
    )


def measure(kind: str, loss: float, bit_rate: float, pictures: int, size: int) -> list[str]:
    """Rows of the table: each way to send pictures of this size, with sets in addition."""
    near, far = socket.socketpair()
    command = ["unshare", "--net", sys.executable, "-m", "benchmarks.picture_loss"]
    ground = subprocess.Popen(
        [*command, "--ground", kind, "--descriptor", str(far.fileno())],
        pass_fds=[far.fileno()], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
    )  # fmt: skip
    _, (far_tunnel,), _, _ = socket.recv_fds(near, 1, 1)
    near_tunnel = tunnel("aircraft", AIRCRAFT, GROUND)
    radio = Radio(near_tunnel, far_tunnel, 0.0, bit_rate)
    config = link_config("peer", listen=[f"{kind}/{AIRCRAFT}:{PORT}"], is_aircraft=True)
    carried: dict[int, float] = defaultdict(float)
    with opened(config) as session:
        sets = declared(session, FEATURES)
        picture = declared(session, PICTURE)
        while not (is_received(sets) and is_received(picture)):
            time.sleep(0.05)
        radio.loss = loss
        stop = threading.Event()

        def say_sets() -> None:
            while not stop.wait(1.0 / SET_HZ):
                sets.put(HEAD.pack(0, 0, 0, 0, time.monotonic()) + os.urandom(SET_BYTES))

        saying = threading.Thread(target=say_sets)
        saying.start()
        for number in range(pictures):
            for way in range(len(WAYS)):
                before = radio.carried[0]
                for message in messages(way, number, size):
                    picture.put(message)
                    # Pieces go as the budget lets them: here at three quarters of the radio's rate.
                    time.sleep(8.0 * (len(message) + 90) / (0.75 * bit_rate))
                carried[way] += radio.carried[0] - before
        time.sleep(1.0)
        stop.set()
        saying.join()
        received = json.loads(ground.communicate(b"")[0])
    radio.close()
    for descriptor in (near_tunnel, far_tunnel):
        os.close(descriptor)
    rows = []
    for way, name in enumerate(WAYS):
        came: dict[int, dict[int, float]] = defaultdict(dict)
        needed = 1
        for its_way, number, piece, its_needed, late_s in received["pieces"]:
            if its_way == way:
                came[number][piece] = late_s
                needed = its_needed
        whole = sum(is_whole(pieces, needed) for pieces in came.values()) / pictures
        cost = carried[way] / pictures
        per_whole = f"{cost / whole:.0f}" if whole else "-"
        rows.append(f"| {kind} | {size} | {name} | {100 * whole:.0f} % | {cost:.0f} | {per_whole} |")
    late = sorted(received["delays_s"])
    said = f"sets besides, {kind}, {size}: median {statistics.median(late):.3f} s, worst {late[-1]:.3f} s"
    print(said, file=sys.stderr)
    return rows


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pictures", type=int, default=60, help="of each size and way")
    parser.add_argument("--loss", type=float, default=0.1, help="share of IP packets lost, each way")
    parser.add_argument("--bit-rate", type=float, default=2e6)
    parser.add_argument("--kinds", nargs="+", default=["udp", "tcp"])
    parser.add_argument("--sizes", nargs="+", type=int, default=SIZES)
    parser.add_argument("--inside", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--ground", help=argparse.SUPPRESS)
    parser.add_argument("--descriptor", type=int, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.ground:
        listen(arguments.ground, arguments.descriptor)
        return
    if not arguments.inside:
        unshare = ["unshare", "--net", *([] if os.geteuid() == 0 else ["--map-root-user"])]
        again = [sys.executable, "-m", "benchmarks.picture_loss", *sys.argv[1:], "--inside"]
        raise SystemExit(subprocess.run([*unshare, *again], check=False, cwd=Path.cwd()).returncode)
    print(
        f"{100 * arguments.loss:.0f} % of IP packets lost each way, MTU {MTU}, {arguments.pictures} pictures a row.\n"
    )
    print("| link | bytes of picture | sent as | whole on the ground | bytes sent a picture | a whole one |")
    print("|---|---|---|---|---|---|")
    for kind in arguments.kinds:
        for size in arguments.sizes:
            for row in measure(kind, arguments.loss, arguments.bit_rate, arguments.pictures, size):
                print(row, flush=True)


if __name__ == "__main__":
    main()
