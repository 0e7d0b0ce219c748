"""`pc-ground open`: the user's own flight in the browser: a video with its log, a folder of photographs, or a session.

`pc-onboard`, a program of its own, makes a flight of pictures and log, and replays it; here it is only started.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import shlex
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from contract.errors import InputError
from ground.onboard_program import pc_onboard
from ground.pins.file import default_path
from ground.web import command as web
from ground.web import opened_page
from ground.web.startup import check_installed

EXAMPLES = """examples:
  pc-ground open DJI_0042.MP4                        with DJI_0042.SRT next to it, or the only log in the folder
  pc-ground open GX010042.MP4 00000042.BIN --set camera.fov_deg=69 --set mount.pitch_deg=-45
  pc-ground open DJI_0042.MP4 --telemetry DJI_0042.SRT --telemetry flightrecord.csv    two logs of one flight
  pc-ground open PHOTOS/                             by the positions in the photographs, or a log next to them
  pc-ground open FLIGHT/                             pictures below it (frames/, DCIM/100MEDIA), and its log
  pc-ground open SESSION.mcap

A flight is replayed once: opened again, it is there at once. What was guessed of camera and mount is listed; --set
replaces it.
"""
SESSION = ".mcap"
PICTURES = "recording.pictures"
UNKNOWN = "NOT KNOWN"  # in the list that an import prints, of values that were assumed with a wide sigma
DONE, NOTHING_SOLVED = 0, 3
PICTURE_SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff")
VIDEO_SUFFIXES = (".mp4", ".mov", ".avi", ".mkv", ".ts", ".m2ts", ".mts", ".mpg", ".mpeg", ".webm")
LOG_SUFFIXES = (".bin", ".ulg", ".csv", ".gpx", ".ass", ".srt", ".nmea", ".pos", ".mrk", ".tlog")
NEAR, ABOVE = ("camera.json", "config.toml", "stamps.csv", "geo.txt"), 2  # what an import finds so far above pictures
IMPORT = "clock searched"  # how flights are imported now: one that was imported otherwise is not shown again


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `open`."""
    parser.add_argument("input", metavar="VIDEO|PHOTOS/|SESSION.mcap", type=Path, help="what was recorded")
    parser.add_argument(
        "log",
        metavar="LOG",
        type=Path,
        nargs="?",
        help="the flight's log: .srt, .bin, .tlog, .ulg, tables, tracks (a session: its video)",
    )
    parser.add_argument(
        "--telemetry", metavar="LOG", type=Path, action="append", default=[],
        help="the log, named so; with LOG, or twice: two logs of one flight, each sensor from the better",
    )  # fmt: skip
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE",
        help="camera.fov_deg, camera.file or a configuration key such as mount.pitch_deg, not guessed; repeatable",
    )  # fmt: skip
    parser.add_argument(
        "--stamps", metavar="STAMPS.csv", type=Path,
        help="when each picture was taken: file,unix_time_s of photographs, index,unix_time_s of a video",
    )  # fmt: skip
    parser.add_argument("--start", metavar="TIME", help="when the video began, in UTC, as 2026-06-12T10:15:23.4Z")
    parser.add_argument("--utc-offset", metavar="H", help="the camera's clock is so many hours ahead of UTC")
    parser.add_argument(
        "--clock-offset", metavar="S",
        help="the camera's clock is so many seconds ahead of UTC (12.4, or 12.4+-0.5); else searched over the log",
    )  # fmt: skip
    parser.add_argument("--home-amsl-m", metavar="M", help="the take-off's height above the sea, for a log without it")
    parser.add_argument("--out", metavar="FLIGHT", type=Path, help="folder for the flight (default: with your pins)")
    opened_page.add_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Replay what must be replayed, then serve the page until a signal ends it. Raises PointclickError."""
    check_installed()
    if not args.input.exists():
        raise InputError(f"{args.input}: no such file or folder")
    if is_session(args.input):
        for name in ("telemetry", "stamps"):
            if getattr(args, name):
                raise InputError(f"{args.input}: a session has its own {name}: leave --{name} out")
        session, video = args.input, args.log
    else:
        args.input = _video_in(args.input) or args.input
        code, session = _replayed(args)
        if code != DONE:
            return code
        video = None
    shown = ["--from", str(session), *([] if video is None else ["--video", str(video)])]
    return web.run(opened_page.web_options(args, shown))


def is_session(path: Path) -> bool:
    return path.suffix.lower() == SESSION or (path.is_dir() and any(path.glob(f"*{SESSION}")))


def _video_in(path: Path) -> Path | None:
    """The only video of a folder without pictures; of a folder with pictures they are the flight. Raises InputError."""
    if not path.is_dir():
        return None
    files = _files_below(path)
    videos = [file for file in files if file.suffix.lower() in VIDEO_SUFFIXES]
    if not videos or any(file.suffix.lower() in PICTURE_SUFFIXES for file in files):
        return None
    if len(videos) > 1:
        raise InputError(f"{path}: {len(videos)} videos in it, {', '.join(str(v) for v in videos[:4])}: name one")
    return videos[0]


def _files_below(folder: Path) -> list[Path]:
    """All files in a folder and below it, without hidden ones."""
    found = (path for path in folder.rglob("*") if not any(p.startswith(".") for p in path.relative_to(folder).parts))
    return sorted(path for path in found if path.is_file())


def _replayed(args: argparse.Namespace) -> tuple[int, Path]:
    """The session of pictures and a log, made now unless it is there; and `pc-onboard`'s exit status."""
    importing = _import_words(args)
    folder = args.out or default_path().parent / "flights" / _name(args, importing)
    session = folder / f"session{SESSION}"
    if args.out is None and session.is_file():
        print(f"{args.input}: replayed before, {folder}")
        return DONE, session
    if args.out is None:
        shutil.rmtree(folder, ignore_errors=True)  # of an attempt that was broken off
        folder.parent.mkdir(parents=True, exist_ok=True)
    program = pc_onboard()
    made = _output([program, *importing, "--out", str(folder)])
    if made.returncode != DONE:
        return made.returncode, session
    *printed, replay = made.stdout.rstrip("\n").split("\n")
    print("\n".join(printed), flush=True)
    replayed = _output([program, *shlex.split(replay)[1:], *([] if sys.stderr.isatty() else ["--progress"])])
    lines = replayed.stdout.rstrip("\n").split("\n")
    # Without what took how long, and without the reports of hot spots, which the page shows.
    print("\n".join(line for line in lines if not line.startswith(("time, ", "{"))), flush=True)
    if replayed.returncode == NOTHING_SOLVED:
        guess = "; of the camera nothing is known: give --set camera.fov_deg=DEGREES" if UNKNOWN in made.stdout else ""
        print(f"no picture was solved: there is nothing to click{guess}", file=sys.stderr)
    if replayed.returncode != DONE and args.out is None:
        session.unlink(missing_ok=True)  # the next attempt begins again
    return replayed.returncode, session


def _import_words(args: argparse.Namespace) -> list[str]:
    """`pc-onboard`'s command that makes the flight, without the folder to write."""
    words = ["import-photos" if args.input.is_dir() else "import-video", str(args.input.resolve())]
    words += [word for log in _logs(args) for word in ("--telemetry", str(log.resolve()))]
    if not any(text.startswith(f"{PICTURES}=") for text in args.set):
        words += ["--set", f"{PICTURES}=jpeg"]
    words += [word for text in args.set for word in ("--set", text)]
    if args.start is not None:
        if args.input.is_dir():
            raise InputError("--start is of a video; photographs have their times in EXIF or name")
        words += ["--start", args.start]
    if args.stamps is not None:
        words += ["--stamps", str(args.stamps.resolve())]
    for name in ("utc_offset", "clock_offset", "home_amsl_m"):
        value = getattr(args, name)
        words += [] if value is None else [f"--{name.replace('_', '-')}={value}"]
    return words


def _logs(args: argparse.Namespace) -> list[Path]:
    return [*([] if args.log is None else [args.log]), *args.telemetry]


def _name(args: argparse.Namespace, importing: Sequence[str]) -> str:
    """The name of the flight's folder: another for other files or settings, and for files that have changed since."""
    files = [file for path in _read_by_import(args) for file in (_files_below(path) if path.is_dir() else [path])]
    stats = [(str(path), path.stat().st_size, path.stat().st_mtime_ns) for path in files if path.is_file()]
    digest = hashlib.sha256(repr((IMPORT, importing, stats)).encode()).hexdigest()
    return f"{args.input.resolve().stem}-{digest[:8]}"


def _read_by_import(args: argparse.Namespace) -> list[Path]:
    """All files and folders that an import may read, there or not."""
    place = args.input.resolve()
    named = [args.input, *_logs(args), *([] if args.stamps is None else [args.stamps]), *_named_in(args.set)]
    if not _logs(args):  # a log is searched for among what lies with a video, or next to a folder of photographs
        with contextlib.suppress(OSError):  # of a folder that may not be read nothing is taken
            named += [file for file in sorted(place.parent.iterdir()) if file.suffix.lower() in LOG_SUFFIXES]
    above = [place, *place.parents][: ABOVE + 2]
    return named + [folder / name for folder in above for name in NEAR]


def _named_in(settings: Sequence[str]) -> list[Path]:
    """The files and folders that are the values of settings: a camera file, elevations."""
    found = []
    for text in settings:
        path = Path(text.partition("=")[2].strip().strip("\"'") or ".")
        with contextlib.suppress(OSError, ValueError):  # of another value
            if path != Path() and path.exists():
                found.append(path.resolve())
    return found


def _output(command: Sequence[str]) -> subprocess.CompletedProcess[str]:
    """Run to its end; its errors and its progress bar go where ours do."""
    try:
        return subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
    except OSError as error:
        raise InputError(f"{command[0]}: {error.strerror}") from error
