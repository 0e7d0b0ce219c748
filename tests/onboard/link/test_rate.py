"""What may go out on the link and which set goes: the cap, the shares, freshness. No clock, no link."""

import itertools
import random
from functools import partial

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from contract.topics import STATUS
from onboard.link.byte_budget import BURST_S, CONNECT_BYTES, OLDER_SHARE, PACKET_BYTES, USES, Budget, Kind
from onboard.link.set_selection import Offer, Selection
from tests.onboard.link.virtual import START_NS, Delivered, Radio, an_offer, flight, heaviest, run, sets
from tests.rest_long import rest_long


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
    assert heaviest(sent, window_s) <= window_s * max_bit_rate / 8.0 + burst + 1e-6
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
    usual = run(Budget(32000.0, 0.2, 5.0, 0.0), flight(20.0), 20.0, 600, 300)
    assert 85 <= sum(s.kind is Kind.SET for s in usual) <= 101
    slow = sets(run(Budget(8000.0, 0.2, 5.0, 0.0), flight(20.0), 20.0, 600, 300))
    assert 12 <= len(slow) <= 26


@pytest.mark.parametrize(
    ("camera_hz", "bit_rate", "reached", "revised", "p95_s"),
    [
        (5.0, 32_000.0, (0.99, 1.0), (0.15, 0.35), 0.1),  # the defaults
        (5.0, 64_000.0, (0.99, 1.0), (0.40, 0.55), 0.1),
        (2.0, 32_000.0, (0.99, 1.0), (0.95, 1.0), 0.1),
    ],
)
def test_the_newest_pictures_set_goes_at_once_and_the_rest_as_the_rate_allows(
    camera_hz: float, bit_rate: float, reached: tuple[float, float], revised: tuple[float, float], p95_s: float
) -> None:
    """While new pictures and revisions took turns, of 5 a second at 32 kbit/s 74 % came, those in up to 3.3 s."""
    offers = flight(60.0, camera_hz)
    found = Delivered.of(offers, run(Budget(bit_rate, 0.2, 5.0, 0.0), offers, 60.0, 480, 300), 44.0)
    assert reached[0] <= found.reached <= reached[1]
    assert revised[0] <= found.revised <= revised[1]
    assert found.wait_s(0.5) <= 0.1 and found.wait_s(0.95) <= p95_s


def test_of_a_faster_camera_the_newest_go_at_once_at_the_greatest_rate_and_others_besides() -> None:
    offers = flight(60.0, 10.0)
    sent = run(Budget(32000.0, 0.2, 5.0, 0.0), offers, 60.0, 480, 300)
    newest = Delivered.of(offers, [s for s in sent if s.kind is Kind.SET], 44.0)
    assert 0.48 <= newest.reached <= 0.51 and newest.wait_s(0.95) <= 0.1
    assert 0.54 <= Delivered.of(offers, sent, 44.0).reached <= 0.65


def test_sets_that_are_made_unevenly_reach_the_ground_all_the_same() -> None:
    """Telemetry and solves hold some back by a quarter of a second."""
    offers = flight(60.0, 5.0, made_s=partial(random.Random(3).uniform, 0.05, 0.3))
    found = Delivered.of(offers, run(Budget(32000.0, 0.2, 5.0, 0.0), offers, 60.0, 480, 300), 44.0)
    assert found.reached >= 0.98 and 0.15 <= found.revised <= 0.35
    assert found.wait_s(0.5) <= 0.1 and found.wait_s(0.95) <= 0.5


@pytest.mark.parametrize("bit_rate", [8_000.0, 16_000.0])
def test_where_new_pictures_take_all_older_ones_still_get_their_share(bit_rate: float) -> None:
    sent = run(Budget(bit_rate, 0.2, 5.0, 0.0), flight(120.0, 10.0), 120.0, 480, 300)
    older = sum(s.wire_bytes for s in sent if s.kind is Kind.OLDER) / 120.0
    assert 0.3 * OLDER_SHARE <= older / (bit_rate / 8.0) <= 1.2 * OLDER_SHARE


@settings(deadline=None, max_examples=25)
@given(
    max_bit_rate=st.floats(8000.0, 500_000.0),
    max_rate_hz=st.floats(0.2, 30.0),
    rate_hz=st.sampled_from([1.0, 10.0, 30.0]),
    window_s=st.floats(0.1, 8.0),
)
def test_no_window_of_time_has_more_new_sets_than_the_greatest_rate_nor_half_as_many_older_ones(
    max_bit_rate: float, max_rate_hz: float, rate_hz: float, window_s: float
) -> None:
    sent = run(Budget(max_bit_rate, 0.2, max_rate_hz, 0.0), flight(10.0, rate_hz), 10.0, 480, 300)
    for kind, most in ((Kind.SET, window_s * max_rate_hz + 2.0), (Kind.OLDER, 0.5 * window_s * max_rate_hz + 1.0)):
        times = [s.at_s for s in sent if s.kind is kind]
        assert all(sum(began <= at <= began + window_s for at in times) <= most + 1e-6 for began in times)


def test_replies_do_not_silence_sets_and_are_not_silenced_by_them() -> None:
    sent = run(Budget(16000.0, 0.2, 30.0, 0.0), flight(20.0), 20.0, 600, 300, 30.0)
    kinds = {kind: sum(s.kind is kind for s in sent) for kind in USES}
    assert kinds[Kind.SET] >= 15 and kinds[Kind.REPLY] >= 10 and kinds[STATUS] >= 15


@pytest.mark.parametrize("max_bit_rate", [4000.0, 32_000.0])
@pytest.mark.parametrize("grounds", [1, 3])
def test_a_message_larger_than_a_burst_goes_once_the_bucket_is_full_whatever_the_background(
    max_bit_rate: float, grounds: int
) -> None:
    # The daemon's own report is such a message: `pc-onboard status` said "not running" of one that ran.
    budget = Budget(max_bit_rate, 0.2, 5.0, 0.0)
    budget.connected(grounds, 0.0)
    took, now_s = [], 0.0
    while now_s < 60.0:
        budget.waits(Kind.REPLY, 3000, now_s)
        if budget.send(Kind.REPLY, 3000, now_s):
            took.append(now_s)
        now_s += 0.01
    assert (
        60.0 * 0.2 * budget.bytes_per_s < len(took) * budget.cost(Kind.REPLY, 3000) < 60.0 * 0.45 * budget.bytes_per_s
    )


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
    sent = sets(run(Budget(64000.0, 0.2, 5.0, 0.0), flight(20.0), 20.0))
    revised = [offer for _, offer in sent if offer.revision]
    keyframes = [offer for offer in revised if offer.is_keyframe]
    assert len(revised) >= 35 and len(keyframes) >= 0.9 * len(revised)
    times = sorted(offer.capture_unix_ns for offer in keyframes)
    gaps_s = [(later - earlier) / 1e9 for earlier, later in itertools.pairwise(times)]
    assert max(gaps_s) <= 2.0  # keyframes lie 0.33 s apart, four of five go


def test_with_nothing_new_the_newest_is_reported_again_every_two_seconds() -> None:
    sent = sets(run(Budget(32000.0, 0.2, 5.0, 0.0), [(0.0, an_offer(7, 0.0))], 21.0))
    assert {offer.frame for _, offer in sent} == {7}
    assert 10 <= len(sent) <= 11


def test_with_nothing_new_the_newest_is_reported_again_between_older_ones_too() -> None:
    """A camera that stops leaves many older pictures that were overtaken; the newest may have gone into a cut."""
    sent = run(Budget(32000.0, 0.2, 5.0, 0.0), flight(10.0, 10.0), 20.0, 480)
    again = [s.at_s for s in sent if s.kind is Kind.SET and s.at_s > 10.5]
    older = [s.at_s for s in sent if s.kind is Kind.OLDER and s.at_s > 10.5]
    assert 4 <= len(again) <= 6 and max(b - a for a, b in itertools.pairwise(again)) < 2.5
    assert len(older) >= 15


def test_before_the_first_set_nothing_is_sent() -> None:
    assert run(Budget(32000.0, 0.2, 5.0, 0.0), [], 5.0) == []


def test_a_refusal_gives_way_to_an_answer_unless_that_is_old() -> None:
    selection: Selection[str] = Selection()
    selection.offer(an_offer(0, 0.0))
    selection.offer(an_offer(1, 0.5, is_ok=False))
    chosen = selection.next(0.6)
    assert chosen.frame == 0
    selection.offer(an_offer(2, 3.0, is_ok=False))
    chosen = selection.next(3.0)
    assert chosen.frame == 2
    selection.sent(chosen, 3.0)
    chosen = selection.next(3.0)
    assert chosen.frame == 0


def test_a_picture_placed_late_is_still_the_newest_that_answers() -> None:
    selection: Selection[str] = Selection()
    for frame in range(5):
        selection.offer(an_offer(frame, frame / 10.0, is_ok=False))
    for frame in range(5):
        selection.offer(an_offer(frame, frame / 10.0, 1))
    chosen = selection.next(1.0)
    assert (chosen.frame, chosen.revision) == (4, 1)
    selection.sent(chosen, 1.0)
    assert selection.next(1.1) is None
    rest = selection.next_of_rest(1.1)
    assert rest.revision == 1 and rest.frame != 4


def test_a_picture_overtaken_before_its_turn_waits_with_the_older_ones_and_not_in_place_of_its_revision() -> None:
    selection: Selection[str] = Selection()
    for frame in range(3):
        selection.offer(an_offer(frame, frame / 10.0))
    newest = selection.next(0.3)
    assert newest.frame == 2
    selection.sent(newest, 0.3)
    selection.offer(an_offer(0, 0.0, revision=1))
    found = []
    while (rest := selection.next_of_rest(0.4)) is not None:
        found.append(rest.item)
        selection.sent(rest, 0.4)
    assert found == ["0.1", "1.0"]


def test_while_the_newest_on_the_ground_is_old_older_pictures_wait_for_one_that_waits_too() -> None:
    selection: Selection[str] = Selection()
    selection.offer(an_offer(1, 1.0))
    selection.offer(an_offer(0, 0.0, revision=1))
    chosen = selection.next(0.0)
    assert chosen is not None
    selection.sent(chosen, 0.0)
    assert selection.next_of_rest(5.0) is not None  # nothing newer is there
    selection.offer(an_offer(3, 3.0))
    assert selection.next_of_rest(0.9) is not None
    assert selection.next_of_rest(1.1) is None


def test_a_later_revision_replaces_the_earlier_while_both_wait() -> None:
    selection: Selection[str] = Selection()
    selection.offer(an_offer(0, 0.0))
    selection.offer(an_offer(0, 0.0, 2))
    selection.offer(an_offer(0, 0.0, 1))
    chosen = selection.next(0.0)
    assert chosen.revision == 2
    selection.sent(chosen, 0.0)
    again = selection.next(0.1)
    assert again is None or again.revision == 1


def test_a_new_session_puts_the_old_ones_sets_away() -> None:
    selection: Selection[str] = Selection()
    selection.offer(an_offer(50, 5.0))
    selection.offer(Offer(2, 0, 0, START_NS, True, False, "new"))
    chosen = selection.next(0.0)
    assert chosen.item == "new"


@given(st.lists(st.tuples(st.integers(0, 300), st.integers(0, 3), st.booleans(), st.booleans()), max_size=150))
def test_any_order_of_offers_is_survived_and_memory_stays_bounded(offers: list[tuple[int, int, bool, bool]]) -> None:
    selection: Selection[str] = Selection()
    now_s = 0.0
    for count, (frame, revision, is_ok, is_keyframe) in enumerate(offers):
        now_s += 0.03
        selection.offer(an_offer(frame, frame / 30.0, revision, is_ok, is_keyframe))
        if count % 3 == 0 and (chosen := selection.next(now_s) or selection.next_of_rest(now_s)) is not None:
            selection.sent(chosen, now_s)
    for _ in range(len(offers) + 2):
        now_s += 0.1
        for chosen in (selection.next(now_s), selection.next_of_rest(now_s)):
            if chosen is not None:
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


# What tests/onboard/link/test_thin_links.py shows of real sessions in real time, of the rules alone: to the hundredth.


@pytest.mark.parametrize("cut_s", rest_long([9.0, 5.0, 40.0, 120.0]))
@pytest.mark.parametrize(("bit_rate", "is_stream"), [(64000.0, True), (44000.0, True), (64000.0, False)])
def test_after_a_cut_the_newest_picture_is_there_within_a_second_or_two(
    cut_s: float, bit_rate: float, is_stream: bool
) -> None:
    radio = Radio(bit_rate, ((10.0, 10.0 + cut_s),), is_stream)
    run(Budget(32000.0, 0.2, 5.0, 0.0), flight(cut_s + 20.0, 10.0), cut_s + 20.0, 600, 300, radio=radio)
    assert max(radio.ages_s(1.0, 10.0)) < 0.8
    assert max(radio.ages_s(10.0, 10.0 + cut_s)) > cut_s - 0.8
    assert max(radio.ages_s(10.0 + cut_s + 1.1, cut_s + 20.0)) < 1.5
    assert max(radio.ages_s(10.0 + cut_s + 2.5, cut_s + 20.0)) < 0.9


def test_without_holding_back_a_cut_would_be_paid_for_long_after(monkeypatch: pytest.MonkeyPatch) -> None:
    """That the radio above can tell: with all that was sent into the cut still to come, the newest is late."""
    monkeypatch.setattr(Radio, "unacknowledged", lambda _: 0.0)
    radio = Radio(44000.0, ((10.0, 19.0),))
    run(Budget(32000.0, 0.2, 5.0, 0.0), flight(30.0, 10.0), 30.0, 600, 300, radio=radio)
    assert max(radio.ages_s(20.5, 30.0)) > 5.0


@pytest.mark.parametrize(
    ("offered", "carried", "replies_hz", "median_s", "worst_s"),
    rest_long(
        [
            (9600.0, 14400.0, 0.0, 1.2, 2.5),
            (32000.0, 16000.0, 0.0, 3.0, 4.0),  # slower than configured: what is unacknowledged holds the delay
            (32000.0, 64000.0, 0.0, 0.5, 0.8),
            (32000.0, 64000.0, 1.0, 0.6, 1.0),
        ],
        2,
    ),
)
def test_the_delay_on_a_slow_radio_does_not_grow(
    offered: float, carried: float, replies_hz: float, median_s: float, worst_s: float
) -> None:
    radio = Radio(carried)
    run(Budget(offered, 0.2, 5.0, 0.0), flight(120.0, 10.0), 120.0, 600, 300, replies_hz, radio)
    for began_s in (5.0, 95.0):
        found = sorted(radio.ages_s(began_s, began_s + 25.0))
        assert 0.05 < found[len(found) // 2] < median_s and found[-1] < worst_s
