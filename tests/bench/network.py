"""The radio: a veth pair between the host and the guest's vec0, whose kernel can lose and delay packets on it."""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tests.bench.image.host import BenchError, run
from tests.bench.machine import GUEST_MAC, Machine

HOST_MAC = "02:00:00:99:00:01"
PAIRS = 64
"""Benches that may run side by side, each with a /30 of its own."""


@dataclass(frozen=True)
class Link:
    """The pair's two ends."""

    interface: str
    """The end that User Mode Linux takes."""
    host: str
    guest: str
    near: str
    """The host's end."""

    def received_bytes(self) -> int:
        """What the guest has sent so far, frames of Ethernet as they came."""
        return int(Path(f"/sys/class/net/{self.near}/statistics/rx_bytes").read_text())

    def up(self, machine: Machine) -> None:
        """Give the guest its address, and each end the other's hardware address: no one waits for ARP."""
        machine.shell(
            f"ip addr add {self.guest}/30 dev vec0 && ip link set vec0 up"
            f" && ip neigh replace {self.host} lladdr {HOST_MAC} dev vec0"
        )

    def impair(self, machine: Machine, words: str) -> None:
        """What the guest sends from now on, in netem's words ("loss 10% delay 80ms"); empty: nothing amiss."""
        machine.shell("tc qdisc del dev vec0 root 2>/dev/null || true")
        if words:
            machine.shell(f"tc qdisc add dev vec0 root netem {words}")


@contextlib.contextmanager
def link() -> Iterator[Link]:
    """A veth pair of its own for as long as the block lasts."""
    number, ours, theirs = _new_pair()
    made = Link(theirs, f"10.213.{number}.1", f"10.213.{number}.2", ours)
    try:
        run(["ip", "link", "set", "dev", ours, "address", HOST_MAC])
        run(["ip", "addr", "add", f"{made.host}/30", "dev", ours])
        for end in (ours, theirs):
            run(["ip", "link", "set", "dev", end, "up"])
            # A veth leaves checksums and segments to a card that is not there; the guest wants whole packets.
            run(["ethtool", "-K", end, "tx", "off", "tso", "off", "gso", "off", "gro", "off"])
        run(["ip", "neigh", "replace", made.guest, "lladdr", GUEST_MAC, "dev", ours])
        yield made
    finally:
        run(["ip", "link", "del", ours])


def _new_pair() -> tuple[int, str, str]:
    for number in range(PAIRS):
        ours, theirs = f"pcbench{number}", f"pcbench{number}uml"
        try:
            run(["ip", "link", "add", ours, "type", "veth", "peer", "name", theirs])
        except BenchError as error:
            if "File exists" not in str(error):
                raise
        else:
            return number, ours, theirs
    raise BenchError(f"{PAIRS} veth pairs named pcbench* exist; remove those left over: ip link del pcbench0")
