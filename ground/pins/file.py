"""The SQLite file under a store of pins: tables, transactions, and its errors as one line."""

from __future__ import annotations

import contextlib
import os
import sqlite3
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from contract.errors import InputError
from ground.pins.postgresql import is_url
from ground.pins.tables import BEGINNING, PinTables

BUSY_TIMEOUT_S = 10.0  # for another process's transaction

_SCHEMA = """
CREATE TABLE IF NOT EXISTS meta (key TEXT PRIMARY KEY, value INTEGER NOT NULL);
CREATE TABLE IF NOT EXISTS pins (
    id TEXT PRIMARY KEY, number INTEGER NOT NULL UNIQUE, revision INTEGER NOT NULL, doc TEXT NOT NULL);
CREATE INDEX IF NOT EXISTS pins_by_revision ON pins (revision);
CREATE TABLE IF NOT EXISTS ties (id TEXT PRIMARY KEY, is_deleted INTEGER NOT NULL, doc TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS crops (click TEXT PRIMARY KEY, picture BLOB NOT NULL);
CREATE TABLE IF NOT EXISTS changes (
    seq INTEGER PRIMARY KEY AUTOINCREMENT, who TEXT NOT NULL, unix_ns INTEGER NOT NULL, what TEXT NOT NULL,
    state TEXT NOT NULL CHECK (state IN ('done', 'undone', 'dropped')));
CREATE INDEX IF NOT EXISTS changes_by_state ON changes (state, seq);
CREATE TABLE IF NOT EXISTS changed (
    seq INTEGER NOT NULL, kind TEXT NOT NULL, id TEXT NOT NULL, before TEXT, after TEXT);
CREATE INDEX IF NOT EXISTS changed_by_seq ON changed (seq);
"""


def default_path() -> Path:
    """The file that keeps the pins unless another is named."""
    base = os.environ.get("XDG_DATA_HOME", "")
    return (Path(base) if base else Path.home() / ".local" / "share") / "pointclick" / "pins.sqlite"


def chosen_path(named: Path | None) -> Path:
    """The file that was named, whose folder must be there, or the user's own. Raises InputError."""
    if named is not None and not named.parent.is_dir():
        raise InputError(f"pins {named}: there is no folder {named.parent}")
    return named or default_path()


def chosen_store(named: Path | None, url: str | None) -> Path | str:
    """The database that was named, or the file as `chosen_path`. Raises InputError."""
    if url is None:
        return chosen_path(named)
    if named is not None:
        raise InputError("--pins and --store each name where pins are kept: give one of them")
    if not is_url(url):
        raise InputError("--store must be postgresql://USER@HOST/DATABASE; a file is named with --pins")
    return url


class PinFile(PinTables):
    """A file. Raises InputError if it is none of ours, and for any error of the disk or of another process's lock."""

    begin = "BEGIN IMMEDIATE"

    def __init__(self, path: Path) -> None:
        super().__init__(str(path))
        self._db: sqlite3.Connection | None = None
        with self._errors_explained():
            path.parent.mkdir(parents=True, exist_ok=True)
            self._db = sqlite3.connect(path, timeout=BUSY_TIMEOUT_S, check_same_thread=False, isolation_level=None)
        self._prepare()

    def _begin(self) -> None:
        if self.rows("SELECT name FROM sqlite_master WHERE type = 'table'") and not self.rows(
            "SELECT name FROM sqlite_master WHERE name = 'changed'"
        ):
            raise InputError(f"pins {self.name}: a database of something else; name another file")
        self.rows("PRAGMA journal_mode = WAL")
        self.rows("PRAGMA synchronous = FULL")
        with self.writing():
            for statement in _SCHEMA.split(";\n"):
                self.rows(statement)
            for key, value in BEGINNING.items():
                self.rows("INSERT OR IGNORE INTO meta VALUES (?, ?)", key, value)
        self.check_version()

    def close(self) -> None:
        """Close the file; no call after this."""
        with self._lock:
            if self._db is not None:
                self._db.close()
                self._db = None

    @property
    def is_in_transaction(self) -> bool:
        """True while what is read may still be rolled back."""
        return self._db is not None and self._db.in_transaction

    def rows(self, statement: str, *values: object) -> list[tuple[Any, ...]]:
        with self._lock, self._errors_explained():
            if self._db is None:
                raise InputError(f"pins {self.name}: closed")
            return self._db.execute(statement, values).fetchall()

    def each(self, statement: str, rows: Iterable[tuple[object, ...]]) -> None:
        """One statement for each of many rows of values."""
        with self._lock, self._errors_explained():
            if self._db is None:
                raise InputError(f"pins {self.name}: closed")
            self._db.executemany(statement, rows)

    @contextlib.contextmanager
    def _errors_explained(self) -> Iterator[None]:
        try:
            yield
        except sqlite3.OperationalError as error:
            raise InputError(f"pins {self.name}: {error}") from error
        except sqlite3.DatabaseError as error:
            raise InputError(f"pins {self.name}: {error}; is it a file of pins?") from error
        except OSError as error:
            raise InputError(f"pins {self.name}: {error.strerror}") from error
