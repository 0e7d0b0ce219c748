"""Boresight, camera-to-autopilot time offset, position delay and heading error, estimated in flight.

Every window solve estimates them (residuals (5.4), (5.7)) against a prior. Its posterior may serve as prior for later
windows only if it has seen none of their data, and the autopilot's attitude error is correlated over tens of seconds,
so that windows closer than that repeat the same error. Therefore posteriors are kept only from windows that far apart,
and a window's prior is the newest posterior that ended before the window began. Windows that disagree with each other
by more than their covariances say count for less, (6.13). Section 10 of docs/mathematics.md.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.errors import InputError
from onboard.estimation import camera_states
from onboard.estimation.information import Information
from onboard.estimation.platform_states import BORESIGHT, DELAY, HEADING, OFFSET, STATES, VELOCITY_DELAY, WALK
from onboard.geometry.robust import OUTLIER_SIGMAS

Array = NDArray[np.float64]

MEMORY_ESTIMATES = 8
TOO_SURE = 2.0  # times the declared sigma that data may claim
AGREEMENT_PRIOR = 2.0  # windows that agree with their covariances, assumed before any has been seen
AGREE = 3.0  # sigmas of their difference, within which two values confirm each other
ZOOM_REACH = 0.3  # of the focal length's logarithm, over which a zoom table's errors are correlated
MIN_GAIN = 0.02  # of a variance: a window that says less of a state is no evidence on it


@dataclass(frozen=True, eq=False)
class PlatformEstimate:
    """Mean (B,) and covariance (B, B) in the order of `platform_states`, from data up to `end_ns`.

    `end_ns` 0 is the prior before take-off.
    """

    end_ns: int
    mean: Array
    covariance: Array
    given: Array | None = None  # (8,) variances of the first prior that it still rests on; None: as configured

    @property
    def sigma(self) -> Array:
        """One sigma of each state."""
        return np.sqrt(np.diag(self.covariance))

    def widened(self, stamp_sigma_s: float) -> PlatformEstimate:
        """The same for pictures whose stamps are off by one more sigma, all by the same."""
        if stamp_sigma_s == 0.0:
            return self
        wider = self.covariance.copy()
        wider[OFFSET, OFFSET] += stamp_sigma_s**2
        return PlatformEstimate(self.end_ns, self.mean, wider, self.given)

    def aged(self, stamp_ns: int) -> PlatformEstimate:
        """The same some time later. Equation (10.1)."""
        minutes = max(stamp_ns - self.end_ns, 0) / 60e9 if self.end_ns else 0.0
        walk = WALK[: len(self.mean)]
        return PlatformEstimate(self.end_ns, self.mean, self.covariance + np.diag(walk**2 * minutes), self.given)


@dataclass(frozen=True, eq=False)
class Unconfirmed:
    """What would be learned if anything confirmed it: the states that are outside (8,), and mean and sigma of all."""

    end_ns: int
    outside: NDArray[np.bool_]
    mean: Array
    sigma: Array


class Alignment:
    """Keeps the posteriors of past windows; hands out the prior a window may use.

    `unconfirmed`: the newest value that was too far from the prior to be adopted; None once it was confirmed,
    or once another was adopted instead.
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
    ) -> None:
        """Priors are one sigma; `spacing_s` is the least time between the ends of two windows that update it.

        `camera`: the camera file, whose own errors are then estimated too, if it states any sigma. `readout`: of its
        rows, as configured, and one sigma (s).
        """
        tiny = 1e-12
        of_camera = camera_states.first_sigmas(camera, readout[1])
        self._camera, self._readout_s = camera if of_camera else None, readout[0]
        self._camera_file = camera
        sigmas = [mount_sigma_rad] * 3 + [offset_sigma_s, delay_sigma_s, delay_sigma_s] + [heading_sigma_rad] * 2
        sigmas += list(of_camera)
        first = np.diag(np.square(sigmas) + tiny)
        self._estimates = [PlatformEstimate(0, np.zeros(len(first)), first)]
        self._spacing_ns = round(spacing_s * 1e9)
        self.forget()

    def forget(self) -> None:
        """Forget what windows have taught; what was known before them stays."""
        del self._estimates[1:]
        count = len(self._estimates[0].mean)
        self._squares, self._counts = np.zeros(count), np.zeros(count)
        self._weakened = np.ones(count)  # by what disagreement the windows so far count for less
        self.unconfirmed: Unconfirmed | None = None

    @property
    def platform(self) -> PlatformEstimate:
        """The newest posterior."""
        return self._estimates[-1]

    @property
    def updates(self) -> int:
        """How many windows have updated the estimate."""
        return len(self._estimates) - 1

    def prior_for(self, start_ns: int) -> PlatformEstimate:
        """The prior of a window whose first keyframe is at `start_ns`."""
        for estimate in reversed(self._estimates):
            if estimate.end_ns <= start_ns:
                return estimate.aged(start_ns)
        return self._estimates[0]

    def offer(self, start_ns: int, end_ns: int, mean: Array, covariance: Array) -> bool:
        """A solved window's posterior; True if it was taken."""
        newest_ns = self._estimates[-1].end_ns
        if start_ns < newest_ns or (newest_ns and end_ns - newest_ns < self._spacing_ns):
            return False
        first, before = self._estimates[0], self.prior_for(start_ns)
        outside = _outside(before, mean, self.disagreement) | (_outside(first, mean) & ~_outside(first, before.mean))
        if np.any(outside) and not self._is_confirmed(start_ns, end_ns, mean, covariance, outside):
            return False
        self.unconfirmed = None
        mean, covariance = self._agreed(before, mean, covariance)
        rests_on = before.given
        estimate = PlatformEstimate(
            end_ns, mean.copy(), covariance.copy(), np.diag(first.covariance) if rests_on is None else rests_on
        )
        self._estimates.append(_with_prior_reweighed(estimate, first))
        del self._estimates[1:-MEMORY_ESTIMATES]
        return True

    def _is_confirmed(
        self, start_ns: int, end_ns: int, mean: Array, covariance: Array, outside: NDArray[np.bool_]
    ) -> bool:
        """Whether an earlier window that shares no data, and no error of the attitude, was outside likewise. (10.6)"""
        held, sigma = self.unconfirmed, np.sqrt(np.diag(covariance))
        if held is not None and (start_ns < held.end_ns or end_ns - held.end_ns < self._spacing_ns):
            return False  # it may repeat the other's error: neither a confirmation nor anything new
        self.unconfirmed = Unconfirmed(end_ns, outside, mean.copy(), sigma)
        if held is None or np.any(outside & ~held.outside):
            return False
        return bool(np.all(np.abs(mean - held.mean)[outside] <= AGREE * np.hypot(sigma, held.sigma)[outside]))

    def lens_moved(self, sigma: float) -> None:
        """The focal length has changed by about `sigma` (of its logarithm): it is as unsure as that from now on.

        A camera that was taken as its file has it gets states of its own.
        """
        if self._camera is None and self._camera_file is not None:
            self._camera, count = self._camera_file, camera_states.COUNT
            self._estimates = [_with_certain_camera(e, count) for e in self._estimates]
            self._squares, self._counts = np.pad(self._squares, (0, count)), np.pad(self._counts, (0, count))
            self._weakened = np.pad(self._weakened, (0, count), constant_values=1.0)
            self.unconfirmed = None
        wider = np.zeros(len(self.platform.mean))
        wider[STATES + camera_states.FOCAL_LENGTH] = sigma**2
        self._estimates = [replace(e, covariance=e.covariance + np.diag(wider)) for e in self._estimates]

    def lens_changed(self, camera: Camera, sigma: float) -> None:
        """The lens has been zoomed to this camera from the one that counted so far; `sigma` is how well that is known.

        What was found of the file's errors holds the less the farther the lens has gone. (21.2)
        """
        before = self._camera_file
        assert before is not None
        if self._camera is None:
            self.lens_moved(0.0)
        apart = abs(float(np.log(camera.focal_px / before.focal_px)))
        kept, wider = float(np.exp(-apart / ZOOM_REACH)), before.focal_px / camera.focal_px
        scale = np.ones(len(self.platform.mean))
        scale[STATES : STATES + camera_states.COUNT] = kept * np.array([1.0, wider, wider, 1.0, 1.0])
        own = np.zeros(len(scale))
        own[STATES : STATES + camera_states.COUNT] = np.square(camera.sigma)
        reported = np.where(np.arange(len(scale)) == STATES + camera_states.FOCAL_LENGTH, sigma**2, 0.0)
        first = self._estimates[0].covariance.copy()
        lens = slice(STATES, STATES + camera_states.COUNT)
        first[lens, lens] = np.diag((own + reported + camera_states.CERTAIN**2)[lens])
        new = []
        for e in self._estimates[1:]:
            covariance = scale[:, None] * e.covariance * scale + np.diag((1.0 - kept**2) * own + reported)
            most = np.where(own > 0.0, (own + reported) / np.diag(covariance), 1.0)
            least = np.sqrt(np.minimum(most, 1.0))  # steps to and fro add no error of their own
            given = None if e.given is None else np.where(own > 0.0, own + reported, e.given)
            new.append(PlatformEstimate(e.end_ns, scale * e.mean, least[:, None] * covariance * least, given))
        begin = self._estimates[0]
        self._estimates = [PlatformEstimate(begin.end_ns, scale * begin.mean, first, begin.given), *new]
        self._camera_file, self.unconfirmed = camera, None

    @property
    def disagreement(self) -> Array:
        """(B,) factor on one sigma by which windows differ more than their covariances say; 1 if they agree."""
        mean_square = (AGREEMENT_PRIOR + self._squares) / (AGREEMENT_PRIOR + self._counts)
        return np.sqrt(np.maximum(mean_square, 1.0))

    def _agreed(self, before: PlatformEstimate, mean: Array, covariance: Array) -> tuple[Array, Array]:
        """The posterior with all windows' information weakened by how far they disagree, this one's too. (6.13)"""
        gained = np.diag(before.covariance - covariance)
        tells = gained > MIN_GAIN * np.diag(before.covariance)
        if before.given is None:
            return mean, covariance  # held against what was declared, not against another window: (6.12) weighs that
        # By what the windows themselves claim: those before have been weakened already, where they disagreed.
        claimed = gained * (1.0 - gained / np.diag(before.covariance) * (1.0 - self._weakened**-2))
        self._squares += np.where(tells, (mean - before.mean) ** 2 / np.where(tells, claimed, 1.0), 0.0)
        self._counts += tells
        disagreement = self.disagreement
        if np.all(disagreement == 1.0):
            return mean, covariance
        own = Information.gained(mean, covariance, before.mean, before.covariance)
        # Along each direction that the window tells of, by how far windows disagree about what lies in it.
        apart = np.square(own.directions * before.sigma[:, None]).T @ np.square(disagreement)
        # Which of two is the wrong one nothing says: those before have counted for too much by as much.
        most = np.maximum(self._estimates[0].sigma / before.sigma, 1.0)
        grown = np.clip(disagreement / self._weakened, 1.0, most)
        self._weakened = np.maximum(self._weakened, disagreement)
        return own.weakened(apart).upon(before.mean, grown[:, None] * before.covariance * grown)

    def to_json(self) -> str:
        """The newest estimate, for the state directory."""
        newest = self.platform
        camera: dict[str, Any] = {}
        if self._camera is not None:
            camera["camera"] = camera_states.as_numbers(self._camera, newest.mean[STATES:], self._readout_s)
        return json.dumps(
            {
                "boresight_rad": newest.mean[BORESIGHT].tolist(),
                "offset_s": float(newest.mean[OFFSET]),
                "delay_s": float(newest.mean[DELAY]),
                "velocity_delay_s": float(newest.mean[VELOCITY_DELAY]),
                "heading_rad": newest.mean[HEADING].tolist(),
                **camera,
                "covariance": newest.covariance.tolist(),
                "end_unix_ns": newest.end_ns,
            },
            indent=1,
        )

    def restore(self, text: str) -> None:
        """Begin from the estimate of an earlier session; raises InputError if the text is not one.

        Its sigma is widened to what may have happened on the ground: half of the first prior.
        """
        try:
            raw: dict[str, Any] = json.loads(text)
            mean = np.array([*raw["boresight_rad"], raw["offset_s"]], float)
            covariance = np.array(raw["covariance"], float)
            if "delay_s" in raw:
                mean = np.array([*mean, raw["delay_s"], raw["velocity_delay_s"], *raw["heading_rad"]], float)
            if self._camera is not None and "camera" in raw:
                states = camera_states.from_numbers(self._camera, raw["camera"], self._readout_s)
                mean = np.array([*mean, *states[: len(self._estimates[0].mean) - STATES]])
                covariance = covariance[: len(mean), : len(mean)]  # the readout may now be taken as it is
            elif "camera" in raw:  # the camera file is now taken as it is
                covariance = covariance[:STATES, :STATES]
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"alignment state: not readable ({error})") from error
        first = self._estimates[0].covariance
        missing = len(first) - len(mean)
        if missing < 0 or covariance.shape != (len(mean), len(mean)):
            raise InputError("alignment state: wrong shape")
        if missing:  # written before these were estimated
            mean, covariance = np.pad(mean, (0, missing)), np.pad(covariance, (0, missing))
            covariance[-missing:, -missing:] = first[-missing:, -missing:]
        if not (np.all(np.isfinite(mean)) and np.all(np.isfinite(covariance))):
            raise InputError("alignment state: not finite")
        if not np.allclose(covariance, covariance.T) or np.linalg.eigvalsh(covariance)[0] <= 0.0:
            raise InputError("alignment state: covariance is not positive definite")
        self._estimates = [PlatformEstimate(0, mean, covariance + 0.25 * first)]


def _outside(prior: PlatformEstimate, mean: Array, factor: Array | float = 1.0) -> NDArray[np.bool_]:
    """(8,) which states are farther from the prior than its sigma, times a factor, allows for. (10.6)"""
    out: NDArray[np.bool_] = np.abs(mean - prior.mean) > OUTLIER_SIGMAS * factor * prior.sigma
    return out


def _with_certain_camera(platform: PlatformEstimate, count: int) -> PlatformEstimate:
    """The estimate with so many states of the camera, which are known to be 0."""
    covariance = np.pad(platform.covariance, (0, count))
    covariance[STATES:, STATES:] = camera_states.CERTAIN**2 * np.eye(count)
    given = (
        None if platform.given is None else np.pad(platform.given, (0, count), constant_values=camera_states.CERTAIN**2)
    )
    return PlatformEstimate(platform.end_ns, np.pad(platform.mean, (0, count)), covariance, given)


def under_another_prior(
    mean: Array, covariance: Array, given: PlatformEstimate, prior: PlatformEstimate
) -> tuple[Array, Array]:
    """The posterior that follows from `prior` where the window was solved under `given`.

    What the window itself says, the precision C^-1 - given^-1 about its own mean, is put upon the other prior, which
    may be tighter: no delay held open.
    """
    gained = Information.gained(mean, covariance, given.mean, given.covariance)
    return gained.upon(prior.mean, prior.covariance)


def _with_prior_reweighed(estimate: PlatformEstimate, first: PlatformEstimate) -> PlatformEstimate:
    """The same posterior with the first prior's variance re-estimated from the data. Equation (6.12).

    A mount that is three sigma from where it was declared biases every posterior towards the declaration. Where the
    data alone are that far from it, the declared sigma was too small: the prior's variance becomes what makes the data
    likeliest, never less than declared and never more than twice its sigma, because the data have unmodelled errors
    too.
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
