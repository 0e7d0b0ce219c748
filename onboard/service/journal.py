"""The log of the service: lines on stdout; under journald each with its priority, <3> to <7>, in front."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Mapping
from typing import TextIO

from contract.secrets import without_secrets

_PRIORITIES = ((logging.CRITICAL, 2), (logging.ERROR, 3), (logging.WARNING, 4), (logging.INFO, 6), (0, 7))


class _Formatter(logging.Formatter):
    """Without secrets, also in the traceback of an error that was not foreseen."""

    def format(self, record: logging.LogRecord) -> str:
        return without_secrets(super().format(record))


class _JournalFormatter(_Formatter):
    """journald makes an entry of each line, so each line of a traceback bears the priority."""

    def format(self, record: logging.LogRecord) -> str:
        priority = next(priority for level, priority in _PRIORITIES if record.levelno >= level)
        return "\n".join(f"<{priority}>{line}" for line in super().format(record).splitlines())


def is_journal(stream: TextIO, environment: Mapping[str, str] = os.environ) -> bool:
    """Return whether a stream leads to journald: $JOURNAL_STREAM names its device and inode (systemd.exec(5))."""
    named = environment.get("JOURNAL_STREAM", "")
    try:
        status = os.fstat(stream.fileno())
    except (OSError, ValueError):
        return False
    return named == f"{status.st_dev}:{status.st_ino}"


def set_up(stream: TextIO = sys.stdout, environment: Mapping[str, str] = os.environ) -> None:
    """Everything of this project from INFO up, others' warnings; times only where nothing else writes them."""
    handler = logging.StreamHandler(stream)
    if is_journal(stream, environment):
        handler.setFormatter(_JournalFormatter("%(message)s"))
    else:
        handler.setFormatter(_Formatter("%(asctime)s %(levelname)-7s %(message)s"))
    root = logging.getLogger()
    root.handlers[:] = [handler]
    root.setLevel(logging.WARNING)
    logging.getLogger("pointclick").setLevel(logging.INFO)
    logging.captureWarnings(True)
