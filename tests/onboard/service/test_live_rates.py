"""Rates of the last seconds: each picture that can be clicked counts once, however late its set comes."""

from contract.camera import Camera
from contract.feature_set import FeatureSet, Status
from onboard.service.live_rates import RATE_WINDOW_NS, LiveRates

CAMERA = Camera.from_field_of_view(640, 480, 60.0)
STEP_NS = 33_333_333


def a_set(frame: int, revision: int = 0, status: Status = Status.OK) -> FeatureSet:
    return FeatureSet("uav-1", 1, frame, 10**18 + frame * STEP_NS, status, CAMERA, revision=revision)


def test_pictures_whose_set_is_made_late_count_as_answered_and_later_revisions_do_not() -> None:
    """Every third at once, the others thirty pictures later, and then those at once again."""
    rates, begin_ns = LiveRates(), 10**18
    frames = 300
    for k in range(frames):
        now_ns = begin_ns + k * STEP_NS
        if k % 3 == 0:
            rates.set_made(a_set(k), now_ns)
        if k >= 30:
            rates.set_made(a_set(k - 30, revision=int(k % 3 == 0)), now_ns)
    assert abs(rates.ok_hz(begin_ns + frames * STEP_NS) - 1e9 / STEP_NS) < 1.0
    assert rates.frame == frames - 3
    assert rates.ok_hz(begin_ns + frames * STEP_NS + 2 * RATE_WINDOW_NS) == 0.0


def test_what_came_late_does_not_speak_for_the_newest_pictures() -> None:
    rates, begin_ns = LiveRates(), 10**18
    for k in range(100):
        rates.set_made(a_set(k, status=Status.TURNING), begin_ns + k * STEP_NS)
    rates.set_made(a_set(20, revision=1), begin_ns + 100 * STEP_NS)
    assert rates.outcome(begin_ns + 100 * STEP_NS) is Status.TURNING
