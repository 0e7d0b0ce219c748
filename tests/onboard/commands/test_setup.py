"""`pc-onboard setup`: with flags and with a fake terminal; wrong answers, nothing there, an existing file, Ctrl-C."""

import argparse
import math
import socket
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from contract.camera import Camera
from contract.errors import ConfigError, InputError
from onboard import __main__ as program
from onboard.camera.known_lenses import LENSES, known_lens, named_lens
from onboard.commands import setup
from onboard.commands.questions import MOST_TRIES, Terminal
from onboard.commands.setup import Found, Surroundings
from onboard.config.files import load_config_files
from onboard.config.recorded import recorded_toml
from onboard.config.schema import parse_config, to_toml
from onboard.telemetry.autopilot_search import FoundAutopilot, candidates, listen
from simulation.autopilot.fake import FakeAutopilot
from tests.onboard.link.ports import free_udp_port
from tests.onboard.telemetry.listening import FLIGHT

PI = Found("libcamera:/base/soc/i2c0mux/i2c@1/imx219@10", "/base/soc/i2c0mux/i2c@1/imx219@10")
WEBCAM = Found("/dev/v4l/by-id/usb-046d-index0", "HD Pro Webcam C920", ((640, 480), (1280, 720), (1920, 1080)))
BARE = Found("/dev/video2", "USB grabber", ((720, 576),))
SERIAL = FoundAutopilot("serial:/dev/ttyAMA0:921600", "ArduPilot", 1)
SLOW = FoundAutopilot("serial:/dev/ttyUSB0:57600", "PX4", 3)


class Around:
    """A computer with these cameras and autopilots, and a doctor who finds nothing."""

    def __init__(self, cameras: list[Found], received: list[FoundAutopilot]) -> None:
        self.listened: list[str] = []
        self.checked: list[Path] = []
        self.received = received
        urls = ["udpin:0.0.0.0:14550", *{h.url: 0 for h in received}, "serial:/dev/ttyAMA0:115200"]
        self.measured_hz: float | None = 29.9
        self.around = Surroundings(lambda: cameras, lambda: urls, self.listen, self.check, lambda _: self.measured_hz)

    def listen(self, url: str) -> list[FoundAutopilot]:
        self.listened.append(url)
        return [found for found in self.received if found.url == url]

    def check(self, arguments: argparse.Namespace) -> int:
        self.checked.append(arguments.config)
        return 0


class Typed:
    def __init__(self, *lines: str | BaseException) -> None:
        self.lines: Iterator[str | BaseException] = iter(lines)
        self.shown: list[str] = []
        self.terminal = Terminal(self.read, self.shown.append)

    def read(self, prompt: str) -> str:
        self.shown.append(prompt)
        line = next(self.lines, EOFError())
        if isinstance(line, BaseException):
            raise line
        return line


def arguments(out: Path, *words: str) -> argparse.Namespace:
    return program.parser().parse_args(["setup", "--out", str(out), *words])


@pytest.fixture
def out(tmp_path: Path) -> Path:
    return tmp_path / "config.toml"


def test_where_everything_is_found_nothing_is_asked(out: Path, capsys: pytest.CaptureFixture[str]) -> None:
    around = Around([WEBCAM], [SERIAL])
    assert setup.run(arguments(out, "--yes"), None, around.around) == 0
    config = load_config_files(out)
    camera = Camera.from_json(out.with_name("camera.json"))
    assert (config.camera.device, config.telemetry.url, config.telemetry.system) == (WEBCAM.device, SERIAL.url, 1)
    assert config.camera.file == str(out.with_name("camera.json").resolve())
    assert (config.mount.roll_deg, config.mount.pitch_deg, config.mount.yaw_deg) == (0.0, -90.0, 0.0)
    assert camera.size_px == (1280, 720) and camera.sigma[0] == pytest.approx(0.05)
    assert 2.0 * math.degrees(math.atan(640 / camera.fx_px)) == pytest.approx(70.4, abs=0.1)
    assert around.checked == [out]
    assert "serial:/dev/ttyAMA0:115200" not in around.listened  # that port has been found at another rate
    printed = capsys.readouterr().out
    for words in ("calibrate --device", "calibrate --from", "--mount ROLL,PITCH,YAW", f"run --config {out}"):
        assert words in printed


def test_flags_alone_say_everything_and_nothing_is_looked_for(out: Path, tmp_path: Path) -> None:
    lens = tmp_path / "mine.json"
    lens.write_text(Camera.from_field_of_view(640, 480, 50.0).to_json())
    around = Around([], [])
    words = ["--yes", "--camera", "rtsp://me:secret@10.0.0.2/live", "--camera-file", str(lens), "--mount", "0,-45,90"]
    words += ["--telemetry", "serial:/dev/ttyS1:57600", "--system", "4", "--vehicle", "kea"]
    assert setup.run(arguments(out, *words), None, around.around) == 0
    config = load_config_files(out)
    assert (
        config.vehicle.id == "kea"
        and config.telemetry.system == 4
        and config.camera.device == "rtsp://me:secret@10.0.0.2/live"
    )
    assert config.camera.file == str(lens.resolve()) and not out.with_name("camera.json").exists()
    assert (config.mount.pitch_deg, config.mount.yaw_deg) == (-45.0, 90.0)
    assert (config.telemetry.attitude_rate_hz, config.telemetry.position_rate_hz) == (20.0, 5.0)
    assert config.camera.sigma_latency_s == pytest.approx(0.29)  # of a network stream, stated
    assert not around.listened and out.stat().st_mode & 0o077 == 0  # it holds a password


def test_a_folder_of_pictures_is_found_from_wherever_the_daemon_starts(
    out: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "frames").mkdir()
    (tmp_path / "mine.json").write_text(Camera.from_field_of_view(640, 480, 50.0).to_json())
    monkeypatch.chdir(tmp_path)
    words = ["--yes", "--camera", "replay:frames", "--camera-file", "mine.json", "--mount", "0,-90,0"]
    words += ["--telemetry", "serial:/dev/ttyS1:57600", "--system", "4"]
    setup.run(arguments(out, *words), None, Around([], []).around)
    assert load_config_files(out).camera.device == f"replay:{tmp_path.resolve() / 'frames'}"


ADDRESS = "rtsp://me:hunter2@10.0.0.2/live"


def test_a_password_is_printed_nowhere(out: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--yes", "--camera", ADDRESS, "--size", "640x480", "--fov-deg", "60", "--system", "4"]
    around = Around([], []).around
    assert setup.run(arguments(out, *words, "--telemetry", "serial:/dev/ttyS1:921600"), None, around) == 0
    printed = capsys.readouterr()
    assert "--device 'rtsp://10.0.0.2/live'" in printed.out and "hunter2" not in printed.out + printed.err


def test_the_first_flight_s_configuration_keeps_the_passwords_that_its_recording_has_not(
    out: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The next step that setup itself asks for wrote the camera's address without them over the one that works."""
    own = parse_config(f'[camera]\ndevice = "{ADDRESS}"\n[mount]\nyaw_deg = 90.0')
    recorded = parse_config(recorded_toml(own).replace("yaw_deg = 90.0", "yaw_deg = 0.0"))
    assert "hunter2" not in to_toml(recorded)
    monkeypatch.setattr(setup, "_with_found_mount", lambda session: recorded)
    words = ["--yes", "--force", "--first-flight", str(tmp_path / "session.mcap")]
    out.write_text(to_toml(own))
    assert setup.run(arguments(out, *words), None, Around([], []).around) == 0
    assert load_config_files(out).camera.device == ADDRESS and load_config_files(out).mount.yaw_deg == 0.0
    out.write_text(to_toml(parse_config('[camera]\ndevice = "rtsp://me:hunter2@10.0.0.3/live"')))  # of another camera
    assert setup.run(arguments(out, *words), None, Around([], []).around) == 0
    assert load_config_files(out).camera.device == "rtsp://10.0.0.2/live"


def test_what_is_several_is_asked_and_wrong_answers_are_asked_again(out: Path) -> None:
    typed = Typed("7", "one", "2", "wide", "1e9", "640x480", "200", "80", "3", "2", "", "")
    around = Around([PI, BARE], [SERIAL, SLOW])
    assert setup.run(arguments(out), typed.terminal, around.around) == 0
    # 7, one: no such camera; wide, 1e9: no size; 200: no field of view; 3: no such autopilot.
    config, camera = load_config_files(out), Camera.from_json(out.with_name("camera.json"))
    assert config.camera.device == BARE.device and (config.telemetry.url, config.telemetry.system) == (SLOW.url, 3)
    assert camera.size_px == (640, 480) and camera.sigma[0] == pytest.approx(0.1)
    assert 2.0 * math.degrees(math.atan(320 / camera.fx_px)) == pytest.approx(80.0)
    assert config.mount.pitch_deg == -90.0
    stated = [line for line in typed.shown if line.startswith("  ") and not line.lstrip()[0].isdigit()]
    assert len(stated) == 6, stated
    assert (
        "  a number from 1 to 3" in stated
        and "  a size as in 1280x720" in stated
        and "  degrees from 5 to 150" in stated
    )


def test_a_camera_may_sit_in_any_way_and_the_angles_are_asked_again_until_they_are_some(out: Path) -> None:
    typed = Typed("", "", "7", "down a bit", "0, -30, 10", "")
    assert setup.run(arguments(out), typed.terminal, Around([WEBCAM], [SERIAL]).around) == 0
    mount = load_config_files(out).mount
    assert (mount.roll_deg, mount.pitch_deg, mount.yaw_deg) == (0.0, -30.0, 10.0)
    assert "  three angles as in 0,-30,0" in typed.shown


@pytest.mark.parametrize(
    ("typed", "mavlink", "bit_rate"),
    [
        (["", "1"], False, 4800.0),
        (["", "2"], True, 9600.0),
        (["", "4"], True, 400.0),
        (["", "5", "fast", "12000"], True, 4800.0),
        (["--radio", "none"], False, 4800.0),
        (["--radio", "mlrs"], True, 4800.0),
        (["--radio", "115200"], True, 19200.0),
    ],
)
def test_the_telemetry_radio_that_is_chosen_gets_as_much_of_ours_as_it_carries(
    out: Path, typed: list[str], mavlink: bool, bit_rate: float, capsys: pytest.CaptureFixture[str]
) -> None:
    is_asked = typed[0] != "--radio"
    terminal = Typed("", "", *typed).terminal if is_asked else None
    words = [] if is_asked else ["--yes", *typed]
    assert setup.run(arguments(out, *words), terminal, Around([WEBCAM], [SERIAL]).around) == 0
    link = load_config_files(out).link
    assert (link.mavlink, link.mavlink_bit_rate) == (mavlink, bit_rate)
    assert ("mavlink:serial:DEVICE:BAUD" in capsys.readouterr().out) is mavlink


@pytest.mark.parametrize(("measured_hz", "written"), [(29.4, 30.0), (14.987, 15.0), (None, 30.0)])
def test_the_rate_that_the_camera_really_gives_is_written(out: Path, measured_hz: float | None, written: float) -> None:
    around = Around([WEBCAM], [SERIAL])
    around.measured_hz = measured_hz
    assert setup.run(arguments(out, "--yes"), None, around.around) == 0
    config = load_config_files(out)
    assert config.camera.rate_hz == written
    assert config.recording.pictures == "jpeg"  # the step that setup names next needs them


def test_empty_lines_take_what_is_shown(out: Path) -> None:
    around = Around([PI, WEBCAM], [SERIAL])
    assert setup.run(arguments(out), Typed("", "", "", "", "").terminal, around.around) == 0
    config = load_config_files(out)
    assert config.camera.device == PI.device and Camera.from_json(out.with_name("camera.json")).size_px == (1280, 720)


def test_without_camera_and_autopilot_a_person_may_name_them(out: Path, capsys: pytest.CaptureFixture[str]) -> None:
    typed = Typed("", "gst:videotestsrc", "640x480", "62", "", "5", "")
    assert setup.run(arguments(out), typed.terminal, Around([], []).around) == 0
    config = load_config_files(out)
    assert (config.camera.device, config.telemetry.url) == ("gst:videotestsrc", "udpin:0.0.0.0:14550")
    assert config.mount.pitch_deg == -45.0
    assert "  it cannot be empty" in typed.shown
    printed = capsys.readouterr().out
    assert "nothing was received on udpin:0.0.0.0:14550" in printed and "telemetry.system is open" in printed


SECOND = FoundAutopilot(SERIAL.url, "ArduPilot quadrotor", 7)


def test_the_line_that_is_given_is_listened_to_for_the_vehicle_s_number(out: Path) -> None:
    words = ["--yes", "--telemetry", SERIAL.url]
    assert setup.run(arguments(out, *words), None, Around([WEBCAM], [SERIAL]).around) == 0
    assert load_config_files(out).telemetry.system == 1
    around = Around([WEBCAM], [SERIAL, SECOND])
    assert setup.run(arguments(out, *words, "--force", "--system", "7"), None, around.around) == 0
    assert load_config_files(out).telemetry.system == 7 and not around.listened
    assert setup.run(arguments(out, "--yes", "--force", "--system", "7"), None, around.around) == 0
    assert (load_config_files(out).telemetry.url, load_config_files(out).telemetry.system) == (SERIAL.url, 7)


def test_two_vehicles_on_one_line_are_a_question(out: Path) -> None:
    around = Around([WEBCAM], [SERIAL, SECOND])
    with pytest.raises(ConfigError, match=r"system 1, ArduPilot; .* system 7, .* quadrotor; .* --system NUMBER"):
        setup.run(arguments(out, "--yes"), None, around.around)
    assert setup.run(arguments(out), Typed("", "", "2", "", "").terminal, around.around) == 0
    assert load_config_files(out).telemetry.system == 7


@pytest.mark.parametrize(
    ("cameras", "received", "message"),
    [
        ([], [SERIAL], "no camera found; name one: --camera"),
        ([WEBCAM, BARE], [SERIAL], "several cameras"),
        ([BARE], [SERIAL], "--fov-deg"),
        ([PI], [SERIAL], "--size"),
        ([WEBCAM], [], "no autopilot found"),
        ([WEBCAM], [SERIAL, SLOW], "several autopilots"),
    ],
)
def test_without_anybody_to_ask_what_is_open_is_one_line_and_nothing_is_written(
    out: Path, cameras: list[Found], received: list[FoundAutopilot], message: str
) -> None:
    with pytest.raises(ConfigError) as caught:
        setup.run(arguments(out, "--yes"), None, Around(cameras, received).around)
    assert message in str(caught.value) and "\n" not in str(caught.value)
    assert not list(out.parent.iterdir())


@pytest.mark.parametrize("which", ["config.toml", "camera.json"])
def test_what_is_there_is_kept_unless_forced(out: Path, which: str) -> None:
    there = out.with_name(which)
    there.write_text("# mine\n")
    there.chmod(0o640)
    around = Around([WEBCAM], [SERIAL])
    with pytest.raises(InputError, match="--force replaces it"):
        setup.run(arguments(out, "--yes"), None, around.around)
    assert there.read_text() == "# mine\n" and [p.name for p in out.parent.iterdir()] == [which]
    assert setup.run(arguments(out, "--yes", "--force"), None, around.around) == 0
    assert there.read_text() != "# mine\n" and (which != "config.toml" or there.stat().st_mode & 0o777 == 0o640)
    assert load_config_files(out).camera.device == WEBCAM.device


def test_a_person_who_leaves_leaves_nothing_behind(out: Path) -> None:
    for stop, caught in ((KeyboardInterrupt(), KeyboardInterrupt), (EOFError(), ConfigError)):
        typed = Typed("1", "1280x720", stop)
        with pytest.raises(caught):
            setup.run(arguments(out), typed.terminal, Around([BARE], [SERIAL]).around)
        assert not list(out.parent.iterdir())
    typed = Typed(*["nonsense"] * 20)
    with pytest.raises(ConfigError, match=f"in {MOST_TRIES} tries"):
        setup.run(arguments(out), typed.terminal, Around([PI, BARE], [SERIAL]).around)


def test_ctrl_c_ends_the_program_with_130(out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object) -> int:
        raise KeyboardInterrupt

    monkeypatch.setattr(setup, "run", interrupted)
    assert program.main(["setup", "--out", str(out)]) == 130


def test_a_key_that_cannot_be_is_named_before_anything_is_written(out: Path) -> None:
    with pytest.raises(ConfigError, match="vehicle"):
        setup.run(arguments(out, "--yes", "--vehicle", "two words"), None, Around([WEBCAM], [SERIAL]).around)
    assert not list(out.parent.iterdir())


def test_the_doctor_s_verdict_is_the_exit_code(out: Path) -> None:
    around = replace(Around([WEBCAM], [SERIAL]).around, check=lambda _: 1)
    assert setup.run(arguments(out, "--yes"), None, around) == 1


def test_lenses_are_known_by_what_drivers_call_them() -> None:
    found = {name: known_lens(name) for name in ("imx219 10-0010", "HD Pro Webcam C920", "imx477", "Integrated Camera")}
    assert [None if lens is None else round(lens.hfov_deg, 1) for lens in found.values()] == [62.2, 70.4, None, None]


def test_a_lens_is_named_by_any_words_that_leave_no_doubt() -> None:
    assert named_lens("camera module 3 wide").hfov_deg == 102.0
    assert named_lens("Raspberry Pi Camera Module 3").hfov_deg == 66.0
    assert named_lens("global 6 mm").hfov_deg == 45.0
    with pytest.raises(ValueError, match=r"several fit: Raspberry Pi Camera Module 3; .* 3 Wide"):
        named_lens("module 3")
    for nothing in ("", "SIYI"):
        with pytest.raises(ValueError, match="none is called that: Raspberry Pi Camera Module 1; "):
            named_lens(nothing)


def test_every_lens_states_its_source_and_is_known_by_its_own_name_alone() -> None:
    for lens in LENSES:
        assert lens.source and named_lens(lens.name) is lens
        assert 10.0 < lens.hfov_deg < 110.0
        assert not lens.part or known_lens(lens.part) is lens


def test_serial_ports_are_tried_under_their_persistent_names(tmp_path: Path) -> None:
    (tmp_path / "serial" / "by-id").mkdir(parents=True)
    for name in ("ttyACM0", "ttyAMA0", "null"):
        (tmp_path / name).touch()
    (tmp_path / "serial" / "by-id" / "usb-Holybro-if00").symlink_to(tmp_path / "ttyACM0")
    urls = list(candidates(tmp_path))
    ports = [url.split(":")[1] for url in urls if url.startswith("serial")]
    assert {Path(port).name for port in ports} == {"usb-Holybro-if00", "ttyAMA0"}
    assert urls[0] == "udpin:0.0.0.0:14550" and f"serial:{tmp_path / 'ttyAMA0'}:57600" in urls


@pytest.mark.wall_clock
@pytest.mark.parametrize(("style", "kind"), [("ardupilot", "ArduPilot fixed wing"), ("px4", "PX4 fixed wing")])
def test_an_autopilot_is_found_on_a_serial_line_by_its_heartbeat(style: str, kind: str) -> None:
    with FakeAutopilot(FLIGHT, "pty", style=style, system=7) as autopilot:
        assert listen(autopilot.url, 60.0) == [FoundAutopilot(autopilot.url, kind, 7)]


def test_silence_others_and_a_wire_that_is_not_there_are_none(tmp_path: Path) -> None:
    assert listen(f"serial:{tmp_path / 'none'}:57600", 0.1) == []
    port = free_udp_port()
    gcs = mavlink.MAVLink_heartbeat_message(6, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for _ in range(3):
            sender.sendto(gcs.pack(mavlink.MAVLink(None, 255, 190)), ("127.0.0.1", port))
        assert listen(f"udpin:127.0.0.1:{port}", 0.3) == []


@pytest.mark.parametrize(("there", "mode"), [(None, 0o600), (0o640, 0o640)])
def test_a_password_is_in_no_file_that_others_can_read_for_a_moment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, there: int | None, mode: int
) -> None:
    out, seen = tmp_path / "config.toml", []
    if there is not None:
        out.write_text("")
        out.chmod(there)
    (tmp_path / "config.toml.part").write_text("of a run that was ended, and readable by all")
    replaced = Path.replace
    monkeypatch.setattr(
        Path, "replace", lambda part, to: (seen.append(part.stat().st_mode & 0o777), replaced(part, to))
    )
    setup._write_config(out, "device = 'rtsp://anna:hunter2@cam'", has_password=True)
    assert seen == [mode] and out.stat().st_mode & 0o777 == mode and "hunter2" in out.read_text()
