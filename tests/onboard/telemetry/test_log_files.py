"""One flight as a log of every kind: the same events, and one line for what is no log."""

import itertools
import math
import random
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from contract.errors import InputError
from contract.rotations import log_so3, matrix_from_quaternion
from onboard.events.types import Attitude, FilterStatus, GimbalAttitude, GpsQuality, Home, PositionFix, RangeFinder
from onboard.telemetry.log_files import read_log
from onboard.telemetry.log_formats import READ, table
from onboard.telemetry.read_options import ReadOptions
from onboard.telemetry.telemetry_log import TelemetryLog, quaternion
from tests.onboard.telemetry import log_writers
from tests.onboard.telemetry.log_events import of
from tests.onboard.telemetry.log_writers import (
    ABOVE_M,
    BOOT_S,
    HOME_M,
    LAT,
    LOCAL_AHEAD_S,
    LON,
    METRES_A_DEGREE,
    SECONDS,
    SPEED,
    T0_S,
    WRITERS,
    Moment,
    dataflash_log,
    gps_time,
    ulog,
    written,
)  # fmt: skip

pytestmark = pytest.mark.xdist_group("log files")  # one worker: what they share is made once


@dataclass(frozen=True)
class Promise:
    """What a kind of log can say, and how well."""

    stamp_s: float = 0.002
    place_m: float = 0.03
    tilt_deg: float = 0.01
    attitude_hz: int = 50
    has_velocity: bool = True
    has_rate: bool = True
    claims: tuple[float, float, int | None] | None = (0.4, 0.6, 12)
    undulation_m: float | None = 11.0
    datum_m: float | None = None
    above_m: float | None = ABOVE_M
    height_m: float = 0.01
    gimbal_deg: tuple[float, float, float] | None = None
    gimbal_abs: float = 1e-9  # of a quaternion
    utc_sigma_s: float | None = 0.0
    ahead_s: float = 0.0  # of UTC, that its times are
    options: ReadOptions | None = None
    least: tuple[int, int] = (5, 60)  # of ten damaged ones, that are read, and of their positions


BARE = Promise(attitude_hz=0, has_velocity=False, has_rate=False, claims=None, undulation_m=None, above_m=None)
DOWN_DEG = (0.0, -90.0, 10.0)
KINDS = {
    "tlog": Promise(),
    "bin": Promise(),
    "ulg": Promise(least=(5, 0)),
    "srt": replace(
        BARE, stamp_s=0.035, place_m=0.7, tilt_deg=0.3, attitude_hz=30, datum_m=100.0, above_m=ABOVE_M,
        gimbal_deg=DOWN_DEG, utc_sigma_s=None,
    ),
    "csv": Promise(least=(0, 60)),
    "airdata": replace(BARE, attitude_hz=10, datum_m=100.0, above_m=ABOVE_M, gimbal_deg=DOWN_DEG, utc_sigma_s=1.0),
    "dji": replace(
        BARE, stamp_s=0.01, attitude_hz=10, datum_m=100.0, above_m=ABOVE_M, gimbal_deg=DOWN_DEG, utc_sigma_s=None,
        ahead_s=LOCAL_AHEAD_S,
    ),
    "skydio": replace(BARE, datum_m=40.0, gimbal_deg=DOWN_DEG, utc_sigma_s=1.0),
    "gpx": replace(BARE, datum_m=40.0, least=(5, 0)),
    "ass": replace(BARE, stamp_s=0.01, above_m=ABOVE_M, utc_sigma_s=None, options=ReadOptions(home_amsl_m=HOME_M)),
    "nmea": Promise(stamp_s=0.01, attitude_hz=0, has_rate=False, above_m=None),
    "pos": replace(BARE, claims=(0.4, 0.6, 12), undulation_m=11.0, options=ReadOptions(undulation_m=11.0)),
    "mp4": replace(
        BARE, claims=(2.5, 5.0, None), undulation_m=11.0, options=ReadOptions(undulation_m=11.0), least=(5, 40)
    ),
    "ts": replace(
        BARE, attitude_hz=10, has_velocity=True, height_m=0.2, datum_m=40.0, gimbal_deg=DOWN_DEG, gimbal_abs=1e-4,
        least=(8, 100),
    ),
    "mrk": replace(BARE, claims=(0.4, 0.6, None), undulation_m=11.0, options=ReadOptions(undulation_m=11.0)),
}  # fmt: skip
PAUSE_S = 600.0
ALL = pytest.mark.parametrize("kind", KINDS)


@cache
def content(kind: str) -> bytes:
    return WRITERS[kind]()


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, TelemetryLog]:
    folder = tmp_path_factory.mktemp("logs")
    for kind in KINDS:
        (folder / f"flight.{kind}").write_bytes(content(kind))
    return {kind: read_log(folder / f"flight.{kind}", KINDS[kind].options) for kind in KINDS}


@ALL
def test_positions_are_where_the_flight_was_at_their_stamps(logs: dict[str, TelemetryLog], kind: str) -> None:
    promise, fixes = KINDS[kind], of(logs[kind], PositionFix)
    assert 0.95 * SECONDS * 10 <= len(fixes) <= SECONDS * 10
    for fix in fixes:
        t = fix.stamp_ns / 1e9 - T0_S - promise.ahead_s
        off_m = (fix.lat_deg - Moment(t).lat) * METRES_A_DEGREE
        assert abs(off_m) < promise.place_m + SPEED * promise.stamp_s
        assert fix.lon_deg == pytest.approx(LON, abs=1e-6)
        assert fix.height_amsl_m == pytest.approx(HOME_M + ABOVE_M, abs=promise.height_m)
        assert fix.height_above_home_m == (None if promise.above_m is None else pytest.approx(ABOVE_M, abs=0.01))
        if promise.has_velocity:
            assert fix.velocity_ned_m_s[:2] == pytest.approx((SPEED, 0.0), abs=0.02)
        else:
            assert fix.velocity_ned_m_s is None


@ALL
def test_attitudes_come_at_the_log_s_full_rate_with_the_gyros_rates(logs: dict[str, TelemetryLog], kind: str) -> None:
    promise, attitudes = KINDS[kind], of(logs[kind], Attitude)
    assert 0.92 * SECONDS * promise.attitude_hz <= len(attitudes) <= SECONDS * promise.attitude_hz
    for attitude in attitudes[1:-1]:
        t = attitude.stamp_ns / 1e9 - T0_S - promise.ahead_s
        R, truth = matrix_from_quaternion(attitude.q_ned_body), matrix_from_quaternion(Moment(t).q)
        assert np.degrees(np.linalg.norm(log_so3(R.T @ truth))) < promise.tilt_deg + 6.0 * promise.stamp_s
        if promise.has_rate:
            assert attitude.rate_body_rad_s == pytest.approx((Moment(t).roll_rate, 0.0, 0.0), abs=2e-3)
        else:
            assert attitude.rate_body_rad_s is None
    gimbal = of(logs[kind], GimbalAttitude)
    assert bool(gimbal) is (promise.gimbal_deg is not None)
    for angles in gimbal:
        assert angles.is_of_camera and angles.reference == "earth"
        assert angles.q_ref_gimbal == pytest.approx(quaternion(promise.gimbal_deg or DOWN_DEG), abs=promise.gimbal_abs)


@ALL
def test_the_receiver_and_the_filter_are_received_before_the_first_position_is_needed(
    logs: dict[str, TelemetryLog], kind: str
) -> None:
    promise, log = KINDS[kind], logs[kind]
    qualities, statuses = of(log, GpsQuality), of(log, FilterStatus)
    assert all(q.fix_type == 3 for q in qualities) and all(s.has_position and not s.is_glitching for s in statuses)
    gaps = np.diff([q.stamp_ns for q in qualities]) / 1e9
    assert len(qualities) > 10 and gaps.max() < 0.6  # `gps.quality_timeout_s` may be as short as 0.5 s
    assert bool(statuses) is (kind != "nmea")
    last = qualities[-1]
    assert (last.sigma_datum_m, log.utc_sigma_s) == (promise.datum_m, promise.utc_sigma_s)
    assert last.undulation_m == (
        None if promise.undulation_m is None else pytest.approx(promise.undulation_m, abs=0.01)
    )
    if promise.claims is not None:
        assert (last.sigma_horizontal_m, last.sigma_vertical_m, last.satellites) == pytest.approx(promise.claims)


@ALL
def test_it_arrives_in_order_and_stamps_of_a_kind_never_run_backwards(logs: dict[str, TelemetryLog], kind: str) -> None:
    log = logs[kind]
    assert len(log.arrival_ns) == len(log.events)
    assert log.arrival_ns == sorted(log.arrival_ns)
    for what in (PositionFix, Attitude, GpsQuality, FilterStatus):
        stamps = [event.stamp_ns for event in of(log, what)]
        assert all(a <= b for a, b in itertools.pairwise(stamps))
    begin_s, end_s = (stamp / 1e9 - T0_S - KINDS[kind].ahead_s for stamp in log.span_ns)
    assert -0.05 < begin_s < 0.05 and SECONDS - 0.2 < end_s < SECONDS + 0.05


@ALL
def test_a_log_is_known_by_what_it_holds_and_not_by_its_name(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "log.dat"
    path.write_bytes(content(kind))
    assert len(of(read_log(path, KINDS[kind].options), PositionFix)) > 100


def test_every_format_that_is_read_is_held_to_a_promise_here_and_named_in_the_docs() -> None:
    assert {each.key for each in READ} == set(KINDS) == set(WRITERS)
    page = (Path(__file__).parents[3] / "docs" / "logs.md").read_text(encoding="utf-8")
    assert table() in page


@ALL
def test_a_log_that_pauses_claims_nothing_meanwhile(tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ten minutes between two halves: a battery change, or a boot."""

    def halves(rate_hz: float) -> Iterator[Moment]:
        for i in range(round(SECONDS * rate_hz)):
            yield Moment(i / rate_hz + (PAUSE_S if 2 * i >= SECONDS * rate_hz else 0.0))

    monkeypatch.setattr(log_writers, "moments", halves)
    log = read_log(written(tmp_path, kind), KINDS[kind].options)
    assert 0.9 * SECONDS * 10 <= len(of(log, PositionFix)) <= SECONDS * 10
    for event in log.events:
        t = event.stamp_ns / 1e9 - T0_S - KINDS[kind].ahead_s
        assert -1.0 < t < SECONDS / 2 + 1.5 or PAUSE_S + SECONDS / 2 - 1.0 < t < PAUSE_S + SECONDS + 1.5
        if isinstance(event, PositionFix):
            assert abs(event.lat_deg - Moment(t).lat) * METRES_A_DEGREE < 0.7 + SPEED * 0.035


@ALL
def test_zeros_in_a_log_cost_only_themselves(tmp_path: Path, kind: str) -> None:
    """The zeros of a card that was pulled out."""
    data = bytearray(content(kind))
    at = 2 * len(data) // 3
    data[at : at + 200] = bytes(200)
    path = tmp_path / "zeros"
    path.write_bytes(data)
    if kind == "csv":  # a table with a line that cannot be meant is refused
        with pytest.raises(InputError, match=r"line \d+"):
            read_log(path)
        return
    fixes = of(read_log(path, KINDS[kind].options), PositionFix)
    assert len(fixes) > 0.6 * SECONDS * 10
    assert all(abs(fix.lat_deg - LAT) < 0.01 and abs(fix.height_amsl_m - HOME_M - ABOVE_M) < 1.0 for fix in fixes)


@ALL
@pytest.mark.parametrize("share", [0.5, 0.9])
def test_a_cut_log_gives_what_it_still_holds(tmp_path: Path, kind: str, share: float) -> None:
    whole = content(kind)
    path = tmp_path / "cut"
    path.write_bytes(whole[: round(share * len(whole))])
    if kind == "csv":  # a table cut within a line is not what was meant
        with pytest.raises(InputError, match=r"line \d+"):
            read_log(path)
        path.write_bytes(path.read_bytes().rpartition(b"\n")[0])
    fixes = of(read_log(path, KINDS[kind].options), PositionFix)
    assert 0.4 * share * SECONDS * 10 < len(fixes) < SECONDS * 10
    assert all(abs(fix.height_amsl_m - HOME_M - ABOVE_M) < 0.1 for fix in fixes)


@ALL
def test_a_damaged_log_gives_the_rest_or_one_line(tmp_path: Path, kind: str) -> None:
    """Bytes overwritten at random, ten times over: never another exception, never a place that it was not at."""
    whole, rng, read = content(kind), random.Random(3), 0
    path = tmp_path / "damaged"
    for _ in range(10):
        data = bytearray(whole)
        for _ in range(4):
            at = rng.randrange(3000, len(data) - 64)
            data[at : at + 16] = rng.randbytes(16)
        path.write_bytes(bytes(data))
        try:
            fixes = of(read_log(path, KINDS[kind].options), PositionFix)
        except InputError as error:
            assert "\n" not in str(error) and str(path) in str(error)
            continue
        read += 1
        near = [f for f in fixes if abs(f.lat_deg - LAT) < 0.01 and abs(f.lon_deg - LON) < 0.01]
        # pyulog goes on at the next synchronisation mark, of which an autopilot writes many and its own writer none.
        assert len(near) >= len(fixes) - 8 and len(near) > KINDS[kind].least[1]
    assert read >= KINDS[kind].least[0]


@pytest.mark.parametrize(
    "head", [bytes(range(256)) * 30, b"\xa3\x95\x80" + bytes(500), b"ULog\x01\x12\x35\x01" + bytes(20)]
)
def test_what_only_begins_like_a_log_is_one_line(tmp_path: Path, head: bytes) -> None:
    """Other files that are none, and bad lines: tests/transcripts/pc-onboard-import-video.txt."""
    path = tmp_path / "x"
    path.write_bytes(head)
    with pytest.raises(InputError, match=r"^telemetry [^\n]*$"):
        read_log(path)


def test_without_pyulog_one_line_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path, "ulg")
    monkeypatch.setitem(sys.modules, "pyulog", None)
    with pytest.raises(InputError, match=r"pip install pyulog"):
        read_log(path)


# ---------------------------------------------------------------- single formats


def test_gps_time_becomes_unix_time_with_the_leap_seconds_of_its_day() -> None:
    from onboard.telemetry.gps_time import unix_ns_of_gps  # noqa: PLC0415

    assert unix_ns_of_gps(*gps_time(T0_S)) == round(T0_S * 1e9)
    # GPS week 1825, 2014-12-28 00:00:00 GPS time: 16 s ahead of UTC; week 1854, 2015-07-19: 17 s.
    assert unix_ns_of_gps(1825, 0) == (1_419_724_800 - 16) * 10**9
    assert unix_ns_of_gps(1854, 0) == (1_437_264_000 - 17) * 10**9


def test_gimbal_range_and_lost_fix_of_a_dataflash_log(tmp_path: Path) -> None:
    log = dataflash_log(gimbal=True)
    for i in range(10):  # the receiver's time stands still
        week, ms = gps_time(T0_S + 12.0)
        log.add("GPS", 12.2 + 0.5 * i, 0, 3, ms, week, 12, LAT, LON, 450.0, SPEED, 0.0, 0.0)
        log.add("XKF4", 12.2 + 0.5 * i, 0, (1 << 16 | 0x4000 | 1 << 4) if i < 5 else (1 << 16 | 1 << 7 | 1 << 4), 0)
    path = tmp_path / "flight.bin"
    path.write_bytes(log.bytes())
    read = read_log(path)
    gimbal, ranged = of(read, GimbalAttitude)[5], of(read, RangeFinder)[5]
    assert gimbal.reference == "vehicle"
    assert matrix_from_quaternion(gimbal.q_ref_gimbal)[:, 0] == pytest.approx((0.0, 0.0, 1.0), abs=1e-6)
    assert ranged.distance_m == pytest.approx(ABOVE_M) and ranged.direction_body == pytest.approx((0.0, 0.0, 1.0))
    kinds = [q.fix_type for q in of(read, GpsQuality)]
    assert kinds[0] == 3 and kinds[-1] == 0
    states = of(read, FilterStatus)
    assert any(s.has_position and s.is_glitching for s in states) and not states[-1].has_position


def test_a_message_whose_kind_is_damaged_costs_itself_alone(tmp_path: Path) -> None:
    """Before, the log ended there without a word: of one in twelve logs with four damaged places, half or more."""
    whole, path = bytearray(log_writers.dataflash()), tmp_path / "flight.bin"
    path.write_bytes(whole)
    all_of_it = of(read_log(path), PositionFix)
    for share in (0.2, 0.5):
        whole[whole.index(b"\xa3\x95", int(share * len(whole))) + 2] = 0xFE
    path.write_bytes(whole)
    assert len(of(read_log(path), PositionFix)) >= len(all_of_it) - 2


@pytest.mark.parametrize("kind", ["bin", "ulg"])
def test_where_it_was_armed_is_read(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "flight"
    path.write_bytes(content(kind))
    (home,) = of(read_log(path, KINDS[kind].options), Home)
    assert (home.lat_deg, home.lon_deg, home.height_amsl_m) == pytest.approx((LAT, LON, HOME_M), abs=1e-6)


@pytest.mark.parametrize(
    ("second", "in_use", "place"),
    [
        ("GPS", (0, 1), "second"),
        ("GPS2", (0, 1), "second"),  # as it was before 4.1
        ("GPS", (1, 0), "first"),
        ("GPS", (0, 0), "first"),  # a blend, as which none is in use: refused as a log without a time
    ],
)
def test_of_two_receivers_the_one_in_use_counts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, second: str, in_use: tuple[int, int], place: str
) -> None:
    form, columns = log_writers.KINDS["GPS"]
    monkeypatch.setitem(log_writers.KINDS, "GPS", (f"{form}B", f"{columns},U"))
    if second == "GPS2":
        monkeypatch.setitem(log_writers.KINDS, "GPS2", (f"Q{form[2:]}B", f"{columns.replace('I,', '', 1)},U"))
    log = log_writers.Dataflash()
    for i in range(50):
        week, ms = gps_time(T0_S + 0.2 * i)
        log.add("POS", 0.2 * i, LAT, LON, HOME_M, 0.0)
        for number, name in enumerate(("GPS", second)):
            at = LAT + 1e-4 * number, LON, HOME_M, 0.0, 0.0, 0.0, in_use[number]
            log.add(name, 0.2 * i, *((number,) if name == "GPS" else ()), 3, ms, week, 12 - number, *at)
            log.add("GPA", 0.2 * i, number, 1.0, 0.4 + number, 0.6, 0.1, HOME_M)
    path = tmp_path / "flight.bin"
    path.write_bytes(log.bytes())
    last = of(read_log(path), GpsQuality)[-1]
    assert last.fix.lat_deg == pytest.approx(LAT + 1e-4 * (place == "second"))
    assert last.satellites == 12 - (place == "second")
    assert last.sigma_horizontal_m == pytest.approx(0.4 + (place == "second"))


def test_px4_s_own_log_without_utc_is_read_with_the_time_of_its_boot(tmp_path: Path) -> None:
    """As PX4's simulator writes it: by the Unix time at boot, or on the pictures' own clock if that counts from it."""
    path, with_utc = tmp_path / "flight.ulg", tmp_path / "utc.ulg"
    path.write_bytes(ulog(has_utc=False))
    with_utc.write_bytes(ulog())
    with pytest.raises(InputError, match=r"no UTC in it .* --time-offset S, or --time-offset 0 where"):
        read_log(path)
    read, known = read_log(path, ReadOptions(boot_unix_s=T0_S - BOOT_S)), read_log(with_utc)
    assert len(read.events) == len(known.events)
    for kind in (PositionFix, Attitude, GpsQuality):
        mine, theirs = of(read, kind), of(known, kind)
        late_s = [(a.stamp_ns - b.stamp_ns) / 1e9 for a, b in zip(mine, theirs, strict=True)]
        assert np.abs(late_s).max() < 0.002
    at_boot = read_log(path, ReadOptions(boot_unix_s=0.0))
    assert at_boot.span_ns[0] / 1e9 == pytest.approx(BOOT_S, abs=0.3)


def test_a_log_that_has_its_time_takes_no_other(tmp_path: Path) -> None:
    (tmp_path / "utc.ulg").write_bytes(ulog())
    with pytest.raises(InputError, match=r"has UTC .* leave --time-offset out"):
        read_log(tmp_path / "utc.ulg", ReadOptions(boot_unix_s=0.0))
    with pytest.raises(InputError, match=r"--time-offset is for a PX4 \.ulg without UTC"):
        read_log(written(tmp_path, "tlog"), ReadOptions(boot_unix_s=0.0))


def test_an_earth_fixed_gimbal_of_a_px4_log(tmp_path: Path) -> None:
    path = tmp_path / "flight.ulg"
    path.write_bytes(ulog(gimbal=True))
    gimbal = of(read_log(path), GimbalAttitude)
    assert len(gimbal) > 100 and all(g.reference == "earth" for g in gimbal)


SRT_HEAD = "1\n00:00:00,000 --> 00:00:00,033\n"
DIALECTS = {
    "mavic 2": (
        '<font size="36">FrameCnt : 1, DiffTime : 33ms\n2019-09-21 10:52:36,245,036\n[iso : 100] [shutter : 1/120.0] '
        "[fnum : 280] [ct : 5353] [focal_len : 240] [latitude : 48.100001] [longtitude : 11.500002] "
        "[altitude: 512.300000] </font>",
        (48.100001, 11.500002, 512.3, None, 300.0), None,
    ),
    "mavic 3": (
        '<font size="28">FrameCnt: 1, DiffTime: 33ms\n2023-05-12 12:01:02.345\n[iso: 100] [latitude: 48.1] '
        "[longitude: 11.5] [rel_alt: 1.300 abs_alt: 212.345] [gb_yaw: -12.3 gb_pitch: -90.0 gb_roll: 0.0] </font>",
        (48.1, 11.5, 212.345, 1.3, 100.0), (0.0, -90.0, -12.3),
    ),
    "matrice": (
        "SrtCnt : 1, DiffTime : 33ms\n2024-06-01 09:00:00.000\n[latitude: 41.3] [longitude: -81.3] "
        "[rel_alt: 50.6 abs_alt: 300] [Drone: Yaw:1.9, Pitch:-3.1, Roll:1.5] [Gimbal: Yaw:10.0, Pitch:-45.0, Roll:0.0]",
        (41.3, -81.3, 300.0, 50.6, 100.0), (0.0, -45.0, 10.0),
    ),
    "siyi": (
        "2026-06-01_09-00-00 stream->FrameCnt:0 \nlatitude:S35°21′46.8″, longitude:E149°9′54.0″, rel_alt:650.2, "
        "abs_alt:650.2, gb_yaw:-12.3, gb_pitch:-45.0, gb_roll:0.0, mix_ratio:2.0",
        (-35.363, 149.165, 650.2, None, 100.0), (0.0, -45.0, -12.3),
    ),
}  # fmt: skip
HOME_NEEDED = {
    "phantom 4": "HOME(149.0251,-20.2532) 2017.08.05 14:11:51\nGPS(149.0251,-20.2533,16) BAROMETER:31.9\nISO:100",
    "older": "HOME(149.0251,-20.2532) 2017.8.5 14:11:51\nGPS(149.0251,-20.2533,16) Hb:31.9 Hs:1.9\nISO:100 TV:60",
    "mavic pro": "F/2.8, SS 206.14, ISO 150, EV 0, GPS (149.0251, -20.2533, 15), D 24.78m, H 31.90m, H.S 2.01m/s",
    "phantom 4 rtk": "GPS (149.0251, -20.2533, 15), D 24.1m, H 31.9m, H.S 3.0m/s, V.S 0.1m/s, "
    "F.PRY (-4.0°, 0.3°, 12.1°), G.PRY (-90.0°, 0.0°, 12.3°)",
}  # fmt: skip


@pytest.mark.parametrize("dialect", DIALECTS)
def test_dialects_of_dji_s_subtitles(tmp_path: Path, dialect: str) -> None:
    text, (lat, lon, amsl, above, sigma), gimbal_deg = DIALECTS[dialect]
    path = tmp_path / "a.srt"
    path.write_text(SRT_HEAD + text + "\n", encoding="utf-8")
    log = read_log(path)
    (fix,) = of(log, PositionFix)
    assert (fix.lat_deg, fix.lon_deg, fix.height_amsl_m, fix.height_above_home_m) == (lat, lon, amsl, above)
    assert of(log, GpsQuality)[0].sigma_datum_m == sigma
    gimbal = of(log, GimbalAttitude)
    assert bool(gimbal) is (gimbal_deg is not None)
    if gimbal_deg is not None:
        R = matrix_from_quaternion(gimbal[0].q_ref_gimbal)
        assert math.degrees(math.asin(-R[2, 0])) == pytest.approx(gimbal_deg[1])
        assert gimbal[0].reference == ("vehicle" if dialect == "siyi" else "earth")
    assert log.video_epoch_ns == fix.stamp_ns
    if dialect == "siyi":  # a tenth of a second of arc
        assert of(log, GpsQuality)[0].sigma_horizontal_m == pytest.approx(0.1 / 3600 * 111_320 / 12**0.5, rel=0.02)
        assert [ratio for _, ratio in log.digital_zoom] == [2.0]


@pytest.mark.parametrize("dialect", HOME_NEEDED)
def test_dialects_without_a_height_above_the_sea_ask_for_the_take_off_s(tmp_path: Path, dialect: str) -> None:
    path = tmp_path / "a.srt"
    path.write_text(SRT_HEAD + HOME_NEEDED[dialect] + "\n", encoding="utf-8")
    with pytest.raises(InputError, match="--home-amsl-m"):
        read_log(path)
    log = read_log(path, ReadOptions(home_amsl_m=400.0))
    (fix,) = of(log, PositionFix)
    assert (fix.lat_deg, fix.lon_deg, fix.height_amsl_m) == (-20.2533, 149.0251, 431.9)
    quality = of(log, GpsQuality)[0]
    assert quality.satellites in (15, 16)
    assert quality.sigma_horizontal_m == pytest.approx(11.132 / 12**0.5)  # four decimals
    if dialect == "phantom 4 rtk":
        R = matrix_from_quaternion(of(log, GimbalAttitude)[0].q_ref_gimbal)
        assert R[2, 0] == pytest.approx(1.0)


def test_a_truth_table_of_the_recordings_is_telemetry_as_it_stands() -> None:
    log = read_log(Path(__file__).parents[2] / "data" / "plane_turn.truth.csv")
    assert len(of(log, PositionFix)) == len(of(log, Attitude)) > 500


WRONG_DATES = {
    "a row that is thirty days early": [(-30 * 86_400.0, 1)],
    "a battery change": [(600.0, 50)],
    "rows that are hours apart": [(3600.0 * hour, 1) for hour in range(1, 200)],
}


@pytest.mark.parametrize("others", WRONG_DATES.values(), ids=WRONG_DATES)
def test_nothing_is_claimed_across_a_gap_of_time(tmp_path: Path, others: list[tuple[float, int]]) -> None:
    """A claim every 0.4 s across one wrong date were 6.5 million events."""
    starts = [(0.0, 100), *others]
    rows = [(1.7e9 + start_s + 0.2 * k, start_s, 1.0 + i) for i, (start_s, n) in enumerate(starts) for k in range(n)]
    lines = [f"{at:.3f},47.1,8.2,500.0,{sigma_m}" for at, _, sigma_m in rows]
    path = tmp_path / "a.csv"
    path.write_text("\n".join(["unix_time_s,lat_deg,lon_deg,height_amsl_m,sigma_horizontal_m", *lines]))
    log = read_log(path)
    assert len(of(log, PositionFix)) == len(rows)
    claims = of(log, GpsQuality)
    assert len(claims) < len(rows) + 5 * len(starts)
    for at, _, sigma_m in rows:  # and each position has its own, as new as a receiver's
        newest = [claim for claim in claims if claim.stamp_ns <= round(at * 1e9)][-1]
        assert at * 1e9 - newest.stamp_ns < 0.41e9 and newest.sigma_horizontal_m in (sigma_m, None)
    assert all(min(abs(claim.stamp_ns / 1e9 - at) for at, _, _ in rows) < 1.0 for claim in claims)


@pytest.mark.parametrize("hours", ["123456", "9" * 400, "9" * 5000])
def test_a_damaged_time_or_number_of_a_subtitle_is_left_out_in_no_time(tmp_path: Path, hours: str) -> None:
    """Some 400 bytes with such an hour had no end."""
    good = "00:00:0{0},000 --> 00:00:0{1},000\n[latitude: 47.1] [longitude: 8.2] [rel_alt: 30.1 abs_alt: {2}]\n\n"
    path = tmp_path / "a.srt"
    path.write_text(
        good.format(0, 1, "500.0")
        + good.format(2, 3, hours).replace("rel_alt: 30.1", f"rel_alt: {hours} gb_yaw: {hours} gb_pitch: 1 gb_roll: 1")
        + good.format(4, 5, "501.0").replace("00:00:04", f"{hours}:00:04")
        + good.format(6, 7, "502.0")
    )
    log = read_log(path)
    assert [fix.height_amsl_m for fix in of(log, PositionFix)] == [500.0, 502.0] and len(log.events) < 40
    assert not of(log, GimbalAttitude)
