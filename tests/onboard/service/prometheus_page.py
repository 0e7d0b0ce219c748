"""A report with everything in it, and all its figures as Prometheus has them: tests/transcripts/prometheus.txt."""

from dataclasses import replace

from contract.supervised_thread import ThreadReport, ThreadState
from onboard.events.source import SourceStatus, State
from onboard.pipeline.estimates import BORESIGHT, RELATIVE_VARIANCE
from onboard.pipeline.summary import Estimate, LeftOut, SensorError
from onboard.service.prometheus import metrics
from onboard.service.reports import ClockReport, PictureCounts
from tests.onboard.service.reported import WELL, report_of

FULL = replace(
    report_of(replace(WELL, position_fault="", outcome=None)),
    camera=SourceStatus(State.OK, "", {"rate_hz": 29.97, "delay_ms": 12.5, "lost": 3.0}),
    telemetry=SourceStatus(State.DEGRADED, "", {"drift_ppm": 20.0, "lost_packets": 7.0, "clock_sigma_ms": 0.9}),
    pictures=PictureCounts(300, 40, 280, {"no_gps": 12}, 0.25, 0, LeftOut(0.02, 0.1)),
    estimates=(
        Estimate(BORESIGHT, "radians", (0.01, 0.0, 0.0), (0.001,) * 3),
        Estimate(RELATIVE_VARIANCE, "ratio", (1.4,), (0.2,)),
    ),
    sensor_errors=(SensorError("heading", "deg", 3.8, 2.0),),
    threads=(ThreadReport("camera", ThreadState.RUNNING, 0.25, 2, "OSError: gone"),),
    clock=ClockReport(-0.5),
)


def page() -> str:
    """Every figure with what it is another of, in base units."""
    lines = ["# What `service.prometheus` serves of a report with everything in it.", ""]
    for family in metrics("kiwi", FULL):
        for sample in family.samples:
            labels = " ".join(f"{name}={text}" for name, text in sample.labels.items() if name != "vehicle")
            lines.append(" ".join(part for part in (sample.name, labels, f"{sample.value:.12g}") if part))
    return "\n".join(lines) + "\n"
