"""A question over a link of a machine that may be busy: what is lost or comes too late is asked again.

Where it is the claim that no one answers, ask once, with `ground.client.ask` itself, or `nobody_answers`.
"""

from collections.abc import Callable
from typing import Any, TypeVar

from contract.answer import Refusal
from contract.errors import LinkError
from contract.feature_set import FeatureSet
from ground.client import ask
from tests.waiting import eventually

T = TypeVar("T")


def answered(question: Callable[[], T]) -> T:
    """What a question gives, asked until there is an answer. Raises the last time's LinkError where there is none."""
    answers: list[T] = []
    failed: list[LinkError] = []

    def is_answered() -> bool:
        try:
            answers.append(question())
        except LinkError as error:
            failed.append(error)
        return bool(answers)

    if not eventually(is_answered):
        raise failed[-1]
    return answers[0]


def asked(endpoint: str, *vehicle: str, **about: Any) -> dict[str, FeatureSet | Refusal]:
    """As `ground.client.ask`, until there is an answer."""
    return answered(lambda: ask(endpoint, *vehicle, **about))


def nobody_answers(endpoint: str, *vehicle: str, **about: Any) -> bool:
    """Whether the link opens and no aircraft answers over it. A link that was too slow to open is opened again."""

    def is_unanswered() -> bool:
        try:
            found = ask(endpoint, *vehicle, **about)
        except LinkError as error:
            return "no aircraft answers" in str(error)
        raise AssertionError(found)

    return eventually(is_unanswered)
