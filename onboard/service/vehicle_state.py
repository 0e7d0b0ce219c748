"""The state of the aircraft's side: a pure function of what its parts report. The only place where it is determined.

`judge` lists everything that is not well, in the order in which one thing causes the next; the state is the first of
the list, and `pc-onboard doctor` prints the whole of it, so that the two cannot disagree. docs/faults.md specifies
what each state means and what ends it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum

from contract.feature_set import Status
from contract.supervised_thread import ThreadReport
from contract.vehicle_status import fix_words
from onboard.events.source import Severity, SourceStatus, State

STUCK_S = 4.0  # one event never takes this long
SILENT_S = 3.0  # without a picture though the camera calls itself well
MIN_FIX_TYPE = 3  # GPS_FIX_TYPE
MAX_GPS_AGE_S = 3.0
MAX_GPS_SIGMA_M = 5.0


class VehicleState(Enum):
    """The state in a word. Values are what users see."""

    OK = "ok"
    AT_REST = "at rest"
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

    @property
    def is_well(self) -> bool:
        """True if all is as it should be: answers flow, or will as soon as the aircraft flies."""
        return self in (VehicleState.OK, VehicleState.AT_REST)


class Subject(Enum):
    """The subjects that are judged; each is a line of `doctor`."""

    PIPELINE = "pipeline"
    CAMERA = "camera"
    TELEMETRY = "telemetry"
    GPS = "gps"
    POSITION = "position"
    ANSWERS = "answers"
    LOAD = "load"
    RECORDING = "recording"
    THREADS = "threads"
    SENSORS = "sensors"
    THERMAL_CAMERA = "thermal camera"


@dataclass(frozen=True)
class GpsReport:
    """The receiver's report on itself, and how old that is."""

    fix_type: int  # MAVLink GPS_FIX_TYPE: 0-1 none, 2 two-dimensional, 3 and up usable
    age_s: float
    satellites: int | None = None
    sigma_horizontal_m: float | None = None
    sigma_vertical_m: float | None = None

    def __str__(self) -> str:
        seen = "" if self.satellites is None else f", {self.satellites} satellites"
        claim = "" if self.sigma_horizontal_m is None else f", +-{self.sigma_horizontal_m:.1f} m"
        old = f", {self.age_s:.0f} s old" if self.age_s >= MAX_GPS_AGE_S else ""
        return f"{fix_words(self.fix_type)}{seen}{claim}{old}"


@dataclass(frozen=True)
class Inputs:
    """The reports of the parts at present."""

    camera: SourceStatus
    telemetry: SourceStatus
    picture_age_s: float | None  # since the last picture came; None before the first
    busy_s: float  # how long the pipeline has been at one event; 0 when it waits
    outcome: Status | None  # of the newest pictures; None while there are none
    gps: GpsReport | None = None  # None before the receiver's first report
    position_fault: str = ""  # why the navigation does not accept the position; empty when it does
    is_at_rest: bool = False  # the autopilot or the positions show that the aircraft stands still
    is_shedding: bool = False  # pictures were dropped a moment ago
    recording_fault: str = ""  # why nothing is recorded; empty when all is well or none is wanted
    threads: tuple[ThreadReport, ...] = ()
    contradiction: str = ""  # which sensor contradicts the others at present; empty when none does
    thermal_camera: SourceStatus | None = None  # a second camera; None where there is none


@dataclass(frozen=True)
class Finding:
    """Something that is not well: what it is about, the state it makes, and the reason."""

    subject: Subject
    state: VehicleState
    reason: str


@dataclass(frozen=True)
class Overall:
    """The state of the whole and the reason for it."""

    state: VehicleState
    reason: str = ""

    def __str__(self) -> str:
        return f"{self.state.value}: {self.reason}" if self.reason else self.state.value


# Why pictures were refused, as a state of the aircraft and in plain words.
_REFUSALS: dict[Status, tuple[VehicleState, str]] = {
    Status.STARTING: (VehicleState.STARTING, "no position or too little seen yet"),
    Status.NO_GPS: (VehicleState.NO_GPS, "the position is not accepted"),
    Status.UNSYNCHRONISED: (VehicleState.UNSYNCHRONISED, "no telemetry about the moment of exposure"),
    Status.FEATURELESS: (VehicleState.FEATURELESS, "too little to follow in the pictures"),
    Status.BAD_PICTURE: (VehicleState.BAD_PICTURE, "pictures cannot be used"),
    Status.TURNING: (VehicleState.TURNING, "turning too fast to follow features"),
    Status.LOW_PARALLAX: (VehicleState.LOW_PARALLAX, "standing still: no depth without motion"),
    Status.POOR_FIT: (VehicleState.POOR_FIT, "pictures and telemetry contradict each other"),
    Status.REPETITIVE: (VehicleState.FEATURELESS, "the ground repeats itself (rows)"),
    Status.STABILISED: (VehicleState.POOR_FIT, "electronic stabilisation shifts the pictures"),
    Status.ZOOMED: (VehicleState.POOR_FIT, "the lens has zoomed or refocused"),
    Status.MIRRORED: (VehicleState.POOR_FIT, "the pictures are mirror images: switch off the camera's flip"),
    Status.STRETCHED: (VehicleState.POOR_FIT, "the pictures are stretched along one side against the camera file"),
    Status.UNCERTAIN: (VehicleState.POOR_FIT, "too uncertain to answer"),
}
# The result of pictures on the ground, where the camera may look at grass from 10 cm: no fault before flight.
_OF_REST = (Status.STARTING, Status.LOW_PARALLAX, Status.FEATURELESS, Status.REPETITIVE)
# The state while the position is not accepted, by the result of the newest pictures; else there is no GPS.
_OF_POSITION: dict[Status | None, VehicleState] = {
    Status.OK: VehicleState.DEGRADED,
    Status.STARTING: VehicleState.STARTING,
    None: VehicleState.STARTING,
}
AT_REST = "standing still; answers begin in flight"


def judge(inputs: Inputs) -> tuple[Finding, ...]:
    """Everything that is not well, causes before their consequences, what only spoils the answers last."""
    found = [*_stopped(inputs), *_position(inputs), *_answers(inputs), *_other_faults(inputs)]
    # Degradations come last: what takes the answers away is named first.
    return tuple(sorted(found, key=lambda finding: finding.state is VehicleState.DEGRADED))


def overall(inputs: Inputs) -> Overall:
    """The state of the whole: that of the first finding; without any, "ok" or "at rest"."""
    found = judge(inputs)
    if found:
        return Overall(found[0].state, found[0].reason)
    return Overall(VehicleState.OK) if inputs.outcome is Status.OK else Overall(VehicleState.AT_REST, AT_REST)


def source_findings(camera: SourceStatus, telemetry: SourceStatus) -> tuple[Finding, ...]:
    """Return the findings that the two sources report about themselves."""
    found = []
    if camera.state is State.LOST:
        found.append(Finding(Subject.CAMERA, VehicleState.CAMERA_LOST, camera.detail))
    if camera.state is State.FROZEN:
        found.append(Finding(Subject.CAMERA, VehicleState.CAMERA_FROZEN, camera.detail))
    if telemetry.state in (State.LOST, State.FROZEN):
        found.append(Finding(Subject.TELEMETRY, VehicleState.TELEMETRY_LOST, telemetry.detail))
    for subject, source in ((Subject.CAMERA, camera), (Subject.TELEMETRY, telemetry)):
        name, detail = subject.value, source.detail
        if source.state is State.STARTING:
            reason = f"{name}: {detail}" if detail else f"waiting for the {name}"
            found.append(Finding(subject, VehicleState.STARTING, reason))
        if source.state is State.DEGRADED:
            found.append(Finding(subject, VehicleState.DEGRADED, f"{name}: {detail}"))
    return tuple(found)


def second_findings(thermal_camera: SourceStatus | None) -> tuple[Finding, ...]:
    """Return the findings on a second camera: without it there are no hot spots, and everything else is as before."""
    if thermal_camera is None or thermal_camera.state is State.OK:
        return ()
    reason = f"thermal camera: {thermal_camera.state.value}, so no hot spots"
    reason += f" ({thermal_camera.detail})" if thermal_camera.detail else ""
    return (Finding(Subject.THERMAL_CAMERA, VehicleState.DEGRADED, reason),)


def second_in_brief(thermal_camera: SourceStatus | None) -> str:
    """Return the state of a second camera that is not well, and why, without the device's name; else an empty text."""
    if thermal_camera is None or thermal_camera.state is State.OK:
        return ""
    device, _, rest = thermal_camera.detail.partition(": ")
    why = rest if rest and " " not in device else thermal_camera.detail
    return f"{thermal_camera.state.value}: {why}" if why else str(thermal_camera.state.value)


def gps_findings(gps: GpsReport | None) -> tuple[Finding, ...]:
    """Return the findings on the receiver's own report, as the state holds them when nothing worse is wrong."""
    if gps is None:
        return (Finding(Subject.GPS, VehicleState.DEGRADED, "gps: the receiver has sent nothing"),)
    if gps.fix_type < MIN_FIX_TYPE:
        return (Finding(Subject.GPS, VehicleState.NO_GPS, f"no position ({gps})"),)
    if gps.age_s >= MAX_GPS_AGE_S:
        return (Finding(Subject.GPS, VehicleState.NO_GPS, f"the receiver has been silent for {gps.age_s:.0f} s"),)
    if gps.sigma_horizontal_m is not None and gps.sigma_horizontal_m > MAX_GPS_SIGMA_M:
        return (Finding(Subject.GPS, VehicleState.DEGRADED, f"gps: {gps}"),)
    return ()


def _stopped(inputs: Inputs) -> Iterator[Finding]:
    """Yield what keeps pictures or telemetry from coming at all."""
    if inputs.busy_s > STUCK_S:
        reason = f"the pipeline has been at one event for {inputs.busy_s:.0f} s"
        yield Finding(Subject.PIPELINE, VehicleState.STUCK, reason)
    yield from source_findings(inputs.camera, inputs.telemetry)
    has_explained = inputs.camera.state in (State.LOST, State.FROZEN, State.STARTING)
    if inputs.picture_age_s is not None and inputs.picture_age_s > SILENT_S and not has_explained:
        reason = f"no picture for {inputs.picture_age_s:.0f} s"
        yield Finding(Subject.CAMERA, VehicleState.CAMERA_SILENT, reason)


def _position(inputs: Inputs) -> Iterator[Finding]:
    """Yield the findings of receiver and navigation on the position."""
    yield from gps_findings(inputs.gps)
    if inputs.position_fault:
        # Answers that flow all the same carry the doubt in their radius; before the first one may still be waited for.
        state = _OF_POSITION.get(inputs.outcome, VehicleState.NO_GPS)
        yield Finding(Subject.POSITION, state, f"position: {inputs.position_fault}")
    if inputs.outcome in (Status.NO_GPS, Status.UNSYNCHRONISED) and not inputs.position_fault:
        yield Finding(Subject.POSITION, *_REFUSALS[inputs.outcome])


def _answers(inputs: Inputs) -> Iterator[Finding]:
    """Yield the finding on the newest pictures' outcome, if it is a refusal or there is none yet."""
    outcome = inputs.outcome
    if outcome is None:
        yield Finding(Subject.ANSWERS, VehicleState.STARTING, "no picture has come through yet")
    elif outcome is not Status.OK and not (inputs.is_at_rest and outcome in _OF_REST):
        yield Finding(Subject.ANSWERS, *_REFUSALS.get(outcome, (VehicleState.DEGRADED, outcome.value)))


def _other_faults(inputs: Inputs) -> Iterator[Finding]:
    """Yield what is amiss while answers flow."""
    if inputs.is_shedding:
        yield Finding(Subject.LOAD, VehicleState.OVERLOADED, "pictures are dropped to keep up")
    if inputs.recording_fault:
        yield Finding(Subject.RECORDING, VehicleState.NOT_RECORDING, inputs.recording_fault)
    for thread in inputs.threads:
        if not thread.is_well:
            why = f" ({thread.last_error})" if thread.last_error else ""
            yield Finding(Subject.THREADS, VehicleState.DEGRADED, f"{thread.name}: {thread.state.value}{why}")
    if inputs.contradiction:
        yield Finding(Subject.SENSORS, VehicleState.DEGRADED, f"sensors: {inputs.contradiction}")
    yield from second_findings(inputs.thermal_camera)


def severity(state: VehicleState) -> Severity:
    """Return how much people should care."""
    if state.is_well or state in (VehicleState.STARTING, VehicleState.TURNING, VehicleState.LOW_PARALLAX):
        return Severity.NOTICE
    return Severity.ERROR if state in (VehicleState.STUCK, VehicleState.CAMERA_SILENT) else Severity.WARNING


def is_alive(inputs: Inputs) -> bool:
    """Return whether the watchdog may be fed: the pipeline moves, and pictures flow or the camera reports why not."""
    if inputs.busy_s > STUCK_S:
        return False
    if inputs.camera.state in (State.LOST, State.FROZEN, State.STARTING):
        return True
    return inputs.picture_age_s is None or inputs.picture_age_s <= SILENT_S
