"""mavsdk within our process: its threads call into Python, and outlive a careless owner."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
ONE_END = """
import time
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from onboard.config.schema import parse_config
from onboard.events.session_clock import SessionClock
from onboard.telemetry.mavsdk_source import MavsdkEnd

class Line:  # without anybody to send to at first, as a socket that listens
    def __init__(self):
        self.sent, self.known_s = [], time.monotonic() + 1.5
    def write(self, data):
        if time.monotonic() < self.known_s:
            return False
        self.sent.append(bytes(data))
        return True

BEAT = mavlink.MAVLink_heartbeat_message(1, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, 4, 3)
config, line, theirs = parse_config("[telemetry]\\nsystem = 1"), Line(), mavlink.MAVLink(None)
one = MavsdkEnd(config, SessionClock.start())
theirs.srcSystem = theirs.srcComponent = 1
one.attach(line)
asked = mavlink.MAVLink_timesync_message(0, 5)
begun = time.monotonic()
while time.monotonic() < begun + 4.0:
    one.take(BEAT.pack(theirs), 0)
    one.send(asked)
    time.sleep(0.1)
one.close()
ours = mavlink.MAVLink(None)
names = [message.get_type() for data in line.sent for message in ours.parse_buffer(data) or []]
print(names.count("HEARTBEAT"), names.count("TIMESYNC"))
"""
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


def test_of_mavsdk_s_heartbeats_one_in_thirty_seconds_goes_out_and_all_else_does() -> None:
    """An autopilot passes each on to its radio: 21 bytes a second."""
    ran = subprocess.run(
        [sys.executable, "-c", ONE_END], cwd=ROOT, capture_output=True, text=True, timeout=120, check=False
    )
    assert ran.returncode == 0, ran.stderr[-2000:]
    beats, others = map(int, ran.stdout.split()[-2:])
    assert beats == 1 and others >= 10
