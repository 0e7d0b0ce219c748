"""A file of a receiver's NMEA sentences -> events. Their own times count, so here the date is needed (RMC, ZDA)."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from datetime import UTC, date, datetime
from datetime import time as clock_time
from pathlib import Path
from typing import Any, TypeGuard

from contract.errors import InputError
from onboard.events.types import GpsQuality, NavEvent, PositionFix
from onboard.telemetry.contradictions import agreeing
from onboard.telemetry.nmea_source import DAY_NS, KINDS, day_ns_of, epoch_events, sentence_of
from onboard.telemetry.row_events import MAX_UNIX_S, MIN_UNIX_S, SIGMA_GEOID_M
from onboard.telemetry.telemetry_log import NS_PER_S, TelemetryLog

_SENTENCE = re.compile(rb"^[^$\r\n]{0,64}\$G[A-Z]{4},[^\r\n]*\*[0-9A-Fa-f]{2}", re.MULTILINE)


@dataclass
class _Epoch:
    """The sentences of one moment of a day, and the day where one of them states it (Unix ns at midnight)."""

    day_ns: int
    date_ns: int | None = None
    sentences: dict[str, Any] = field(default_factory=dict)


def begins_nmea(head: bytes) -> bool:
    return _SENTENCE.search(head) is not None


def read_nmea(path: Path) -> TelemetryLog:
    """Read a receiver's log. Raises InputError, without the file's name, for one without dates or heights."""
    lines = [line for line in path.read_bytes().splitlines() if line.strip()]
    sentences = [sentence for line in lines if (sentence := sentence_of(line.strip())) is not None]
    if not sentences:
        raise InputError(f"none of its {len(lines)} lines is a whole sentence with a right checksum")
    epochs = _epochs(sentences)
    stamps_ns = _stamps(epochs)
    by_time = sorted(zip(stamps_ns, epochs, strict=True), key=lambda pair: pair[0])
    events: list[NavEvent] = [event for stamp_ns, epoch in by_time for event in epoch_events(epoch.sentences, stamp_ns)]
    fixes = [event for event in events if isinstance(event, PositionFix)]
    if not fixes:
        had_fix = any(isinstance(event, GpsQuality) and event.fix_type >= 2 for event in events)
        raise InputError("no heights in it: the receiver must send GGA" if had_fix else "no position: it had no fix")
    kept, notes = agreeing(fixes)
    good = {id(fixes[at]) for at in kept}
    damaged = len(lines) - len(sentences)
    if damaged:
        notes = [f"{damaged} of {len(lines)} lines are no whole sentence and are not used", *notes]
    used = [event for event in events if not isinstance(event, PositionFix) or id(event) in good]
    if any(_has_no_geoid(event) for event in used):
        notes = [*notes, f"no height of the geoid in it: heights are +-{SIGMA_GEOID_M:.0f} m as a whole"]
        used = [replace(event, sigma_datum_m=SIGMA_GEOID_M) if _has_no_geoid(event) else event for event in used]
    return replace(TelemetryLog.by_stamp(used), notes=tuple(notes))


def _has_no_geoid(event: NavEvent) -> TypeGuard[GpsQuality]:
    """Return whether a report of a fix lacks the geoid's separation, or has the 0 of a receiver that knows no geoid."""
    return isinstance(event, GpsQuality) and event.has_fix and not event.undulation_m


def _epochs(sentences: list[Any]) -> list[_Epoch]:
    out: list[_Epoch] = []
    for sentence in sentences:
        kind = getattr(sentence, "msgID", "")
        if kind == "DTM" and (datum := str(getattr(sentence, "datum", "") or "W84")) != "W84":
            raise InputError(f"its positions are of datum {datum}, not WGS 84 (DTM): set the receiver to W84")
        moment = getattr(sentence, "time", None)
        if kind != "VTG":
            if not isinstance(moment, clock_time) or kind not in KINDS | {"ZDA"}:
                continue  # before the first fix there is no time
            if not out or out[-1].day_ns != day_ns_of(moment):
                out.append(_Epoch(day_ns_of(moment)))
        if out:
            out[-1].date_ns = _date_ns(sentence) if out[-1].date_ns is None else out[-1].date_ns
            out[-1].sentences.setdefault(kind, sentence)
    return out


def _date_ns(sentence: Any) -> int | None:
    """The day that a sentence states, as Unix ns at midnight."""
    day = getattr(sentence, "date", None)
    if not isinstance(day, date):
        try:
            day = date(*(int(getattr(sentence, name)) for name in ("year", "month", "day")))
        except (AttributeError, TypeError, ValueError):
            return None
    seconds = datetime(day.year, day.month, day.day, tzinfo=UTC).timestamp()
    return int(seconds) * NS_PER_S if MIN_UNIX_S <= seconds <= MAX_UNIX_S else None


def _stamps(epochs: list[_Epoch]) -> list[int]:
    """Unix ns of each epoch; those without a date are of the day of their neighbours."""
    dated = [at for at, epoch in enumerate(epochs) if epoch.date_ns is not None]
    if not dated:
        raise InputError("no date in it (RMC, ZDA): its times are of any day")
    out: list[int] = []
    first = epochs[dated[0]]
    last_ns = (first.date_ns or 0) + first.day_ns
    for epoch in epochs:
        if epoch.date_ns is None:
            step = (epoch.day_ns - last_ns % DAY_NS + DAY_NS // 2) % DAY_NS - DAY_NS // 2
            last_ns += step
        else:
            last_ns = epoch.date_ns + epoch.day_ns
        out.append(last_ns)
    return out
