"""Threads under supervision, reloads that find no way on, sinks that fail: what the daemon makes of each."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from types import TracebackType

import numpy as np
import pytest

from contract.errors import InputError
from contract.feature_set import FeatureSet
from contract.supervised_thread import Policy, SupervisedThread, ThreadState
from onboard.config.schema import Config
from onboard.events.sink import Sink
from onboard.events.types import Event
from onboard.service.daemon import Order
from onboard.service.session import Parts
from onboard.service.solver_thread import SolverThread
from tests.onboard.service.test_daemon import Rig
from tests.waiting import PATIENCE_S, eventually

KIWI = Config.model_validate({"vehicle": {"id": "kiwi"}})


class Fitted(Rig):
    def __init__(self, change: Callable[[Parts], Parts]) -> None:
        super().__init__()
        self.change = change

    def open(self, config: Config) -> Parts:
        parts = self.change(super().open(config))
        self.opened[-1] = (config, parts)
        return parts

    @property
    def states_of_threads(self) -> dict[str, ThreadState]:
        return {report.name: report.state for report in self.daemon._session.threads()}


class Listening:
    def __init__(self, entry: Exception | None = None, at: Callable[[FeatureSet], Exception | None] | None = None):
        self.entry, self.at = entry, at
        self.sets: list[FeatureSet] = []
        self.is_left = False

    def __enter__(self) -> Listening:
        if self.entry is not None:
            raise self.entry
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.is_left = True

    def event(self, arrival_ns: int, event: Event) -> None:
        return None

    def feature_set(self, output: FeatureSet) -> None:
        if self.at is not None and (error := self.at(output)) is not None:
            raise error
        self.sets.append(output)


def with_sinks(*sinks: Sink) -> Fitted:
    return Fitted(lambda parts: replace(parts, sinks=sinks))


def test_the_threads_of_a_session_are_reported() -> None:
    with Fitted(lambda parts: parts) as rig:
        rig.wait_for(lambda: set(rig.states_of_threads.values()) == {ThreadState.RUNNING})
        assert set(rig.states_of_threads) == {"camera", "telemetry", "pipeline", "alignment file"}
        rig.order(Order.STOP)
        assert rig.ended() == 0
    assert set(rig.states_of_threads.values()) == {ThreadState.ENDED}


def test_a_hanging_source_that_calls_itself_well_starves_the_watchdog(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("onboard.service.session.SOURCE_LATE_S", 0.3)
    with Fitted(lambda parts: parts) as rig:
        rig.wait_for(lambda: rig.fed > 3)
        rig.telemetry.is_deaf = True
        rig.wait_for(lambda: rig.states_of_threads["telemetry"] is ThreadState.LATE)
        assert rig.is_unfed()
        fed = rig.fed
        rig.telemetry.is_deaf = False
        rig.wait_for(lambda: rig.fed > fed)


def test_a_hanging_source_ends_a_daemon_without_a_watchdog(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("onboard.service.session.SOURCE_LATE_S", 0.5)
    monkeypatch.setattr("onboard.service.daemon.HUNG_S", 3.0)  # longer than a busy machine holds up another thread
    monkeypatch.setattr("onboard.service.daemon.FINISH_S", 0.5)
    with Fitted(lambda parts: parts) as rig:
        rig.camera.is_deaf = True  # and so it is found, whenever it asked last
        assert rig.ended() == 1
        rig.camera.is_deaf = False
    assert "the camera has not reported" in caplog.text


@pytest.mark.parametrize("policy", [Policy.RESTART, Policy.DEGRADE])
def test_a_thread_that_the_flight_can_do_without_neither_starves_the_watchdog_nor_ends_the_daemon(
    policy: Policy,
) -> None:
    release = threading.Event()

    def hang(thread: SupervisedThread) -> None:
        if not release.wait(PATIENCE_S):
            return
        raise RuntimeError("and then it fails")

    threads = [SupervisedThread("link", hang, policy, late_after_s=0.1)]
    with Fitted(lambda parts: replace(parts, threads=threads)) as rig:
        threads[0].start()
        rig.wait_for(lambda: rig.states_of_threads["link"] is ThreadState.LATE)
        fed = rig.fed
        rig.wait_for(lambda: rig.fed > fed + 3)
        release.set()
        failed = {Policy.RESTART: ThreadState.RESTARTING, Policy.DEGRADE: ThreadState.FAILED}[policy]
        rig.wait_for(lambda: rig.states_of_threads["link"] is failed)
        fed = rig.fed
        rig.wait_for(lambda: rig.fed > fed + 3)
        threads[0].end()
        rig.order(Order.STOP)
        assert rig.ended() == 0


def test_the_solver_hands_back_results_and_errors_in_order_and_hangs_visibly() -> None:
    solver = SolverThread()
    first: Future[int] = solver.submit(lambda n: n + 1, 1)
    second: Future[float] = solver.submit(lambda n: 1.0 / n, 0)
    third: Future[int] = solver.submit(lambda n: n, 3)
    assert first.result(PATIENCE_S) == 2 and third.result(PATIENCE_S) == 3
    with pytest.raises(ZeroDivisionError):
        second.result(PATIENCE_S)
    assert solver.thread.report().state is ThreadState.RUNNING and solver.thread.policy is Policy.END
    release = threading.Event()
    hanging: Future[bool] = solver.submit(release.wait, PATIENCE_S)
    solver.thread.late_after_s = 0.05
    assert eventually(lambda: solver.thread.is_late)
    release.set()
    assert hanging.result(PATIENCE_S) is True
    solver.close()
    assert solver.thread.join(PATIENCE_S)


# Fault 12: exit 2 keeps systemd from starting the service again.
def test_a_reload_while_a_source_hangs_ends_with_1_and_raises_nothing(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("onboard.service.daemon.FINISH_S", 0.5)
    with Fitted(lambda parts: parts) as rig:
        hanging = rig.camera
        hanging.is_deaf = True
        assert hanging.hangs.wait(PATIENCE_S)
        rig.configs.append(KIWI)
        rig.order(Order.RELOAD)
        assert rig.ended() == 1
        hanging.is_deaf = False
    assert rig.error is None
    assert len(rig.opened) == 1
    assert "camera did not end" in caplog.text and "cannot begin before it has" in caplog.text


def test_a_reload_after_which_nothing_can_be_opened_ends_with_1(caplog: pytest.LogCaptureFixture) -> None:
    opened: list[Parts] = []

    def refuse(parts: Parts) -> Parts:
        opened.append(parts)
        if len(opened) > 1:
            raise InputError(f"camera file missing, {len(opened)}")
        return parts

    with Fitted(refuse) as rig:
        rig.configs.append(KIWI)
        rig.order(Order.RELOAD)
        assert rig.ended() == 1
    assert rig.error is None
    assert "back to the old: camera file missing, 2" in caplog.text
    assert "the old configuration cannot be used any more: camera file missing, 3" in caplog.text


# Fault 15.
@pytest.mark.parametrize("error", [ValueError("camera_lat_deg = nan"), OverflowError("int too large to convert")])
def test_a_set_that_cannot_be_encoded_is_left_out_counted_and_logged_once(
    error: Exception, caplog: pytest.LogCaptureFixture
) -> None:
    link = Listening(at=lambda output: error if output.frame % 2 else None)
    recording = Listening()
    with with_sinks(link, recording) as rig:
        rig.wait_for(lambda: len(link.sets) >= 10)
        assert rig.daemon._session.unencodable >= 9
        rig.order(Order.STOP)
        assert rig.ended() == 0
    assert {output.frame % 2 for output in link.sets} == {0}
    assert {output.frame % 2 for output in recording.sets} == {0, 1}  # each sink for itself
    assert caplog.text.count("is left out") == 1 and str(error) in caplog.text


def test_sets_of_which_none_can_be_encoded_are_not_called_well() -> None:
    link = Listening(at=lambda _: ValueError("nan"))
    with with_sinks(link) as rig:
        rig.wait_for(lambda: rig.daemon._session.unencodable >= 20)
        rig.wait_for(lambda: bool(rig.states) and rig.states[-1] == "starting")


def test_another_error_of_a_sink_ends_the_daemon_as_before(caplog: pytest.LogCaptureFixture) -> None:
    with with_sinks(Listening(at=lambda _: RuntimeError("a bug"))) as rig:
        assert rig.ended() == 1
    assert "the pipeline failed" in caplog.text


# Fault 20.
class Memory:
    def __init__(self, refusals: int = 0) -> None:
        self.refusals, self.tries, self.kept = refusals, 0, ""

    def write(self, text: str) -> None:
        self.tries += 1
        if self.tries <= self.refusals:
            raise InputError("state file alignment.json: No space left on device")
        self.kept = text


def learning(memory: Memory) -> Callable[[Parts], Parts]:
    def change(parts: Parts) -> Parts:
        assert parts.pipeline.window.alignment.offer(0, 1, np.zeros(8), 1e-6 * np.eye(8))
        return replace(parts, state=memory)

    return change


def test_what_was_learned_is_written_again_after_a_write_that_failed(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("onboard.service.session.KEEP_S", 0.1)
    memory = Memory(refusals=2)
    with Fitted(learning(memory)) as rig:
        rig.wait_for(lambda: memory.kept != "")
        tries = memory.tries
        threading.Event().wait(0.4)
        assert memory.tries == tries == 3  # once is enough: nothing new was learned
    assert caplog.text.count("No space left on device") == 2


def test_what_was_learned_is_kept_though_a_resource_cannot_be_closed(caplog: pytest.LogCaptureFixture) -> None:
    memory = Memory()

    def change(parts: Parts) -> Parts:
        parts = learning(memory)(parts)
        parts.resources.callback(fail)
        return parts

    def fail() -> None:
        raise OSError(5, "Input/output error")

    with Fitted(change) as rig:
        rig.wait_for(lambda: rig.fed > 3)
        rig.order(Order.STOP)
        assert rig.ended() == 1  # not cleanly, and not by an error that no one caught
    assert rig.error is None
    assert memory.kept != "" and rig.closed == 1
    assert "Input/output error" in caplog.text


def test_what_was_learned_is_kept_though_the_pipeline_hangs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("onboard.service.daemon.FINISH_S", 0.5)
    memory = Memory()
    with Fitted(learning(memory)) as rig:
        rig.wait_for(lambda: rig.daemon._session._learned is not None)
        rig.pipeline.release.clear()
        threading.Event().wait(0.2)
        assert memory.kept == ""
        rig.order(Order.STOP)
        assert rig.ended() == 1
    assert memory.kept != ""


def test_a_pipeline_that_fails_at_its_very_end_is_no_clean_end(caplog: pytest.LogCaptureFixture) -> None:
    with Fitted(lambda parts: parts) as rig:

        def fail() -> list[FeatureSet]:
            raise RuntimeError("at the end")

        rig.pipeline.finish = fail
        rig.wait_for(lambda: rig.fed > 3)
        rig.order(Order.STOP)
        assert rig.ended() == 1
    assert caplog.text.count("the pipeline failed as it ended") == 1


# Fault 21.
@pytest.mark.parametrize("error", [InputError("recording: no such folder"), RuntimeError("can't start new thread")])
def test_a_sink_that_fails_on_entry_is_the_error_that_is_raised(error: Exception) -> None:
    entered, failing, never = Listening(), Listening(entry=error), Listening()
    rig = with_sinks(entered, failing, never)
    raised: list[BaseException] = []

    def run() -> None:
        try:
            rig.daemon.run()
        except Exception as found:  # whatever it is
            raised.append(found)

    thread = threading.Thread(target=run)
    thread.start()
    thread.join(PATIENCE_S)
    assert not thread.is_alive()
    assert raised == [error]
    assert entered.is_left and not never.is_left and rig.closed == 1
    assert rig.notes.words == []
