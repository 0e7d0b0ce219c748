"""mavsdk within our process: its threads call into Python, and outlive a careless owner."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
MANY_ENDS = """
import faulthandler, threading, time
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from onboard.config.schema import parse_config
from onboard.events.session_clock import SessionClock
from onboard.telemetry.mavsdk_source import MavsdkEnd

faulthandler.enable()
BEAT = mavlink.MAVLink_heartbeat_message(1, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, 4, 3)
BEAT = BEAT.pack(mavlink.MAVLink(None, 1, 1))
config, clock, made = parse_config("[telemetry]\\nsystem = 1"), SessionClock.start(), []

def come_and_go():
    begun = time.monotonic()
    while time.monotonic() < begun + 2.0 or (len(made) <= 20 and time.monotonic() < begun + 60.0):
        one = MavsdkEnd(config, clock)
        one.take(BEAT, 0)
        one.close()
        made.append(one)

threads = [threading.Thread(target=come_and_go) for _ in range(4)]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
print(len(made))
"""


def test_ends_that_come_and_go_next_to_each_other_do_not_end_the_process() -> None:
    """Two vehicles' links opened at one moment crashed it: one's log callback was freed while the other wrote."""
    command = [sys.executable, "-c", MANY_ENDS]
    ran = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False)
    assert ran.returncode == 0, ran.stderr[-2000:]
    assert int(ran.stdout.split()[-1]) > 20
