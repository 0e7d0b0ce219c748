"""Clicks on a source's sets: which picture is meant, and what it answers."""

from __future__ import annotations

import threading
from collections import OrderedDict
from dataclasses import dataclass

import numpy as np

from contract.answer import Answer, Refusal
from contract.feature_set import FeatureSet, Status
from contract.locate import Locator
from ground.freshness import aged
from ground.web.source import Source

KEPT_LOCATORS = 64


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
