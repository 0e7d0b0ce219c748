"""The daemon's life: it begins, flies, is asked things and ends, and does none of it halfway."""

from __future__ import annotations

import json
import logging
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import pytest

from contract.errors import ConfigError, InputError
from contract.feature_set import FeatureSet
from contract.vehicle_status import VehicleStatus
from ground.recording import Recording
from onboard.config.schema import Config
from onboard.events.session_clock import SessionClock
from onboard.events.source import AircraftReport, Emit, Severity, SourceStatus, State, Stop
from onboard.events.types import Event, Frame, GpsQuality
from onboard.pipeline.pipeline import Pipeline
from onboard.service.daemon import Daemon, Order, SignalOrders
from onboard.service.reports import Report
from onboard.service.sd_notify import Notifier
from onboard.service.session import Parts
from tests.onboard.service.air import QueueOrders, take_off
from tests.scenarios.flights import CAMERA
from tests.waiting import PATIENCE_S, eventually


class Notes(Notifier):
    def __init__(self) -> None:
        super().__init__({"WATCHDOG_USEC": "1000000"})
        self.words: list[str] = []

    def _send(self, text: str) -> None:
        self.words.append(text.split("\n", maxsplit=1)[0])


class Steady:
    """A source of one kind of event, twenty a second, that can be told how to be."""

    def __init__(self, make: type[Frame] | type[GpsQuality], clock: SessionClock) -> None:
        self.make, self.clock = make, clock
        self.state = State.OK
        self.error: BaseException | None = None
        self.is_silent = self.ends = self.is_deaf = False
        self.late_ns, self.aircraft = 0, AircraftReport()
        self.hangs = threading.Event()  # is deaf, and past its last question whether to end
        self.reported: list[str] = []

    def run(self, emit: Emit, stop: Stop) -> None:
        index = 0
        while (self.is_deaf or not stop.wait(0.05)) and not self.ends:
            if self.error is not None:
                raise self.error
            if self.is_deaf:
                self.hangs.set()
                time.sleep(0.05)
            elif not self.is_silent:
                now_ns = self.clock.now_ns()
                quality = GpsQuality(now_ns - self.late_ns, 3, 17)
                emit(now_ns, Frame(now_ns, index, None) if self.make is Frame else quality)
                index += 1

    def health(self) -> SourceStatus:
        return SourceStatus(self.state, "as told" if self.state is not State.OK else "", aircraft=self.aircraft)

    def send_text(self, severity: Severity, text: str) -> None:
        self.reported.append(text)


class Held(Pipeline):
    def __init__(self, config: Config) -> None:
        super().__init__(config, CAMERA)
        self.release = threading.Event()
        self.release.set()
        self.error: Exception | None = None

    def handle(self, event: Event) -> list[FeatureSet]:
        self.release.wait(PATIENCE_S)
        if self.error is not None:
            raise self.error
        return super().handle(event)


class Rig:
    """A daemon in a thread of the test, on the real clock, with sources that do as they are asked."""

    def __init__(self) -> None:
        self.orders, self.notes = QueueOrders(), Notes()
        self.configs: list[Config | ConfigError] = [Config()]
        self.open_error: InputError | None = None
        self.opened: list[tuple[Config, Parts]] = []
        self.closed = 0
        self.states: list[str] = []
        self.status = VehicleStatus(0.0, 0, "starting")  # the newest
        self.code: int | None = None
        self.error: BaseException | None = None
        self.daemon = Daemon(self.load, self.open, self.orders, self.notes, tick_s=0.02)
        self.thread = threading.Thread(target=self.run)

    def load(self) -> Config:
        found = self.configs[-1]
        if isinstance(found, ConfigError):
            raise found
        return found

    def open(self, config: Config) -> Parts:
        if self.open_error is not None:
            error, self.open_error = self.open_error, None
            raise error
        clock = SessionClock.start()
        self.camera, self.telemetry = Steady(Frame, clock), Steady(GpsQuality, clock)
        self.pipeline = Held(config)
        parts = Parts(
            clock,
            self.camera,
            self.telemetry,
            self.pipeline,
            reporters=[self.note_status],
        )
        parts.resources.callback(self.note_closed)
        self.opened.append((config, parts))
        return parts

    def note_status(self, report: Report) -> None:
        self.states.append(report.status.state)
        self.status = report.status

    def note_closed(self) -> None:
        self.closed += 1

    def run(self) -> None:
        try:
            self.code = self.daemon.run()
        except (ConfigError, InputError) as error:
            self.error = error

    def __enter__(self) -> Rig:
        self.thread.start()
        self.wait_for(lambda: "READY=1" in self.notes.words or not self.thread.is_alive())
        return self

    def __exit__(self, *_: object) -> None:
        self.orders.queue.put(Order.STOP)
        self.pipeline.release.set()
        self.thread.join(PATIENCE_S)
        assert not self.thread.is_alive()

    def wait_for(self, claim: Callable[[], object]) -> None:
        assert eventually(claim), (self.notes.words[-5:], self.states[-3:])

    def turn(self, times: int = 2) -> None:
        begun = self.orders.asked
        self.wait_for(lambda: self.orders.asked >= begun + times)

    def is_unfed(self) -> bool:
        """Whether the watchdog gets nothing in some turns from now on."""
        self.turn()
        fed = self.fed
        self.turn(12)
        return self.fed == fed

    def order(self, order: Order) -> None:
        self.orders.queue.put(order)

    def ended(self) -> int:
        self.thread.join(PATIENCE_S)
        assert not self.thread.is_alive()
        assert self.code is not None
        return self.code

    @property
    def fed(self) -> int:
        return self.notes.words.count("WATCHDOG=1")


def test_it_says_ready_feeds_the_watchdog_and_stops_when_asked() -> None:
    with Rig() as rig:
        rig.wait_for(lambda: rig.fed > 3 and "no gps" not in rig.states[:1])
        rig.order(Order.STOP)
        assert rig.ended() == 0  # and not 1, as where a thread must be left behind
    assert rig.notes.words[0] == "READY=1"
    assert rig.notes.words[-1] == "STOPPING=1"
    assert rig.closed == 1


def test_a_configuration_that_cannot_be_used_is_raised_and_nothing_reported_to_be_ready() -> None:
    rig = Rig()
    rig.open_error = InputError("camera file missing")
    rig.thread.start()
    rig.thread.join(PATIENCE_S)
    assert str(rig.error) == "camera file missing"
    assert rig.notes.words == []


@pytest.mark.parametrize("part", ["camera", "telemetry", "pipeline"])
def test_a_thread_that_fails_ends_the_daemon_with_the_reason(part: str, caplog: pytest.LogCaptureFixture) -> None:
    with Rig() as rig:
        getattr(rig, part).error = RuntimeError("out of luck")
        assert rig.ended() == 1
    assert f"the {part} failed" in caplog.text
    assert "out of luck" in caplog.text
    assert rig.closed == 1


def test_what_no_configuration_can_mend_is_one_line(caplog: pytest.LogCaptureFixture) -> None:
    with Rig() as rig:
        rig.camera.error = InputError("/dev/video0: not a camera")
        assert rig.ended() == 1
    assert [r.getMessage() for r in caplog.records if r.levelno == logging.ERROR] == [
        "the camera cannot go on: /dev/video0: not a camera"
    ]


def test_a_source_that_ends_by_itself_ends_the_daemon(caplog: pytest.LogCaptureFixture) -> None:
    with Rig() as rig:
        rig.telemetry.ends = True
        assert rig.ended() == 1
    assert "the telemetry ended by itself" in caplog.text


def test_a_hung_pipeline_starves_the_watchdog_and_is_called_stuck() -> None:
    with Rig() as rig:
        rig.wait_for(lambda: rig.fed > 3)
        rig.pipeline.release.clear()
        rig.wait_for(lambda: "stuck" in rig.states)
        assert rig.is_unfed()
        fed = rig.fed
        rig.pipeline.release.set()
        rig.wait_for(lambda: rig.fed > fed)


def test_a_daemon_with_a_hung_pipeline_still_ends_and_says_so(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("onboard.service.daemon.FINISH_S", 0.5)
    with Rig() as rig:
        rig.pipeline.release.clear()
        time.sleep(0.2)
        rig.order(Order.STOP)
        assert rig.ended() == 1
    assert "did not end" in caplog.text


def test_a_silent_camera_that_calls_itself_well_starves_the_watchdog_a_lost_one_does_not() -> None:
    with Rig() as rig:
        rig.wait_for(lambda: rig.fed > 3)
        rig.camera.is_silent, rig.camera.state = True, State.LOST
        time.sleep(3.5)
        fed = rig.fed
        rig.wait_for(lambda: rig.fed > fed + 3 and rig.states[-1] == "camera lost")
        rig.camera.state = State.OK
        assert rig.is_unfed()
        rig.wait_for(lambda: rig.states[-1] == "camera silent")


def test_the_status_has_what_receiver_and_autopilot_report_unless_it_is_old() -> None:
    with Rig() as rig:
        rig.telemetry.aircraft = AircraftReport("AUTO", 64, 22.1)
        rig.wait_for(lambda: (rig.status.fix, rig.status.satellites) == (3, 17) and rig.status.mode == "AUTO")
        assert (rig.status.battery_percent, rig.status.battery_v) == (64, 22.1)
        rig.telemetry.late_ns = 4_000_000_000
        rig.wait_for(lambda: rig.status.fix is None and rig.status.satellites is None)


def test_states_are_logged_once_and_reported_to_the_pilot(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    with Rig() as rig:
        rig.wait_for(lambda: rig.states.count("bad picture") + rig.states.count("no gps") > 1)
        rig.camera.state = State.LOST
        rig.wait_for(lambda: "pointclick: camera lost: as told" in rig.telemetry.reported)
        rig.camera.state = State.OK
    lost = [r for r in caplog.records if r.getMessage() == "state: camera lost: as told"]
    assert len(lost) == 1
    assert lost[0].levelno == logging.WARNING
    assert "STATUS=camera lost: as told" in rig.notes.words
    assert all(len(text) <= 100 for text in rig.telemetry.reported)  # two STATUSTEXT


def test_a_reload_of_the_delay_goes_on_in_the_same_session() -> None:
    with Rig() as rig:
        service = rig.opened[0][0].service.model_copy(update={"max_delay_s": 0.2})
        rig.configs.append(Config(service=service))
        rig.order(Order.RELOAD)
        rig.wait_for(lambda: rig.notes.words.count("READY=1") == 2)
        assert len(rig.opened) == 1
        assert rig.daemon._session.event_queue.max_delay_s == 0.2


def test_a_reload_of_anything_else_begins_a_session_of_its_own() -> None:
    with Rig() as rig:
        rig.configs.append(Config.model_validate({"vehicle": {"id": "kiwi"}}))
        rig.order(Order.RELOAD)
        rig.wait_for(lambda: rig.notes.words.count("READY=1") == 2)
        assert [config.vehicle.id for config, _ in rig.opened] == ["uav", "kiwi"]
        assert rig.closed == 1
        assert rig.notes.words.index("RELOADING=1") > rig.notes.words.index("READY=1")


def test_a_bad_configuration_is_refused_in_one_line_and_the_old_one_flies_on(caplog: pytest.LogCaptureFixture) -> None:
    with Rig() as rig:
        rig.configs.append(ConfigError("config.toml: unknown key 'gps.latency'"))
        rig.order(Order.RELOAD)
        rig.wait_for(lambda: rig.notes.words.count("READY=1") == 2)
        fed = rig.fed
        rig.wait_for(lambda: rig.fed > fed)
        assert len(rig.opened) == 1
        assert rig.closed == 0
    (line,) = [r.getMessage() for r in caplog.records if r.levelno == logging.ERROR]
    assert line == "not reloaded, the old configuration stays: config.toml: unknown key 'gps.latency'"


def test_a_new_configuration_that_cannot_be_opened_gives_way_to_the_old(caplog: pytest.LogCaptureFixture) -> None:
    with Rig() as rig:
        rig.configs.append(Config.model_validate({"vehicle": {"id": "kiwi"}}))
        rig.open_error = InputError("the port is already in use")
        rig.order(Order.RELOAD)
        rig.wait_for(lambda: rig.notes.words.count("READY=1") == 2)
        assert [config.vehicle.id for config, _ in rig.opened] == ["uav", "uav"]
    assert "back to the old: the port is already in use" in caplog.text


def test_signals_are_orders_and_interrupt_nothing() -> None:
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [])
    with SignalOrders() as orders:
        assert orders.next(0.01) is None
        for number, order in ((signal.SIGHUP, Order.RELOAD), (signal.SIGTERM, Order.STOP), (signal.SIGINT, Order.STOP)):
            signal.pthread_kill(threading.get_ident(), number)  # threads of earlier tests (zenoh's) do not block it
            assert orders.next(PATIENCE_S) is order
    assert signal.pthread_sigmask(signal.SIG_BLOCK, []) == before


WAITS_FOR_ORDERS = """
from onboard.service.daemon import SignalOrders
with SignalOrders() as orders:
    print("waits", flush=True)
    input()
    print(*(orders.next(0.3) for _ in range(6)), flush=True)
    print(orders.next(60.0), flush=True)
"""


def test_a_process_that_is_stopped_and_goes_on_received_nothing() -> None:
    """As by a suspend: the daemon ended, for the wait that was over by then gave a signal of a number that is none."""
    command = [sys.executable, "-c", WAITS_FOR_ORDERS]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdin is not None and process.stdout is not None
        try:
            assert process.stdout.readline() == "waits\n"
            process.stdin.write("\n")
            process.stdin.flush()
            for _ in range(3):
                time.sleep(0.1)
                process.send_signal(signal.SIGSTOP)
                time.sleep(0.4)
                process.send_signal(signal.SIGCONT)
            assert process.stdout.readline() == "None None None None None None\n"
            process.send_signal(signal.SIGHUP)
            assert process.stdout.readline() == "Order.RELOAD\n"
        finally:
            process.kill()


def test_a_flight_gives_answers_a_recording_and_what_was_learned(tmp_path: Path) -> None:
    air = take_off(tmp_path, seconds=16.0)
    assert air.code == 0
    assert air.states(-1.0, 6.0) == ["starting", "ok"]
    assert air.states(6.0, 15.0) == ["ok"]
    outcome = air.clicked()
    assert outcome.solved > 0.95, outcome.reported
    assert outcome.inside_99 > 0.97, outcome.reported
    assert air.received is not None
    (_, first), (_, second) = air.telemetry.reported
    assert first.startswith("pointclick: starting: ")  # and why
    assert second == "pointclick: ok"
    learned = json.loads((tmp_path / "alignment.json").read_text())
    assert abs(learned["offset_s"]) < 0.2
    status = [status for at_s, status in air.statuses if at_s < 14.0][-1]  # while the camera still flew
    assert (status.dropped, status.recording) == (0, True)
    assert 3.0 < status.camera_hz < 5.0
    assert 0.0 < status.delay_s < 1.0
    (recording,) = air.recordings
    kept = Recording(recording)
    frames = [event.index for event in air.received.events if isinstance(event, Frame)]
    assert kept.frames("uav") == frames == list(range(len(frames)))
    last = {output.frame: output for _, output in air.received.sets}
    for frame, output in last.items():
        found = kept.by_frame("uav", frame)
        assert (found.revision, found.status) == (output.revision, output.status)


def test_pictures_are_shed_oldest_first_when_the_processor_is_starved(tmp_path: Path) -> None:
    """A pipeline that needs 0.4 s a picture, fed four a second, on a real clock."""

    took_s = [0.0]  # each picture, which is more than 0.4 s where the machine itself stands still

    def slow(pipeline: Pipeline) -> Pipeline:
        handle = pipeline.handle

        def slowly(event: Event) -> list[FeatureSet]:
            began_s = time.monotonic()
            if isinstance(event, Frame):
                time.sleep(0.4)
            try:
                return handle(event)
            finally:
                took_s.append(time.monotonic() - began_s)

        pipeline.handle = slowly
        return pipeline

    air = take_off(tmp_path, seconds=8.0, speed=1.0, wrap=slow, config={"service": {"max_delay_s": 0.8}})
    assert air.statuses[-1][1].dropped > 5
    late = [(made_ns - s.capture_unix_ns) / 1e9 for made_ns, s in air.received.sets if s.revision == 0]
    # Waiting, its own handling and telemetry's; the same at the end as at the beginning.
    longest_s = 0.8 + 2 * max(0.4, *took_s) + 0.6
    assert max(late[len(late) // 2 :]) < longest_s
    assert "overloaded" in air.states(2.0, 8.0)
    events = air.received.events
    stamps = [event.stamp_ns for event in events if isinstance(event, Frame)]
    assert stamps == sorted(stamps)
    assert stamps[-1] > air.first_ns + 8e9 - min(longest_s, 7.0) * 1e9
    outcome = air.clicked()
    assert outcome.inside_99 > 0.97, outcome.reported
    # Shedding comes before recording: what was dropped is in no one's list.
    assert len(Recording(air.recordings[0]).frames("uav")) == len(stamps)


@pytest.mark.long
def test_nothing_the_host_does_to_its_clock_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An hour forth and an hour back in flight."""
    true_ns, hour_ns = time.time_ns, 3_600_000_000_000
    pictures = 0

    class Counting(ExitStack):
        def feature_set(self, output: FeatureSet) -> None:
            return None

        def event(self, arrival_ns: int, event: Event) -> None:
            nonlocal pictures
            pictures += isinstance(event, Frame)

    def stepped() -> int:  # after six and after ten seconds of four pictures each
        return true_ns() + (0 if pictures < 24 else hour_ns if pictures < 40 else -hour_ns)

    monkeypatch.setattr(time, "time_ns", stepped)
    air = take_off(tmp_path, seconds=14.0, sinks=lambda: [Counting()])
    assert pictures == 56
    assert air.code == 0
    assert air.states(4.0, 13.0) == ["ok"]
    outcome = air.clicked()
    assert outcome.solved > 0.95, outcome.reported
    assert outcome.inside_99 > 0.97, outcome.reported
    stamps = [s.capture_unix_ns for s in air.sets().values()]
    assert max(stamps) - min(stamps) < 15e9


def test_a_state_file_is_begun_from(tmp_path: Path) -> None:
    platform = {
        "boresight_rad": [0.01, 0.0, 0.0], "offset_s": 0.05, "end_unix_ns": 1,
        "covariance": [[1e-6 if i == j else 0.0 for j in range(4)] for i in range(4)],
    }  # fmt: skip
    (tmp_path / "alignment.json").write_text(json.dumps(platform))
    from onboard.service.session import restore  # noqa: PLC0415
    from onboard.storage.alignment_file import StateFile  # noqa: PLC0415

    pipeline = Pipeline(Config(), CAMERA)
    assert restore(StateFile(tmp_path / "alignment.json"), pipeline) == ""
    assert pipeline.window.alignment.platform.mean[3] == 0.05
    (tmp_path / "alignment.json").write_text("{half")
    again = Pipeline(Config(), CAMERA)
    assert "alignment.json" in restore(StateFile(tmp_path / "alignment.json"), again)
    assert again.window.alignment.platform.mean[3] == 0.0
