"""Slow clients: the page answers others throughout, what they may hold is bounded, and they cannot fill a log."""

from __future__ import annotations

import http.client
import logging
import os
import resource
import shlex
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from ground.web.gate import HEADERS_S, Gate, LoggedOnce
from tests.waiting import PATIENCE_S
from tests.web.conftest import page_is_built
from tests.web.served import ROOT, Simulated

pytestmark = pytest.mark.xdist_group("web: served alone")

TOKEN = "a-token-of-some-length"
HALF_OPEN = 1000
HALF_A_REQUEST = b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Slow: a"


class Held:
    def __init__(self) -> None:
        self.sockets: list[socket.socket] = []

    def __enter__(self) -> Held:
        return self

    def __exit__(self, *_: object) -> None:
        for one in self.sockets:
            one.close()

    def open(self, port: int, sends: bytes) -> None:
        made = socket.create_connection(("127.0.0.1", port), PATIENCE_S)
        made.sendall(sends)
        self.sockets.append(made)


@pytest.mark.long
@pytest.mark.wall_clock
def test_a_thousand_half_open_connections_leave_the_page_answering(simulated: Simulated, tmp_path: Path) -> None:
    page_is_built()
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if hard < 3000 and hard != resource.RLIM_INFINITY:
        pytest.fail(f"this test opens {HALF_OPEN} connections, and the limit of descriptors is {hard}")
    resource.setrlimit(resource.RLIMIT_NOFILE, (3000, hard))
    log = tmp_path / "log.txt"
    arguments = "web", "--port", "0", "--token", TOKEN, "--from", simulated.path, "--pins", tmp_path / "pins.sqlite"
    command = shlex.join(map(str, (sys.executable, "-m", "ground", *arguments)))
    with log.open("wb") as out, Held() as held:
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": "1"}
        server = subprocess.Popen(
            ["bash", "-c", f"ulimit -n 1024; exec {command}"],
            stdout=out, stderr=subprocess.STDOUT, cwd=ROOT, env=environment,
        )  # fmt: skip
        try:
            until_s = time.monotonic() + PATIENCE_S
            while b"Ctrl-C" not in log.read_bytes():
                assert time.monotonic() < until_s and server.poll() is None, log.read_text()
                time.sleep(0.05)
            port = int(log.read_text().split("127.0.0.1:")[1].split("/")[0])
            attack = threading.Thread(target=lambda: [held.open(port, HALF_A_REQUEST) for _ in range(HALF_OPEN)])
            attack.start()
            worst_s, answered = 0.0, 0
            while attack.is_alive() or answered < 10:
                began_s = time.monotonic()
                client = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
                client.request("GET", "/api/pins", headers={"Authorization": f"Bearer {TOKEN}"})
                assert client.getresponse().status == 200
                client.close()
                worst_s, answered = max(worst_s, time.monotonic() - began_s), answered + 1
            attack.join()
            descriptors = len(list(Path(f"/proc/{server.pid}/fd").iterdir()))
        finally:
            server.terminate()
            server.wait(PATIENCE_S)
            resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    print(f"\n{answered} answers among {len(held.sockets)} half-open connections, at worst after {worst_s:.3f} s")
    assert len(held.sockets) == HALF_OPEN
    assert worst_s < 0.8 * HEADERS_S  # none waits for the time limit of others; goal: 1, where nothing else runs
    assert descriptors < 900
    printed = [line for line in log.read_text().splitlines() if "closed" in line or "rror" in line]
    assert len(printed) == 1, printed


def test_a_connection_that_owes_its_headers_is_closed_and_one_that_does_not_is_not() -> None:
    gate = Gate(10)
    ours, theirs = socket.socketpair()
    busy, other = socket.socketpair()
    with ours, theirs, busy, other:
        assert gate.admit(ours, ("10.0.0.1", 1))
        assert gate.admit(busy, ("10.0.0.1", 2))
        gate.expect(("10.0.0.1", 2), None)
        gate.expect(("10.0.0.1", 1), -1.0)
        gate.sweep()
        assert (len(gate), gate.closed) == (1, 1)
        assert theirs.recv(1) == b""
        other.sendall(b"x")
        assert busy.recv(1) == b"x"
    assert HEADERS_S <= 15.0


def test_one_address_does_not_keep_another_out() -> None:
    gate = Gate(6, waiting_of_one=100)
    pairs = [socket.socketpair() for _ in range(9)]
    try:
        for k in range(6):
            assert gate.admit(pairs[k][0], ("10.0.0.1", k))
        assert gate.admit(pairs[6][0], ("10.0.0.2", 0))  # in place of the oldest of the address that has most
        assert (len(gate), gate.closed) == (6, 1)
        assert pairs[0][1].recv(1) == b""
        for peer in [("10.0.0.1", k) for k in range(1, 6)] + [("10.0.0.2", 0)]:
            gate.expect(peer, None)
        assert not gate.admit(pairs[7][0], ("10.0.0.3", 0))  # all are being answered
    finally:
        for pair in pairs:
            for one in pair:
                one.close()


def test_a_line_that_anybody_can_provoke_is_written_once() -> None:
    once = LoggedOnce()

    def record(text: str) -> logging.LogRecord:
        return logging.LogRecord("uvicorn.error", logging.WARNING, "", 0, text, None, None)

    assert [once.filter(record("Invalid HTTP request received.")) for _ in range(3)] == [True, False, False]
    assert once.filter(record("another"))
