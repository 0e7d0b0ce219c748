"""The number of a session: the clock's second as it begins, and higher than that of any session before it.

A computer without a clock battery may begin with an earlier time than it ended with, or with the same at every start.
By its number a ground knows a later session from packets of an earlier one, so the last one is kept in a file.
"""

from __future__ import annotations

from pathlib import Path

from contract.errors import InputError
from onboard.storage.alignment_file import StateFile

FILE_NAME = "last_session"
MOST = 0xFFFFFFFF  # that the wire carries


def next_session(folder: Path, now_ns: int) -> tuple[int, str]:
    """The number of the session that begins now, kept in the state folder; and why it could not be kept, if so."""
    second = now_ns // 1_000_000_000
    try:
        file = StateFile(folder / FILE_NAME)
        text = file.text().strip()
        last = int(text) if text.isascii() and text.isdecimal() and len(text) <= 10 else 0
        number = min(max(second, last + 1 if last < MOST else 1), MOST)
        file.write(f"{number}\n")
    except InputError as error:
        return min(max(second, 1), MOST), str(error)
    return number, ""
