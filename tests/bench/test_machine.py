"""The bench itself: what the other tests lean on is there, and a guest leaves nothing behind."""

import json
import re
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from simulation.autopilot.fake import FakeAutopilot
from simulation.autopilot.flight import Flight
from tests.bench.image.host import BenchError
from tests.bench.image.root import CHECKOUT
from tests.bench.machine import PYTHON, Machine, boot, processes_of
from tests.bench.network import Link, link

LISTEN = """
import collections, json, time
from pymavlink import mavutil
line = mavutil.mavlink_connection("/dev/ttyS0", 115200)
print("open", flush=True)
counts = collections.Counter()
end = time.monotonic() + 6
while time.monotonic() < end:
    message = line.recv_match(blocking=True, timeout=0.2)
    if message is not None:
        counts[message.get_type()] += 1
print(json.dumps(counts))
"""


@pytest.fixture(scope="module")
def autopilot() -> FakeAutopilot:
    """Plays when entered; its line is there before."""
    return FakeAutopilot(Flight.read(CHECKOUT / "tests" / "data" / "plane_turn.tlog"), "pty", everything=True)


@pytest.fixture(scope="module")
def radio() -> Iterator[Link]:
    with link() as made:
        yield made


@pytest.fixture(scope="module")
def guest(autopilot: FakeAutopilot, radio: Link) -> Iterator[Machine]:
    with boot(serial=Path(autopilot.url.split(":")[1]), interface=radio.interface) as machine:
        radio.up(machine)
        yield machine


def test_it_is_a_linux_with_systemd_as_process_one(guest: Machine) -> None:
    assert guest.shell("cat /proc/1/comm").strip() == "systemd"
    assert guest.shell("uname -r").strip().endswith("-pointclick")
    assert guest.run("systemctl", "is-system-running", "--wait").text.strip() == "running"


def test_exit_codes_and_output_come_back(guest: Machine) -> None:
    done = guest.run("/bin/sh", "-c", "echo out; echo err >&2; exit 7")
    assert (done.code, done.text) == (7, "out\nerr\n")
    long = guest.run("/bin/sh", "-c", "seq 1 20000")
    assert long.text == "".join(f"{number}\n" for number in range(1, 20001))


def test_a_job_that_hangs_is_killed_for_its_time(guest: Machine) -> None:
    before = time.monotonic()
    with pytest.raises(BenchError, match="killed for its time"):
        guest.run("sleep", "100", timeout_s=1.0)
    assert 0.9 < time.monotonic() - before < 5.0


def test_the_two_clocks_run_the_same(guest: Machine) -> None:
    offsets = []
    for _ in range(5):
        offsets.append(guest.clock_offset_ns())
        time.sleep(0.2)
    assert max(offsets) - min(offsets) < 1_000_000


@pytest.mark.parametrize(
    ("words", "least_ms", "most_ms", "lost"),
    [("", 0.0, 20.0, (0, 1)), ("delay 80ms", 79.9, 110.0, (0, 2)), ("loss 10% delay 80ms", 79.9, 110.0, (3, 60))],
)
def test_the_radio_is_as_bad_as_asked(
    guest: Machine, radio: Link, words: str, least_ms: float, most_ms: float, lost: tuple[int, int]
) -> None:
    radio.impair(guest, words)
    reported = guest.run("ping", "-q", "-c", "200", "-i", "0.01", "-W", "1", radio.host).text
    radio.impair(guest, "")
    came = re.search(r"(\d+) received", reported)
    times = re.search(r"= ([\d.]+)/([\d.]+)/", reported)
    assert came is not None and times is not None, reported
    assert lost[0] <= 200 - int(came[1]) <= lost[1], reported
    assert least_ms <= float(times[1]) and float(times[2]) <= most_ms, reported


def test_the_autopilot_is_received_over_the_serial_line_without_loss(guest: Machine, autopilot: FakeAutopilot) -> None:
    job = guest.start([PYTHON, "-c", LISTEN])
    for _ in range(100):
        if "open" in job.text:
            break
        time.sleep(0.1)
    with autopilot:
        time.sleep(4.0)
        autopilot.mute(60.0)  # leaving would close the line, which the guest takes for a hangup
        received = json.loads(job.wait(30.0).ok().splitlines()[-1])
    assert autopilot.counts["ATTITUDE"] > 80
    assert {name: received.get(name, 0) for name in autopilot.counts} == dict(autopilot.counts)


def test_a_guest_leaves_nothing_behind() -> None:
    with link() as radio, boot(interface=radio.interface) as machine:
        folder, session = machine.share.parent, machine.session
        assert processes_of(session)
        machine.start(["sleep", "50"])
    assert not folder.exists()
    assert not processes_of(session)
    assert not Path("/sys/class/net", radio.interface).exists()
