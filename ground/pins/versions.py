"""Versions of one pin that servers made apart: joined part by part, so that what either changed is kept.

A part is the name, the note, the category, or one click; each has the time at which it was changed last, and by whom.
Of two versions of a part the later one counts, so that a pin is the same whichever server joins what in which order. A
click that is stamped but not there was taken out.
"""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

from contract.errors import InputError
from ground.pins.model import MAX_CLICKS, MAX_STAMPS, Pin, Stamp

TEXTS = ("name", "note", "category")
CLICK = "click "  # before the id of one, which may be any word


def stamped(pin: Pin, before: Pin, at_unix_ns: int, who: str) -> Pin:
    """A pin as it was changed from what was there before, with the time and the author of each part that differs."""
    old, new = _parts(before), _parts(pin)
    changed = [part for part in (*old, *new) if old.get(part) != new.get(part)]
    stamps = {**before.stamps, **dict.fromkeys(changed, (at_unix_ns, who))}
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
        best = max(known, key=lambda pin: (_stamp(pin, part), parts[pin].get(part, "")))
        if part in best.stamps:
            stamps[part] = best.stamps[part]
        taken[part] = _value(best, part)
    clicks = tuple(click for part, click in taken.items() if part not in TEXTS and click is not None)
    clicks = clicks or newer.clicks
    if len(clicks) > MAX_CLICKS or len(stamps) > MAX_STAMPS:
        raise InputError(f"pin {one.number}: {len(clicks)} clicks; at most {MAX_CLICKS} are kept")
    texts = {part: taken[part] for part in TEXTS}
    return replace(newer, number=one.number, was=one.was, clicks=clicks, stamps=stamps, **texts)


def turned_back(held: Pin, now: Pin, then: Pin) -> Pin | None:
    """The pin as it is held, with what changed from `then` to `now` as it was; None if one of these parts has been
    changed again since, or the pin deleted or brought back, or if no click would be left.
    """
    here, after, before = _parts(held), _parts(now), _parts(then)
    changed = {part for part in (*after, *before) if after.get(part) != before.get(part)}
    if held.is_deleted != now.is_deleted or any(here.get(part) != after.get(part) for part in changed):
        return None
    parts = dict.fromkeys((*before, *here))
    found = {part: _value(then if part in changed else held, part) for part in parts}
    clicks = tuple(click for part, click in found.items() if part not in TEXTS and click is not None)
    if not clicks:
        return None
    return replace(held, clicks=clicks, is_deleted=then.is_deleted, **{part: found[part] for part in TEXTS})


def order_of(pin: Pin) -> tuple[int, str, str]:
    """The key that orders versions of a pin by time: the same on every server, whatever the order of its clicks."""
    plain = replace(pin, number=0, clicks=tuple(sorted(pin.clicks, key=lambda click: click.id))).to_dict()
    del plain["was"]  # as the number: both are a change of the pin, with a time of its own, where servers agree on them
    return pin.modified_unix_ns, pin.modified_by, json.dumps(plain, separators=(",", ":"), allow_nan=False)


def _parts(pin: Pin) -> dict[str, str]:
    """The parts that are there, as texts that can be compared."""
    texts = {"name": pin.name, "note": pin.note, "category": pin.category.value}
    return {**texts, **{CLICK + click.id: json.dumps(click.to_dict(), sort_keys=True) for click in pin.clicks}}


def _value(pin: Pin, part: str) -> Any:
    if part in TEXTS:
        return getattr(pin, part)
    return next((click for click in pin.clicks if CLICK + click.id == part), None)


def _stamp(pin: Pin, part: str) -> Stamp:
    """The time and the author of a part's last change: it may be as old as the pin."""
    return pin.stamps.get(part, (pin.created_unix_ns, pin.who))
