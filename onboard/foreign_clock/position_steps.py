"""Steps of the positions that photographs state, by the pictures' own motion. (28.14) to (28.19)

A receiver that begins again states every position from then on elsewhere by the same vector. In the positions alone it
looks like a turn; but the pictures' motion, to scale, is that of the other intervals about it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from contract.rotations import exp_so3
from onboard.foreign_clock.picture_pairs import Pairs
from onboard.navigation.limits import LIKELY_SIGMAS
from onboard.navigation.position_jumps import EXPLAINED_SHARE

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

SIDE = 2  # intervals before and after one, by which it is judged
MATCH, RELIEF, PLACE_M = 0.003, 0.05, 0.5  # as shares of the height, of the way in heights, and m: one sigma
MEDIAN_2D = float(np.sqrt(2.0 * np.log(2.0)))  # of a distance in two dimensions, in sigmas of each
ODDS = 1000.0  # that a flight without a step shows none
ASSUMED = 4  # intervals that the assumed scatter counts as
TOP_AHEAD = np.diag([1.0, -1.0, -1.0])  # R of a picture straight down, whose top is ahead
LEAST_DOWN = 0.5  # of the ground's direction along the camera's axis: it may look 60 degrees off
BRIDGES = ((1, 0), (0, 1), (1, 1), (2, 0), (0, 2), (3, 0), (0, 3))  # intervals before and after an unknown one
SAME_SIZE = 0.3  # of the logarithm of a picture's scale: more is another match, not another place


@dataclass(frozen=True, eq=False)
class Intervals:
    """From each of N pictures to the next, (N - 1,) each; nan where it was not found.

    `way`: where the second was, in heights and in the first's axes, x + iy; `turn`: of the axes, a unit number;
    `warp`: what a similarity leaves over, as the tilt that it is by.
    """

    way: Complex
    turn: Complex
    warp: Array


def intervals(pairs: Pairs, R_enu_cam: Sequence[Array | None]) -> Intervals:
    """Return the intervals by pairs of pictures, whose moments are the pictures' numbers; axes are east and north of
    pictures with an attitude, else right and up in the picture. An interval of which no pair is found is what pairs
    farther apart have beyond its neighbours. (28.14), (28.22)
    """
    count = len(R_enu_cam) - 1
    out = Intervals(np.full(count, np.nan, complex), np.ones(count, complex), np.zeros(count))
    bridges: list[tuple[int, int, complex, complex, float]] = []
    for (first, second), at, to in zip(pairs.moments_ns.tolist(), pairs.at, pairs.to, strict=True):
        between = _between(at, to, R_enu_cam[first], R_enu_cam[second])
        if between is not None and second == first + 1:
            out.way[first], out.turn[first], out.warp[first] = between
        elif between is not None:
            bridges.append((first, second, *between))
    for first, second, way, turn, warp in sorted(bridges, key=lambda bridge: bridge[1] - bridge[0]):
        _fill(out, range(first, second), way, turn, warp)
    return out


def _between(
    at: Array, to: Array, R_first: Array | None, R_second: Array | None
) -> tuple[complex, complex, float] | None:
    """Way, turn and warp of a pair of pictures; None where its scale is another match's."""
    if R_first is None or R_second is None:
        R_first, R_second = _upright(at, to)
    a, b = _level(at, R_first), _level(to, R_second)
    middle_a, middle_b = complex(a.mean()), complex(b.mean())
    size = float(np.mean(np.abs(a - middle_a) ** 2))
    similar = complex(np.vdot(a - middle_a, b - middle_b)) / (len(a) * size)
    if abs(np.log(abs(similar))) > SAME_SIZE:
        return None
    left = (b - middle_b) / similar - (a - middle_a)
    return middle_a - middle_b / similar, similar / abs(similar), float(np.sqrt(np.mean(np.abs(left) ** 2))) / size


def _fill(out: Intervals, spanned: range, way: complex, turn: complex, warp: float) -> None:
    """Take the one unknown interval of those that a pair of pictures farther apart spans from it and the others: what
    they leave of its way. (28.22)
    """
    unknown = [k for k in spanned if not np.isfinite(out.way[k])]
    if len(unknown) != 1:
        return
    (at,), turned = unknown, 1.0 + 0.0j
    others = np.array([k for k in spanned if k != at])
    for k in spanned[: at - spanned.start]:
        way, turned = way - out.way[k] / turned, turned * out.turn[k]
    after = 1.0 + 0.0j
    for k in reversed(spanned[at + 1 - spanned.start :]):
        after = after * out.turn[k]
    own = turn / (turned * after)
    left, axes = way * turned, own  # in the axes of the interval's own first picture
    for k in spanned[at + 1 - spanned.start :]:
        left, axes = left - out.way[k] / axes, axes * out.turn[k]
    # The relief is the same ground's: it is not added again.
    variance = warp**2 + float(np.sum(out.warp[others] ** 2)) + MATCH**2 * len(others)
    out.way[at], out.turn[at], out.warp[at] = left, own, np.sqrt(variance)


def bridging(found: Intervals) -> list[tuple[int, int]]:
    """Return the pairs of pictures farther apart that may show what intervals next to known ones do not."""
    last, known = len(found.way), np.isfinite(found.way)
    out: set[tuple[int, int]] = set()
    for at in np.flatnonzero(~known).tolist():
        for first, second in ((at - before, at + 1 + after) for before, after in BRIDGES):
            others = [k for k in range(first, second) if k != at]
            if first >= 0 and second <= last and known[others].all():
                out.add((first, second))
    return sorted(out)


def _upright(at: Array, to: Array) -> tuple[Array, Array]:
    """Attitudes (3, 3) of two pictures, headings aside, by the ground plane that their motion is of. (28.15)

    Of the planes that it may be of the one that is most nearly in front is taken: an aircraft flies along the ground.
    """
    H = cv2.getPerspectiveTransform(at.astype(np.float32), to.astype(np.float32))
    _, turns, _, normals = cv2.decomposeHomographyMat(H, np.eye(3))
    best = max(range(len(normals)), key=lambda k: abs(float(normals[k][2, 0])))
    down = normals[best][:, 0] * np.sign(normals[best][2, 0])
    if down[2] < LEAST_DOWN:
        return TOP_AHEAD, TOP_AHEAD
    return _turned_down(down), _turned_down(turns[best] @ down)


def _turned_down(down_cam: Array) -> Array:
    """The smallest turn (3, 3) on looking straight down that takes a direction to down."""
    direction = TOP_AHEAD @ down_cam
    across = np.cross(direction, (0.0, 0.0, -1.0))
    sine = float(np.linalg.norm(across))
    angle = float(np.arctan2(sine, -direction[2]))
    return np.asarray(exp_so3(across * (angle / sine if sine > 0.0 else 1.0)) @ TOP_AHEAD, np.float64)


def _level(xy: Array, R_enu_cam: Array) -> Complex:
    """Directions (4, 2) as places on level ground one height below, x + iy."""
    rays = np.concatenate([xy, np.ones((len(xy), 1))], axis=1) @ R_enu_cam.T
    return np.asarray((rays[:, 0] + 1j * rays[:, 1]) / np.maximum(-rays[:, 2], 0.05), complex)


@dataclass(frozen=True)
class Step:
    """A step: m east + i north, and one sigma of it, m."""

    moved_m: complex
    sigma_m: float


def steps(east_north_m: Array, found: Intervals, claims_m: Array) -> dict[int, Step]:
    """Return the steps of positions (N, 2) by the interval they are in. (28.16) to (28.18)

    `claims_m` (N,): one sigma of each position, horizontal: what is no more than likely under it is no step.
    """
    moved = np.diff(east_north_m[:, 0] + 1j * east_north_m[:, 1])
    known = np.isfinite(found.way)
    most = np.count_nonzero(known) // 2
    if np.count_nonzero(known) <= SIDE:
        return {}
    height_m = float(np.median(np.abs(moved[known]) / np.maximum(np.abs(found.way[known]), 1e-6)))
    relative = np.sqrt(found.warp**2 + MATCH**2 + (RELIEF * np.abs(found.way)) ** 2)
    sigma_m = np.hypot(height_m * relative, PLACE_M)
    least_m = LIKELY_SIGMAS * np.hypot(np.maximum(claims_m[:-1], claims_m[1:]), PLACE_M)
    out: dict[int, Step] = {}
    while True:
        miss, in_sigmas = _misses(moved, found, sigma_m, out)
        candidates = np.where(np.abs(miss) > least_m, np.nan_to_num(in_sigmas), 0.0)
        candidates[list(out)] = 0.0
        worst = int(np.argmax(candidates))
        one_more = out | {worst: Step(complex(miss[worst]), 0.0)}
        scatter, chance = _scatter(moved, found, sigma_m, one_more)  # which a step that counts as none would widen
        if candidates[worst] <= chance * scatter or len(one_more) > most + 1:
            sigmas_m = _scatter(moved, found, sigma_m, out)[0] * np.abs(miss) / in_sigmas
            return {at: Step(complex(miss[at]), float(sigmas_m[at])) for at in sorted(out)}
        out = one_more


def _scatter(moved: Complex, found: Intervals, sigma_m: Array, stepped: Mapping[int, Step]) -> tuple[float, float]:
    """The flight's own scatter in sigmas, by the intervals that no step is in and by what is assumed where they are
    few; and of how many of these scatters one interval is by chance, once in a thousand flights. (28.18)
    """
    _, in_sigmas = _misses(moved, found, sigma_m, stepped)
    in_sigmas[list(stepped)] = np.nan
    judged = in_sigmas[np.isfinite(in_sigmas)]
    own = float(np.median(judged)) / MEDIAN_2D if len(judged) else 1.0
    scatter = np.sqrt((ASSUMED + len(judged) * own**2) / (ASSUMED + len(judged)))
    freedoms = ASSUMED + np.log(2.0) ** 2 * len(judged)  # a median is worth less than a mean of squares
    chance = np.sqrt(2.0 * freedoms * np.expm1(np.log(ODDS * (len(judged) + 1)) / freedoms))
    return float(scatter), float(chance)


def _misses(moved: Complex, found: Intervals, sigma_m: Array, stepped: Mapping[int, Step]) -> tuple[Complex, Array]:
    """The way of each interval beyond what its neighbours make of its pictures, and that in sigmas. (28.17)"""
    miss, in_sigmas = np.full(len(moved), np.nan, complex), np.full(len(moved), np.nan)
    for at in np.flatnonzero(np.isfinite(found.way)).tolist():
        others = _neighbours(at, found, stepped)
        if not others:
            continue
        index = np.array([j for j, _ in others])
        ways = found.way[index] * np.array([turn for _, turn in others])
        weight = sigma_m[index] ** -2.0
        information = float(np.sum(weight * np.abs(ways) ** 2))
        if information <= 0.0:
            continue
        scale = np.sum(weight * np.conj(ways) * moved[index]) / information
        miss[at] = moved[at] - scale * found.way[at]
        in_sigmas[at] = abs(miss[at]) / np.hypot(sigma_m[at], abs(found.way[at]) / np.sqrt(information))
    return miss, in_sigmas


def _neighbours(at: int, found: Intervals, stepped: Mapping[int, Step]) -> list[tuple[int, complex]]:
    """The nearest intervals on both sides that no step is known in, and the turn of their axes into this one's."""
    out: list[tuple[int, complex]] = []
    for side in (-1, 1):
        turn, j, count = 1.0 + 0.0j, at, 0
        while count < SIDE:
            turn = turn if side < 0 else turn / found.turn[j]
            j += side
            if not 0 <= j < len(found.way) or not np.isfinite(found.way[j]):
                break
            turn = turn * found.turn[j] if side < 0 else turn
            if j not in stepped:
                out.append((j, turn))
                count += 1
    return out


@dataclass(frozen=True, eq=False)
class Joined:
    """Positions less their steps: what is to be added to each (N,), m east + i north; by how much less certain each is
    then, one sigma (N,), m; and how far all of them may be off together, m.
    """

    add_m: Complex
    sigma_m: Array
    doubt_m: float


def joined(count: int, found: Mapping[int, Step], claim_m: float) -> Joined:
    """Return what joins N positions. (28.19)

    Where a step is undone, the positions between are off, as they are in flight. Which side of another one is right,
    nothing shows: all are put halfway between the farthest two.
    """
    at, sigma_m = np.zeros(count, complex), np.zeros(count)
    levels = [(0.0 + 0.0j, 0.0)]  # (where positions are, the variance of that), none of which is undone so far
    here, variance = levels[0]
    for before, step in sorted(found.items()):
        here, variance = here + step.moved_m, variance + step.sigma_m**2
        same = next(
            (i for i in range(len(levels)) if _is_back(here, [place for place, _ in levels[i:]], claim_m)), None
        )
        if same is None:
            levels.append((here, variance))
        else:
            here, variance = levels[same]
            del levels[same + 1 :]
        at[before + 1 :], sigma_m[before + 1 :] = here, np.sqrt(variance)
    places = np.array([place for place, _ in levels])
    apart = np.abs(places[:, None] - places)
    one, other = np.unravel_index(int(np.argmax(apart)), apart.shape)
    middle = 0.5 * (places[one] + places[other])
    return Joined(middle - at, sigma_m, float(np.abs(places - middle).max()))


def _is_back(here: complex, since: list[complex], claim_m: float) -> bool:
    """Return whether positions are where they were at the first of some places since."""
    farthest_m = max(abs(place - since[0]) for place in since)
    return abs(here - since[0]) <= max(LIKELY_SIGMAS * claim_m, EXPLAINED_SHARE * farthest_m)
