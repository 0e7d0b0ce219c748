"""The protocol of what answers clicks and looks for a MAVLink camera component. Called in the telemetry's thread."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from contract.answer import Answer
from contract.feature_set import FeatureSet
from contract.track import TrackReport


@dataclass(frozen=True)
class VideoClick:
    """A click on the video: `share` from its left and its top edge, 0 to 1. It arrived at `arrival_ns` (Unix ns of the
    session's clock), and some time after the picture was taken that was shown then.
    """

    number: int
    share: tuple[float, float]
    arrival_ns: int


@dataclass(frozen=True)
class ViewQuestion:
    """A question for the newest picture's pose and its middle."""

    number: int


@dataclass(frozen=True, eq=False)
class Clicked:
    """The answer to a click; whether the thing there is followed from now on, and if not, why not."""

    number: int
    answer: Answer
    is_followed: bool = False
    unfollowed: str = ""


@dataclass(frozen=True, eq=False)
class View:
    """The newest set, None without one that has a pose, the answer in the picture's middle, and the picture's age."""

    number: int
    feature_set: FeatureSet | None
    middle: Answer | None
    age_s: float = 0.0


Asked = VideoClick | ViewQuestion
Answered = Clicked | View


class CameraEnd(Protocol):
    """Our end of the camera component: nothing here waits."""

    def ask(self, asked: Asked) -> bool:
        """Take a question; False where too many wait already."""

    def answers(self) -> list[Answered]:
        """The answers since the last call."""

    def stop(self) -> None:
        """Follow what was clicked no longer."""

    @property
    def is_following(self) -> bool:
        """Return whether what was clicked last is followed."""

    def followed(self) -> TrackReport | None:
        """The newest report of the thing that is followed, as of now, its ellipse as wide as the click's moment makes
        it; None without one.
        """


class Share(Protocol):
    """The share of a bit rate that is left, in bytes: `onboard.link.byte_budget.Bucket` serves it."""

    def wait_s(self, cost: float, now_s: float) -> float:
        """Return how long so many bytes have to wait."""

    def take(self, cost: float, now_s: float) -> None:
        """Take them."""
