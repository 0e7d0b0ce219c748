import dataclasses

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
    assert newest is not None and newest.frame == 5
    assert near is not None and near.frame == 3


def test_a_new_session_forgets_the_old() -> None:
    history = filled(at(5, 5.0), at(0, 1.0, session=9))
    assert history.frame(5) is None and len(history) == 1


def test_a_frame_refused_at_a_later_revision_no_longer_answers() -> None:
    history = filled(at(0, 0.0), at(1, 1.0), at(1, 1.0, revision=1, is_ok=False))
    newest = history.newest()
    assert newest is not None and newest.frame == 0


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
