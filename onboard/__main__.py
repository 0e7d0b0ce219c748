"""`pc-onboard`: the aircraft's commands. Only arguments, exit codes and wiring.

Exit codes: 0 done, 2 wrong usage or unusable input (one line on stderr), 3 the daemon that was asked is not running, or
a replay solved no picture, 1 `doctor`, `bench` or `check-config --fly` found something, or the daemon failed and should
be started again, 130 interrupted (what was done is kept), 141 whoever reads our output (`head`, say) went away before
there was a verdict.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import math
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeAlias

from contract.errors import PointclickError
from contract.topics import DEFAULT_ENDPOINT
from onboard.argument_parser import (
    Parser,
    Version,
    angles,
    clicked,
    days,
    degrees_wide,
    drop_output,
    finite,
    hours,
    is_output_lost,
    is_reader_gone,
    pair,
    precise,
    precise_moment,
    rate,
    seconds,
    speed,
)

PROGRAM = "pc-onboard"
CONFIG = Path("/etc/pointclick/config.toml")
NOTHING_SOLVED = 3
READER_GONE = 141  # as the shell has it for a program that a SIGPIPE ended


REPLAY_EXAMPLES = """examples:
  pc-onboard replay --frames FRAMES --telemetry 00000042.BIN --camera camera.json --out session.mcap
  pc-onboard replay --frames DJI_0042.MP4 --telemetry DJI_0042.SRT --camera camera.json --home-amsl-m 412
  pc-onboard replay --config FLIGHT/config.toml --frames FLIGHT/frames --telemetry exif --camera FLIGHT/camera.json
"""
IMPORT_EXAMPLE = """example:
  pc-onboard import-photos /media/card/DCIM/100MEDIA --out survey-0612
"""
VIDEO_EXAMPLE = """example:
  pc-onboard import-video DJI_0042.MP4 --out flight-42 --set camera.fov_deg=72
"""
AsWritten = argparse.RawDescriptionHelpFormatter
Commands: TypeAlias = "argparse._SubParsersAction[Parser]"


def parser() -> argparse.ArgumentParser:
    """The command line."""
    top = Parser(prog=PROGRAM, description="Pictures and position in, georeferenced feature sets out.")
    top.add_argument("--version", action=Version, nargs=0, help="print the version and exit")
    commands = top.add_subparsers(dest="command", required=True, metavar="COMMAND")

    _add_replay(commands)
    _add_imports(commands)
    cameras = commands.add_parser("cameras", help="list cameras, their formats and controls")
    cameras.add_argument("--json", action="store_true", help="for programs")

    _add_setup(
        commands.add_parser("setup", help="a configuration for this aircraft: found out, or asked for, and checked")
    )

    _add_camera(commands.add_parser("camera", help="read a camera file, also another tool's calibration"))
    _add_calibrate(commands.add_parser("calibrate", help="make a camera file from pictures of a board"))

    _add_checks(commands)
    _add_make_credentials(
        commands.add_parser("make-credentials", help="certificates for an encrypted link (docs/certificates.md)")
    )

    _add_bench(commands.add_parser("bench", help="what this computer can do: pictures a second, stages, temperature"))

    serve = commands.add_parser("serve", help="answer questions about a recorded flight, clicked pixels measured")
    serve.add_argument("session", type=Path, metavar="SESSION.mcap", help="a recording with pictures, or its folder")
    serve.add_argument(
        "--listen", default=DEFAULT_ENDPOINT, metavar="ENDPOINT", help=f"zenoh endpoint ({DEFAULT_ENDPOINT})"
    )

    run = commands.add_parser("run", help="fly: the daemon, as the service starts it")
    run.add_argument("--config", type=Path, default=CONFIG, metavar="FILE", help=f"configuration ({CONFIG})")
    return top


def _add_replay(commands: Commands) -> None:
    replay = commands.add_parser(
        "replay", help="run a recorded flight through the pipeline", epilog=REPLAY_EXAMPLES, formatter_class=AsWritten
    )
    replay.add_argument(
        "recording",
        type=Path,
        nargs="*",
        metavar="SESSION.mcap",
        help="a recorded session (all its parts, by any of them), or a folder with one; in place of the three below",
    )
    replay.add_argument(
        "--config",
        type=Path,
        metavar="FILE",
        help="configuration (TOML); without it the recording's own, or all defaults",
    )
    replay.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="another value of a configuration key, as mount.pitch_deg=-45; repeatable",
    )
    replay.add_argument("--frames", type=Path, metavar="DIR_OR_VIDEO", help="folder of pictures, or a video")
    replay.add_argument(
        "--telemetry", type=Path, action="append", default=[], metavar="LOG|exif",
        help="a log: .tlog, ArduPilot .bin, PX4 .ulg, DJI .srt, tables, tracks (docs/logs.md); twice: two logs of one "
        "flight, each sensor from the better; exif: from the pictures",
    )  # fmt: skip
    replay.add_argument(
        "--home-amsl-m",
        type=finite,
        metavar="M",
        help="how high above sea level the take-off was, for a log that counts heights from there",
    )
    replay.add_argument(
        "--gps-order",
        choices=("lat-lon", "lon-lat"),
        help="which number of GPS(a, b) in a .srt is the latitude, where nothing in it shows which",
    )
    replay.add_argument(
        "--time-offset",
        type=finite,
        metavar="S",
        help="Unix time at the autopilot's boot, for a .ulg without UTC; 0: the pictures' stamps count from it too",
    )
    replay.add_argument("--camera", type=Path, metavar="CAMERA.json", help="camera file, ours or another tool's")
    replay.add_argument(
        "--stamps",
        type=Path,
        metavar="STAMPS.csv",
        help="capture times: file,unix_time_s (a video: index,unix_time_s); else EXIF, else the file names",
    )
    replay.add_argument(
        "--rate", type=rate, default=math.inf, metavar="HZ", help="pictures a second at most; the others are left out"
    )
    replay.add_argument("--out", type=Path, metavar="SESSION.mcap", help="write events and feature sets")
    replay.add_argument(
        "--state",
        type=Path,
        metavar="FILE",
        help="boresight and time offset: begin with what this file knows, leave there what was learned",
    )
    replay.add_argument("--publish", action="store_true", help="put feature sets on the link")
    replay.add_argument(
        "--speed", type=speed, default=None, metavar="1|max", help="real time, or as fast as it goes (max)"
    )
    replay.add_argument(
        "--linger", type=seconds, default=0.0, metavar="S", help="seconds to go on answering on the link afterwards"
    )
    replay.add_argument(
        "--track",
        type=clicked,
        action="append",
        default=[],
        metavar="FRAME,U,V",
        help="follow what is at that pixel of that picture, a JSON line twice a second; up to 8 times",
    )
    replay.add_argument(
        "--spots", action="store_true", help="look for hot spots (thermal.enabled), a JSON line for each picture"
    )
    replay.add_argument(
        "--thermal",
        type=Path,
        metavar="DIR_OR_VIDEO",
        help="of --spots: a second camera's pictures (camera.thermal), in which hot spots are looked for",
    )
    replay.add_argument(
        "--thermal-stamps", type=Path, metavar="STAMPS.csv", help="its capture times, as --stamps has the first one's"
    )
    replay.add_argument("--progress", action="store_true", help="progress also without a terminal: a line each 10 s")
    replay.add_argument("--budget", action="store_true", help="where a click's error comes from; what makes it smaller")


def _add_imports(commands: Commands) -> None:
    photos = commands.add_parser(
        "import-photos",
        help="make a flight for replay of a folder of survey photographs",
        description="Stamps, camera file and mount of a folder of photographs, from their EXIF and XMP; "
        "prints what it assumed, and how to replay it.",
        epilog=IMPORT_EXAMPLE,
        formatter_class=AsWritten,
    )
    photos.add_argument("folder", type=Path, metavar="DIR", help="the photographs, of one camera and one flight")
    photos.add_argument("--copy", action="store_true", help="copy the pictures; else they are linked to")
    _add_importing(photos)

    video = commands.add_parser(
        "import-video",
        help="make a flight for replay of a video and the log of its flight",
        description="Frame times, camera file and mount of a video, from the video and the log next to it; prints what "
        "it assumed, and how to replay it.",
        epilog=VIDEO_EXAMPLE,
        formatter_class=AsWritten,
    )
    video.add_argument("video", type=Path, metavar="VIDEO", help="a video file, as the camera wrote it")
    video.add_argument(
        "--start",
        type=precise_moment,
        metavar="TIME",
        help="when it began, in UTC, to as many digits as you know: 2026-06-12T10:15:23.4Z",
    )
    _add_importing(video)


def _add_setup(setup: argparse.ArgumentParser) -> None:
    setup.add_argument(
        "--out", "--config", type=Path, default=CONFIG, metavar="FILE", help=f"the configuration to write ({CONFIG})"
    )
    setup.add_argument("--force", action="store_true", help="replace one that is there")
    setup.add_argument("--yes", action="store_true", help="ask nothing: take what is given, and what is found")
    setup.add_argument("--vehicle", default="uav", metavar="NAME", help="vehicle.id (uav)")
    setup.add_argument(
        "--camera", metavar="DEVICE", help="camera.device; without it the computer's cameras are offered"
    )
    setup.add_argument("--size", type=pair, metavar="WxH", help="picture size")
    setup.add_argument("--camera-file", type=Path, metavar="CAMERA.json", help="a calibrated lens")
    setup.add_argument("--lens", metavar="NAME", help="else its camera, where that is known: camera module 3 wide")
    setup.add_argument(
        "--fov-deg", type=degrees_wide, metavar="DEG", help="else how much it sees from left to right, degrees"
    )
    setup.add_argument(
        "--telemetry", metavar="URL", help="telemetry.url; without it serial and UDP ports are listened to"
    )
    setup.add_argument(
        "--system",
        type=int,
        metavar="N",
        help="telemetry.system, the vehicle's MAVLink number; without it the one received",
    )
    setup.add_argument(
        "--mount", type=angles, metavar="ROLL,PITCH,YAW", help="how the camera sits, degrees: 0,-90,0 looks down"
    )
    setup.add_argument(
        "--radio",
        metavar="KIND",
        help="the autopilot's radio, for clicks and sets: none, sik, mlrs, elrs, or bit/s",
    )
    setup.add_argument(
        "--first-flight",
        type=Path,
        metavar="SESSION.mcap",
        help="the configuration of a recorded flight (with pictures), the camera sitting as its pictures show",
    )


def _add_checks(commands: Commands) -> None:
    status = commands.add_parser("status", help="how the running daemon is")
    status.add_argument("--config", type=Path, default=CONFIG, metavar="FILE", help=f"its configuration ({CONFIG})")
    status.add_argument("--vehicle", metavar="NAME", help="another vehicle than the configured one")
    status.add_argument("--json", action="store_true", help="everything it knows of itself")

    check = commands.add_parser("check-config", help="check a configuration file and the config.d next to it")
    check.add_argument("--config", type=Path, default=CONFIG, metavar="FILE", help=f"configuration ({CONFIG})")
    check.add_argument(
        "--fly", action="store_true", help="and whether what it names is there: camera file, camera, telemetry"
    )

    doctor = commands.add_parser("doctor", help="before take-off: is everything well?")
    doctor.add_argument("--config", type=Path, default=CONFIG, metavar="FILE", help=f"configuration ({CONFIG})")
    doctor.add_argument("--json", action="store_true", help="for programs")
    doctor.add_argument("--explain", action="store_true", help="below each line what it means, and what to do")
    doctor.add_argument(
        "--seconds",
        type=seconds,
        default=8.0,
        metavar="S",
        help="without a daemon: longest look at camera and telemetry",
    )


def _add_bench(bench: argparse.ArgumentParser) -> None:
    bench.add_argument(
        "recording", type=Path, nargs="?", metavar="SESSION.mcap", help="fly this again; without it a flight is made up"
    )
    bench.add_argument("--config", type=Path, default=CONFIG, metavar="FILE", help=f"configuration ({CONFIG})")
    bench.add_argument("--camera", type=Path, metavar="CAMERA.json", help="another camera file than the configured one")
    bench.add_argument("--size", type=pair, metavar="WxH", help="without a camera file: picture size (640x480)")
    bench.add_argument("--rate", type=rate, metavar="HZ", help="pictures a second wanted (camera.rate_hz)")
    bench.add_argument("--seconds", type=seconds, default=30.0, metavar="S", help="how long (30)")
    bench.add_argument("--frames", type=Path, metavar="DIR", help="given pictures, with the next two as for replay")
    bench.add_argument("--telemetry", type=Path, metavar="LOG")
    bench.add_argument("--stamps", type=Path, metavar="STAMPS.csv")
    bench.add_argument("--json", action="store_true", help="as a JSON object, for programs")


def _add_camera(camera: argparse.ArgumentParser) -> None:
    camera.add_argument("file", type=Path, metavar="FILE", help="the file; its format is found out")
    camera.add_argument("--out", type=Path, metavar="CAMERA.json", help="write it as a camera file of ours")
    camera.add_argument("--size", type=pair, metavar="WxH", help="picture size, for a file that states none")
    camera.add_argument("--which", metavar="NAME", help="one of a file's several cameras")


def _add_calibrate(calibrate: argparse.ArgumentParser) -> None:
    calibrate.add_argument("--out", type=Path, metavar="CAMERA.json", help="the camera file to write")
    calibrate.add_argument("--pictures", type=Path, metavar="DIR", help="pictures of the board")
    calibrate.add_argument(
        "--zoom",
        action="append",
        default=[],
        metavar="POSITION=DIR",
        help="a zoom lens: pictures at each zoom position",
    )
    calibrate.add_argument(
        "--zoom-unit", choices=("times", "percent"), default="times", help="what positions count (times the widest)"
    )
    calibrate.add_argument(
        "--from", dest="from_session", type=Path, metavar="SESSION.mcap", help="no board: what a recorded flight found"
    )
    calibrate.add_argument("--device", metavar="/dev/videoN", help="or: watch this camera")
    calibrate.add_argument("--size", type=pair, metavar="WxH", help="with --device: picture size, as in flight")
    calibrate.add_argument(
        "--format", default="auto", choices=["auto", "GREY", "YUYV", "NV12", "MJPG", "Y16"], help="with --device"
    )
    calibrate.add_argument("--views", type=int, default=25, metavar="N", help="with --device: views to collect (25)")
    calibrate.add_argument("--seconds", type=seconds, default=300.0, metavar="S", help="with --device: at most (300)")
    calibrate.add_argument("--keep", type=Path, metavar="DIR", help="with --device: keep the pictures")
    calibrate.add_argument("--board", default="charuco", choices=["charuco", "checkerboard"], help="kind of board")
    calibrate.add_argument("--squares", type=pair, default=(7, 10), metavar="CxR", help="squares of the board (7x10)")
    calibrate.add_argument("--square-mm", type=float, default=25.0, metavar="MM", help="a square, as measured (25)")
    calibrate.add_argument("--marker-mm", type=float, metavar="MM", help="a ChArUco marker (0.74 of a square)")
    calibrate.add_argument("--dictionary", default="5X5_100", metavar="NAME", help="of the markers (5X5_100)")
    calibrate.add_argument("--coverage", type=Path, metavar="FILE.png", help="coverage picture (next to --out)")
    calibrate.add_argument("--accept", action="store_true", help="write the camera file against the verdict")
    calibrate.add_argument(
        "--print-board", type=Path, metavar="FILE.pdf", help="write the board for the printer (or .png)"
    )


def _add_make_credentials(credentials: argparse.ArgumentParser) -> None:
    credentials.add_argument("folder", type=Path, metavar="DIR", help="one folder each in it, and the authority's own")
    credentials.add_argument(
        "--vehicle", action="append", default=[], metavar="NAME", help="an aircraft: its vehicle.id"
    )
    credentials.add_argument(
        "--operator", action="append", default=[], metavar="NAME", help="someone who clicks and keeps pins"
    )
    credentials.add_argument("--viewer", action="append", default=[], metavar="NAME", help="someone who looks on")
    credentials.add_argument("--router", metavar="NAME", help="the ground station's router (pc-ground router)")
    credentials.add_argument(
        "--address",
        action="append",
        default=[],
        metavar="HOST",
        help="where the router, or without one the aircraft, is reached; name and loopback are always among them",
    )
    credentials.add_argument("--days", type=days, default=365.0, metavar="N", help="valid for so long (365)")


def _add_importing(command: argparse.ArgumentParser) -> None:
    """Add the arguments that both imports take."""
    command.add_argument("--out", type=Path, required=True, metavar="FLIGHT", help="folder to write; new or empty")
    command.add_argument(
        "--telemetry", type=Path, action="append", default=[], metavar="LOG",
        help="the log of the flight, or twice: two of it, each sensor from the better; else one next to the pictures, "
        "or what photographs state",
    )  # fmt: skip
    command.add_argument(
        "--stamps", type=Path, metavar="STAMPS.csv",
        help="when each picture was taken: file,unix_time_s of photographs, index,unix_time_s of a video",
    )  # fmt: skip
    command.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="a configuration key (mount.pitch_deg=-45), camera.fov_deg or camera.file, not guessed; repeatable",
    )
    command.add_argument(
        "--utc-offset", type=hours, default=0.0, metavar="H", help="the camera's clock is so many hours ahead of UTC"
    )
    command.add_argument(
        "--clock-offset",
        type=precise,
        metavar="S",
        help="the camera's clock is so many seconds ahead of UTC (of the log's times where these are local), to as "
        "many digits as you know, or S+-SIGMA; else it is searched over the log",
    )
    command.add_argument("--home-amsl-m", type=finite, metavar="M", help="as for replay")


def run_serve(arguments: argparse.Namespace) -> int:
    """Answer questions about a recording until a signal ends it."""
    from onboard.commands.serve import run  # noqa: PLC0415

    with _interrupt_sets(threading.Event()) as stop:
        return run(arguments, stop)


def run_replay(arguments: argparse.Namespace) -> int:
    """Replay and print the summary; 3 if no picture was solved."""
    from onboard.commands.replay import run  # noqa: PLC0415  NumPy and OpenCV must find their environment set

    with _interrupt_sets(threading.Event()) as stop:
        text, is_solved = run(arguments, stop)
        print(text)
        if stop.is_set():
            return 130
        return 0 if is_solved else NOTHING_SOLVED


def _set_environment() -> None:
    """Before NumPy and OpenCV are first imported.

    One thread each: the same inputs then give the same bytes on any number of cores, and a small computer keeps its
    other cores for the rest of the aircraft. No message of OpenCV's own: what cannot be opened is our line to write.
    """
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    os.environ.setdefault("OPENCV_LOG_LEVEL", "ERROR")
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")


@contextlib.contextmanager
def _interrupt_sets(stop: threading.Event) -> Iterator[threading.Event]:
    """Ctrl-C and SIGTERM set an event instead of raising in the middle of something; a second Ctrl-C raises."""

    def ask_to_stop(number: int, _: object) -> None:
        stop.set()
        signal.signal(number, previous[signal.Signals(number)])

    previous = {number: signal.signal(number, ask_to_stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def main(argv: list[str] | None = None) -> int:
    """Run a command; returns the exit code. Whoever reads what it prints may go away when they have seen enough."""
    code = READER_GONE
    try:
        try:
            code = _run(argv)
        finally:
            sys.stdout.flush()  # here, where it can be reported, and not by the interpreter on its way out
    except BrokenPipeError:
        if not is_reader_gone():
            raise
    except OSError as error:
        if not is_output_lost(error):
            raise
        drop_output()
        print(f"{PROGRAM}: error: the output cannot be written: {error.strerror}", file=sys.stderr)
        code = 2
    return code


def _command(arguments: argparse.Namespace) -> Callable[[argparse.Namespace], int]:
    """Return the function of a command. Its module is imported now: NumPy and OpenCV must find their environment set,
    and what another command needs may not be installed.
    """
    name = arguments.command.replace("-", "_")
    if name in (here := {"serve": run_serve, "replay": run_replay}):
        return here[name]
    if name == "calibrate":
        name += "_in_flight" if arguments.from_session is not None else "_zoom" if arguments.zoom else ""
    run: Callable[[argparse.Namespace], int] = importlib.import_module(f"onboard.commands.{name}").run
    return run


def _run(argv: list[str] | None) -> int:
    _set_environment()
    arguments = parser().parse_args(argv)
    try:
        return _command(arguments)(arguments)
    except PointclickError as error:
        print(f"{PROGRAM}: error: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] in {"onboard", "contract"}:
            raise
        # The ground's installation has this command too, but not what it runs on.
        print(
            f"{PROGRAM}: error: {error.name} is not installed: install pointclick with its extra [onboard] (README)",
            file=sys.stderr,
        )
        return 2
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    sys.exit(main())
