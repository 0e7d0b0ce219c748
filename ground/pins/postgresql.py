"""The tables of a store of pins in a PostgreSQL server, for several ground servers. Extra `postgresql`.

All is in a schema of its own, `pointclick`. One writer at a time, as in a file: a change is a short transaction.
"""

from __future__ import annotations

import contextlib
import importlib
import re
from collections.abc import Iterable, Iterator
from typing import Any

from contract.errors import InputError
from ground.pins.tables import BEGINNING, PinTables

SCHEMES = ("postgresql://", "postgres://")
CONNECT_TIMEOUT_S = 5
STATEMENT_TIMEOUT_S = 10  # also for another server's transaction

_SCHEMA = """
CREATE SCHEMA IF NOT EXISTS pointclick;
CREATE TABLE IF NOT EXISTS meta (key TEXT PRIMARY KEY, value BIGINT NOT NULL);
CREATE TABLE IF NOT EXISTS pins (
    id TEXT PRIMARY KEY, number BIGINT NOT NULL UNIQUE, revision BIGINT NOT NULL, doc TEXT NOT NULL);
CREATE INDEX IF NOT EXISTS pins_by_revision ON pins (revision);
CREATE TABLE IF NOT EXISTS ties (
    id TEXT PRIMARY KEY, is_deleted INTEGER NOT NULL, doc TEXT NOT NULL, rowid BIGINT GENERATED ALWAYS AS IDENTITY);
CREATE TABLE IF NOT EXISTS crops (click TEXT PRIMARY KEY, picture BYTEA NOT NULL);
CREATE TABLE IF NOT EXISTS changes (
    seq BIGINT PRIMARY KEY GENERATED ALWAYS AS IDENTITY, who TEXT NOT NULL, unix_ns BIGINT NOT NULL,
    what TEXT NOT NULL, state TEXT NOT NULL CHECK (state IN ('done', 'undone', 'dropped')));
CREATE INDEX IF NOT EXISTS changes_by_state ON changes (state, seq);
CREATE TABLE IF NOT EXISTS changed (
    seq BIGINT NOT NULL, kind TEXT NOT NULL, id TEXT NOT NULL, before TEXT, after TEXT);
CREATE INDEX IF NOT EXISTS changed_by_seq ON changed (seq)
"""
_SECRET = re.compile(r"(?<=:)[^/@:]*(?=@)|(?<=password=)[^&]*")
_CREATING = 7_016_990_113  # an advisory lock: of several servers that start at once, one makes the tables


class PinDatabase(PinTables):
    """A connection to a server, opened again after it was lost; what was under way then was rolled back."""

    begin = "BEGIN; LOCK TABLE meta IN EXCLUSIVE MODE"  # readers go on

    def __init__(self, url: str) -> None:
        super().__init__(_SECRET.sub("***", url))
        self._url = url
        try:
            self._psycopg: Any = importlib.import_module("psycopg")
        except ImportError as error:
            raise InputError(f"pins {self.name}: install pointclick with its extra [postgresql]") from error
        self._db: Any = None
        self._is_closed = False
        self._prepare()

    def _begin(self) -> None:
        if not self._is_made():
            with self._lock:
                self.rows(f"BEGIN; SELECT pg_advisory_xact_lock({_CREATING})")
                # Another may have made them meanwhile and be writing: touching them then would be a deadlock.
                if not self._is_made():
                    for statement in _SCHEMA.split(";\n"):
                        self.rows(statement)
                    for key, value in BEGINNING.items():
                        self.rows("INSERT INTO meta VALUES (?, ?) ON CONFLICT DO NOTHING", key, value)
                self.rows("COMMIT")
        self.check_version()

    def _is_made(self) -> bool:
        return bool(
            self.rows(
                "SELECT 1 FROM information_schema.tables WHERE table_name = 'changed' AND table_schema = ?",
                "pointclick",
            )
        )

    def close(self) -> None:
        """Close the connection; no call after this."""
        with self._lock:
            self._is_closed = True
            if self._db is not None:
                self._db.close()
                self._db = None

    @property
    def is_in_transaction(self) -> bool:
        """True while what is read may still be rolled back."""
        return self._db is not None and self._db.info.transaction_status.name in ("ACTIVE", "INTRANS", "INERROR")

    def rows(self, statement: str, *values: object) -> list[tuple[Any, ...]]:
        with self._lock, self._errors_explained():
            cursor = self._connected().execute(statement.replace("?", "%s"), values or None)
            return cursor.fetchall() if cursor.description else []

    def each(self, statement: str, rows: Iterable[tuple[object, ...]]) -> None:
        """One statement for each of many rows of values."""
        with self._lock, self._errors_explained(), self._connected().cursor() as cursor:
            cursor.executemany(statement.replace("?", "%s"), rows)

    def _connected(self) -> Any:
        if self._is_closed:
            raise InputError(f"pins {self.name}: closed")
        if self._db is None or self._db.closed:
            self._db = self._psycopg.connect(
                self._url,
                autocommit=True,  # transactions are begun and ended by their statements
                connect_timeout=CONNECT_TIMEOUT_S,
                application_name="pointclick",
                options=f"-c search_path=pointclick -c statement_timeout={STATEMENT_TIMEOUT_S}s",
            )
        return self._db

    @contextlib.contextmanager
    def _errors_explained(self) -> Iterator[None]:
        try:
            yield
        except self._psycopg.Error as error:
            words = " ".join(_SECRET.sub("***", str(error)).split()) or type(error).__name__
            raise InputError(f"pins {self.name}: {words}") from error


def is_url(text: str) -> bool:
    """Return whether a text is a PostgreSQL URL."""
    return text.startswith(SCHEMES)
