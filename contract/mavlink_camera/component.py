"""A MAVLink camera component: commands of ground stations in, acknowledgements and states out. No link, no thread.

By MAVLink's camera protocol v2. Clicks (MAV_CMD_CAMERA_TRACK_POINT) and looks are answered elsewhere, by a `CameraEnd`;
nothing of what is received here commands the autopilot or the camera. What is not addressed to this component is not
answered, and what waits is bounded: in a flood the oldest is served and the rest is refused or dropped.
"""

from __future__ import annotations

import math
import struct
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from contract.answer import Fix, Refusal
from contract.feature_set import Status
from contract.mavlink_camera.end import Answered, CameraEnd, Clicked, Share, VideoClick, View, ViewQuestion
from contract.mavlink_camera.messages import CameraFacts, words_of
from contract.mavlink_camera.status_texts import StatusTexts
from contract.track_age import SILENT_S

NS_PER_S = 1_000_000_000
FRAME_BYTES = 12  # of a packet, in addition to its payload
BEAT_NS = NS_PER_S  # a ground station takes a camera for gone after five seconds
CONTESTED_NS = 10 * NS_PER_S  # since another camera of our number was received
MAX_OUT = 24  # messages that wait for the bit rate
MAX_PENDING = 8  # questions that are being answered
ANSWERED_NS = 5 * NS_PER_S  # after which a question is taken for lost
SAME_TEXT_NS = 5 * NS_PER_S  # between two texts with the same words
LEAST_INTERVAL_US, MOST_INTERVAL_US = 100_000.0, 3.6e9

# Numbers of MAVLink's common.xml: MAV_RESULT,
ACCEPTED, BUSY, DENIED, UNSUPPORTED, FAILED, IN_PROGRESS, CANCELLED = range(7)
# messages,
INFORMATION, SETTINGS, STREAM_INFORMATION, STREAM_STATUS, FOV, IMAGE, GEO = 259, 260, 269, 270, 271, 275, 276
STREAMED = FOV, IMAGE, GEO
# MAV_CMD,
SET_MESSAGE_INTERVAL, REQUEST_MESSAGE, CAMERA_TRACK_POINT, CAMERA_STOP_TRACKING = 511, 512, 2004, 2010
# commands of before MAV_CMD_REQUEST_MESSAGE with what they ask for (the first two with 1),
OLD_REQUESTS = {521: INFORMATION, 522: SETTINGS, 2504: STREAM_INFORMATION, 2505: STREAM_STATUS}
# MAV_TYPE_CAMERA, MAV_AUTOPILOT_INVALID, MAV_STATE_ACTIVE, the version of HEARTBEAT; and MAV_SEVERITY.
CAMERA_BEAT = 30, 8, 0, 0, 4, 3
WARNING, INFO = 4, 6
# Refusals that no waiting mends: the pixel's, or the camera's.
PERMANENT = {
    Status.OUTSIDE, Status.ABOVE_HORIZON, Status.OUTSIDE_CALIBRATION, Status.STABILISED, Status.ZOOMED,
    Status.MIRRORED, Status.STRETCHED, Status.CAMERA_LOST,
}  # fmt: skip


@dataclass(frozen=True)
class _Command:
    """A command to us: its sender, what it is, its first four parameters, and whether it was sent again."""

    sender: tuple[int, int]
    command: int
    parameters: tuple[float, ...]
    is_again: bool
    arrival_ns: int  # by the clock of the pictures

    @property
    def key(self) -> tuple[tuple[int, int], int, bytes]:
        """The same for a command that is sent again, also where a parameter is nan."""
        return self.sender, self.command, struct.pack("<4f", *self.parameters)


class MavlinkCamera:
    """One camera component. `receive` and `due` are called by one thread. `monotonic_s` is the clock of `share`."""

    def __init__(
        self,
        component: int,
        facts: CameraFacts,
        end: CameraEnd,
        share: Share,
        *,
        signature_bytes: int = 0,
        monotonic_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self.component, self._facts, self._end, self._share = component, facts, end, share
        self._overhead, self._monotonic_s = FRAME_BYTES + signature_bytes, monotonic_s
        self._acknowledgements: deque[Any] = deque()
        self._out: deque[Any] = deque()
        self._texts = StatusTexts(facts.dialect)
        self._shown = "", -SAME_TEXT_NS  # the last text, and when
        self._pending: dict[int, tuple[_Command, int]] = {}  # with when it came
        self._number = 0
        self._clicked: tuple[_Command, int] | None = None  # the last, and its result
        self._fix: Fix | None = None  # of the last click
        self._fixed_ns = 0  # when it came
        self._is_fix_followed = False
        self._was_followed = self._is_view_asked = False
        self._intervals: dict[int, tuple[int, int]] = {}  # of a message: how long, and when it is due next
        self._next_beat_ns = 0
        self._contested_ns: int | None = None
        self._handlers: dict[int, Callable[[_Command, int], int | None]] = {
            REQUEST_MESSAGE: self._request,
            SET_MESSAGE_INTERVAL: self._set_interval,
            CAMERA_TRACK_POINT: self._track_point,
            CAMERA_STOP_TRACKING: self._stop_tracking,
            **dict.fromkeys(OLD_REQUESTS, self._old_request),
        }

    # --- in ---

    def receive(self, message: Any, system: int | None, now_ns: int, arrival_ns: int | None = None) -> None:
        """One message from the line; `system`: the vehicle's number, as far as it is known.

        `arrival_ns` is now by the clock of the pictures, where that is another.
        """
        name = message.get_type()
        if system is None:
            return
        if name == "HEARTBEAT" and (message.get_srcSystem(), message.get_srcComponent()) == (system, self.component):
            self._contested_ns = now_ns
        if name not in ("COMMAND_LONG", "COMMAND_INT") or message.target_system != system:
            return
        is_for_all = message.target_component == 0
        handler = self._handlers.get(message.command)
        if message.target_component not in (0, self.component) or self._is_contested(now_ns):
            return
        sender = message.get_srcSystem(), message.get_srcComponent()
        parameters = message.param1, message.param2, message.param3, message.param4
        command = _Command(
            sender,
            message.command,
            parameters,
            bool(getattr(message, "confirmation", 0)),
            now_ns if arrival_ns is None else arrival_ns,
        )
        if handler is None and is_for_all:  # it may be someone else's, as what is denied may
            return
        result = UNSUPPORTED if handler is None else handler(command, now_ns)
        if result is not None and not (is_for_all and result == DENIED):
            self._acknowledge(command, result)

    def _request(self, command: _Command, now_ns: int) -> int | None:
        return self._asked_for(command, _whole(command.parameters[0]), command.parameters[1], now_ns)

    def _old_request(self, command: _Command, now_ns: int) -> int | None:
        wanted, first = OLD_REQUESTS[command.command], command.parameters[0]
        if wanted in (INFORMATION, SETTINGS):
            if first not in (0.0, 1.0):
                return DENIED
            return ACCEPTED if first == 0.0 else self._asked_for(command, wanted, 0.0, now_ns)
        return self._asked_for(command, wanted, first, now_ns)

    def _asked_for(self, command: _Command, wanted: int | None, index: float, now_ns: int) -> int | None:
        """Send one message once; the result, None where it comes later."""
        facts = self._facts
        if wanted == FOV:
            return self._ask(command, ViewQuestion(self._next_number()), now_ns)
        if wanted == GEO:
            found = self._geo_status(now_ns)
            if found is not None:
                self._put(found)
            return BUSY if found is None else ACCEPTED
        if wanted in (STREAM_INFORMATION, STREAM_STATUS):
            if facts.stream is None or index not in (0.0, 1.0):
                return DENIED
            whole = wanted == STREAM_INFORMATION
            self._put(facts.stream_information(facts.stream) if whole else facts.stream_status())
            return ACCEPTED
        if wanted == INFORMATION:
            self._put(facts.information(now_ns))
        elif wanted == SETTINGS:
            self._put(facts.settings(now_ns))
        elif wanted == IMAGE:
            self._put(facts.image_status(self._end.followed()))
        else:
            return DENIED
        return ACCEPTED

    def _set_interval(self, command: _Command, now_ns: int) -> int | None:
        """Set an interval, or end it: -1 does, and 0, the default rate, for nothing is sent by itself."""
        wanted, interval_us = _whole(command.parameters[0]), command.parameters[1]
        if wanted not in STREAMED or not math.isfinite(interval_us):
            return DENIED
        if interval_us in (-1.0, 0.0):
            self._intervals.pop(wanted, None)
            return ACCEPTED
        if not LEAST_INTERVAL_US <= interval_us <= MOST_INTERVAL_US:
            return DENIED
        interval_ns = round(interval_us * 1e3)
        self._intervals[wanted] = interval_ns, now_ns + interval_ns
        return ACCEPTED

    def _track_point(self, command: _Command, now_ns: int) -> int | None:
        if any(waiting.key == command.key for waiting, _ in self._pending.values()):
            return IN_PROGRESS
        if command.is_again:
            if self._clicked is not None and self._clicked[0].key == command.key:
                return self._clicked[1]
            # It was clicked some seconds before it came: no one knows on which picture.
            self._show(WARNING, "click: it came late, click again", now_ns)
            return BUSY
        u, v, _, camera = command.parameters
        if not (0.0 <= u <= 1.0 and 0.0 <= v <= 1.0):
            self._show(WARNING, "click: the point is off the picture", now_ns)
            return DENIED
        if not self._is_ours(camera):
            return DENIED
        result = self._ask(command, VideoClick(self._next_number(), (u, v), command.arrival_ns), now_ns)
        if result == BUSY:
            self._show(WARNING, "click: too many at once", now_ns)
        return result

    def _stop_tracking(self, command: _Command, now_ns: int) -> int | None:
        if not self._is_ours(command.parameters[0]):
            return DENIED
        self._end.stop()
        for number in [n for n, (asked, _) in self._pending.items() if asked.command == CAMERA_TRACK_POINT]:
            self._acknowledge(self._pending.pop(number)[0], CANCELLED)
        self._fix = None
        return ACCEPTED

    def _is_ours(self, camera: float) -> bool:
        """Return whether a command's Target Camera ID leaves us a part in it; nan is none."""
        return math.isnan(camera) or camera in (0.0, float(self.component))

    def _ask(self, command: _Command, asked: VideoClick | ViewQuestion, now_ns: int) -> int | None:
        if len(self._pending) >= MAX_PENDING or not self._end.ask(asked):
            return BUSY
        self._pending[asked.number] = command, now_ns
        return None

    def _next_number(self) -> int:
        self._number += 1
        return self._number

    # --- out ---

    def due(self, now_ns: int) -> list[Any]:
        """Return the messages to send now, the bit rate paid."""
        if self._is_contested(now_ns):
            return []
        for answered in self._end.answers():
            self._take(answered, now_ns)
        for number in [n for n, (_, asked_ns) in self._pending.items() if now_ns - asked_ns > ANSWERED_NS]:
            self._acknowledge(self._pending.pop(number)[0], BUSY)
        self._stream(now_ns)
        for message in self._texts.due(now_ns):
            self._put(message)
        out, now_s = list[Any](), self._monotonic_s()
        if now_ns >= self._next_beat_ns:  # paid, but never put off: without it the camera is taken for gone
            self._next_beat_ns = now_ns + BEAT_NS
            out.append(self._facts.dialect.MAVLink_heartbeat_message(*CAMERA_BEAT))
            self._share.take(self._cost(out[0]), now_s)
        for waiting in (self._acknowledgements, self._out):
            while waiting and self._share.wait_s(self._cost(waiting[0]), now_s) <= 0.0:
                out.append(waiting.popleft())
                self._share.take(self._cost(out[-1]), now_s)
        return out

    def complaint(self, now_ns: int) -> str:
        """The reason why nothing is answered; empty if there is none."""
        if not self._is_contested(now_ns):
            return ""
        return f"another camera is component {self.component}: set mavlink_camera.component to a free number"

    def _is_contested(self, now_ns: int) -> bool:
        return self._contested_ns is not None and now_ns - self._contested_ns < CONTESTED_NS

    def _cost(self, message: Any) -> int:
        return self._overhead + int(message.unpacker.size)

    def _take(self, answered: Answered, now_ns: int) -> None:
        command, _ = self._pending.pop(answered.number, (None, 0))
        if isinstance(answered, View):
            self._take_view(answered, command, now_ns)
        elif command is not None:
            self._take_click(answered, command, now_ns)

    def _take_view(self, view: View, command: _Command | None, now_ns: int) -> None:
        self._is_view_asked = self._is_view_asked and view.number != 0
        is_there = view.feature_set is not None and view.middle is not None
        if command is not None:
            self._acknowledge(command, ACCEPTED if is_there else BUSY)
        if view.feature_set is not None and view.middle is not None:
            taken_ns = now_ns - round(view.age_s * NS_PER_S)
            self._put(self._facts.fov_status(view.feature_set, view.middle, taken_ns))

    def _take_click(self, clicked: Clicked, command: _Command, now_ns: int) -> None:
        answer = clicked.answer
        if isinstance(answer, Refusal):
            result = FAILED if answer.status in PERMANENT else BUSY
            self._show(WARNING, words_of(answer), now_ns)
            if not self._is_fix_followed:  # what was clicked last has no place
                self._fix = None
        else:
            result, self._fix, self._is_fix_followed = ACCEPTED, answer, clicked.is_followed
            self._fixed_ns = now_ns
            self._put(self._facts.geo_of_fix(answer, is_followed=clicked.is_followed))
            not_followed = f"; not followed: {clicked.unfollowed}" if clicked.unfollowed else ""
            self._show(INFO, words_of(answer) + not_followed, now_ns)
        self._clicked = command, result
        self._acknowledge(command, result)

    def _geo_status(self, now_ns: int) -> Any | None:
        """The place of what is followed, else of what was clicked last; None without one, and of what was followed and
        is not any more, or was not reported yet when it should have been: it has left where it was clicked.
        """
        report = self._end.followed()
        if report is not None:
            return self._facts.geo_of_track(report)
        is_overdue = now_ns - self._fixed_ns > SILENT_S * NS_PER_S
        if self._fix is None or (self._is_fix_followed and (is_overdue or not self._end.is_following)):
            return None
        return self._facts.geo_of_fix(self._fix, is_followed=self._is_fix_followed)

    def _stream(self, now_ns: int) -> None:
        """Send what was asked for in intervals and is due: what is followed, once that it is no longer, the view."""
        for wanted, (interval_ns, due_ns) in self._intervals.items():
            if now_ns < due_ns:
                continue
            self._intervals[wanted] = interval_ns, now_ns + interval_ns
            if wanted == FOV:  # one at a time: clicks wait in the same queue
                self._is_view_asked = self._is_view_asked or self._end.ask(ViewQuestion(0))
            elif wanted == GEO:
                if (found := self._geo_status(now_ns)) is not None:
                    self._put(found)
            else:
                report = self._end.followed()
                if report is not None or self._was_followed:
                    self._put(self._facts.image_status(report))
                self._was_followed = report is not None

    def _show(self, severity: int, text: str, now_ns: int) -> None:
        shown, shown_ns = self._shown
        if text != shown or now_ns - shown_ns >= SAME_TEXT_NS:
            self._shown = text, now_ns
            self._texts.add(severity, text)

    def _acknowledge(self, command: _Command, result: int) -> None:
        if len(self._acknowledgements) < MAX_OUT:
            acknowledgement = self._facts.dialect.MAVLink_command_ack_message
            self._acknowledgements.append(acknowledgement(command.command, result, 0, 0, *command.sender))

    def _put(self, message: Any) -> None:
        if len(self._out) < MAX_OUT:
            self._out.append(message)


def _whole(value: float) -> int | None:
    """A parameter that is a whole number; None for any other."""
    return int(value) if math.isfinite(value) and value == int(value) else None
