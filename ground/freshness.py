"""The age of a picture, and whether the newest one that can be clicked is what is seen now. No I/O.

An aircraft's clock may be hours off the ground's: ages come from the aircraft's answers, or from its clock as far as
that can be relied on (`ground.aircraft_clock`), and the ground adds what it measured itself.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from contract.answer import EXPLANATIONS, Answer, Refusal
from contract.feature_set import FeatureSet, Status
from contract.vehicle_status import VehicleStatus

MAX_AGE_S = 3.0  # of the newest picture, by default: at 24 m/s the aircraft is 70 m further by then
STATUS_S = 10.0  # of a status: its battery, fix and mode are no longer stated then
STATED_S = 5.0  # by how much clocks differ before it is reported of one that is known


def is_of_now(status: VehicleStatus, newest: FeatureSet | None, silent_s: float | None) -> bool:
    """Return whether a status is about the aircraft as it is at its newest picture, which bears the same clock.

    `silent_s`: since anything was received; None in a recording.
    """
    is_received = silent_s is None or silent_s <= STATUS_S
    return is_received and (newest is None or newest.capture_unix_ns / 1e9 - status.unix_s <= STATUS_S)


@dataclass(frozen=True)
class Later:
    """A newer picture that cannot be clicked."""

    status: Status
    frame: int
    age_s: float | None = None


@dataclass(frozen=True, eq=False)
class Reply:
    """A set or a refusal with its picture's age (None: not known), and what explains that there is nothing newer.

    `state` and `reason` are the daemon's own, empty if it is well or did not report them. `doubt`: what is to be known
    of the aircraft's clock, in words.
    """

    answer: FeatureSet | Refusal
    age_s: float | None = None
    later: Later | None = None
    state: str = ""
    reason: str = ""
    doubt: str = ""

    @property
    def why(self) -> str:
        """The reasons, as far as known, why the newest picture cannot be clicked."""
        causes = []
        if self.later is not None:
            age = "" if self.later.age_s is None else f", {self.later.age_s:.1f} s old,"
            status = self.later.status
            causes.append(f"frame {self.later.frame}{age} is refused: {status.value}: {EXPLANATIONS[status]}")
        if self.state:
            causes.append(f"the aircraft reports: {self.state}" + (f": {self.reason}" if self.reason else ""))
        causes += [self.doubt] if self.doubt else []
        return "; ".join(causes) or "no newer picture came"

    def later_by(self, seconds: float) -> Reply:
        """The same after some time: all ages grow."""
        later = self.later
        if later is not None and later.age_s is not None:
            later = replace(later, age_s=later.age_s + seconds)
        return replace(self, age_s=None if self.age_s is None else self.age_s + seconds, later=later)

    def fresh(self, max_age_s: float) -> FeatureSet | Refusal:
        """The answer if its picture is at most so old; else, and where that is not known, a refusal: `stale`."""
        found = self.answer
        if isinstance(found, Refusal) or math.isinf(max_age_s):
            return found
        age = too_old(self.age_s, max_age_s)
        if not age:
            return found
        what = "the newest picture that can be clicked" if found.is_ok else f"the newest picture ({found.status.value})"
        detail = f"{what} is {age}: {self.why}"
        return Refusal(Status.STALE, found.frame, found.capture_unix_ns, found.vehicle, detail, self.age_s)


def span(seconds: float) -> str:
    """A length of time for people, of any size."""
    for unit, in_s, most in (("s", 1.0, 100.0), ("min", 60.0, 100.0), ("h", 3600.0, 48.0), ("d", 86_400.0, 1000.0)):
        if seconds < most * in_s:
            return f"{seconds / in_s:.{1 if unit == 's' else 0}f} {unit}"
    return f"{seconds / 31_557_600.0:.0f} years"


def stamped_elsewhen(stamp_unix_s: float, now_unix_s: float) -> str:
    """Words for a message that is stamped far from now by this computer's clock; empty if it is not."""
    behind_s = now_unix_s - stamp_unix_s
    if abs(behind_s) <= STATED_S:
        return ""
    return f"stamped {span(abs(behind_s))} {'behind' if behind_s > 0.0 else 'ahead of'} this computer's clock"


def too_old(age_s: float | None, max_age_s: float) -> str:
    """The age of a picture that is too old, for people; empty if it is not."""
    if age_s is None:
        return "of unknown age (is the aircraft's software older than this?)"
    return f"{span(age_s)} old, more than {max_age_s:g} s" if age_s > max_age_s else ""


def aged(answer: Answer, age_s: float | None) -> Answer:
    return replace(answer, age_s=age_s)
