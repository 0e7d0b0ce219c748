"""Boot time to host time: an injected offset, drift, reboot or step is recovered from jittered arrivals."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.clocks.boot_clock import MAX_BINS, BootClock

OFFSET_NS = 1_795_217_044_570_831_800
MS = 1_000_000


def fly(
    clock: BootClock, offset_ns: int, seconds: float, drift: float = 0.0, boot_start_s: float = 2.0, seed: int = 0
) -> list[tuple[int, int, int]]:
    """Feed 20 Hz messages delayed by 1 ms and exponential jitter of 80 ms; returns boot, true host time, segment."""
    rng = np.random.default_rng(seed)
    fed = []
    for t in np.arange(0.0, seconds, 0.05):
        boot = round((boot_start_s + t) * 1e9)
        true = offset_ns + boot + round(drift * t * 1e9)
        fed.append((boot, true, clock.add(boot, true + round(1e6 + rng.exponential(80e6)))))
    return fed


def worst_error_ms(clock: BootClock, fed: list[tuple[int, int, int]]) -> float:
    return max(abs(clock.to_host_ns(boot, segment) - true) for boot, true, segment in fed) / MS


@settings(max_examples=25, deadline=None)
@given(offset_ns=st.integers(0, 2 * 10**18), seed=st.integers(0, 1000))
def test_a_constant_offset_is_recovered_from_jittered_arrivals(offset_ns: int, seed: int) -> None:
    clock = BootClock()
    fed = fly(clock, offset_ns, 60.0, seed=seed)
    assert clock.segments == 1
    assert clock.drift() == 0.0
    assert 0.5 < worst_error_ms(clock, fed) < 5.0  # the millisecond every message took cannot be seen


@pytest.mark.parametrize("drift", [0.025, -0.025, 0.002])
def test_an_injected_drift_is_recovered(drift: float) -> None:
    clock = BootClock()
    fed = fly(clock, OFFSET_NS, 300.0, drift)
    assert clock.drift() == pytest.approx(drift, abs=1e-5)
    assert 0.3 < worst_error_ms(clock, fed) < 5.0


def test_a_crystal_s_drift_over_a_short_flight_is_left_alone() -> None:
    clock = BootClock()
    fly(clock, OFFSET_NS, 300.0, 50e-6)
    assert clock.drift() == 0.0


def test_an_envelope_that_rises_in_steps_is_delay_not_drift() -> None:
    clock, fed = BootClock(), []
    rng = np.random.default_rng(3)
    for t in np.arange(0.0, 400.0, 0.05):
        boot = round(t * 1e9)
        queue_ns = 110 * MS * (t > 50) + 100 * MS * (t > 260) + 90 * MS * (t > 330)
        fed.append(
            (boot, OFFSET_NS + boot, clock.add(boot, OFFSET_NS + boot + round(queue_ns + rng.exponential(20e6))))
        )
    assert clock.drift() == 0.0
    assert worst_error_ms(clock, fed) < 5.0


def test_the_mode_can_be_forced() -> None:
    constant, drift = BootClock("constant"), BootClock("drift")
    assert worst_error_ms(constant, fly(constant, OFFSET_NS, 100.0, 0.002)) > 100.0
    assert worst_error_ms(drift, fly(drift, OFFSET_NS, 100.0, 200e-6)) < 5.0
    assert drift.drift() == pytest.approx(200e-6, abs=2e-5)


@pytest.mark.parametrize(
    ("seconds", "boot_start_s", "step_s", "later_s"),
    [pytest.param(60.0, 500.0, 565, 0.0, id="a reboot"), pytest.param(30.0, 0.0, -3600, 32.0, id="a stepped host")],
)
def test_a_reboot_and_a_stepped_host_clock_start_a_new_segment_and_both_are_recovered(
    seconds: float, boot_start_s: float, step_s: int, later_s: float
) -> None:
    clock = BootClock()
    before = fly(clock, OFFSET_NS, seconds, boot_start_s=boot_start_s)
    after = fly(clock, OFFSET_NS + step_s * 10**9, seconds, boot_start_s=later_s, seed=1)
    assert clock.segments == 2
    assert [{segment for _, _, segment in part} for part in (before, after)] == [{0}, {1}]
    assert worst_error_ms(clock, before) < 5.0 and worst_error_ms(clock, after) < 5.0


def test_slightly_disordered_boot_stamps_are_not_a_reboot() -> None:
    clock = BootClock()
    for boot_ms in (1000, 1100, 1060, 1200, 1199):
        clock.add(boot_ms * MS, OFFSET_NS + 1300 * MS)
    assert clock.segments == 1


def test_fed_as_it_flies_it_settles_within_seconds() -> None:
    clock = BootClock()
    fed = fly(clock, OFFSET_NS, 20.0)
    assert worst_error_ms(clock, fed[-1:]) < 5.0


def test_memory_stays_bounded_over_days() -> None:
    clock = BootClock()
    for hour in np.arange(0.0, 72.0, 0.001):
        boot = round(hour * 3600e9)
        clock.add(boot, OFFSET_NS + boot + MS)
    assert len(clock._segments[-1].least) <= MAX_BINS
    assert clock.to_host_ns(10**9) == OFFSET_NS + 10**9 + MS


def test_an_unfed_clock_says_so() -> None:
    with pytest.raises(LookupError):
        BootClock().to_host_ns(0)
