"""The reach of an aircraft through its autopilot's radio, a small packet of its own. docs/wire-format.md, section 13.

A radio that is full drops the large packets first: an answer or a piece of a set. This one is as long on the wire as a
heartbeat, so that it still comes where those do not.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum

from contract.errors import CorruptPayload
from contract.wire.click_code import MAJOR

STATE = 7
UNKNOWN = 0xFFFF
RATE_STEP, SET_STEP_S = 10.0, 0.1
LOWER_STREAMS = "lower what the autopilot streams to this radio (ArduPilot: SRn_* or MAVn_*; PX4: MAV_n_RATE)"
_STATE = struct.Struct("<BBHH")


class Held(IntEnum):
    """The cause that keeps sets or answers from coming."""

    BY_NOTHING = 0
    BY_RADIO = 1  # the autopilot drops what it has no room for, or lets it wait
    BY_CONFIGURATION = 2  # link.mavlink_bit_rate


@dataclass(frozen=True)
class RadioState:
    """The rate (bit/s) at which the aircraft may send sets now, and the time that one takes at it.

    Without both it is about answers to a question: they were sent, and the question came again and again.
    """

    held: Held
    bit_rate: float | None = None
    set_s: float | None = None

    @property
    def words(self) -> str:
        """The finding with what to do, in a line; empty where nothing is amiss."""
        if self.held is Held.BY_NOTHING:
            return ""
        if self.bit_rate is None or self.set_s is None:
            return f"the radio is full: answers are sent and do not arrive; {LOWER_STREAMS}"
        every = f"a set takes {self.set_s:.0f} s at the {self.bit_rate / 1000.0:.1f} kbit/s"
        if self.held is Held.BY_RADIO:
            return f"the radio is full: {every} that it has left; {LOWER_STREAMS}"
        return f"{every} of link.mavlink_bit_rate: raise it as far as the radio carries"


def encode_state(state: RadioState) -> bytes:
    """Return the six bytes."""
    rate, set_s = state.bit_rate, state.set_s
    return _STATE.pack(MAJOR << 4 | STATE, state.held, _steps(rate, RATE_STEP), _steps(set_s, SET_STEP_S))


def read_state(payload: bytes) -> RadioState | None:
    """Return a packet's content; None if it is of another kind. Raises CorruptPayload."""
    if not payload or payload[0] != MAJOR << 4 | STATE:
        return None
    if len(payload) != _STATE.size or payload[1] > max(Held):
        raise CorruptPayload(f"the state of a radio of {len(payload)} bytes")
    _, held, rate, set_s = _STATE.unpack(payload)
    known = UNKNOWN not in (rate, set_s)
    return RadioState(Held(held), rate * RATE_STEP, set_s * SET_STEP_S) if known else RadioState(Held(held))


def _steps(value: float | None, step: float) -> int:
    return UNKNOWN if value is None else min(max(round(value / step), 0), UNKNOWN - 1)
