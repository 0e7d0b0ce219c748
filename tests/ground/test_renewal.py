"""The listener's renewal: whatever an attempt raises, the next one comes, and the listener says how it is."""

import threading
import time
from collections.abc import Callable

import pytest
import zenoh

from contract.errors import LinkError
from ground import client, presence
from ground.client import SetCache
from ground.watched_thread import WatchedThread
from tests.waiting import PATIENCE_S, eventually


class FakeSession:
    def __init__(self, close_error: Exception | None = None, listen_error: Exception | None = None) -> None:
        self.is_closed = False
        self.close_error, self.listen_error = close_error, listen_error
        self.info = self

    def routers_zid(self) -> list[object]:
        return []

    peers_zid = routers_zid

    def declare_subscriber(self, key: str, handler: Callable[[object], None]) -> object:
        if self.listen_error is not None:
            raise self.listen_error
        return object()

    def close(self) -> None:
        self.is_closed = True
        if self.close_error is not None:
            raise self.close_error


class Opener:
    """Stands in for opening a session: hands out what it was given, raises what is an error, then goes on well."""

    def __init__(self, *results: FakeSession | Exception) -> None:
        self._results = list(results)
        self.fault: Exception | None = None  # while it lasts
        self.opened: list[FakeSession] = []
        self.attempts = 0
        self.gate = threading.Event()
        self.gate.set()
        self.waiting = threading.Event()

    def __call__(self, mode: str, endpoint: str, tls: object) -> FakeSession:
        self.attempts += 1
        if not self.gate.is_set():
            self.waiting.set()
            assert self.gate.wait(PATIENCE_S)
        if self.fault is not None:
            raise self.fault
        result = self._results.pop(0) if self._results else FakeSession()
        if isinstance(result, Exception):
            raise result
        self.opened.append(result)
        return result


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client, "RENEW_S", 0.05)
    monkeypatch.setattr(client, "FIRST_RETRY_S", 0.02)
    monkeypatch.setattr(client, "RENEWAL_PERIOD_S", 0.01)


@pytest.mark.parametrize(
    "error", [LinkError("no route"), zenoh.ZError("no route"), RuntimeError("no route"), MemoryError("no route")]
)
def test_failed_attempts_do_not_end_the_renewal_and_are_reported_until_one_goes_well(
    monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    opener = Opener(FakeSession())
    monkeypatch.setattr(client, "open_link", opener)
    with SetCache("tcp/nowhere") as cache:
        assert cache.link_error == ""
        opener.fault = error
        assert eventually(lambda: "no route" in cache.link_error)
        failed = opener.attempts
        assert eventually(lambda: opener.attempts >= failed + 3)
        assert "no route" in cache.link_error
        opener.fault = None
        assert eventually(lambda: len(opener.opened) >= 2 and cache.link_error == "")
    assert all(session.is_closed for session in opener.opened)


def test_a_session_that_cannot_be_closed_or_listened_on_is_left_for_a_new_one(monkeypatch: pytest.MonkeyPatch) -> None:
    deaf = FakeSession(listen_error=zenoh.ZError("deaf"))
    opener = Opener(FakeSession(close_error=zenoh.ZError("gone")), deaf)
    monkeypatch.setattr(client, "open_link", opener)
    with SetCache("tcp/nowhere") as cache:
        assert eventually(lambda: len(opener.opened) >= 3 and cache.link_error == "")
    assert deaf.is_closed and all(session.is_closed for session in opener.opened)


def test_closing_while_a_renewal_opens_leaves_no_session_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    opener = Opener()
    monkeypatch.setattr(client, "open_link", opener)
    cache = SetCache("tcp/nowhere")
    opener.gate.clear()
    assert opener.waiting.wait(PATIENCE_S)
    closing = threading.Thread(target=cache.close)
    closing.start()
    time.sleep(0.05)
    opener.gate.set()
    closing.join(PATIENCE_S)
    assert not closing.is_alive()
    attempts = opener.attempts
    time.sleep(0.1)
    assert opener.attempts == attempts  # and nothing is opened afterwards
    assert len(opener.opened) >= 2 and all(session.is_closed for session in opener.opened)
    cache.close()


def test_a_first_attempt_that_fails_is_the_callers(monkeypatch: pytest.MonkeyPatch) -> None:
    deaf = FakeSession(listen_error=zenoh.ZError("deaf"))
    monkeypatch.setattr(client, "open_link", Opener(deaf))
    with pytest.raises(LinkError, match="deaf"):
        SetCache("tcp/nowhere")
    assert deaf.is_closed


def test_a_watched_thread_outlives_anything_and_says_so() -> None:
    raised: list[BaseException | None] = [SystemExit("out"), KeyboardInterrupt(), ValueError("two\nlines"), None]
    seen: list[str] = []
    is_there = threading.Event()

    def work() -> None:
        is_there.wait(PATIENCE_S)
        seen.append(watched.trouble if seen else "")
        error = raised.pop(0) if raised else None
        if error is not None:
            raise error

    watched = WatchedThread("a worker", work, 0.01)
    is_there.set()
    assert eventually(lambda: len(seen) > 4)
    assert seen[:5] == ["", "out", "KeyboardInterrupt", "two lines", ""] and watched.trouble == ""
    assert watched.close()


def test_a_watched_thread_that_hangs_is_reported_and_does_not_hold_up_its_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(WatchedThread, "HUNG_S", 0.05)
    release = threading.Event()
    watched = WatchedThread("a worker", lambda: release.wait(PATIENCE_S) and None, 0.01)
    assert eventually(lambda: "a worker has been at one attempt for" in watched.trouble)
    assert not watched.close(within_s=0.05)
    release.set()
    assert watched.close()


def test_a_link_with_no_one_at_its_other_end_is_named_until_there_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """`watch` waited for an aircraft at a mistyped address without a word of it."""
    monkeypatch.setattr(presence, "ALONE_S", 0.05)
    alone = FakeSession()
    monkeypatch.setattr(client, "open_link", Opener(alone, *(alone for _ in range(1000))))
    with SetCache("tcp/nowhere:1") as cache:
        assert eventually(lambda: cache.unreached == "nothing listens at tcp/nowhere:1")
        assert cache.link_error == ""
        monkeypatch.setattr(FakeSession, "peers_zid", lambda _: ["someone"])
        assert eventually(lambda: cache.unreached == "")
