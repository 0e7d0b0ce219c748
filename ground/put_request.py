"""A request to an aircraft over the link: what it answers as JSON, or its reason not to do it."""

from __future__ import annotations

from typing import Any

from contract.errors import LinkError
from contract.topics import ANSWER_TIMEOUT_S
from ground.client import json_object, put_question


class RequestRefused(LinkError):
    """The aircraft does not do what was asked; the message is its reason, `word` the same for programs."""

    def __init__(self, word: str, reason: str) -> None:
        super().__init__(f"{word}: {reason}")
        self.word, self.reason = word, reason


def put_request(
    session: Any, selector: str, *, tries: int = 1, timeout_s: float = ANSWER_TIMEOUT_S
) -> dict[str, Any] | None:
    """The aircraft's answer; None if it gives none. Raises RequestRefused with its reason."""
    for _ in range(tries):
        for reply in put_question(session, selector, timeout_s):
            content = json_object((reply.ok or reply.err).payload)
            if reply.ok is not None:
                return content
            if "reason" in content:
                word, reason = (_plain(content.get(key, "refused")) for key in ("status", "reason"))
                raise RequestRefused(word, reason)
    return None


def _plain(value: object) -> str:
    """The words of another, for a line of ours."""
    return "".join(c for c in str(value)[:300] if c.isprintable())
