"""`pc-onboard` as a program of its own next to this one: where it is, and a port on which it can be reached."""

from __future__ import annotations

import os
import shutil
import socket
import sys
from pathlib import Path

from contract.errors import InputError


def pc_onboard() -> str:
    """The program of this installation, else of the path. Raises InputError if it is nowhere."""
    neighbour = Path(sys.executable).with_name("pc-onboard")
    found = str(neighbour) if os.access(neighbour, os.X_OK) else shutil.which("pc-onboard")
    if found is None:
        raise InputError("pc-onboard is not installed here: install pointclick with [open] or [live]")
    return found


def unused_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
