"""Survey photographs become a flight in one command, and its clicks are where they should be."""

import csv
import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import ExifTags, Image

from contract.camera import Camera
from contract.errors import InputError
from contract.wire.message import SPOT_REPORTS
from ground.__main__ import main as ground
from ground.formats import table
from ground.recording import Recording
from onboard.__main__ import main
from onboard.camera.photo_metadata import read_photo
from onboard.commands.camera_clock import against_log, clock_of
from onboard.config.files import load_config_files
from onboard.config.schema import parse_config
from onboard.events.types import Attitude, GimbalAttitude, PositionFix
from onboard.foreign_clock.clock_search import Stated
from onboard.replay.photo_telemetry import photo_telemetry
from onboard.replay.runner import Flight
from onboard.telemetry.telemetry_log import TelemetryLog
from onboard.telemetry.tlog_reader import read_tlog
from simulation.flight import DescribedSpec
from simulation.paths import PathSpec
from simulation.session import SessionSpec
from tests.onboard.photographs import Style, write_photographs
from tests.onboard.radiometric_pictures import make_radiometric
from tests.own_flights import write_named_photographs
from tests.rest_long import rest_long
from tests.scenarios.flights import Outcome, click, simulated

pytestmark = pytest.mark.xdist_group("import photos")  # one worker: what they share is made once

CAMERA = Camera.from_field_of_view(400, 300, 70.0)
PICTURES, APART_S = 16, 2.1
SURVEY = PathSpec("survey", speed_m_s=9.0, height_m=120.0, wobble_deg=0.3, pitch_deg=0.0, leg_m=100.0, spacing_m=45.0)


@pytest.fixture(scope="module")
def session() -> Path:
    return simulated(
        SessionSpec(
            DescribedSpec(SURVEY), seconds=PICTURES * APART_S, rate_hz=1 / APART_S, camera=CAMERA, clicks_per_frame=8
        )
    )


def imported(session: Path, folder: Path, style: Style) -> Path:
    write_photographs(session, folder / "photos", style)
    assert main(["import-photos", str(folder / "photos"), "--out", str(folder / "flight")]) == 0
    return folder / "flight"


def replayed(session: Path, flight: Path, capsys: pytest.CaptureFixture[str]) -> Outcome:
    """By the very line that the import printed."""
    command = capsys.readouterr().out.splitlines()[-1].split()
    assert command[0] == "pc-onboard"
    assert main(command[1:]) == 0
    recording = Recording(flight / "session.mcap")
    (vehicle,) = recording.vehicles
    sets = {frame: recording.by_frame(vehicle, frame) for frame in recording.frames(vehicle)}
    return click(session, {frame: found for frame, found in sets.items() if found is not None}, None)


STYLES = {
    "a camera drone, times cut to the second": (Style(whole_seconds=True), 8.0),
    "the same with RTK": (Style(rtk=True, offset_m=(0.0, 0.0, 0.0), white_m=0.02), 6.0),
    "a survey camera without angles": (Style(angles=False, focal="equivalent"), 20.0),
}


@pytest.mark.parametrize("name", rest_long(STYLES))
def test_a_folder_of_photographs_is_clicked_within_its_radius(
    session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    style, widest_m = STYLES[name]
    outcome = replayed(session, imported(session, tmp_path, style), capsys)
    assert outcome.solved >= 0.9, outcome.reported
    assert outcome.inside_99 >= 0.97, outcome.reported
    assert np.median(outcome.errors_m) < 3.0, outcome.reported
    assert 0.5 < np.median(outcome.semi_m) < widest_m, outcome.reported


@pytest.mark.long
def test_a_folder_of_r_jpegs_is_a_thermal_flight_clicked_by_its_counts(
    session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Their picture is black hot, in colours and saturated."""
    write_photographs(session, tmp_path / "photos", Style())
    for path in (tmp_path / "photos").iterdir():
        make_radiometric(path)
    assert main(["import-photos", str(tmp_path / "photos"), "--out", str(tmp_path / "flight")]) == 0
    config = parse_config((tmp_path / "flight" / "config.toml").read_text())
    assert config.thermal.enabled and config.thermal.scale is None
    outcome = replayed(session, tmp_path / "flight", capsys)
    assert outcome.solved >= 0.9 and outcome.inside_99 >= 0.97 and np.median(outcome.errors_m) < 3.0, outcome.reported
    recording = Recording(tmp_path / "flight" / "session.mcap")
    assert len(recording.reports(SPOT_REPORTS, recording.vehicles)) == PICTURES  # each was searched for hot spots


def test_it_says_what_it_assumed_and_writes_it_down(
    session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flight = imported(session, tmp_path, Style(whole_seconds=True))
    printed = capsys.readouterr().out
    for words in (
        "16 of DJI FC7303",
        "cut to the second",
        "from CalibratedFocalLength",
        "gimbal's angles",
        "barometer, +-100 m",
    ):
        assert words in printed, printed
    camera, raw = Camera.from_json(flight / "camera.json"), json.loads((flight / "camera.json").read_text())
    assert camera.fx_px == pytest.approx(CAMERA.fx_px, rel=1e-6) and camera.size_px == CAMERA.size_px
    sigma = raw["calibration"]["sigma"]
    assert 0.005 < sigma["fx"] / camera.fx_px < 0.03
    assert set(sigma) == {"fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"}
    config = load_config_files(flight / "config.toml")
    assert config.mount.gimbal == "always" and config.gps.max_gap_s > APART_S
    with (flight / "stamps.csv").open() as stream:
        assert len(list(csv.DictReader(stream))) == PICTURES
    assert (flight / "frames" / "DJI_0001.JPG").is_symlink()


def test_clicks_by_the_photograph_s_name(session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flight = imported(session, tmp_path, Style())
    replayed(session, flight, capsys)
    clicks = tmp_path / "clicks.csv"
    clicks.write_text("file,u,v\nDJI_0008.JPG,200,150\n/elsewhere/DJI_0009.JPG,180,140\n")
    capsys.readouterr()
    assert ground(["click", "--batch", str(clicks), "--from", str(flight / "session.mcap")]) == 0
    answers = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [(a["status"], a["frame"]) for a in answers] == [("ok", 7), ("ok", 8)]


def test_the_pictures_own_words_are_the_same_telemetry(session: Path, tmp_path: Path) -> None:
    """`--telemetry exif` and the table that the import wrote."""
    flight = imported(session, tmp_path, Style())
    config, camera = load_config_files(flight / "config.toml"), Camera.from_json(flight / "camera.json")
    own, table = (
        Flight.open(config, camera, flight / "frames", source, None if source == "exif" else flight / "stamps.csv")
        for source in ("exif", flight / "telemetry.csv")
    )
    assert own.stamps_ns == table.stamps_ns
    for kind in (PositionFix, Attitude, GimbalAttitude):
        one, other = ([e for e in f.telemetry.events if isinstance(e, kind)] for f in (own, table))
        assert len(one) == len(other) == PICTURES
        assert [e.stamp_ns for e in one] == [e.stamp_ns for e in other] == list(own.stamps_ns)
    fixes = [[e for e in f.telemetry.events if isinstance(e, PositionFix)] for f in (own, table)]
    for a, b in zip(*fixes, strict=True):
        assert (a.lat_deg, a.lon_deg, a.height_amsl_m) == pytest.approx(
            (b.lat_deg, b.lon_deg, b.height_amsl_m), abs=1e-8
        )


def test_exif_alone_says_what_the_configuration_must_join(
    session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flight = imported(session, tmp_path, Style())
    capsys.readouterr()
    arguments = ["replay", "--frames", str(flight / "frames"), "--telemetry", "exif", "--camera"]
    assert main([*arguments, str(flight / "camera.json")]) == 2
    err = capsys.readouterr().err
    assert "set gps.max_gap_s" in err and "import-photos" in err and err.count("\n") == 1


def spoilt(folder: Path, how: str) -> None:
    photo = sorted(folder.iterdir())[3]
    with Image.open(photo) as image:
        image.load()
        exif = image.getexif()
        size = (200, 150) if how == "size" else image.size
        details, gps = exif.get_ifd(ExifTags.IFD.Exif), exif.get_ifd(ExifTags.IFD.GPSInfo)
        if how == "time":
            details.pop(ExifTags.Base.DateTimeOriginal)
        if how == "place":
            gps.clear()
        if how == "model":
            exif[ExifTags.Base.Model] = "another"
        if how == "serial":  # two cameras of one kind, whose pictures were copied into one folder
            details[ExifTags.Base.BodySerialNumber] = "1581F4BND"
        xmp = b"" if how in ("place", "focal") else image.info.get("xmp", b"")
        copy = image.resize(size)
    copy.save(photo, "JPEG", exif=exif, xmp=xmp)
    if how == "cut":
        photo.write_bytes(photo.read_bytes()[:40])


@pytest.mark.parametrize(
    ("how", "printed"),
    [
        ("size", "another size than most"),
        ("model", "another camera than most"),
        ("serial", "another camera's serial number than most"),
        ("time", "no DateTimeOriginal"),
        ("place", "no GPS position with a height in DJI_0004.JPG; give a log of the flight instead"),
        ("focal", "no focal length in EXIF"),
        ("cut", "cannot be read"),
    ],
)
def test_what_cannot_be_a_flight_is_one_line_and_nothing_is_written(
    session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], how: str, printed: str
) -> None:
    style = Style(angles=False, focal="plane") if how == "place" else Style()
    write_photographs(session, tmp_path / "photos", style)
    spoilt(tmp_path / "photos", how)
    assert main(["import-photos", str(tmp_path / "photos"), "--out", str(tmp_path / "flight")]) == 2
    err = capsys.readouterr().err
    assert printed in err and err.count("\n") == 1
    assert not (tmp_path / "flight").exists()


def test_pictures_named_by_utc_are_a_flight_with_the_log_and_the_camera_file_next_to_them(
    shared_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Such a folder was refused for want of EXIF, though `replay` took it."""
    real = shared_data / "cmac_2018"
    assert main(["import-photos", str(real / "frames"), "--out", str(tmp_path / "flight")]) == 0
    printed = capsys.readouterr().out
    assert "18 of" in printed and "of the names, with fractions" in printed and "cmac_2018/telemetry.tlog" in printed
    assert Camera.from_json(tmp_path / "flight" / "camera.json") == Camera.from_json(real / "camera.json")
    stamps = (tmp_path / "flight" / "stamps.csv").read_text().splitlines()
    # The names were given some time after the exposure, by the pictures' own motion.
    name, first_s = stamps[1].split(",")
    assert name == "2018080501004480Z.jpg" and len(stamps) == 19
    assert -0.4 < float(first_s) - 1533430844.8 < -0.1


@pytest.mark.parametrize(
    ("pictures", "log", "named"),
    [
        ("frames", "flight.tlog", ""),
        ("DCIM/100MEDIA", "LOGS/flight.tlog", ""),
        ("DCIM/100MEDIA", "flight.tlog", ""),
        ("DCIM/100MEDIA", "DCIM/flight.tlog", "DCIM"),
        ("", "../flight.tlog", ""),
    ],
)
def test_pictures_and_log_are_found_below_the_folder_that_is_named(
    session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], pictures: str, log: str, named: str
) -> None:
    """And a table that is no log, such as our own export, is none, wherever it lies."""
    card, made = tmp_path / "card", tmp_path / "made"
    write_named_photographs(session, made)
    shutil.copytree(made, card / pictures, ignore=shutil.ignore_patterns("*.tlog"), dirs_exist_ok=True)
    (card / log).parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(made / "flight.tlog", card / log)
    for place in {tmp_path, card, card / pictures}:
        (place / "pins.csv").write_text(table.header())
    assert main(["import-photos", str(card / named), "--out", str(tmp_path / "flight")]) == 0
    printed = capsys.readouterr().out
    assert str((card / log).resolve()) in printed.replace(str(card / log), str((card / log).resolve()))
    (card / "other").mkdir()
    shutil.copyfile(next((card / pictures).glob("*.png")), card / "other" / "one.png")
    if pictures and not named:
        assert main(["import-photos", str(card), "--out", str(tmp_path / "again")]) == 2
        assert "pictures in 2 folders below it: name one" in capsys.readouterr().err


def test_a_folder_with_nothing_but_our_own_export_has_no_log(
    session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_named_photographs(session, tmp_path / "photos")
    (tmp_path / "photos" / "flight.tlog").unlink()
    (tmp_path / "x.csv").write_text(table.header() + "1,car,vehicle,ok,-43.1,172.2\r\n")
    assert main(["import-photos", str(tmp_path / "photos"), "--out", str(tmp_path / "flight")]) == 2
    assert "no log next to them: give a log" in capsys.readouterr().err


def test_a_flight_s_own_folder_has_its_times_and_its_configuration(
    session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["import-photos", str(session), "--out", str(tmp_path / "flight")]) == 0
    printed = capsys.readouterr().out
    assert f"configuration  {session / 'config.toml'}, nothing guessed" in printed
    assert parse_config((tmp_path / "flight" / "config.toml").read_text()) == parse_config(
        (session / "config.toml").read_text()
    )
    assert len((tmp_path / "flight" / "stamps.csv").read_text().splitlines()) == len(
        (session / "stamps.csv").read_text().splitlines()
    )


def test_times_of_photographs_from_a_file_that_is_named(
    session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    photos, taken = tmp_path / "photos", tmp_path / "taken.csv"
    shutil.copytree(session / "frames", photos)
    shutil.copyfile(session / "stamps.csv", taken)
    named = ("--telemetry", str(session / "telemetry.tlog"), "--set", f"camera.file={session / 'camera.json'}")
    command = ["import-photos", str(photos), *named, "--stamps", str(taken), "--out", str(tmp_path / "flight")]
    assert main(command) == 0
    assert f"of {taken}" in capsys.readouterr().out
    taken.write_text("file,unix_time_s\nother.png,1790000065.0\n")
    assert main([*command[:-1], str(tmp_path / "again")]) == 2
    assert f"stamps {taken}: of fewer than 3 pictures" in capsys.readouterr().err


@pytest.mark.long  # short: a folder is clicked within its radius, above
def test_a_camera_of_which_nothing_is_known_and_a_log_in_the_folder(
    session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_named_photographs(session, tmp_path / "photos")
    assert main(["import-photos", str(tmp_path / "photos"), "--out", str(tmp_path / "flight")]) == 0
    outcome = replayed(session, tmp_path / "flight", capsys)
    assert outcome.solved >= 0.8, outcome.reported
    assert outcome.inside_99 >= 0.97, outcome.reported


def test_a_clock_that_nothing_ties_is_refused_by_that_name_until_it_is_stated(
    session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_photographs(session, tmp_path / "photos", Style(gps=False, angles=False, focal="plane"))
    log = tmp_path / "later.csv"
    with (session / "truth.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    first_s, last_s = (float(rows[k]["unix_time_s"]) - 5.5 * 3600.0 for k in (0, -1))
    lines = ["unix_time_s,lat_deg,lon_deg,height_amsl_m"]
    lines += [f"{t:.1f},{rows[0]['lat_deg']},{rows[0]['lon_deg']},200" for t in np.arange(first_s - 60, last_s + 60)]
    log.write_text("\n".join(lines))
    command = ["import-photos", str(tmp_path / "photos"), "--telemetry", str(log), "--out", str(tmp_path / "flight")]
    assert main(command) == 2
    err = capsys.readouterr().err  # a log that stands still shows no offset at all
    assert "error: clock: " in err and "--clock-offset" in err and err.count("\n") == 1
    assert main([*command, "--utc-offset", "5.5"]) == 2
    assert main([*command, "--utc-offset", "5.5", "--clock-offset", "0.0"]) == 0
    assert load_config_files(tmp_path / "flight" / "config.toml").camera.sigma_latency_s == pytest.approx(
        0.11, abs=0.01
    )


def test_pictures_of_two_days_with_the_log_of_one_are_refused_as_such(session: Path) -> None:
    """It asked for the clock, which was right."""
    log = read_tlog(session / "telemetry.tlog")
    begin_ns, end_ns = log.span_ns
    taken_ns = [round(ns) for ns in np.linspace(begin_ns + 2e9, end_ns - 2e9, 16)]
    of_two = [ns - 86_400_000_000_000 * (k < 7) for k, ns in enumerate(taken_ns)]
    config = parse_config("[mount]\npitch_deg = -90.0")
    with pytest.raises(InputError, match=r"7 of 16 pictures were taken 24\.0 h before the others, and the log"):
        clock_of(log, config, CAMERA, of_two, 0.03, lambda _: None, None)
    with pytest.raises(InputError, match="by how much the camera's is off"):
        clock_of(log, config, CAMERA, taken_ns, 0.03, lambda _: None, None)


def test_positions_by_name_go_before_the_photographs_own(
    session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """OpenDroneMap's geo.txt next to them, or named; it must have all of them, in degrees."""
    photos, made = tmp_path / "photos", tmp_path / "flight"
    write_photographs(session, photos, Style())
    names = sorted(path.name for path in photos.glob("*.JPG"))
    with (session / "truth.csv").open(newline="") as stream:  # as they flew, 80 m farther east
        places = [(float(row["lon_deg"]) + 0.001, row["lat_deg"]) for row in csv.DictReader(stream)]
    placed = enumerate(zip(names, places, strict=True))
    lines = [f"{name} {lon:.9f} {lat} {400 + k} 0 0 0 0.03 0.05" for k, (name, (lon, lat)) in placed]
    geo = photos / "geo.txt"
    geo.write_text("\n".join(["EPSG:4326", *lines]))
    assert main(["import-photos", str(photos), "--out", str(made)]) == 0
    printed = capsys.readouterr().out
    assert f"places     {geo}" in printed and "of an unnamed origin, +-40 m" in printed
    with (made / "telemetry.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [float(row["height_amsl_m"]) for row in rows] == [400.0 + k for k in range(len(names))]
    assert [row["lon_deg"] for row in rows] == [f"{lon:.9f}" for lon, _ in places]
    stated = ("sigma_horizontal_m", "sigma_vertical_m", "sigma_datum_m")
    assert {tuple(row[name] for name in stated) for row in rows} == {("0.03", "0.05", "40.0")}
    command = ["import-photos", str(photos), "--telemetry", str(geo), "--out", str(tmp_path / "again")]
    for content, printed in (
        ("EPSG:4326\n" + "\n".join(lines[1:]), f"none of {names[0]}"),
        ("EPSG:32759\n" + "\n".join(lines), "its coordinates are in EPSG:32759"),
        ("EPSG:4326\n" + names[0] + " 172.4 x 400", "line 2: not name"),
        ("EPSG:4326\n" + names[0] + " 172.4 -43.0", "line 2: not name"),
    ):
        geo.write_text(content)
        assert main(command) == 2
        assert printed in capsys.readouterr().err


def test_what_is_stated_of_utc_is_worth_what_the_log_s_clock_is() -> None:
    stated, log = Stated(12.0, 0.3, "the GPS time in EXIF"), TelemetryLog([], [])
    assert against_log(stated, log, is_given=False) == stated
    by_a_phone = against_log(stated, replace(log, utc_sigma_s=0.4), is_given=False)
    assert by_a_phone.sigma_s == pytest.approx(0.5)
    local = replace(log, utc_sigma_s=None)
    assert against_log(stated, local, is_given=False) is None and against_log(stated, local, is_given=True) == stated


# ---------------------------------------------------------------- single photographs


def photo(folder: Path, attributes: str = "", details: dict[str, int] | None = None, **gps: object) -> Path:
    exif = Image.Exif()
    given = {"FocalLengthIn35mmFilm": 24} if details is None else details
    exif._ifds[ExifTags.IFD.Exif] = {
        ExifTags.Base.DateTimeOriginal: "2023:05:12 12:01:02",
        **{getattr(ExifTags.Base, name): value for name, value in given.items()},
    }
    if gps:
        exif._ifds[ExifTags.IFD.GPSInfo] = {getattr(ExifTags.GPS, name): value for name, value in gps.items()}
    xmp = (
        '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
        f'<rdf:Description xmlns:d="http://www.dji.com/drone-dji/1.0/" {attributes}/></rdf:RDF></x:xmpmeta>'
    )
    path = folder / "a.jpg"
    Image.new("L", (400, 300)).save(path, "JPEG", exif=exif, xmp=xmp.encode())
    return path


def test_dewarping_data_are_a_calibration(tmp_path: Path) -> None:
    data = 'd:DewarpData="2018-09-24;300.5,301.5,2.0,-1.5,-0.26,0.11,0.0001,-0.0002,-0.03" d:DewarpFlag="0"'
    focal = read_photo(photo(tmp_path, data)).focal
    assert (focal.fx_px, focal.fy_px) == (300.5, 301.5)
    assert focal.centre_px == (199.5 + 2.0, 149.5 - 1.5) and focal.sigma_px < 2.0
    assert focal.distortion == (-0.26, 0.11, 0.0001, -0.0002, -0.03)
    straight = read_photo(photo(tmp_path, data.replace('DewarpFlag="0"', 'DewarpFlag="1"'))).focal
    assert straight.distortion == (0.0, 0.0, 0.0, 0.0, 0.0)


def test_dewarping_data_whose_pixels_would_be_twice_as_wide_as_high_are_none(tmp_path: Path) -> None:
    attributes = 'd:DewarpData="2018-09-24;300.5,588.0,2.0,-1.5,0,0,0,0,0"'
    focal = read_photo(photo(tmp_path, attributes, details={"FocalLengthIn35mmFilm": 24})).focal
    assert focal.source.startswith("FocalLengthIn35mmFilm")


DEWARP = 'd:DewarpData="2018-09-24;3666.7,3666.7,20.0,-15.0,-0.26,0.11,0.0001,-0.0002,-0.03"'


@pytest.mark.parametrize("attributes", [DEWARP, 'd:CalibratedFocalLength="3666.7"'])
def test_a_picture_that_was_made_smaller_has_not_the_lens_of_its_full_size(tmp_path: Path, attributes: str) -> None:
    """A calibration of 5472 px in a file of 400 px became "6 deg wide" at 0.3 %."""
    details = {"FocalLengthIn35mmFilm": 24, "ExifImageWidth": 5472, "ExifImageHeight": 4104}
    scaled = read_photo(photo(tmp_path, attributes, details=details)).focal
    assert scaled.fx_px == pytest.approx(3666.7 * 400 / 5472)
    if attributes == DEWARP:
        assert scaled.centre_px == pytest.approx((199.5 + 20.0 * 400 / 5472, 149.5 - 15.0 * 400 / 5472))
        assert scaled.distortion == (-0.26, 0.11, 0.0001, -0.0002, -0.03)
        assert scaled.sigma_px / scaled.fx_px == pytest.approx(0.003)
    # Without the size in EXIF the equivalent shows it, and where that is not stated either, nothing is known.
    by_equivalent = read_photo(photo(tmp_path, attributes)).focal
    assert by_equivalent.fx_px == pytest.approx(277.35, abs=0.1)
    assert by_equivalent.distortion is None and "another size of picture" in by_equivalent.source
    assert read_photo(photo(tmp_path, attributes, details={})).focal is None


def test_an_equivalent_focal_length_counts_along_the_diagonal(tmp_path: Path) -> None:
    focal = read_photo(photo(tmp_path)).focal
    assert focal.fx_px == pytest.approx(24.0 / 43.2666 * 500.0)
    assert 0.02 < focal.sigma_px / focal.fx_px < 0.05


def test_the_exposure_s_utc_beats_exif_s_whole_second(tmp_path: Path) -> None:
    plain, exact = (
        read_photo(photo(tmp_path)),
        read_photo(photo(tmp_path, 'd:UTCAtExposure="2023-05-12T10:01:02.345678"')),
    )
    assert plain.stamp_is_whole_s and plain.stamp_ns == 1_683_892_862 * 10**9
    assert not exact.stamp_is_whole_s and exact.stamp_ns == (1_683_892_862 - 7200) * 10**9 + 345_678_000


def test_south_west_and_below_the_sea(tmp_path: Path) -> None:
    read = read_photo(
        photo(tmp_path, GPSLatitudeRef="S", GPSLatitude=(43.0, 22.0, 48.0), GPSLongitudeRef="W",
              GPSLongitude=(7.0, 30.0, 0.0), GPSAltitudeRef=b"\x01", GPSAltitude=3.5)
    )  # fmt: skip
    assert (read.lat_deg, read.lon_deg, read.height_amsl_m) == pytest.approx((-43.38, -7.5, -3.5))


def test_a_place_without_letters_is_no_place(shared_data: Path, tmp_path: Path) -> None:
    """It was taken for north and east, 75 degrees from where it was."""
    read = read_photo(shared_data / "people_bring" / "noref.jpg")
    assert (read.lat_deg, read.lon_deg) == (None, None) and read.place_lacks_side
    with pytest.raises(InputError, match="lacks the letters N or S, E or W"):
        photo_telemetry([read], [0], None)
    one = read_photo(photo(tmp_path, GPSLatitudeRef="S", GPSLatitude=(43.0, 22.0, 48.0), GPSLongitude=(7.0, 30.0, 0.0)))
    assert (one.lat_deg, one.lon_deg) == (None, None) and one.place_lacks_side


def test_a_photograph_that_states_two_places_is_refused_until_they_are_stated_otherwise(
    session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One of both was edited: clicks were 299 m off, by ellipses of 4 m."""
    write_photographs(session, tmp_path / "photos", Style())
    name = "DJI_0009.JPG"
    path = tmp_path / "photos" / name
    with Image.open(path) as image:
        exif, xmp = image.getexif(), image.info["xmp"].decode()
        lat_deg = float(re.search(r'GpsLatitude="([^"]+)"', xmp)[1])
        xmp = re.sub(r'GpsLatitude="[^"]+"', f'GpsLatitude="{lat_deg + 300.0 / 111111.0:+.9f}"', xmp)
        image.save(path, "JPEG", exif=exif, xmp=xmp.encode())
    command = ["import-photos", str(tmp_path / "photos"), "--out", str(tmp_path / "flight")]
    assert main(command) == 2
    assert f"photograph {name} states two places 300 m apart" in capsys.readouterr().err
    shutil.copyfile(session / "telemetry.tlog", tmp_path / "photos" / "flight.tlog")
    assert main([*command, "--telemetry", str(tmp_path / "photos" / "flight.tlog"), "--clock-offset", "0"]) == 0


def test_photographs_without_letters_are_where_the_log_has_them_or_refused(
    session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_photographs(session, tmp_path / "photos", Style(angles=False, focal="plane", sides=False))
    command = ["import-photos", str(tmp_path / "photos"), "--out", str(tmp_path / "flight")]
    assert main(command) == 2
    err = capsys.readouterr().err
    assert "it lacks the letters N or S, E or W" in err and "no log next to them: give a log" in err
    shutil.copyfile(session / "telemetry.tlog", tmp_path / "photos" / "flight.tlog")
    assert main([*command, "--clock-offset", "0"]) == 0
    outcome = replayed(session, tmp_path / "flight", capsys)
    assert outcome.solved >= 0.8 and outcome.inside_99 >= 0.97, outcome.reported


def test_a_receiver_s_time_in_exif_is_read(shared_data: Path) -> None:
    read = read_photo(shared_data / "people_bring" / "gpstime.jpg")
    assert read.lat_deg == pytest.approx(-33.8667, abs=1e-3)
    assert (read.gps_ns - read.stamp_ns) / 1e9 == pytest.approx(3 * 3600 + 59 * 60 + 45, abs=1.1)


def test_a_receiver_s_time_goes_before_the_camera_s_clock(session: Path, tmp_path: Path) -> None:
    """Without a log it moves the stamps; half a second of one cut to the second is its expectation."""
    write_photographs(session, tmp_path / "photos", Style(gps_time_s=-13.2))
    assert main(["import-photos", str(tmp_path / "photos"), "--out", str(tmp_path / "flight")]) == 0
    with (tmp_path / "flight" / "stamps.csv").open() as stream, (session / "truth.csv").open() as truth:
        pairs = zip(csv.DictReader(stream), csv.DictReader(truth), strict=True)
        off_s = [float(one["unix_time_s"]) - float(other["unix_time_s"]) for one, other in pairs]
    assert np.ptp(off_s) < 2e-3 and off_s[0] == pytest.approx(-13.2, abs=0.5)


@pytest.mark.parametrize(
    "attributes", ['d:GimbalYawDegree="north"', "<broken", 'd:GpsLatitude="91" d:GpsLongitude="0"']
)
def test_nonsense_is_as_if_it_were_not_there(tmp_path: Path, attributes: str) -> None:
    read = read_photo(photo(tmp_path, attributes))
    assert read.gimbal_deg is None and read.lat_deg is None


def test_an_rtk_height_counts_from_the_ellipsoid(tmp_path: Path) -> None:
    read = read_photo(
        photo(tmp_path, 'd:AltitudeType="RtkAlt" d:AbsoluteAltitude="+461.0" d:RtkStdLat="0.01" d:RtkStdLon="0.01"')
    )
    assert read.height_is_ellipsoidal and read.height_amsl_m == 461.0
    assert read.sigma_horizontal_m == pytest.approx(0.01)
