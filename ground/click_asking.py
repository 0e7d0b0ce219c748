"""A click on its way: asked until it is answered, over a link that loses and delays. Pure logic, time is passed in."""

from __future__ import annotations

from dataclasses import replace

from contract.answer import Answer
from contract.errors import WireError
from contract.wire.click_code import ClickAnswer, ClickQuestion, decode, encode_question

# A question and its answer take 2.4 s of 400 bit/s: a lost one is asked again after that. And once sooner: on a faster
# radio it is lost by then, and on a thin one the way up is free.
SOON_S, ASK_AGAIN_S = 1.0, 2.9
GIVE_UP_S = 20.0


class Asking:
    """One question. Sent again it states how long ago the click was made, and means the picture of then."""

    def __init__(self, question: ClickQuestion, now_s: float) -> None:
        self.question = question
        self._began_s = self._due_s = now_s

    def is_due(self, now_s: float) -> bool:
        """Return whether to send it now, at first or again, and count it as sent if so."""
        if now_s < self._due_s:
            return False
        waited_s = now_s - self._began_s
        if waited_s < SOON_S:
            self._due_s = self._began_s + SOON_S
        else:
            self._due_s = self._began_s + ASK_AGAIN_S * (waited_s // ASK_AGAIN_S + 1.0)
        return True

    def packet(self, now_s: float) -> bytes:
        return encode_question(replace(self.question, waited_s=now_s - self._began_s))

    def is_over(self, now_s: float) -> bool:
        return now_s - self._began_s >= GIVE_UP_S

    def take(self, payload: bytes) -> Answer | None:
        """The answer in a packet to this question; None if it is about another, or cannot be read."""
        try:
            found = decode(payload)
        except WireError:
            return None
        return found.answer if isinstance(found, ClickAnswer) and found.number == self.question.number else None
