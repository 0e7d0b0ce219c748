"""The thread that answers who asks to have the camera look at a place: an offer first, and the command once confirmed.

Where the camera looks the aircraft may be sent to circle, by a second offer that is confirmed like the first.

The place is found here again, by the set of the picture that was clicked: what a person asks for is compared with that,
and never sent itself. A question only joins a short queue, and what waits too long there is refused: a command comes
soon or not at all.
"""

from __future__ import annotations

import json
import logging
import math
import secrets
import time
from collections import OrderedDict, deque
from collections.abc import Callable
from dataclasses import dataclass, replace

from contract.answer import EXPLANATIONS, Fix
from contract.circular_error import ce90_m, le90_m
from contract.errors import InputError
from contract.geodesy import distance_m
from contract.locate import Locator
from contract.look import LATE_S, OFFER_S, AskCircle, AskLook, Circle, ConfirmLook, EndLook, Offer, read_request
from contract.supervised_thread import SupervisedThread, WokenWork
from contract.track import refused
from contract.vehicle_status import MAX_LOOK
from contract.wire.codec import decode
from onboard.config.link import Look
from onboard.events.pointing import (
    ACCEPTED,
    NO_AUTOPILOT,
    NO_CIRCLE,
    NOT_ACKNOWLEDGED,
    ON_GROUND,
    CircleAbout,
    LookAhead,
    LookAt,
    Order,
    PointingEnd,
)

MAX_ASKED = 4  # questions that wait for this thread
MAX_OFFERS = 16
BETWEEN_S = 2.0  # commands to the autopilot, whoever asks
REST = 1.0  # of the time that a question took, in which it leaves the processor to others
MOST_REST_S = 0.1
IDLE_S = 0.5
CUT = "..."
MAX_NOTICE = 88  # characters for the pilot: "pointclick: " goes before it, and a text has 100

Done = Callable[[bytes, bool], object]  # takes the answer, and whether it is a refusal
SetOf = Callable[[int], "tuple[bytes, float | None] | None"]

log = logging.getLogger("pointclick")

UNSENT = {
    NO_CIRCLE: "a VTOL, a vehicle of another kind, or one that does not report whether it is a VTOL: nothing was sent",
    ON_GROUND: "the autopilot reports that the aircraft is on the ground: nothing was sent",
    NO_AUTOPILOT: "no autopilot is received: nothing was sent",
    NOT_ACKNOWLEDGED: "the autopilot has not acknowledged it: it may have been done or not, look at the picture",
}


class _Refused(Exception):
    """A question that is not done: a word for programs, a sentence for people."""

    def __init__(self, word: str, reason: str) -> None:
        super().__init__(word, reason)
        self.answer = refused(word, reason)


@dataclass(frozen=True)
class _Asked:
    who: str
    parameters: str
    done: Done
    at_s: float


@dataclass(eq=False)
class _Offered:
    offer: Offer
    who: str
    at_s: float
    height_sigma_m: float  # of the place
    about: str = ""  # of a circle: the ticket of the look at its place
    outcome: tuple[bytes, bool] | None = None  # once it was confirmed: asked again, the same answer


class LookThread(WokenWork):
    """`set_of` gives a picture's set, encoded, and how old the picture is (s), None if it is not there.

    `notified` get what was sent in words, for the pilot; `newest` has who asked, where to and what came of it.
    """

    def __init__(
        self, limits: Look, set_of: SetOf, autopilot: PointingEnd, monotonic_s: Callable[[], float] = time.monotonic
    ) -> None:
        super().__init__("looks")
        self._limits, self._set_of, self._autopilot, self._monotonic_s = limits, set_of, autopilot, monotonic_s
        self.notified: list[Callable[[str], object]] = []
        self.newest = ""
        self._asked: deque[_Asked] = deque()
        self._offers: OrderedDict[str, _Offered] = OrderedDict()  # by their tickets
        self._looked_at: _Offered | None = None  # where the camera was sent last
        self._commanded_s = -BETWEEN_S

    def ask(self, who: str, parameters: str, done: Done) -> None:
        """Have a question answered in this thread; at once where too much is asked. `who` has shown that he is that."""
        with self._changed:
            if len(self._asked) < MAX_ASKED:
                self._asked.append(_Asked(who, parameters, done, self._monotonic_s()))
                self._changed.notify()
                return
        done(refused("busy", "too much is asked at once: ask again"), True)

    def _run(self, thread: SupervisedThread) -> None:
        while not thread.is_set():
            with self._changed:
                if not self._asked:
                    self._changed.wait(IDLE_S)
            thread.wait(min(REST * self.work(), MOST_REST_S))

    def work(self) -> float:
        """Answer one question, if one waits. Returns the processor's time, s."""
        began_s = time.thread_time()
        with self._changed:
            if not self._asked:
                return 0.0
            asked = self._asked.popleft()
        answer, is_error = refused("failed", "the aircraft could not answer"), True
        try:
            answer, is_error = self._answer(asked)
        except _Refused as refusal:
            answer = refusal.answer
        finally:
            asked.done(answer, is_error)
        return time.thread_time() - began_s

    def _answer(self, asked: _Asked) -> tuple[bytes, bool]:
        if self._monotonic_s() - asked.at_s > LATE_S:
            raise _Refused("busy", "others were asking: ask again")
        try:
            request = read_request(asked.parameters)
        except InputError as error:
            raise _Refused("bad_request", str(error)) from error
        if isinstance(request, AskLook):
            return self._offer(asked.who, request).to_json(), False
        if isinstance(request, AskCircle):
            return self._offer_circle(asked.who, request).to_json(), False
        if isinstance(request, EndLook):
            return self._command(asked.who, None)
        return self._confirm(asked.who, request)

    def _offer(self, who: str, asked: AskLook) -> Offer:
        found = self._set_of(asked.frame)
        feature_set = None if found is None else decode(found[0])
        if found is None or feature_set is None or feature_set.session != asked.session:
            raise _Refused("unknown_frame", "that picture's set is not kept: click on a newer one")
        age_s = found[1]
        if age_s is None or not age_s <= self._limits.max_age_s:
            age = "of unknown age" if age_s is None else f"{age_s:.0f} s old"
            raise _Refused("stale", f"that picture is {age}: click on one of the last {self._limits.max_age_s:.0f} s")
        answer = Locator(feature_set).locate((asked.u_px, asked.v_px))
        if not isinstance(answer, Fix):
            raise _Refused(answer.status.value, EXPLANATIONS[answer.status])
        if answer.height_amsl_m is None:
            raise _Refused("no_height", "the place's height above mean sea level is not known: set gps.undulation_m")
        radius_m = ce90_m(answer.covariance_enu_m2[:2, :2])
        if not radius_m <= self._limits.max_radius_m:
            limit = f"look.max_radius_m = {self._limits.max_radius_m:g}"
            raise _Refused("uncertain", f"the place is known to {radius_m:.0f} m (90 %) only, and {limit}")
        apart_m = distance_m((answer.lat_deg, answer.lon_deg), (asked.lat_deg, asked.lon_deg))
        if not apart_m <= radius_m + min(asked.radius_m, self._limits.max_radius_m):
            raise _Refused("contradiction", f"the aircraft's own answer lies {apart_m:.0f} m away: click again")
        offer = Offer(secrets.token_hex(8), answer.lat_deg, answer.lon_deg, answer.height_amsl_m, radius_m, age_s)
        return self._keep(_Offered(offer, who, self._monotonic_s(), math.sqrt(answer.covariance_enu_m2[2, 2])))

    def _offer_circle(self, who: str, request: AskCircle) -> Offer:
        """The offer to circle about the place that the camera was sent to look at last, as high as the aircraft is."""
        limits, now_s = self._limits, self._monotonic_s()
        if limits.circle_radius_m is None:
            raise _Refused("not_allowed", "no one may have this aircraft circle: its look.circle_radius_m is not set")
        looked_at = self._looking(who, request.ticket)
        place = looked_at.offer
        age_s = place.age_s + now_s - looked_at.at_s
        if age_s > limits.max_age_s:
            raise _Refused(
                "stale", f"that picture is {age_s:.0f} s old: click on one of the last {limits.max_age_s:.0f} s"
            )
        height_m = self._autopilot.height_amsl_m()
        if height_m is None:
            raise _Refused("no_height", "the autopilot does not send its height above mean sea level")
        above_m = height_m - place.height_amsl_m
        known_m = le90_m(looked_at.height_sigma_m)  # which one error of twenty exceeds upwards
        if not above_m - known_m >= limits.circle_clearance_m:
            limit = f"look.circle_clearance_m = {limits.circle_clearance_m:g}"
            raise _Refused(
                "too_low",
                f"the aircraft is {above_m:.0f} m above the place (+-{known_m:.0f} m), and {limit}: climb first",
            )
        circle = Circle(limits.circle_radius_m, height_m, above_m)
        offer = replace(place, ticket=secrets.token_hex(8), age_s=age_s, circle=circle)
        return self._keep(replace(looked_at, offer=offer, at_s=now_s, about=place.ticket, outcome=None))

    def _looking(self, who: str, ticket: str) -> _Offered:
        """Return the look that was commanded last. Raises _Refused if it was not this person's by this ticket."""
        looked_at = self._looked_at
        if looked_at is None or (looked_at.who, looked_at.offer.ticket) != (who, ticket):
            raise _Refused(
                "not_looking", "you have not sent the camera there, or it was sent elsewhere since: click again"
            )
        return looked_at

    def _keep(self, offered: _Offered) -> Offer:
        self._offers[offered.offer.ticket] = offered
        while len(self._offers) > MAX_OFFERS:
            self._offers.popitem(last=False)
        return offered.offer

    def _confirm(self, who: str, request: ConfirmLook) -> tuple[bytes, bool]:
        offered = self._offers.get(request.ticket)
        if offered is None or offered.who != who:
            raise _Refused("unknown_ticket", "there is no such offer any more: click again")
        if offered.outcome is not None:
            return offered.outcome
        since_s = self._monotonic_s() - offered.at_s
        if max(since_s, request.waited_s) > OFFER_S:
            raise _Refused("late", f"the offer is more than {OFFER_S:.0f} s old: click again")
        if since_s - request.waited_s > LATE_S:
            raise _Refused(
                "late", f"offer and confirmation were {since_s - request.waited_s:.0f} s on their way: click again"
            )
        if offered.about:
            self._looking(who, offered.about)  # still: offers are answered one after the other, by this thread alone
        offered.outcome = self._command(who, offered)
        return offered.outcome

    def _command(self, who: str, offered: _Offered | None) -> tuple[bytes, bool]:
        """Have the autopilot sent a command; what became of it is the answer, is logged and shown to everybody."""
        now_s = self._monotonic_s()
        if now_s - self._commanded_s < BETWEEN_S:
            raise _Refused("busy", f"the last command is less than {BETWEEN_S:g} s old: ask again")
        self._commanded_s = now_s
        offer = None if offered is None else offered.offer
        order = _order_of(offer)
        what = "has the aircraft" if isinstance(order, CircleAbout) else "has the camera look"
        word = self._autopilot.command(order)
        radius = "" if offer is None else f" (CE90 {offer.ce90_m:.1f} m)"
        log.info("look: %s %s %s%s: %s", who, what, order, radius, word)
        if word != NO_AUTOPILOT:
            if not isinstance(order, CircleAbout):
                self._looked_at = offered if word == ACCEPTED else None  # it may look there, or where it did
            self.newest = _with_outcome(f"{who}: {order}", word, MAX_LOOK)
            for notify in self.notified:
                notify(_with_outcome(f"{who} {what} {order}", "" if word == ACCEPTED else word, MAX_NOTICE))
        if word != ACCEPTED:
            return refused(word, UNSENT.get(word, f"the autopilot refuses: {word.replace('_', ' ')}")), True
        content: dict[str, object] = {"result": word, **vars(order)}
        if isinstance(order, LookAt):
            content["may_circle"] = self._limits.circle_radius_m is not None
        return json.dumps(content, separators=(",", ":")).encode(), False


def _order_of(offer: Offer | None) -> Order:
    """Return what an offer, once confirmed, has the autopilot do; without one, to look ahead."""
    if offer is None:
        return LookAhead()
    if offer.circle is None:
        return LookAt(offer.lat_deg, offer.lon_deg, offer.height_amsl_m)
    return CircleAbout(offer.lat_deg, offer.lon_deg, offer.circle.height_amsl_m, offer.circle.radius_m)


def _with_outcome(what: str, word: str, most: int) -> str:
    """Return what was sent and what came of it in so many characters: the outcome is whole, and a cut is seen."""
    end = f": {word}" if word else ""
    room = most - len(end)
    return (what if len(what) <= room else f"{what[: room - len(CUT)]}{CUT}") + end
