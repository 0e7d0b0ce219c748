"""`python -m benchmarks.link`: what a message costs on the wire, IP headers and up.

These are the reasons for the figures in `onboard.link.byte_budget`.

Real zenoh sessions in a network namespace of their own (needs root, or user namespaces), every packet seen by a packet
socket. Our configuration of both ends; certificates made on the spot.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import socket
import struct
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import zenoh

from contract.link_config import Tls, link_config
from contract.topics import ANY_VEHICLE, FEATURES
from onboard.link.certificates import make_credentials

PORT = 17447
SIZES = (60, 600, 1250)
RATE_HZ = 5.0
AGE, REPLY_AGE = b"0.35", b'{"age_s":0.351}'  # as sent with each set
ETH_P_IP, PACKET_OUTGOING = 0x0800, 4


class Wire:
    """Bytes that went each way since `clear`."""

    def __init__(self) -> None:
        self.bytes: Counter[str] = Counter()
        self._stop = threading.Event()
        self._socket = socket.socket(socket.AF_PACKET, socket.SOCK_DGRAM, socket.htons(ETH_P_IP))
        self._socket.bind(("lo", 0))
        self._socket.settimeout(0.2)
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                packet, address = self._socket.recvfrom(70000)
            except TimeoutError:
                continue
            if address[2] == PACKET_OUTGOING:  # the same again, as it arrives
                continue
            (source,) = struct.unpack_from("!H", packet, (packet[0] & 15) * 4)
            self.bytes["down" if source == PORT else "up"] += len(packet)

    def during(self, seconds: float) -> Counter[str]:
        """Count the bytes up and down that pass in so many seconds while nothing is done."""
        self.bytes.clear()
        time.sleep(seconds)
        return Counter(self.bytes)

    def close(self) -> None:
        """Stop looking."""
        self._stop.set()
        self._thread.join(2.0)
        self._socket.close()


@contextlib.contextmanager
def sessions(kind: str, tls: Tls | None, ground_tls: Tls | None) -> Iterator[tuple[zenoh.Session, zenoh.Session]]:
    """An aircraft and a ground."""
    endpoint = f"{kind}/127.0.0.1:{PORT}"

    def opened(text: str) -> zenoh.Session:
        return zenoh.open(zenoh.Config.from_json5(text))

    with (
        opened(link_config("peer", listen=[endpoint], tls=tls, is_aircraft=True)) as aircraft,
        opened(link_config("peer", connect=[endpoint], tls=ground_tls)) as ground,
    ):
        yield aircraft, ground


def row(kind: str, credentials: Path, seconds: float) -> str:
    """One kind of link."""
    is_secure = kind in ("tls", "quic")
    tls, ground_tls = (Tls.in_folder(credentials / n) if is_secure else None for n in ("uav", "ground"))
    key = FEATURES.key("uav")
    wire = Wire()
    with sessions(kind, tls, ground_tls) as (aircraft, ground):
        subscriber = ground.declare_subscriber(FEATURES.key(ANY_VEHICLE), lambda sample: None)
        publisher = aircraft.declare_publisher(
            key,
            congestion_control=zenoh.CongestionControl.DROP,
            express=True,
            reliability=zenoh.Reliability.BEST_EFFORT,
        )
        queryable = aircraft.declare_queryable(key, lambda query: _reply(query, key))
        time.sleep(1.5)
        idle = wire.during(seconds)
        cells = [f"{idle['down'] / seconds:.0f} / {idle['up'] / seconds:.0f}"]
        for size in SIZES:
            count = round(RATE_HZ * seconds)
            wire.bytes.clear()
            for _ in range(count):
                publisher.put(os.urandom(size), attachment=AGE)
                time.sleep(1.0 / RATE_HZ)
            message = (wire.bytes["down"] - idle["down"]) / count - size
            cells.append(f"{message:.0f}")
        wire.bytes.clear()
        for _ in range(20):
            list(ground.get(f"{key}?frame=1"))
        time.sleep(0.2)
        cells.append(f"{wire.bytes['down'] / 20 - 600:.0f}")
        wire.bytes.clear()
        endpoint = f"{kind}/127.0.0.1:{PORT}"
        with zenoh.open(zenoh.Config.from_json5(link_config("client", connect=[endpoint], tls=ground_tls))) as client:
            list(client.get(key))
        time.sleep(0.5)
        cells.append(f"{wire.bytes['down'] - 600:.0f} / {wire.bytes['up']:.0f}")
        subscriber.undeclare()  # type: ignore[no-untyped-call]
        queryable.undeclare()  # type: ignore[no-untyped-call]
    wire.close()
    return f"| {kind} | {' | '.join(cells)} |"


def _reply(query: zenoh.Query, key: str) -> None:
    with query:
        query.reply(key, os.urandom(600), attachment=REPLY_AGE)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=6.0, help="a measurement")
    parser.add_argument("--inside", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if not arguments.inside:
        command = ["unshare", "--net", *([] if os.geteuid() == 0 else ["--map-root-user"])]
        again = [sys.executable, "-m", "benchmarks.link", "--inside", "--seconds", str(arguments.seconds)]
        raise SystemExit(subprocess.run([*command, *again], check=False).returncode)
    subprocess.run(["ip", "link", "set", "lo", "up"], check=True)
    print("Bytes, IP headers included; down is from the aircraft. Messages at 5 Hz, what they add to their payload.\n")
    print(
        f"| link | idle a second, down / up | {' | '.join(f'{n} B adds' for n in SIZES)} | a reply adds "
        "| a click's own session, down / up |"
    )
    print(f"|{'---|' * (len(SIZES) + 4)}")
    with TemporaryDirectory() as folder:
        make_credentials(Path(folder), ["uav"], ["ground"], [], 1.0)
        for kind in ("tcp", "udp", "tls", "quic"):
            print(row(kind, Path(folder), arguments.seconds), flush=True)


if __name__ == "__main__":
    main()
