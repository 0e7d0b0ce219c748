"""Gimbals and cameras that speak for themselves: whose attitude and zoom are the camera's, and on which clock.

A gimbal's attitude may come several times over one line: from the gimbal's own component, with a boot clock of its own,
from the autopilot that passes it on, and in two kinds of message. One of them counts: the gimbal's own before the
autopilot's, and the newer message before the older. Another takes its place once it has been silent.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from onboard.clocks.boot_clock import Mode
from onboard.clocks.timesync import LinkClock
from onboard.events.types import GimbalAttitude, Zoom
from onboard.telemetry.mavlink_events import AUTOPILOT_COMPONENT, GIMBAL_EVENTS, ZOOM_EVENTS, boot_ns_of

GIMBAL_COMPONENTS = frozenset(
    [mavlink.MAV_COMP_ID_GIMBAL, *(getattr(mavlink, f"MAV_COMP_ID_GIMBAL{i}") for i in range(2, 7))]
)
CAMERA_COMPONENTS = frozenset(
    [mavlink.MAV_COMP_ID_CAMERA, *(getattr(mavlink, f"MAV_COMP_ID_CAMERA{i}") for i in range(2, 7))]
)
PAYLOADS = GIMBAL_COMPONENTS | CAMERA_COMPONENTS
SILENT_NS = 2_000_000_000  # after which another sender's attitude is taken
MAX_PENDING = 32
MESSAGES = tuple(GIMBAL_EVENTS)  # the better first


def is_of_payload(message: Any, wanted: int) -> bool:
    """Return whether a message is from a camera's component or a gimbal's: the `wanted` gimbal's, any if 0."""
    component = message.get_srcComponent()
    return component in CAMERA_COMPONENTS or (component in GIMBAL_COMPONENTS and wanted in (0, component))


@dataclass
class GimbalChoice:
    """The choice among several senders, fed with every attitude as it arrives. `wanted`: a component, 0 for any."""

    wanted: int = 0
    chosen: tuple[bool, int, int] | None = None  # (passed on, kind of message, component): the least is the best
    received_ns: int = 0

    def takes(self, message: Any, arrival_ns: int) -> bool:
        """Return whether this attitude is the camera's: its sender is the chosen one.

        A sender is chosen if it is better than the one before, or that has been silent for SILENT_NS.
        """
        component = message.get_srcComponent()
        if self.wanted not in (0, component):
            return False
        voice = component == AUTOPILOT_COMPONENT, MESSAGES.index(message.get_type()), component
        if self.chosen is None or voice < self.chosen or arrival_ns - self.received_ns > SILENT_NS:
            self.chosen = voice
        if voice != self.chosen:
            return False
        self.received_ns = arrival_ns
        return True

    @property
    def component(self) -> int | None:
        """The component whose attitudes are taken; None before the first."""
        return None if self.chosen is None else self.chosen[2]


@dataclass
class _Gimbal:
    """One component: its clock, and the newest message with its boot stamp."""

    clock: LinkClock
    newest: tuple[str, int] | None = None


@dataclass
class Gimbals:
    """All gimbals and cameras of one vehicle on a live line. No link, no thread, no clock of its own."""

    mode: Mode
    wanted: int = 0
    choice: GimbalChoice = field(init=False)
    _by_component: dict[int, _Gimbal] = field(default_factory=dict)
    _asked: deque[int] = field(default_factory=lambda: deque(maxlen=MAX_PENDING))

    def __post_init__(self) -> None:
        self.choice = GimbalChoice(self.wanted)

    def asked(self, sent_ns: int) -> None:
        """A TIMESYNC request has left: everyone on the line may answer it, each from a clock of its own."""
        self._asked.append(sent_ns)
        for gimbal in self._by_component.values():
            gimbal.clock.asked(sent_ns)

    def receive(self, message: Any, arrival_ns: int) -> list[GimbalAttitude | Zoom]:
        """A message of their own component -> attitude or zoom on our clock, if it holds one that counts."""
        component, name = message.get_srcComponent(), message.get_type()
        gimbal = self._by_component.setdefault(component, _Gimbal(LinkClock(self.mode)))
        if name == "TIMESYNC":
            if message.tc1 != 0 and message.ts1 in self._asked:
                gimbal.clock.exchanged(message.ts1, message.tc1, arrival_ns)
            return []
        if name not in GIMBAL_EVENTS and name not in ZOOM_EVENTS:
            return []
        stamp_ns = self._stamp(gimbal, message, arrival_ns)
        if stamp_ns is None:
            return []
        if name in ZOOM_EVENTS:
            zoom = ZOOM_EVENTS[name](message, stamp_ns)
            return [] if zoom is None else [zoom]
        event = GIMBAL_EVENTS[name](message, stamp_ns)
        return [] if event is None or not self.choice.takes(message, arrival_ns) else [event]

    @staticmethod
    def _stamp(gimbal: _Gimbal, message: Any, arrival_ns: int) -> int | None:
        """Return when the attitude was true; None while the clock is not known, and for a stamp that came before."""
        boot_ns = boot_ns_of(message)
        if not boot_ns:
            return arrival_ns  # it does not fill the stamp in
        if gimbal.clock.arrived(boot_ns, arrival_ns):
            gimbal.newest = None
        this = message.get_type(), boot_ns
        if this == gimbal.newest or not gimbal.clock.is_known(arrival_ns):
            return None
        gimbal.newest = this
        return gimbal.clock.to_host_ns(boot_ns)

    def figures(self) -> dict[str, float]:
        """Return the component that counts, and one sigma of its clock where it is another than the autopilot's."""
        component = self.choice.component
        if component is None:
            return {}
        out = {"gimbal_component": float(component)}
        if component in self._by_component:
            known = self._by_component[component].clock.figures()
            sigma_ms = known.get("clock_sigma_ms", known.get("arrival_sigma_ms"))
            out |= {} if sigma_ms is None else {"gimbal_clock_sigma_ms": sigma_ms}
        return out

    def complaint(self, now_ns: int, limit_s: float) -> str:
        """A gimbal that has fallen silent; empty where none is, or none has ever spoken."""
        silent_s = (now_ns - self.choice.received_ns) / 1e9
        if self.choice.chosen is None or silent_s <= limit_s:
            return ""
        return f"the gimbal (component {self.choice.component}) is silent for {silent_s:.0f} s"
