"""`python -m tests.onboard.link.forwarding_autopilot TLOG ONBOARD GROUND`: a recorded autopilot that forwards.

It plays its log on the UDP ports of a companion and of a radio, and passes on what they send to each other.
"""

import json
import signal
import subprocess
import sys
import threading

from tests.onboard.link.mavlink_router import Line, Router, Udp


def main() -> int:
    ended = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: ended.set())
    log, onboard, ground = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    command = [sys.executable, "-m", "simulation.autopilot", "--tlog", log, "--url", "pty", "--loop", "--everything"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True) as plays:
        assert plays.stdout is not None
        try:
            with Router(Line(json.loads(plays.stdout.readline())["url"]), Udp(onboard), Udp(ground)):
                ended.wait()
        finally:
            plays.terminate()
    return 0


if __name__ == "__main__":
    sys.exit(main())
