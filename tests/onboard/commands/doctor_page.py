"""The cases of the transcript of the doctor's lines, tests/transcripts/pc-onboard-doctor.txt."""

from dataclasses import dataclass, replace

from contract.camera import Camera
from contract.feature_set import Status
from contract.supervised_thread import ThreadReport, ThreadState
from contract.wire.radio_state import Held, RadioState
from onboard.commands.doctor import text
from onboard.commands.preflight import Surroundings, diagnose
from onboard.config.schema import Config, ThermalConfig
from onboard.config.second_camera import SecondCamera
from onboard.events.source import SourceStatus, State
from onboard.events.tunnel import RadioReport
from onboard.georeferencing.budget import Budget
from onboard.pipeline.estimates import (
    BORESIGHT,
    RELATIVE_VARIANCE,
    TIME_OFFSET,
    in_words,
)
from onboard.pipeline.summary import Contradiction, Estimate, LeftOut, SensorError
from onboard.service.reports import Report
from onboard.service.vehicle_state import source_findings
from tests.onboard.service.reported import WELL as WELL_INPUTS
from tests.onboard.service.reported import report_of

CONFIG = Config.model_validate({"telemetry": {"url": "serial:/dev/ttyAMA0:921600"}, "camera": {"exposure_us": 2000.0}})
CAMERA = Camera.from_field_of_view(640, 480, 40.0)
WELL = report_of(WELL_INPUTS)
AROUND = Surroundings(CAMERA, "", 20000.0, 61.0)
BUDGET = replace(WELL, budget=Budget(6.2, {"mount": 0.6, "gps": 0.21, "pixels": 0.19}))


@dataclass(frozen=True)
class Case:
    what: str
    report: Report = WELL
    around: Surroundings = AROUND
    config: Config = CONFIG


def judged(**changed: object) -> Report:
    return report_of(replace(WELL_INPUTS, **changed))


def figures(source: str, **changed: float | None) -> Report:
    """The report with figures of a source changed, or without them."""
    status: SourceStatus = getattr(WELL, source)
    kept = {name: value for name, value in (status.figures | changed).items() if value is not None}
    return replace(WELL, **{source: replace(status, figures=kept)})


def estimated(name: str, unit: str, value: tuple[float, ...], sigma: tuple[float, ...]) -> Report:
    return replace(WELL, estimates=(Estimate(name, unit, value, sigma),))


def left_out(mask: float, standing: float) -> Report:
    return replace(WELL, pictures=replace(WELL.pictures, left_out=LeftOut(mask, standing)))


def configured(**camera: object) -> Config:
    return CONFIG.model_copy(update={"camera": CONFIG.camera.model_copy(update=camera)})


GPS, LIGHT = WELL.gps, WELL.brightness
assert GPS is not None and LIGHT is not None
SECOND = configured(thermal=SecondCamera(device="/dev/video9", file="thermal.json", scale=0.04))
RADIO = CONFIG.model_copy(update={"link": CONFIG.link.model_copy(update={"mavlink": True})})
FULL, LOW = RadioState(Held.BY_RADIO, 300.0, 22.0), RadioState(Held.BY_CONFIGURATION, 1200.0, 5.5)
NMEA = Config.model_validate({"telemetry": {"url": "nmea:/dev/ttyUSB0:9600"}, "recording": {"enabled": False}})
UNPLUGGED = SourceStatus(State.LOST, "/dev/video9: not there")
SILENT = SourceStatus(State.STARTING, "no autopilot found yet")
NO_CAMERA = replace(WELL, camera=UNPLUGGED, findings=source_findings(UNPLUGGED, WELL.telemetry), brightness=None)
NO_AUTOPILOT = replace(WELL, telemetry=SILENT, findings=source_findings(WELL.camera, SILENT))
RECEIVER = replace(
    WELL,
    gps=replace(GPS, sigma_horizontal_m=None, satellites=None),
    telemetry=SourceStatus(State.OK, "", {"position_hz": 10.0}),
)
SENSORS = (
    SensorError("tilt", "deg", 0.52, 0.5),
    SensorError("heading", "deg", 3.8, 2.0),
    SensorError("velocity", "m/s", 0.3, 0.1),
)
WRONG, OVER = Contradiction("tilt", 12.0, 9.0, 8), Contradiction("velocity", 1.0, 3.0, 4)
FAILED = ThreadReport("link", ThreadState.FAILED, None, 0, "gone")

CASES = [
    # What the daemon judges turns the state red, and its own line.
    Case("ten pictures a second of thirty", judged(camera=SourceStatus(State.DEGRADED, "10 of 30 Hz"))),
    Case("a frozen camera", judged(camera=SourceStatus(State.FROZEN, "same again"))),
    Case("a silent autopilot", judged(telemetry=SourceStatus(State.LOST, "silent"))),
    Case("no camera, without a daemon", NO_CAMERA, replace(AROUND, is_running=False)),
    Case("no autopilot, without a daemon", NO_AUTOPILOT, replace(AROUND, is_running=False)),
    Case("a pipeline that is busy for 9 s", judged(busy_s=9.0)),
    Case("a position that is doubted", judged(outcome=Status.NO_GPS, position_fault="far from it")),
    Case("pictures that do not fit", judged(outcome=Status.POOR_FIT)),
    Case("more pictures than can be solved", judged(is_shedding=True)),
    Case("a full disk", judged(recording_fault="disk full")),
    Case("a thread that failed", judged(threads=(FAILED,))),
    Case("no receiver", judged(gps=None)),
    Case("a fix without height", judged(gps=replace(GPS, fix_type=2))),
    Case("a fix of 9 s ago", judged(gps=replace(GPS, age_s=9.0))),
    Case("a fix of +-12 m", judged(gps=replace(GPS, sigma_horizontal_m=12.0))),
    # It was `ok` with a red line and exit 1.
    Case("a sensor that contradicts the others", judged(contradiction=in_words((WRONG, OVER)))),
    Case("a sensor that did", judged(contradiction=in_words((OVER,)))),
    # PX4 on the ground: a good fix and nothing to be seen. It was `no gps` with a doctor that was green.
    Case("at rest with a good fix", judged(outcome=Status.LOW_PARALLAX, is_at_rest=True)),
    # Each limit for take-off turns its own line red.
    Case("20 pictures a second", figures("camera", rate_hz=20.0)),
    Case("pictures at no known rate", figures("camera", rate_hz=None)),
    Case("no picture looked at", replace(WELL, brightness=None)),
    Case("dark pictures", replace(WELL, brightness=replace(LIGHT, mean=12.0))),
    Case("half of it white", replace(WELL, brightness=replace(LIGHT, white=0.5))),
    Case("half of it black", replace(WELL, brightness=replace(LIGHT, black=0.5))),
    Case("a position a second", figures("telemetry", position_hz=1.0)),
    Case("no positions", figures("telemetry", position_hz=None)),
    Case("four attitudes a second", figures("telemetry", attitude_hz=4.0)),
    Case("a clock that is not known", figures("telemetry", clock_sigma_ms=None)),
    Case("a clock without a number", figures("telemetry", clock_sigma_ms=float("nan"))),
    Case("a clock known to 50 ms", figures("telemetry", clock_sigma_ms=50.0)),
    Case("a clock known by arrival alone",
         figures("telemetry", clock_sigma_ms=None, round_trip_ms=None, arrival_sigma_ms=3.0)),
    Case("a round trip of 300 ms", figures("telemetry", round_trip_ms=300.0)),
    Case("stamps known to 31 ms", figures("camera", stamp_sigma_ms=31.0)),
    Case("stamps known to 140 ms", figures("camera", stamp_sigma_ms=140.0)),
    Case("a mount 11 degrees off", estimated(BORESIGHT, "radians", (0.2, 0.0, 0.0), (0.002,) * 3)),
    Case("half of the picture left out", left_out(0.0, 0.5)),
    Case("relative errors of six times the variance", estimated(RELATIVE_VARIANCE, "ratio", (6.0,), (0.2,))),
    # What surrounds it counts too.
    Case("no camera file", around=replace(AROUND, camera="camera.file is not set")),
    Case("a port in use", around=replace(AROUND, link="the port is already in use")),
    Case("900 MB free", around=replace(AROUND, free_mb=900.0)),
    Case("no folder for recordings", around=replace(AROUND, free_mb=None)),
    Case("a processor at 85 degrees", around=replace(AROUND, temperature_c=85.0)),
    # What is reported and is well.
    Case("an offset that was learned", estimated(TIME_OFFSET, "seconds", (-0.213,), (0.008,))),
    Case("a mount within its prior", estimated(BORESIGHT, "radians", (0.01, 0.01, 0.0), (0.002,) * 3)),
    Case("relative errors of 1.3 times the variance", estimated(RELATIVE_VARIANCE, "ratio", (1.3,), (0.2,))),
    Case("parts of the picture left out", left_out(0.02, 0.113)),
    Case("sensors worse than declared", replace(WELL, sensor_errors=SENSORS)),
    Case("what is not confirmed", replace(WELL, unconfirmed=(Estimate(TIME_OFFSET, "seconds", (0.81,), (0.12,)),))),
    Case("what would make a radius smaller", BUDGET),
    Case("a stream's decoder", around=replace(AROUND, decoders="H264 by v4l2h264dec (hardware), else avdec_h264")),
    Case("a thermal camera", config=CONFIG.model_copy(update={"thermal": ThermalConfig(enabled=True, scale=0.01)})),
    Case("one of no known scale", config=CONFIG.model_copy(update={"thermal": ThermalConfig(enabled=True)})),
    Case("a second camera", judged(thermal_camera=SourceStatus(State.OK, "")), config=SECOND),
    Case("one that was unplugged", judged(thermal_camera=SourceStatus(State.LOST, "unplugged")), config=SECOND),
    # The telemetry radio has a line where something goes through it.
    Case("the autopilot's radio, without a daemon", around=replace(AROUND, is_running=False), config=RADIO),
    Case("one that no ground listens to", replace(WELL, radio=RadioReport(answered=9)), config=RADIO),
    Case("one that carries sets", replace(WELL, radio=RadioReport(4800.0, 1.4, "", 9, 1, 80)), config=RADIO),
    Case("one that is full", replace(WELL, radio=RadioReport(300.0, 22.0, FULL.words, 9, 1)), config=RADIO),
    Case("one with too low a bit rate", replace(WELL, radio=RadioReport(1200.0, 5.5, LOW.words)), config=RADIO),
    Case("one whose answers do not arrive", replace(WELL, radio=RadioReport(answered=9, unheard=8)), config=RADIO),
    Case("one that reports a full buffer", replace(WELL, radio=RadioReport(free_percent=4)), config=RADIO),
    # What is not needed is not missed, and without a daemon nothing is reported of what only it can know.
    Case("a receiver alone, without recording", RECEIVER, Surroundings(CAMERA, "", None, None), NMEA),
    Case("no daemon", around=replace(AROUND, is_running=False)),
]  # fmt: skip


def page() -> str:
    """All lines before a good flight, and of every case those that differ from them."""
    good = diagnose(CONFIG, WELL, AROUND)
    lines = ["# What `pc-onboard doctor` prints before a good flight.", "", *text(good, False).splitlines(), ""]
    lines += ["# What else it prints of other reports, case by case. Where none is BAD it exits with 0.", ""]
    for case in CASES:
        found = diagnose(case.config, case.report, case.around)
        other = [line for line in found if line not in good]
        differing = text(other, False).splitlines() if other else ["nothing else"]
        missing = {line.name for line in good} - {line.name for line in found}
        lines += [f"{case.what}:", *(f"  {line}" for line in differing)]
        lines += [f"  without a line: {', '.join(sorted(missing))}"] if missing else []
    return "\n".join(line.rstrip() for line in lines) + "\n"
