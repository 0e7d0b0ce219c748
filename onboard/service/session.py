"""One configuration in the air: camera, telemetry and pipeline, each in its own thread, on one clock.

Started, looked at, and finished by the daemon's thread. The pipeline's thread is all that ever touches the pipeline
and the sinks' events and sets, in one order, so that a recording replays to the same bytes.
"""

from __future__ import annotations

import logging
import struct
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from typing import Protocol

from contract.errors import InputError
from contract.feature_set import FeatureSet
from contract.supervised_thread import Policy, SupervisedThread, ThreadReport
from contract.vehicle_status import VehicleStatus
from onboard.config.schema import Config
from onboard.events.session_clock import SessionClock
from onboard.events.sink import Sink
from onboard.events.source import Source, TelemetrySource
from onboard.events.tunnel import RadioReport
from onboard.events.types import Event, Frame, GpsQuality
from onboard.pipeline.error_budgets import NewestBudget
from onboard.pipeline.estimates import in_words
from onboard.pipeline.pipeline import Pipeline
from onboard.pipeline.summary import Summary
from onboard.service.event_queue import EventQueue
from onboard.service.live_rates import LiveRates
from onboard.service.reports import (
    Brightness,
    ClockReport,
    PictureCounts,
    RecordingReport,
    Report,
    gps_report,
)
from onboard.service.standstill import Standstill
from onboard.service.supervision import Supervisor
from onboard.service.vehicle_state import MAX_GPS_AGE_S, STUCK_S, Inputs, judge, overall, second_in_brief
from onboard.storage.alignment_file import StateFile

IDLE_S = 0.2  # the pipeline's thread looks up this often when nothing comes
KEEP_LATE_S = 10.0
SOURCE_LATE_S = 10.0  # a source asks each second whether to end; opening a device may take it some seconds
SNAPSHOT_NS = 1_000_000_000
KEEP_S = 30.0  # between writes of what was learned
REPEAT_NS = 60_000_000_000  # between lines of the log about the same thing
# Encoding a set raises one of these if a number in it has no place on the wire.
UNENCODABLE = (ValueError, ArithmeticError, struct.error)

log = logging.getLogger("pointclick")
Reporter = Callable[[Report], None]


class RecordingSink(Sink, Protocol):
    """A sink that may be unable to continue, and reports that instead of raising."""

    @property
    def fault(self) -> str:
        """The reason why nothing is being recorded; empty while all is well."""


@dataclass(frozen=True, eq=False)
class Parts:
    """The parts that a session is put together from. `resources` closes whatever had to be opened for it."""

    clock: SessionClock
    camera: Source
    telemetry: TelemetrySource
    pipeline: Pipeline
    sinks: Sequence[Sink] = ()
    recording: RecordingSink | None = None  # one of the sinks
    reporters: Sequence[Reporter] = ()
    state: StateFile | None = None
    temperature_c: Callable[[], float | None] = field(default=lambda: None)
    resources: ExitStack = field(default_factory=ExitStack)
    threads: Sequence[SupervisedThread] = ()  # those that the parts brought with them: link, recording, solver, ...
    thermal_camera: Source | None = None  # a second one, which one of the sinks runs
    radio: Callable[[], RadioReport] | None = None  # how it goes through the autopilot's
    look: Callable[[], str] | None = None  # who had the camera look where; None where no one may


class Session:
    """Raises nothing of its threads' making: `failure` is to be asked."""

    def __init__(self, config: Config, parts: Parts) -> None:
        self.parts = parts
        self.clock = parts.clock
        self.event_queue = EventQueue(self.clock.now_ns, config.service.max_delay_s)
        self.live_rates = LiveRates()
        self._stop = threading.Event()
        self._sources = [
            SupervisedThread("camera", self._run_camera, Policy.END, late_after_s=SOURCE_LATE_S, stop=self._stop),
            SupervisedThread("telemetry", self._run_telemetry, Policy.END, late_after_s=SOURCE_LATE_S, stop=self._stop),
        ]
        self._pipeline = SupervisedThread(
            "pipeline", self._run_pipeline, Policy.END, late_after_s=STUCK_S, stop=self._stop
        )
        self._may_not_learn = threading.Event()  # set when nothing more comes to be learned
        self._keeper = SupervisedThread(
            "alignment file", self._keep, Policy.RESTART, late_after_s=KEEP_LATE_S, stop=self._may_not_learn
        )
        self.supervisor = Supervisor(lambda: (*self._sources, self._pipeline, self._keeper, *parts.threads))
        self.unencodable = 0  # sets that a sink could not encode, and that were left out
        self._unencodable_ns: int | None = None
        self._began_ns = self.clock.now_ns()
        self._busy_since_ns: int | None = None
        self._snapshot_at_ns = self._looked_ns = 0
        self._summary = Summary()
        self._tracks, self._follows = 0, config.tracks.enabled
        self._budget = NewestBudget()
        parts.pipeline.placing.watches.append(self._budget)
        self._gps: GpsQuality | None = None
        self._standstill = Standstill(config.gps)
        self._brightness: Brightness | None = None
        self._learned: str | None = None  # the newest; written by the pipeline's thread
        self._kept: str | None = None  # what the state file holds of it

    def start(self) -> None:
        """Enter the sinks and let everything run."""
        for sink in self.parts.sinks:
            self.parts.resources.enter_context(sink)
        for thread in (self._keeper, self._pipeline, *self._sources):
            thread.start()

    def threads(self) -> tuple[ThreadReport, ...]:
        """Return a report of each thread of the session: camera, telemetry, pipeline, and those of the parts."""
        return self.supervisor.reports()

    def finish(self, within_s: float) -> bool:
        """Stop the sources, let the pipeline come to its end, keep what was learned, close everything.

        Whether all that was done, and in time; what was not is in the log. A thread that does not end is left behind
        with what it uses: the process has to end then. A session that never started, or only in part, is closed too.
        """
        deadline = time.monotonic() + within_s
        reported = self.supervisor.failure or ()  # by the daemon, already
        self._stop.set()
        for source in self._sources:
            source.join(max(deadline - time.monotonic() - 0.5 * within_s, 0.0))
        self.event_queue.close()
        self._pipeline.join(max(deadline - time.monotonic(), 0.0))
        # Before anything that may fail is closed: it is small, and flights were needed to learn it.
        self._may_not_learn.set()
        self._keeper.join(max(deadline - time.monotonic(), 0.5))
        left = [t.name for t in (*self._sources, self._pipeline, self._keeper) if t.is_alive()]
        if left:
            log.error("%s did not end within %.0f s: left behind", ", ".join(left), within_s)
        if self._pipeline.is_alive():
            return False
        failed = self._pipeline.error
        if failed is not None and failed not in reported:
            log.error("the pipeline failed as it ended", exc_info=failed)
        return self._close() and failed is None and not left

    def _close(self) -> bool:
        try:
            self.parts.resources.close()
        except InputError as error:
            log.error("%s", error)
        except Exception:  # closing continues after it; it must not change the exit code or what the daemon does next
            log.exception("something could not be closed")
        else:
            return True
        return False

    def _keep(self, thread: SupervisedThread) -> None:
        """Write what was learned now and then, and at the end. In a thread of its own: a disk may hang."""
        while not thread.wait(KEEP_S):
            self.keep_learned()
        self.keep_learned()

    def keep_learned(self) -> bool:
        """Write what was learned since the last time; if that fails, report it, and it is tried again the next time."""
        learned = self._learned
        if learned is None or learned == self._kept or self.parts.state is None:
            return True
        try:
            self.parts.state.write(learned)
        except InputError as error:
            log.warning("%s", error)
            return False
        self._kept = learned
        return True

    def inputs(self) -> Inputs:
        """Return the inputs that the state is judged by."""
        now_ns, busy_since_ns = self.clock.now_ns(), self._busy_since_ns
        return Inputs(
            camera=self.parts.camera.health(),
            telemetry=self.parts.telemetry.health(),
            picture_age_s=self.live_rates.picture_age_s(now_ns),
            busy_s=0.0 if busy_since_ns is None else (now_ns - busy_since_ns) / 1e9,
            outcome=self.live_rates.outcome(now_ns),
            is_shedding=self.event_queue.dropped_within(2.0),
            recording_fault=self.parts.recording.fault if self.parts.recording is not None else "",
            gps=gps_report(self._gps, now_ns),
            position_fault=self.parts.pipeline.navigation.reason,
            is_at_rest=self._standstill.is_at_rest,
            threads=self.threads(),
            contradiction=in_words(self._summary.contradictions, self._summary.terrain_doubt),
            thermal_camera=None if self.parts.thermal_camera is None else self.parts.thermal_camera.health(),
        )

    def report(self) -> Report:
        """Everything the session knows of itself."""
        now_ns, inputs, rates, summary = self.clock.now_ns(), self.inputs(), self.live_rates, self._summary
        state, budget, gps = overall(inputs), self._budget.at(now_ns), inputs.gps
        gps = gps if gps is not None and gps.age_s < MAX_GPS_AGE_S else None
        is_recording = self.parts.recording is not None and not inputs.recording_fault
        status = VehicleStatus(
            unix_s=now_ns / 1e9,
            session=rates.session,
            state=state.state.value,
            reason=state.reason,
            up_s=(now_ns - self._began_ns) / 1e9,
            camera_hz=rates.camera_hz(now_ns),
            ok_hz=rates.ok_hz(now_ns),
            frame=rates.frame,
            delay_s=rates.delay_s,
            tracks=self._tracks,
            dropped=self.event_queue.dropped,
            lost=round(inputs.camera.figures.get("lost", 0.0)),
            recording=is_recording,
            cpu_c=self.parts.temperature_c(),
            shares={} if budget is None else budget.percent,
            follows=self._follows,
            looks=self.parts.look is not None,
            look="" if self.parts.look is None else self.parts.look(),
            heat=second_in_brief(inputs.thermal_camera),
            fix=None if gps is None else gps.fix_type,
            satellites=None if gps is None else gps.satellites,
            **asdict(inputs.telemetry.aircraft),
        )
        return Report(
            status,
            inputs.camera,
            inputs.telemetry,
            judge(inputs),
            self._brightness,
            inputs.gps,
            PictureCounts.of(summary, self.unencodable),
            summary.estimates,
            summary.sensor_errors,
            summary.contradictions,
            inputs.threads,
            RecordingReport(is_recording, inputs.recording_fault),
            ClockReport(self.clock.host_step_s()),
            summary.unconfirmed,
            budget,
            inputs.thermal_camera,
            None if self.parts.radio is None else self.parts.radio(),
        )

    def _run_camera(self, thread: SupervisedThread) -> None:
        self.parts.camera.run(self._take, thread)

    def _run_telemetry(self, thread: SupervisedThread) -> None:
        self.parts.telemetry.run(self._take, thread)

    def _take(self, arrival_ns: int, event: Event) -> None:
        if isinstance(event, Frame):
            self.live_rates.picture_came(self.clock.now_ns())
        elif isinstance(event, GpsQuality):
            self._gps = event  # here, before it waits in the queue: its age is the receiver's silence
        self.event_queue.put(arrival_ns, event)

    def _run_pipeline(self, thread: SupervisedThread) -> None:
        pipeline, sinks = self.parts.pipeline, self.parts.sinks
        while not self.event_queue.is_over:
            thread.beat()
            got = self.event_queue.get(IDLE_S)
            self._busy_since_ns = None if got is None else self.clock.now_ns()
            if got is not None:
                arrival_ns, event = got
                for sink in sinks:
                    sink.event(arrival_ns, event)
                self._hand_out(pipeline.handle(event))
                self._standstill.note(event)
                self._busy_since_ns = None
            self._take_snapshot(None if got is None else got[1])
        self._busy_since_ns = self.clock.now_ns()
        self._hand_out(pipeline.finish())
        self._snapshot_at_ns = self._looked_ns = 0
        self._take_snapshot(None)
        self._busy_since_ns = None

    def _hand_out(self, outputs: Sequence[FeatureSet]) -> None:
        for output in outputs:
            taken = [self._hand_over(output, sink) for sink in self.parts.sinks]
            if all(taken):
                self.live_rates.set_made(output, self.clock.now_ns())

    def _hand_over(self, output: FeatureSet, sink: Sink) -> bool:
        """Hand a set over; return whether the sink took it. One without an encoding is left out: it ends no flight."""
        try:
            sink.feature_set(output)
        except UNENCODABLE as error:
            self.unencodable += 1
            now_ns = self.clock.now_ns()
            if self._unencodable_ns is None or now_ns - self._unencodable_ns >= REPEAT_NS:
                self._unencodable_ns = now_ns
                log.exception("the set of frame %d is left out (%d so far): %s", output.frame, self.unencodable, error)
            return False
        return True

    def _take_snapshot(self, event: Event | None) -> None:
        """Once a second, what other threads may see of the pipeline; and how bright its newest picture is."""
        now_ns, pipeline = self.clock.now_ns(), self.parts.pipeline
        if isinstance(event, Frame) and event.image is not None and now_ns - self._looked_ns >= SNAPSHOT_NS:
            self._looked_ns, self._brightness = now_ns, Brightness.of(event.image)
        if now_ns - self._snapshot_at_ns < SNAPSHOT_NS:
            return
        self._snapshot_at_ns = now_ns
        self._summary = pipeline.summary
        self._tracks = len(pipeline.tracks)
        alignment = pipeline.window.alignment
        if alignment.updates:
            self._learned = alignment.to_json()


def restore(state: StateFile, pipeline: Pipeline) -> str:
    """Begin from the state file; what is wrong with it if it cannot be used, and the flight begins without."""
    try:
        left_out = state.restore(pipeline.window.alignment)
    except InputError as error:
        return str(error)
    if left_out:
        log.warning("of what was learned before, %s begins again: it is of what was declared then", ", ".join(left_out))
    return ""
