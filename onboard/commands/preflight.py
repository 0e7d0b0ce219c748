"""Before take-off: one line for each thing that a good flight needs, from a report of the daemon's.

Two kinds of lines. Those of `vehicle_state.Subject` only show what the daemon itself has judged, so that the state and
the doctor agree. The others compare what is seen with limits for take-off (rates, exposure, time sync, mount, disk),
that are stricter than what a flight needs to continue. The same lines whether a running daemon was asked or
`doctor` looked itself, which then knows only camera, telemetry and receiver. What is unknown
is never good: what cannot be determined is reported as unknown, and counts as bad where a flight depends on it. Of one
fault there is one bad line: what only the missing source could show waits for it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from contract.camera import Camera
from contract.wire.radio_state import LOWER_STREAMS
from onboard.config.schema import Config
from onboard.events.source import SourceStatus, State
from onboard.events.tunnel import RadioReport
from onboard.pipeline.estimates import BORESIGHT, RELATIVE_VARIANCE, TIME_OFFSET, larger_than_declared, not_adopted
from onboard.service.reports import Report
from onboard.service.vehicle_state import Subject, VehicleState

RATE_SHARE = 0.8  # of the rate asked for
MIN_ATTITUDE_HZ = 10.0
MIN_POSITION_HZ = 2.0
MAX_CLOCK_SIGMA_MS = 20.0  # 20 m/s over 20 ms are 0.4 m
MAX_STAMP_SIGMA_MS = 100.0  # by arrivals it is how late they usually are, which describes the link rather than a stamp
MAX_ROUND_TRIP_MS = 100.0
MAX_VARIANCE_FACTOR = 4.0  # ellipses are then twice as long as sensors and pictures explain
BORESIGHT_SIGMAS = 3.0
MAX_CLIPPED = 0.3
MAX_LEFT_OUT = 0.4  # of the picture
DARK, BRIGHT = 25.0, 230.0
HOT_C = 80.0
LEAST_FREE_PERCENT = 20  # of a radio's buffer: below it ArduPilot slows its own streams down
MAX_UNHEARD = 0.5  # of the questions answered


@dataclass(frozen=True)
class Line:
    """A line of the report: the thing checked, whether it is well, and what was seen.

    `waits_for`: the line that has to be well before this one can be judged; empty if this one was.
    """

    name: str
    is_good: bool
    text: str
    waits_for: str = ""


@dataclass(frozen=True)
class Surroundings:
    """The facts that are known without the report."""

    camera: Camera | str  # the camera file, or what is wrong with it
    link: str  # what is wrong with the link; empty if nothing
    free_mb: float | None
    temperature_c: float | None
    is_running: bool = True  # the report is a daemon's, which has judged its flight
    decoders: str = ""  # what decodes the camera's stream; empty where it is none


# The first can be judged without a daemon; the second have lines of their own.
SEEN_ALONE = (Subject.CAMERA, Subject.TELEMETRY, Subject.GPS)
OWN_LINES = (Subject.SENSORS, Subject.THERMAL_CAMERA)
# What nothing can be known of while its source gives nothing: one fault is one bad line.
SHOWN_BY = {"rate": "camera", "exposure": "camera", "rates": "telemetry", "time sync": "telemetry", "gps": "telemetry"}
GIVES_NOTHING = (State.STARTING, State.LOST)


def diagnose(config: Config, report: Report, around: Surroundings) -> list[Line]:
    """All lines, in the order in which one would look."""
    seen = [s for s in Subject if s not in OWN_LINES and (around.is_running or s in SEEN_ALONE)]
    judged = {s: _judged(report, s) for s in seen}
    second = [] if report.thermal_camera is None else [_judged(report, Subject.THERMAL_CAMERA)]
    lines = [
        judged.pop(Subject.CAMERA),
        _rate(config, report),
        _stamps(config, report),
        _exposure(config, report),
        *([Line("decoder", True, around.decoders)] if around.decoders else []),
        *second,
        *([_thermal(config)] if config.thermal.enabled or second or config.spots.things else []),
        judged.pop(Subject.TELEMETRY),
        _rates(report),
        _time_sync(config, report),
        *judged.values(),
        *([_left_out(report), _sensors(report), _radius(report)] if around.is_running else []),
        _mount(config, report),
        _relative_errors(report),
        _calibration(around.camera),
        Line("link", not around.link, around.link or f"open, {', '.join((*config.link.listen, *config.link.connect))}"),
        *([_radio(config, report.radio)] if config.link.mavlink else []),
        _disk(config, around.free_mb),
        _processor(around.temperature_c),
    ]
    lines = [_as_shown(line, report) for line in lines]
    return [_state_line(report), *lines] if around.is_running else lines


def _as_shown(line: Line, report: Report) -> Line:
    """Return a line, or that it cannot be judged yet: its source gives nothing, which is a bad line of its own."""
    source = SHOWN_BY.get(line.name, "")
    states = {"camera": report.camera.state, "telemetry": report.telemetry.state}
    if line.is_good or states.get(source) not in GIVES_NOTHING:
        return line
    return replace(line, text=f"not known without {source}", waits_for=source)


def _thermal(config: Config) -> Line:
    """Return whether counts are temperatures (a camera that has none may fly), and the net has what it looks at."""
    if config.spots.things and not (
        config.spots.enabled and (config.thermal.enabled or config.camera.thermal.is_stated)
    ):
        lacking = "no thermal camera is configured" if config.spots.enabled else "spots.enabled = false"
        return Line("thermal", False, f"spots.things = true, and {lacking}: nothing is looked for")
    key = "thermal.scale" if config.thermal.enabled else "camera.thermal.scale"
    unknown = f"; hot spots have no temperatures ({key})" if config.heat.calibration is None else ""
    return Line("thermal", True, config.heat.words.removeprefix("thermal, ") + unknown)


def _sensors(report: Report) -> Line:
    judged, doubted = _judged(report, Subject.SENSORS), not_adopted(report.unconfirmed)
    words = "; ".join(text for text in (judged.text, larger_than_declared(report.sensor_errors)) if text)
    words = words or "no error found larger than configured"
    if doubted:
        words += f"; found but not confirmed, and not used: {doubted}"
    return replace(judged, text=words)


def _state_line(report: Report) -> Line:
    """Return the state as `pc-onboard status` has it; the lines below report the same, one by one."""
    status = report.status
    is_well = status.state in {state.value for state in VehicleState if state.is_well}
    return Line("state", is_well, f"{status.state}: {status.reason}" if status.reason else status.state)


def _judged(report: Report, subject: Subject) -> Line:
    """Return what the daemon has found amiss with one thing; if nothing, how it is."""
    found = [finding for finding in report.findings if finding.subject is subject]
    if found:
        words = dict.fromkeys(finding.reason.removeprefix(f"{subject.value}: ") for finding in found)
        return Line(subject.value, False, "; ".join(words))
    return Line(subject.value, True, _WELL[subject](report))


def _answers(report: Report) -> str:
    status, pictures = report.status, report.pictures
    if status.state == VehicleState.AT_REST.value:
        return f"at rest: {status.reason}"
    return f"{status.ok_hz:.1f} pictures a second can be clicked, {pictures.solved} of {pictures.handled} so far"


# The words on a thing when nothing is amiss with it.
_WELL: dict[Subject, Callable[[Report], str]] = {
    Subject.PIPELINE: lambda report: f"moves, {report.status.delay_s:.2f} s from capture to set",
    Subject.CAMERA: lambda report: _source(report.camera),
    Subject.TELEMETRY: lambda report: _source(report.telemetry),
    Subject.GPS: lambda report: str(report.gps),
    Subject.POSITION: lambda report: "plausible",
    Subject.ANSWERS: _answers,
    Subject.LOAD: lambda report: f"keeps up, {report.status.dropped} pictures dropped so far",
    Subject.RECORDING: lambda report: "on" if report.recording.is_on else "off, as configured",
    Subject.SENSORS: lambda report: "",
    Subject.THERMAL_CAMERA: lambda report: "" if report.thermal_camera is None else _source(report.thermal_camera),
    Subject.THREADS: lambda report: ", ".join(thread.name for thread in report.threads) or "none but its own",
}


def _rate(config: Config, report: Report) -> Line:
    rate_hz, asked_hz = report.camera.figures.get("rate_hz", 0.0), config.camera.rate_hz
    lost = report.camera.figures.get("lost", 0.0)
    text = f"{rate_hz:.1f} of {asked_hz:g} pictures a second" + (f", {lost:.0f} lost" if lost else "")
    return Line("rate", rate_hz >= RATE_SHARE * asked_hz, text)


def _stamps(config: Config, report: Report) -> Line:
    """Return how well pictures are timed: each against the others, and all against the autopilot."""
    sigma_ms, camera = report.camera.figures.get("stamp_sigma_ms"), config.camera
    each = "" if sigma_ms is None else f"each picture's time +-{sigma_ms:.1f} ms; "
    learned = report.estimate(TIME_OFFSET)
    if learned is None:
        prior = f"{camera.latency_s:.3f} +-{camera.sigma_latency_s:.3f} s late by camera.latency_s"
        common = f"{prior}, nothing learned yet: turns show it"
    else:
        common = (
            f"learned in flight: {learned.values[0]:+.3f} +-{learned.sigmas[0]:.3f} s in addition to camera.latency_s"
        )
    return Line("stamps", sigma_ms is None or sigma_ms <= MAX_STAMP_SIGMA_MS, each + common)


def _exposure(config: Config, report: Report) -> Line:
    how = "automatic" if config.camera.exposure_us is None else f"fixed at {config.camera.exposure_us:g} us"
    picture = report.brightness
    if picture is None:
        return Line("exposure", False, f"{how}; no picture to judge it by")
    for share, what in ((picture.black, "black"), (picture.white, "white")):
        if share > MAX_CLIPPED:
            return Line("exposure", False, f"{how}; {100 * share:.0f} % of the picture is {what}")
    mean = picture.mean
    good = DARK < mean < BRIGHT
    return Line(
        "exposure",
        good,
        f"{how}, mean grey {mean:.0f} of 255" + ("" if good else ": too dark" if mean <= DARK else ": too bright"),
    )


def _rates(report: Report) -> Line:
    figures = report.telemetry.figures
    attitude, position = figures.get("attitude_hz"), figures.get("position_hz")
    reported = [
        f"{name} {rate:.0f} Hz" for name, rate in (("attitude", attitude), ("position", position)) if rate is not None
    ]
    if position is None:
        return Line("rates", False, "no position rate is known")
    good = position >= MIN_POSITION_HZ and (attitude is None or attitude >= MIN_ATTITUDE_HZ)
    return Line("rates", good, ", ".join(reported))


def _time_sync(config: Config, report: Report) -> Line:
    figures = report.telemetry.figures
    sigma_ms, trip_ms = figures.get("clock_sigma_ms"), figures.get("round_trip_ms")
    if config.telemetry.url.startswith(("tlog:", "nmea:")):
        return Line("time sync", True, "by arrival: this kind of telemetry answers no TIMESYNC")
    by_arrival_ms = figures.get("arrival_sigma_ms")
    if sigma_ms is None and by_arrival_ms is not None and math.isfinite(by_arrival_ms):
        why = f"TIMESYNC is not answered: by arrival, +-{by_arrival_ms:.1f} ms and whatever the line delays"
        return Line("time sync", False, why)
    if sigma_ms is None or not math.isfinite(sigma_ms):
        return Line("time sync", False, "the autopilot's clock is not known yet")
    text = f"+-{sigma_ms:.1f} ms" + ("" if trip_ms is None else f", round trip {trip_ms:.1f} ms")
    good = sigma_ms <= MAX_CLOCK_SIGMA_MS and (trip_ms is None or trip_ms <= MAX_ROUND_TRIP_MS)
    return Line("time sync", good, text)


def _left_out(report: Report) -> Line:
    """Return what of the picture is taken for no ground."""
    left_out = report.pictures.left_out
    return Line("left out", left_out.masked + left_out.standing <= MAX_LEFT_OUT, str(left_out) or "nothing")


def _mount(config: Config, report: Report) -> Line:
    mount = config.mount
    how = f"roll {mount.roll_deg:g}, pitch {mount.pitch_deg:g}, yaw {mount.yaw_deg:g} deg"
    learned = report.estimate(BORESIGHT)
    if learned is None:
        return Line("mount", True, f"{how} +-{mount.sigma_deg:g}; nothing learned yet")
    off_deg = math.degrees(math.hypot(*learned.values))
    sigma_deg = math.degrees(max(learned.sigmas))
    good = off_deg <= BORESIGHT_SIGMAS * math.hypot(mount.sigma_deg, sigma_deg)
    return Line("mount", good, f"{how}; learned in flight: {off_deg:.1f} +-{sigma_deg:.1f} deg in addition")


def _relative_errors(report: Report) -> Line:
    factor = report.estimate(RELATIVE_VARIANCE)
    if factor is None:
        return Line("relative errors", True, "no ground has been seen again yet")
    value = factor.values[0]
    how = f"variance {value:.2f} +-{factor.sigmas[0]:.2f} of what was stated, by points seen again"
    return Line("relative errors", value < MAX_VARIANCE_FACTOR, how)


def _radius(report: Report) -> Line:
    """No radius is bad: `solve` refuses those that are too long. The line is what would make it smaller."""
    budget = report.budget
    if budget is None:
        return Line("radius", True, "no picture has been placed in the last half minute")
    return Line("radius", True, f"90 % within {budget.semi_major_m:.1f} m in the picture's middle; {budget.advice}")


def _calibration(camera: Camera | str) -> Line:
    if isinstance(camera, str):
        return Line("calibration", False, camera)
    width, height = camera.size_px
    return Line("calibration", True, f"{width} x {height}, {camera.hfov_deg:.0f} deg wide")


def _radio(config: Config, radio: RadioReport | None) -> Line:
    """Return whether what goes through the autopilot's radio arrives; unknown until a ground has listened or asked."""
    most = f"link.mavlink_bit_rate {config.link.mavlink_bit_rate:g} bit/s"
    if radio is None:
        return Line("radio", True, f"for clicks and sets, {most}; whether it carries that shows in flight")
    found = []
    if radio.free_percent is not None and radio.free_percent < LEAST_FREE_PERCENT:
        found.append(f"its buffer is full ({radio.free_percent} % free, by RADIO_STATUS): {LOWER_STREAMS}")
    if radio.finding:
        found.append(radio.finding)
    if radio.unheard > MAX_UNHEARD * radio.answered:
        found.append(f"{radio.unheard} of {radio.answered} answers did not arrive: {LOWER_STREAMS}")
    if found:
        return Line("radio", False, "; ".join(dict.fromkeys(found)))
    free = "" if radio.free_percent is None else f", {radio.free_percent} % of its buffer free"
    answers = f"{radio.answered} clicks answered, {radio.unheard} answers lost{free}"
    if radio.bit_rate is None or radio.set_s is None:
        return Line("radio", True, f"{answers}; no ground listens, so what it carries of {most} is not known")
    return Line("radio", True, f"{radio.bit_rate:.0f} of {most}, a set every {radio.set_s:.1f} s; {answers}")


def _disk(config: Config, free_mb: float | None) -> Line:
    if not config.recording.enabled:
        return Line("disk", True, "recording is off")
    if free_mb is None:
        return Line("disk", False, "free space unknown")
    return Line(
        "disk",
        free_mb > config.recording.keep_free_mb,
        f"{free_mb / 1000.0:.1f} GB free, {config.recording.keep_free_mb / 1000.0:.1f} kept free",
    )


def _processor(temperature_c: float | None) -> Line:
    if temperature_c is None:
        return Line("processor", True, "reports no temperature")
    return Line("processor", temperature_c < HOT_C, f"{temperature_c:.0f} deg C")


def _source(source: SourceStatus) -> str:
    return f"{source.state.value}: {source.detail}" if source.detail else source.state.value
