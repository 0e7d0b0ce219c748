"""The end of a program of the ground while a callback of zenoh's is under way."""

import subprocess
import sys
from pathlib import Path

from onboard.link.publisher import Publisher
from tests.onboard.link.ports import free_endpoint
from tests.waiting import PATIENCE_S

ROOT = Path(__file__).resolve().parents[2]
# The link is opened in a daemon thread, as one is that is renewed after a silence.
PROGRAM = """
import sys, threading, time
from ground.client import SetCache

begun, opened = threading.Event(), []

def take(key, payload):
    begun.set()
    until_s = time.monotonic() + 1.0
    while time.monotonic() < until_s:  # comes back to the interpreter whatever that is at
        time.sleep(1e-4)

def open_it():
    opened.append(SetCache(sys.argv[1], subscriptions={"pc/kiwi/status": take}))

thread = threading.Thread(target=open_it, daemon=True)
thread.start()
thread.join()
print("opened", flush=True)
assert begun.wait(60.0)
opened[0].close()
print("closed", flush=True)
sys.exit(2)
"""


def test_it_ends_with_its_own_status_and_aborts_never() -> None:
    endpoint = free_endpoint()
    command = [sys.executable, "-c", PROGRAM, endpoint]
    with Publisher("kiwi", (endpoint,)) as publisher:
        running = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        assert running.stdout is not None and running.stdout.readline() == "opened\n"
        while running.poll() is None:
            publisher.publish_status(b"{}", b"{}")
            try:
                running.wait(0.1)
            except subprocess.TimeoutExpired:
                continue
        printed = running.communicate(timeout=PATIENCE_S)
    assert (running.returncode, printed) == (2, ("closed\n", ""))
