"""What may go out on the link and which set goes: the cap, the shares, freshness. No clock, no link."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.link.byte_budget import BURST_S, CONNECT_BYTES, PACKET_BYTES, Budget, Kind
from onboard.link.set_selection import Offer, Selection

SECOND_NS = 1_000_000_000
START_NS = 1_700_000_000 * SECOND_NS


def an_offer(frame: int, at_s: float, revision: int = 0, is_ok: bool = True, is_keyframe: bool = False) -> Offer[str]:
    return Offer(1, frame, revision, START_NS + round(at_s * 1e9), is_ok, is_keyframe, f"{frame}.{revision}")


@dataclass
class Sent:
    at_s: float
    kind: Kind
    wire_bytes: float
    offer: Offer[str] | None = None


def run(
    budget: Budget,
    offers: list[tuple[float, Offer[str]]],
    duration_s: float,
    set_bytes: int = 600,
    status_bytes: int = 0,
    replies_hz: float = 0.0,
) -> list[Sent]:
    """The publisher's loop without its thread: sets come as given, a status a second, replies as often as asked."""
    selection: Selection[str] = Selection()
    sent: list[Sent] = []
    waiting = sorted(offers, key=lambda pair: pair[0])
    status_due, replies_due, step_s = 0.0, 0.0, 0.02
    for tick in range(round(duration_s / step_s)):
        now_s = tick * step_s
        while waiting and waiting[0][0] <= now_s:
            selection.offer(waiting.pop(0)[1])
        budget.waits(Kind.SET, set_bytes if selection.waiting else None, now_s)
        budget.waits(Kind.STATUS, status_bytes if status_bytes and now_s >= status_due else None, now_s)
        budget.waits(Kind.REPLY, set_bytes if replies_hz and now_s >= replies_due else None, now_s)
        if status_bytes and now_s >= status_due and budget.send(Kind.STATUS, status_bytes, now_s):
            sent.append(Sent(now_s, Kind.STATUS, budget.cost(Kind.STATUS, status_bytes)))
            status_due = now_s + 1.0
        if replies_hz and now_s >= replies_due and budget.send(Kind.REPLY, set_bytes, now_s):
            sent.append(Sent(now_s, Kind.REPLY, budget.cost(Kind.REPLY, set_bytes)))
            replies_due = now_s + 1.0 / replies_hz
        chosen = selection.next(now_s)
        if chosen is not None and budget.send(Kind.SET, set_bytes, now_s):
            selection.sent(chosen, now_s)
            sent.append(Sent(now_s, Kind.SET, budget.cost(Kind.SET, set_bytes), chosen))
    return sent


def flight(duration_s: float, rate_hz: float = 30.0, revised_after_s: float = 3.0) -> list[tuple[float, Offer[str]]]:
    """Every picture at once, and again when the window has seen past it; every tenth is a keyframe."""
    offers: list[tuple[float, Offer[str]]] = []
    for frame in range(round(duration_s * rate_hz)):
        at_s = frame / rate_hz
        key = frame % 10 == 0
        offers.append((at_s + 0.05, an_offer(frame, at_s, is_keyframe=key)))
        offers.append((at_s + revised_after_s, an_offer(frame, at_s, 1, is_keyframe=key)))
    return offers


def sets(sent: list[Sent]) -> list[tuple[float, Offer[str]]]:
    return [(s.at_s, s.offer) for s in sent if s.offer is not None]


@settings(deadline=None, max_examples=25)
@given(
    max_bit_rate=st.floats(4000.0, 500_000.0),
    set_bytes=st.integers(60, 1250),
    status_bytes=st.sampled_from([0, 250, 300]),
    replies_hz=st.sampled_from([0.0, 1.0, 10.0]),
    rate_hz=st.sampled_from([1.0, 10.0, 30.0]),
    grounds=st.integers(1, 3),
    window_s=st.floats(0.1, 8.0),
)
def test_no_window_of_time_carries_more_than_the_cap_and_one_burst(
    max_bit_rate: float,
    set_bytes: int,
    status_bytes: int,
    replies_hz: float,
    rate_hz: float,
    grounds: int,
    window_s: float,
) -> None:
    budget = Budget(max_bit_rate, 0.2, 30.0, 0.0)
    budget.connected(grounds, 0.0)
    sent = run(budget, flight(10.0, rate_hz), 10.0, set_bytes, status_bytes, replies_hz)
    burst = max(PACKET_BYTES, BURST_S * max_bit_rate / 8.0, *(s.wire_bytes for s in sent))
    for first in range(len(sent)):
        began_s = sent[first].at_s
        carried = sum(s.wire_bytes for s in itertools.takewhile(lambda s: s.at_s <= began_s + window_s, sent[first:]))  # noqa: B023
        assert carried <= window_s * max_bit_rate / 8.0 + burst + 1e-6
    assert sent or grounds > 1  # the handshakes of two more may take ten seconds of the slowest link


@settings(deadline=None, max_examples=10)
@given(
    max_bit_rate=st.floats(8000.0, 200_000.0),
    set_bytes=st.integers(60, 1250),
    min_rate_hz=st.floats(0.1, 1.0),
    replies_hz=st.sampled_from([0.0, 10.0, 50.0]),
)
def test_sets_come_at_least_at_the_least_rate_where_the_budget_allows_it(
    max_bit_rate: float, set_bytes: int, min_rate_hz: float, replies_hz: float
) -> None:
    budget = Budget(max_bit_rate, min_rate_hz, 5.0, 0.0)
    took = [at for at, _ in sets(run(budget, flight(20.0, 10.0), 20.0, set_bytes, 300, replies_hz))]
    gaps = [later - earlier for earlier, later in itertools.pairwise([0.0, *took, 20.0])]
    # At half the budget (the rest is background at worst), or one packet late because others went just before.
    affordable_s = budget.cost(Kind.SET, set_bytes) / (0.5 * budget.bytes_per_s)
    late_s = 2.0 * PACKET_BYTES / (0.5 * budget.bytes_per_s)
    assert max(gaps) <= max(1.0 / min_rate_hz, affordable_s) + late_s + 0.1


def test_the_usual_link_carries_the_greatest_rate_and_a_slow_one_less() -> None:
    usual = sets(run(Budget(32000.0, 0.2, 5.0, 0.0), flight(20.0), 20.0, 600, 300))
    assert 85 <= len(usual) <= 101
    slow = sets(run(Budget(8000.0, 0.2, 5.0, 0.0), flight(20.0), 20.0, 600, 300))
    assert 12 <= len(slow) <= 26


def test_replies_do_not_silence_sets_and_are_not_silenced_by_them() -> None:
    sent = run(Budget(16000.0, 0.2, 30.0, 0.0), flight(20.0), 20.0, 600, 300, 30.0)
    kinds = {kind: sum(s.kind is kind for s in sent) for kind in Kind}
    assert kinds[Kind.SET] >= 15 and kinds[Kind.REPLY] >= 10 and kinds[Kind.STATUS] >= 15


def test_the_ground_is_never_without_the_newest_picture_for_long() -> None:
    sent = sets(run(Budget(32000.0, 0.2, 5.0, 0.0), flight(20.0), 20.0))
    newest_ns, late_s = 0, []
    times = iter(sent)
    upcoming = next(times, None)
    for tick in range(100, 2000):
        now_s = tick / 100.0
        while upcoming is not None and upcoming[0] <= now_s:
            newest_ns = max(newest_ns, upcoming[1].capture_unix_ns)
            upcoming = next(times, None)
        late_s.append(now_s - (newest_ns - START_NS) / 1e9)
    assert max(late_s) < 0.7


def test_revisions_of_keyframes_go_first_and_lie_evenly_in_time() -> None:
    sent = sets(run(Budget(32000.0, 0.2, 5.0, 0.0), flight(20.0), 20.0))
    revised = [offer for _, offer in sent if offer.revision]
    keyframes = [offer for offer in revised if offer.is_keyframe]
    assert len(revised) >= 35 and len(keyframes) >= 0.9 * len(revised)
    times = sorted(offer.capture_unix_ns for offer in keyframes)
    gaps_s = [(later - earlier) / 1e9 for earlier, later in itertools.pairwise(times)]
    assert max(gaps_s) <= 2.0  # keyframes lie 0.33 s apart, every second one goes


def test_with_nothing_new_the_newest_is_said_again_every_two_seconds() -> None:
    sent = sets(run(Budget(32000.0, 0.2, 5.0, 0.0), [(0.0, an_offer(7, 0.0))], 21.0))
    assert {offer.frame for _, offer in sent} == {7}
    assert 10 <= len(sent) <= 11


def test_before_the_first_set_nothing_is_sent() -> None:
    assert run(Budget(32000.0, 0.2, 5.0, 0.0), [], 5.0) == []


def test_a_refusal_gives_way_to_an_answer_unless_that_is_old() -> None:
    selection: Selection[str] = Selection()
    selection.offer(an_offer(0, 0.0))
    selection.offer(an_offer(1, 0.5, is_ok=False))
    chosen = selection.next(0.6)
    assert chosen is not None and chosen.frame == 0
    selection.offer(an_offer(2, 3.0, is_ok=False))
    chosen = selection.next(3.0)
    assert chosen is not None and chosen.frame == 2
    selection.sent(chosen, 3.0)
    chosen = selection.next(3.0)
    assert chosen is not None and chosen.frame == 0


def test_a_picture_placed_late_is_still_the_newest_that_answers() -> None:
    selection: Selection[str] = Selection()
    for frame in range(5):
        selection.offer(an_offer(frame, frame / 10.0, is_ok=False))
    for frame in range(5):
        selection.offer(an_offer(frame, frame / 10.0, 1))
    chosen = selection.next(1.0)
    assert chosen is not None and (chosen.frame, chosen.revision) == (4, 1)
    selection.sent(chosen, 1.0)
    assert [selection.next(1.1).frame] == [0]  # type: ignore[union-attr]  farthest from what was sent


def test_a_later_revision_replaces_the_earlier_while_both_wait() -> None:
    selection: Selection[str] = Selection()
    selection.offer(an_offer(0, 0.0))
    selection.offer(an_offer(0, 0.0, 2))
    selection.offer(an_offer(0, 0.0, 1))
    chosen = selection.next(0.0)
    assert chosen is not None and chosen.revision == 2
    selection.sent(chosen, 0.0)
    again = selection.next(0.1)
    assert again is None or again.revision == 1


def test_a_new_session_puts_the_old_ones_sets_away() -> None:
    selection: Selection[str] = Selection()
    selection.offer(an_offer(50, 5.0))
    selection.offer(Offer(2, 0, 0, START_NS, True, False, "new"))
    chosen = selection.next(0.0)
    assert chosen is not None and chosen.item == "new"


@settings(deadline=None, max_examples=100)
@given(st.lists(st.tuples(st.integers(0, 300), st.integers(0, 3), st.booleans(), st.booleans()), max_size=150))
def test_any_order_of_offers_is_survived_and_memory_stays_bounded(
    offers: list[tuple[int, int, bool, bool]],
) -> None:
    selection: Selection[str] = Selection()
    now_s = 0.0
    for count, (frame, revision, is_ok, is_keyframe) in enumerate(offers):
        now_s += 0.03
        selection.offer(an_offer(frame, frame / 30.0, revision, is_ok, is_keyframe))
        if count % 3 == 0 and (chosen := selection.next(now_s)) is not None:
            selection.sent(chosen, now_s)
    for _ in range(len(offers) + 2):
        now_s += 0.1
        if (chosen := selection.next(now_s)) is not None:
            selection.sent(chosen, now_s)
    assert not selection.waiting


def test_a_second_ground_halves_the_rate_and_its_handshake_is_paid_for() -> None:
    one, two = Budget(8000.0, 0.2, 5.0, 0.0), Budget(8000.0, 0.2, 5.0, 0.0)
    two.connected(2, 0.0)
    assert 1500 / 1000 >= two.wait_s(Kind.SET, 1000, 0.0) >= (CONNECT_BYTES + 1000 - 1500) / 1000
    alone, shared = (len(sets(run(budget, flight(30.0), 30.0))) for budget in (one, two))
    assert 0.3 * alone <= shared <= 0.6 * alone


@pytest.mark.parametrize("kind", list(Kind))
def test_time_that_stands_still_or_runs_backwards_earns_nothing(kind: Kind) -> None:
    budget = Budget(8000.0, 0.2, 30.0, 100.0)
    sent = sum(budget.send(kind, 600, 100.0 - i) for i in range(50))
    assert sent <= 3
