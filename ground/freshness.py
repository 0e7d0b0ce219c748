"""How old a picture is, and whether the newest one that can be clicked is what is seen now. No I/O.

An aircraft's clock may be hours off the ground's, so ages never compare the two: they come from the aircraft, or from
captures among each other, and the ground adds what it measured itself.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from contract.answer import EXPLANATIONS, Answer, Refusal
from contract.feature_set import FeatureSet, Status

MAX_AGE_S = 3.0  # of the newest picture, by default: at 24 m/s the aircraft is 70 m further by then


@dataclass(frozen=True)
class Later:
    """A newer picture that cannot be clicked."""

    status: Status
    frame: int
    age_s: float | None = None


@dataclass(frozen=True, eq=False)
class Reply:
    """A set or a refusal with its picture's age (None: not known), and what explains that there is nothing newer.

    `state` and `reason` are the daemon's own, empty if it is well or did not report them.
    """

    answer: FeatureSet | Refusal
    age_s: float | None = None
    later: Later | None = None
    state: str = ""
    reason: str = ""

    @property
    def why(self) -> str:
        """Why the newest picture cannot be clicked, as far as it is known."""
        causes = []
        if self.later is not None:
            age = "" if self.later.age_s is None else f", {self.later.age_s:.1f} s old,"
            status = self.later.status
            causes.append(f"frame {self.later.frame}{age} is refused: {status.value}: {EXPLANATIONS[status]}")
        if self.state:
            causes.append(f"the aircraft reports: {self.state}" + (f": {self.reason}" if self.reason else ""))
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


def too_old(age_s: float | None, max_age_s: float) -> str:
    """How old a picture is if that is too old, for people; empty if it is not."""
    if age_s is None:
        return "of unknown age (is the aircraft's software older than this?)"
    return f"{age_s:.1f} s old, more than {max_age_s:g} s" if age_s > max_age_s else ""


class AircraftClock:
    """Ages of an aircraft's pictures by the ground's monotonic clock, from when its sets were received.

    A set received at h, of a picture of age a when it was sent, was captured at h - a at the latest; the least
    difference to its stamp is that of the set that came fastest, and what others took longer counts as their age.
    """

    # Largest rate at which two clocks' crystals drift apart: it limits what an old message can state about now.
    DRIFT = 100e-6

    def __init__(self) -> None:
        self._session = -1
        self._offset_ns = 0  # monotonic minus capture times, at most
        self._noted_ns = 0

    def received(self, session: int, capture_unix_ns: int, age_s: float | None, received_ns: int) -> None:
        """A set came; `age_s` is the age of its picture as its sender states it."""
        offset_ns = received_ns - round((age_s or 0.0) * 1e9) - capture_unix_ns
        if session != self._session or offset_ns < self._offset_at(received_ns):
            self._session, self._offset_ns, self._noted_ns = session, offset_ns, received_ns

    def age_s(self, capture_unix_ns: int, now_ns: int) -> float:
        """Seconds since a picture of that session was taken; what the fastest set took on its way is not in it."""
        return max((now_ns - self._offset_at(now_ns) - capture_unix_ns) / 1e9, 0.0)

    def _offset_at(self, now_ns: int) -> int:
        return self._offset_ns + round(self.DRIFT * (now_ns - self._noted_ns))


def aged(answer: Answer, age_s: float | None) -> Answer:
    """An answer with the age of its picture."""
    return replace(answer, age_s=age_s)
