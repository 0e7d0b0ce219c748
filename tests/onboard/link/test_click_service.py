"""Clicks through the autopilot's radio in virtual time: how soon they are answered, and what that costs others."""

import dataclasses
import json
import random
import time
from collections import deque
from collections.abc import Iterator

import pytest

from contract.answer import Fix
from contract.feature_set import Status
from contract.locate import locate
from contract.wire.click_code import ClickAnswer, ClickQuestion, decode, encode_question
from contract.wire.codec import decode as decode_set
from contract.wire.codec import encode
from ground.click_asking import Asking
from onboard.config.schema import parse_config
from onboard.events.tunnel import Peer
from onboard.events.types import Frame
from onboard.link.autopilot_radio import OVERHEAD
from onboard.link.byte_budget import Bucket
from onboard.link.click_service import MAX_WAITING, MEASURED_WITHIN_S, ClickService
from onboard.link.reply import Answer, Measure, Question
from onboard.service.measure_thread import MeasureThread
from tests.contract.sets import plain_set
from tests.onboard.link.pipe import HEARTBEAT_BYTES, Way, own_stream
from tests.onboard.measured.step_world import CLICKED, EPOCH_NS, World

SET = decode_set(encode(dataclasses.replace(plain_set(60), frame=7)))
PAYLOAD = encode(SET)
GROUND = Peer(245, 25)
UV = (320.0, 240.0)
WORLD = World(roof_m=8.0, seed=12)
STEP_S = 0.01


class Clock:
    def __init__(self) -> None:
        self.now_s = 0.0

    def ns(self) -> int:
        return round(self.now_s * 1e9)


def look_up(asked: Question) -> Answer | None:
    if asked.frame not in (None, "7"):
        return Answer(json.dumps({"status": "unknown_frame", "vehicle": "uav-1"}).encode(), is_error=True)
    return Answer(PAYLOAD, b'{"age_s":0.25}')


def a_bucket(bit_rate: float = 4800.0) -> Bucket:
    return Bucket(bit_rate / 8.0, max(bit_rate / 16.0, 118.0), 0.0)


def a_service(clock: Clock, bit_rate: float = 4800.0, asked: list[Question] | None = None) -> ClickService:
    def noted(question: Question) -> Answer | None:
        if asked is not None:
            asked.append(question)
        return look_up(question)

    return ClickService("uav-1", noted, OVERHEAD, a_bucket(bit_rate), clock.ns)


def answered(service: ClickService, question: ClickQuestion, ground: Peer = GROUND) -> list[ClickAnswer]:
    service.receive(ground, encode_question(question))
    while service.work():
        pass
    found = [decode(payload) for to, payload in service.due() if to == ground]
    return [f for f in found if isinstance(f, ClickAnswer)]


def test_an_answer_is_that_of_the_set_with_the_age_it_had_when_the_question_came() -> None:
    (found,) = answered(a_service(Clock()), ClickQuestion(5, *UV))
    expected = locate(SET, UV)
    assert isinstance(found, ClickAnswer)
    assert abs(found.answer.lat_deg - expected.lat_deg) <= 1e-9 and abs(found.answer.lon_deg - expected.lon_deg) <= 1e-9
    assert found.answer.ellipse.semi_major_m == pytest.approx(expected.ellipse.semi_major_m, rel=1e-3)
    assert (found.number, found.answer.frame, found.answer.age_s) == (5, 7, 0.25)


@pytest.fixture(scope="module")
def measuring() -> Iterator[MeasureThread]:
    """A thread that has taken nine pictures of a roof."""
    with MeasureThread(parse_config('[vehicle]\nid = "uav-1"\n')) as thread:
        for number in range(9):
            thread.event(0, Frame(EPOCH_NS + number * 10**9, number, WORLD.image(number)))
            thread.feature_set(WORLD.its_set(number))
        yield thread


def roof_click(measure: Measure) -> tuple[Fix, float]:
    """The answer to a click on it through the radio, and how long the service took, s."""
    service = ClickService("uav-1", lambda _: Answer(encode(WORLD.its_set(CLICKED))), OVERHEAD, a_bucket(), Clock().ns)
    service.measure = measure
    began_s = time.monotonic()
    (found,) = answered(service, ClickQuestion(5, 200.0, 85.0))
    assert isinstance(found.answer, Fix)
    return found.answer, time.monotonic() - began_s


@pytest.mark.wall_clock  # within half a second
def test_the_answer_is_the_measured_one_or_in_time_the_interpolated_one(measuring: MeasureThread) -> None:
    measured, _ = roof_click(measuring.measure)
    assert measured.method == "measured" and measured.above_ground_m == pytest.approx(8.0, abs=1.0)
    never, took_s = roof_click(lambda *_: True)
    assert never.method == "interpolated" and took_s >= MEASURED_WITHIN_S
    refused, _ = roof_click(lambda *_: False)
    border, _ = roof_click(lambda payload, uv, done: measuring.measure(payload, (3.0, 3.0), done))
    for fix in (never, refused, border):
        assert fix.method == "interpolated" and fix.above_ground_m is None
        assert fix.height_amsl_m == pytest.approx((measured.height_amsl_m or 0.0) - 8.0, abs=1.0)


def test_what_the_aircraft_has_not_is_refused_and_what_is_being_made_is_not_answered_yet() -> None:
    clock = Clock()
    (unknown,) = answered(a_service(clock), ClickQuestion(5, *UV, frame=8))
    assert isinstance(unknown, ClickAnswer)
    assert (unknown.answer.status, unknown.answer.frame) == (Status.UNKNOWN_FRAME, 8)
    made: list[Answer] = []
    service = ClickService("uav-1", lambda _: made[0] if made else None, OVERHEAD, a_bucket(), clock.ns)
    assert answered(service, ClickQuestion(6, *UV, frame=7)) == []
    made.append(Answer(PAYLOAD))
    (late,) = answered(service, ClickQuestion(6, *UV, frame=7))
    assert isinstance(late, ClickAnswer) and isinstance(late.answer, Fix)


def test_a_question_that_is_sent_again_gets_the_same_answer_and_is_computed_once() -> None:
    clock, asked = Clock(), list[Question]()
    service = a_service(clock, asked=asked)
    first = answered(service, ClickQuestion(5, *UV))
    clock.now_s = 3.0
    again = answered(service, ClickQuestion(5, *UV))
    assert answered(service, ClickQuestion(5, *UV)) == []  # that answer is still under way
    assert len(asked) == 1
    assert isinstance(first[0], ClickAnswer) and isinstance(again[0], ClickAnswer)
    assert first[0].answer.age_s == again[0].answer.age_s == 0.25
    answered(service, ClickQuestion(5, *UV), Peer(246, 25))  # another ground's question of the same number
    assert len(asked) == 2


@pytest.mark.parametrize(("waited_s", "frame"), [(0.0, 9), (0.2, 9), (0.6, 8), (1.2, 7)])
def test_a_question_that_comes_late_means_the_picture_of_when_it_was_clicked(waited_s: float, frame: int) -> None:
    """Pictures 0.4 s apart, the newest 0.3 s old."""
    made = {
        n: dataclasses.replace(SET, frame=n, capture_unix_ns=SET.capture_unix_ns + n * 400_000_000) for n in range(10)
    }

    def of_a_flight(asked: Question) -> Answer | None:
        found = made[9]
        if asked.time_s is not None:
            found = min(made.values(), key=lambda s: abs(s.capture_unix_ns / 1e9 - (asked.time_s or 0.0)))
        return Answer(encode(found), json.dumps({"age_s": 0.3 + 0.4 * (9 - found.frame)}).encode())

    service = ClickService("uav-1", of_a_flight, OVERHEAD, a_bucket(), Clock().ns)
    (found,) = answered(service, ClickQuestion(5, *UV, waited_s=waited_s))
    assert found.answer.frame == frame
    assert found.answer.age_s == pytest.approx(max(0.3 + 0.4 * (9 - frame) - waited_s, 0.0), abs=0.01)


def test_a_flood_of_questions_is_bounded_and_never_above_the_bit_rate() -> None:
    clock = Clock()
    service = a_service(clock, 4800.0)
    sent: deque[tuple[float, int]] = deque()
    for number in range(2000):
        clock.now_s += 0.005
        service.receive(GROUND, encode_question(ClickQuestion(number, *UV)))
        service.receive(GROUND, b"\x11garbage")
        service.work()
        out = service.due()
        assert len(out) <= MAX_WAITING
        sent += [(clock.now_s, len(payload) + OVERHEAD) for _, payload in out]
    for began_s, _ in list(sent):
        carried = sum(size for at_s, size in sent if began_s <= at_s <= began_s + 2.0)
        assert carried <= 2.0 * 600.0 + 300.0 + 77.0
    assert sum(size for _, size in sent) >= 0.9 * 600.0 * 10.0


def waits_s(
    bit_rate: float, clicks: int, loss: float = 0.0, delay_s: float = 0.1, share: float = 0.6, seconds: float = 900.0
) -> tuple[list[float], Way[bytes]]:
    """How long each of so many clicks, a while after one another, waits for its answer; and the way down."""
    clock, chance = Clock(), random.Random(4)
    service = a_service(clock, 0.4 * bit_rate if bit_rate > 1000.0 else bit_rate)
    up: Way[bytes] = Way(bit_rate, loss, delay_s, 0.05, seed=1)
    down: Way[bytes] = Way(bit_rate, loss, delay_s, 0.05, seed=2)
    stream = deque(own_stream(bit_rate, share, seconds))
    found: list[float] = []
    asking, began_s, beat_s = None, 0.0, 0.0
    next_s = 1.0
    while len(found) < clicks and clock.now_s < seconds - 1.0:
        now_s = clock.now_s = clock.now_s + STEP_S
        while stream and stream[0][0] <= now_s:
            down.put_own(now_s, stream.popleft()[1])
        if asking is None and now_s >= next_s:
            asking, began_s = Asking(ClickQuestion(len(found), *UV), now_s), now_s
        if asking is not None and asking.is_due(now_s):
            up.put(now_s, 20 + OVERHEAD, asking.packet(now_s))
        if now_s >= beat_s:
            up.put(now_s, HEARTBEAT_BYTES, b"")
            beat_s = now_s + 5.0
        for payload in up.arrived(now_s):
            service.receive(GROUND, payload)
        while service.work():
            pass
        for _, payload in service.due():
            down.put(now_s, len(payload) + OVERHEAD, payload)
        for payload in down.arrived(now_s):
            if asking is not None and asking.take(payload) is not None:
                found.append(now_s - began_s)
                asking, next_s = None, now_s + chance.uniform(0.5, 3.0)
    return sorted(found), down


@pytest.mark.parametrize(
    ("bit_rate", "share", "loss", "most_s"),
    [
        (400.0, 0.42, 0.0, 4.0),  # nothing but the autopilot's heartbeat
        (400.0, 0.42, 0.1, 6.0),
        (4800.0, 0.6, 0.1, 4.0),
        (57_600.0, 0.65, 0.1, 4.0),
    ],
)
def test_a_click_is_answered_within_seconds_on_the_thinnest_radio(
    bit_rate: float, share: float, loss: float, most_s: float
) -> None:
    waits, _ = waits_s(bit_rate, 100, loss, share=share)
    assert len(waits) == 100
    assert waits[94] <= most_s
    assert waits[0] >= 8.0 * (37 + 60) / bit_rate  # and no sooner than its bytes take


def test_the_autopilots_own_messages_are_hardly_later_for_the_answers_between_them() -> None:
    _, busy = waits_s(57_600.0, 60, share=0.65, seconds=150.0)
    _, alone = waits_s(57_600.0, 0, share=0.65, seconds=0.0)
    for at_s, size in own_stream(57_600.0, 0.65, 150.0):
        alone.put_own(at_s, size)
    later = [one - other for one, other in zip(busy.own_waits_s, alone.own_waits_s, strict=False)]
    assert len(later) > 2000 and len(busy.carried) >= 60
    assert 0.005 < max(later) <= 0.05
