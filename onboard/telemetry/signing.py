"""MAVLink 2 signing: the key file, and what makes a pymavlink end sign and accept only what is signed."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from contract.errors import ConfigError
from contract.signing_key import signing_key

EPOCH_S = 1_420_070_400  # signatures count ten microseconds since 2015
LINK = 1


def read_key(path: str) -> bytes:
    """32 bytes, raw or as 64 hexadecimal digits. Raises ConfigError, one line, for anything else."""
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise ConfigError(f"telemetry.signing_key {path}: {error.strerror}") from error
    try:
        return signing_key(data)
    except ValueError as error:
        raise ConfigError(f"telemetry.signing_key {path}: {error}") from error


def sign(end: Any, key: bytes) -> None:
    """Give a pymavlink `MAVLink` its key: what it packs is signed, and what is not signed is refused."""
    end.signing.secret_key = key
    end.signing.link_id = LINK
    end.signing.sign_outgoing = True
    keep_time(end)


def keep_time(end: Any) -> None:
    """Let signatures' time keep up with the host's; it never goes back, nor behind what the other end uses."""
    end.signing.timestamp = max(end.signing.timestamp, round((time.time() - EPOCH_S) * 1e5))
