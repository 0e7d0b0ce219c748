"""The decoder of a camera's stream cannot open keys, state and recordings, nor look into the daemon."""

import os
import socket
import subprocess
from pathlib import Path

import pytest

from onboard.camera import box
from onboard.camera.helper_launch import BOX, HELPER, SYSTEM_PYTHON, helper_launch, private_paths
from onboard.config.schema import CameraConfig, parse_config

TRY = """
import os, sys
for path in sys.argv[1:]:
    try:
        open(path, "rb").read(1)
        print("read")
    except OSError as error:
        print(type(error).__name__)
"""
CONNECT = """
import socket, sys
for family, kind, place in (
    (socket.AF_INET, socket.SOCK_STREAM, ("127.0.0.1", int(sys.argv[1]))),
    (socket.AF_INET6, socket.SOCK_DGRAM, ("::1", 9)),
    (socket.AF_UNIX, socket.SOCK_STREAM, sys.argv[2]),
    (socket.AF_NETLINK, socket.SOCK_RAW, (0, 0)),
):
    try:
        with socket.socket(family, kind) as one:
            one.bind(place) if family == socket.AF_NETLINK else one.connect(place)
        print("connected")
    except OSError as error:
        print(type(error).__name__)
"""
SECRET = "POINTCLICK_SECRET"


def in_a_box(closed: list[Path | str], *command: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [SYSTEM_PYTHON, "-I", BOX, *closed, "--", *map(str, command)],
        env={**os.environ, SECRET: "hidden", "GST_DEBUG": "0"},
        capture_output=True, text=True, check=False, timeout=60,
    )  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("keys/link.key", "keys/video.mp4", "state/estimate.json", "state/recordings/a.mcap", "free.mp4"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("x")
    (tmp_path / "door").symlink_to(tmp_path / "state")
    return tmp_path.resolve()


def test_what_is_closed_cannot_be_read_and_all_else_can(folder: Path) -> None:
    names = ["keys/link.key", "state/estimate.json", "state/recordings/a.mcap", "door/estimate.json"]
    free = ["keys/video.mp4", "free.mp4", "/etc/passwd", "/dev/zero", "/proc/self/status"]
    paths = [folder / name for name in (*names, *free)]
    tried = in_a_box([folder / "keys" / "link.key", folder / "state"], SYSTEM_PYTHON, "-c", TRY, *paths)
    assert tried.stdout.split() == ["PermissionError"] * 4 + ["read"] * 5, tried.stderr
    without = in_a_box([folder / "nothing"], SYSTEM_PYTHON, "-c", TRY, *paths)
    assert without.stdout.split() == ["read"] * 9


def test_it_holds_for_what_the_command_starts(folder: Path) -> None:
    tried = in_a_box([folder / "state"], "sh", "-c", f"cat {folder}/free.mp4; cat {folder}/state/estimate.json")
    assert tried.stdout == "x" and "Permission denied" in tried.stderr


def test_the_environment_is_what_a_decoder_needs() -> None:
    given = dict(line.partition("=")[::2] for line in in_a_box([], "env").stdout.splitlines())
    assert SECRET not in given and {"PATH", "GST_DEBUG"} <= set(given)


def test_the_memory_of_processes_outside_is_not_read() -> None:
    """Keys are in the daemon's; even by root."""
    mine = f"/proc/{os.getpid()}/mem"
    assert in_a_box([], SYSTEM_PYTHON, "-c", TRY, mine).stdout.split() == ["PermissionError"]
    without = subprocess.run([SYSTEM_PYTHON, "-c", TRY.replace(".read(1)", ""), mine], capture_output=True, check=False)
    assert os.geteuid() != 0 or without.stdout.split() == [b"read"]


def test_as_few_paths_are_opened_as_can_be(folder: Path) -> None:
    opened = box.open_paths({str(folder / "state"), str(folder / "keys" / "link.key")}, str(folder))
    assert opened == [str(folder / "free.mp4"), str(folder / "keys" / "video.mp4")]
    assert box.open_paths(set()) == ["/"] and box.open_paths({"/"}) == []


def test_a_kernel_without_it_is_reported_and_the_camera_still_works(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(*_: object) -> int:
        raise OSError(38, "Function not implemented")

    became: list[object] = []
    monkeypatch.setattr(box, "_call", refuse)
    monkeypatch.setattr(os, "execvpe", lambda *words: became.extend(words))
    box.main(["/closed", "--", "it", "word"])
    assert became[:2] == ["it", ["it", "word"]]
    assert "no Landlock here (Function not implemented)" in capsys.readouterr().err


@pytest.mark.parametrize("device", ["rtsp://u:p@10.0.0.2/video", "libcamera:", "gst:videotestsrc"])
def test_keys_state_and_recordings_are_closed_to_our_helper(device: str) -> None:
    config = parse_config(
        '[service]\nstate_dir = "/srv/state"\n[recording]\nfolder = "/srv/kept"\n[link]\nca = "/k/ca"\n'
        'certificate = "/k/it.pem"\nkey = "/k/it.key"\n[telemetry]\nsigning_key = "/k/signing"\n'
    )
    unit = {"STATE_DIRECTORY": "/var/lib/pointclick", "CONFIGURATION_DIRECTORY": "/etc/pointclick"}
    closed = private_paths(config, unit)
    launch = helper_launch(CameraConfig.model_validate({"device": device}), (640, 480), closed)
    at = launch.command.index("--")
    assert launch.command[:3] == (SYSTEM_PYTHON, "-I", str(BOX))
    assert launch.command[at:] == ("--", SYSTEM_PYTHON, "-I", str(HELPER))
    assert set(launch.command[3:at]) - {"--no-network"} == {
        "/srv/state", "/srv/kept", "/k/it.key", "/k/signing", "/var/lib/pointclick", "/etc/pointclick",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("words", "expected"),
    [([], ["connected"] * 4), (["--no-network"], ["PermissionError", "PermissionError", "connected", "connected"])],
)
def test_a_decoder_that_needs_no_network_cannot_connect_to_it(
    tmp_path: Path, words: list[Path | str], expected: list[str]
) -> None:
    """Nor what it starts; local sockets and the kernel's stay open."""
    with socket.create_server(("127.0.0.1", 0)) as server, socket.socket(socket.AF_UNIX) as local:
        local.bind(str(tmp_path / "a.sock"))
        local.listen()
        port, place = server.getsockname()[1], tmp_path / "a.sock"
        tried = in_a_box(words, "sh", "-c", '"$@"', "sh", SYSTEM_PYTHON, "-c", CONNECT, port, place)
    if not socket.has_ipv6 or not Path("/proc/net/if_inet6").exists():  # without it none can be connected to
        expected = [*expected[:1], tried.stdout.split()[1], *expected[2:]]
    assert tried.stdout.split() == expected, tried.stderr


def test_rules_are_known_for_both_machines_and_for_no_other() -> None:
    both = [box._filter(machine) for machine in ("x86_64", "aarch64")]
    assert len(both[0]) == len(both[1]) == 8 * 11 and both[0] != both[1]
    with pytest.raises(OSError, match="no rules for riscv64"):
        box._filter("riscv64")


@pytest.mark.parametrize(
    ("device", "is_open"),
    [
        ("libcamera:", False),
        ("gst:v4l2src device=/dev/video0 ! video/x-h264 ! h264parse ! avdec_h264", False),
        ("gst:filesrc location=/a.mp4 ! qtdemux ! decodebin", False),
        ("gst:udpsrc port=5600 caps=application/x-rtp ! rtph264depay ! avdec_h264", True),
        ("gst:v4l2src ! tee name=t t. ! queue ! x264enc ! udpsink host=10.0.0.2 t. ! videoconvert", True),
        ("gst:uridecodebin uri=http://cam/x", True),
        ("gst:somethingelse ! decodebin", True),
        ("rtsp://10.0.0.2/live", True),
        ("udp://0.0.0.0:5600", True),
    ],
)
def test_what_may_come_from_the_network_keeps_it(device: str, is_open: bool) -> None:
    launch = helper_launch(CameraConfig(device=device), (640, 480))
    assert ("--no-network" not in launch.command) is is_open
