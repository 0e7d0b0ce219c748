"""The database interface of a store of pins, SQLite or PostgreSQL: statements, transactions, errors as one line."""

from __future__ import annotations

import abc
import contextlib
import json
import threading
from collections.abc import Iterable, Iterator
from typing import Any

from contract.errors import InputError

SCHEMA_VERSION = 1
BEGINNING = {"schema": SCHEMA_VERSION, "revision": 0, "ties_revision": 0}


class PinTables(abc.ABC):
    """One connection, which threads take in turn. A transaction is on disk when `writing` is left.

    Statements are in the SQL that both databases know, with `?` for values. Raises InputError, in one line with `name`,
    for a database that is not one of ours, and for any error of it.
    """

    begin: str  # a transaction that no other writer is in

    def __init__(self, name: str) -> None:
        self.name = name
        self._lock = threading.RLock()

    def _prepare(self) -> None:
        """Begin, or close and raise."""
        try:
            self._begin()
        except BaseException:
            self.close()
            raise

    @abc.abstractmethod
    def _begin(self) -> None:
        """Make the tables where there are none, and check those that are there."""

    @abc.abstractmethod
    def close(self) -> None:
        """Close the connection; no call after this."""

    @property
    @abc.abstractmethod
    def is_in_transaction(self) -> bool:
        """True while what is read may still be rolled back."""

    @abc.abstractmethod
    def rows(self, statement: str, *values: object) -> list[tuple[Any, ...]]:
        """The rows that a statement gives."""

    @abc.abstractmethod
    def each(self, statement: str, rows: Iterable[tuple[object, ...]]) -> None:
        """One statement for each of many rows of values."""

    def value(self, key: str) -> int:
        return int(self.rows("SELECT value FROM meta WHERE key = ?", key)[0][0])

    def bump(self, key: str) -> None:
        self.rows("UPDATE meta SET value = value + 1 WHERE key = ?", key)

    @contextlib.contextmanager
    def reading(self) -> Iterator[None]:
        with self._lock:
            yield

    @contextlib.contextmanager
    def writing(self) -> Iterator[None]:
        """A transaction: on disk at its end, or nothing of it."""
        with self._lock:
            self.rows(self.begin)
            try:
                yield
                self.rows("COMMIT")
            except BaseException:
                if self.is_in_transaction:
                    self.rows("ROLLBACK")
                raise

    def json(self, text: str) -> Any:
        try:
            return json.loads(text)
        except (ValueError, RecursionError) as error:
            raise InputError(f"pins {self.name}: damaged ({error})") from error

    def check_version(self) -> None:
        """Raises InputError for tables of another version."""
        if (version := self.value("schema")) != SCHEMA_VERSION:
            raise InputError(f"pins {self.name}: of version {version}; this program reads {SCHEMA_VERSION}")
