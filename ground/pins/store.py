"""Pins and ties in a database: on disk before a call returns, undone and redone, shared by threads and processes.

Each change is one transaction with what was there before and after, so that undoing is writing back. Nothing is ever
removed from the file: a deleted pin stays as a tombstone, which other servers must receive, and its number is not given
again, because it may have been passed on by radio.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from operator import attrgetter
from pathlib import Path
from types import TracebackType
from typing import Any

from contract.errors import InputError
from ground.pins.file import PinFile
from ground.pins.model import Category, Pin, PinClick, Tie, check_texts, new_pin, to_text
from ground.pins.postgresql import PinDatabase, is_url
from ground.pins.tables import PinTables
from ground.pins.ties import TieRefused, judge
from ground.pins.versions import joined, order_of, stamped, turned_back

MAX_CROP_BYTES = 2_000_000
# A pin from another server may be at most this far ahead of now: clocks differ, but one far ahead would always win.
MAX_AHEAD_NS = 86_400_000_000_000
PASSING_NS = 60_000_000_000  # for which a number that came of servers' agreeing is not yet one that somebody has used
MAX_NUMBER = 10**9  # that are given again as they came in a file or from another server

_NUMBER = attrgetter("number")
_Change = tuple[str, str, str | None, str | None]  # "pin" or "tie", id, before and after as JSON


class PinStore:
    """A file of pins, or a PostgreSQL database by its URL. Every method may be called from any thread.

    Raises InputError for what cannot be stored or found.

    `revision` grows with each change by any user, in this process or another.
    """

    def __init__(self, path: Path | str, *, now_ns: Callable[[], int] = time.time_ns) -> None:
        self._now_ns = now_ns
        self._file: PinTables = PinDatabase(str(path)) if is_url(str(path)) else PinFile(Path(path))
        self._pins: dict[str, Pin] = {}  # tombstones too, by number, as of revision `_seen`
        self._seen = 0
        self._given: dict[str, tuple[int, int]] = {}  # numbers of moved pins, and when (ns), by id
        self._written_texts: dict[str, Pin] = {}  # of the last change
        self._ties: tuple[int, list[Tie]] = (-1, [])

    def close(self) -> None:
        """Close the file; what was written is on disk already."""
        self._file.close()

    def __enter__(self) -> PinStore:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    # Reading

    @property
    def name(self) -> str:
        """The place of the pins, for people: a path, or a URL without its password."""
        return self._file.name

    @property
    def revision(self) -> int:
        with self._file.reading():
            return self._file.value("revision")

    def pins(
        self,
        *,
        category: Category | None = None,
        text: str = "",
        vehicle: str = "",
        who: str = "",
        since_unix_ns: int = 0,
    ) -> list[Pin]:
        """The pins that are not deleted, by number; `text` in name or note, in small or capital letters."""
        wanted = text.casefold()
        return [
            pin
            for pin in self._current().values()
            if not pin.is_deleted
            and (category is None or pin.category is category)
            and (not wanted or wanted in pin.name.casefold() or wanted in pin.note.casefold())
            and (not vehicle or any(click.vehicle == vehicle for click in pin.clicks))
            and (not who or pin.who == who)
            and pin.created_unix_ns >= since_unix_ns
        ]

    def everything(self) -> list[Pin]:
        """Pins and tombstones of one moment, by number. A pin that has not changed is the same object again."""
        return list(self._current().values())

    def pin(self, pin_id: str) -> Pin:
        """The pin of an id. Raises InputError if there is none, or it was deleted."""
        found = self._current().get(pin_id)
        if found is None or found.is_deleted:
            raise InputError(f"no pin with id {pin_id[:64]!r}")
        return found

    def by_number(self, number: int) -> Pin:
        """The pin of a number. Raises InputError if there is none, or it was deleted."""
        for pin in self._current().values():
            if pin.number == number and not pin.is_deleted:
                return pin
        raise InputError(f"no pin {number}")

    def crop(self, click_id: str) -> bytes | None:
        """The picture around a click, if one was kept."""
        rows = self._file.rows("SELECT picture FROM crops WHERE click = ?", click_id)
        return bytes(rows[0][0]) if rows else None

    def ties(self) -> list[Tie]:
        """The ties that are not deleted, in the order they were made."""
        with self._file.reading():
            # They have a revision of their own: pins come far more often.
            revision = self._file.value("ties_revision")
            if self._ties[0] == revision:
                return list(self._ties[1])
            rows = self._file.rows("SELECT doc FROM ties WHERE is_deleted = 0 ORDER BY rowid")
            found = [Tie.from_dict(self._file.json(doc)) for (doc,) in rows]
            if not self._file.is_in_transaction:
                self._ties = revision, found
            return list(found)

    # Changing

    def add(
        self,
        clicks: Sequence[PinClick],
        *,
        name: str = "",
        note: str = "",
        category: Category = Category.POI,
        who: str = "",
        crop: bytes | None = None,
    ) -> Pin:
        """A new pin with the next number; `crop` is of its first click. On disk when this returns."""
        with self._changing(who) as change:
            made = new_pin(self._next_number(), tuple(clicks), name, note, category, who, self._now_ns())
            Pin.from_dict(made.to_dict())  # what could not be read back is not written
            self._keep_crop(made.clicks[:1], crop)
            change(f"pin {made.number} added", [self._written(made)])
        return made

    def add_click(self, pin_id: str, click: PinClick, *, who: str = "", crop: bytes | None = None) -> Pin:
        """Add one more click on the same thing."""

        def more(pin: Pin) -> Pin:
            self._keep_crop((click,), crop)
            return replace(pin, clicks=(*pin.clicks, click))

        return self._modified(pin_id, who, "got a click", more)

    def remove_click(self, pin_id: str, click_id: str, *, who: str = "") -> Pin:
        """Remove one of its clicks. Raises InputError if it is none of them, or the only one."""

        def fewer(pin: Pin) -> Pin:
            left = tuple(click for click in pin.clicks if click.id != click_id)
            if len(left) == len(pin.clicks):
                raise InputError(f"pin {pin.number} has no click {click_id[:64]!r}")
            if not left:
                raise InputError(f"this is the only click of pin {pin.number}: delete the pin")
            return replace(pin, clicks=left)

        return self._modified(pin_id, who, "lost a click", fewer)

    def measure(self, pin_id: str, click: PinClick) -> Pin | None:
        """Put a click in the place of the one of its id, as if it had been answered so at once: also in what undo and
        redo bring back. None if the pin has no such click now.
        """
        with self._file.writing():
            held = self._held(pin_id)
            if held is None:
                return None
            for seq, *docs in self._file.rows(
                "SELECT seq, before, after FROM changed WHERE kind = 'pin' AND id = ?", pin_id
            ):
                then = (None if pin is None else _with_click(pin, click) for pin in map(self._read, docs))
                self._file.rows(
                    "UPDATE changed SET before = ?, after = ? WHERE seq = ? AND kind = 'pin' AND id = ?",
                    *(None if pin is None else to_text(pin.to_dict()) for pin in then), seq, pin_id,
                )  # fmt: skip
            if click.id not in {one.id for one in held.clicks}:
                return None
            self._file.bump("revision")
            after = stamped(_with_click(held, click), held, self._time_after(held), held.modified_by)
            Pin.from_dict(after.to_dict())
            self._written(after)
        return after

    def edit(
        self,
        pin_id: str,
        *,
        who: str = "",
        name: str | None = None,
        note: str | None = None,
        category: Category | None = None,
    ) -> Pin:
        """Change texts or category; what is None stays the same."""

        def edited(pin: Pin) -> Pin:
            return check_texts(
                replace(
                    pin,
                    name=pin.name if name is None else name,
                    note=pin.note if note is None else note,
                    category=pin.category if category is None else category,
                )
            )

        return self._modified(pin_id, who, "edited", edited)

    def delete(self, pin_id: str, *, who: str = "") -> None:
        """Undone like any other change; its number is not given again."""
        self._modified(pin_id, who, "deleted", lambda pin: replace(pin, is_deleted=True))

    def clear(self, *, who: str = "") -> int:
        """Delete all pins, as one change. Returns how many."""
        with self._changing(who) as change:
            now = self._now_ns()
            there = self.pins()
            gone = [replace(p, is_deleted=True, modified_unix_ns=now, modified_by=who) for p in there]
            if gone:
                change(f"{len(gone)} pins deleted", [self._written(p) for p in gone])
        return len(gone)

    def bring_in(self, pins: Sequence[Pin], *, who: str = "", crops: dict[str, bytes] | None = None) -> int:
        """Pins of a file, as one change, those that are here already only if they are newer. Returns how many."""
        with self._changing(who) as change:
            held = dict(self._current())
            numbers = {pin.number for pin in held.values()}
            highest = max(numbers, default=0)
            taken: dict[str, Pin] = {}
            for pin in pins:
                was = held.get(pin.id)
                new = self._with(Pin.from_dict(pin.to_dict()), was, revive=True)
                if new is None:
                    continue
                if was is None and (new.number in numbers or not 1 <= new.number < MAX_NUMBER):
                    new = new.numbered(highest + 1, (new.number,))
                highest = max(highest, new.number)
                numbers.add(new.number)
                held[new.id] = taken[new.id] = new
            items = self._written_all(list(taken.values()))
            for click_id, picture in (crops or {}).items():
                self._write_crop(click_id, picture)
            if items:
                change(f"{len(items)} pins imported", items)
        return len(items)

    def merge_all(self, pins: Sequence[Pin], most: int) -> tuple[int, list[tuple[Pin, str]]]:
        """Pins of another server, deleted ones too, in one transaction: of each part its last writer wins (`versions`).

        How many changed anything here; and what was refused, and why: a time far ahead of ours, or too many pins. Not
        undone by any user here. Pins as `Pin.from_dict` gives them: they are not checked again.
        `most`: pins and tombstones above which none that is new here is taken.
        """
        changed, refused = 0, []
        with self._file.writing():
            ((held,),) = self._file.rows("SELECT COUNT(*) FROM pins")
            for pin in pins:
                was = self._held(pin.id)
                try:
                    taken = self._with(pin, was)
                except InputError as error:
                    refused.append((pin, str(error)))
                    continue
                if taken is None:
                    continue
                if was is None and held >= most:
                    refused.append((pin, f"there are {held} pins already"))
                    continue
                if not changed:
                    self._file.bump("revision")
                held += was is None
                is_newer = was is None or order_of(pin) > order_of(was)
                self._written(self._numbered(pin.number if is_newer else taken.number, taken, was))
                changed += 1
        return changed, refused

    def _numbered(self, wanted: int, taken: Pin, was: Pin | None) -> Pin:
        """A pin of another server that is to be written over `was`, with the number that it has there, if it can be.

        Of two pins that servers made apart with one number the one that was made first keeps it, on all of them. The
        other's new number is a change of it, which they receive.
        """
        if was is not None and was.number == wanted:
            return taken
        other = self._holder(wanted)
        if 1 <= wanted < MAX_NUMBER and (other is None or _made(taken) < _made(other)):
            if other is not None:
                self._written(self._moved(other))
            return taken if was is None else taken.numbered(wanted, self._read_out(was))
        if was is None:
            return self._moved(replace(taken, number=wanted))
        return self._restamped(taken)  # by which they receive its number here

    def _moved(self, pin: Pin) -> Pin:
        """A pin whose number is another's, with the next free one."""
        made = self._restamped(pin.numbered(self._next_number(), self._read_out(pin)))
        self._given[pin.id] = made.number, self._now_ns()
        return made

    def _read_out(self, pin: Pin) -> tuple[int, ...]:
        """A pin's number, unless it was given so shortly ago, while many came, that no one will have read it out."""
        number, given_ns = self._given.get(pin.id, (0, 0))
        is_passing = number == pin.number and self._now_ns() - given_ns < PASSING_NS
        return () if is_passing else (pin.number,)

    def _restamped(self, pin: Pin) -> Pin:
        return replace(pin, modified_unix_ns=self._time_after(pin))

    def _time_after(self, pin: Pin) -> int:
        """The time of a change that is made now: later than the pin's last by any clock."""
        return max(self._now_ns(), pin.modified_unix_ns + 1)

    def add_tie(self, tie: Tie, *, who: str = "") -> Tie:
        """Apply a tie to its session. Raises TieRefused if it disagrees with its click or the ties there are."""
        with self._changing(who) as change:
            judgement = judge(tie, self.ties())
            if not judgement.is_accepted:
                raise TieRefused(judgement)
            change(f"tie {tie.name or tie.id[:8]} added", [self._written_tie(tie.id, to_text(tie.to_dict()))])
        return tie

    def delete_tie(self, tie_id: str, *, who: str = "") -> None:
        """Take a tie back. Raises InputError if there is none."""
        with self._changing(who) as change:
            if tie_id not in {tie.id for tie in self.ties()}:
                raise InputError(f"no tie with id {tie_id[:64]!r}")
            change(f"tie {tie_id[:8]} deleted", [self._written_tie(tie_id, None)])

    def undo(self, *, who: str | None = None) -> str | None:
        """Take back the last change, or the last one of a user. Returns what it was; None if there is none.

        Raises InputError if what it changed has been changed again since, by another user.
        """
        return self._turned("done", "undone", "seq DESC", who)

    def redo(self, *, who: str | None = None) -> str | None:
        """Make again the change that was undone last."""
        return self._turned("undone", "done", "seq ASC", who)

    def last_change(self, state: str) -> tuple[str, str] | None:
        """The last change that is `done`, or the first that is `undone`, and its author; None if there is none."""
        order = {"done": "DESC", "undone": "ASC"}[state]
        with self._file.reading():
            rows = self._file.rows(f"SELECT what, who FROM changes WHERE state = ? ORDER BY seq {order} LIMIT 1", state)
        return (str(rows[0][0]), str(rows[0][1])) if rows else None

    # Inside a transaction

    def _turned(self, of: str, to: str, order: str, who: str | None) -> str | None:
        with self._file.writing():
            condition, values = ("AND who = ?", (of, who)) if who is not None else ("", (of,))
            rows = self._file.rows(
                f"SELECT seq, what, who FROM changes WHERE state = ? {condition} ORDER BY {order} LIMIT 1", *values
            )
            if not rows:
                return None
            seq, what, author = rows[0]
            self._file.bump("revision")
            items = self._file.rows("SELECT kind, id, before, after FROM changed WHERE seq = ?", seq)
            for kind, key, before, after in items:
                now, then = (after, before) if of == "done" else (before, after)
                if kind == "pin":
                    self._turn_pin(key, now, then, what, author)
                else:
                    self._written_tie(key, then)
            self._file.rows("UPDATE changes SET state = ? WHERE seq = ?", to, seq)
        return str(what)

    def _turn_pin(self, key: str, now: str | None, then: str | None, what: str, author: str) -> None:
        held, was, target = self._held(key), self._read(now), self._read(then)
        assert held is not None
        after: Pin | None
        if target is None:  # it was not there: what was added to it since would go with it
            is_same = was is not None and _content(held) == _content(was)
            after = replace(held, is_deleted=True) if is_same else None
        elif was is None:
            after = replace(target, number=held.number, was=held.was) if held.is_deleted else None
        else:
            after = turned_back(held, was, target)
        if after is None:
            raise InputError(
                f"cannot undo {what!r}: pin {held.number} was changed since by {held.modified_by or 'others'}"
            )
        self._written(stamped(after, held, self._time_after(held), author))

    def _modified(self, pin_id: str, who: str, did: str, change_of: Callable[[Pin], Pin]) -> Pin:
        with self._changing(who) as change:
            before = self.pin(pin_id)
            after = stamped(change_of(before), before, self._time_after(before), who)
            Pin.from_dict(after.to_dict())
            change(f"pin {after.number} {did}", [self._written(after)])
        return after

    def _with(self, pin: Pin, held: Pin | None, *, revive: bool = False) -> Pin | None:
        """A pin from outside joined with `held`, ours of that id, to be written; None if that changes nothing.

        It keeps our number; of a pin that is new here the number may be taken.
        """
        if pin.modified_unix_ns > self._now_ns() + MAX_AHEAD_NS:
            if revive:  # whoever imports a file wants its pins, whatever clock wrote it; over ours it cannot be judged
                return replace(pin, modified_unix_ns=self._now_ns(), stamps={}) if held is None else None
            raise InputError(f"pin {pin.number} by {pin.modified_by!r}: stamped more than a day ahead of this clock")
        if held is None:
            return pin
        if revive and held.is_deleted and not pin.is_deleted:
            # A user who imports a file wants what is in it, also what was deleted here since.
            return stamped(pin.numbered(held.number, held.was), held, self._time_after(held), pin.modified_by)
        both = joined(held, pin)
        return None if order_of(both) == order_of(held) else both

    def _held(self, pin_id: str) -> Pin | None:
        """The pin of an id, deleted or not."""
        rows = self._file.rows("SELECT doc FROM pins WHERE id = ?", pin_id)
        return self._read(rows[0][0]) if rows else None

    def _holder(self, number: int) -> Pin | None:
        """The pin of a number, deleted or not."""
        rows = self._file.rows("SELECT doc FROM pins WHERE number = ?", number)
        return self._read(rows[0][0]) if rows else None

    def _read(self, doc: str | None) -> Pin | None:
        return None if doc is None else Pin.from_dict(self._file.json(doc))

    def _written(self, pin: Pin) -> _Change:
        (item,) = self._written_all([pin])
        return item

    def _written_all(self, pins: Sequence[Pin]) -> list[_Change]:
        """Write pins of different ids; the changes, each with its document before and after."""
        revision = self._file.value("revision")
        before = {p.id: self._file.rows("SELECT doc FROM pins WHERE id = ?", p.id) for p in pins}
        docs = [to_text(pin.to_dict()) for pin in pins]
        self._file.each(
            "INSERT INTO pins VALUES (?, ?, ?, ?) ON CONFLICT (id) DO UPDATE SET "
            "number = excluded.number, revision = excluded.revision, doc = excluded.doc",
            [(pin.id, pin.number, revision, doc) for pin, doc in zip(pins, docs, strict=True)],
        )
        self._written_texts = dict(zip(docs, pins, strict=True))
        old = [rows[0][0] if (rows := before[pin.id]) else None for pin in pins]
        return [("pin", pin.id, was, doc) for pin, was, doc in zip(pins, old, docs, strict=True)]

    def _written_tie(self, tie_id: str, doc: str | None) -> _Change:
        """Write a tie with this content, or delete it; the change."""
        rows = self._file.rows("SELECT doc FROM ties WHERE id = ? AND is_deleted = 0", tie_id)
        self._file.bump("ties_revision")
        if doc is None:
            self._file.rows("UPDATE ties SET is_deleted = 1 WHERE id = ?", tie_id)
        else:
            self._file.rows(
                "INSERT INTO ties VALUES (?, 0, ?) ON CONFLICT (id) DO UPDATE SET is_deleted = 0, doc = excluded.doc",
                tie_id,
                doc,
            )
        return "tie", tie_id, rows[0][0] if rows else None, doc

    def _keep_crop(self, clicks: Sequence[PinClick], crop: bytes | None) -> None:
        if crop is not None and clicks:
            self._write_crop(clicks[0].id, crop)

    def _write_crop(self, click_id: str, picture: bytes) -> None:
        if len(picture) > MAX_CROP_BYTES:
            raise InputError(f"a crop of {len(picture)} bytes; at most {MAX_CROP_BYTES} are kept")
        self._file.rows(
            "INSERT INTO crops VALUES (?, ?) ON CONFLICT (click) DO UPDATE SET picture = excluded.picture",
            click_id,
            picture,
        )

    def _next_number(self) -> int:
        return int(self._file.rows("SELECT COALESCE(MAX(number), 0) FROM pins")[0][0]) + 1

    def _current(self) -> dict[str, Pin]:
        """All pins by id, in the order of their numbers, tombstones too; only what has changed is read again."""
        with self._file.reading():
            revision = self._file.value("revision")
            if revision == self._seen:
                return self._pins
            rows = self._file.rows("SELECT doc FROM pins WHERE revision > ?", self._seen)
            # A text that was written here just now need not be read to know its content.
            texts = self._written_texts
            read = (texts[doc] if doc in texts else Pin.from_dict(self._file.json(doc)) for (doc,) in rows)
            known = _merged(self._pins, sorted(read, key=_NUMBER))
            if not self._file.is_in_transaction:  # nothing is kept that may still be rolled back
                self._pins, self._seen = known, revision
            return known

    @contextlib.contextmanager
    def _changing(self, who: str) -> Iterator[Callable[[str, list[_Change]], None]]:
        """A transaction that is one change, which can be undone; what was undone before cannot be made again."""

        def change(what: str, items: list[_Change]) -> None:
            self._file.rows("UPDATE changes SET state = 'dropped' WHERE state = 'undone' AND who = ?", who)
            ((seq,),) = self._file.rows(
                "INSERT INTO changes (who, unix_ns, what, state) VALUES (?, ?, ?, 'done') RETURNING seq",
                who, self._now_ns(), what,
            )  # fmt: skip
            self._file.each("INSERT INTO changed VALUES (?, ?, ?, ?, ?)", [(seq, *item) for item in items])

        with self._file.writing():
            self._file.bump("revision")
            yield change


def _merged(pins: dict[str, Pin], fresh: Sequence[Pin]) -> dict[str, Pin]:
    """Pins in the order of their numbers, and those that have changed, in that order, too.

    Mostly one is changed, or one is new and the last: ten thousand need not be sorted for it.
    """
    last = next((pin.number for pin in reversed(pins.values())), 0)
    new = [pin for pin in fresh if pin.id not in pins]
    stays = all(pins[pin.id].number == pin.number for pin in fresh if pin.id in pins)
    known = {**pins, **{pin.id: pin for pin in fresh}}
    if stays and (not new or new[0].number > last):
        return known
    return {pin.id: pin for pin in sorted(known.values(), key=_NUMBER)}


def _with_click(pin: Pin, click: PinClick) -> Pin:
    """The pin with a click in the place of the one of its id."""
    return replace(pin, clicks=tuple(click if one.id == click.id else one for one in pin.clicks))


def _content(pin: Pin) -> dict[str, Any]:
    """The content of a pin that a user sees, without the user who changed it last."""
    out = pin.to_dict()
    for name in ("modified_unix_ns", "modified_by", "number", "was", "stamps"):
        del out[name]
    return out


def _made(pin: Pin) -> tuple[int, str]:
    """The key that orders pins by when they were made."""
    return pin.created_unix_ns, pin.id
