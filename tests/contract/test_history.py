import dataclasses

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from contract.feature_set import FeatureSet, Status
from contract.history import History
from tests.contract.sets import plain_set

OK = plain_set(1)
REFUSED = FeatureSet("uav-1", OK.session, 0, 0, Status.TURNING, OK.camera)


def at(frame: int, time_s: float, revision: int = 0, is_ok: bool = True, session: int = OK.session) -> FeatureSet:
    base = OK if is_ok else REFUSED
    stamp_ns = round(time_s * 1e9)
    return dataclasses.replace(base, frame=frame, capture_unix_ns=stamp_ns, revision=revision, session=session)


def filled(*sets: FeatureSet, max_age_s: float = 600.0, max_sets: int = 5000) -> History[FeatureSet]:
    history: History[FeatureSet] = History(max_age_s, max_sets)
    for s in sets:
        history.add(s, s)
    return history


def test_age_and_number_are_bounded() -> None:
    assert len(filled(*(at(i, i) for i in range(50)), max_sets=10)) == 10
    history = filled(*(at(i, i) for i in range(50)), max_age_s=5.0)
    assert history.frame(44) is not None and history.frame(43) is None


def test_late_sets_take_their_place_in_time() -> None:
    history = filled(at(5, 5.0), at(3, 3.0), at(4, 4.0))
    newest, near = history.newest(), history.nearest(3.4)
    assert newest.frame == 5
    assert near.frame == 3


def test_a_new_session_takes_the_place_of_the_old_at_once() -> None:
    history = filled(at(5, 5.0), at(0, 1.0, session=OK.session + 1))
    assert history.frame(5) is None and len(history) == 1 and history.session == OK.session + 1


def test_however_many_sets_of_an_earlier_session_come_they_change_nothing() -> None:
    """Five in a row used to be taken for the session that runs."""
    history = filled(*(at(i, i) for i in range(100)))
    for late in range(20):
        history.add(earlier := at(late, 1000.0 + late, session=OK.session - 50), earlier)
    newest = history.newest()
    assert len(history) == 100 and newest.frame == 99 and newest.session == OK.session


def test_an_aircraft_whose_clock_was_set_back_runs_when_that_is_known() -> None:
    """Started again without a clock battery it counts from an earlier second; who has asked it knows."""
    history = filled(*(at(i, i) for i in range(100)))
    again = [at(i, i, session=OK.session - 3600) for i in range(20)]
    for s in again[:10]:
        history.add(s, s)
    assert history.session == OK.session
    history.run(OK.session - 3600)
    assert history.session == OK.session - 3600 and len(history) == 10  # those before it was known too
    for s in again[10:]:
        history.add(s, s)
    history.add(late := at(100, 100.0), late)
    assert history.session == OK.session - 3600 and len(history) == len(again)
    history.add(made := at(0, 0.0, session=1), made, runs=True)  # as on board, where what is made is what runs
    assert history.session == 1


@st.composite
def delivered(draw: st.DrawFn) -> tuple[list[FeatureSet], int]:
    """Sets of sessions that follow each other, each packet late by some; and the number of the last session."""
    packets: list[tuple[float, FeatureSet]] = []
    sent = 0
    lengths = draw(st.lists(st.integers(1, 12), min_size=1, max_size=4))
    for session, length in enumerate(lengths, 100):
        for frame in range(length):
            delay = draw(st.floats(0.0, 3.5))
            packets.append((sent + delay, at(frame, float(frame), is_ok=draw(st.booleans()), session=session)))
            sent += 1
    return [s for _, s in sorted(packets, key=lambda pair: pair[0])], 99 + len(lengths)


@given(delivered())
def test_late_packets_of_several_sessions_leave_the_last_whole(simulated: tuple[list[FeatureSet], int]) -> None:
    packets, last = simulated
    history = filled(*packets)
    kept = {s.frame: s for s in packets if s.session == last}
    assert history.session == last and len(history) == len(kept)
    assert all(history.frame(frame) is s for frame, s in kept.items())
    assert history.newest() is max(kept.values(), key=lambda s: (s.is_ok, s.frame))


@given(st.lists(st.tuples(st.integers(1, 4), st.integers(0, 9), st.integers(0, 2)), max_size=60))
def test_in_any_order_what_is_handed_out_is_of_the_latest_session(rows: list[tuple[int, int, int]]) -> None:
    history: History[FeatureSet] = History()
    received: list[FeatureSet] = []
    for session, frame, revision in rows:
        received.append(s := at(frame, float(frame), revision, session=session))
        history.add(s, s)
        found = [item for frame in range(10) if (item := history.frame(frame)) is not None]
        assert history.session == max(h.session for h in received)
        assert {item.session for item in found} == {history.session}
        assert all(any(item is h for h in received) for item in found)


def test_what_is_stamped_later_than_can_be_is_forgotten() -> None:
    history = filled(at(0, 0.0), at(1, 1.0), at(2, 3600.0), max_age_s=5000.0)
    history.forget_after(OK.session, 60 * 10**9)
    assert [e.frame for e in history.ordered()] == [0, 1] and (newest := history.newest()) and newest.frame == 1
    history.forget_after(OK.session + 1, 0)  # of which nothing is kept


@pytest.mark.parametrize("sessions", [3, 50])
def test_memory_stays_bounded_whatever_sessions_come(sessions: int) -> None:
    history: History[FeatureSet] = History(max_sets=10)
    for session in range(sessions):
        for frame in range(30):
            history.add(s := at(frame, frame, session=session), s)
    assert len(history._sessions) <= 2 and sum(len(s.entries) for s in history._sessions.values()) <= 20


def test_a_frame_refused_at_a_later_revision_no_longer_answers() -> None:
    history = filled(at(0, 0.0), at(1, 1.0), at(1, 1.0, revision=1, is_ok=False))
    newest = history.newest()
    assert newest.frame == 0


@settings(deadline=None)
@given(st.lists(st.tuples(st.integers(0, 12), st.integers(0, 3), st.booleans()), max_size=40), st.integers(1, 6))
def test_it_holds_what_a_plain_model_holds(rows: list[tuple[int, int, bool]], max_sets: int) -> None:
    history = filled(max_sets=max_sets)
    model: dict[int, FeatureSet] = {}
    for frame, revision, is_ok in rows:
        s = at(frame, float(frame), revision, is_ok)
        history.add(s, s)
        if frame not in model or model[frame].revision <= revision:
            model[frame] = s
        model = {f: model[f] for f in sorted(model)[-max_sets:]}
    answers = [s for s in model.values() if s.is_ok]
    expected = max(answers or list(model.values()), key=lambda s: s.frame, default=None)
    assert history.newest() is expected
    assert all(history.frame(frame) is model.get(frame) for frame in range(13))
