"""The session that runs and the age of a picture: packets of yesterday, clocks that are wrong, sets stamped ahead."""

import dataclasses

import pytest

from contract.feature_set import FeatureSet
from ground.aircraft_clock import AHEAD_S, AircraftClock, Moment
from ground.last_received import LastReceived
from ground.received_sets import ReceivedSets
from tests.contract.sets import plain_set

DAY_S, HOUR_S, YEARS_S = 86_400.0, 3600.0, 30 * 31_557_600.0
NOW_UNIX_S = 1_800_000_000.0
BASE = plain_set(1)
ASIDE = "sends sets of session"


class World:
    """A ground whose two clocks go on, and what an aircraft's packets are to it. Times in s since it began."""

    def __init__(self, max_age_s: float = 600.0) -> None:
        self.sets = ReceivedSets("uav-1", max_age_s, 5000)
        self.frame = 0

    def moment(self, at_s: float) -> Moment:
        return Moment(round((5000.0 + at_s) * 1e9), round((NOW_UNIX_S + at_s) * 1e9))

    def receive(self, at_s: float, behind_s: float = 0.0, *, ago_s: float = 0.0, session_s: float = -10.0) -> str:
        """A set of a picture 0.1 s old when it was sent `ago_s` ago, of an aircraft whose clock is behind by so much.

        Its session began at `session_s`, by that clock.
        """
        self.frame += 1
        captured_s = NOW_UNIX_S + at_s - 0.02 - 0.1 - ago_s - behind_s
        s = dataclasses.replace(
            BASE, frame=self.frame, capture_unix_ns=round(captured_s * 1e9), session=session_of(behind_s, session_s)
        )
        return self.sets.take(s, 0.1, self.moment(at_s))

    def answer(self, at_s: float, behind_s: float, session_s: float = -10.0, took_s: float = 0.04) -> None:
        """The aircraft answers a question of `took_s` before: its clock showed what it shows in the middle."""
        showed_ns = round((NOW_UNIX_S + at_s - 0.5 * took_s - behind_s) * 1e9)
        asked_ns = self.moment(at_s - took_s).monotonic_ns
        self.sets.answered(session_of(behind_s, session_s), showed_ns, asked_ns, self.moment(at_s))

    def age_s(self, at_s: float) -> float:
        reply = self.sets.reply(self.moment(at_s))
        assert reply.age_s is not None
        return reply.age_s

    def newest(self) -> FeatureSet:
        found = self.sets.history.newest()
        assert found is not None
        return found


def session_of(behind_s: float, session_s: float) -> int:
    return max(int(NOW_UNIX_S + session_s - behind_s), 1)


def test_the_age_of_a_picture_of_an_aircraft_whose_clock_is_set_is_its_age() -> None:
    world = World()
    for k in range(20):
        assert world.receive(0.5 * k) == ""
    assert 0.1 <= world.age_s(9.52) <= 0.2
    assert world.sets.doubt(world.moment(9.5)) == "" and not world.sets.is_to_be_asked(world.moment(9.5))
    assert 3.1 <= world.age_s(12.5) <= 3.2


@pytest.mark.parametrize("count", [1, 5, 50])
def test_sets_of_yesterday_are_never_young(count: int) -> None:
    """Alone they are what there is, and a day old; next to today's they are left out, however many come."""
    alone = World()
    for k in range(count):
        assert alone.receive(0.5 * k, ago_s=DAY_S, session_s=-DAY_S) == ""
        assert alone.age_s(0.5 * k) > DAY_S - 1.0
    assert "stamped 24 h behind this computer's clock: they are old, or" in alone.sets.doubt(alone.moment(0.0))
    world = World()
    assert world.receive(0.0) == ""
    for k in range(count):
        assert ASIDE in world.receive(0.1 + 0.01 * k, ago_s=DAY_S, session_s=-DAY_S)
    assert world.newest().frame == 1 and world.age_s(1.0) < 1.2


def test_today_s_sets_take_the_place_of_yesterday_s_at_once() -> None:
    world = World()
    for k in range(5):
        world.receive(0.1 * k, ago_s=DAY_S, session_s=-DAY_S)
    assert world.receive(1.0) == "" and world.age_s(1.0) < 0.2


@pytest.mark.parametrize("behind_s", [YEARS_S, HOUR_S, -HOUR_S, -YEARS_S])
def test_a_clock_that_is_not_set_is_asked_for_and_then_known(behind_s: float) -> None:
    """Before that a picture may be as old as the clocks differ; after that the answer counts, and it is reported."""
    world = World()
    for k in range(3):
        assert world.receive(0.2 * k, behind_s) == ""
    assert world.age_s(0.5) == pytest.approx(abs(behind_s), abs=1.0)
    assert world.sets.is_to_be_asked(world.moment(0.5))
    assert not world.sets.is_to_be_asked(world.moment(0.6))  # once
    assert "does not answer" in world.sets.doubt(world.moment(0.6))
    world.answer(0.7, behind_s)
    assert 0.2 <= world.age_s(0.7) <= 0.45
    assert not world.sets.is_to_be_asked(world.moment(60.0))
    assert world.sets.doubt(world.moment(0.7)).startswith("the aircraft's clock is ")
    for k in range(3):
        assert world.receive(1.0 + 0.2 * k, behind_s) == ""
    assert 0.1 <= world.age_s(1.4) <= 0.2
    assert world.receive(2.0, behind_s, ago_s=HOUR_S / 10.0) == ""  # a late packet, in its place in time
    assert world.age_s(2.0) < 1.0


def test_a_replay_is_not_confirmed_by_the_answer_of_the_aircraft_that_is_there() -> None:
    """Its clock shows today: what was received before is a day old, and of a session that does not run."""
    world = World()
    for k in range(5):
        world.receive(0.1 * k, ago_s=DAY_S, session_s=-DAY_S)
    world.answer(1.0, 0.0)
    assert world.sets.reply(world.moment(1.0)) is None  # nothing of today has come
    assert world.receive(1.1) == "" and world.age_s(1.1) < 0.2
    assert ASIDE in world.receive(1.2, ago_s=DAY_S, session_s=-DAY_S)


def test_the_same_session_answered_a_day_later_makes_its_replayed_sets_a_day_old() -> None:
    world = World()
    for k in range(5):
        world.receive(0.1 * k, ago_s=DAY_S, session_s=-2.0 * DAY_S)
    world.answer(1.0, 0.0, session_s=-2.0 * DAY_S)
    assert world.age_s(1.0) == pytest.approx(DAY_S, abs=2.0)


def test_an_aircraft_that_begins_again_with_its_clock_set_back_is_received_when_it_has_answered() -> None:
    world = World()
    for k in range(10):
        world.receive(0.5 * k)
    for k in range(20):
        assert ASIDE in world.receive(30.0 + 0.5 * k, YEARS_S, session_s=29.0)
    assert world.sets.is_to_be_asked(world.moment(35.0))
    world.answer(40.0, YEARS_S, session_s=29.0)
    assert world.age_s(40.0) < 1.0 and len(world.sets.history) == 20
    assert ASIDE in world.receive(40.1, ago_s=36.0)  # a late one of before
    assert world.receive(40.2, YEARS_S, session_s=29.0) == ""
    assert world.receive(50.0, session_s=49.0) == ""  # it began again, and has the time of day


def test_a_later_session_of_a_doubtful_clock_runs_when_the_one_before_is_silent() -> None:
    """An aircraft that no one may ask, as for viewers, is shown, and as old as it may be."""
    world = World()
    world.receive(0.0)
    assert ASIDE in world.receive(5.0, -HOUR_S, session_s=4.0)
    assert world.receive(20.0, -HOUR_S, session_s=4.0) == ""
    assert world.age_s(20.0) > HOUR_S
    assert world.receive(21.0) == ""  # but one of the right time is better, though it is an earlier one
    assert world.age_s(21.0) < 0.2


@pytest.mark.parametrize("behind_s", [0.0, 1000.0, DAY_S])
@pytest.mark.parametrize("at", [0, 3])
def test_one_set_that_is_stamped_an_hour_ahead_is_left_out_and_the_others_stay(behind_s: float, at: int) -> None:
    """24 sent, 1 kept, when it emptied the history; also where it is the first."""
    world = World()
    left_out = []
    for k in range(24):
        left_out.append(world.receive(0.5 * k, behind_s, ago_s=-HOUR_S * (k == at)))
    world.answer(12.0, behind_s)
    frames = [entry.frame for entry in world.sets.history.ordered()]
    assert len(frames) >= 23 - 5 and at + 1 not in frames and world.age_s(12.0) < 1.0
    if at:
        assert [k for k, why in enumerate(left_out) if why] == [at] and len(frames) == 23
        assert "'uav-1' stamps sets more than 60 s ahead of its own clock" in left_out[at]


@pytest.mark.parametrize("ahead_s", [2.0, 5.0, 30.0, 59.0])
@pytest.mark.parametrize(
    ("behind_s", "answers_s"),
    [(0.0, []), (0.3, []), (0.0, [2.2]), (HOUR_S, [2.2]), (HOUR_S, [2.7]), (-HOUR_S, [0.1, 2.2, 2.7, 6.1])],
)
def test_one_set_up_to_a_minute_ahead_is_forgotten_and_makes_none_old(
    ahead_s: float, behind_s: float, answers_s: list[float]
) -> None:
    """One set 30 s ahead made all that followed 30 s old, and refused as stale, to the end of the session."""
    world = World()
    for k in range(24):
        for at_s in answers_s:
            if 0.5 * (k - 1) < at_s <= 0.5 * k:
                world.answer(at_s, behind_s)
        assert world.receive(0.5 * k, behind_s, ago_s=-ahead_s * (k == 5)) == ""
        if k == 5 and min(answers_s, default=0.0) < 2.5:  # a claim: what is true of the two the next set shows
            assert world.sets.is_to_be_asked(world.moment(2.5)) and world.age_s(2.5) > 0.9 * ahead_s
        if k > 5:
            assert [e.frame for e in world.sets.history.ordered()] == [f for f in range(1, k + 2) if f != 6]
            assert world.age_s(0.5 * k + 0.1) < 0.9
    assert not world.sets.is_to_be_asked(world.moment(30.0))


@pytest.mark.parametrize("behind_s", [0.0, HOUR_S])
@pytest.mark.parametrize("step_s", [1.9, 3.0, 20.0])
def test_one_set_two_seconds_ahead_goes_too_where_its_stamp_is_past_before_the_next_comes(
    behind_s: float, step_s: float
) -> None:
    """Over a thin radio sets come seconds apart: it stayed in the list, as a picture of two seconds later."""
    world = World(max_age_s=3600.0)
    world.answer(-0.1, behind_s)
    for k in range(12):
        assert world.receive(step_s * k, behind_s, ago_s=-2.0 * (k == 5)) == ""
        if k > 5:
            assert [e.frame for e in world.sets.history.ordered()] == [f for f in range(1, k + 2) if f != 6]


@pytest.mark.parametrize("ahead_s", [5.0, 30.0, 59.0])
@pytest.mark.parametrize("behind_s", [0.0, HOUR_S])
def test_two_sets_ahead_in_a_row_make_others_old_until_the_next_answer(ahead_s: float, behind_s: float) -> None:
    world = World()
    world.answer(-0.1, behind_s)
    for k in range(24):
        assert world.receive(0.5 * k, behind_s, ago_s=-ahead_s * (k in (5, 6))) == ""
        if k == 8:
            assert world.sets.is_to_be_asked(world.moment(4.0))
            world.answer(4.1, behind_s)
        if k > 8:
            assert [e.frame for e in world.sets.history.ordered()] == [f for f in range(1, k + 2) if f not in (6, 7)]
            assert world.age_s(0.5 * k + 0.1) < 0.4


@pytest.mark.parametrize("step_s", [1.0, 14.0])
@pytest.mark.parametrize("late_s", [0.0, 0.3, 3.0])
@pytest.mark.parametrize("answers", [[], [10], [10, 11, 25], list(range(40))])
def test_of_sets_that_are_sent_faster_than_taken_none_is_dropped(
    step_s: float, late_s: float, answers: list[int]
) -> None:
    """A flight played in fast motion: its clock leaps from set to set, and does not go back.

    Its answers state what it showed when it was asked, two sets before. Every third set is late, and holds the others.
    """
    world, at_s = World(), 0.0
    for k in range(40):
        sent_s = 0.05 * k
        at_s = max(at_s, sent_s + (late_s if k % 3 == 0 else 0.0))
        showed_s = NOW_UNIX_S - YEARS_S + sent_s + step_s * k
        s = dataclasses.replace(BASE, frame=k, capture_unix_ns=round((showed_s - 0.1) * 1e9), session=1)
        assert world.sets.take(s, 0.1, world.moment(at_s)) == ""
        if k in answers:
            showed_ns = round((showed_s - 2 * (step_s + 0.05)) * 1e9)
            world.sets.answered(1, showed_ns, world.moment(sent_s - 0.1).monotonic_ns, world.moment(at_s))
        assert [e.frame for e in world.sets.history.ordered()] == list(range(k + 1))
    assert world.newest().frame == 39
    world.sets.answered(1, round((showed_s + 8.0) * 1e9), world.moment(9.9).monotonic_ns, world.moment(10.0))
    assert len(world.sets.history) == 40 and world.age_s(10.0) == pytest.approx(8.1, abs=0.2)


def test_a_false_stamp_that_happens_to_be_right_by_the_ground_s_clock_is_found_out_by_asking() -> None:
    """An aircraft an hour behind, and one set an hour ahead of that: what it contradicts goes on."""
    world = World()
    for k in range(24):
        world.receive(0.5 * k, HOUR_S, ago_s=-HOUR_S * (k == 3))
    assert world.sets.is_to_be_asked(world.moment(12.0))
    world.answer(12.1, HOUR_S)
    for k in range(24, 30):
        assert world.receive(0.5 * k + 1.0, HOUR_S) == ""
    assert world.newest().frame == 30 and world.age_s(15.6) < 0.3


def test_ages_that_a_sender_states_wrongly_do_not_make_a_picture_younger() -> None:
    world = World()
    world.receive(0.0)
    late = dataclasses.replace(world.newest(), frame=9, capture_unix_ns=world.newest().capture_unix_ns - 30 * 10**9)
    assert world.sets.take(late, 0.0, world.moment(0.5)) == ""
    assert world.sets.age_s(late.capture_unix_ns, world.moment(0.5)) == pytest.approx(30.6, abs=0.2)
    assert "ahead" in world.sets.take(dataclasses.replace(late, frame=10), 2 * HOUR_S, world.moment(0.6))
    assert world.age_s(0.6) < 0.9


def test_a_clock_never_makes_a_picture_younger_than_it_can_be() -> None:
    """Sets that come faster than the first ones mean a later clock; those that come slower change nothing."""
    clock, world = AircraftClock(), World()
    stamp_ns = world.moment(0.0).unix_ns
    assert clock.received(stamp_ns, world.moment(0.3))
    assert clock.received(stamp_ns + 10**9, world.moment(1.1))
    assert clock.received(stamp_ns + 2 * 10**9, world.moment(12.0))
    assert clock.age_s(stamp_ns + 2 * 10**9, world.moment(12.0)) == pytest.approx(10.0, abs=0.01)
    assert not clock.received(stamp_ns + round((13.0 + AHEAD_S) * 1e9), world.moment(12.0))


def test_invented_names_take_the_place_of_none_that_goes_on_sending() -> None:
    held = LastReceived(lambda name: name, 10)
    for k in range(500):
        held.of("uav-1")
        held.of(f"invented {k}")
        assert len(held.values()) <= 10 and "uav-1" in held
    assert held.get("invented 0") is None and held.get("invented 499") == "invented 499"


AT_ONCE = "two aircraft call themselves 'uav-1'"


def test_two_aircraft_of_one_name_are_known_from_one_that_began_again() -> None:
    """Both have the default name: the one that began first was left out as an earlier session, without a word."""
    world = World()
    words_of = [
        world.receive(k + 0.25 * which, session_s=(-500.0, -100.0)[which]) for k in range(20) for which in (0, 1)
    ]
    assert any(AT_ONCE in words for words in words_of[20:])
    assert not any(AT_ONCE in words for words in words_of[:8])  # a set of the session before may have been under way
    again = World()
    for k in range(20):
        assert again.receive(float(k), session_s=-500.0) == ""
    late = [again.receive(25.0 + k, session_s=24.0) for k in range(20)]
    late += [again.receive(45.0 + k, ago_s=30.0, session_s=-500.0) for k in range(5)]  # what a link held back
    assert not any(AT_ONCE in words for words in late) and ASIDE in late[-1]
