"""Between attitudes: how far interpolation may be off, by the messages themselves."""

from __future__ import annotations

import numpy as np
import pytest

from contract.rotations import exp_so3, log_so3
from onboard.navigation.attitude_interpolation import Attitudes

SWAY_RAD = np.radians(20.0)


def rolled(t_s: float, period_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Attitude and rate of a vehicle that sways in roll."""
    phase = 2.0 * np.pi * t_s / period_s
    rate = SWAY_RAD * 2.0 * np.pi / period_s * np.cos(phase)
    return exp_so3(np.array([SWAY_RAD * np.sin(phase), 0.0, 0.0])), np.array([rate, 0.0, 0.0])


def heard(rate_hz: float, with_rates: bool, period_s: float = 4.0) -> Attitudes:
    attitudes = Attitudes(max_gap_s=5.0)
    for k in range(round(20.0 * rate_hz)):
        R, rate = rolled(k / rate_hz, period_s)
        attitudes.insert(round(k / rate_hz * 1e9), R, rate if with_rates else None)
    return attitudes


def errors_and_sigmas(attitudes: Attitudes, period_s: float = 4.0) -> tuple[np.ndarray, np.ndarray]:
    moments = np.linspace(4.0, 16.0, 601)
    found = [attitudes.at(round(t * 1e9)) for t in moments]
    errors = [np.linalg.norm(log_so3(R.T @ rolled(t, period_s)[0])) for t, R in zip(moments, found, strict=True)]
    return np.array(errors), np.array([attitudes.sigma_at(round(t * 1e9)) for t in moments])


# With rates only a sway nearly as quick as the messages is missed.
@pytest.mark.parametrize(
    ("rate_hz", "with_rates", "period_s"), [(1.0, True, 1.7), (2.0, True, 0.9), (1.0, False, 4.0), (2.0, False, 4.0)]
)
def test_slow_attitudes_say_how_far_they_may_be_off(rate_hz: float, with_rates: bool, period_s: float) -> None:
    errors, sigmas = errors_and_sigmas(heard(rate_hz, with_rates, period_s), period_s)
    assert np.sqrt(np.mean(errors**2)) > np.radians(0.3)
    assert np.mean(errors <= 3.0 * sigmas + 1e-6) > 0.9
    assert np.sqrt(np.mean(sigmas**2)) < 5.0 * np.sqrt(np.mean(errors**2))


@pytest.mark.parametrize("with_rates", [True, False])
def test_quick_attitudes_are_believed_as_they_are(with_rates: bool) -> None:
    _, sigmas = errors_and_sigmas(heard(50.0, with_rates))
    assert sigmas.max() < np.radians(0.05)


def test_at_a_message_itself_nothing_is_added() -> None:
    attitudes = heard(1.0, True)
    assert attitudes.sigma_at(8_000_000_000) == 0.0
