"""The boot clock by TIMESYNC: offsets, drifts, steps and disagreements, with no link and no waiting."""

import itertools
import random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.clocks.boot_clock import BootClock
from onboard.clocks.timesync import NS_PER_S, LinkClock, TimeSync

MS = 1_000_000
EPOCH = 1_795_000_000 * NS_PER_S
BOOT = 60 * NS_PER_S


class World:
    """An autopilot whose clock runs (1 + drift) times as fast as ours, over a link with random delays."""

    def __init__(self, drift: float = 0.0, least_ms: float = 1.0, mean_ms: float = 0.0, seed: int = 0) -> None:
        self.drift, self.least_ms, self.mean_ms = drift, least_ms, mean_ms
        self.rng = random.Random(seed)
        self.now_ns = EPOCH
        self.boot_began_ns, self.boot_began_at_ns = BOOT, EPOCH

    def boot_ns(self, now_ns: int) -> int:
        return self.boot_began_ns + round((now_ns - self.boot_began_at_ns) * (1.0 + self.drift))

    def true_ns(self, boot_ns: int) -> int:
        return self.boot_began_at_ns + round((boot_ns - self.boot_began_ns) / (1.0 + self.drift))

    def delay_ns(self) -> int:
        extra = self.rng.expovariate(1.0 / self.mean_ms) if self.mean_ms else 0.0
        return round((self.least_ms + extra) * MS)

    def exchange(self) -> tuple[int, int, int]:
        there = self.now_ns + self.delay_ns()
        return self.now_ns, self.boot_ns(there), there + self.delay_ns()

    def fly(self, clock: LinkClock, seconds: float, sync: bool = True, hz: int = 10) -> list[tuple[int, int]]:
        """Messages and, once a second, an exchange; returns (stamp given, true moment) of each message."""
        out = []
        for i in range(round(seconds * hz)):
            boot = self.boot_ns(self.now_ns) // MS * MS
            arrival = self.now_ns + self.delay_ns()
            clock.arrived(boot, arrival)
            if clock.is_known(arrival):
                out.append((clock.to_host_ns(boot), self.true_ns(boot)))
            if sync and i % hz == 0:
                clock.exchanged(*self.exchange())
            self.now_ns += NS_PER_S // hz
        return out


def errors_ms(stamps: list[tuple[int, int]]) -> np.ndarray:
    return np.array([(given - true) / 1e6 for given, true in stamps])


def is_rising(stamps: list[tuple[int, int]]) -> bool:
    return all(a[0] < b[0] for a, b in itertools.pairwise(stamps))


def test_long_queues_cost_a_part_of_the_least_round_trip_only() -> None:
    world, clock = World(100e-6, 20.0, 150.0), LinkClock("auto")
    stamps = world.fly(clock, 60.0)
    figures = clock.figures()
    assert 40.0 < figures["round_trip_ms"] < 120.0
    assert figures["round_trip_ms"] / 2 / np.sqrt(3.0) <= figures["clock_sigma_ms"] < figures["round_trip_ms"]
    assert np.max(np.abs(errors_ms(stamps[200:]))) < 3.0 * figures["clock_sigma_ms"]
    assert is_rising(stamps)


@pytest.mark.parametrize("seed", range(8))
def test_a_few_exchanges_over_a_bad_link_are_no_drift(seed: int) -> None:
    world, clock = World(-400e-6, 40.0, 30.0, seed), LinkClock("auto")
    stamps = world.fly(clock, 2.0, hz=5)
    stamps += world.fly(clock, 8.0)
    assert abs(clock.figures()["drift_ppm"]) < 4000.0
    assert np.max(np.abs(errors_ms(stamps[20:]))) < 40.0


def test_the_stated_sigma_is_neither_too_small_nor_too_large() -> None:
    ratios = []
    for seed in range(60):
        world, clock = World(30e-6, 2.0, 10.0, seed), LinkClock("auto")
        # Which way the least round trip is spent differs from link to link: all of it one way at worst.
        share = random.Random(seed).random()
        for _ in range(30):
            there, back = (world.delay_ns() * 2 * part for part in (share, 1.0 - share))
            at = world.now_ns + round(there)
            boot = world.boot_ns(at)
            clock.arrived(boot // MS * MS, at)
            clock.exchanged(world.now_ns, boot, at + round(back))
            world.now_ns += NS_PER_S
        boot = world.boot_ns(world.now_ns)
        ratios.append((clock.sync.line.at(boot) + boot - world.true_ns(boot)) / clock.sync.line.sigma_ns)
    assert 0.4 < np.sqrt(np.mean(np.square(ratios))) < 1.5


def test_the_change_from_arrivals_to_exchanges_never_turns_stamps_back() -> None:
    world, clock = World(0.0, 150.0), LinkClock("auto")
    before = world.fly(clock, 3.0, sync=False)
    after = world.fly(clock, 8.0)
    assert errors_ms(before)[-1] == pytest.approx(150.0, abs=1.0)
    assert errors_ms(after)[-1] == pytest.approx(0.0, abs=1.0)
    assert is_rising(before + after)


def test_a_simulator_that_stalls_is_followed() -> None:
    world, clock = World(0.0, 1.0, 1.0), LinkClock("auto")
    before = world.fly(clock, 20.0)
    world.boot_began_ns -= 300 * MS  # its clock stood still for 0.3 s
    after = world.fly(clock, 15.0)
    assert np.max(np.abs(errors_ms(after)[60:])) < 2.0
    assert is_rising(before)
    assert is_rising(after)


def test_a_reboot_begins_again() -> None:
    world, clock = World(), LinkClock("auto")
    before = world.fly(clock, 10.0)
    world.now_ns += 3 * NS_PER_S
    world.boot_began_ns, world.boot_began_at_ns = NS_PER_S, world.now_ns
    assert clock.arrived(NS_PER_S, world.now_ns + MS)
    assert not clock.is_known(world.now_ns + 2 * MS)
    after = world.fly(clock, 10.0)
    assert np.max(np.abs(errors_ms(after))) < 3.0
    assert is_rising(before + after)


def test_an_answer_from_another_clock_is_not_accepted() -> None:
    world, clock = World(0.0, 1.0), LinkClock("auto")
    world.fly(clock, 3.0, sync=False)
    clock.exchanged(world.now_ns, world.now_ns, world.now_ns + MS)  # Unix time in place of boot time
    assert clock.disagrees
    assert clock.figures().keys() == {"arrival_sigma_ms", "drift_ppm"}
    stamps = world.fly(clock, 3.0, sync=False)
    assert np.max(np.abs(errors_ms(stamps))) < 2.0


@pytest.mark.parametrize("times", [(10, 0, 5), (0, 0, 3 * NS_PER_S)])
def test_impossible_round_trips_are_ignored(times: tuple[int, int, int]) -> None:
    assert not TimeSync().add(*times)


def test_memory_is_bounded() -> None:
    world, sync = World(), TimeSync()
    for _ in range(2000):
        sync.add(*world.exchange())
        world.now_ns += NS_PER_S // 5
    assert len(sync.kept) <= 122


@given(st.lists(st.tuples(st.integers(0, 2**40), st.integers(-(2**33), 2**33), st.booleans()), max_size=60))
def test_whatever_comes_stamps_of_one_boot_rise_with_boot_time(fed: list[tuple[int, int, bool]]) -> None:
    clock, boot, given_ns = LinkClock("auto"), 0, []
    for step, late, sync in fed:
        boot += step % 3000 * MS
        if clock.arrived(boot, EPOCH + boot + late % (4 * NS_PER_S)):
            given_ns = []
        if sync:
            sent = EPOCH + boot + late % NS_PER_S
            clock.exchanged(sent, boot, sent + step % NS_PER_S)
        if step % 3000:
            given_ns.append(clock.to_host_ns(boot))
    assert all(a < b for a, b in itertools.pairwise(given_ns))


def test_arrivals_that_are_forgotten_let_a_constant_offset_follow_a_drift() -> None:
    forgetful, keeper = BootClock("constant", 60 * NS_PER_S), BootClock("constant")
    for i in range(6000):
        boot = i * NS_PER_S // 10
        arrival = EPOCH + boot + round(boot * 100e-6)
        forgetful.add(boot, arrival)
        keeper.add(boot, arrival)
    true = EPOCH + boot + round(boot * 100e-6)
    assert 0.0 <= (true - forgetful.to_host_ns(boot)) / 1e6 < 7.0
    assert (true - keeper.to_host_ns(boot)) / 1e6 > 50.0
