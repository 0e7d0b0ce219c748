"""A file that is written whole or not at all, safe against a loss of power."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

from contract.errors import InputError


def save(path: Path, content: str | bytes, mode: int = 0o666, owner: tuple[int, int] | None = None) -> None:
    """Write a file next to it first, with its owner and mode before there is anything in it: nothing half-written has
    the name. Raises InputError.
    """
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        part.unlink(missing_ok=True)
        with os.fdopen(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "wb") as file:
            if owner is not None:
                os.fchown(file.fileno(), *owner)
                os.fchmod(file.fileno(), mode)
            file.write(content.encode() if isinstance(content, str) else content)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
    except OSError as error:
        with contextlib.suppress(OSError):
            part.unlink()
        raise InputError(f"{path}: {error.strerror}") from error
