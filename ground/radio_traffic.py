"""The traffic through an autopilot's radio, its own and ours: by it a full radio differs from a silent aircraft."""

from __future__ import annotations

from dataclasses import dataclass

from contract.wire.radio_state import LOWER_STREAMS, RadioState

WINDOW_S = 5.0  # over which bit rates are taken
QUIET_S = 12.0  # without a packet of ours, where sets are asked for every 2 s
FRESH_S = 70.0  # that an aircraft's own word counts; it is repeated every 30 s, and taken back


@dataclass
class _OfSystem:
    """The traffic of one MAVLink system."""

    began_s: float
    ours_s: float  # when the last packet of ours came, or it was received first
    bits: float = 0.0
    bit_rate: float | None = None  # of the window before
    state: tuple[RadioState, float] | None = None


class RadioTraffic:
    """Written by the link's thread, read by any."""

    def __init__(self) -> None:
        self._systems: dict[int, _OfSystem] = {}

    def came(self, system: int, size: int, now_s: float, *, is_ours: bool) -> None:
        """A message of so many bytes came from a vehicle; of the autopilot's own the bits are counted."""
        held = self._systems.setdefault(system, _OfSystem(now_s, now_s))
        if is_ours:
            held.ours_s = now_s
            return
        if now_s - held.began_s >= WINDOW_S:
            held.bit_rate, held.began_s, held.bits = held.bits / (now_s - held.began_s), now_s, 0.0
        held.bits += 8.0 * size

    def stated(self, system: int, state: RadioState, now_s: float) -> None:
        """An aircraft has reported how it gets through."""
        self._systems.setdefault(system, _OfSystem(now_s, now_s)).state = state, now_s

    def own_words(self, system: int, since_s: float) -> str:
        """The aircraft's own words of what is amiss, if they came since then; else empty."""
        held = self._systems.get(system)
        state = None if held is None else held.state
        return "" if state is None or state[1] < since_s else state[0].words

    def autopilots_words(self, system: int, now_s: float) -> str:
        """The bit rate of the autopilot's messages in words, and what follows if the radio carries no more."""
        held = self._systems.get(system)
        if held is None:
            return ""
        bit_rate = held.bit_rate
        if bit_rate is None:
            bit_rate = held.bits / max(now_s - held.began_s, 1.0)
        return (
            f"{bit_rate / 1000.0:.1f} kbit/s of its autopilot's own messages come: if the radio carries no more, it is "
            f"full, and nothing of ours finds room; {LOWER_STREAMS}"
        )

    def trouble(self, now_s: float) -> str:
        """The cause that keeps sets from coming, by system number if there are several; empty if none is known."""
        found = {system: self._trouble(system, now_s) for system in sorted(self._systems)}
        if len(found) == 1:
            return next(iter(found.values()))
        return "; ".join(f"system {system}: {words}" for system, words in found.items() if words)

    def _trouble(self, system: int, now_s: float) -> str:
        words = self.own_words(system, now_s - FRESH_S)
        if not words and now_s - self._systems[system].ours_s > QUIET_S:
            silent = "nothing of pc-onboard comes: it does not run, lacks link.mavlink, or serves another ground"
            words = f"{silent}; {self.autopilots_words(system, now_s)}"
        return words
