"""The verdict on a soak: figures minute by minute, and the limits they are compared with."""

from __future__ import annotations

import re
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from benchmarks.machine import table, verdict
from benchmarks.soak_world import Spans, watchdog_s

WARM_UP_MINUTES = 5
SETTLED = 3  # minutes at either end that count
GOAL_GROWTH, GOAL_DROPPED = 0.05, 0.001
EVERY_S = 600.0
_BAD_LINE = re.compile(r"Traceback|panicked|Fatal Python error|^<[0-3]>| ERROR | CRITICAL ")


@dataclass(frozen=True)
class Faults:
    """The faults on the way: (seconds after the first picture, for how many)."""

    unplugged: Spans = ()
    cut: Spans = ()
    no_gps: Spans = ()

    @classmethod
    def of(cls, minutes: float) -> Faults:
        """Each kind once in ten minutes, never two at a time and none in the first or the last."""
        begins = [i * EVERY_S for i in range(int(minutes * 60.0 // EVERY_S) + 1)]

        def spans(offset_s: float, length_s: float) -> Spans:
            return tuple((b + offset_s, length_s) for b in begins if b + offset_s + length_s < 60.0 * (minutes - 1))

        return cls(spans(270.0, 20.0), spans(90.0, 5.0), spans(450.0, 15.0))

    def in_minute(self, minute: int) -> str:
        """The kinds of faults in a minute, counted from 1."""
        kinds = {"camera": self.unplugged, "telemetry": self.cut, "GPS": self.no_gps}
        return ", ".join(n for n, spans in kinds.items() if any(int(b // 60) + 1 == minute for b, _ in spans))


@dataclass(frozen=True)
class Minute:
    """The state at the end of a minute of flight; the queue and the delays are that minute's."""

    minute: int
    rss_mb: float  # without the leg's own pictures
    threads: int
    files: int
    queue: int
    delay_s: float | None
    longest_s: float | None
    pictures: int
    dropped: int
    sets: int
    sent: int
    received: int
    recorded_mb: float
    recordings: int
    speed: float  # mean over the minute


@dataclass
class Soak:
    """The result."""

    faults: Faults
    minutes: list[Minute] = field(default_factory=list)
    code: int | None = None
    log: list[str] = field(default_factory=list)
    notified: dict[str, int] = field(default_factory=dict)
    states: dict[str, int] = field(default_factory=dict)
    gap_s: float = 0.0
    gap_wall_s: float = 0.0
    asked: int = 0
    answered: int = 0
    unreadable: int = 0
    recorded_sets: int = 0
    ok_sets: int = 0
    wall_s: float = 0.0
    flight_s: float = 0.0

    @property
    def bad_lines(self) -> list[str]:
        """The lines of the daemon's log with exceptions and errors."""
        return [line for line in self.log if _BAD_LINE.search(line)]

    @property
    def growth(self) -> float | None:
        """Memory at the end over memory after warm-up, less 1; None for a run that is hardly longer than that."""
        warm = [m.rss_mb for m in self.minutes if m.minute >= WARM_UP_MINUTES]
        if len(warm) < 2 * SETTLED:
            return None
        return statistics.median(warm[-SETTLED:]) / statistics.median(warm[:SETTLED]) - 1.0

    def grown(self, count: Callable[[Minute], int]) -> int | None:
        """The excess of the least of the last minutes over the most of the first after warm-up; None as `growth`."""
        warm = [count(m) for m in self.minutes if m.minute >= WARM_UP_MINUTES]
        return min(warm[-SETTLED:]) - max(warm[:SETTLED]) if len(warm) >= 2 * SETTLED else None

    def verdicts(self) -> list[tuple[str, bool]]:
        """Each goal in a sentence, and whether it was reached."""
        out: list[tuple[str, bool]] = []
        growth, threads, files = self.growth, self.grown(lambda m: m.threads), self.grown(lambda m: m.files)
        if growth is not None and threads is not None and files is not None:
            goal = f"goal under {100 * GOAL_GROWTH:.0f} %"
            out.append((f"memory: {100 * growth:+.1f} % after {WARM_UP_MINUTES} min ({goal})", growth < GOAL_GROWTH))
            out.append((f"threads: {threads:+d}, files: {files:+d} (goal +0)", max(threads, files) <= 0))
        limit_s = watchdog_s()
        fed = self.notified.get("WATCHDOG=1", 0)
        out.append(
            (
                f"watchdog: fed {fed} times, at most {self.gap_s:.2f} s apart ({self.gap_wall_s:.2f} s wall); "
                f"WatchdogSec is {limit_s:.0f} s",
                fed > 0 and max(self.gap_s, self.gap_wall_s) < limit_s and self.notified.get("READY=1", 0) == 1,
            )
        )
        last = self.minutes[-1] if self.minutes else None
        sets, pictures, dropped = (last.sets, last.pictures, last.dropped) if last else (0, 0, 0)
        share = dropped / max(pictures, 1)
        slowest = min((m.speed for m in self.minutes), default=0.0)
        out.append((f"pace: the slowest minute ran {slowest:.1f} times as fast as real time", slowest >= 1.0))
        out.append((f"pictures dropped: {dropped} of {pictures} (goal under 1 in 1000)", share < GOAL_DROPPED))
        out.append(
            (
                f"link: {self.answered} of {self.asked} questions answered, {self.unreadable} sets unreadable",
                0 < self.answered == self.asked and self.unreadable == 0,
            )
        )
        out.append(
            (
                f"recording: {self.recorded_sets} sets in it, {sets} made by the last minute's end",
                self.recorded_sets >= sets > 0,
            )
        )
        out.append(
            (
                f"log: {len(self.bad_lines)} errors or exceptions, exit code {self.code}",
                self.code == 0 and not self.bad_lines,
            )
        )
        return out

    @property
    def is_good(self) -> bool:
        """True if every goal was reached."""
        return all(is_good for _, is_good in self.verdicts())

    def report(self) -> str:
        """Table and verdicts."""
        rows = [
            [
                f"{m.minute}",
                f"{m.rss_mb:.1f}",
                f"{m.threads}",
                f"{m.files}",
                f"{m.queue}",
                "-" if m.delay_s is None else f"{m.delay_s:.2f}",
                "-" if m.longest_s is None else f"{m.longest_s:.2f}",
                f"{m.dropped}",
                f"{m.sets}",
                f"{m.sent}",
                f"{m.received}",
                f"{m.recorded_mb:.1f}",
                f"{m.recordings}",
                f"{m.speed:.1f}",
                self.faults.in_minute(m.minute),
            ]
            for m in shown(self.minutes)
        ]
        head = [
            "min", "MB", "threads", "files", "queue", "delay, s", "longest", "dropped", "sets", "sent", "received",
            "recorded, MB", "in files", "factor", "lost in it",
        ]  # fmt: skip
        states = ", ".join(f"{state} {n}" for state, n in sorted(self.states.items(), key=lambda kv: -kv[1]))
        lines = [
            f"{self.flight_s:.0f} s of flight in {self.wall_s:.0f} s wall: "
            f"{self.flight_s / max(self.wall_s, 1e-9):.1f} times real time",
            f"{self.ok_sets} of the sets answer clicks; states heard, once a second: {states}",
        ]
        goals = [f"{text}: {verdict(is_good)}" for text, is_good in self.verdicts()]
        bad = [f"log: {line}" for line in self.bad_lines[:10]]
        return "\n".join([*lines, "", table(head, rows), "", *goals, *bad])


def shown(minutes: Sequence[Minute]) -> list[Minute]:
    """All of few, every fifth of many, and always the first and the last."""
    if len(minutes) <= 20:
        return list(minutes)
    return [m for m in minutes if m.minute == 1 or m.minute % 5 == 0 or m is minutes[-1]]
