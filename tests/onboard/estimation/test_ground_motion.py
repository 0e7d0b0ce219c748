"""Ground that moves as a whole: flow disagreement measures it, and covariances grow by what it does to the solution."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from onboard.estimation.ground_motion import MOTION_PER_SLIP, ground_motion, ground_sigma_m_s
from onboard.estimation.keyframe import Keyframe
from onboard.estimation.sensor_factors import Sensors
from onboard.estimation.window_request import Request
from onboard.estimation.window_solver import adjust
from onboard.navigation.position_interpolation import Displacement
from onboard.vision.coarse_flow import flow_disagreement
from onboard.vision.contrast_normalisation import Picture, prepare
from onboard.vision.klt_tracker import Tracker
from tests.onboard.scenes import FULL, SceneSpec, draw

SIZE = (640, 480)


def patterns(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Two random patterns (H, W): blobs of about 3 px and of about 20 px, with a margin to move in."""
    rng = np.random.default_rng(seed)
    shape = (SIZE[1] + 80, SIZE[0] + 80)
    return tuple(cv2.GaussianBlur(rng.standard_normal(shape), (0, 0), s) * s * 3.5 for s in (2.0, 12.0))


def seen(seed: int, fine_px: tuple[int, int], coarse_px: tuple[int, int]) -> Picture:
    """Both patterns, each moved by so many pixels right and down, under the sensor's noise."""
    layers = [
        pattern[40 - v : 40 - v + SIZE[1], 40 - u : 40 - u + SIZE[0]]
        for pattern, (u, v) in zip(patterns(seed), (fine_px, coarse_px), strict=True)
    ]
    noise = 1.5 * np.random.default_rng([seed, fine_px[0]]).standard_normal(layers[0].shape)
    return np.asarray(np.clip(120.0 + 22.0 * layers[0] + 22.0 * layers[1] + noise, 0, 255), np.uint8)


def measured(seed: int, fine_px: tuple[int, int], coarse_px: tuple[int, int]) -> np.ndarray:
    tracker = Tracker(SIZE, 100)
    tracker.track(seen(seed, (0, 0), (0, 0)), None)
    tracker.promote(tracker.nothing())
    motion = np.array([[1.0, 0.0, fine_px[0]], [0.0, 1.0, fine_px[1]], [0.0, 0.0, 1.0]])
    tracks = tracker.track(seen(seed, fine_px, coarse_px), motion)
    tracker.promote(tracks)
    assert len(tracks) > 30 and tracker.flow_disagreement_px is not None
    return tracker.flow_disagreement_px


@pytest.mark.parametrize("seed", [0, 1])
def test_solid_ground_does_not_slip(seed: int) -> None:
    assert np.linalg.norm(measured(seed, (12, -5), (12, -5))) < 0.1


@pytest.mark.parametrize("past_px", [(4, 0), (-3, 3)])
def test_patterns_that_pass_each_other_slip(past_px: tuple[int, int]) -> None:
    """The coarse view sees some of the fine pattern too: part of the motion is found, in its direction."""
    found = measured(0, (12, -5), (12 + past_px[0], -5 + past_px[1]))
    share = found @ np.array(past_px) / np.square(past_px).sum()
    assert 0.2 < share < 1.1
    assert np.linalg.norm(found - share * np.array(past_px)) < 0.25 * np.linalg.norm(past_px)


def test_slip_is_measured_on_a_picture_that_turns() -> None:
    """A turn of 0.15 rad about the middle is no disagreement."""
    c, s = np.cos(0.15), np.sin(0.15)
    u, v = (SIZE[0] - 1) / 2, (SIZE[1] - 1) / 2
    turn = np.array([[c, -s, u - c * u + s * v], [s, c, v - s * u - c * v], [0.0, 0.0, 1.0]])
    was = prepare(seen(3, (0, 0), (0, 0)))
    now = np.asarray(cv2.warpPerspective(was, turn, SIZE, flags=cv2.INTER_CUBIC), np.uint8)
    at = np.random.default_rng(0).uniform((150, 120), (490, 360), (60, 2))
    to = (np.column_stack([at, np.ones(60)]) @ turn.T)[:, :2]
    assert np.linalg.norm(flow_disagreement(was, now, turn, at, to)) < 0.15


def request_of(seed: int) -> Request:
    return draw(np.random.default_rng(seed), FULL, SceneSpec(error_scale=0.3)).window().prepare()


def test_the_speed_is_the_slip_over_the_ground_in_time() -> None:
    request = request_of(0)
    keyframes = [replace(k, flow_disagreement_xy=np.array([0.003, 0.004])) for k in request.keyframes]
    seconds = np.diff([k.nav.stamp_ns for k in keyframes]) / 1e9
    expected = MOTION_PER_SLIP * np.sqrt(np.mean((0.005 * 200.0 / seconds) ** 2))
    assert ground_sigma_m_s(keyframes, 200.0) == pytest.approx(expected, rel=1e-9)
    assert ground_sigma_m_s([replace(k, flow_disagreement_xy=None) for k in keyframes], 200.0) == 0.0


def strayed(keyframe: Keyframe, newest_ns: int, speed_m_s: np.ndarray, seconds: float) -> Keyframe:
    """Position and displacement as they would be measured from ground that moves by `speed_m_s`."""
    age_s = (keyframe.nav.stamp_ns - newest_ns) / 1e9
    nav = replace(keyframe.nav, position_enu_m=keyframe.nav.position_enu_m + speed_m_s * age_s)
    displacement = (
        None if keyframe.displacement is None else Displacement(keyframe.displacement.enu_m + speed_m_s * seconds)
    )
    return replace(keyframe, nav=nav, displacement=displacement)


@pytest.mark.parametrize("speed_m_s", [(0.4, 0.0, 0.0), (0.0, -0.4, 0.0)])
def test_the_answer_to_moving_ground_is_the_solutions_own(speed_m_s: tuple[float, float, float]) -> None:
    """A window solved from measurements that stray moves as (6.9) says, in poses, boresight and time offset."""
    request = request_of(2)
    before = adjust(request)
    speed, newest_ns = np.array(speed_m_s), request.keyframes[-1].nav.stamp_ns
    seconds = [0.0, *(np.diff([k.nav.stamp_ns for k in request.keyframes]) / 1e9)]
    moved = [strayed(k, newest_ns, speed, float(s)) for k, s in zip(request.keyframes, seconds, strict=True)]
    after = adjust(replace(request, keyframes=tuple(moved)))
    a, b = before.solved.solution, after.solved.solution
    layout = before.solved.layout
    noise = before.noise
    sensors = Sensors(request.config, request.R_body_cam, before.keyframes, layout, noise.factors, noise.jitter_s)
    priors = sensors.priors(request.platform, False)
    answer = ground_motion(before.keyframes, priors, a.state, a.covariance, 1.0)
    axis = int(np.argmax(np.abs(speed)))
    expected = answer.at_epoch[:, axis] * speed[axis]
    found = (b.state.centres_enu_m - a.state.centres_enu_m).ravel()
    assert found == pytest.approx(expected[layout.centres().ravel()], abs=0.25 * np.abs(found).max())
    assert answer.covariance(newest_ns) == pytest.approx(answer.at_epoch @ answer.at_epoch.T)
    # A picture of another time: its own place must hardly stray at that time, however far the others do.
    oldest = layout.centre(0)
    now, then = (
        answer.covariance(t)[oldest, oldest][axis, axis] for t in (newest_ns, before.keyframes[0].nav.stamp_ns)
    )
    assert then < 0.1 * now
