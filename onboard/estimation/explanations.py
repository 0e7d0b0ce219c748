"""Other explanations of a window's pictures: other starts, and optics or attitudes that changed within it.

Least squares find the minimum next to their start, and a window that starts from the one before inherits its minimum.
Without attitude there may be another one: a plane's pictures have a second motion, which a climb's positions do not
distinguish from the first, and in a turn an aircraft may be upside down. And lenses zoom, stabilised frames shift, and
attitudes are wrong: each is the window again with one more block of image states, or without a sensor.

One function makes one explanation; `judge` compares them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contract.feature_set import Status
from contract.rotations import exp_so3, log_so3
from onboard.estimation import ground_roughness, row_waves
from onboard.estimation.bundle_adjustment import Solution
from onboard.estimation.camera_states import COUNT, FOCAL_LENGTH, K1
from onboard.estimation.factors import (
    OWN_STATES,
    RATES,
    READ,
    SHIFT,
    STRETCH,
    WAVES,
    ZOOM,
    AttitudePrior,
    PathPrior,
    State,
)
from onboard.estimation.information import with_own_variance
from onboard.estimation.keyframe import have_attitude, observation, turned
from onboard.estimation.platform_states import STATES
from onboard.estimation.sensor_orientation import by_sensors
from onboard.estimation.sensor_table import HEADING, TILT
from onboard.estimation.window_acceptance import MIN_AHEAD
from onboard.estimation.window_problem import Outcome, Weighed, WindowProblem, from_request
from onboard.estimation.window_request import Noise, Request
from onboard.geometry.planar_ambiguity import mirrored
from onboard.geometry.plane_fit import fit_plane
from onboard.navigation.limits import RARE, SURE_SIGMAS

Array = NDArray[np.float64]

MIRRORED, SENSORS, HEADINGS, ATTITUDE = "mirrored motion", "the sensors' own start", "headings all round", "attitude"
FLIPPED = "pictures flipped"
SET_ASIDE = 1e6  # on the variance of a sensor that is to count for nothing
OPEN_LENS = {FOCAL_LENGTH: 0.3, K1: 0.1}  # one sigma of what all pictures share, under every explanation by the optics


@dataclass(frozen=True, eq=False)
class Explanation:
    """One explanation: a window with its blocks and priors, the noise that weights it, and the state it begins from.

    `freedom`: the number of states that it frees beyond those of what it is compared with.
    """

    name: str
    window: WindowProblem
    noise: Noise
    start: State
    freedom: int = 0

    def solved(self) -> Solution:
        """Solve the window under it."""
        return self.window.weighed(self.noise, self.start).solution

    def is_possible(self, solution: Solution) -> bool:
        """Return whether every image state of a solution is within three sigmas of its prior."""
        blocks = self.window.unweighed.blocks
        return not any(
            b.sigma is not None and np.abs(b.values(solution.state)).max() > SURE_SIGMAS * b.sigma for b in blocks
        )


def begun_at(name: str, request: Request, R_cam_enu: Array) -> Explanation | None:
    """Return the window begun again from these orientations (K, 3, 3); None where it cannot be set up from there."""
    keyframes = turned(request.keyframes, R_cam_enu)
    window = from_request(replace(request, keyframes=keyframes, previous=None, is_oriented=True))
    return None if isinstance(window, Outcome) else Explanation(name, window, request.noise, window.state)


def mirrored_motion(request: Request, found: Outcome) -> Explanation | None:
    """Return the second motion of the plane's pictures, if one is possible; None of a window with attitude."""
    if found.weighed is None or have_attitude(request.keyframes) or found.status is Status.LOW_PARALLAX:
        return None
    state, problem = found.weighed.solution.state, found.weighed.problem
    seen = problem.weight > 0
    plane, _ = fit_plane(state.points_enu_m[np.count_nonzero(seen, axis=0) > 1])
    R = mirrored(state.R_cam_enu, state.centres_enu_m, plane, problem.xy, seen, MIN_AHEAD)
    return None if R is None else begun_at(MIRRORED, request, R)


def sensors_own(request: Request, found: Outcome) -> Explanation | None:
    """Return the sensors' own orientations as a start, where the one that led to `found` is in doubt.

    It is where the window was refused, where the sensors are further from it than chance has them, (16.11), or, without
    attitude, where nothing confirms it yet.
    """
    has_attitude = have_attitude(request.keyframes)
    # The first start was the sensors' own if there is attitude, unless the window before gave it.
    is_other = request.previous is not None or not has_attitude
    is_doubtful = is_other and (found.status is Status.POOR_FIT or _is_far_from_sensors(found, has_attitude))
    is_confirmed = has_attitude or found.agreed is not None or bool(request.memory.windows)
    if not is_doubtful and (found.status is not Status.OK or is_confirmed):
        return None
    R = by_sensors(request.keyframes, request.platform, request.R_body_cam)
    return None if R is None else begun_at(SENSORS, request, R)


def flipped(weighed: Weighed, axis: int) -> Explanation | None:
    """Return the window with its pictures flipped along an image axis, begun from the sensors; None if impossible."""
    window, request = weighed.window, weighed.window.request
    R = by_sensors(request.keyframes, request.platform, request.R_body_cam)
    if R is None:
        return None
    keyframes = []
    for k in turned(request.keyframes, R):
        seen, uv_px = k.observation, k.observation.uv_px.copy()
        uv_px[:, axis] = seen.camera.size_px[axis] - 1.0 - uv_px[:, axis]
        keyframes.append(replace(k, observation=observation(seen.camera, seen.ids, uv_px, seen.moving)))
    tried = from_request(replace(request, keyframes=tuple(keyframes), previous=None, is_oriented=True))
    if isinstance(tried, Outcome):
        return None
    if np.array_equal(tried.ids, window.ids):
        tried = tried.with_problem(weight=np.where(window.unweighed.weight > 0.0, tried.unweighed.weight, 0.0))
    return Explanation(FLIPPED, tried, weighed.noise, tried.state)


def _is_far_from_sensors(found: Outcome, has_attitude: bool) -> bool:
    """Return whether a sensor's residuals in an accepted solution are larger than chance explains. (16.11)"""
    if found.solved is None or found.weighed is None:
        return False
    for prior in found.weighed.problem.priors:
        if isinstance(prior, PathPrior) or (has_attitude and isinstance(prior, AttitudePrior)):
            r = prior.evaluate(found.solved.solution.state)[0]
            if float(r @ r) - len(r) > RARE:
                return True
    return False


def other_starts(request: Request, found: Outcome) -> Iterator[Explanation]:
    """The starts that `found` is to be compared with."""
    for explanation_of in (mirrored_motion, sensors_own):
        explanation = explanation_of(request, found)
        if explanation is not None:
            yield explanation


@dataclass(frozen=True, eq=False)
class OpenOptics:
    """A window as every explanation by its optics has it: lens and rows are open, and its solution with that alone.

    A camera file that is wrong is no zoom; and rates and vibration of rows, declared or not, scale and shear each
    picture by itself. `lens`: the solution with the lens alone. `closed`: the window with the camera file's lens.
    """

    window: WindowProblem
    solution: Solution
    noise: Noise
    lens: Solution
    closed: WindowProblem

    @property
    def pictures(self) -> int:
        """The number of pictures."""
        return self.window.layout.keyframes


def open_optics(weighed: Weighed) -> OpenOptics:
    """Open the lens and the rows of a window that was solved with both as they are known."""
    optics = open_lens(weighed)
    window, solution = _with_open_rows(optics.window, optics.noise, optics.lens)
    return replace(optics, window=window, solution=solution)


def open_lens(weighed: Weighed) -> OpenOptics:
    """Open the lens of a window that was solved with it as it is known; the rows stay as they are."""
    window = weighed.window
    stated = from_request(with_open_lens(replace(window.request, keyframes=window.keyframes, is_oriented=True)))
    assert isinstance(stated, WindowProblem)
    # A sensor that was found to fail may have been innocent.
    noise = replace(weighed.noise, factors=replace(weighed.noise.factors, groups={}))
    # Nor do hills contradict the pictures, whose points all lie above or below a plane together.
    hold = ground_roughness.correlated(weighed.problem, weighed.solution, stated.unweighed.ground_weight)
    weight = np.where(window.unweighed.weight > 0.0, stated.unweighed.weight, 0.0)
    stated = stated.with_problem(ground_weight=hold, weight=weight)
    lens = stated.weighed(noise, stated.state).solution
    return OpenOptics(stated, lens, noise, lens, window.with_problem(ground_weight=hold))


def with_open_lens(request: Request) -> Request:
    """The request with focal length and k1 open, whatever the camera file claims."""
    platform = request.platform.with_camera()
    covariance = platform.covariance
    for state, sigma in OPEN_LENS.items():
        covariance = with_own_variance(covariance, STATES + state, sigma**2)
    taken = request.camera_taken if len(request.camera_taken) else np.zeros(COUNT)
    return replace(request, platform=replace(platform, covariance=covariance), camera_taken=taken)


def _with_open_rows(window: WindowProblem, noise: Noise, solution: Solution) -> tuple[WindowProblem, Solution]:
    """The window, whose own solution is given, with rates and waves of its rows that nothing measures; its solution."""
    rates = window.with_rows_in_turn()
    state = solution.state if rates.layout == window.layout else solution.state.with_block(rates.layout, RATES)
    solution = rates.weighed(noise, state).solution
    waves = row_waves.seen(rates.problem(noise), solution)
    if waves is None:
        return rates, solution
    vibrating = rates.vibrating(waves)
    return vibrating, vibrating.weighed(noise, solution.state.with_block(vibrating.layout, WAVES)).solution


def zoomed(optics: OpenOptics) -> Explanation:
    """A focal length of each picture's own; the first picture's is fixed."""
    return _of_each(optics, optics.window.with_block(ZOOM), ZOOM, optics.pictures - 1)


def stretched(optics: OpenOptics) -> Explanation:
    """A width of each picture's own, against its height."""
    return _of_each(optics, optics.window.with_block(STRETCH), STRETCH, optics.pictures)


def read_longer(optics: OpenOptics) -> Explanation:
    """A readout of each picture's own, beyond the one that is known."""
    return _of_each(optics, optics.window.with_readout(), READ, optics.pictures)


def _of_each(optics: OpenOptics, tried: WindowProblem, block: str, free: int) -> Explanation:
    """An image block, the last of a window, of each picture's own, free in so many of them."""
    start = optics.solution.state.with_block(tried.layout, block)
    return Explanation(block, tried, optics.noise, start, OWN_STATES[block] * free)


def attitude_aside(optics: OpenOptics, start: State | None = None) -> Explanation:
    """All attitudes ignored, from a state: by default the optics' own solution."""
    factors = replace(optics.noise.factors, groups=dict.fromkeys((TILT, HEADING), SET_ASIDE))
    noise = replace(optics.noise, factors=factors)
    return Explanation(ATTITUDE, optics.window, noise, start or optics.solution.state, 3 * optics.pictures)


def attitude_aside_as_shifted(optics: OpenOptics, shifted: State) -> Explanation:
    """All attitudes ignored, from where shifts have led, each taken for the rotation that moves its picture as far."""
    x, y = shifted.own[:, -2:].T
    R = exp_so3(np.column_stack([-y, x, np.zeros(len(x))])) @ shifted.R_cam_enu
    return attitude_aside(optics, replace(shifted, R_cam_enu=R, own=optics.solution.state.own))


def shifted(optics: OpenOptics, without_attitude: State) -> Explanation:
    """A shift of each frame, that begins by hiding how far the pictures' rotations part from the attitudes'. (19.5)

    `without_attitude`: the solution of `attitude_aside`. The first picture's shift is fixed.
    """
    tried = optics.window.with_block(SHIFT)
    asked = tried.request
    R = by_sensors(asked.keyframes, asked.platform, asked.R_body_cam)
    assert R is not None
    hidden = log_so3(without_attitude.R_cam_enu @ R.transpose(0, 2, 1))
    own = optics.solution.state.with_block(tried.layout, SHIFT).own.copy()
    own[:, -2:] = np.column_stack([hidden[:, 1], -hidden[:, 0]]) - [hidden[0, 1], -hidden[0, 0]]
    start, freedom = replace(without_attitude, R_cam_enu=R, own=own), OWN_STATES[SHIFT] * (optics.pictures - 1)
    return Explanation(SHIFT, tried, optics.noise, start, freedom)
