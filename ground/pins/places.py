"""Present places of a store's pins: fused, tied, computed once for each version of a pin and of the ties."""

from __future__ import annotations

import threading
from collections.abc import Sequence

from ground.pins.fusion import Contradiction, Fused, Unplaced, Vector, fuse, vector
from ground.pins.model import Pin, PinClick, Tie
from ground.pins.store import PinStore


class Places:
    """The places of a store's pins. Every method may be called from any thread."""

    def __init__(self, store: PinStore) -> None:
        self._store = store
        self._lock = threading.Lock()
        # By the pin's id: its version and that of the ties of its sessions.
        self._known: dict[str, tuple[tuple[int, tuple[str, ...]], Fused]] = {}

    def place(self, pin: Pin) -> Fused:
        """The place of a pin, or the reason why it has none."""
        return self.of([pin])[0]

    def of(self, pins: Sequence[Pin]) -> list[Fused]:
        """The same for many: the ties are read once."""
        by_session: dict[tuple[str, int | None], list[Tie]] = {}
        for tie in self._store.ties():
            by_session.setdefault((tie.click.vehicle, tie.click.session), []).append(tie)
        out = []
        for pin in pins:
            ties: list[Tie] = []
            if by_session:
                sessions = {(click.vehicle, click.session) for click in pin.clicks if click.errors is not None}
                ties = [tie for session in by_session if session in sessions for tie in by_session[session]]
            version = pin.modified_unix_ns, tuple(tie.id for tie in ties)
            with self._lock:
                held = self._known.get(pin.id)
            if held is None or held[0] != version:
                held = version, fuse(pin.clicks, ties)
                with self._lock:
                    self._known[pin.id] = held
            out.append(held[1])
        return out

    def with_click(self, pin: Pin, click: PinClick) -> Fused:
        """The place that a pin would have with one more click."""
        return self.of_clicks([*pin.clicks, click])

    def of_clicks(self, clicks: Sequence[PinClick]) -> Fused:
        """The place of clicks of one thing that are no pin yet, as if they were one."""
        return fuse(clicks, self._ties_of(clicks))

    def ties_of(self, pin: Pin) -> list[Tie]:
        """The ties that apply to a pin: those of its clicks' sessions."""
        return self._ties_of(pin.clicks)

    def _ties_of(self, clicks: Sequence[PinClick]) -> list[Tie]:
        sessions = {(click.vehicle, click.session) for click in clicks if click.errors is not None}
        return [tie for tie in self._store.ties() if (tie.click.vehicle, tie.click.session) in sessions]

    def between(self, one: Pin, two: Pin) -> Vector | Contradiction | Unplaced:
        """Distance, bearing and height difference from one pin to another."""
        ties = {tie.id: tie for tie in [*self.ties_of(one), *self.ties_of(two)]}
        return vector(one.clicks, two.clicks, list(ties.values()))
