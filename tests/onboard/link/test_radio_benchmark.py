"""`benchmarks.radio` against a recorded autopilot that forwards, in the place of a simulator."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from tests.onboard.link.ports import free_udp_port

ROOT = Path(__file__).resolve().parents[3]
LOG = ROOT / "tests" / "data" / "plane_turn.tlog"


def benchmark(*words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "benchmarks.radio", *words]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=120)


def test_without_an_autopilot_it_says_that_nothing_was_measured() -> None:
    done = benchmark()
    assert done.returncode == 0 and "LEFT OUT: no autopilot given" in done.stdout


@pytest.mark.long
@pytest.mark.wall_clock(waits=True)
def test_clicks_through_an_autopilot_are_counted_and_its_own_messages_timed() -> None:
    onboard, ground = free_udp_port(), free_udp_port()
    module = "tests.onboard.link.forwarding_autopilot"
    autopilot = shlex.join([sys.executable, "-m", module, str(LOG), str(onboard), str(ground)])
    done = benchmark(
        "--autopilot", autopilot, "--onboard", f"udpin:127.0.0.1:{onboard}",
        "--ground", f"udpin:127.0.0.1:{ground}", "--seconds", "4",
    )  # fmt: skip
    assert "clicks answered" in done.stdout, done.stderr
    found = re.search(r"(\d+) of (\d+)", done.stdout)
    assert int(found[1]) == int(found[2]) >= 3
    assert done.stdout.count("99 % within") == 2
