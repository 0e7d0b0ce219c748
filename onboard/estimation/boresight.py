"""Boresight, camera-to-autopilot time offset, position delay and heading error, estimated in flight.

Every window solve estimates them against a prior, the newest posterior that ended before the window began. Posteriors
are kept only from windows so far apart that they share neither data nor the autopilot's attitude error, (10.2), which
is correlated over tens of seconds. Windows that disagree with each other by more than their covariances allow count for
less, (6.13). Section 10 of docs/mathematics.md.
"""

from __future__ import annotations

import json
import zlib
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from contract.camera import Camera
from contract.errors import InputError
from contract.stated_values import check_keys, object_of
from onboard.estimation import camera_states
from onboard.estimation.counted_from import CountedFrom
from onboard.estimation.information import Information
from onboard.estimation.platform_states import (
    BORESIGHT,
    DELAY,
    HEADING,
    MOST,
    OFFSET,
    STATES,
    VELOCITY_DELAY,
    WALK,
    present,
)
from onboard.geometry.robust import OUTLIER_SIGMAS, student_widening
from onboard.navigation.limits import SURE_SIGMAS

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

MEMORY_ESTIMATES = 8
TOO_SURE = 2.0  # times the declared sigma that data may claim: they have unmodelled errors too
AGREEMENT_PRIOR = 2.0  # windows that agree with their covariances, assumed before any has been seen
ZOOM_REACH = 0.3  # of the focal length's logarithm, over which a zoom table's errors are correlated
MIN_GAIN = 0.02  # of a variance: a window that gains less on a state is no evidence on it
LENS = slice(STATES, STATES + camera_states.COUNT)
FOCAL_LENGTH = STATES + camera_states.FOCAL_LENGTH
# Keys of the file in the state directory, in the order of the states; older files lack those from the delays on.
TIMES = {"offset_s": OFFSET, "delay_s": DELAY, "velocity_delay_s": VELOCITY_DELAY}
CHECKSUM, COUNTED_FROM, WHAT = "crc32", "counted_from", "alignment state"
KEYS: dict[str, slice | int] = {"boresight_rad": BORESIGHT, **TIMES, "heading_rad": HEADING}
FILED = (*KEYS, "camera", "covariance", "end_unix_ns", COUNTED_FROM, CHECKSUM)


@dataclass(frozen=True, eq=False)
class PlatformEstimate:
    """Mean (B,) and covariance (B, B) in the order of `platform_states`, from data up to `end_ns`."""

    end_ns: int  # 0: before take-off
    mean: Array
    covariance: Array
    given: Array | None = None  # (B,) variances of the first prior that it still rests on; None: as configured

    @property
    def sigma(self) -> Array:
        """One sigma of each state."""
        return np.sqrt(np.diag(self.covariance))

    def widened(self, stamp_sigma_s: float) -> PlatformEstimate:
        """The same for pictures whose stamps are off by one more sigma, all by the same."""
        wider = self.covariance.copy()
        wider[OFFSET, OFFSET] += stamp_sigma_s**2
        return replace(self, covariance=wider)

    def with_mount_sigmas(self, times: tuple[float, float, float]) -> PlatformEstimate:
        """The same with so many times the sigma of each of the mount's angles. (16.13)"""
        scale = np.ones(len(self.mean))
        scale[BORESIGHT] = times
        return replace(self, covariance=self.covariance * np.outer(scale, scale))

    def aged(self, stamp_ns: int) -> PlatformEstimate:
        """The same some time later. Equation (10.1)."""
        minutes = max(stamp_ns - self.end_ns, 0) / 60e9 if self.end_ns else 0.0
        return replace(self, covariance=self.covariance + np.diag(WALK[: len(self.mean)] ** 2 * minutes))

    def with_camera(self) -> PlatformEstimate:
        """The same with states of the camera; those of one that had none are known to be 0."""
        if len(self.mean) > STATES:
            return self
        sure, given = np.full(camera_states.COUNT, camera_states.CERTAIN**2), self.given
        covariance = block_diag(self.covariance, np.diag(sure))
        given = None if given is None else np.append(given, sure)
        return PlatformEstimate(self.end_ns, np.append(self.mean, 0.0 * sure), covariance, given)

    def is_outside(self, mean: Array, factor: Array | float = 1.0) -> Mask:
        """(B,) which states are farther from it than its sigma, times a factor, allows for. (10.7)"""
        return np.abs(mean - self.mean) > OUTLIER_SIGMAS * factor * self.sigma


@dataclass(frozen=True, eq=False)
class Unconfirmed:
    """An estimate that awaits confirmation by another window, and a mask (B,) of its states outside the prior."""

    found: PlatformEstimate
    outside: Mask


class Alignment:
    """Keeps the posteriors of past windows; hands out the prior a window may use.

    `unconfirmed`: the newest value that was too far from the prior to be adopted; None once any was adopted.
    """

    def __init__(
        self,
        mount_sigma_rad: float,
        offset_sigma_s: float,
        spacing_s: float,
        delay_sigma_s: float = 0.0,
        heading_sigma_rad: float = 0.0,
        camera: Camera | None = None,
        readout: tuple[float, float] = (0.0, 0.0),
        counted_from: CountedFrom | None = None,
    ) -> None:
        """Priors are one sigma; `spacing_s` is the least time between the ends of two windows that update it.

        `camera`: the file, whose errors are estimated if it states any sigma. `readout`: of its rows, as configured,
        and one sigma (s). `counted_from`: the declarations that the states are errors of, for the state directory.
        """
        self._counted_from = counted_from or CountedFrom(camera=camera)
        self._file, self._lens, self._readout_s = camera, camera, readout[0]
        sigmas = [mount_sigma_rad] * 3 + [offset_sigma_s, delay_sigma_s, delay_sigma_s] + [heading_sigma_rad] * 2
        sigmas += camera_states.first_sigmas(camera, readout[1])
        first = np.diag(np.square(sigmas) + camera_states.CERTAIN**2)
        self._estimates = [PlatformEstimate(0, np.zeros(len(first)), first)]
        self._spacing_ns = round(spacing_s * 1e9)
        self.forget()

    def forget(self) -> None:
        """Forget what windows have taught; what was known before them stays."""
        del self._estimates[1:]
        # Each has all states that there can be. The last: the disagreement by which the windows so far count for less.
        self._squares, self._counts, self._weakened = np.zeros(len(WALK)), np.zeros(len(WALK)), np.ones(len(WALK))
        self.unconfirmed: Unconfirmed | None = None

    @property
    def platform(self) -> PlatformEstimate:
        return self._estimates[-1]

    @property
    def updates(self) -> int:
        return len(self._estimates) - 1

    def prior_for(self, start_ns: int) -> PlatformEstimate:
        """The prior of a window whose first keyframe is at `start_ns`."""
        return next(e for e in reversed(self._estimates) if e.end_ns <= start_ns).aged(start_ns)

    def offer(self, start_ns: int, end_ns: int, mean: Array, covariance: Array) -> bool:
        """A solved window's posterior; True if it was taken."""
        if self._repeats(self.platform, start_ns, end_ns):
            return False
        first, before, found = self._estimates[0], self.prior_for(start_ns), PlatformEstimate(end_ns, mean, covariance)
        outside = before.is_outside(mean, self.disagreement) | (first.is_outside(mean) & ~first.is_outside(before.mean))
        if np.any(outside) and not self._is_confirmed(start_ns, Unconfirmed(found, outside)):
            return False
        self.unconfirmed = None
        mean, covariance = self._agreed(before, mean, covariance)
        given = np.diag(first.covariance) if before.given is None else before.given
        self._estimates.append(_with_prior_reweighed(PlatformEstimate(end_ns, mean, covariance, given), first))
        del self._estimates[1:-MEMORY_ESTIMATES]
        return True

    def _repeats(self, earlier: PlatformEstimate, start_ns: int, end_ns: int) -> bool:
        """Return whether a window may share data, or an error of the attitude, with an earlier estimate. (10.2)"""
        return earlier.end_ns > 0 and (start_ns < earlier.end_ns or end_ns - earlier.end_ns < self._spacing_ns)

    def _is_confirmed(self, start_ns: int, new: Unconfirmed) -> bool:
        """Return whether an earlier window that this one does not repeat was outside by the same. (10.7)

        Keep this one for later windows to confirm, unless it repeats the one that is kept.
        """
        held = self.unconfirmed
        if held is not None and self._repeats(held.found, start_ns, new.found.end_ns):
            return False  # neither a confirmation nor anything new
        self.unconfirmed = new
        if held is None or np.any(new.outside & ~held.outside):
            return False
        sigmas = np.abs(new.found.mean - held.found.mean) / np.hypot(new.found.sigma, held.found.sigma)
        return bool(np.all(sigmas[new.outside] <= SURE_SIGMAS))

    def lens_moved(self, sigma: float) -> None:
        """The focal length has changed by about `sigma` (of its logarithm): it is as unsure as that from now on.

        A camera that was taken as its file has it gets states of its own.
        """
        if len(self.platform.mean) == STATES:
            self._estimates, self.unconfirmed = [e.with_camera() for e in self._estimates], None
        wider = np.zeros_like(self.platform.covariance)
        wider[FOCAL_LENGTH, FOCAL_LENGTH] = sigma**2
        self._estimates = [replace(e, covariance=e.covariance + wider) for e in self._estimates]

    def lens_changed(self, camera: Camera, sigma: float) -> None:
        """The lens has been zoomed to this camera from the one that counted so far; `sigma` is how well that is known.

        What was found of the file's errors holds the less the farther the lens has gone. (21.2)
        """
        assert self._lens is not None
        wider = self._lens.focal_px / camera.focal_px
        kept = float(np.exp(-abs(np.log(wider)) / ZOOM_REACH))
        self.lens_moved(0.0)  # which gives it states
        self._lens, self.unconfirmed = camera, None
        begin = self._estimates[0]
        scale, own, reported = np.ones_like(begin.mean), np.zeros_like(begin.mean), np.zeros_like(begin.mean)
        scale[LENS] = kept * np.array([1.0, wider, wider, 1.0, 1.0])
        own[LENS] = np.square(camera.sigma)
        reported[FOCAL_LENGTH] = sigma**2
        most, grown = own + reported, np.diag((1.0 - kept**2) * own + reported)
        first = begin.covariance.copy()
        first[LENS, LENS] = np.diag(most[LENS] + camera_states.CERTAIN**2)
        estimates = [replace(begin, mean=scale * begin.mean, covariance=first)]
        for e in self._estimates[1:]:
            assert e.given is not None
            covariance = scale[:, None] * e.covariance * scale + grown
            # Steps to and fro add no error of their own.
            least = np.sqrt(np.where(own > 0.0, np.minimum(most / np.diag(covariance), 1.0), 1.0))
            covariance = least[:, None] * covariance * least
            estimates.append(PlatformEstimate(e.end_ns, scale * e.mean, covariance, np.where(own > 0.0, most, e.given)))
        self._estimates = estimates

    @property
    def disagreement(self) -> Array:
        """(B,) factor on one sigma by which windows differ more than their covariances allow; 1 if they agree.

        What is beyond their covariances is known from few squares only, and wider by Student's t for as many. (6.13)
        """
        squares = AGREEMENT_PRIOR + self._counts
        beyond = np.maximum((AGREEMENT_PRIOR + self._squares) / squares - 1.0, 0.0)
        return np.sqrt(1.0 + beyond * student_widening(squares) ** 2)[: len(self.platform.mean)]

    def _agreed(self, before: PlatformEstimate, mean: Array, covariance: Array) -> tuple[Array, Array]:
        """The posterior with all windows' information weakened by how far they disagree, this one's too. (6.13)"""
        if before.given is None:
            return mean, covariance  # held against what was declared, not against another window: (6.12) weighs that
        count, known = len(mean), np.diag(before.covariance)
        weakened, gained = self._weakened[:count], known - np.diag(covariance)
        shown = gained > MIN_GAIN * known
        # The claims of the windows themselves count: the earlier ones are weakened already where they disagreed.
        claimed = gained * (1.0 - gained / known * (1.0 - weakened**-2))
        self._squares[:count][shown] += (mean - before.mean)[shown] ** 2 / claimed[shown]
        self._counts[:count] += shown
        disagreement = self.disagreement
        if np.all(disagreement == 1.0):
            return mean, covariance
        own = Information.gained(mean, covariance, before.mean, before.covariance)
        # Along each direction that the window shows, by how far windows disagree about what lies in it.
        apart = np.square(own.directions * before.sigma[:, None]).T @ np.square(disagreement)
        # Nothing shows which of two is the wrong one: those before have counted for too much by as much.
        most = np.maximum(self._estimates[0].sigma / before.sigma, 1.0)
        grown = np.clip(disagreement / weakened, 1.0, most)
        self._weakened[:count] = np.maximum(weakened, disagreement)
        return own.weakened(apart).upon(before.mean, grown[:, None] * before.covariance * grown)

    def to_json(self) -> str:
        """The newest estimate, for the state directory."""
        newest = self.platform
        found: dict[str, Any] = {key: newest.mean[at].tolist() for key, at in KEYS.items()}
        if self._file is not None and len(newest.mean) > STATES:
            found["camera"] = camera_states.as_numbers(self._file, newest.mean[STATES:], self._readout_s)
        found |= {"covariance": newest.covariance.tolist(), "end_unix_ns": newest.end_ns}
        found[COUNTED_FROM] = self._counted_from.as_numbers()
        return json.dumps({**found, CHECKSUM: _checksum(found)}, indent=1)

    def restore(self, text: str) -> tuple[str, ...]:
        """Begin from the estimate of an earlier session; raises InputError if the text is not one, if it is not as it
        was written, or beyond what can be.

        Return the labels of what is of another vehicle, mount, clock or camera than is declared now: as in the first
        prior. (10.8)

        What it does not have is as in the first prior; what is taken as it is now (lens, readout) is left out. Its
        sigma is widened to what may have happened on the ground: half of the first prior.
        """
        raw = object_of(text, WHAT)
        check_keys(raw, FILED, WHAT, needed=("covariance",))
        stated = raw.pop(CHECKSUM, None)  # older files have none
        if stated is not None and stated != _checksum(raw):
            raise InputError(f"{WHAT}: damaged or edited (its checksum is of another content); delete it")
        try:
            states = [raw[key] for key in KEYS if key in raw]
            if self._file is not None and "camera" in raw:
                states.append(camera_states.from_numbers(self._file, raw["camera"], self._readout_s))
            found, covariance = np.hstack(states).astype(float), np.array(raw["covariance"], float)
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise InputError(f"{WHAT}: not readable ({error})") from error
        if covariance.shape != (len(found), len(found)) or len(found) > len(MOST):
            raise InputError(f"{WHAT}: wrong shape")
        if not (np.all(np.isfinite(found)) and np.all(np.isfinite(covariance))):
            raise InputError(f"{WHAT}: not finite")
        is_lost = self._recount(raw.get(COUNTED_FROM), found, covariance)
        for q, at in present(len(found)):
            if np.any(np.abs(found[at]) > q.most):
                value = found[at][np.argmax(np.abs(found[at]))]
                raise InputError(f"{WHAT}: {q.label} of {value:.3g} {q.unit}: beyond {q.most:.3g} is none; delete it")
        if not np.allclose(covariance, covariance.T) or np.linalg.eigvalsh(covariance)[0] <= 0.0:
            raise InputError(f"{WHAT}: covariance is not positive definite")
        first = self._estimates[0]
        mean, before, count = first.mean.copy(), first.covariance.copy(), min(len(found), len(first.mean))
        taken = np.flatnonzero(~is_lost[:count])
        mean[taken], before[np.ix_(taken, taken)] = found[taken], covariance[np.ix_(taken, taken)]
        self._estimates = [PlatformEstimate(0, mean, before + 0.25 * first.covariance)]
        return tuple(q.label for q, at in present(count) if is_lost[at].any())

    def _recount(self, before: Any, found: Array, covariance: Array) -> Mask:
        """Count states (B,) from what is declared now, in place; a mask (B,) of those that are of something else."""
        if before is None:
            return np.zeros(len(found), bool)  # older files state nothing of it
        try:
            sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
            recounted, is_lost = self._counted_from.recounted(before, found, sigma)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise InputError(f"{WHAT}: {COUNTED_FROM} is not readable ({error})") from error
        found[:] = np.where(is_lost, 0.0, recounted)
        return is_lost


def _checksum(content: dict[str, Any]) -> str:
    return f"{zlib.crc32(json.dumps(content, sort_keys=True).encode()):08x}"


def _with_prior_reweighed(estimate: PlatformEstimate, first: PlatformEstimate) -> PlatformEstimate:
    """The same posterior with the first prior's variance re-estimated from the data. Equation (6.12).

    A mount that is three sigma from where it was declared biases every posterior towards the declaration.
    """
    assert estimate.given is not None
    precision = np.linalg.inv(estimate.covariance)
    alone = precision - np.diag(1.0 / estimate.given)
    values, vectors = np.linalg.eigh(alone)
    if values[0] <= 1e-6 * values[-1]:
        return estimate  # in some direction the data carry no information
    pull = precision @ (estimate.mean - first.mean)
    by_data = np.linalg.solve(alone, pull)
    own = np.diag((vectors / values) @ vectors.T)
    declared = np.diag(first.covariance)
    given = np.clip(by_data**2 - own, declared, TOO_SURE**2 * declared)
    covariance = np.linalg.inv(alone + np.diag(1.0 / given))
    return PlatformEstimate(estimate.end_ns, first.mean + covariance @ pull, covariance, given)
