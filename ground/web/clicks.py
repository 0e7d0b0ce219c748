"""Clicks on a source's sets: which picture is meant, and what it answers."""

from __future__ import annotations

import threading
from collections import OrderedDict
from dataclasses import dataclass, replace

import numpy as np

from contract.answer import Answer, Fix, Refusal
from contract.errors import LinkError, WireError
from contract.feature_set import FeatureSet, Status
from contract.locate import Locator
from ground.freshness import aged
from ground.unmeasured import MOST_CHARACTERS, TOO_MANY
from ground.web.source import Source

KEPT_LOCATORS = 64
MOST_MEASURED = 12  # questions to aircraft under way at once: the threads of requests are forty


@dataclass(frozen=True, eq=False)
class Clicked:
    """An answer with what it was made from; no set where there is none."""

    answer: Answer
    feature_set: FeatureSet | None = None
    locator: Locator | None = None


class Clicker:
    """Thread-safe; the last pictures' solutions are kept, so that a second click on one costs little."""

    def __init__(self, source: Source) -> None:
        self._source = source
        self._lock = threading.Lock()
        self._asking = threading.BoundedSemaphore(MOST_MEASURED)
        self._kept: OrderedDict[tuple[str, int, int], Locator] = OrderedDict()

    def click(self, vehicle: str, session: int | None, frame: int, u_px: float, v_px: float) -> Clicked:
        """The answer of one pixel of one picture, whether it is the newest or not."""
        found = self._source.feature_set(vehicle, session, frame)
        if found is None:
            return Clicked(
                Refusal(Status.UNKNOWN_FRAME, frame, vehicle=vehicle, detail=self._unknown(vehicle, session))
            )
        locator = self.locator(found)
        answer = locator.locate(np.array([u_px, v_px]))
        return Clicked(aged(answer, self._source.age_s(found)), found, locator)

    def measured(self, clicked: Clicked, u_px: float, v_px: float) -> Clicked:
        """The answer once the aircraft has measured the pixel; where it has not, the first one with the reason.

        Takes as long as `Source.measured`. What no one can be asked about comes back as it is.
        """
        first, found = clicked.answer, clicked.feature_set
        if not self._source.measures or found is None or not isinstance(first, Fix):
            return clicked
        if not self._asking.acquire(blocking=False):
            return replace(clicked, answer=replace(first, unmeasured=TOO_MANY))
        try:
            asked = self._source.measured(found, (u_px, v_px))
        except (LinkError, WireError) as error:
            return replace(clicked, answer=replace(first, unmeasured=str(error)[:MOST_CHARACTERS]))
        finally:
            self._asking.release()
        locator = Locator(asked)
        answer = aged(locator.locate(np.array([u_px, v_px])), self._source.age_s(asked))
        if isinstance(answer, Fix):
            return Clicked(answer, asked, locator)
        return replace(clicked, answer=replace(first, unmeasured=answer.reason[:MOST_CHARACTERS]))

    def locator(self, feature_set: FeatureSet) -> Locator:
        """A set's Locator, once for each revision."""
        key = feature_set.vehicle, feature_set.session, feature_set.frame
        with self._lock:
            held = self._kept.get(key)
            if held is not None and held.feature_set is feature_set:
                self._kept.move_to_end(key)
                return held
        made = Locator(feature_set)
        with self._lock:
            self._kept[key] = made
            while len(self._kept) > KEPT_LOCATORS:
                self._kept.popitem(last=False)
        return made

    def _unknown(self, vehicle: str, session: int | None) -> str:
        if vehicle not in self._source.vehicles():
            return f"no vehicle {vehicle!r} is known here"
        rows = self._source.frames(vehicle)
        if session is not None and rows and rows[-1].session != session:
            return "the aircraft's software was restarted after this picture: its earlier sets are gone"
        return "no set of this picture is there"
