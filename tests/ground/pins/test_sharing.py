"""Pins shared by ground servers over real zenoh sessions on loopback: partitions, chains, liars, ten thousand."""

import dataclasses
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st

from contract.errors import InputError, LinkError
from contract.link_config import MAX_MESSAGE_BYTES, Tls, link_config
from ground.pins import sharing_messages as messages
from ground.pins.model import Category, Pin, PinClick, new_pin
from ground.pins.sharing import PinSharing, share_pins
from ground.pins.store import PinStore
from onboard.link.certificates import make_credentials
from tests.ground.pins.test_store import clicked
from tests.onboard.link.ports import free_endpoint
from tests.waiting import eventually

ROOT = Path(__file__).resolve().parents[3]
NOW_NS = 1_700_000_000_000_000_000
LIAR = "0123456789abcdef"


class Clock:
    def __init__(self) -> None:
        self.now_ns = NOW_NS

    def __call__(self) -> int:
        return self.now_ns

    def at(self, seconds: float) -> None:
        self.now_ns = NOW_NS + round(seconds * 1e9)


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def ann(tmp_path: Path, clock: Clock) -> Iterator[PinStore]:
    with PinStore(tmp_path / "ann.sqlite", now_ns=clock) as store:
        yield store


@pytest.fixture
def bob(tmp_path: Path, clock: Clock) -> Iterator[PinStore]:
    with PinStore(tmp_path / "bob.sqlite", now_ns=clock) as store:
        yield store


def typed(lat_deg: float = -35.0) -> PinClick:
    return PinClick.entered(lat_deg, 149.0, sigma_m=2.0, who="ann", clicked_unix_ns=NOW_NS)


def many(count: int) -> list[Pin]:
    return [new_pin(i + 1, (typed(),), f"pin {i}", "", Category.POI, "ann", NOW_NS + i) for i in range(count)]


def content(store: PinStore) -> dict[str, str]:
    """All of a store but the numbers, which are each store's own."""
    return {p.id: json.dumps(dataclasses.replace(p, number=0).to_dict()) for p in store.everything()}


def same(*stores: PinStore) -> bool:
    return eventually(lambda: all(content(store) == content(stores[0]) for store in stores[1:]))


def test_what_one_server_adds_edits_and_deletes_the_other_has_too(ann: PinStore, bob: PinStore) -> None:
    endpoint = free_endpoint()
    with PinSharing(ann, listen=[endpoint]) as first, PinSharing(bob, connect=[endpoint]) as second:
        pin = ann.add([clicked()], name="tent", category=Category.PERSON, who="ann")
        assert eventually(lambda: len(bob.pins()) == 1) and same(ann, bob)
        (received,) = bob.pins()
        assert received.clicks[0].errors is not None  # fused and tied as where it was clicked
        np.testing.assert_array_equal(received.clicks[0].errors.common_cov, pin.clicks[0].errors.common_cov)
        bob.edit(pin.id, who="bob", name="red tent")
        bob.add_click(pin.id, clicked(2), who="bob")
        assert eventually(lambda: len(ann.pin(pin.id).clicks) == 2) and ann.pin(pin.id).name == "red tent"
        ann.delete(pin.id, who="ann")
        assert eventually(lambda: not bob.pins()) and same(ann, bob)
        with pytest.raises(InputError, match="changed since by ann"):
            bob.undo(who="bob")
        assert eventually(lambda: first.state.same == second.state.same == 1)
        assert second.state.taken >= 2 and second.state.refused == second.state.unreadable == 0


def test_after_a_partition_both_have_the_same_winner_and_deletions_survive(
    ann: PinStore, bob: PinStore, clock: Clock
) -> None:
    endpoint = free_endpoint()
    with PinSharing(ann, listen=[endpoint]):
        with PinSharing(bob, connect=[endpoint]):
            names = ["later by bob", "later by ann", "at once", "deleted later", "deleted first", "gone here"]
            pins = {name: ann.add([typed()], name=name, who="ann") for name in names}
            assert eventually(lambda: len(bob.pins()) == len(names))
        # Parted: each changes what the other changes too.
        for by, store, seconds in (("ann", ann, 10.0), ("bob", bob, 20.0)):
            clock.at(seconds)
            store.edit(pins["later by bob"].id, who=by, note=f"by {by}")
            clock.at(100.0 - seconds)
            store.edit(pins["later by ann"].id, who=by, note=f"by {by}")
            clock.at(50.0)
            store.edit(pins["at once"].id, who=by, note=f"by {by}")
            store.add([typed()], name=f"new by {by}", who=by)
        clock.at(30.0)
        ann.edit(pins["deleted later"].id, who="ann", note="?")
        bob.delete(pins["deleted first"].id, who="bob")
        bob.delete(pins["gone here"].id, who="bob")
        clock.at(40.0)
        bob.delete(pins["deleted later"].id, who="bob")
        ann.edit(pins["deleted first"].id, who="ann", note="still there")
        clock.at(200.0)
        with PinSharing(bob, connect=[endpoint]) as again:
            assert same(ann, bob)
            for store in (ann, bob):
                notes = {p.name: p.note for p in store.pins()}
                assert notes == {
                    "later by bob": "by bob",
                    "later by ann": "by ann",
                    "at once": "by bob",  # by name, where the times are the same
                    "deleted first": "still there",
                    "new by ann": "",
                    "new by bob": "",
                }
                assert {p.name for p in store.everything() if p.is_deleted} == {"deleted later", "gone here"}
                assert len({p.number for p in store.everything()}) == 8  # each number once
            assert eventually(lambda: again.state.same == 1)


def test_servers_that_are_not_connected_hear_each_other_through_a_third(
    ann: PinStore, bob: PinStore, tmp_path: Path, clock: Clock
) -> None:
    first, second = free_endpoint(), free_endpoint()
    with (
        PinStore(tmp_path / "cyd.sqlite", now_ns=clock) as cyd,
        PinSharing(ann, connect=[first]),
        PinSharing(bob, listen=[first], connect=[second]),
        PinSharing(cyd, listen=[second]),
    ):
        pin = ann.add([typed()], name="from ann", who="ann")
        assert same(ann, bob, cyd) and len(cyd.pins()) == 1
        cyd.delete(pin.id, who="cyd")
        assert eventually(lambda: not ann.pins())


@pytest.mark.long
def test_ten_thousand_pins_are_caught_up_and_then_nothing_more_is_asked(
    ann: PinStore, bob: PinStore, clock: Clock
) -> None:
    ann.bring_in(many(10_000), who="ann")
    clock.at(1.0)  # of two that were made at one time either may keep the number
    bob.add([typed()], name="bob's own", who="bob")
    endpoint = free_endpoint()
    began_s = time.process_time()
    with PinSharing(ann, listen=[endpoint]) as first, PinSharing(bob, connect=[endpoint]) as second:
        assert eventually(lambda: len(bob.everything()) == 10_001 == len(ann.everything()), within_s=240.0)
        spent_s = time.process_time() - began_s
        assert spent_s < 60.0  # of a processor; measured 5 s
        assert eventually(lambda: first.state.same == second.state.same == 1)
        assert 10_000 <= second.state.taken <= 10_010 and second.state.refused == 0  # and its own with another number
        (own,) = (p for p in bob.pins() if p.name == "bob's own")
        assert own.was == (1,) and own.number == ann.pin(own.id).number
        revision = ann.revision
        ann.edit(many_first(ann).id, who="ann", note="changed")
        assert eventually(lambda: bob.pin(many_first(ann).id).note == "changed")
        assert ann.revision == revision + 1  # and nothing comes back
    assert {p.name for p in ann.pins()} == {p.name for p in bob.pins()}


def many_first(store: PinStore) -> Pin:
    return next(p for p in store.pins() if p.name == "pin 0")


def test_a_change_that_is_lost_on_its_way_is_asked_for(
    ann: PinStore, bob: PinStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever is said one by one is lost here: only digests and answers are left."""
    monkeypatch.setattr("ground.pins.sharing.PUSHED", 0)
    endpoint = free_endpoint()
    with PinSharing(ann, listen=[endpoint]), PinSharing(bob, connect=[endpoint]) as second:
        assert eventually(lambda: second.state.servers == 1)
        ann.add([typed()], name="one", who="ann")
        bob.add([typed()], name="two", who="bob")
        assert same(ann, bob) and len(ann.pins()) == 2


def hostile_pins() -> list[bytes]:
    good = many(1)[0].to_dict()
    click = good["clicks"][0]
    wrong: list[object] = [
        {**good, "modified_unix_ns": NOW_NS + 10**17},  # three years ahead
        {**good, "modified_unix_ns": 2**70},
        {**good, "modified_unix_ns": -1},
        {**good, "modified_unix_ns": "now"},
        {**good, "id": "../../etc/passwd"},
        {**good, "id": ""},
        {**good, "name": "x" * 10_000},
        {**good, "name": {"$gt": ""}},
        {**good, "number": 10**400},
        {**good, "is_deleted": "no"},
        {**good, "clicks": [click] * 5000},
        {**good, "clicks": [{**click, "lat_deg": 1e308}]},
        {**good, "clicks": [{**click, "lat_deg": float("nan")}]},
        {**good, "clicks": [{**click, "covariance_enu_m2": [[10**400] * 3] * 3}]},
        {**good, "clicks": [{**click, "covariance_enu_m2": [[-1.0, 0, 0], [0, 1, 0], [0, 0, 1]]}]},
        {**good, "category": "<script>"},
        [], None, 7, "pin", {},
    ]  # fmt: skip
    texts = [json.dumps(w).encode() for w in wrong]
    return [*texts, b"", b"\xff\xfe", b"{", b"[" * 100_000, b'{"a":' * 50_000, json.dumps("\ud800").encode()]


def test_whatever_others_send_is_refused_counted_and_does_no_harm(ann: PinStore, bob: PinStore) -> None:
    endpoint = free_endpoint()
    ann.add([typed()], name="mine", who="ann")
    config = zenoh.Config.from_json5(link_config("peer", connect=[endpoint]))
    with PinSharing(ann, listen=[endpoint]) as sharing, zenoh.open(config) as liar:

        def is_refused(kind: str, payloads: list[bytes]) -> bool:
            """Said again until all have been counted: the link may drop what it has no room for."""
            before = sharing.state.refused + sharing.state.unreadable

            def printed() -> bool:
                for payload in payloads:
                    liar.put(f"pc/pins/{LIAR}/{kind}", payload)
                time.sleep(0.2)
                return sharing.state.refused + sharing.state.unreadable >= before + len(payloads)

            return eventually(printed)

        assert is_refused("changed", hostile_pins())
        beat = json.loads(messages.announcement_to_bytes(messages.Announcement(LIAR, 1, 5, NOW_NS)))
        lies = [{**beat, "v": 99}, {**beat, "server": "f" * 16}, {**beat, "digest": 5}, {**beat, "pins": -1}, [], 3]
        assert is_refused("said", [*(json.dumps(lie).encode() for lie in lies), b"\0" * 400, b"x" * 100_000])
        assert [p.name for p in ann.everything()] == ["mine"] and not sharing.state.trouble
        # A server that promises pins and answers nonsense, when it is asked.
        answered: list[str] = []

        def answer(query: zenoh.Query) -> None:
            with query:
                kind = str(query.key_expr).rpartition("/")[2]
                answered.append(kind)
                if kind == "summary":
                    query.reply(query.key_expr, next(messages.summaries({f"p{k}": b"8 bytes." for k in range(250)})))
                else:
                    for payload in hostile_pins():
                        query.reply(query.key_expr, payload)

        liar.declare_queryable(f"pc/pins/{LIAR}/*", answer)
        # Questions to us that are none.
        for payload in (b"", b"x" * 100_000, b"\n" * 500, b"../x"):
            replies = list(liar.get(f"pc/pins/{sharing.server}/pins", payload=payload, timeout=5.0))
            assert all(reply.ok is None for reply in replies)

        def asked() -> bool:
            liar.put(f"pc/pins/{LIAR}/said", json.dumps(beat).encode())
            time.sleep(0.2)
            return answered.count("pins") >= 3

        assert eventually(asked)
        # More names than there is room for: invented servers.
        for number in range(300):
            name = f"{number:016x}"
            liar.put(f"pc/pins/{name}/said", messages.announcement_to_bytes(messages.Announcement(name, 1, 5, NOW_NS)))
        assert [p.name for p in ann.everything()] == ["mine"] and sharing.state.servers <= 64
        # And all the while it serves who is honest.
        with PinSharing(bob, connect=[endpoint]):
            assert same(ann, bob) and len(bob.pins()) == 1
            bob.add([typed()], name="bob's", who="bob")
            assert eventually(lambda: len(ann.pins()) == 2)


def test_a_message_larger_than_any_of_ours_does_not_get_through(ann: PinStore) -> None:
    endpoint = free_endpoint()
    config = json.loads(link_config("peer", connect=[endpoint]))
    config["transport"]["shared_memory"] = {"enabled": False}
    with PinSharing(ann, listen=[endpoint]) as sharing, zenoh.open(zenoh.Config.from_json5(json.dumps(config))) as liar:
        assert eventually(lambda: bool(sharing._session.info.transports()))

        def counted(size: int) -> bool:
            liar.put(f"pc/pins/{LIAR}/changed", os.urandom(size))
            time.sleep(0.1)
            return sharing.state.unreadable > 0

        assert not any(counted(MAX_MESSAGE_BYTES + 500_000) for _ in range(3))
        assert eventually(lambda: counted(messages.MAX_PIN_BYTES + 1000))


def test_more_pins_than_are_taken_are_refused_and_those_that_are_here_go_on(tmp_path: Path, clock: Clock) -> None:
    with PinStore(tmp_path / "full.sqlite", now_ns=clock) as store:
        pins = many(30)
        assert store.merge_all(pins[:10], 20) == (10, [])
        changed, refused = store.merge_all(pins, 20)
        assert changed == 10 and len(refused) == 10 and "20 pins already" in refused[0][1]
        clock.at(60.0)
        later = dataclasses.replace(pins[0], note="later", modified_unix_ns=clock())
        far = dataclasses.replace(pins[1], modified_unix_ns=clock() + 10**15)
        revision = store.revision
        changed, refused = store.merge_all([later, far, *pins[:5]], 20)
        assert changed == 1 and [pin.id for pin, _ in refused] == [far.id] and "ahead" in refused[0][1]
        assert store.pin(later.id).note == "later" and store.revision == revision + 1
        assert store.merge_all(pins[:5], 20) == (0, []) and store.revision == revision + 1


@given(st.binary(max_size=300), st.recursive(st.none() | st.integers() | st.text(max_size=5), st.lists, max_leaves=20))
def test_reading_messages_raises_nothing_but_input_errors(junk: bytes, value: object) -> None:
    good = many(1)[0].to_dict()
    spoilt = json.dumps({**good, list(good)[len(junk) % len(good)]: value}).encode()
    for payload in (junk, spoilt, json.dumps(value).encode()):
        for read in (messages.pin_from_bytes, messages.announcement_from_bytes, messages.asked_from_bytes):
            try:
                read(payload)
            except InputError:
                continue
        try:
            list(messages.summary_from_bytes(payload))
        except InputError:
            continue
    with pytest.raises(InputError):
        messages.server_of(repr(junk))


def test_messages_come_back_as_they_were() -> None:
    pins = many(5)
    assert [messages.pin_from_bytes(messages.pin_to_bytes(p)).to_dict() for p in pins] == [p.to_dict() for p in pins]
    printed = messages.Announcement(LIAR, 12, 2**64 - 1, NOW_NS)
    assert messages.announcement_from_bytes(messages.announcement_to_bytes(printed)) == printed
    assert messages.server_of(f"pc/pins/{LIAR}/said") == (LIAR, "said")
    versions = {p.id: messages.version_of(p) for p in many(2000)}
    parts = list(messages.summaries(versions))
    assert len(parts) > 2 and max(map(len, parts)) < messages.SUMMARY_BYTES + 100
    assert dict(entry for part in parts for entry in messages.summary_from_bytes(part)) == versions
    assert list(messages.summaries({})) == [b""]
    assert messages.asked_from_bytes(messages.asked_to_bytes(["a", "b-2"])) == ["a", "b-2"]
    one, *rest = pins
    assert messages.version_of(dataclasses.replace(one, number=9)) == messages.version_of(one)
    others = (dataclasses.replace(one, note="x"), dataclasses.replace(one, is_deleted=True), rest[0])
    assert all(messages.version_of(other) != messages.version_of(one) for other in others)
    with pytest.raises(InputError, match="at most"):
        messages.pin_to_bytes(dataclasses.replace(one, clicks=tuple([clicked()] * 400)))


def test_a_port_in_use_is_reported_and_without_endpoints_nothing_is_shared(ann: PinStore, bob: PinStore) -> None:
    endpoint = free_endpoint()
    assert share_pins(ann) is None
    first = share_pins(ann, listen=[endpoint])
    assert first is not None
    with first, pytest.raises(LinkError, match="cannot share pins"):
        share_pins(bob, listen=[endpoint])


def test_with_certificates_only_who_has_one_can_change_pins(ann: PinStore, bob: PinStore, tmp_path: Path) -> None:
    make_credentials(tmp_path / "keys", ["post"], ["bob"], ["127.0.0.1"], 1.0)
    endpoint = free_endpoint().replace("tcp/", "tls/")
    post, operator = (Tls.in_folder(tmp_path / "keys" / name) for name in ("post", "bob"))
    with PinSharing(ann, listen=[endpoint], tls=post) as first:
        ann.add([typed()], name="secret", who="ann")
        with PinStore(tmp_path / "eve.sqlite") as eve:
            eve.add([typed()], name="eve's", who="eve")
            with (
                PinSharing(eve, connect=[endpoint.replace("tls/", "tcp/")]) as stranger,
                PinSharing(bob, connect=[endpoint], tls=operator),
            ):
                assert same(ann, bob) and len(bob.pins()) == 1
                assert [p.name for p in eve.pins()] == ["eve's"] and stranger.state.servers == 0
                assert first.state.servers == 1


def test_the_command_shares_a_file_that_other_commands_change(ann: PinStore, clock: Clock, tmp_path: Path) -> None:
    clock.now_ns = time.time_ns()  # as the command's own
    endpoint, file = free_endpoint(), str(tmp_path / "bob.sqlite")
    command = [sys.executable, "-m", "ground", "pins"]
    with PinSharing(ann, listen=[endpoint]):
        ann.add([typed()], name="from ann", who="ann")
        sharing = subprocess.Popen(
            # As a script's background has it: SIGINT ignored from the start.
            ["sh", "-c", "trap '' INT; exec \"$@\"", "sh", *command, "share", "--connect", endpoint, "--pins", file],
            cwd=ROOT,
            stdout=subprocess.PIPE,
            text=True,
        )
        with PinStore(file) as bob:
            try:
                assert eventually(lambda: [p.name for p in bob.pins()] == ["from ann"])
                bob.add([typed()], name="from bob", who="bob")
                assert eventually(lambda: len(ann.pins()) == 2)
            finally:
                sharing.send_signal(signal.SIGINT)
                out, _ = sharing.communicate(timeout=60.0)
    assert sharing.returncode == 0 and "1 other servers" in out
    lonely = subprocess.run([*command, "share", "--pins", file], cwd=ROOT, capture_output=True, text=True, check=False)
    assert lonely.returncode == 2 and "--listen" in lonely.stderr and len(lonely.stderr.splitlines()) == 1
