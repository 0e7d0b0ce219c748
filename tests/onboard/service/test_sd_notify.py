"""Words to systemd, found at a socket of the same kind."""

import os
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from onboard.service.sd_notify import Notifier


@pytest.fixture(params=["path", "abstract"])
def manager(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[socket.socket, str]]:
    name = str(tmp_path / "notify") if request.param == "path" else f"@pointclick-test-{os.getpid()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as hearing:
        hearing.bind(name.replace("@", "\0"))
        hearing.settimeout(2.0)
        yield hearing, name


def received(manager: socket.socket) -> list[bytes]:
    manager.setblocking(False)
    out = []
    while True:
        try:
            out.append(manager.recv(4096))
        except BlockingIOError:
            return out


def test_every_word_arrives_as_systemd_reads_it(manager: tuple[socket.socket, str]) -> None:
    hearing, name = manager
    notifier = Notifier({"NOTIFY_SOCKET": name, "WATCHDOG_USEC": "10000000", "WATCHDOG_PID": str(os.getpid())})
    assert notifier.watchdog_s == 10.0
    notifier.ready()
    notifier.status("camera lost:\n unplugged")
    notifier.status("camera lost: unplugged")
    notifier.feed_watchdog()
    notifier.reloading()
    notifier.stopping()
    ready, status, fed, reloading, stopping = received(hearing)
    assert (ready, status, fed, stopping) == (
        b"READY=1", b"STATUS=camera lost: unplugged", b"WATCHDOG=1", b"STOPPING=1",
    )  # fmt: skip
    assert reloading.startswith(b"RELOADING=1\nMONOTONIC_USEC=")


@pytest.mark.parametrize(
    "watchdog", [{}, {"WATCHDOG_USEC": "0"}, {"WATCHDOG_USEC": "x"}, {"WATCHDOG_USEC": "9", "WATCHDOG_PID": "1"}]
)
def test_a_watchdog_that_is_not_ours_is_not_fed(manager: tuple[socket.socket, str], watchdog: dict[str, str]) -> None:
    hearing, name = manager
    notifier = Notifier({"NOTIFY_SOCKET": name, **watchdog})
    assert notifier.watchdog_s is None
    notifier.feed_watchdog()
    assert received(hearing) == []


@pytest.mark.parametrize("environment", [{}, {"NOTIFY_SOCKET": "/nonexistent/socket", "WATCHDOG_USEC": "1000"}])
def test_without_a_manager_that_listens_nothing_happens(environment: dict[str, str]) -> None:
    notifier = Notifier(environment)
    notifier.ready()
    notifier.status("ok")
    notifier.feed_watchdog()
