"""DJI's subtitles: which number is the latitude, how well a height is known, digital zoom and stabilisation."""

import math
from pathlib import Path

import pytest

from contract.errors import InputError
from onboard.events.types import GpsQuality, PositionFix
from onboard.telemetry.log_files import read_log
from onboard.telemetry.read_options import ReadOptions
from onboard.telemetry.srt_axis_order import Order
from onboard.telemetry.telemetry_log import TelemetryLog
from tests.onboard.telemetry.log_events import of
from tests.onboard.telemetry.log_writers import written

METRES_A_DEGREE = 111_320.0


def subtitles(*texts: str, step_s: int = 1) -> str:
    return "\n".join(
        f"{i + 1}\n00:{i * step_s // 60:02d}:{i * step_s % 60:02d},000 --> 00:{(i + 1) * step_s // 60:02d}:"
        f"{(i + 1) * step_s % 60:02d},000\n{text}\n"
        for i, text in enumerate(texts)
    )


def read(tmp_path: Path, *texts: str, order: Order | None = None, home_amsl_m: float | None = 100.0) -> TelemetryLog:
    path = tmp_path / "a.srt"
    path.write_text(subtitles(*texts), encoding="utf-8")
    return read_log(path, ReadOptions(home_amsl_m=home_amsl_m, gps_order=order))


def first(log: TelemetryLog) -> tuple[float, float]:
    fix = of(log, PositionFix)[0]
    return fix.lat_deg, fix.lon_deg


def claim(log: TelemetryLog) -> GpsQuality:
    return of(log, GpsQuality)[0]


@pytest.mark.parametrize(
    ("text", "place", "why"),
    [
        ("2022.06.21 16:06:17\nGPS(36.5,-6.25,0.0M) BAROMETER:0.3M", (36.5, -6.25), "a height in metres third"),
        ("GPS(52.1,5.3,12.300) BAROMETER(91.2) H 3.0m HOME(52.1,5.3)", (52.1, 5.3), "Avata 2"),
        ("GPS(39.9,116.4,69.800) BAROMETER(91.2) H 3.0m HOME(39.9,116.4)", (39.9, 116.4), "beyond 90"),
        ("HOME(8.2,47.1) 2017.08.05 14:11:51\nGPS(8.2,47.1,16) BAROMETER:31.9", (47.1, 8.2), "number of satellites"),
        ("F/2.8, SS 206.14, ISO 150, EV 0, GPS (149.0251, -20.2533, 15), D 4.8m, H 31.9m", (-20.2533, 149.0251), "90"),
        ("F/6.3, SS 60, RTK (8.2, 47.1, 28), HOME (8.2, 47.1, 103.5m), D 0.0m, H 76.2m", (47.1, 8.2), "satellites"),
    ],
)  # fmt: skip
def test_the_latitude_of_gps_a_b_is_known_by_range_or_by_the_model_s_format(
    tmp_path: Path, text: str, place: tuple[float, float], why: str
) -> None:
    log = read(tmp_path, text, text)
    assert first(log) == place
    (note,) = [note for note in log.notes if "GPS(a, b)" in note]
    assert why in note and ("latitude, longitude" in note) is (text.find(str(place[0])) < text.find(str(place[1])))


def test_labels_need_no_order(tmp_path: Path) -> None:
    log = read(tmp_path, "[latitude: 36.5] [longitude: -6.25] [rel_alt: 3.0 abs_alt: 50.0]", home_amsl_m=None)
    assert first(log) == (36.5, -6.25) and not any("GPS(a, b)" in note for note in log.notes)
    log = read(tmp_path, "HOME(W: 6.25, N: 36.5) 2023-01-01 12:00:01\nGPS(W: 6.25, N: 36.5, 001.01m)", home_amsl_m=None)
    assert first(log) == (36.5, -6.25)


def test_of_a_text_a_second_the_moment_is_known_to_as_much(tmp_path: Path) -> None:
    """Half a second in it left none of the clicks of a straight flight in its 90 % ellipse, in turns a seventh."""
    texts = [f"[latitude: 36.50000{k}] [longitude: -6.25] [rel_alt: 3.0 abs_alt: 50.0]" for k in range(4)]
    assert read(tmp_path, *texts).position_sigma_s == pytest.approx(12.0**-0.5)
    assert read(tmp_path, *texts).video_s == (3.0, 1.0)
    assert read(tmp_path, texts[0]).position_sigma_s == 0.0
    assert 0.005 < read_log(written(tmp_path, "srt")).position_sigma_s < 0.02  # of one for each picture


UNKNOWN = "GPS({a:.6f}, {b:.6f}, 95), D {d:.2f}m, H 31.9m, H.S {v:.2f}m/s"  # 95: neither satellites nor in metres


def flight_north_east(order: Order, has_home: bool) -> list[str]:
    """Two minutes at 8 m/s, first east, then north, from 52 N 8 E, as a model of no known format would write it."""
    out = []
    for i in range(120):
        east_m, north_m = 8.0 * min(i, 60), 8.0 * max(i - 60, 0)
        lat = 52.0 + north_m / METRES_A_DEGREE
        lon = 8.0 + east_m / METRES_A_DEGREE / math.cos(math.radians(52.0))
        a, b = (lat, lon) if order == "lat-lon" else (lon, lat)
        home = (52.0, 8.0) if order == "lat-lon" else (8.0, 52.0)
        text = UNKNOWN.format(a=a, b=b, d=math.hypot(east_m, north_m), v=8.0)
        out.append(text + (f", HOME({home[0]}, {home[1]})" if has_home else ""))
    return out


@pytest.mark.parametrize("order", ["lat-lon", "lon-lat"])
@pytest.mark.parametrize("has_home", [True, False])
def test_distances_from_home_or_speeds_tell_the_order_of_an_unknown_format(
    tmp_path: Path, order: Order, has_home: bool
) -> None:
    log = read(tmp_path, *flight_north_east(order, has_home))
    assert first(log) == (52.0, 8.0)
    assert ("distances from home" if has_home else "speeds") in log.notes[0]


def test_what_nothing_tells_is_refused_in_one_line_that_says_the_way_on(tmp_path: Path) -> None:
    text = UNKNOWN.format(a=36.5, b=-6.25, d=0.0, v=0.0)
    with pytest.raises(InputError, match=r"--gps-order lat-lon or --gps-order lon-lat") as caught:
        read(tmp_path, text)
    assert "\n" not in str(caught.value)
    assert first(read(tmp_path, text, order="lat-lon")) == (36.5, -6.25)
    assert first(read(tmp_path, text, order="lon-lat")) == (-6.25, 36.5)


def test_a_format_that_the_distances_contradict_is_refused(tmp_path: Path) -> None:
    """The format says longitude first, the distances latitude first: neither is taken."""
    texts = [text.replace(", 95)", ", 15)") for text in flight_north_east("lat-lon", has_home=True)]
    with pytest.raises(InputError, match=r"contradicts itself.*--gps-order"):
        read(tmp_path, *texts)
    assert first(read(tmp_path, *texts, order="lat-lon")) == (52.0, 8.0)
    agreeing = [text.replace(", 95)", ", 15)") for text in flight_north_east("lon-lat", has_home=True)]
    assert first(read(tmp_path, *agreeing)) == (52.0, 8.0)


def test_a_stated_order_that_cannot_be_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="leave --gps-order out"):
        read(tmp_path, "GPS(149.0251,-20.2533,16) BAROMETER:31.9", order="lat-lon")


def test_one_damaged_number_does_not_turn_the_order_of_the_others(tmp_path: Path) -> None:
    texts = [f"GPS(36.{500 + i},-6.25,0.0M) BAROMETER:{i}.0M" for i in range(40)]
    texts[7] = texts[7].replace("GPS(36", "GPS(936")
    log = read(tmp_path, *texts)
    assert first(log) == (36.5, -6.25)
    assert all(fix.lat_deg < 37.0 for fix in log.events if isinstance(fix, PositionFix))


@pytest.mark.parametrize(
    ("name", "place", "spread_deg"),
    [
        ("matrice_300.srt", (36.6, -6.1), 0.1),  # Spain, not 6 S 36 E
        ("air2s.srt", (41.42, 2.23), 0.1),
        ("mavic_air2.srt", (41.42, 2.16), 0.1),
        ("Mini5PRO.SRT", (53.365, 6.46), 0.1),
        ("neo2.SRT", (45.6, 13.75), 0.1),
    ],
)
def test_real_subtitles_of_several_models_lie_where_they_were_recorded(
    shared_data: Path, name: str, place: tuple[float, float], spread_deg: float
) -> None:
    log = read_log(shared_data / "logs" / name, ReadOptions(home_amsl_m=10.0 if name == "matrice_300.srt" else None))
    for fix in log.events:
        if isinstance(fix, PositionFix):
            assert (fix.lat_deg, fix.lon_deg) == pytest.approx(place, abs=spread_deg)


@pytest.mark.parametrize("name", ["Mini5PRO.SRT", "Avata360.SRT"])
def test_the_stated_height_above_the_sea_covers_a_take_off_at_minus_130_m(shared_data: Path, name: str) -> None:
    """Both were recorded from a field in the Netherlands, 1 m above the sea, on a day of high pressure."""
    log = read_log(shared_data / "logs" / name)
    fix = of(log, PositionFix)[0]
    error_m = fix.height_amsl_m - fix.height_above_home_m - 1.0
    sigma_m = claim(log).sigma_datum_m
    assert abs(error_m) < 1.645 * sigma_m < 200.0
    assert any("--home-amsl-m" in note for note in log.notes)
    known = read_log(shared_data / "logs" / name, ReadOptions(home_amsl_m=1.0))
    assert claim(known).sigma_datum_m is None and not any("--home-amsl-m" in note for note in known.notes)


PLACE = "[latitude: 48.1] [longitude: 11.5] [rel_alt: 1.3 abs_alt: 512.3]"


@pytest.mark.parametrize(
    ("text", "ratio"),
    [
        (f"[focal_len: 24.00] [dzoom_ratio: 2.00], {PLACE}", 2.0),
        (f"[focal_len : 240] [dzoom_ratio: 20000, delta:0],{PLACE}", 2.0),
        (f"[focal_len : 240] [dzoom_ratio: 10000, delta:0],{PLACE}", 1.0),
        ("F/2.8, ISO 100, EV 0, DZOOM 1.500, GPS (120.35, 23.12, 26), D 49.2m, H 98.0m, H.S 4.8m/s", 1.5),
    ],
)
def test_digital_zoom_is_read_in_every_way_it_is_written(tmp_path: Path, text: str, ratio: float) -> None:
    log = read(tmp_path, text, text)
    assert [zoom for _, zoom in log.digital_zoom] == [ratio]
    assert log.digital_zoom[0][0] == log.video_epoch_ns


@pytest.mark.parametrize(("word", "is_on"), [("normal", True), ("close", False), ("rocksteady", True), ("off", False)])
def test_stabilisation_that_was_on_is_reported(tmp_path: Path, word: str, is_on: bool) -> None:
    notes = read(tmp_path, f"{PLACE} [vsync: 0] [eis: {word}] [shift x: 0.00, y: 0.00]").notes
    assert any("stabilisation was on" in note and word in note for note in notes) is is_on


def placed(*offsets_m: float) -> list[str]:
    return [
        f"[latitude: {47.0 + north_m / METRES_A_DEGREE:.7f}] [longitude: 8.2] [rel_alt: 30 abs_alt: 530]"
        for north_m in offsets_m
    ]


def test_two_rows_that_contradict_one_another_are_refused(tmp_path: Path) -> None:
    with pytest.raises(
        InputError, match=r"a\.srt: an \.srt: positions contradict one another: .* 4993 m and 1\.00 s apart"
    ):
        read(tmp_path, *placed(0.0, 5000.0))
    assert len([e for e in read(tmp_path, *placed(0.0, 250.0)).events if isinstance(e, PositionFix)]) == 2


@pytest.mark.parametrize("wrong", [0, 7, 19])
def test_one_row_that_contradicts_all_others_is_left_out_and_reported(tmp_path: Path, wrong: int) -> None:
    rows = placed(*(20.0 * i + 40_000.0 * (i == wrong) for i in range(20)))
    log = read(tmp_path, *rows)
    fixes = of(log, PositionFix)
    assert len(fixes) == 19 and max(fix.lat_deg for fix in fixes) < 47.01
    assert any("1 of 20 positions contradict the others" in note for note in log.notes)


def test_dates_that_contradict_one_another_are_refused_and_one_among_many_is_left_out(tmp_path: Path) -> None:
    dated = [f"2024-05-01 10:00:{i:02d}.000\n{row}" for i, row in enumerate(placed(*(20.0 * i for i in range(20))))]
    good = read(tmp_path, *dated)
    with pytest.raises(InputError, match=r"dates contradict one another.*2024-05-01 10:00:00.*2024-05-01 11:00:00"):
        read(tmp_path, dated[0], dated[1].replace(" 10:", " 11:"))
    late = read(tmp_path, *dated[:9], dated[9].replace(" 10:", " 11:"), *dated[10:])
    assert late.video_epoch_ns == good.video_epoch_ns and good.notes != late.notes
    assert any("1 of 20 dates" in note for note in late.notes)


def test_a_table_s_rows_are_judged_in_the_same_way(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    rows = [f"{1.7e9 + 0.1 * i:.2f},{47.0 + 1e-5 * i + (i == 9):.7f},8.2,500" for i in range(20)]
    path.write_text("\n".join(["unix_time_s,lat_deg,lon_deg,height_amsl_m", *rows]) + "\n")
    log = read_log(path)
    assert len(of(log, PositionFix)) == 19
    assert any("1 of 20 positions contradict" in note for note in log.notes)
    path.write_text("\n".join(["unix_time_s,lat_deg,lon_deg,height_amsl_m", *rows[8:10]]) + "\n")
    with pytest.raises(InputError, match="positions contradict one another"):
        read_log(path)
