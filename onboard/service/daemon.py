"""The daemon: begins a session, watches over it, ends it. Lifecycle, orders and messages; no work itself.

A camera or a link that fails in the field is handled by its own part. A thread that fails or hangs is not: the daemon
ends, with the reason in the log and an exit code that is not zero, and the service manager starts it again within a
second.
"""

from __future__ import annotations

import enum
import logging
import signal
import time
from collections.abc import Callable
from types import TracebackType
from typing import Protocol, Self

from contract.errors import PointclickError
from onboard.config.schema import Config
from onboard.events.source import Severity
from onboard.service.sd_notify import Notifier
from onboard.service.session import Parts, Session
from onboard.service.vehicle_state import Overall, VehicleState, is_alive, overall, severity

TICK_S = 0.25
LOOK_S = 0.05  # between two looks whether an order has come
REPORT_NS = 1_000_000_000
TEXT_NS = 3_000_000_000  # the pilot's screen is small: a state must be new for so long since the last one reported
FINISH_S = 5.0
HUNG_S = 30.0  # without a service manager's watchdog, the daemon ends itself

log = logging.getLogger("pointclick")
_LEVELS = {
    Severity.ERROR: logging.ERROR,
    Severity.WARNING: logging.WARNING,
    Severity.NOTICE: logging.INFO,
    Severity.INFO: logging.INFO,
}


class Order(enum.Enum):
    """The orders that the daemon takes."""

    STOP = enum.auto()
    RELOAD = enum.auto()


class Orders(Protocol):
    """The place that orders come from."""

    def next(self, timeout_s: float) -> Order | None:
        """Wait for an order; None if none came in time."""


class SignalOrders:
    """SIGTERM and SIGINT stop, SIGHUP reloads. Waited for, never handled in the middle of something.

    Entered before any thread is started, so that all of them leave these signals alone.
    """

    _MEANING = {signal.SIGTERM: Order.STOP, signal.SIGINT: Order.STOP, signal.SIGHUP: Order.RELOAD}  # noqa: RUF012

    def __enter__(self) -> Self:
        self._before = signal.pthread_sigmask(signal.SIG_BLOCK, self._MEANING)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        signal.pthread_sigmask(signal.SIG_SETMASK, self._before)

    def next(self, timeout_s: float) -> Order | None:
        """Wait for one of them."""
        end_s = time.monotonic() + timeout_s
        while True:
            # Only asked, without a wait: one that is over when a process that was stopped goes on, as after a suspend,
            # gives any number for a signal (CPython leaves what sigtimedwait did not fill in).
            came = signal.sigtimedwait(self._MEANING, 0.0)
            if came is not None:
                return self._MEANING[signal.Signals(came.si_signo)]
            left_s = end_s - time.monotonic()
            if left_s <= 0.0:
                return None
            time.sleep(min(left_s, LOOK_S))


class Daemon:
    """`load` reads the configuration, `open_parts` opens what it names; both raise PointclickError."""

    def __init__(
        self,
        load: Callable[[], Config],
        open_parts: Callable[[Config], Parts],
        orders: Orders,
        notifier: Notifier,
        tick_s: float = TICK_S,
    ) -> None:
        self._load, self._open_parts = load, open_parts
        self._orders, self._notifier, self._tick_s = orders, notifier, tick_s
        self._session: Session
        self._config: Config
        self._overall: Overall | None = None
        self._sent: VehicleState | None = None
        self._sent_ns = self._reported_ns = 0

    def run(self) -> int:
        """Fly until asked to stop; the exit code. Raises PointclickError if it cannot begin, and only then.

        Whatever happens after the beginning, a reload that finds no way on among it, is 1: the manager tries again.
        """
        self._begin(self._load())
        self._notifier.ready()
        while (order := self._orders.next(self._tick_s)) is not Order.STOP:
            if order is Order.RELOAD and not self._reload():
                return 1
            if not self._is_well():
                self._finish()
                return 1
            self._tick()
        log.info("asked to stop")
        self._notifier.stopping()
        return 0 if self._finish() else 1

    def _begin(self, config: Config) -> None:
        parts = self._open_parts(config)
        session = Session(config, parts)
        try:
            session.start()
        except BaseException:
            session.finish(FINISH_S)
            raise
        self._config, self._session = config, session
        self._overall, self._sent = None, None
        self._reported_ns = self._sent_ns = 0

    def _is_well(self) -> bool:
        """False, with the reason logged, if a thread has failed or hangs."""
        failure = self._session.supervisor.failure
        if failure is not None:
            name, error = failure
            if isinstance(error, PointclickError):
                log.error("the %s cannot go on: %s", name, error)
            elif error is not None:
                log.error("the %s failed", name, exc_info=error)
            else:
                log.error("the %s ended by itself", name)
            return False
        busy_s = self._session.inputs().busy_s
        if busy_s > HUNG_S:
            log.error("the pipeline has been at one event for %.0f s", busy_s)
            return False
        if hung := self._session.supervisor.hung(HUNG_S):
            log.error("the %s has not reported for %.0f s", hung, HUNG_S)
            return False
        return True

    def _tick(self) -> None:
        session, now_ns = self._session, self._session.clock.now_ns()
        inputs = session.inputs()
        self._report(overall(inputs), now_ns)
        if is_alive(inputs) and session.supervisor.is_alive:
            self._notifier.feed_watchdog()
        if now_ns - self._reported_ns >= REPORT_NS:
            self._reported_ns = now_ns
            report = session.report()
            for reporter in session.parts.reporters:
                reporter(report)

    def _report(self, state: Overall, now_ns: int) -> None:
        """The log and the service manager get each change at once, the pilot no more often than can be read."""
        if self._overall is None or state.state is not self._overall.state:
            log.log(_LEVELS[severity(state.state)], "state: %s", state)
        self._overall = state
        self._notifier.status(str(state))
        if state.state is not self._sent and now_ns - self._sent_ns >= TEXT_NS:
            self._session.parts.telemetry.send_text(severity(state.state), f"pointclick: {state}")
            self._sent, self._sent_ns = state.state, now_ns

    def _reload(self) -> bool:
        """Load the configuration again; return whether the flight continues, with the new one or with the old."""
        self._notifier.reloading()
        try:
            config = self._load()
        except PointclickError as error:
            log.error("not reloaded, the old configuration stays: %s", " ".join(str(error).split()))
        else:
            if not self._change(config):
                return False
        self._notifier.ready()
        return True

    def _change(self, config: Config) -> bool:
        """Change what can be changed in flight; all else needs a new session, with a clock and a recording of its own.

        False if there is no session any more: then a new process is the way on.
        """
        live = {"service": self._config.service.model_copy(update={"max_delay_s": config.service.max_delay_s})}
        if config == self._config.model_copy(update=live):
            self._session.event_queue.max_delay_s = config.service.max_delay_s
            self._config = config
            log.info("configuration reloaded; the session goes on")
            return True
        log.info("configuration reloaded; a new session begins")
        old = self._config
        if not self._finish():
            log.error("the old session did not end; a new one cannot begin before it has")
            return False
        try:
            self._begin(config)
        except PointclickError as error:
            log.error("the new configuration cannot be used, back to the old: %s", " ".join(str(error).split()))
        else:
            return True
        try:
            self._begin(old)
        except PointclickError as error:
            log.error("the old configuration cannot be used any more: %s", " ".join(str(error).split()))
            return False
        return True

    def _finish(self) -> bool:
        return self._session.finish(FINISH_S)
