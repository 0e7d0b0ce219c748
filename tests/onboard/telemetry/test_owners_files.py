"""Logs as their owners have them: resaved by spreadsheets, of clocks that were set, of several makers' habits."""

import functools
import operator
from pathlib import Path

import pytest

from contract.errors import InputError
from onboard.events.types import GpsQuality, PositionFix
from onboard.telemetry.log_files import read_log
from onboard.telemetry.read_options import ReadOptions
from onboard.telemetry.telemetry_log import TelemetryLog
from tests.onboard.telemetry.log_events import of

AIRDATA_HEAD = "time(millisecond),datetime(utc),latitude,longitude,height_above_takeoff(m),altitude_above_sealevel(m)\n"


def rows_of(line: str, count: int = 100) -> str:
    """Ten lines a second, with `k` their number, `s` the second it is in and `d` the tenth."""
    return "".join(line.format(k=k, s=k // 10, d=k % 10) + "\n" for k in range(count))


def read_text(tmp_path: Path, text: str, options: ReadOptions | None = None) -> TelemetryLog:
    (tmp_path / "log").write_bytes(text.encode())
    return read_log(tmp_path / "log", options)


@pytest.mark.parametrize(
    ("line", "height_m"),
    [
        ('{k}00,2026-06-01 10:00:{s:02d},47.1{k:06d},8.2,100.0,"1,640"', 1640.0),  # grouped by three
        ('{k}00,2026-06-01 10:00:{s:02d},"47,1{k:06d}","8,2","100,0","1.640,5"', 1640.5),
        ('{k}00,2026-06-01 10:00:{s:02d},"47,1{k:06d}","8,2","100,0","640,125"', 640.125),
        ('{k}00,2026-06-01 10:00:{s:02d},"47,1{k:06d}","8,2","100,0",1.640', None),  # 1.64 or 1640: neither is taken
    ],
)
def test_a_mark_that_groups_digits_is_no_decimal_mark(tmp_path: Path, line: str, height_m: float | None) -> None:
    text = AIRDATA_HEAD + rows_of(line)
    if height_m is None:
        with pytest.raises(InputError, match="heights above the take-off only"):
            read_text(tmp_path, text)
        return
    fixes = of(read_text(tmp_path, text), PositionFix)
    assert {fix.height_amsl_m for fix in fixes} == {height_m} and len(fixes) == 100


def test_a_row_without_a_height_above_the_take_off_takes_none_of_another_origin(tmp_path: Path) -> None:
    lines = rows_of("{k}00,2026-06-01 10:00:{s:02d},47.1{k:06d},8.2,100.0,600.0").splitlines()
    text = "\n".join([*(line.replace(",100.0,", ",,") for line in lines[:30]), *lines[30:], ""])
    fixes = of(read_text(tmp_path, AIRDATA_HEAD + text, ReadOptions(home_amsl_m=400.0)), PositionFix)
    assert [fix.height_amsl_m for fix in fixes] == [500.0] * 70


def test_a_phone_s_clock_that_was_set_in_flight_is_no_better_than_that(tmp_path: Path) -> None:
    lines = rows_of("{k}00,2026-06-01 10:00:{s:02d},47.1{k:06d},8.2,100.0,600.0").splitlines()
    late = [line.replace("10:00:0", "10:00:1") if k > 70 else line for k, line in enumerate(lines)]
    assert read_text(tmp_path, AIRDATA_HEAD + "\n".join([*lines, ""])).utc_sigma_s == 1.0
    sigma_s = read_text(tmp_path, AIRDATA_HEAD + "\n".join([*late, ""])).utc_sigma_s
    assert 9.0 < sigma_s < 11.0


def test_the_dates_of_one_table_have_one_order_of_day_and_month(tmp_path: Path) -> None:
    """Across midnight of November 12, with times of 24 hours: the first half alone may be of December 11."""
    head = "CUSTOM.date [UTC],CUSTOM.updateTime [UTC],OSD.latitude,OSD.longitude,OSD.height [m],OSD.altitude [m]\n"
    before = rows_of("11/12/2026,23:59:5{s}.{d},47.1{k:06d},8.2,10.0,500.0", 100)
    after = rows_of("11/13/2026,0:00:0{s}.{d},47.2{k:06d},8.2,10.0,500.0", 100).replace("47.2000", "47.1001")
    log = read_text(tmp_path, head + before + after)
    assert log.span_ns == (1_794_527_990_000_000_000, 1_794_528_009_900_000_000)


@pytest.mark.parametrize(
    ("head", "line"),
    [
        ("unix_time_s,lat_deg,lon_deg,height_amsl_m", "1.79522E+09,47.1{k:06d},8.2,500"),
        ("unix_time_s,lat_deg,lon_deg,height_amsl_m", "17952170{s:02d},47.1{k:06d},8.2,500"),
        ("%  UTC  latitude(deg) longitude(deg)  height(m)  Q", "2026/06/01 10:00:{s:02d} 47.1{k:06d} 8.2 500 1 12"),
    ],
)
def test_times_that_were_cut_off_are_no_times(tmp_path: Path, head: str, line: str) -> None:
    """The times that a spreadsheet shows and then writes, or RTKLIB without decimals."""
    with pytest.raises(InputError, match=r"of its 100 positions have the time of another: its times were cut off"):
        read_text(tmp_path, f"{head}\n{rows_of(line)}")


@pytest.mark.parametrize("zero", ["0,0", "0.0000000,0.0000000"])
def test_a_place_of_zeros_is_no_fix_in_any_table(tmp_path: Path, zero: str) -> None:
    before = rows_of(f"17952169{{k:02d}},{zero},500")
    text = "unix_time_s,lat_deg,lon_deg,height_amsl_m\n" + before + rows_of("17952170{s:02d}.{d},47.1{k:06d},8.2,500")
    assert len(of(read_text(tmp_path, text), PositionFix)) == 100


def point(k: int, more: str = "", lat_deg: float = 47.1, height_m: float = 500.0, lon_deg: float = 8.2) -> str:
    return (
        f'<trkpt lat="{lat_deg}" lon="{lon_deg}"><ele>{height_m}</ele>'
        f"<time>2026-06-01T10:{k // 60:02d}:{k % 60:02d}Z</time>{more}</trkpt>"
    )


def gpx(*tracks: list[str]) -> str:
    return "<gpx>" + "".join(f"<trk><trkseg>{''.join(points)}</trkseg></trk>" for points in tracks) + "</gpx>"


def test_a_gpx_of_two_tracks_at_once_is_of_no_one_aircraft(tmp_path: Path) -> None:
    """The pilot's telephone within 100 m of it contradicts nothing."""
    flight, pilot = [point(k) for k in range(60)], [point(k, lat_deg=47.1003, height_m=450.0) for k in range(30, 90)]
    with pytest.raises(InputError, match="several of its tracks"):
        read_text(tmp_path, gpx(flight, pilot))
    two = read_text(tmp_path, gpx(flight, [point(k) for k in range(300, 360)]))
    assert len(of(two, PositionFix)) == 120


def test_points_of_a_gpx_without_a_fix_or_with_a_flat_one_are_left_out(tmp_path: Path) -> None:
    bad = [point(k, lat_deg=0.0, lon_deg=0.0, height_m=0.0) for k in range(20)]
    bad += [point(k, "<fix>2d</fix>", height_m=0.0) for k in range(20, 30)]
    log = read_text(tmp_path, gpx([*bad, *(point(k, "<fix>3d</fix>") for k in range(30, 60))]))
    assert [fix.height_amsl_m for fix in of(log, PositionFix)] == [500.0] * 30
    assert "30 of 60 track points" in log.notes[0] and "+-40 m" in log.notes[1]


def test_heights_of_a_gpx_that_come_down_to_about_0_may_be_the_take_off_s(tmp_path: Path) -> None:
    log = read_text(tmp_path, gpx([point(k, height_m=60.0 - k) for k in range(60)]))
    assert "+-300 m" in log.notes[0] and "they reach 1.0 m" in log.notes[0]


@pytest.mark.parametrize(
    ("system", "time", "unix_s"),
    [
        ("GPST", "2421 122400.000", 1_780_308_000 - 18),
        ("UTC", "2421 122400.000", 1_780_308_000),
        ("JST", "2421 122400.000", 1_780_308_000 - 9 * 3600),
        ("GPST", "2026/06/01 10:00:00.000", 1_780_308_000 - 18),
    ],
)
def test_the_times_of_rtklib_are_of_the_system_in_its_head(tmp_path: Path, system: str, time: str, unix_s: int) -> None:
    """A week and its seconds are counted in that system too."""
    text = f"%  {system}  latitude(deg) longitude(deg)  height(m)  Q\n{time} -47.1 -8.2 500 1 12\n"
    assert read_text(tmp_path, text).span_ns[0] == unix_s * 10**9


@pytest.mark.parametrize(("separation", "sigma_m"), [("48.0", None), ("0.0", 40.0), ("", 40.0)])
def test_heights_of_a_receiver_that_knows_no_geoid_may_be_the_ellipsoid_s(
    tmp_path: Path, separation: str, sigma_m: float | None
) -> None:
    texts = ("GPRMC,100000.00,A,4706.0,N,00812.0,E,10.0,90.0,010626,,,A",
             f"GPGGA,100000.00,4706.0,N,00812.0,E,1,12,0.8,500.0,M,{separation},M,,")  # fmt: skip
    log = read_text(tmp_path, "".join(f"${t}*{functools.reduce(operator.xor, t.encode()):02X}\r\n" for t in texts))
    (quality,) = of(log, GpsQuality)
    assert quality.sigma_datum_m == sigma_m
    assert any("geoid" in note for note in log.notes) is (sigma_m is not None)


def test_a_receiver_s_positions_of_another_datum_are_refused(tmp_path: Path) -> None:
    """Tokyo's are 400 m off."""
    parts = ["GPDTM,{0},,0.1,N,0.1,W,10,W84", "GPRMC,100000.00,A,4706.0,N,00812.0,W,10.0,90.0,010626,,,A"]
    parts.append("GPGGA,100000.00,4706.0,N,00812.0,W,1,12,0.8,500.0,M,48.0,M,,")

    def of_datum(name: str) -> str:
        texts = [part.format(name) for part in parts]
        return "".join(f"${t}*{functools.reduce(operator.xor, t.encode()):02X}\r\n" for t in texts)

    (fix,) = of(read_text(tmp_path, of_datum("W84")), PositionFix)
    assert (fix.lat_deg, fix.lon_deg) == (47.1, -8.2)
    with pytest.raises(InputError, match="datum TOY, not WGS 84"):
        read_text(tmp_path, of_datum("TOY"))


def test_a_letter_and_a_sign_that_both_mean_south_are_no_position_and_no_crash(tmp_path: Path) -> None:
    text = "1\n00:00:00,000 --> 00:00:01,000\nGPS(E: 8.2, S: -47.1, 501.3m)\n"
    with pytest.raises(InputError, match="no position in its 1 subtitles"):
        read_text(tmp_path, text)
    (fix,) = of(read_text(tmp_path, text.replace("S: -", "S: ")), PositionFix)
    assert fix.lat_deg == -47.1
