"""The estimates of mount, clock, delays, compass and camera, kept in a file between sessions."""

from __future__ import annotations

from pathlib import Path

from contract.errors import InputError
from contract.whole_file import save
from onboard.estimation.boresight import Alignment


class StateFile:
    """One file, written whole or not at all. Raises InputError, one line."""

    def __init__(self, path: Path) -> None:
        if not path.parent.is_dir():
            raise InputError(f"state file {path}: no such folder as {path.parent}")
        if path.is_dir():
            raise InputError(f"state file {path}: is a folder; name a file")
        self.path = path

    def text(self) -> str:
        """The file's content, for the recording; empty on a first flight. Raises InputError."""
        try:
            return self.path.read_text(encoding="utf-8") if self.path.exists() else ""
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(f"state file {self.path}: {error}") from error

    def restore(self, alignment: Alignment) -> tuple[str, ...]:
        """Begin from the file, and return what of it is left out, `Alignment.restore`; a missing one is a first
        flight.
        """
        if not self.path.exists():
            return ()
        try:
            return alignment.restore(self.path.read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError, InputError) as error:
            raise InputError(f"state file {self.path}: {error}") from error

    def keep(self, alignment: Alignment) -> None:
        if alignment.updates:
            self.write(alignment.to_json())

    def write(self, text: str) -> None:
        """Replace the file's content, safe against a loss of power: the old text or the new, never a part."""
        try:
            save(self.path, text)
        except InputError as error:
            raise InputError(f"state file {error}") from error
