"""Stamps that begin to mean something else are seen by when pictures arrive; a slow host is not taken for that."""

import numpy as np
import pytest

from onboard.camera.stamp_consistency import HELD_NS, StampConsistency

PERIOD_NS, DELAY_MS = 33_000_000, 40.0


def sigmas(late_ms: dict[range, float], count: int = 400, load_ms: dict[range, float] | None = None) -> list[float]:
    """Of pictures at 30 Hz that arrive `DELAY_MS` and a little after exposure, stamped late where `late_ms` says so."""
    rng, consistency, out = np.random.default_rng(2), StampConsistency(), []
    for k in range(count):
        late = next((ms for part, ms in late_ms.items() if k in part), 0.0)
        load = next((rng.uniform(0.0, ms) for part, ms in (load_ms or {}).items() if k in part), 0.0)
        delay_ms = DELAY_MS + rng.exponential(1.0) + load
        arrival_ns = k * PERIOD_NS + round(1e6 * delay_ms)
        out.append(consistency.sigma_s(arrival_ns, round(1e6 * (delay_ms - late))))
    return out


def test_stamps_as_ever_have_no_sigma_of_their_own() -> None:
    assert sigmas({}) == [0.0] * 400


@pytest.mark.parametrize("late_ms", [150.0, 30.0])
def test_late_stamps_are_seen_at_the_first_picture_and_forgotten_when_they_are_right(late_ms: float) -> None:
    found = sigmas({range(100, 200): late_ms})
    assert found[:100] == [0.0] * 100
    assert found[100] == pytest.approx(late_ms / 1e3, abs=0.006)
    assert all(s == pytest.approx(late_ms / 1e3, abs=0.006) for s in found[100:200])
    held = HELD_NS // PERIOD_NS + 2
    assert found[200 + held :] == [0.0] * (200 - held)


def test_a_loaded_host_hides_no_late_stamp_and_makes_none() -> None:
    loaded = {range(80, 400): 100.0}
    assert max(sigmas({}, load_ms=loaded)) == 0.0
    assert min(sigmas({range(100, 200): 150.0}, load_ms=loaded)[130:200]) > 0.1


def test_early_stamps_are_seen_once_no_picture_comes_in_time() -> None:
    found = sigmas({range(100, 400): -150.0})
    assert max(found[:100]) == 0.0
    assert found[250] == pytest.approx(0.15, abs=0.006)


def test_stamps_ahead_of_their_arrival_are_doubted_from_the_first_picture_on() -> None:
    consistency = StampConsistency()
    assert consistency.sigma_s(0, -60_000_000) == pytest.approx(0.06)
