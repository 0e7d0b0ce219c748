"""Between attitudes: how far interpolation may be off, by the messages themselves."""

import numpy as np
import pytest

from contract.rotations import exp_so3, log_so3
from onboard.navigation.attitude_interpolation import Attitudes, Orientation

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
        attitudes.insert(round(k / rate_hz * 1e9), Orientation(R, rate if with_rates else None))
    return attitudes


def errors_and_sigmas(
    whole: Attitudes, period_s: float = 4.0, *, is_newest: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """`is_newest`: as in flight, when nothing after the next attitude has come yet."""
    errors, sigmas = [], []
    for t in np.linspace(4.0, 16.0, 601):
        moment_ns, attitudes = round(t * 1e9), whole
        if is_newest:
            past = np.searchsorted(whole.stamps_ns, moment_ns) + 1
            attitudes = Attitudes(whole.max_gap_s, whole.stamps_ns[:past], whole.values[:past])
        R = attitudes.at(moment_ns)
        errors.append(np.linalg.norm(log_so3(R.T @ rolled(t, period_s)[0])))
        sigmas.append(attitudes.sigma_at(moment_ns))
    return np.array(errors), np.array(sigmas)


# With rates only a sway nearly as quick as the messages is missed.
@pytest.mark.parametrize("is_newest", [False, True])
@pytest.mark.parametrize(
    ("rate_hz", "with_rates", "period_s"), [(1.0, True, 1.7), (2.0, True, 0.9), (1.0, False, 4.0), (2.0, False, 4.0)]
)
def test_slow_attitudes_say_how_far_they_may_be_off(
    rate_hz: float, with_rates: bool, period_s: float, is_newest: bool
) -> None:
    errors, sigmas = errors_and_sigmas(heard(rate_hz, with_rates, period_s), period_s, is_newest=is_newest)
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


def gusty(rate_hz: float, bandwidth_hz: float, gyro_rad_s: float = 0.0) -> tuple[Attitudes, np.ndarray, np.ndarray]:
    """Attitudes with the rates (about the roll axis) of a vehicle in gusts, and those at 100 Hz: times (s), rates."""
    rng = np.random.default_rng(2)
    times = np.arange(0.0, 120.0, 0.01)
    step = np.exp(-2.0 * np.pi * bandwidth_hz * 0.01)
    push, rates = rng.standard_normal((len(times), 3)), np.zeros((len(times), 3))
    for _ in range(2):  # a low pass of second order: gusts, and an airframe that does not follow them at once
        for k in range(1, len(times)):
            rates[k] = step * rates[k - 1] + (1.0 - step) * push[k]
        push = rates.copy()
    rates *= np.radians(15.0) / rates.std()
    attitudes = Attitudes(max_gap_s=5.0)
    every = round(100.0 / rate_hz)
    for k in range(0, len(times), every):
        rate = rates[k] + gyro_rad_s * rng.standard_normal(3)
        attitudes.insert(round(times[k] * 1e9), Orientation(np.eye(3), rate))
    return attitudes, times, rates


# Followed well, just about, and hardly at all.
@pytest.mark.parametrize("rate_hz", [25.0, 10.0, 3.3, 1.0])
def test_rates_that_come_too_rarely_say_how_far_they_are_off(rate_hz: float) -> None:
    attitudes, times, rates = gusty(rate_hz, 0.5)
    about = np.flatnonzero((times > 40.0) & (times < 80.0))[::7]
    found = [attitudes.rate_at(round(times[k] * 1e9)) for k in about]
    sigmas = [attitudes.rate_sigma_at(round(times[k] * 1e9), 0.0) for k in about]
    assert None not in sigmas
    stated = float(np.sqrt(np.mean(np.square(sigmas))))
    true = float(np.sqrt(np.mean(np.square(np.array(found) - rates[about]))))
    assert 0.7 < stated / true < 2.3
    assert true < np.radians(2.0) if rate_hz > 5.0 else true > np.radians(2.0)


def test_a_rate_at_the_wrong_moment_is_a_wrong_rate() -> None:
    attitudes, _, rates = gusty(25.0, 0.5)
    sigmas = [attitudes.rate_sigma_at(round(t * 1e9), 0.1) for t in np.arange(40.0, 80.0, 0.1)]
    change = float(np.sqrt(np.mean(np.square(np.diff(rates[::4], axis=0) / 0.04))))
    assert np.sqrt(np.mean(np.square(np.array(sigmas, float)))) == pytest.approx(0.1 * change, rel=0.3)


def test_attitudes_without_rates_measure_none() -> None:
    assert heard(10.0, with_rates=False).rate_sigma_at(round(8.03e9), 0.0) is None
    smooth = heard(10.0, with_rates=True).rate_sigma_at(round(8.03e9), 0.0)
    assert 0.0 < smooth < np.radians(0.5)


def test_a_turn_by_rates_is_surer_than_the_attitudes_and_its_sigma_is_what_it_misses() -> None:
    """Attitudes with 0.1 degrees of white noise, rates with a bias of 0.1 degrees a second, 25 a second. (1.10)"""
    rng, white_rad, bias = np.random.default_rng(2), np.radians(0.1), np.radians([0.1, -0.06, 0.04])
    attitudes, hz, errors, sigmas = Attitudes(max_gap_s=1.0), 25.0, [], []
    for k in range(500):
        R, rate = rolled(k / hz, 4.0)
        noisy = R @ exp_so3(white_rad * rng.standard_normal(3))
        attitudes.insert(round(k / hz * 1e9), Orientation(noisy, rate + bias))
    for start_s in np.linspace(6.0, 18.0, 200):
        start_ns, end_ns = round(start_s * 1e9), round((start_s + 0.2) * 1e9)
        turn = attitudes.turned(start_ns, end_ns)
        truth = rolled(start_s, 4.0)[0].T @ rolled(start_s + 0.2, 4.0)[0]
        errors.append(log_so3(truth.T @ turn))
        sigmas.append(attitudes.turned_sigma(start_ns, end_ns, white_rad))
    rms_rad = np.sqrt(np.mean(np.square(errors)))
    assert rms_rad < 0.2 * np.sqrt(2.0) * white_rad
    assert 0.7 * rms_rad < np.mean(sigmas) < 2.5 * rms_rad
    assert attitudes.turned(start_ns, round(30e9)) is None
    without = Orientation(np.eye(3))
    attitudes.insert(start_ns + 100_000_000, without)
    assert attitudes.turned(start_ns, end_ns) is None
