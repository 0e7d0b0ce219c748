"""One thing followed from picture to picture, against the ground's own motion. (24.6) to (24.9)

Two things speak for a place: it looks as the thing did (correlation), and something is there that was not there before
(`backdrop`). A person from 120 m is four pixels: features of its own it has none, and a window about it is mostly
ground. A thing at rest shows no difference and goes with the ground.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from contract.track import Unseen
from contract.track_age import ACCELERATION_M_S2, LOST_AFTER_S, TURN_RAD_S
from onboard.geometry.plane_homography import move
from onboard.tracks.backdrop import AGES_S, Change, Patch, cut, difference, earlier, suggested
from onboard.tracks.ground_steps import Pictures, Seen
from onboard.tracks.looks import RIM_PX, Look, Wanted, cover_of

Array = NDArray[np.float64]
Image = NDArray[np.float32]

LEAST_SIZE_PX, USUAL_SIZE_PX, MOST_SIZE_PX = 3.0, 9.0, 48.0
SIZE_BY_ROOT = 1.15  # of the area that it changes
MOST_REACH_PX = 40  # that a thing is looked for about where it should be
FASTEST_M_S = 25.0
USUAL_M_PX = 0.15  # on the ground, where no set gives a better one
CLICK_SIGMA_PX, CLICK_REACH_PX = 1.5, 10.0
SURE_DIFFERENCE, SURE_LIKENESS, LEAST_LIKENESS = 0.35, 0.8, 0.5
CHANGED = 0.3  # how surely a pixel must differ to belong to a region that does
AGAIN_S, LEAST_AGAIN = 0.3, 0.65  # unseen for so long it must look so much as it did: more places are compared
STOOD_S = 0.5  # at one place, after which what changes there is first of all the ground that it uncovers
# What must differ within a thing's size about where it stood, for it not to be taken as there: px, and of its area.
LEFT_PX2, LEFT_SHARE = 1.5, 0.02
LEFT_REACH_PX = 1.5  # of where it stood: what looks like it so near is the ground about it
# How near to the picture's edge its middle is still looked for: a share of its size, and px.
EDGE_SHARE, LEAST_EDGE_PX = 0.5, 3.0
COURSE_SIGMAS = 4.0  # of the speed, from which a thing is known to turn with its course
MOST_AGE_S = AGES_S[len(AGES_S) // 2]  # since then most of the pictures by which the ground behind is known are taken
OLD_S = 1.0  # age of the older of the two looks that are remembered
PRIOR_WEIGHT = 0.04
OTHERS_APART_M = 30.0  # from one moving thing to the next, where nothing else shows how many there are
USUAL_SPREAD, SPREAD_LEARNED = 30.0, 0.1  # one sigma of a thing's grey levels at first, and the share each picture adds
SURE_ODDS = 3.0  # logarithm of the odds that something is the thing and not another
CLIMB_SHARE = 0.12  # of its size, from where what has changed is likeliest to where it looks most like the thing
CHAIN_PX2 = 0.01  # variance of a step of the ground, and of what a walking thing does within one
# So many times as large as it was: something else is there too, and one sigma of its place is that share of its size.
MERGED, MERGED_SHARE = 1.2, 0.6
# One sigma of the middle of what differs, as a share of its size, at first; more of a large thing, which moves over
# itself. And the share that each picture adds to what is learned of it.
SPREAD, LARGE_PX, MIDDLE_LEARNED = 0.06, 8.0, 0.1
# Where nothing has changed by more than so much, and the thing looks elsewhere better by at most so much, it stands.
UNCHANGED, STILL_LIKENESS, STILL_SIGMA_PX = 0.1, 0.05, 0.3


@dataclass(frozen=True, eq=False)
class Observation:
    """The place (2,) of a thing in a picture, px, one sigma of it, its size, and why it was not seen, if it was not."""

    seen: Seen
    uv_px: Array
    sigma_px: float
    size_px: float
    unseen: Unseen = Unseen.NONE

    @property
    def is_seen(self) -> bool:
        return self.unseen is Unseen.NONE


@dataclass(frozen=True, eq=False)
class _Window:
    """The places (N, N, 2), px, in a patch at which it is looked for, N = 2 reach + 1, and what is known of each.

    `far`: its squared distance from the prediction over that covariance, `spread_px2` the area that this covers.
    `differs`: the sureness that a thing of its size there is something that was not there before; None without
    `changed`. `has_left`: it is not where it stood.
    """

    patch: Patch
    reach: int
    place: Array
    far: Array
    spread_px2: float
    changed: Change | None
    differs: Image | None
    has_left: bool

    def at(self, j: int, i: int) -> NDArray[Any]:
        """Return the pixel (2,) of the patch, column and row, that a place is."""
        return np.array([i, j]) - self.reach + self.patch.middle


class Follower:
    """Follows one thing; `begin` at the clicked picture, `follow` through those that come after it, in order."""

    def __init__(self, pictures: Pictures, clicked: Seen, uv_px: Array, m_px: float | None = None) -> None:
        self._pictures = pictures
        self._m_px = m_px or USUAL_M_PX
        self._seen = clicked
        self._size = USUAL_SIZE_PX
        self._uv = np.asarray(uv_px, float)
        self._is_size_known = self._find_size()
        self._last_seen_ns = clicked.stamp_ns
        self._moved_ns = clicked.stamp_ns - (0 if self._is_size_known else round(1e9 * STOOD_S))
        fastest = FASTEST_M_S / 2.0 / self._m_px
        self._velocity = np.zeros(2)  # against the ground, px/s
        self._cov = np.diag([CLICK_SIGMA_PX**2] * 2 + [fastest**2] * 2)
        self._looks: list[Look] = []
        self._spread = USUAL_SPREAD  # of its own grey levels, from picture to picture
        self._middle_share = 0.0  # of its size: one sigma of the middle of what differs, once that was learned
        self._rest = self._uv.copy()  # where it is if it has stood since it was last seen to move
        self._stood, self._stood_ns = self._uv.copy(), clicked.stamp_ns if self._stands() else 0  # when it stood last
        self._as_stood, self._is_gone = clicked, False  # the last picture in which nothing had changed where it stands
        self._may_be_away = False  # it may have gone without being seen, and nothing that differs has been it since
        self._been = [(self._there_since_ns(), self._uv.copy())]  # when it was seen where, MOST_AGE_S back
        self._remember()

    @property
    def uv_px(self) -> Array:
        """The pixel (2,) at which the thing is now, seen or predicted."""
        return self._uv

    @property
    def size_px(self) -> float:
        return self._size

    @property
    def has_look(self) -> bool:
        """True if there was anything to be followed: a click at the very border has none."""
        return bool(self._looks)

    def is_lost(self, seen: Seen) -> bool:
        return self.unseen_s(seen) > LOST_AFTER_S

    def unseen_s(self, seen: Seen) -> float:
        """Return the time from when it was seen last to a picture."""
        return (seen.stamp_ns - self._last_seen_ns) * 1e-9

    def passed_over(self, seen: Seen) -> Observation:
        """Take a picture in which it is not looked for."""
        self._seen = seen
        return self._unseen(Unseen.NO_PICTURE)

    def follow(self, seen: Seen) -> Observation:
        """Look for it in the next picture."""
        H = self._pictures.between(self._seen, seen)
        dt = (seen.stamp_ns - self._seen.stamp_ns) * 1e-9
        self._seen = seen
        if H is None:
            return self._unseen(Unseen.NO_GROUND)
        self._predict(H, dt)
        height, width = seen.image.shape
        inner = max(EDGE_SHARE * self._size, LEAST_EDGE_PX)
        if (self._uv < inner).any() or (self._uv > (width - 1.0 - inner, height - 1.0 - inner)).any():
            return self._unseen(Unseen.OFF_PICTURE)
        reach = self._reach()
        half = self._half()
        patch = cut(seen, self._uv, reach + half + 6)
        changed = difference(self._pictures, seen, patch, self._size)
        is_again = self.unseen_s(seen) > AGAIN_S
        whole, since = changed, None if changed is None else self._since_it_left(seen, changed, patch)
        has_left = self._is_gone and changed is not None
        if has_left:
            self._unless_away(changed, self._rest, 0.0)
        if changed is not None and (self._stands() or is_again) and seen.stamp_ns - self._stood_ns < AGES_S[-1] * 1e9:
            changed = replace(changed, surely=self._without_uncovered(changed, self._stood))
        wanted = Wanted.of(self._looks, half, self._size, self._known_velocity(), self._spread)
        window = self._window(patch, changed, reach, has_left, self._uv, self._cov[:2, :2])
        found = self._best(window, wanted, LEAST_AGAIN if is_again else LEAST_LIKENESS)
        by_look = found is not None
        if found is None:
            found = self._otherwise(window, wanted)
        if found is None and whole is not None and since is not None and not self._is_size_known:
            found = self._set_off(replace(window, changed=whole), since)
        if found is None:
            return self._unseen(Unseen.HIDDEN)
        uv, sigma = found
        is_still, self._may_be_away = uv is self._rest, False
        self._update(uv, sigma)
        if not is_still:
            self._rest, self._moved_ns = self._uv.copy(), seen.stamp_ns
        self._last_seen_ns = seen.stamp_ns
        self._been.append((seen.stamp_ns, uv.copy()))
        if self._stands():
            self._stood, self._stood_ns = self._rest.copy(), seen.stamp_ns
        if by_look and sigma < MERGED_SHARE * self._size:
            self._learn_spread(seen, uv, wanted)
            self._remember(changed, wanted)
        return Observation(seen, uv, sigma, self._size)

    def _stands(self) -> bool:
        """Return whether it has stood for a while, as far as it was seen."""
        return self._last_seen_ns - self._moved_ns >= STOOD_S * 1e9

    def _there_since_ns(self) -> int:
        """When it came to where it was clicked, as far as earlier pictures show; 0 if it was there in all of them."""
        if not self._is_size_known:
            return 0
        since_ns, patch = self._seen.stamp_ns, cut(self._seen, self._uv, self._half() + 6)
        for other in earlier(self._pictures, self._seen):
            changed = difference(self._pictures, self._seen, patch, self._size, other)
            if changed is None or self._differs_at(self._uv, changed) >= self._left_px2():
                break
            since_ns = other.stamp_ns
        return since_ns

    def _has_been_at(self, uv: Array) -> bool:
        """Return whether it has been seen within its size of a place since most of the earlier pictures. (24.25)

        What has not is in few of them, so that it differs from them now.
        """
        if self.unseen_s(self._seen) > AGAIN_S and not self._stands():
            return False
        before_ns = self._seen.stamp_ns - MOST_AGE_S * 1e9
        is_near = [float(np.hypot(*(at - uv))) < self._size for _, at in self._been]
        return self._been[0][0] <= before_ns and all(is_near)

    def _since_it_left(self, seen: Seen, changed: Change, patch: Patch) -> Change | None:
        """What has changed since the last picture in which nothing had changed where it stood, if it is no longer there
        (`_is_gone`). What has passed before it is none of this: then it looks as it did before. (24.26)
        """
        if not self._stands() or (not self._is_gone and self._differs_at(self._rest, changed) < self._left_px2()):
            self._as_stood, self._is_gone = seen, False
            return None
        since = None if self._as_stood is seen else difference(self._pictures, seen, patch, self._size, self._as_stood)
        self._is_gone = since is None or self._differs_at(self._rest, since) >= self._left_px2()
        return since if self._is_gone else None

    def _set_off(self, found: _Window, since: Change) -> tuple[Array, float] | None:
        """Where something differs that is likely the thing that stood, once it has left its place whole: what has
        changed there since is its cover, and what was seen there then its own grey. None if there is none. (24.30)
        """
        about = since.surely - self._without_uncovered(since, self._rest)
        if max(about[0].max(), about[-1].max(), about[:, 0].max(), about[:, -1].max()) > CHANGED:
            return None  # more of it may lie beyond
        size = _within(SIZE_BY_ROOT * float(np.sqrt(about.sum())))
        kept = self._looks, self._size
        self._size = size
        half = self._half()
        if half + found.reach + 1 <= found.patch.middle and found.changed is not None:
            look = Look(self._as_stood.stamp_ns, Patch(since.behind, since.corner), self._rest.copy(), np.zeros(2),
                        np.eye(2), about)  # fmt: skip
            self._looks, self._is_size_known = [look], True
            left = self._without_uncovered(found.changed, self._rest)
            changed = replace(found.changed, surely=left)
            since_s = (self._seen.stamp_ns - self._as_stood.stamp_ns) * 1e-9
            sigma_px = float(np.hypot(CLICK_SIGMA_PX, 0.5 * ACCELERATION_M_S2 / self._m_px * since_s**2))
            window = self._window(
                found.patch, changed, found.reach, found.has_left, self._rest, sigma_px**2 * np.eye(2)
            )
            at = self._otherwise(window, Wanted.of(self._looks, half, size, np.zeros(2), self._spread))
            if at is not None and np.hypot(*(at[0] - self._rest)) >= size:
                return at
        (self._looks, self._size), self._is_size_known = kept, False
        return None

    def _left_px2(self) -> float:
        return max(LEFT_PX2, LEFT_SHARE * self._size**2)

    def _differs_at(self, uv: Array, changed: Change) -> float:
        """The area, px2, that surely differs within its size about a place."""
        column, row = uv - changed.corner
        half = max(0.5 * self._size, LEFT_REACH_PX)
        rows, columns = np.ogrid[: len(changed.surely), : len(changed.surely)]
        return float(changed.surely[(np.abs(rows - row) <= half) & (np.abs(columns - column) <= half)].sum())

    def _unseen(self, unseen: Unseen) -> Observation:
        sigma = float(np.sqrt(0.5 * np.trace(self._cov[:2, :2])))
        return Observation(self._seen, self._uv.copy(), sigma, self._size, unseen)

    def _predict(self, H: Array, dt: float) -> None:
        """(24.6): with the ground, and on with its own velocity."""
        near = move(H, self._uv + np.array([[0.0, 0.0], [0.5, 0.0], [-0.5, 0.0], [0.0, 0.5], [0.0, -0.5]]))
        J = np.stack([near[1] - near[2], near[3] - near[4]], axis=1)
        before_ns = self._seen.stamp_ns - MOST_AGE_S * 1e9
        # Those since then, and the last before.
        been = self._been[max(sum(at_ns <= before_ns for at_ns, _ in self._been) - 1, 0) :]
        places = move(H, np.stack([self._rest, self._stood, *(uv for _, uv in been)]))
        self._rest, self._stood = places[:2]
        self._been = [(at_ns, uv) for (at_ns, _), uv in zip(been, places[2:], strict=True)]
        self._velocity = J @ self._velocity
        self._uv = near[0] + self._velocity * dt
        q = (ACCELERATION_M_S2 / self._m_px + TURN_RAD_S * float(np.hypot(*self._velocity))) ** 2
        F = np.zeros((4, 4))
        F[:2, :2] = F[2:, 2:] = J
        F[:2, 2:] = dt * J
        self._cov = F @ self._cov @ F.T
        for i in (0, 1):
            self._cov[i, i] += q * dt**4 / 4.0 + CHAIN_PX2
            self._cov[i, i + 2] += q * dt**3 / 2.0
            self._cov[i + 2, i] += q * dt**3 / 2.0
            self._cov[i + 2, i + 2] += q * dt**2
        self._looks = [replace(look, turned=J @ look.turned) for look in self._looks]

    def _update(self, uv: Array, sigma: float) -> None:
        gain = self._cov[:, :2] @ np.linalg.inv(self._cov[:2, :2] + sigma**2 * np.eye(2))
        change = gain @ (uv - self._uv)
        self._uv, self._velocity = self._uv + change[:2], self._velocity + change[2:]
        left = np.eye(4) - gain @ np.eye(4)[:2]
        self._cov = left @ self._cov @ left.T + sigma**2 * gain @ gain.T

    def _reach(self) -> int:
        sigma = float(np.sqrt(np.linalg.eigvalsh(self._cov[:2, :2])[-1]))
        return int(np.clip(np.ceil(3.0 * sigma + 1.0), 3, MOST_REACH_PX))

    def _half(self) -> int:
        return int(np.clip(np.ceil(0.75 * self._size), 3, 30))

    def _window(
        self, patch: Patch, changed: Change | None, reach: int, has_left: bool, about: Array, cov: Array
    ) -> _Window:
        """The places about the middle of a patch, with what is known of each before its look; it is predicted `about`
        (2,), px, with the covariance (2, 2).
        """
        steps = np.arange(-reach, reach + 1, dtype=float)
        place = np.asarray(np.stack(np.meshgrid(steps, steps), axis=-1) + patch.corner + patch.middle, float)
        off, cov = place - about, cov + 0.25 * np.eye(2)
        far = np.einsum("ijk,kl,ijl->ij", off, np.linalg.inv(cov), off)
        spread_px2 = 2.0 * np.pi * float(np.sqrt(np.linalg.det(cov)))
        if changed is None:
            return _Window(patch, reach, place, far, spread_px2, None, None, has_left)
        cover = cv2.GaussianBlur(changed.surely, (0, 0), max(0.3 * self._size, 0.8))
        inner = slice(patch.middle - reach, patch.middle + reach + 1)
        differs = np.asarray(np.clip(1.6 * cover[inner, inner], 0.0, 1.0), np.float32)
        return _Window(patch, reach, place, far, spread_px2, changed, differs, has_left)

    def _best(self, found: _Window, wanted: Wanted, least: float) -> tuple[Array, float] | None:
        """(24.7): the likeliest place in the picture and its one sigma; None if none looks like it by `least`."""
        patch, changed, place, here = found.patch, found.changed, found.place, found.differs
        half, reach = wanted.mask.shape[0] // 2, found.reach
        window = slice(patch.middle - reach - half, patch.middle + reach + half + 1)
        likeness = wanted.likeness(patch.image[window, window])
        score = likeness - PRIOR_WEIGHT * found.far
        inner = max(EDGE_SHARE * self._size, LEAST_EDGE_PX)
        height, width = self._seen.image.shape
        if patch.inside is not None:  # what is cut by the picture's edge is not compared
            score[((place < inner) | (place > (width - 1.0 - inner, height - 1.0 - inner))).any(axis=-1)] = -np.inf
        arrived = None
        if changed is not None and here is not None:
            # Where the ground behind looks more like the thing than the picture does, it has gone from there.
            if here.max() > 0.0:
                arrived = np.where(likeness > wanted.likeness(changed.behind[window, window]), here, 0.0)
            else:
                arrived = here
            score = score + arrived
        j, i = np.unravel_index(int(np.argmax(score)), score.shape)
        like, differs = float(likeness[j, i]), 0.0 if arrived is None else float(arrived[j, i])
        is_behind = self._has_been_at(place[j, i])
        is_shown = changed is not None and (changed.shown is None or changed.shown[window, window][half + j, half + i])
        still = (
            None
            if here is None or found.has_left or self._may_be_away or not self._has_been_at(self._rest)
            else self._still(likeness, here, place[0, 0], like)
        )
        if still is not None:
            return self._unless_away(changed, still, STILL_SIGMA_PX)
        by_look = like >= SURE_LIKENESS and (is_behind or not is_shown) and not self._may_be_away
        if found.has_left:  # nor by the look of the ground about where it stood, at which it is not
            is_there = least > LEAST_LIKENESS or np.hypot(*(place[j, i] - self._rest)) < LEFT_REACH_PX
            by_look = by_look and not is_there
        if not (by_look or (differs >= SURE_DIFFERENCE and like >= least)):
            return None
        if not by_look and self._odds(wanted.log_evidence(like), found, wanted, int(j), int(i)) < SURE_ODDS:
            return None
        peak = _climbed(likeness, int(j), int(i), int(CLIMB_SHARE * self._size))
        matched, sigma = place[peak] + _peak(likeness, *peak[::-1]), 0.3 + 2.0 * (1.0 - like)
        if changed is None or differs < SURE_DIFFERENCE:
            return self._unless_away(changed, matched, sigma)
        if not self._is_size_known and not self._measured(changed.surely, found.at(int(j), int(i))):
            return matched, sigma
        centre, spread = self._centred(changed.surely, found.at(int(j), int(i)), patch)
        if spread >= MERGED_SHARE * self._size:
            self._middle_share = MERGED_SHARE
            return place[j, i] + _peak(likeness, int(i), int(j)), spread
        share = sigma**2 / (sigma**2 + self._learn_middle(centre - matched, spread) ** 2)
        # What both places are off by together is not learned by how far they are apart.
        return matched + share * (centre - matched), sigma * spread / float(np.hypot(sigma, spread))

    def _unless_away(self, changed: Change | None, uv: Array, sigma: float) -> tuple[Array, float] | None:
        """The place at which nothing differs and its one sigma; None if it may have gone from there unseen."""
        unseen_px = self._unseen_px(changed, uv)
        self._may_be_away = self._may_be_away or not np.isfinite(unseen_px)
        return None if self._may_be_away else (uv, float(np.hypot(sigma, unseen_px)))

    def _unseen_px(self, changed: Change | None, uv: Array) -> float:
        """One sigma, px, of where the thing is if nothing differs and it may be at a place: it can be anywhere about it
        where picture and ground are both clipped. Infinite if that goes on beyond what is looked at. (24.29)
        """
        if changed is None or changed.unknown is None:
            return 0.0
        most = int(max(self._size - 2.0 * RIM_PX, LEAST_SIZE_PX) if self._is_size_known else LEAST_SIZE_PX)
        free = cv2.erode(changed.unknown.astype(np.uint8), np.ones((most, most)), borderValue=1)
        count, labels = cv2.connectedComponents(free)
        rows, columns = np.mgrid[: free.shape[0], : free.shape[1]]
        off = np.stack([columns, rows], axis=-1) + changed.corner - uv
        may = np.zeros(count, bool)
        may[labels[np.abs(off).max(axis=-1) <= LEFT_REACH_PX]] = True
        may[0] = False
        where = may[labels]
        if not where.any():
            return 0.0
        if where[0].any() or where[-1].any() or where[:, 0].any() or where[:, -1].any():
            return float(np.inf)
        # Of a thing of unknown size the clipped part is its own: who clicked on it saw it.
        return float(np.sqrt(0.5 * (off[where] ** 2).sum(axis=-1).mean())) if self._is_size_known else 0.0

    def _otherwise(self, found: _Window, wanted: Wanted) -> tuple[Array, float] | None:
        """(24.24): where something differs that is likelier the thing, over other ground than before, than another;
        None if it is not.
        """
        patch, changed = found.patch, found.changed
        if changed is None or found.differs is None or not self._is_size_known:
            return None
        j, i = np.unravel_index(int(np.argmax(found.differs - PRIOR_WEIGHT * found.far)), found.far.shape)
        if found.differs[j, i] < SURE_DIFFERENCE:
            return None
        at, half = found.at(int(j), int(i)), wanted.mask.shape[0] // 2
        is_known = np.ones_like(patch.image) if changed.unknown is None else ~changed.unknown
        parts = np.stack([patch.image, changed.behind, changed.sigma, is_known])
        ratio = max(
            wanted.log_ratio(*parts[:, y - half : y + half + 1, x - half : x + half + 1])
            for x in range(at[0] - 1, at[0] + 2)
            for y in range(at[1] - 1, at[1] + 2)
        )
        if self._odds(ratio, found, wanted, int(j), int(i)) < SURE_ODDS:
            return None
        return self._centred(changed.surely, at, patch)

    def _odds(self, ratio: float, found: _Window, wanted: Wanted, j: int, i: int) -> float:
        """The logarithm of the odds that what is at a place is the thing and not another, (24.24), where it looks like
        it by `ratio`, a logarithm as well.
        """
        others = 0.0 if found.changed is None else wanted.others(found.changed.surely, found.at(j, i))
        others = max((self._m_px / OTHERS_APART_M) ** 2, others)
        return ratio - 0.5 * float(found.far[j, i]) - float(np.log(found.spread_px2 * others))

    def _without_uncovered(self, changed: Change, uv: Array) -> Image:
        """The change without the part about a place, where the thing stood: as it leaves it uncovers ground, of
        which nothing shows how it looked before. (24.20)
        """
        surely, known = changed.surely, None if changed.unknown is None else ~changed.unknown
        is_changed = surely > CHANGED if known is None else (surely > CHANGED) & known
        count, labels = cv2.connectedComponents(is_changed.astype(np.uint8))
        near = int(np.ceil(0.5 * self._size)) + 1
        column, row = (int(n) for n in np.rint(uv - changed.corner))
        about = labels[max(row - near, 0) : row + near + 1, max(column - near, 0) : column + near + 1]
        touched = np.zeros(count, bool)
        touched[about] = True
        touched[0] = False
        left = np.where(touched[labels], np.float32(0.0), surely)
        return left if known is None else suggested(left, known)

    def _still(self, likeness: Image, here: Image, first: Array, best: float) -> Array | None:
        """(24.9): where it stood, if nothing there has changed and it looks no better elsewhere; None if it moves."""
        i, j = (int(n) for n in np.rint(self._rest - first))
        if not (0 <= j < likeness.shape[0] and 0 <= i < likeness.shape[1]):
            return None
        like = float(likeness[j, i])
        stands = here[j, i] < UNCHANGED and like >= max(SURE_LIKENESS, best - STILL_LIKENESS)
        return self._rest if stands else None

    def _centred(self, changed: Image, at: Array, patch: Patch) -> tuple[Array, float]:
        """(24.8): the middle of what differs and one sigma of it, px; and the thing's size by its area."""
        rows, columns = np.mgrid[: changed.shape[0], : changed.shape[1]]
        centre = at.astype(float)
        for _ in range(3):
            near = np.maximum(np.abs(rows - centre[1]), np.abs(columns - centre[0])) <= max(0.65 * self._size, 2.5)
            weight = changed * near
            total = float(weight.sum())
            if total < 1.0:
                break
            centre = np.array([(weight * columns).sum(), (weight * rows).sum()]) / total
        seen_px = self._size_by_area(changed, centre)
        if seen_px > MERGED * self._size:  # something else has come close: where the thing is in it is not known
            return centre + patch.corner, MERGED_SHARE * self._size
        self._size += 0.1 * (_within(seen_px) - self._size)
        return centre + patch.corner, SPREAD * self._size * (1.0 + self._size / LARGE_PX)

    def _measured(self, changed: Image, at: Array) -> bool:
        """Learn the size of a thing that stood when it was clicked from what changes as it leaves; return whether it is
        known. Until then that is no measure of where it is: it is the ground that it uncovers, too.
        """
        seen_px = _within(self._size_by_area(changed, at))
        gone_px = float(np.hypot(*(self._uv - self._stood)))
        self._is_size_known = seen_px <= min(MERGED * self._size, gone_px)
        self._size += 0.1 * (seen_px - self._size)
        return self._is_size_known

    def _size_by_area(self, changed: Image, at: Array) -> float:
        """The size that the area of what has changed about a place gives, px. (24.8)"""
        rows, columns = np.mgrid[: changed.shape[0], : changed.shape[1]]
        wide = np.maximum(np.abs(rows - at[1]), np.abs(columns - at[0])) <= max(1.3 * self._size, 4.0)
        return SIZE_BY_ROOT * float(np.sqrt((changed * wide).sum()))

    def _remember(self, changed: Change | None = None, wanted: Wanted | None = None) -> None:
        """Keep how it looks now, next to how it looked OLD_S ago; with its cover by what has changed about it."""
        half = self._half()
        patch = cut(self._seen, self._uv, int(1.5 * half) + 2)
        if patch.inside is not None:
            return
        cover = cover_of(patch, changed, wanted, self._uv)
        new = Look(self._seen.stamp_ns, patch, self._uv.copy(), self._known_velocity(), np.eye(2), cover)
        old = [look for look in self._looks if new.stamp_ns - look.stamp_ns >= OLD_S * 1e9]
        if not self._looks:
            self._looks = [new]
        elif len(self._looks) == 1 or old[:1] == self._looks[:1]:
            self._looks = [self._looks[-1], new]
        else:
            self._looks = [self._looks[0], new]

    def _known_velocity(self) -> Array:
        """Its velocity (2,) against the ground, px/s, with which it turns; 0 where that is not known. (24.21)

        So of a small thing: what would turn about it is ground.
        """
        sigma = float(np.sqrt(0.5 * np.trace(self._cov[2:, 2:])))
        is_known = self._size > LARGE_PX and float(np.hypot(*self._velocity)) > COURSE_SIGMAS * sigma
        return self._velocity if is_known else np.zeros(2)

    def _learn_middle(self, off_px: Array, usual_px: float) -> float:
        """Learn one sigma of the middle of what differs, by how far it is from where the thing looks most like itself,
        as a share of its size; return it, px, or how far that is now, if that is more. `usual_px`: at first. (24.8)
        """
        before = self._middle_share or usual_px / self._size
        variance = 0.5 * float(off_px @ off_px) / self._size**2
        self._middle_share = float(np.sqrt(before**2 + MIDDLE_LEARNED * (variance - before**2)))
        return max(self._middle_share, float(np.sqrt(variance))) * self._size

    def _learn_spread(self, seen: Seen, uv: Array, wanted: Wanted) -> None:
        """Learn by how much its grey levels differ from one picture to the next: from those that it was to have."""
        half = wanted.mask.shape[0] // 2
        sure = wanted.inside[0] > 0.5
        if not sure.any():
            return
        size = 2 * half + 1
        image = cv2.getRectSubPix(seen.image, (size, size), (float(uv[0]), float(uv[1]))).astype(np.float32)
        off = float(np.mean((image - wanted.grey)[sure] ** 2))
        self._spread = float(np.sqrt(self._spread**2 + SPREAD_LEARNED * (off - self._spread**2)))

    def _find_size(self) -> bool:
        """Find its middle and size from what differs about the click, if the thing has been moving; return whether.

        By the ground about a usual thing, then about the least: what shines may do so over little more than that.
        """
        patch = cut(self._seen, self._uv, int(MOST_SIZE_PX))
        return any(self._find_region(patch, size_px) for size_px in (USUAL_SIZE_PX, LEAST_SIZE_PX))

    def _find_region(self, patch: Patch, size_px: float) -> bool:
        """The same by the ground about a thing of one size. (24.31)"""
        changed = difference(self._pictures, self._seen, patch, size_px)
        if changed is None:
            return False
        sure = cv2.morphologyEx((changed.surely > CHANGED).astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
        count, _, stats, middles = cv2.connectedComponentsWithStats(sure)
        for k in sorted(range(1, count), key=lambda k: -stats[k, cv2.CC_STAT_AREA]):
            left, top, width, height, area = stats[k]
            uv = self._uv - patch.corner
            outside = np.maximum(np.maximum([left, top] - uv, uv - [left + width - 1, top + height - 1]), 0.0)
            if area >= 5 and max(width, height) <= 1.5 * MOST_SIZE_PX and np.hypot(*outside) <= 3.0:
                self._size = _within(SIZE_BY_ROOT * float(np.sqrt(area)))
                if np.hypot(*(middles[k] - uv)) <= max(CLICK_REACH_PX, 0.5 * self._size):
                    self._uv = middles[k] + patch.corner
                return True
        return False


def _within(size_px: float) -> float:
    """The size, or the least or the most that is followed."""
    return float(np.clip(size_px, LEAST_SIZE_PX, MOST_SIZE_PX))


def _climbed(values: Image, j: int, i: int, most: int) -> tuple[int, int]:
    """Return the place of the maximum that is reached from (j, i) by at most so many steps upward."""
    for _ in range(most):
        rows, columns = slice(max(j - 1, 0), j + 2), slice(max(i - 1, 0), i + 2)
        near = values[rows, columns]
        up = divmod(int(near.argmax()), near.shape[1])
        if (rows.start + up[0], columns.start + up[1]) == (j, i):
            break
        j, i = rows.start + up[0], columns.start + up[1]
    return j, i


def _peak(values: Image, i: int, j: int) -> Array:
    """Return the offset (2,) from (i, j) to the peak of a parabola through its neighbours, px."""
    out = np.zeros(2)
    for axis, (one, two) in enumerate((((j, i - 1), (j, i + 1)), ((j - 1, i), (j + 1, i)))):
        if min(*one, *two) < 0 or two[0] >= values.shape[0] or two[1] >= values.shape[1]:
            continue
        a, b, c = float(values[one]), float(values[j, i]), float(values[two])
        bend = a - 2.0 * b + c
        if bend < -1e-6:
            out[axis] = float(np.clip(0.5 * (a - c) / bend, -0.5, 0.5))
    return out
