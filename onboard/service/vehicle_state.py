"""How the aircraft's side is, in one word with a reason: a pure function of what its parts say.

The word is the first thing that keeps answers from being given, in the order in which one causes the next; only when
answers flow, what is amiss besides. docs/faults.md says what each word means and what ends it.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from contract.feature_set import Status
from onboard.events.source import Severity, SourceStatus, State

STUCK_S = 4.0  # one event never takes this long
SILENT_S = 3.0  # without a picture though the camera calls itself well


class Word(Enum):
    """The state in a word. Values are what users see."""

    OK = "ok"
    DEGRADED = "degraded"
    STARTING = "starting"
    STUCK = "stuck"
    CAMERA_LOST = "camera lost"
    CAMERA_FROZEN = "camera frozen"
    CAMERA_SILENT = "camera silent"
    TELEMETRY_LOST = "telemetry lost"
    NO_GPS = "no gps"
    UNSYNCHRONISED = "unsynchronised"
    FEATURELESS = "featureless"
    BAD_PICTURE = "bad picture"
    TURNING = "turning"
    LOW_PARALLAX = "low parallax"
    POOR_FIT = "poor fit"
    OVERLOADED = "overloaded"
    NOT_RECORDING = "not recording"


@dataclass(frozen=True)
class Inputs:
    """What the parts say just now."""

    camera: SourceStatus
    telemetry: SourceStatus
    picture_age_s: float | None  # since the last picture came; None before the first
    busy_s: float  # how long the pipeline has been at one event; 0 when it waits
    outcome: Status | None  # of the newest pictures; None while there are none
    is_shedding: bool = False  # pictures were dropped a moment ago
    recording_fault: str = ""  # why nothing is recorded; empty when all is well or none is wanted


@dataclass(frozen=True)
class Overall:
    """The word and the reason for it."""

    word: Word
    reason: str = ""

    def __str__(self) -> str:
        return f"{self.word.value}: {self.reason}" if self.reason else self.word.value


# Why pictures were refused, as a word about the aircraft and in plain words.
_REFUSALS: dict[Status, tuple[Word, str]] = {
    Status.STARTING: (Word.STARTING, "no position or too little seen yet"),
    Status.NO_GPS: (Word.NO_GPS, "the position is not believed"),
    Status.UNSYNCHRONISED: (Word.UNSYNCHRONISED, "no telemetry about the moment of exposure"),
    Status.FEATURELESS: (Word.FEATURELESS, "too little to follow in the pictures"),
    Status.BAD_PICTURE: (Word.BAD_PICTURE, "pictures cannot be used"),
    Status.TURNING: (Word.TURNING, "turning too fast to follow features"),
    Status.LOW_PARALLAX: (Word.LOW_PARALLAX, "standing still: no depth without motion"),
    Status.POOR_FIT: (Word.POOR_FIT, "pictures and telemetry contradict each other"),
    Status.UNCERTAIN: (Word.POOR_FIT, "too uncertain to answer"),
}


def overall(inputs: Inputs) -> Overall:
    """The state of the whole."""
    camera, telemetry = inputs.camera, inputs.telemetry
    if inputs.busy_s > STUCK_S:
        return Overall(Word.STUCK, f"the pipeline has been at one event for {inputs.busy_s:.0f} s")
    if camera.state is State.LOST:
        return Overall(Word.CAMERA_LOST, camera.detail)
    if camera.state is State.FROZEN:
        return Overall(Word.CAMERA_FROZEN, camera.detail)
    if telemetry.state in (State.LOST, State.FROZEN):
        return Overall(Word.TELEMETRY_LOST, telemetry.detail)
    for name, health in (("camera", camera), ("telemetry", telemetry)):
        if health.state is State.STARTING:
            return Overall(Word.STARTING, f"{name}: {health.detail}" if health.detail else f"waiting for the {name}")
    if inputs.picture_age_s is not None and inputs.picture_age_s > SILENT_S:
        return Overall(Word.CAMERA_SILENT, f"no picture for {inputs.picture_age_s:.0f} s")
    if inputs.outcome is None:
        return Overall(Word.STARTING, "no picture has come through yet")
    if inputs.outcome is not Status.OK:
        return Overall(*_REFUSALS.get(inputs.outcome, (Word.DEGRADED, inputs.outcome.value)))
    if inputs.is_shedding:
        return Overall(Word.OVERLOADED, "pictures are dropped to keep up")
    if inputs.recording_fault:
        return Overall(Word.NOT_RECORDING, inputs.recording_fault)
    for name, health in (("camera", camera), ("telemetry", telemetry)):
        if health.state is State.DEGRADED:
            return Overall(Word.DEGRADED, f"{name}: {health.detail}")
    return Overall(Word.OK)


def severity(word: Word) -> Severity:
    """How much people should care."""
    if word in (Word.OK, Word.STARTING, Word.TURNING, Word.LOW_PARALLAX):
        return Severity.NOTICE
    return Severity.ERROR if word in (Word.STUCK, Word.CAMERA_SILENT) else Severity.WARNING


def is_alive(inputs: Inputs) -> bool:
    """Whether the watchdog may be fed: the pipeline moves, and pictures flow or the camera says why they do not."""
    if inputs.busy_s > STUCK_S:
        return False
    if inputs.camera.state in (State.LOST, State.FROZEN, State.STARTING):
        return True
    return inputs.picture_age_s is None or inputs.picture_age_s <= SILENT_S
