"""Publisher and client over real zenoh sessions on the loopback interface."""

import dataclasses
import json
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import zenoh

from contract.answer import Fix, Refusal
from contract.errors import LinkError
from contract.feature_set import FeatureSet, Status
from contract.link_config import link_config
from contract.supervised_thread import ThreadState
from contract.wire.codec import decode, encode
from ground.__main__ import main
from ground.client import SetCache, ask
from onboard.events.types import Frame
from onboard.link.publisher import Publisher, Rate
from onboard.link.reply import MOST_PATIENCE_S
from onboard.link.socket_backlog import Backlog
from tests.contract.sets import plain_set
from tests.onboard.link.asking import asked
from tests.onboard.link.ports import free_endpoint
from tests.waiting import PATIENCE_S, eventually

START_NS = 1_700_000_000_000_000_000
BASE = plain_set(100)
WIDE = Rate(max_bit_rate=1e8, max_rate_hz=30.0)  # tests of what is said, not of how much


def a_set(frame: int, revision: int = 0, status: Status = Status.OK, vehicle: str = "uav-1") -> FeatureSet:
    stamp_ns = START_NS + frame * 10**9
    if status is Status.OK:
        return dataclasses.replace(BASE, frame=frame, revision=revision, capture_unix_ns=stamp_ns, vehicle=vehicle)
    return FeatureSet(vehicle, BASE.session, frame, stamp_ns, status, BASE.camera, revision)


@pytest.fixture
def endpoint() -> str:
    return free_endpoint()


@pytest.fixture
def publisher(endpoint: str) -> Iterator[Publisher]:
    with Publisher("uav-1", [endpoint], rate=WIDE) as opened:
        yield opened


def got(answers: dict[str, FeatureSet | Refusal], vehicle: str = "uav-1") -> FeatureSet:
    answer = answers[vehicle]
    assert isinstance(answer, FeatureSet), answer
    return answer


def refused(answers: dict[str, FeatureSet | Refusal], vehicle: str = "uav-1") -> Status:
    answer = answers[vehicle]
    assert isinstance(answer, Refusal), answer
    return answer.status


def test_a_query_without_parameters_gets_the_newest_set_that_answers(publisher: Publisher, endpoint: str) -> None:
    assert refused(asked(endpoint)) is Status.STARTING
    publisher.publish(a_set(0, status=Status.LOW_PARALLAX))
    assert got(asked(endpoint)).status is Status.LOW_PARALLAX
    publisher.publish(a_set(1))
    publisher.publish(a_set(2))
    publisher.publish(a_set(3, status=Status.TURNING))
    newest = got(asked(endpoint, "uav-1"))
    assert newest.frame == 2 and encode(newest) == encode(a_set(2))


def test_a_query_for_a_frame_or_a_time_gets_that_set(publisher: Publisher, endpoint: str) -> None:
    for frame in range(5):
        publisher.publish(a_set(frame))
    publisher.publish(a_set(5, status=Status.TURNING))
    assert got(asked(endpoint, frame=1)).frame == 1
    assert got(asked(endpoint, frame=5)).status is Status.TURNING
    assert refused(asked(endpoint, frame=99)) is Status.UNKNOWN_FRAME
    assert got(asked(endpoint, unix_s=START_NS / 1e9 + 2.4)).frame == 2
    assert refused(asked(endpoint, unix_s=START_NS / 1e9 + 5.6)) is Status.UNKNOWN_FRAME


def test_a_picture_whose_set_is_being_made_is_answered_when_it_is_there(
    publisher: Publisher, endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    publisher.publish(a_set(0))
    for frame in (1, 2, 3):
        publisher.event(START_NS + frame * 10**9, Frame(START_NS + frame * 10**9, frame, None))
    monkeypatch.setattr("ground.client.PICTURE_TIMEOUT_S", MOST_PATIENCE_S)
    with ThreadPoolExecutor() as pool:
        by_number = pool.submit(ask, endpoint, frame=1)
        by_time = pool.submit(ask, endpoint, unix_s=START_NS / 1e9 + 2.1)
        assert eventually(lambda: len(publisher._parked) == 2)
        publisher.publish(a_set(3))
        assert refused(asked(endpoint, frame=99)) is Status.UNKNOWN_FRAME  # never taken: nothing to wait for
        assert not by_number.done() and not by_time.done()
        publisher.publish(a_set(2, status=Status.TURNING))
        publisher.publish(a_set(1))
        assert got(by_number.result(PATIENCE_S)).frame == 1
        assert got(by_time.result(PATIENCE_S)).status is Status.TURNING


def test_a_picture_that_gets_no_set_while_its_ground_waits_is_refused_with_the_reason(
    publisher: Publisher, endpoint: str
) -> None:
    publisher.event(START_NS, Frame(START_NS, 4, None))
    with zenoh.open(zenoh.Config.from_json5(link_config("client", connect=[endpoint]))) as session:
        refusals: list[dict[str, str]] = []
        took_s: list[float] = []

        def is_refused() -> bool:
            """Asked again where the refusal found no time to go."""
            began_s = time.monotonic()
            replies = list(session.get("pc/uav-1/features?frame=4;wait=1.5", timeout=10.0))
            took_s.append(time.monotonic() - began_s)
            refusals.extend(json.loads(reply.err.payload.to_bytes()) for reply in replies if reply.err)
            return bool(refusals)

        assert eventually(is_refused)
    (printed,) = refusals
    assert (printed["status"], printed["state"]) == ("unknown_frame", "placing pictures") and "picture 4" in printed[
        "reason"
    ]
    assert 0.9 <= took_s[-1] < 10.0  # said while it was waited for, and not before most of that time


def test_a_later_revision_replaces_the_earlier_and_not_the_other_way(publisher: Publisher, endpoint: str) -> None:
    publisher.publish(a_set(0, revision=0))
    publisher.publish(a_set(0, revision=2))
    publisher.publish(a_set(0, revision=1))
    assert got(asked(endpoint, frame=0)).revision == 2


@pytest.mark.parametrize(
    "parameters",
    ["frame=x", "frame=-1", "frame=" + "9" * 5000, "frame=", "time=nan", "time=x", "time=1e400", "frame=²"],
)
def test_a_senseless_query_is_refused_and_the_next_one_answered(
    publisher: Publisher, endpoint: str, parameters: str
) -> None:
    publisher.publish(a_set(0))
    config = {"mode": "client", "connect": {"endpoints": [endpoint]}}
    printed: list[str] = []

    def is_refused() -> bool:
        replies = list(session.get(f"pc/uav-1/features?{parameters}", timeout=5.0))
        printed[:] = [json.loads(r.err.payload.to_bytes())["status"] for r in replies if r.err]
        return bool(printed)

    with zenoh.open(zenoh.Config.from_json5(json.dumps(config))) as session:
        assert eventually(is_refused)
    assert printed == ["unknown_frame"]
    assert got(asked(endpoint)).frame == 0


def test_a_subscriber_caches_sets_by_vehicle_frame_and_time(publisher: Publisher, endpoint: str) -> None:
    with SetCache(endpoint) as cache:
        assert cache.newest("uav-1") is None

        def received() -> bool:  # the first sets are sent before the subscription is known
            publisher.publish(a_set(0))
            return cache.vehicles == ["uav-1"]

        assert eventually(received)

        def complete() -> bool:  # a set may be dropped where the machine is busy: the link never holds up the aircraft
            for frame, revision in ((1, 1), (2, 4), (3, 0)):  # older pictures only go out again when revised
                publisher.publish(a_set(frame, revision))
            return all(cache.by_frame("uav-1", frame) is not None for frame in range(1, 4))

        assert eventually(complete)
        newest, two, timed = (
            cache.newest("uav-1"),
            cache.by_frame("uav-1", 2),
            cache.by_time("uav-1", START_NS / 1e9 + 1.1),
        )
        assert newest.frame == 3
        assert eventually(lambda: (s := cache.by_frame("uav-1", 2)) is not None and s.revision == 4)
        assert two is not None and timed.frame == 1
        assert cache.locator(newest) is cache.locator(newest)
        assert isinstance(cache.locator(newest).locate((320.0, 240.0)), Fix)
        assert cache.by_frame("nobody", 1) is None and cache.dropped.unreadable == 0


def test_garbage_on_the_key_is_counted_and_does_no_harm(endpoint: str) -> None:
    """From a faulty aircraft: a Publisher lets no one else publish through it (test_access.py)."""
    with SetCache(endpoint) as cache, zenoh_peer(endpoint) as session:

        def spoilt() -> bool:
            session.put("pc/uav-1/features", b"PC\x40 nonsense")
            session.put("pc/uav-1/features", encode(a_set(0)))
            return cache.dropped.unreadable > 0 and cache.newest("uav-1") is not None

        assert eventually(spoilt)
        assert "bytes" in str(cache.dropped.last_error)


def zenoh_peer(endpoint: str, mode: str = "peer") -> zenoh.Session:
    return zenoh.open(zenoh.Config.from_json5(link_config(mode, listen=[endpoint])))


def test_a_subscriber_may_come_first_and_the_aircraft_later(endpoint: str) -> None:
    with SetCache(endpoint) as cache, Publisher("uav-1", [endpoint]) as publisher:

        def received() -> bool:
            publisher.publish(a_set(0))
            return cache.newest("uav-1") is not None

        assert eventually(received)


def test_a_port_in_use_is_named(endpoint: str) -> None:
    port = int(endpoint.rsplit(":", maxsplit=1)[-1])
    with socket.socket() as holder:
        holder.bind(("127.0.0.1", port))
        holder.listen()
        with pytest.raises(LinkError, match=f"{endpoint}: the port is already in use"):
            Publisher("uav-1", [endpoint])


def test_an_impossible_endpoint_and_vehicle_are_named(endpoint: str) -> None:
    with pytest.raises(LinkError, match="carrier pigeon"):
        Publisher("uav-1", ["carrier pigeon"])
    with pytest.raises(ValueError, match="uav/1"):
        Publisher("uav/1", [endpoint])


@pytest.mark.parametrize("works", range(5))
def test_a_declaration_that_fails_leaves_no_session_and_is_one_error(
    endpoint: str, monkeypatch: pytest.MonkeyPatch, works: int
) -> None:
    """Of three publishers and two queryables the first so many can be declared."""

    class Session:
        declared, is_closed = 0, False

        def declare(self, *_: object, **__: object) -> object:
            if self.declared == works:
                raise zenoh.ZError("out of memory at /zenoh/src/net/routing/mod.rs:11")
            self.declared += 1
            return object()

        declare_publisher = declare_queryable = declare

        def close(self) -> None:
            self.is_closed = True

    session = Session()
    monkeypatch.setattr(zenoh, "open", lambda _: session)
    with pytest.raises(LinkError, match="cannot publish as 'uav-1': out of memory; try again"):
        Publisher("uav-1", [endpoint])
    assert session.is_closed


def test_no_one_there_and_no_one_answering_are_distinguished(publisher: Publisher, endpoint: str) -> None:
    with pytest.raises(LinkError, match="nothing listens"):
        ask(free_endpoint())
    with pytest.raises(LinkError, match="'uav-9' does not answer"):
        ask(endpoint, "uav-9")


def test_a_listener_that_says_nothing_is_given_up() -> None:
    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))
        silent.listen()
        began = time.monotonic()
        with pytest.raises(LinkError, match="nothing listens"):
            ask(f"tcp/127.0.0.1:{silent.getsockname()[1]}")
        assert time.monotonic() - began < PATIENCE_S  # and not when it likes; after two seconds where nothing else runs


def test_another_vehicles_set_is_not_published(publisher: Publisher) -> None:
    with pytest.raises(ValueError, match="uav-2"):
        publisher.publish(a_set(0, vehicle="uav-2"))


def test_two_vehicles_at_one_endpoint_must_be_distinguished(endpoint: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Both connect to a router on the ground."""
    with (
        zenoh_peer(endpoint, "router"),
        Publisher("uav-1", (), [endpoint]) as one,
        Publisher("uav-2", (), [endpoint]) as two,
    ):
        one.publish(a_set(0))
        two.publish(a_set(4, vehicle="uav-2"))

        def both() -> bool:
            try:
                return len(ask(endpoint)) == 2
            except LinkError:
                return False

        assert eventually(both)

        def click(*options: str) -> tuple[int, str, str]:
            code = main(["click", "320", "240", "--connect", endpoint, *options])
            return code, *capsys.readouterr()

        assert eventually(
            lambda: (printed := click())[0] == 2 and ": uav-1, uav-2; choose one with --vehicle" in printed[2]
        )
        options = ["--vehicle", "uav-2", "--max-age", "inf", "--format", "json"]
        assert eventually(lambda: (printed := click(*options))[0] == 0 and json.loads(printed[1])["frame"] == 4)


def test_the_age_of_the_newest_picture_grows_while_only_old_ones_come(publisher: Publisher, endpoint: str) -> None:
    with SetCache(endpoint) as cache:
        assert cache.age_s("uav-1") is None
        begun_at = time.monotonic()
        publisher.publish(a_set(5))
        assert eventually(lambda: cache.newest("uav-1") is not None)  # sent again after 2 s if no one received it
        time.sleep(0.5)
        publisher.publish(a_set(4, revision=1))
        assert eventually(lambda: cache.by_frame("uav-1", 4) is not None)
        age_s = cache.age_s("uav-1")
        assert 0.4 <= age_s <= time.monotonic() - begun_at + 0.5
        renewed_at = time.monotonic()
        publisher.publish(a_set(500))  # its stamp is further ahead than the waits took: its way is the fastest known
        assert eventually(lambda: cache.by_frame("uav-1", 500) is not None)
        age_s = cache.age_s("uav-1")
        assert age_s <= time.monotonic() - renewed_at + 0.3


def test_a_live_click_in_its_own_process_answers_and_refuses(publisher: Publisher, endpoint: str) -> None:
    publisher.publish(a_set(7))

    def click(*arguments: str) -> tuple[int, str, str]:
        command = [sys.executable, "-m", "ground", "click", "320", "240", "--connect", endpoint, *arguments]
        done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=Path(__file__).parents[3])
        return done.returncode, done.stdout, done.stderr

    def answer(expected: int, *arguments: str) -> dict[str, object]:
        """Asked again where the link took too long: a loaded machine's may."""
        printed: list[tuple[int, str, str]] = []
        assert eventually(lambda: printed.append(click(*arguments, "--format", "json")) or printed[-1][0] != 2)
        assert printed[-1][0] == expected, printed[-1]
        return json.loads(printed[-1][1])

    first = answer(0, "--max-age", "inf")
    assert (first["frame"], first["vehicle"]) == (7, decode(encode(a_set(7))).vehicle)
    unknown = answer(3, "--frame", "8")
    assert (unknown["status"], unknown["frame"]) == ("unknown_frame", 8)
    code, out, err = click("--file", "x.png")
    assert (code, out) == (2, "") and "--frame or --time" in err


@pytest.mark.parametrize("error", [OSError(24, "Too many open files"), RuntimeError("a bug")])
def test_an_error_in_the_links_thread_costs_a_moment_and_not_the_link(
    publisher: Publisher, endpoint: str, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    assert publisher.thread.report().state is ThreadState.RUNNING
    send, left = Publisher._send_one, [2]

    def fail(self: Publisher) -> float:
        left[0] -= 1
        if left[0] >= 0:
            raise error
        return send(self)

    monkeypatch.setattr(Publisher, "_send_one", fail)
    assert eventually(lambda: publisher.thread.report().restarts == 2)
    publisher.publish(a_set(3))
    assert got(asked(endpoint)).frame == 3
    report = publisher.thread.report()
    assert (report.state, report.restarts) == (ThreadState.RUNNING, 2) and str(error) in report.last_error


def test_sets_go_out_where_it_cannot_be_known_what_is_under_way(
    publisher: Publisher, endpoint: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Without a free descriptor the process cannot look at its sockets."""

    def fail(self: Backlog, peers: object) -> int:
        raise OSError(24, "Too many open files")

    monkeypatch.setattr(Backlog, "unacknowledged", fail)
    with SetCache(endpoint) as cache:

        def received() -> bool:
            publisher.publish(a_set(0))
            return cache.newest("uav-1") is not None

        assert eventually(received)
    assert publisher.thread.report().restarts == 0
    assert caplog.text.count("Too many open files") == 1
