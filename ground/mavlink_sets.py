"""Feature sets that come through autopilots' radio: asked for with reports, put together, handed on."""

from __future__ import annotations

import contextlib
import random
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from contract.errors import ForeignMessage, LinkError, WireError
from contract.feature_set import FeatureSet
from contract.wire.click_code import MAX_NUMBER, ClickQuestion
from contract.wire.set_pieces import SetAssembly, encode_report, read_piece
from ground.click_asking import Asking
from ground.mavlink_endpoint import MavlinkEndpoint
from ground.mavlink_link import MavlinkLink, NumberRefused
from ground.watched_thread import WatchedThread

REPORT_S = 2.0
REOPEN_S = 1.0


class RadioSystems:
    """The vehicle of each MAVLink system: the one that its first set names, for as long as this program listens."""

    def __init__(self) -> None:
        self._names: dict[int, str] = {}

    def checked(self, system: int, found: FeatureSet) -> FeatureSet:
        """A set of a system. Raises ForeignMessage if it names another vehicle, or one that is another system."""
        others = (number for number, name in self._names.items() if name == found.vehicle and number != system)
        if (other := next(others, None)) is not None:
            raise ForeignMessage(f"MAVLink system {system} sends what names {found.vehicle!r}, which is system {other}")
        if (known := self._names.setdefault(system, found.vehicle)) != found.vehicle:
            raise ForeignMessage(f"MAVLink system {system}, which is {known!r}, sends what names {found.vehicle!r}")
        return found

    def system_of(self, vehicle: str) -> int | None:
        """The system of a vehicle; None before its first set."""
        return next((number for number, name in self._names.items() if name == vehicle), None)


@dataclass(frozen=True)
class _Question:
    """A question to a vehicle, and who wants the answer: what its clock showed, and when it was asked."""

    asking: Asking
    asked_ns: int
    answered: Callable[[int, int], None]


class MavlinkSets:
    """Listens in a thread of its own, and opens a link that broke again. Raises LinkError if it cannot be opened.

    `take` gets the MAVLink system, its set, and the age its picture had when it was sent (s, or None), `on_packet` is
    called for whatever comes: both in that thread. Where the endpoint names a vehicle, no other's sets are taken.
    Once an aircraft has turned our number away nothing more is sent, whatever comes.
    """

    def __init__(
        self, endpoint: MavlinkEndpoint, take: Callable[[int, bytes, float | None], None], on_packet: Callable[[], None]
    ) -> None:
        self._endpoint, self._take, self._on_packet = endpoint, take, on_packet
        self._link: MavlinkLink | None = MavlinkLink(endpoint)
        self._assemblies: dict[int, SetAssembly] = {}
        self._report_s = -REPORT_S
        self.refusal = ""  # why nothing is asked for any more
        self._to_ask: deque[tuple[int, Callable[[int, int], None]]] = deque()
        self._asked: dict[int, _Question] = {}  # by system
        self._thread = WatchedThread("sets over MAVLink", self._work, 0.0)

    @property
    def trouble(self) -> str:
        """The cause that keeps sets from coming, in a line; empty if none is known."""
        link = self._link
        return self.refusal or self._thread.trouble or ("" if link is None else link.traffic.trouble(time.monotonic()))

    def ask(self, system: int | None, answered: Callable[[int, int], None]) -> None:
        """Ask a vehicle what its clock shows, by a click into its newest picture; from any thread.

        `answered` gets what it showed (Unix ns) and when it was asked (monotonic ns), in this thread.
        """
        if system is not None:
            self._to_ask.append((system, answered))

    def close(self) -> None:
        """No more sets."""
        self._thread.close()
        if self._link is not None:
            self._link.close()

    def _work(self) -> None:
        if self._link is None:
            self._thread.wait(REOPEN_S)
            if self.refusal:
                return
            self._link = MavlinkLink(self._endpoint)
        try:
            self._listen(self._link)
        except NumberRefused as refused:
            self.refusal = str(refused)
            self._link.close()
            self._link = None
        except LinkError:
            with contextlib.suppress(OSError):
                self._link.close()
            self._link = None
            raise

    def _listen(self, link: MavlinkLink) -> None:
        """Take the packets of a moment, report to every vehicle from time to time, send questions. Raises LinkError."""
        for vehicle, payload in link.received():
            if self._endpoint.vehicle not in (None, vehicle):
                continue
            self._on_packet()
            self._take_packet(vehicle, payload)
        if link.vehicles and time.monotonic() - self._report_s >= REPORT_S:
            now_s = self._report_s = time.monotonic()
            link.beat()
            for vehicle in link.vehicles:
                link.send(vehicle, encode_report(self._assemblies.setdefault(vehicle, SetAssembly()).report(now_s)))
        while self._to_ask:
            system, answered = self._to_ask.popleft()
            asking = Asking(ClickQuestion(random.randrange(MAX_NUMBER + 1), 0.0, 0.0), time.monotonic())
            self._asked[system] = _Question(asking, time.monotonic_ns(), answered)
            link.send(system, asking.packet(time.monotonic()))

    def _take_packet(self, vehicle: int, payload: bytes) -> None:
        try:
            piece = read_piece(payload)
            if piece is not None:
                whole = self._assemblies.setdefault(vehicle, SetAssembly()).take(piece, time.monotonic())
                if whole is not None:
                    self._take(vehicle, *whole)
        except WireError:
            return
        if (
            piece is None
            and vehicle in self._asked
            and (answer := self._asked[vehicle].asking.take(payload)) is not None
        ):
            question = self._asked.pop(vehicle)
            if answer.capture_unix_ns and answer.age_s is not None:
                question.answered(answer.capture_unix_ns + round(answer.age_s * 1e9), question.asked_ns)
