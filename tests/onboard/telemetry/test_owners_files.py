"""Logs as their owners have them: resaved by spreadsheets, of clocks that were set, of several makers' habits."""

from __future__ import annotations

from pathlib import Path

import pytest

from contract.errors import InputError
from onboard.events.types import NavEvent, PositionFix
from onboard.telemetry.log_files import read_log
from onboard.telemetry.read_options import ReadOptions
from onboard.telemetry.telemetry_log import TelemetryLog

AIRDATA_HEAD = "time(millisecond),datetime(utc),latitude,longitude,height_above_takeoff(m),altitude_above_sealevel(m)\n"


def of(log: TelemetryLog, kind: type[NavEvent]) -> list:
    return [event for event in log.events if isinstance(event, kind)]


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
    assert sigma_s is not None and 9.0 < sigma_s < 11.0


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
    """As a spreadsheet shows and then writes them, or RTKLIB without decimals."""
    with pytest.raises(InputError, match=r"of its 100 positions have the time of another: its times were cut off"):
        read_text(tmp_path, f"{head}\n{rows_of(line)}")


@pytest.mark.parametrize("zero", ["0,0", "0.0000000,0.0000000"])
def test_a_place_of_zeros_is_no_fix_in_any_table(tmp_path: Path, zero: str) -> None:
    before = rows_of(f"17952169{{k:02d}},{zero},500")
    text = "unix_time_s,lat_deg,lon_deg,height_amsl_m\n" + before + rows_of("17952170{s:02d}.{d},47.1{k:06d},8.2,500")
    assert len(of(read_text(tmp_path, text), PositionFix)) == 100
