"""Pins on disk: there before a call returns, undone and redone, shared by threads and processes, stored as given."""

import dataclasses
import json
import os
import signal
import sqlite3
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from contract.errors import InputError
from contract.feature_set import SharedErrors
from ground.formats.mark import Mark
from ground.pins.model import Category, ClickErrors, Pin, PinClick
from ground.pins.places import Places
from ground.pins.store import PinStore
from ground.pins.ties import TieRefused
from ground.pins.versions import order_of
from tests import postgres
from tests.ground.pins.flights import sightings
from tests.ground.pins.test_fusion import TARGET
from tests.ground.pins.test_ties import LANDMARK, tied

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "folder" / "pins.sqlite"


@pytest.fixture(params=["sqlite", "postgresql"])
def path(request: pytest.FixtureRequest, tmp_path: Path) -> Path | str:
    """Where a store is kept: all that holds of the one database holds of the other."""
    if request.param == "sqlite":
        return tmp_path / "folder" / "pins.sqlite"
    server: postgres.Server = request.getfixturevalue("postgresql")
    return server.database()


def typed(lat_deg: float = -35.0) -> PinClick:
    return PinClick.entered(lat_deg, 149.0, height_amsl_m=600.0, sigma_m=2.0, who="ann")


def clicked(seed: int = 1) -> PinClick:
    return sightings(np.random.default_rng(seed), np.zeros(1), TARGET[None])[0]


def test_a_pin_comes_back_as_it_was_given_from_another_opening(path: Path | str) -> None:
    name, note = "<script>alert(1)</script> =1+1 'Ünï' \U0001f525", "a\nb\0c\u202e"
    with PinStore(path) as store:
        pin = store.add([clicked()], name=name, note=note, category=Category.PERSON, who="ann", crop=b"\xff\xd8crop")
        again = store.add_click(pin.id, clicked(2), who="bob")
    with PinStore(path) as store:
        (found,) = store.pins()
        assert json.dumps(found.to_dict()) == json.dumps(again.to_dict())
        assert (found.name, found.note, found.number, found.category) == (name, note, 1, Category.PERSON)
        assert (found.who, found.modified_by) == ("ann", "bob")
        assert store.crop(found.clicks[0].id) == b"\xff\xd8crop"
        assert store.crop(found.clicks[1].id) is None
        assert store.by_number(1).id == store.pin(found.id).id == found.id


def test_filters(path: Path | str) -> None:
    with PinStore(path) as store:
        store.add([typed()], name="Red tent", category=Category.POI, who="ann")
        store.add([clicked()], name="smoke", note="by the RED barn", category=Category.FIRE, who="bob")
        numbers = [
            [pin.number for pin in found]
            for found in (
                store.pins(), store.pins(category=Category.FIRE), store.pins(text="red"), store.pins(who="ann"),
                store.pins(vehicle="uav-1"), store.pins(text="nothing"), store.pins(since_unix_ns=2**62),
            )
        ]  # fmt: skip
    assert numbers == [[1, 2], [2], [1, 2], [1], [2], [], []]


def test_everything_can_be_undone_and_redone(path: Path | str) -> None:
    with PinStore(path) as store:
        pin = store.add([typed()], name="a")
        store.edit(pin.id, name="b", category=Category.FIRE)
        store.add_click(pin.id, typed(-35.1))
        store.remove_click(pin.id, pin.clicks[0].id)
        store.delete(pin.id)
        states = [_state(store)]
        printed = []
        while (what := store.undo()) is not None:
            printed.append(what)
            states.append(_state(store))
        assert printed == [
            "pin 1 deleted", "pin 1 lost a click", "pin 1 got a click", "pin 1 edited", "pin 1 added",
        ]  # fmt: skip
        assert states == [[], [("b", 1)], [("b", 2)], [("b", 1)], [("a", 1)], []]
    with PinStore(path) as store:  # also after a restart
        redone = []
        while store.redo() is not None:
            redone.append(_state(store))
        assert redone == states[-2::-1]
        assert store.redo() is None


def _state(store: PinStore) -> list[tuple[str, int]]:
    return [(pin.name, len(pin.clicks)) for pin in store.pins()]


def test_a_click_that_is_measured_later_is_as_if_it_had_been_at_once(path: Path | str) -> None:
    with PinStore(path) as store:
        first = clicked()
        pin = store.add([first], who="ann")
        store.edit(pin.id, name="roof", who="bob")
        store.add_click(pin.id, clicked(2), who="bob")
        measured = dataclasses.replace(first, method="measured", above_ground_m=6.1, sigma_above_ground_m=0.4)
        found = store.measure(pin.id, measured)
        assert found.modified_unix_ns > store.pin(pin.id).created_unix_ns
        assert (found.modified_by, found.clicks[0].method, len(found.clicks)) == ("bob", "measured", 2)
        assert [store.undo(), store.undo(), store.undo(), store.undo()][:3] == [
            "pin 1 got a click", "pin 1 edited", "pin 1 added",
        ]  # fmt: skip
        other = dataclasses.replace(measured, above_ground_m=7.2)
        assert store.measure(pin.id, other) is not None and store.pins() == []  # also of one that is undone
        assert store.measure("none", other) is None and store.measure(pin.id, clicked(3)) is None
        while store.redo() is not None:
            assert store.pins()[0].clicks[0].above_ground_m == 7.2
        assert (store.pins()[0].name, len(store.pins()[0].clicks)) == ("roof", 2)
        store.remove_click(pin.id, first.id)
        assert store.measure(pin.id, measured) is None
        store.undo()
        assert store.pins()[0].clicks[0].above_ground_m == 6.1


def test_a_new_change_ends_redoing_and_a_number_is_not_given_twice(path: Path | str) -> None:
    with PinStore(path) as store:
        store.add([typed()], name="a")
        store.undo()
        assert store.add([typed()], name="b").number == 2
        assert store.redo() is None
        store.delete(store.by_number(2).id)
        assert store.add([typed()], name="c").number == 3


def test_undo_of_ones_own_leaves_what_another_has_changed_since(path: Path | str) -> None:
    with PinStore(path) as store:
        pin = store.add([typed()], name="a", who="ann")
        store.add([typed()], name="x", who="bob")
        assert store.undo(who="ann") == "pin 1 added"
        assert [p.name for p in store.pins()] == ["x"]
        store.redo(who="ann")
        store.edit(pin.id, name="by bob", who="bob")
        with pytest.raises(InputError, match="changed since by bob"):
            store.undo(who="ann")
        assert [p.name for p in store.pins()] == ["by bob", "x"]


def removed(store: PinStore) -> list[Pin]:
    return [pin for pin in store.everything() if pin.is_deleted]


def merge(store: PinStore, pin: Pin) -> bool:
    changed, refused = store.merge_all([pin], most=10)
    assert not refused
    return bool(changed)


def test_clearing_is_one_change(path: Path | str) -> None:
    with PinStore(path) as store:
        for _ in range(5):
            store.add([typed()])
        assert store.clear(who="ann") == 5
        assert store.pins() == [] and len(removed(store)) == 5
        store.undo()
        assert len(store.pins()) == 5


_WRITER = """
import sys
from ground.pins.model import PinClick
from ground.pins.store import PinStore
store = PinStore(sys.argv[1])
for _ in range(int(sys.argv[2])):
    pin = store.add([PinClick.entered(1.0, 2.0)], name="n" * 200, crop=b"c" * 5000)
    print(pin.number, flush=True)
"""


def _writer(path: Path | str, count: int) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", _WRITER, str(path), str(count)]
    return subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def test_what_was_answered_survives_kill_9(path: Path | str) -> None:
    PinStore(path).close()
    process = _writer(path, 100_000)
    assert process.stdout is not None
    printed = [int(process.stdout.readline()) for _ in range(40)]
    os.kill(process.pid, signal.SIGKILL)
    printed += [int(line) for line in process.communicate()[0].split() if line]
    with PinStore(path) as store:
        numbers = [pin.number for pin in store.pins()]
        assert set(printed) <= set(numbers)
        assert numbers == list(range(1, len(numbers) + 1))
        assert all(store.crop(pin.clicks[0].id) == b"c" * 5000 for pin in store.pins())
        assert store.add([typed()]).number == len(numbers) + 1


def test_several_processes_and_threads_write_at_once(path: Path | str) -> None:
    writers = [_writer(path, 20) for _ in range(2)]
    with PinStore(path) as store:
        threads = [threading.Thread(target=lambda: [store.add([typed()]) for _ in range(10)]) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        for process in writers:
            out, err = process.communicate(timeout=60)
            assert process.returncode == 0, err
            assert len(out.split()) == 20
        assert [pin.number for pin in store.pins()] == list(range(1, 81))
        seen = store.revision
        with PinStore(path) as other:
            other.edit(other.by_number(7).id, name="seven")
        assert store.revision > seen
        assert store.by_number(7).name == "seven"


def test_pins_are_in_the_order_of_their_numbers_however_they_come(path: Path | str) -> None:
    with PinStore(path) as store, PinStore(path) as other:
        pattern = store.add([typed()]).to_dict()
        for number in (40, 7, 90, 8, 91, 3):
            click = typed()
            known = {**pattern, "id": click.id, "number": number, "clicks": [click.to_dict()]}
            assert store.bring_in([Pin.from_dict(known)]) == 1
            other.edit(other.by_number(7 if number == 91 else number).id, name=f"was {number}")
            found = [pin.number for pin in store.pins()]
            assert found == sorted(found) == [pin.number for pin in other.pins()] and number in found
        assert store.add([typed()]).number == 92
        assert [pin.number for pin in store.pins()] == [1, 3, 7, 8, 40, 90, 91, 92]


def test_of_two_servers_the_last_writer_wins_on_both(path: Path | str, tmp_path: Path) -> None:
    with PinStore(path) as a, PinStore(tmp_path / "b.sqlite") as b:
        pin = a.add([clicked()], name="first", who="ann")
        mine = b.add([typed()], name="other", who="bob")
        assert merge(b, pin) and not merge(b, pin)
        assert sorted(p.number for p in b.pins()) == [1, 2]  # number 1 was given twice: the first one's it stays
        assert b.by_number(1).id == pin.id
        assert b.by_number(2).id == mine.id and b.by_number(2).was == (1,)
        # A partition: both change the pin, one of them later.
        ours, theirs = a.edit(pin.id, name="by ann", who="ann"), b.edit(pin.id, name="by bob", who="bob")
        assert theirs.modified_unix_ns > ours.modified_unix_ns
        assert not merge(b, ours) and merge(a, theirs)
        assert a.pin(pin.id).name == b.pin(pin.id).name == "by bob"
        b.delete(pin.id, who="bob")
        (gone,) = removed(b)
        assert merge(a, gone) and a.pins() == []
        changed, ((_, why),) = a.merge_all([dataclasses.replace(pin, modified_unix_ns=2**62)], most=10)
        assert changed == 0 and "ahead" in why


def exchange(stores: list[PinStore]) -> None:
    """Every server receives all pins of every other, until nothing changes any more."""
    for _ in range(50):
        received = [(to, of.everything()) for to in stores for of in stores if to is not of]
        if not sum(to.merge_all(pins, most=1000)[0] for to, pins in received):
            return
    raise AssertionError("the servers do not come to an end")


@pytest.mark.parametrize("seed", range(8))
def test_servers_that_were_apart_agree_on_every_number(tmp_path: Path, seed: int) -> None:
    """A number that one server gives to a tent and another to a hut sends a team to the wrong one of the two."""
    rng = np.random.default_rng(seed)
    stores = [PinStore(tmp_path / f"{k}.sqlite") for k in range(3)]
    made: dict[str, int] = {}  # by id, the number that was perhaps read out at once
    for _ in range(4):
        for store in stores:
            for _ in range(int(rng.integers(0, 4))):
                pin = store.add([typed()], who="ann")
                made[pin.id] = pin.number
            for pin in store.pins():
                if rng.random() < 0.3:
                    store.edit(pin.id, note=str(rng.random()))
        rng.shuffle(stores)
        exchange(stores[: int(rng.integers(2, 4))])
    exchange(stores)
    numbers = [{pin.id: pin.number for pin in store.pins()} for store in stores]
    assert numbers[0] == numbers[1] == numbers[2]
    assert len(set(numbers[0].values())) == len(made)
    for store in stores:
        for pin in store.pins():
            assert made[pin.id] in (pin.number, *pin.was) and pin.number not in pin.was
        store.close()


def test_what_two_servers_changed_apart_of_one_pin_is_all_kept(tmp_path: Path) -> None:
    """The second click of one team and the "sheep" of the other: whichever came last was all that was left."""
    with PinStore(tmp_path / "a.sqlite") as a, PinStore(tmp_path / "b.sqlite") as b:
        pin = a.add([typed()], name="figure", note="by the hut", who="ann")
        exchange([a, b])
        a.add_click(pin.id, typed(-35.1), who="ann")
        b.edit(pin.id, name="IGNORE: sheep", who="bob")
        more = b.add_click(pin.id, typed(-35.2), who="bob").clicks[-1]
        a.edit(pin.id, category=Category.PERSON, who="ann")
        exchange([a, b])
        for held in (a.pin(pin.id), b.pin(pin.id)):
            assert (held.name, held.note, held.category) == ("IGNORE: sheep", "by the hut", Category.PERSON)
            assert sorted(click.lat_deg for click in held.clicks) == [-35.2, -35.1, -35.0]
        # What is taken out stays out, also where another server changes the pin meanwhile.
        a.remove_click(pin.id, more.id, who="ann")
        b.edit(pin.id, note="at the ford", who="bob")
        exchange([a, b])
        assert all(more.id not in {click.id for click in store.pin(pin.id).clicks} for store in (a, b))
        assert a.pin(pin.id).note == b.pin(pin.id).note == "at the ford"
        # A change that is undone is a later one.
        b.undo(who="bob")
        exchange([a, b])
        assert a.pin(pin.id).note == b.pin(pin.id).note == "by the hut"


def test_a_pin_keeps_a_click_whatever_two_servers_take_out(tmp_path: Path) -> None:
    with PinStore(tmp_path / "a.sqlite") as a, PinStore(tmp_path / "b.sqlite") as b:
        pin = a.add([typed()], who="ann")
        second = a.add_click(pin.id, typed(-35.1), who="ann").clicks[1]
        exchange([a, b])
        a.remove_click(pin.id, pin.clicks[0].id, who="ann")
        b.remove_click(pin.id, second.id, who="bob")
        exchange([a, b])
        assert [click.id for click in a.pin(pin.id).clicks] == [click.id for click in b.pin(pin.id).clicks]
        assert len(a.pin(pin.id).clicks) == 1
        # Nor does undoing take out the only one.
        third = a.add_click(pin.id, typed(-35.2), who="ann").clicks[1]
        a.remove_click(pin.id, a.pin(pin.id).clicks[0].id, who="bob")
        with pytest.raises(InputError, match="changed since by bob"):
            a.undo(who="ann")
        assert [click.id for click in a.pin(pin.id).clicks] == [third.id]


@pytest.mark.parametrize("seed", range(6))
def test_servers_that_were_apart_hold_the_same_pins_and_lose_no_click(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    stores = [PinStore(tmp_path / f"{k}.sqlite") for k in range(3)]
    pins = [stores[0].add([typed()], who="ann").id for _ in range(3)]
    exchange(stores)
    added: dict[str, set[str]] = {pin: set() for pin in pins}
    taken_out, deleted = set[str](), set[str]()
    for _ in range(5):
        for who, store in enumerate(stores):
            for held in store.pins():
                kind = rng.integers(0, 6)
                if kind == 0:
                    added[held.id].add(store.add_click(held.id, typed(rng.uniform(-40, -30))).clicks[-1].id)
                elif kind == 1 and len(held.clicks) > 1:
                    taken_out.add(held.clicks[-1].id)
                    store.remove_click(held.id, held.clicks[-1].id)
                elif kind == 2:
                    store.edit(held.id, name=f"{rng.integers(100)} by {who}", who=str(who))
                elif kind == 3 and rng.random() < 0.1:
                    deleted.add(held.id)
                    store.delete(held.id)
        rng.shuffle(stores)
        exchange(stores[: int(rng.integers(2, 4))])
    exchange(stores)
    versions = [{pin.id: order_of(pin) for pin in store.everything()} for store in stores]
    assert versions[0] == versions[1] == versions[2] and len(versions[0]) == len(pins)
    for pin in stores[0].everything():
        clicks = {click.id for click in pin.clicks}
        assert clicks >= added[pin.id] - taken_out and not clicks & taken_out
        assert not pin.is_deleted or pin.id in deleted
    for store in stores:
        store.close()


def test_a_stamp_later_than_the_pin_itself_is_refused() -> None:
    """It would win over every change to come."""
    content = PinClick.entered(-35.0, 149.0)
    pin = Pin("a", 1, "", "", Category.POI, "ann", 10, 20, "ann", (content,), stamps={"name": (20, "bob")})
    assert Pin.from_dict(pin.to_dict()).stamps == {"name": (20, "bob")}
    for wrong in ({"name": [21, "bob"]}, {"name": [5]}, {"name": ["5", "bob"]}, [], {"n" * 81: [5, "bob"]}):
        with pytest.raises(InputError, match="stamps"):
            Pin.from_dict({**pin.to_dict(), "stamps": wrong})


def test_the_pin_that_was_made_first_keeps_its_number_and_the_other_states_which_it_had(path: Path | str) -> None:
    with PinStore(path) as store:
        ours = store.add([typed()], name="tent")
        theirs = dataclasses.replace(ours, id="earlier", name="hut", created_unix_ns=ours.created_unix_ns - 1)
        assert merge(store, theirs)
        moved = store.pin(ours.id)
        assert (store.by_number(1).name, moved.number, moved.was) == ("hut", 2, (1,))
        assert Mark.of_pin(moved, Places(store).place(moved)).title == "2 (was 1) tent"
        assert store.edit(moved.id, name="camp").was == (1,)  # for good
        store.undo()
        assert store.pin(moved.id).was == (1,)


def test_a_file_that_a_wrong_clock_wrote_is_taken_but_for_what_is_here(path: Path | str) -> None:
    with PinStore(path) as store:
        ours = store.add([typed()], name="ours")
        ahead = 2**62
        theirs = [dataclasses.replace(ours, id=name, name=name) for name in ("right", "wrong")]
        theirs[1] = dataclasses.replace(theirs[1], modified_unix_ns=ahead)
        over = dataclasses.replace(ours, name="theirs", modified_unix_ns=ahead)
        assert store.bring_in([*theirs, over]) == 2
        assert [pin.name for pin in store.pins()] == ["ours", "right", "wrong"]
        assert all(pin.modified_unix_ns < ahead for pin in store.pins())


def test_ties_are_kept_judged_undone(path: Path | str) -> None:
    rng = np.random.default_rng(21)
    clicks = sightings(rng, np.array([0.0, 1.0]), np.array([TARGET, LANDMARK]))
    with PinStore(path) as store:
        pin, places = store.add([clicks[0]]), Places(store)
        before = places.place(pin)
        with pytest.raises(TieRefused, match=r"\d+\.\d m"):
            store.add_tie(tied(clicks[1], LANDMARK + [90.0, 0.0, 0.0], None))
        assert store.ties() == []
        tie = store.add_tie(tied(clicks[1], LANDMARK, rng))
        after = places.place(pin)
        assert after.ce90_m < 0.9 * before.ce90_m
        assert store.undo() is not None
        assert places.place(pin).ce90_m == before.ce90_m
        store.redo()
    with PinStore(path) as store:
        assert [t.id for t in store.ties()] == [tie.id]
        assert Places(store).place(store.pins()[0]).ce90_m == after.ce90_m
        store.delete_tie(tie.id)
        assert store.ties() == []


def test_what_was_computed_is_kept_until_something_changes(path: Path | str, monkeypatch: pytest.MonkeyPatch) -> None:
    with PinStore(path) as store:
        pin, places = store.add([clicked()]), Places(store)
        first = places.place(pin)
        assert places.place(store.pins()[0]) is first
        assert places.place(store.add_click(pin.id, clicked(2))) is not first


@pytest.mark.parametrize("content", [b"no database at all" * 100, b""])
def test_a_file_of_something_else_is_reported_in_a_line(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "f"
    path.write_bytes(content)
    if not content:  # an empty file may become one
        PinStore(path).close()
        return
    with pytest.raises(InputError, match="is it a file of pins"):
        PinStore(path)
    assert path.read_bytes() == content


def test_anothers_database_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "f.sqlite"
    db = sqlite3.connect(path)
    db.execute("CREATE TABLE pins (x)")
    db.commit()
    db.close()
    with pytest.raises(InputError, match="something else"):
        PinStore(path)
    with pytest.raises(InputError, match=r"f\.sqlite"):
        PinStore(path / "below")


def test_a_damaged_document_is_reported_in_a_line(file: Path) -> None:
    with PinStore(file) as store:
        store.add([typed()])
    db = sqlite3.connect(file)
    db.execute("UPDATE pins SET doc = substr(doc, 1, 40)")
    db.commit()
    db.close()
    with PinStore(file) as store, pytest.raises(InputError, match="damaged"):
        store.pins()


@pytest.mark.parametrize(
    ("change", "printed"),
    [
        ({"id": "../../etc/passwd"}, "id"), ({"number": -1}, "number"), ({"number": True}, "number"),
        ({"name": 7}, "name"), ({"name": "n" * 201}, "201"), ({"name": "\ud800"}, "name"), ({"category": "x"}, "poi"),
        ({"clicks": [1]}, "click"), ({"clicks": None}, "clicks"), ({"created_unix_ns": 1e400}, "created"),
        ({"modified_unix_ns": 2**63}, "modified"), ({"is_deleted": 0}, "is_deleted"),
    ],
)  # fmt: skip
def test_a_pin_that_is_none_is_refused_by_its_field(change: dict[str, object], printed: str, path: Path | str) -> None:
    with PinStore(path) as store:
        pin = store.add([clicked()])
        with pytest.raises(InputError, match=printed):
            Pin.from_dict({**pin.to_dict(), **change})


@pytest.mark.parametrize(
    ("where", "value"),
    [
        (("lat_deg",), 91.0), (("lon_deg",), float("nan")), (("u_px",), "1"), (("height_amsl_m",), 1e9),
        (("covariance_enu_m2",), [[1, 2], [3, 4]]), (("covariance_enu_m2",), np.diag([1.0, 1.0, -1.0]).tolist()),
        (("errors", "arrays_f64le_base64"), "AAAA"), (("errors", "arrays_f64le_base64"), "?"),
        (("errors", "arrays_f64le_base64"), None), (("errors", "session"), -1), (("errors", "feature_noise"), 1e9),
        (("errors",), []),
    ],
)  # fmt: skip
def test_a_click_that_lies_is_refused(where: tuple[str, ...], value: object) -> None:
    content = clicked().to_dict()
    *path, last = where
    inner = content
    for name in path:
        inner = inner[name]
    inner[last] = value
    with pytest.raises(InputError):
        PinClick.from_dict(content)


@pytest.mark.parametrize(
    "change",
    [
        {"R_enu_cam": np.zeros((3, 3))}, {"offset_enu_m": np.zeros(3)}, {"common_cov": np.full((9, 9), 1e300)},
        {"common_cov": -np.eye(9)}, {"pointing_cov_m2": np.triu(np.ones((3, 3)))},
        {"common_cov": np.full((9, 9), np.nan)}, {"shared": SharedErrors(span_s=(1.0, 0.0))},
        {"shared": SharedErrors(alignment_sigma=-np.ones(4))}, {"shared": SharedErrors(np.full((9, 13), 1e9))},
    ],
)  # fmt: skip
def test_errors_that_lie_are_refused(change: dict[str, object]) -> None:
    errors = clicked().errors
    assert errors is not None
    lying = dataclasses.replace(errors, **change)
    with pytest.raises(InputError, match="errors"):
        ClickErrors.from_dict(lying.to_dict())


@pytest.mark.wall_clock
def test_ten_thousand_pins_and_a_click_stays_quick(file: Path) -> None:
    """This thread's processor time: what a change and a list of all cost with 10,000 pins there."""
    import time  # noqa: PLC0415

    one = clicked()
    with PinStore(file) as store:
        model = store.add([one])
        many = [
            dataclasses.replace(
                model, id=f"p{k}", number=k, clicks=(dataclasses.replace(PinClick.entered(1.0, 2.0), id=f"c{k}"),)
            )
            for k in range(2, 10_001)
        ]
        assert store.bring_in(many) == 9_999
        assert len(store.pins()) == 10_000
        spent_s = []
        for _ in range(5):
            begun = time.thread_time()
            store.add([one])
            assert len(store.pins()) > 10_000
            spent_s.append(time.thread_time() - begun)
        assert min(spent_s) < 0.05  # in any of them the collector of garbage may have its turn


def test_pins_of_a_file_get_free_numbers_and_the_later_of_two_with_one_id(path: Path | str) -> None:
    def of_a_file(pin_id: str, number: int, name: str, modified_ns: int = 5) -> Pin:
        click = dataclasses.replace(typed(), id=f"c{pin_id}")
        return Pin(pin_id, number, name, "", Category.POI, "ann", 5, modified_ns, "ann", (click,))

    with PinStore(path) as store:
        here = store.add([typed()], name="here")
        found = [
            of_a_file("a", 1, "taken"), of_a_file("b", 0, "none"), of_a_file("c", 7, "free"),
            of_a_file("c", 9, "later", 6), of_a_file("b", 3, "as old"),
        ]  # fmt: skip
        assert store.bring_in(found) == 3
        assert {p.name: p.number for p in store.pins()} == {"here": 1, "taken": 2, "none": 3, "later": 7}
        assert store.bring_in(found) == 0 and store.undo() == "3 pins imported"
        assert [p.id for p in store.pins()] == [here.id]
        assert store.bring_in(found[:1]) == 1 and {p.name: p.number for p in store.pins()} == {"here": 1, "taken": 2}
        with pytest.raises(InputError, match="note"):
            store.bring_in([dataclasses.replace(found[0], id="d", note="n" * 20_000)])
        assert len(store.pins()) == 2
