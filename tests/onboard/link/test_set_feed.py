"""Sets in pieces through the autopilot's radio, in virtual time: how often, how old, and at whose cost."""

from collections import deque
from dataclasses import dataclass, field

import pytest

from contract.wire.click_code import ClickQuestion, TurnedAway, decode, encode_question
from contract.wire.radio_state import Held, RadioState, encode_state, read_state
from contract.wire.set_pieces import MAX_WIRE_BYTES, ReceiverReport, SetAssembly, encode_report, read_piece
from onboard.events.tunnel import Peer
from onboard.link.autopilot_radio import OVERHEAD, AutopilotRadio
from onboard.link.rate_follower import BEGIN_BIT_RATE, LEAST_BIT_RATE, SILENT_S, RateFollower
from onboard.link.set_feed import SLOW_S, STATE_S
from onboard.link.set_selection import Offer
from tests.onboard.link.pipe import HEARTBEAT_BYTES, Way, own_stream
from tests.onboard.link.test_click_service import Clock, look_up

GROUND = Peer(245, 25)
REPORT_S = 2.0
STEP_S = 0.01
STATE_BYTES = len(encode_state(RadioState(Held.BY_RADIO))) + OVERHEAD
SET_BYTES = 551  # the median of a hundred features


def a_radio(clock: Clock, bit_rate: float, is_signed: bool = False) -> AutopilotRadio:
    return AutopilotRadio(
        "uav-1",
        look_up,
        lambda capture_ns: clock.now_s - capture_ns / 1e9,
        bit_rate,
        is_signed=is_signed,
        now_ns=clock.ns,
    )


def an_offer(frame: int, at_s: float) -> Offer[bytes]:
    payload = frame.to_bytes(4, "little") + bytes([frame % 251]) * (SET_BYTES - 4)
    return Offer(1, frame, 0, round(at_s * 1e9), True, frame % 10 == 0, payload)


@dataclass
class Ground:
    """What a ground has: when each set came, and how old it was."""

    came: list[tuple[float, float]] = field(default_factory=list)
    ages_s: list[float] = field(default_factory=list)  # of the newest, at every step
    states: list[tuple[float, RadioState]] = field(default_factory=list)


def simulated(
    radio_bit_rate: float,
    our_bit_rate: float,
    loss: float,
    share: float,
    seconds: float = 120.0,
    camera_hz: float = 5.0,
    stops_s: float = 1e9,
) -> tuple[Ground, Way[bytes]]:
    """A flight over a radio; the ground listens until `stops_s`."""
    clock = Clock()
    radio = a_radio(clock, our_bit_rate)
    up: Way[bytes] = Way(radio_bit_rate, loss, 0.1, 0.05, seed=1)
    down: Way[bytes] = Way(radio_bit_rate, loss, 0.1, 0.05, seed=2)
    stream = deque(own_stream(radio_bit_rate, share, seconds))
    assembly, ground = SetAssembly(), Ground()
    frame, report_s, newest_s = 0, 0.0, -1e9
    for tick in range(round(seconds / STEP_S)):
        now_s = clock.now_s = tick * STEP_S
        while stream and stream[0][0] <= now_s:
            down.put_own(now_s, stream.popleft()[1])
        if frame < now_s * camera_hz:
            radio.feed.offer(an_offer(frame, frame / camera_hz))
            frame += 1
        if report_s <= now_s < stops_s:
            report = encode_report(assembly.report(now_s))
            up.put(now_s, len(report) + OVERHEAD, report)
            up.put(now_s, HEARTBEAT_BYTES, b"")
            report_s = now_s + REPORT_S
        for payload in up.arrived(now_s):
            radio.receive(GROUND, payload)
        for _, payload in radio.due():
            assert len(payload) + OVERHEAD <= MAX_WIRE_BYTES
            down.put(now_s, len(payload) + OVERHEAD, payload)
        for payload in down.arrived(now_s):
            piece, state = read_piece(payload), read_state(payload)
            ground.states += [] if state is None else [(now_s, state)]
            done = None if piece is None else assembly.take(piece, now_s)
            if done is not None:
                number = int.from_bytes(done[0][:4], "little")
                assert done[0] == an_offer(number, 0.0).item
                assert -0.01 <= done[1] <= now_s - number / camera_hz
                ground.came.append((now_s, number / camera_hz))
                newest_s = max(newest_s, number / camera_hz)
        ground.ages_s.append(now_s - newest_s)
    return ground, down


def quantile(values: list[float], share: float) -> float:
    return sorted(values)[round(share * (len(values) - 1))]


@pytest.mark.parametrize(
    ("radio_bit_rate", "our_bit_rate", "loss", "share", "between_s", "age_s"),
    [
        (9_600.0, 4_800.0, 0.1, 0.4, 2.0, 5.0),
        (9_600.0, 4_800.0, 0.0, 0.4, 1.6, 4.0),
        (57_600.0, 9_600.0, 0.1, 0.65, 1.1, 3.0),
    ],
)
def test_a_set_comes_every_two_seconds_and_the_newest_is_young(
    radio_bit_rate: float, our_bit_rate: float, loss: float, share: float, between_s: float, age_s: float
) -> None:
    ground, down = simulated(radio_bit_rate, our_bit_rate, loss, share)
    settled = [came_s for came_s, _ in ground.came if came_s >= 30.0]
    assert 90.0 / between_s <= len(settled) <= 90.0 * our_bit_rate / 8.0 / SET_BYTES
    assert quantile(ground.ages_s[3000:], 0.95) <= age_s
    for began_s, _ in down.carried:
        carried = sum(size for at_s, size in down.carried if began_s <= at_s <= began_s + 2.0)
        assert carried <= 2.0 * our_bit_rate / 8.0 + max(our_bit_rate / 16.0, MAX_WIRE_BYTES) + MAX_WIRE_BYTES


def test_the_rate_follows_what_the_radio_carries() -> None:
    """Half of what we may send: the autopilot drops the rest without a word, and reports of the ground show it."""
    ground, down = simulated(4_800.0, 9_600.0, 0.0, 0.2, 180.0)
    settled = [size for at_s, size in down.carried if at_s >= 60.0]
    assert 0.55 * 600.0 * 0.8 <= sum(settled) / 120.0 <= 600.0
    assert down.dropped <= 0.35 * (len(down.carried) + down.dropped)
    assert len([came_s for came_s, _ in ground.came if came_s >= 60.0]) >= 0.25 * 120.0


def test_the_autopilots_own_messages_are_hardly_later_for_the_sets_between_them() -> None:
    _, busy = simulated(57_600.0, 9_600.0, 0.0, 0.65, 60.0)
    alone: Way[bytes] = Way(57_600.0)
    for at_s, size in own_stream(57_600.0, 0.65, 60.0):
        alone.put_own(round(at_s / STEP_S + 0.4999) * STEP_S, size)  # as the loop looks
    later = [one - other for one, other in zip(busy.own_waits_s, alone.own_waits_s, strict=False)]
    assert len(later) > 2000 and len(busy.carried) > 300
    assert 0.005 < max(later) <= 0.05


def lateness_s(share: float, busy: Way[bytes], radio_bit_rate: float, seconds: float) -> float:
    """Return by how much later 99 % of the autopilot's messages come than without ours, after the first tenth."""
    alone: Way[bytes] = Way(radio_bit_rate)
    for at_s, size in own_stream(radio_bit_rate, share, seconds):
        alone.put_own(round(at_s / STEP_S + 0.4999) * STEP_S, size)  # as the loop looks
    begun = len(alone.own_waits_s) // 10
    return quantile(busy.own_waits_s[begun:], 0.99) - quantile(alone.own_waits_s[begun:], 0.99)


def test_on_a_radio_that_is_nearly_full_the_autopilots_messages_are_little_later_and_sets_come() -> None:
    ground, busy = simulated(4_800.0, 4_800.0, 0.0, 0.79, 300.0)
    assert 0.02 <= lateness_s(0.79, busy, 4_800.0, 300.0) <= 0.2
    assert busy.dropped <= 0.05 * (len(busy.carried) + busy.dropped)
    assert len([came_s for came_s, _ in ground.came if came_s >= 30.0]) >= 270.0 / 25.0


@pytest.mark.parametrize(
    ("radio_bit_rate", "our_bit_rate", "share", "held"),
    [(4_800.0, 4_800.0, 0.79, Held.BY_RADIO), (19_200.0, 1_200.0, 0.05, Held.BY_CONFIGURATION)],
)
def test_where_sets_take_too_long_the_ground_learns_what_holds_them(
    radio_bit_rate: float, our_bit_rate: float, share: float, held: Held
) -> None:
    ground, down = simulated(radio_bit_rate, our_bit_rate, 0.0, share)
    states = ground.states
    assert 2 <= len(states) <= 120.0 / STATE_S + 1.0 and states[0][0] < 30.0
    assert {state.held for _, state in states} == {held}
    assert all(SLOW_S < (state.set_s or 0.0) < 40.0 for _, state in states)
    assert ("radio is full" in states[0][1].words) is (held is Held.BY_RADIO)
    sizes = [size for _, size in down.carried]
    assert STATE_BYTES * sizes.count(STATE_BYTES) < 0.03 * sum(sizes)


@pytest.mark.parametrize(("radio_bit_rate", "share", "loss"), [(9_600.0, 0.4, 0.0), (57_600.0, 0.65, 0.1)])
def test_where_sets_come_soon_there_is_no_word_of_the_radio(radio_bit_rate: float, share: float, loss: float) -> None:
    ground, _ = simulated(radio_bit_rate, 9_600.0, loss, share)
    assert ground.states == [] and ground.came


def test_where_the_radio_is_idle_sets_soon_come_at_the_rate_that_is_allowed() -> None:
    ground, _ = simulated(19_200.0, 4_800.0, 0.0, 0.05, 60.0)
    assert len([came_s for came_s, _ in ground.came if came_s < 12.0]) >= 3
    assert len([came_s for came_s, _ in ground.came if came_s >= 30.0]) >= 30.0 / 1.6


def test_as_fast_a_rate_as_the_radio_itself_loses_little_to_the_autopilots_full_buffer() -> None:
    ground, down = simulated(57_600.0, 57_600.0, 0.0, 0.65, 120.0)
    assert 0.01 <= down.dropped / (len(down.carried) + down.dropped) <= 0.12
    assert len([came_s for came_s, _ in ground.came if came_s >= 30.0]) >= 90.0 / 0.5


def test_no_sets_flow_before_a_ground_asks_nor_long_after_it_is_gone() -> None:
    ground, down = simulated(9_600.0, 4_800.0, 0.0, 0.2, 60.0, stops_s=20.0)
    times = [at_s for at_s, _ in down.carried]
    assert times[0] < 2.0 and 18.0 + SILENT_S - 1.0 < times[-1] <= 20.0 + SILENT_S + 1.0
    assert ground.came
    radio = a_radio(Clock(), 4_800.0)
    radio.feed.offer(an_offer(0, 0.0))
    assert radio.due() == []


def test_one_ground_at_a_time_gets_sets() -> None:
    clock = Clock()
    radio, other = a_radio(clock, 1e5), Peer(246, 25)
    radio.feed.offer(an_offer(0, 0.0))
    for ground in (GROUND, other):
        radio.receive(ground, encode_report(ReceiverReport(0, 0)))
    clock.now_s = 5.0
    assert {ground for ground, _ in radio.due()} == {GROUND}
    clock.now_s = 5.0 + SILENT_S
    radio.feed.offer(an_offer(9, 9.0))
    radio.receive(other, encode_report(ReceiverReport(0, 0)))
    clock.now_s += 1.0
    assert {ground for ground, _ in radio.due()} == {other}


def test_signed_packets_are_as_long_on_the_wire_as_unsigned_ones() -> None:
    clock = Clock()
    radio = a_radio(clock, 1e6, is_signed=True)
    radio.feed.offer(an_offer(0, 0.0))
    radio.receive(GROUND, encode_report(ReceiverReport(0, 0)))
    sizes = []
    for _ in range(100):
        clock.now_s += 0.1
        radio.receive(GROUND, encode_report(ReceiverReport(0, 0)))
        sizes += [len(payload) for _, payload in radio.due()]
    assert 70 <= max(sizes) <= 88 and len(sizes) == 9  # 553 bytes in 7 pieces and 2 parities


@pytest.mark.parametrize(("system", "is_turned_away"), [(249, False), (250, True), (255, True)])
def test_a_ground_stations_system_number_is_turned_away(system: int, is_turned_away: bool) -> None:
    radio, ground = a_radio(Clock(), 4_800.0), Peer(system, 25)
    radio.know_ground_stations(250, 255)
    radio.feed.offer(an_offer(0, 0.0))
    radio.receive(ground, encode_question(ClickQuestion(5, 1.0, 2.0)))
    radio.receive(ground, encode_report(ReceiverReport(0, 0)))
    radio.receive(ground, b"")
    messages = [decode(payload) for to, payload in radio.due() if to == ground and read_piece(payload) is None]
    assert [isinstance(s, TurnedAway) and (s.low, s.high) == (250, 255) for s in messages] == [True] * is_turned_away


def reported(
    follower: RateFollower, share: float, reports: int, way_s: float = 0.3, begin_s: float = 0.0, first: int = 0
) -> float:
    """The bit rate after so many reports, 20 packets apart, of which a share has come."""
    follower.received(ReceiverReport(20 * first % 65536, round(20 * first * share) % 65536), begin_s, [])
    for number in range(first + 1, first + reports + 1):
        report = ReceiverReport(20 * number % 65536, round(20 * number * share) % 65536)
        follower.received(report, begin_s + 2.0 * (number - first), [way_s] * 4)
    return follower.bit_rate(begin_s + 2.0 * reports)


def test_the_rate_doubles_until_packets_queue_and_never_passes_the_greatest() -> None:
    assert reported(RateFollower(9_600.0), 1.0, 0) == BEGIN_BIT_RATE
    assert reported(RateFollower(9_600.0), 1.0, 1) == 2.0 * BEGIN_BIT_RATE
    assert reported(RateFollower(9_600.0), 1.0, 4) == 9_600.0
    assert reported(RateFollower(9_600.0), 1.0, 5000) == 9_600.0
    assert reported(RateFollower(250.0), 1.0, 1) == 250.0
    assert reported(RateFollower(9_600.0), 0.9, 20) == 9_600.0  # a radio's own loss


def test_a_start_that_fills_the_radio_ends_at_once() -> None:
    follower = RateFollower(9_600.0)
    assert reported(follower, 1.0, 2) == 4.0 * BEGIN_BIT_RATE
    assert reported(follower, 1.0, 1, way_s=0.6, begin_s=6.0, first=2) == BEGIN_BIT_RATE


def test_the_rate_falls_while_packets_queue_and_grows_again_afterwards() -> None:
    follower = RateFollower(9_600.0)
    assert reported(follower, 1.0, 10) == 9_600.0
    fallen = reported(follower, 1.0, 5, way_s=0.7, begin_s=22.0, first=10)
    assert LEAST_BIT_RATE <= fallen <= 0.25 * 9_600.0
    assert reported(follower, 1.0, 20, way_s=0.3, begin_s=34.0, first=15) > 4.0 * fallen


def test_the_rate_halves_at_loss_that_it_causes_and_not_at_the_radios_own() -> None:
    follower = RateFollower(9_600.0)
    assert reported(follower, 1.0, 10) == 9_600.0
    follower.received(ReceiverReport(220, 210), 22.0, [])  # half of 20
    assert follower.bit_rate(22.0) == 4_800.0
    follower.received(ReceiverReport(240, 220), 23.0, [])  # sent before
    assert follower.bit_rate(23.0) == 4_800.0
    lossy = RateFollower(9_600.0)
    assert reported(lossy, 0.7, 100) == 9_600.0  # as much at any rate
    assert reported(RateFollower(9_600.0), 0.1, 100) == LEAST_BIT_RATE


def test_a_ground_that_begins_again_or_is_silent_is_no_loss() -> None:
    follower = RateFollower(9_600.0)
    assert reported(follower, 1.0, 10) == 9_600.0
    follower.received(ReceiverReport(0, 0), 21.0, [])
    follower.received(ReceiverReport(50_000, 3), 22.0, [])
    assert follower.bit_rate(22.0) == 9_600.0
    assert follower.bit_rate(22.0 + SILENT_S) == 0.0
    follower.received(ReceiverReport(50_000, 4), 40.0, [])
    assert follower.bit_rate(40.0) == BEGIN_BIT_RATE
