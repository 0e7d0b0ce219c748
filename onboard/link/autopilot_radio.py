"""All that goes through the autopilot's radio: answers to clicks first, then sets, below one bit rate."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable
from typing import Self

from contract.supervised_thread import SupervisedThread
from contract.wire.click_code import TurnedAway, encode_answer
from contract.wire.set_pieces import MAX_WIRE_BYTES
from onboard.config.schema import Config
from onboard.events.tunnel import Peer, RadioReport
from onboard.link.byte_budget import Bucket
from onboard.link.click_service import ClickService
from onboard.link.publisher import Publisher
from onboard.link.reply import Answer, Question
from onboard.link.set_feed import SetFeed

OVERHEAD, SIGNATURE = 17, 13  # bytes on the wire in addition to a payload in MAVLink's TUNNEL
BURST_S = 0.5
MAX_TURNED_AWAY = 4  # between two looks
NUMBERED = struct.Struct("<BH")  # how every packet of a ground begins: its kind, and a number
REPORTED_S = 10.0  # that a radio's own report is news
GROUND_STATIONS = 255, 255  # as autopilots have it unless they report others


def radio_bucket(max_bit_rate: float, now_s: float) -> Bucket:
    """The bytes that may go through the autopilot, at `link.mavlink_bit_rate`."""
    return Bucket(max_bit_rate / 8.0, max(BURST_S * max_bit_rate / 8.0, MAX_WIRE_BYTES), now_s)


class AutopilotRadio:
    """A `TunnelEnd` for grounds behind the autopilot.

    Grounds that send as one of its ground stations are turned away: they would hide from it that it has lost that one.
    `look_up` and `age_s` are `Publisher`'s.
    """

    def __init__(
        self,
        vehicle: str,
        look_up: Callable[[Question], Answer | None],
        age_s: Callable[[int], float | None],
        max_bit_rate: float,
        *,
        is_signed: bool = False,
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        overhead = OVERHEAD + is_signed * SIGNATURE
        self.bucket = bucket = radio_bucket(max_bit_rate, now_ns() / 1e9)
        self._overhead, self._now_ns = overhead, now_ns
        self.clicks = ClickService(vehicle, look_up, overhead, bucket, now_ns)
        self.feed = SetFeed(max_bit_rate, overhead, bucket, age_s, now_ns)
        self._ground_stations = GROUND_STATIONS
        self._turned_away: dict[Peer, int] = {}  # with the number of their question
        self._reported: tuple[int, float] | None = None  # what is free of a radio's buffer, and when that was

    @classmethod
    def open(cls, config: Config, link: Publisher) -> Self:
        """Open it as the configuration specifies, with its thread running; sets are those that `link` publishes."""
        is_signed = config.telemetry.signing_key is not None
        radio = cls(config.vehicle.id, link.look_up, link.age_s, config.link.mavlink_bit_rate, is_signed=is_signed)
        link.watches.append(radio.feed.offer)
        radio.clicks.thread.start()
        return radio

    @property
    def thread(self) -> SupervisedThread:
        return self.clicks.thread

    def close(self) -> None:
        self.clicks.close()

    def charge(self, wire_bytes: int) -> None:
        """Count what the autopilot passes on of ours in addition: heartbeats, time requests, texts to the pilot."""
        self.bucket.take(wire_bytes, self._now_ns() / 1e9)

    def know_ground_stations(self, low: int, high: int) -> None:
        """The system numbers that the autopilot takes for its ground stations."""
        self._ground_stations = low, high

    def note_radio(self, free_percent: int) -> None:
        """Note how much of its buffer a radio on our line has left."""
        self._reported = free_percent, self._now_ns() / 1e9

    def report(self) -> RadioReport:
        """Return how it goes, from any thread."""
        state, reported = self.feed.state(), self._reported
        is_news = reported is not None and self._now_ns() / 1e9 - reported[1] < REPORTED_S
        return RadioReport(
            None if state is None else state.bit_rate,
            None if state is None else state.set_s,
            "" if state is None else state.words,
            self.clicks.answered,
            self.clicks.unheard,
            reported[0] if reported is not None and is_news else None,
        )

    def receive(self, ground: Peer, payload: bytes) -> None:
        """A packet from a ground; what is nothing of ours is passed over."""
        low, high = self._ground_stations
        if not low <= ground.system <= high:
            self.clicks.receive(ground, payload)
            self.feed.receive(ground, payload)
        elif len(self._turned_away) < MAX_TURNED_AWAY and len(payload) >= NUMBERED.size:
            self._turned_away[ground] = NUMBERED.unpack_from(payload)[1]

    def due(self) -> list[tuple[Peer, bytes]]:
        """Return the packets that may go now, the bit rate paid."""
        out = [(ground, TurnedAway(number, *self._ground_stations)) for ground, number in self._turned_away.items()]
        self._turned_away.clear()
        refusals = [(ground, encode_answer(refusal)) for ground, refusal in out]
        for _, refusal in refusals:
            self.bucket.take(len(refusal) + self._overhead, self._now_ns() / 1e9)
        return refusals + self.clicks.due() + self.feed.due()
