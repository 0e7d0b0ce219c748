"""The thread that measures clicks: pictures kept within its bytes, questions bounded, hostile ones harmless."""

import dataclasses
import weakref

import numpy as np
import pytest

from contract.feature_set import FeatureSet, Measured, Status
from contract.wire.codec import decode, encode
from onboard.config.schema import parse_config
from onboard.events.kept_pictures import KeptPictures
from onboard.events.types import Frame
from onboard.service.measure_thread import LATE_ANSWER_S, MAX_ASKED, MAX_HELD, MeasureThread
from onboard.service.track_thread import TrackThread
from tests.onboard.measured.step_world import CLICKED, EPOCH_NS, World

CONFIG = parse_config('[vehicle]\nid = "uav-1"\n')
WORLD = World(seed=11)
UV = (150.0, 110.0)


class Simulated:
    """A thread that is never started: its work is done by hand, by a clock that is set."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self.measured = MeasureThread(CONFIG, lambda: self.now_s)
        self.answers: list[FeatureSet | None] = []

    def fly(self, *numbers: int) -> None:
        for number in numbers:
            self.measured.event(0, Frame(EPOCH_NS + number * 10**9, number, WORLD.image(number)))
            self.measured.feature_set(WORLD.its_set(number))

    def ask(self, payload: bytes, uv: tuple[float, float] = UV) -> bool:
        return self.measured.measure(payload, uv, self.answers.append)

    @property
    def words(self) -> list[Measured | None]:
        return [None if a is None or a.clicked is None else a.clicked.measured for a in self.answers]


@pytest.fixture(scope="module")
def held() -> Simulated:
    simulated = Simulated()
    simulated.fly(*range(9))
    return simulated


def test_a_pixel_is_measured_and_the_answer_is_the_same_set_but_for_it(held: Simulated) -> None:
    held.answers.clear()
    payload = encode(WORLD.its_set(CLICKED))
    assert held.ask(payload)
    held.measured.work()
    (answer,) = held.answers
    assert answer.clicked.is_measured
    assert encode(dataclasses.replace(answer, clicked=None)) == payload
    assert decode(encode(answer)).clicked == pytest.approx(answer.clicked) or answer.clicked.is_measured


def test_of_a_thousand_questions_eight_wait_and_the_rest_are_refused_at_once(held: Simulated) -> None:
    held.answers.clear()
    payload = encode(WORLD.its_set(CLICKED))
    assert [held.ask(payload) for _ in range(1000)].count(True) == MAX_ASKED
    held.now_s += LATE_ANSWER_S + 0.01
    for _ in range(MAX_ASKED):
        held.measured.work()
    assert held.words == [None] * MAX_ASKED  # too late to be measured: answered by what is there
    assert held.measured.work() == 0.0


@pytest.mark.parametrize("uv", [(-3.0, 5.0), (400.0, 20.0), (float("nan"), 3.0), (1e9, 1e9)])
def test_a_pixel_off_the_picture_is_answered_without_a_measurement(held: Simulated, uv: tuple[float, float]) -> None:
    held.answers.clear()
    held.ask(encode(WORLD.its_set(CLICKED)), uv)
    held.measured.work()
    assert held.answers == [None]


def test_an_old_picture_another_session_and_a_refused_set_are_not_measured(held: Simulated) -> None:
    held.answers.clear()
    of_old = dataclasses.replace(WORLD.its_set(CLICKED), frame=1000)
    before = dataclasses.replace(WORLD.its_set(CLICKED), session=4)
    refused = FeatureSet("uav-1", 5, CLICKED, EPOCH_NS, Status.TURNING, of_old.camera)
    for asked in (of_old, before, refused):
        held.ask(encode(asked))
        held.measured.work()
    assert held.words == [Measured.NO_PICTURE, Measured.NO_PICTURE, None]


def test_a_payload_that_is_none_costs_no_answer_but_its_own(held: Simulated) -> None:
    held.answers.clear()
    held.ask(b"PC nothing")
    with pytest.raises(Exception, match="payload"):
        held.measured.work()
    assert held.answers == [None]


def test_pictures_are_kept_within_their_bytes_keyframes_longest() -> None:
    image = np.zeros((240, 320), np.uint8)
    pictures = KeptPictures(10 * image.nbytes)
    for number in range(40):
        pictures.add(image, dataclasses.replace(SET, frame=number, is_keyframe=number % 8 == 0))
    assert len(pictures) == 10
    kept = [k.its_set.frame for k in pictures.placed(SET.session, -1)[1]]
    assert kept[:4] == [0, 8, 16, 24] and kept[-1] == 39
    pictures.add(image, dataclasses.replace(SET, session=6))
    assert len(pictures) == 1


def test_the_last_seconds_are_whole_and_keyframes_before_them_have_their_share() -> None:
    """Ten pictures a second, each tenth a keyframe, in a ring of eighty: eight seconds if nothing else were kept."""
    pictures, order = KeptPictures(80 * 8 * 8), []
    for number in range(600):
        its_set = dataclasses.replace(SET, frame=number, is_keyframe=number % 10 == 0)
        pictures.add(np.zeros((8, 8), np.uint8), its_set, EPOCH_NS + number * 100_000_000)
        order.append(len(pictures))
    kept = [k.its_set.frame for k in pictures.placed(SET.session, -1)[1]]
    assert max(order) == len(kept) == 80
    recent = [n for n in kept if n >= 540]
    assert len(recent) >= 60 and [n for n in kept if n < 538] == list(range(340, 538, 10))


def test_tracks_and_measured_clicks_share_one_ring_of_the_bytes_that_the_key_states() -> None:
    config = parse_config('[vehicle]\nid = "uav-1"\n[tracks]\nkeep_mb = 8.0\n')
    ring, one = KeptPictures(100 * 240 * 320), np.zeros((240, 320), np.uint8)
    threads = TrackThread(config, pictures=ring), MeasureThread(config, pictures=ring)
    images: list[weakref.ref[np.ndarray]] = []
    for number in range(300):
        image = one.copy()
        images.append(weakref.ref(image))
        its_set = dataclasses.replace(SET, frame=number, is_keyframe=number % 10 == 0)
        for thread in threads:
            thread.event(0, Frame(EPOCH_NS + number * 33_000_000, number, image))
            thread.feature_set(its_set)
        threads[0].work()
        del image
    alive = sum(ref() is not None for ref in images)
    assert 98 <= alive <= 102  # both hold the same pictures, but for the last few that a thread works on
    assert threads[0]._frames <= frozenset(n for n in range(300) if n in ring)
    assert len(threads[0]._frames) > 50


SET = WORLD.its_set(3)


def test_a_later_set_of_a_kept_picture_replaces_its_earlier_one() -> None:
    image = np.zeros((240, 320), np.uint8)
    pictures = KeptPictures(10 * image.nbytes)
    pictures.add(image, SET)
    pictures.revise(dataclasses.replace(SET, revision=2))
    pictures.revise(dataclasses.replace(SET, revision=1))
    kept, _ = pictures.placed(SET.session, SET.frame)
    assert kept.its_set.revision == 2


def test_pictures_whose_sets_never_come_are_forgotten() -> None:
    simulated = Simulated()
    for number in range(3 * MAX_HELD):
        simulated.measured.event(0, Frame(EPOCH_NS + number, number, np.zeros((8, 8), np.uint8)))
    assert len(simulated.measured._held) == MAX_HELD
