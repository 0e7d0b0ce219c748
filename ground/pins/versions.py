"""Versions of one pin that servers made apart: joined part by part, so that what either changed is kept.

A part is the name, the note, the category, or one click; each has the time at which it was changed last, and by whom.
Of two versions of a part the later one counts, so that a pin is the same whichever server joins what in which order. A
click that is stamped but not there was taken out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from contract.errors import InputError
from ground.pins.model import MAX_CLICKS, MAX_STAMPS, Category, Pin, PinClick, Stamp, to_text

TEXTS = ("name", "note", "category")
CLICK = "click "  # before the id of one, which may be any word


def stamped(pin: Pin, before: Pin, at_unix_ns: int, who: str) -> Pin:
    """A pin as it was changed from what was there before, with the time and the author of each part that differs."""
    stamps = {**before.stamps, **dict.fromkeys(_changed(_parts(before), _parts(pin)), (at_unix_ns, who))}
    return replace(pin, stamps=stamps, modified_unix_ns=at_unix_ns, modified_by=who)


def joined(one: Pin, other: Pin) -> Pin:
    """Two versions of a pin as one; number and former numbers are the first's, and so is the order of its clicks.

    Deleted is deleted, unless the pin was changed after that; and where each of two took out what the other left, the
    later one's clicks stay. Raises InputError for more clicks than a pin holds.
    """
    older, newer = sorted((one, other), key=order_of)
    parts = {version: _parts(version) for version in (older, newer)}
    taken, stamps = dict[str, Any](), dict[str, Stamp]()
    for part in dict.fromkeys((*parts[one], *parts[other], *one.stamps, *other.stamps)):
        known = [pin for pin in (older, newer) if part in parts[pin] or part in pin.stamps]
        best = max(known, key=lambda pin: (_stamp(pin, part), _text(parts[pin].get(part))))
        if part in best.stamps:
            stamps[part] = best.stamps[part]
        if part in parts[best]:
            taken[part] = parts[best][part]
    found = _with_parts(newer, taken)
    clicks = found.clicks or newer.clicks
    if len(clicks) > MAX_CLICKS or len(stamps) > MAX_STAMPS:
        raise InputError(f"pin {one.number}: {len(clicks)} clicks; at most {MAX_CLICKS} are kept")
    return replace(found, number=one.number, was=one.was, clicks=clicks, stamps=stamps)


def turned_back(held: Pin, now: Pin, then: Pin) -> Pin | None:
    """The pin as it is held, with what changed from `then` to `now` as it was; None if one of these parts has been
    changed again since, or the pin deleted or brought back, or if no click would be left.
    """
    here, before = _parts(held), _parts(then)
    changed = _changed(before, _parts(now))
    if held.is_deleted != now.is_deleted or changed & _changed(here, _parts(now)):
        return None
    found = {}
    for part in dict.fromkeys((*before, *here)):
        whose = before if part in changed else here
        if part in whose:
            found[part] = whose[part]
    turned = replace(_with_parts(held, found), is_deleted=then.is_deleted)
    return turned if turned.clicks else None


def order_of(pin: Pin) -> tuple[int, str, str]:
    """The key that orders versions of a pin by time: the same on every server, whatever the order of its clicks."""
    plain = replace(pin, number=0, clicks=tuple(sorted(pin.clicks, key=lambda click: click.id))).to_dict()
    del plain["was"]  # as the number: both are a change of the pin, with a time of its own, where servers agree on them
    return pin.modified_unix_ns, pin.modified_by, to_text(plain)


def _parts(pin: Pin) -> dict[str, Any]:
    """The parts that are there."""
    return {**{name: getattr(pin, name) for name in TEXTS}, **{CLICK + click.id: click for click in pin.clicks}}


def _with_parts(pin: Pin, parts: Mapping[str, Any]) -> Pin:
    """The pin with these parts and no others."""
    texts = {name: parts[name] for name in TEXTS}
    return replace(pin, clicks=tuple(value for part, value in parts.items() if part not in TEXTS), **texts)


def _changed(one: Mapping[str, Any], other: Mapping[str, Any]) -> set[str]:
    """The names of the parts that differ, or that only one of two versions has."""
    return {part for part in (*one, *other) if _text(one.get(part)) != _text(other.get(part))}


def _text(value: Any) -> str:
    """A part as a text that can be compared; empty for one that is not there."""
    if isinstance(value, PinClick):
        return to_text(value.to_dict())
    return str(value.value if isinstance(value, Category) else value or "")


def _stamp(pin: Pin, part: str) -> Stamp:
    """The time and the author of a part's last change: it may be as old as the pin."""
    return pin.stamps.get(part, (pin.created_unix_ns, pin.who))
