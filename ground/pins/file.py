"""The SQLite file under a store of pins: tables, transactions, and its errors as one line."""

from __future__ import annotations

import contextlib
import json
import os
import sqlite3
import threading
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from contract.errors import InputError

SCHEMA_VERSION = 1
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
_BEGINNING = {"schema": SCHEMA_VERSION, "revision": 0, "ties_revision": 0}


def default_path() -> Path:
    """Where pins are kept unless a file is named."""
    base = os.environ.get("XDG_DATA_HOME", "")
    return (Path(base) if base else Path.home() / ".local" / "share") / "pointclick" / "pins.sqlite"


def chosen_path(named: Path | None) -> Path:
    """The file that was named, whose folder must be there, or the user's own. Raises InputError."""
    if named is not None and not named.parent.is_dir():
        raise InputError(f"pins {named}: there is no folder {named.parent}")
    return named or default_path()


class PinFile:
    """One connection, which threads take in turn. A transaction is on disk when `writing` is left.

    Raises InputError for a file that is not one of ours, and for any error of the disk or a lock of another process.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = threading.RLock()
        self._db: sqlite3.Connection | None = None
        with self._told():
            path.parent.mkdir(parents=True, exist_ok=True)
            self._db = sqlite3.connect(path, timeout=BUSY_TIMEOUT_S, check_same_thread=False, isolation_level=None)
        try:
            self._begin()
        except BaseException:
            self.close()
            raise

    def _begin(self) -> None:
        if self.rows("SELECT name FROM sqlite_master WHERE type = 'table'") and not self.rows(
            "SELECT name FROM sqlite_master WHERE name = 'changed'"
        ):
            raise InputError(f"pins {self.path}: a database of something else; name another file")
        self.rows("PRAGMA journal_mode = WAL")
        self.rows("PRAGMA synchronous = FULL")
        with self.writing():
            for statement in _SCHEMA.split(";\n"):
                self.rows(statement)
            for key, value in _BEGINNING.items():
                self.rows("INSERT OR IGNORE INTO meta VALUES (?, ?)", key, value)
        if (version := self.value("schema")) != SCHEMA_VERSION:
            raise InputError(f"pins {self.path}: of version {version}; this program reads {SCHEMA_VERSION}")

    def close(self) -> None:
        """Close the file; no call after this."""
        with self._lock:
            if self._db is not None:
                self._db.close()
                self._db = None

    @property
    def is_in_transaction(self) -> bool:
        """Whether what is read now may still be rolled back."""
        return self._db is not None and self._db.in_transaction

    def rows(self, statement: str, *values: object) -> list[tuple[Any, ...]]:
        """The rows that a statement gives."""
        with self._lock, self._told():
            if self._db is None:
                raise InputError(f"pins {self.path}: closed")
            return self._db.execute(statement, values).fetchall()

    def each(self, statement: str, rows: Iterable[tuple[object, ...]]) -> None:
        """One statement for each of many rows of values."""
        with self._lock, self._told():
            if self._db is None:
                raise InputError(f"pins {self.path}: closed")
            self._db.executemany(statement, rows)

    def value(self, key: str) -> int:
        """One number of the file's own."""
        return int(self.rows("SELECT value FROM meta WHERE key = ?", key)[0][0])

    def bump(self, key: str) -> None:
        """One more."""
        self.rows("UPDATE meta SET value = value + 1 WHERE key = ?", key)

    @contextlib.contextmanager
    def reading(self) -> Iterator[None]:
        """No other thread in between."""
        with self._lock:
            yield

    @contextlib.contextmanager
    def writing(self) -> Iterator[None]:
        """A transaction: on disk at its end, or nothing of it."""
        with self._lock:
            self.rows("BEGIN IMMEDIATE")
            try:
                yield
                self.rows("COMMIT")
            except BaseException:
                if self.is_in_transaction:
                    self.rows("ROLLBACK")
                raise

    def json(self, text: str) -> Any:
        """A document of the file's."""
        try:
            return json.loads(text)
        except (ValueError, RecursionError) as error:
            raise InputError(f"pins {self.path}: damaged ({error})") from error

    @contextlib.contextmanager
    def _told(self) -> Iterator[None]:
        try:
            yield
        except sqlite3.OperationalError as error:
            raise InputError(f"pins {self.path}: {error}") from error
        except sqlite3.DatabaseError as error:
            raise InputError(f"pins {self.path}: {error}; is it a file of pins?") from error
        except OSError as error:
            raise InputError(f"pins {self.path}: {error.strerror}") from error
