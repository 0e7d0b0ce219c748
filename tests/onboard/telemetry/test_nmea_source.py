"""A plain GPS receiver: its sentences as events, its clock as ours, its faults."""

import math
import os
import tty
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.events.source import State
from onboard.events.types import GpsQuality, NavEvent, PositionFix
from onboard.telemetry.nmea_source import NmeaReceiver
from tests.onboard.telemetry.listening import config_for, listening
from tests.onboard.telemetry.sentences import burst, gga, gst, rmc, sentence, vtg

SECOND = 1_000_000_000
EPOCH = 1_795_000_000 * SECOND
NOON = 43_200.0


def feed(receiver: NmeaReceiver, chunks: list[tuple[float, bytes]]) -> list[NavEvent]:
    """Hand over bytes at seconds after EPOCH, and a moment of silence at the end."""
    out = []
    for t, data in chunks:
        out += receiver.take(data, EPOCH + round(t * SECOND))
    return out + receiver.take(b"", EPOCH + round((chunks[-1][0] + 0.3) * SECOND))


def fixes(events: list[NavEvent]) -> list[PositionFix]:
    return [event for event in events if isinstance(event, PositionFix)]


def qualities(events: list[NavEvent]) -> list[GpsQuality]:
    return [event for event in events if isinstance(event, GpsQuality)]


def test_sentences_become_a_position_and_its_quality() -> None:
    (quality, fix) = feed(NmeaReceiver(), [(0.1, burst(NOON))])
    assert isinstance(fix, PositionFix)
    assert fix.stamp_ns == EPOCH + round(0.1 * SECOND)
    assert fix.lat_deg == pytest.approx(-43.38, abs=1e-7)
    assert fix.lon_deg == pytest.approx(172.4, abs=1e-7)
    assert fix.height_amsl_m == 350.2
    assert fix.velocity_ned_m_s[:2] == pytest.approx((0.0, 10.0), abs=1e-3)
    assert math.isnan(fix.velocity_ned_m_s[2])
    assert quality == GpsQuality(
        fix.stamp_ns, 3, 9, pytest.approx(math.hypot(0.8, 0.6) / math.sqrt(2.0)), 1.5, None, 12.5
    )


def test_without_deviations_the_dilution_says_how_good_it_is() -> None:
    (quality, _) = feed(NmeaReceiver(), [(0.1, gga(NOON, 1.0, 2.0) + rmc(NOON, 1.0, 2.0))])
    assert quality.sigma_horizontal_m == pytest.approx(3.0)
    assert quality.sigma_vertical_m == pytest.approx(6.0)


@pytest.mark.parametrize(("quality", "fix_type"), [(0, 1), (1, 3), (2, 4), (4, 6), (5, 5), (6, 1), (7, 1), (8, 1)])
def test_only_what_the_sky_says_is_a_fix(quality: int, fix_type: int) -> None:
    events = feed(NmeaReceiver(), [(0.1, burst(NOON, quality=quality))])
    assert qualities(events)[0].fix_type == fix_type
    assert len(fixes(events)) == (fix_type >= 3)


def test_a_warning_in_rmc_is_no_fix() -> None:
    events = feed(NmeaReceiver(), [(0.1, gga(NOON, 1.0, 2.0) + rmc(NOON, 1.0, 2.0, status="V"))])
    assert qualities(events)[0].fix_type == 1
    assert not fixes(events)


def test_stamps_are_the_receiver_s_times_by_the_least_delay() -> None:
    rng = np.random.default_rng(1)
    chunks = [(i * 0.2 + 0.05 + float(rng.exponential(0.03)), burst(NOON + i * 0.2)) for i in range(100)]
    stamps = [fix.stamp_ns for fix in fixes(feed(NmeaReceiver(), chunks))]
    assert len(stamps) == 100
    errors_ms = [(stamp - EPOCH) / 1e6 - 50.0 - 200.0 * i for i, stamp in enumerate(stamps)]
    assert max(abs(error) for error in errors_ms[20:]) < 6.0


def test_midnight_is_passed_and_the_week_number_does_not_matter() -> None:
    chunks = [(i * 1.0, burst(86_395.0 + i)) for i in range(12)]
    stamps = [fix.stamp_ns for fix in fixes(feed(NmeaReceiver(), chunks))]  # its RMC says 1994 throughout
    assert np.diff(stamps) == pytest.approx(np.full(11, SECOND), abs=1000)


def test_a_receiver_that_corrects_its_clock_is_followed() -> None:
    chunks = [(i * 1.0, burst(NOON + i - (2.0 if i >= 10 else 0.0))) for i in range(30)]
    events = fixes(feed(NmeaReceiver(), chunks))
    assert events[-1].stamp_ns == EPOCH + 29 * SECOND
    late = [abs(fix.stamp_ns - EPOCH - round(i * SECOND)) for i, fix in enumerate(events[-14:], start=16)]
    assert max(late) < SECOND // 100


def test_an_epoch_is_out_with_its_last_sentence() -> None:
    receiver = NmeaReceiver()
    feed(receiver, [(i * 1.0, burst(NOON + i)) for i in range(4)])
    lat, lon = 1.0, 2.0
    assert receiver.take(rmc(NOON + 4, lat, lon) + vtg() + gga(NOON + 4, lat, lon), EPOCH + 4 * SECOND) == []
    assert len(receiver.take(gst(NOON + 4), EPOCH + 4 * SECOND + 1)) == 2


def test_missing_sentences_do_not_hold_back_what_came() -> None:
    chunks = [(i * 1.0, burst(NOON + i) if i % 3 else gga(NOON + i, -43.38, 172.4)) for i in range(12)]
    events = feed(NmeaReceiver(), chunks)
    assert len(fixes(events)) == 12
    assert sum(fix.velocity_ned_m_s is None for fix in fixes(events)) == 4


def test_without_heights_there_is_no_position_and_it_is_reported_why() -> None:
    events = feed(NmeaReceiver(), [(i * 1.0, rmc(NOON + i, 1.0, 2.0)) for i in range(3)])
    assert [quality.fix_type for quality in qualities(events)] == [2, 2, 2]
    assert not fixes(events)
    events = feed(NmeaReceiver(), [(0.0, gga(NOON, 1.0, 2.0, height="", separation=""))])
    assert qualities(events)[0].fix_type == 2
    assert not fixes(events)


def test_standing_still_without_a_course_is_no_velocity() -> None:
    (_, fix) = feed(NmeaReceiver(), [(0.0, rmc(NOON, 1.0, 2.0, knots="0.01", course="") + gga(NOON, 1.0, 2.0))])
    assert fix.velocity_ned_m_s is None


@pytest.mark.parametrize(
    "line",
    [
        burst(NOON).split(b"\r\n")[2].replace(b"350.2", b"950.2") + b"\r\n",
        burst(NOON).split(b"\r\n")[2].partition(b"*")[0] + b"\r\n",
        b"$GNGGA,,,,,,*5\r\n",
        b"$\r\n",
        b"\xff\xfe\x00$GN\r\n",
        b"no sentence\r\n",
    ],
)
def test_a_damaged_line_is_counted_and_costs_only_itself(line: bytes) -> None:
    receiver = NmeaReceiver()
    events = feed(receiver, [(0.0, line), (1.0, burst(NOON + 1))])
    assert receiver.errors == 1
    assert len(fixes(events)) == 1


def test_half_a_line_now_and_half_later_is_one_line() -> None:
    whole = burst(NOON)
    events = feed(NmeaReceiver(), [(i / 1000.0, whole[i : i + 1]) for i in range(len(whole))])
    assert len(fixes(events)) == 1
    assert fixes(events)[0].stamp_ns == EPOCH  # when it began to arrive


@given(
    st.lists(st.one_of(st.binary(max_size=120), st.text(max_size=60).map(lambda s: sentence("GNGGA," + s))), max_size=8)
)
def test_whatever_comes_is_survived(chunks: list[bytes]) -> None:
    receiver = NmeaReceiver()
    for i, chunk in enumerate(chunks):
        receiver.take(chunk, EPOCH + i * SECOND)
    assert fixes(feed(receiver, [(100.0 + i, burst(NOON + i)) for i in range(5)]))


@given(
    st.lists(
        st.sampled_from(["", "x", "nan", "inf", "-1", "1e400", "123519", "999999.99", "4807.038", "N"]), max_size=16
    )
)
def test_sentences_of_nonsense_with_a_right_checksum_are_survived(parts: list[str]) -> None:
    receiver = NmeaReceiver()
    for kind in ("GNGGA", "GNRMC", "GNGST", "GNVTG"):
        receiver.take(sentence(",".join([kind, *parts])), EPOCH)
    receiver.take(b"", EPOCH + SECOND)


@pytest.fixture
def line() -> Iterator[tuple[int, str]]:
    master, slave = os.openpty()
    tty.setraw(slave)
    yield master, f"nmea:{os.ttyname(slave)}:9600"
    os.close(master)
    os.close(slave)


@pytest.mark.wall_clock(waits=True)
def test_on_a_serial_line_it_comes_goes_stands_still_and_returns(line: tuple[int, str]) -> None:
    master, url = line
    with listening(config_for(url)) as received:
        received.until(lambda: received.source.health().detail == "the receiver has sent nothing yet")
        t = NOON

        def send(state: State) -> None:
            nonlocal t
            t += 0.1
            os.write(master, burst(t if state is not State.FROZEN else NOON))

        for state in (State.OK, State.FROZEN, State.OK):
            received.until(lambda: send(state) or received.stop.wait(0.05) or received.source.health().state is state)  # noqa: B023
        assert 0.3 < received.wait(State.LOST) < 1.5
        received.until(lambda: send(State.OK) or received.stop.wait(0.05) or received.source.health().state is State.OK)
        assert len(received.of(PositionFix)) > 3
        assert received.source.health().figures["bad_sentences"] == 0.0
