"""Threads that are watched: what each policy makes of a failure, and when a thread counts as late."""

import logging
import threading
from collections.abc import Callable

import pytest

from contract.supervised_thread import LONGEST_PAUSE_S, Policy, SupervisedThread, ThreadState
from tests.waiting import PATIENCE_S, eventually


class Time:
    """A clock, and an event to stop by, on which waiting takes no time: each wait moves the clock on."""

    def __init__(self) -> None:
        self.s = 100.0
        self.waits_s: list[float | None] = []
        self.is_over = False

    def now_s(self) -> float:
        return self.s

    def set(self) -> None:
        self.is_over = True

    def is_set(self) -> bool:
        return self.is_over

    def wait(self, timeout: float | None = None) -> bool:
        self.waits_s.append(timeout)
        self.s += timeout or 0.0
        return self.is_over


def run(work: Callable[[SupervisedThread], None], policy: Policy, clock: Time) -> SupervisedThread:
    thread = SupervisedThread("worker", work, policy, stop=clock, monotonic_s=clock.now_s)
    thread.start()
    assert thread.join(PATIENCE_S)
    return thread


def failing(times: int, clock: Time, after_s: float = 0.0) -> Callable[[SupervisedThread], None]:
    """Fails so often, each time after so long, and then ends as asked."""
    left = [times]

    def work(thread: SupervisedThread) -> None:
        clock.s += after_s
        left[0] -= 1
        if left[0] >= 0:
            raise OSError(5, "Input/output error")
        clock.set()

    return work


def test_a_thread_that_fails_is_begun_again_after_pauses_that_grow_to_a_bound(caplog: pytest.LogCaptureFixture) -> None:
    clock = Time()
    thread = run(failing(9, clock), Policy.RESTART, clock)
    assert clock.waits_s == [0.5, 1.0, 2.0, 4.0, 8.0, 16.0, LONGEST_PAUSE_S, LONGEST_PAUSE_S, LONGEST_PAUSE_S]
    report = thread.report()
    assert (report.state, report.restarts, report.heartbeat_age_s) == (ThreadState.ENDED, 9, None)
    assert "Input/output error" in report.last_error and "\n" not in report.last_error
    assert report.is_well
    traces = [record for record in caplog.records if record.exc_info]
    assert len(caplog.records) == 9 and len(traces) == 1  # the trace once, a line for each


def test_a_failure_after_a_good_while_is_a_new_one() -> None:
    clock = Time()
    run(failing(3, clock, after_s=LONGEST_PAUSE_S + 1.0), Policy.RESTART, clock)
    assert clock.waits_s == [0.5, 0.5, 0.5]


def test_a_thread_asked_to_end_while_it_waits_for_its_restart_ends() -> None:
    thread = SupervisedThread("worker", _fail, Policy.RESTART)
    thread.start()
    assert eventually(lambda: thread.report().state is ThreadState.RESTARTING)
    thread.end()
    assert thread.join(PATIENCE_S)
    assert thread.report().state is ThreadState.ENDED


def _fail(_: SupervisedThread) -> None:
    raise RuntimeError("a bug")


@pytest.mark.parametrize(("policy", "lines"), [(Policy.DEGRADE, 1), (Policy.END, 0)])  # the daemon reports the latter
def test_other_policies_leave_it_failed(policy: Policy, lines: int, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    thread = run(_fail, policy, Time())
    report = thread.report()
    assert (report.state, report.restarts, report.last_error) == (ThreadState.FAILED, 0, "RuntimeError: a bug")
    assert thread.has_failed and isinstance(thread.error, RuntimeError) and not report.is_well
    assert len(caplog.records) == lines


@pytest.mark.parametrize("policy", Policy)
def test_ending_unasked_is_a_failure_and_ending_as_asked_is_none(policy: Policy) -> None:
    clock = Time()
    if policy is Policy.RESTART:
        thread = run(lambda _: clock.set() if clock.waits_s else None, policy, clock)
        assert thread.report().restarts == 1
    else:
        thread = run(lambda _: None, policy, clock)
        assert (thread.has_failed, thread.error, thread.report().last_error) == (True, None, "ended by itself")
    asked = Time()
    assert run(lambda _: asked.set(), policy, asked).report().state is ThreadState.ENDED


class Steps:
    """Lets a thread of work stand still where the test wants to look at it."""

    def __init__(self) -> None:
        self.reached, self.go_on = threading.Semaphore(0), threading.Semaphore(0)

    def stand(self) -> None:
        self.reached.release()
        assert self.go_on.acquire(timeout=PATIENCE_S)

    def next(self) -> None:
        assert self.reached.acquire(timeout=PATIENCE_S)


def test_a_thread_is_late_without_heartbeats_and_not_while_it_waits_for_its_end() -> None:
    clock, steps, stop = Time(), Steps(), threading.Event()

    def work(thread: SupervisedThread) -> None:
        steps.stand()  # hangs
        thread.is_set()  # asks whether to end: a sign of life
        steps.stand()
        thread.wait()

    thread = SupervisedThread("worker", work, Policy.END, late_after_s=3.0, stop=stop, monotonic_s=clock.now_s)
    assert thread.report().state is ThreadState.NOT_STARTED and thread.join(0.0)  # never started: nothing to wait for
    thread.start()
    steps.next()
    clock.s += 2.9
    assert thread.report().state is ThreadState.RUNNING
    clock.s += 0.2
    report = thread.report()
    assert (report.state, thread.is_late, report.is_well) == (ThreadState.LATE, True, False)
    assert report.heartbeat_age_s == pytest.approx(3.1)
    steps.go_on.release()
    steps.next()
    assert thread.report().state is ThreadState.RUNNING and thread.report().heartbeat_age_s == 0.0
    steps.go_on.release()
    clock.s += 1000.0
    assert eventually(lambda: not thread.is_late)  # once it has come to `wait`
    assert thread.report().state is ThreadState.RUNNING
    stop.set()
    assert thread.join(PATIENCE_S)


def test_a_thread_without_a_heartbeat_is_never_late() -> None:
    clock, steps = Time(), Steps()
    thread = SupervisedThread(
        "worker", lambda _: steps.stand(), Policy.DEGRADE, late_after_s=None, monotonic_s=clock.now_s
    )
    thread.start()
    steps.next()
    clock.s += 1e6
    assert (thread.report().state, thread.report().heartbeat_age_s) == (ThreadState.RUNNING, None)
    thread.end()
    steps.go_on.release()
    assert thread.join(PATIENCE_S)
