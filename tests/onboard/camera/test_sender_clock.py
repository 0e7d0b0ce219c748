"""Stamps of a sender's clock -> ours: jitter gone, the least delay kept, drift followed, steps survived."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.camera.frame_protocol import Clock, Header, Origin
from onboard.camera.sender_clock import SETTLING_NS, SenderClock
from onboard.events.session_clock import SessionClock

SESSION = SessionClock(1_700_000_000_000_000_000)
START_NS = 10**12
NS = 1_000_000_000


def header(stamp_ns: int, arrival_ns: int, clock: Clock = Clock.SENDER, origin: Origin = Origin.MEDIA) -> Header:
    return Header(64, 48, stamp_ns, 0, arrival_ns=arrival_ns, clock=clock, origin=origin)


def late_ms(
    seconds: float, delay_s: float, jitter_s: float, *, rate_hz: float = 30.0, drift_ppm: float = 0.0,
    backlog_s: float = 0.0, step_at_s: float = 1e9, step_s: float = 0.0, seed: int = 1,
) -> tuple[np.ndarray, SenderClock]:  # fmt: skip
    """How far mapped stamps lie behind the true captures, of pictures that were mapped; and the clock."""
    rng = np.random.default_rng(seed)
    clock, out = SenderClock(SESSION, False), []
    for k in range(round(seconds * rate_hz)):
        captured_s = k / rate_hz
        arrived_s = captured_s + delay_s + jitter_s * rng.uniform(-1.0, 1.0)
        arrived_s = max(arrived_s, backlog_s + k * 0.002)  # what had been waiting comes at once
        sender_s = captured_s * (1.0 + 1e-6 * drift_ppm) + (step_s if captured_s >= step_at_s else 0.0) + 1234.5
        now_ns = START_NS + round(arrived_s * NS)
        mapped_ns = clock.to_monotonic_ns(header(round(sender_s * NS), now_ns), now_ns)
        if mapped_ns is not None:
            out.append((captured_s, (mapped_ns - START_NS) / 1e6 - 1e3 * captured_s))
    return np.array(out), clock


@settings(max_examples=15)
@given(
    delay_s=st.floats(0.05, 0.8),
    jitter_s=st.floats(0.0, 0.03),
    seed=st.integers(0, 1000),
    backlog_s=st.floats(0.0, 1.0),
)
def test_a_constant_is_left_of_delay_jitter_and_backlog(
    delay_s: float, jitter_s: float, seed: int, backlog_s: float
) -> None:
    rows, clock = late_ms(6.0, delay_s, jitter_s, seed=seed, backlog_s=backlog_s)
    late = rows[:, 1]
    assert 1.0 <= rows[0, 0] < 3.5  # the first second is waited for
    assert np.ptp(late) < 8.0 and np.all(late >= 1e3 * (delay_s - jitter_s) - 0.01)
    assert late[-1] < 1e3 * (delay_s - jitter_s) + 3.0 + 200.0 * jitter_s
    assert 0.3 * jitter_s - 1e-6 <= clock.sigma_s < 2.5 * jitter_s + 0.003


def test_a_clock_that_drifts_is_followed() -> None:
    rows, _ = late_ms(150.0, 0.3, 0.03, rate_hz=10.0, drift_ppm=80.0)
    assert np.ptp(rows[:, 1]) < 20.0  # 12 ms of drift in all


def test_a_clock_that_is_set_is_begun_again() -> None:
    rows, _ = late_ms(20.0, 0.2, 0.02, step_at_s=10.0, step_s=-33.0)
    assert np.ptp(rows[:, 1]) < 25.0


def test_each_kind_of_stamp_has_a_clock_of_its_own() -> None:
    clock = SenderClock(SESSION, False)
    mapped = []
    for k in range(120):
        now_ns = START_NS + k * NS // 30
        kind = Origin.SEI if k >= 60 else Origin.MEDIA
        stamp_ns = k * NS // 30 + (10**18 if k >= 60 else 0)
        mapped.append(clock.to_monotonic_ns(header(stamp_ns, now_ns, origin=kind), now_ns))
    waiting = [k for k, at in enumerate(mapped) if at is None]
    assert waiting == [*range(SETTLING_NS * 30 // NS), *range(60, 60 + SETTLING_NS * 30 // NS)]
    assert all(at is None or at == START_NS + k * NS // 30 for k, at in enumerate(mapped))


@pytest.mark.parametrize(("age_s", "is_taken"), [(0.0, True), (4.9, True), (5.1, False), (-0.004, True), (-0.1, False)])
def test_a_stamp_of_our_own_clock_is_taken_where_it_can_be(age_s: float, is_taken: bool) -> None:
    clock = SenderClock(SESSION, False)
    stamp_ns = START_NS - round(age_s * NS)
    mapped = clock.to_monotonic_ns(header(stamp_ns, START_NS, Clock.MONOTONIC), START_NS)
    assert mapped == (stamp_ns if is_taken else None)
    assert bool(clock.complaint) == (not is_taken)


@given(st.integers(-(2**63), 2**63 - 1), st.integers(-(2**63), 2**63 - 1), st.sampled_from(Clock), st.booleans())
def test_no_stamp_makes_it_fail(stamp_ns: int, arrival_ns: int, kind: Clock, is_utc: bool) -> None:
    clock = SenderClock(SESSION, is_utc)
    for k in range(4):
        mapped = clock.to_monotonic_ns(header(stamp_ns, arrival_ns, kind), START_NS + k * NS)
        assert mapped is None or abs(mapped - START_NS) < 20 * NS
