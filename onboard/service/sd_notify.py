"""Messages to systemd: sd_notify(3) in the standard library. Without systemd every message is lost."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Mapping


class Notifier:
    """Reports our state to the service manager. A manager that does not listen is no reason to stop."""

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        self._address = environment.get("NOTIFY_SOCKET", "")
        self._last_status = ""
        self.watchdog_s = _watchdog_s(environment)

    def ready(self) -> None:
        """Started, or done with reloading."""
        self._send("READY=1")

    def reloading(self) -> None:
        """A reload has begun; `ready` ends it."""
        self._send(f"RELOADING=1\nMONOTONIC_USEC={time.monotonic_ns() // 1000}")

    def stopping(self) -> None:
        self._send("STOPPING=1")

    def status(self, text: str) -> None:
        """One line for `systemctl status`; the same line is sent once."""
        line = " ".join(text.split())
        if line != self._last_status:
            self._last_status = line
            self._send(f"STATUS={line}")

    def feed_watchdog(self) -> None:
        """Report that we are alive. After more than `watchdog_s` without it the manager ends us and starts us again."""
        if self.watchdog_s is not None:
            self._send("WATCHDOG=1")

    def _send(self, text: str) -> None:
        if not self._address:
            return
        # A leading @ stands for the zero byte of an abstract socket.
        address = "\0" + self._address[1:] if self._address.startswith("@") else self._address
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as to_manager:
            try:
                to_manager.connect(address)
                to_manager.sendall(text.encode())
            except OSError:
                return


def _watchdog_s(environment: Mapping[str, str]) -> float | None:
    """WatchdogSec= as the manager hands it down; None if it is off or meant for another process."""
    micros = environment.get("WATCHDOG_USEC", "")
    for_whom = environment.get("WATCHDOG_PID", str(os.getpid()))
    if not micros.isdecimal() or int(micros) == 0 or for_whom != str(os.getpid()):
        return None
    return int(micros) / 1e6
