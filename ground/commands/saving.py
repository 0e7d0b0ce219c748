"""A file of a command's own, written whole."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

from contract.errors import InputError


def save(path: Path, content: str | bytes) -> None:
    """First a file next to it: nothing half-written has the name. Raises InputError."""
    subscriptions = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        subscriptions.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)
        subscriptions.replace(path)
    except OSError as error:
        with contextlib.suppress(OSError):
            subscriptions.unlink()
        raise InputError(f"{path}: {error.strerror}") from error
