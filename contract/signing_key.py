"""The key of MAVLink 2's signing, as it lies in a file."""

from __future__ import annotations

KEY_LENGTH = 32


def signing_key(data: bytes) -> bytes:
    """A file's content -> 32 bytes, which it holds raw or as 64 hexadecimal digits. Raises ValueError."""
    try:
        key = data if len(data) == KEY_LENGTH else bytes.fromhex(data.decode("ascii").strip())
    except ValueError:
        key = b""
    if len(key) != KEY_LENGTH:
        raise ValueError(f"not a key of {KEY_LENGTH} bytes, raw or in hexadecimal")
    return key
