"""Speed and course over the ground out of a velocity and its covariance."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contract.track import Course

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Velocity:
    """East and north (2,), m/s, and its covariance (2, 2)."""

    velocity_m_s: Array
    cov: Array

    @property
    def speed_m_s(self) -> float:
        """Over the ground."""
        return float(np.hypot(*self.velocity_m_s))

    @property
    def sigma_speed_m_s(self) -> float:
        """One sigma along the way; across it too where that is not known."""
        speed = self.speed_m_s
        if speed < 1e-6:
            return math.sqrt(0.5 * float(np.trace(self.cov)))
        along = self.velocity_m_s / speed
        return math.sqrt(float(along @ self.cov @ along))

    @property
    def course_deg(self) -> float:
        """Clockwise from north, in [0, 360)."""
        return math.degrees(math.atan2(self.velocity_m_s[0], self.velocity_m_s[1])) % 360.0

    @property
    def sigma_course_deg(self) -> float:
        """One sigma, at most half a turn."""
        speed = max(self.speed_m_s, 1e-6)
        across = np.array([self.velocity_m_s[1], -self.velocity_m_s[0]]) / speed
        return min(math.degrees(math.sqrt(float(across @ self.cov @ across)) / speed), 180.0)

    def course(self, is_moving: bool) -> Course:
        """The speed, and the course unless the thing is at rest."""
        figures = self.speed_m_s, self.sigma_speed_m_s
        return Course(*figures, self.course_deg, self.sigma_course_deg) if is_moving else Course(*figures)
