"""`pc-ground live`: no computer on the aircraft: the downlink's video and the radio's telemetry, on this machine.

`pc-onboard run`, a program of its own, does here what it does on an aircraft; the page shows what it finds. Both end
together.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import signal
import socket
import subprocess
import threading
import time
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from contract.errors import InputError
from contract.tied_process import tied
from ground.onboard_program import pc_onboard, unused_port
from ground.pins.file import default_path
from ground.web import command as web
from ground.web import opened_page
from ground.web.startup import check_installed

EXAMPLES = """examples:
  pc-ground live --camera rtsp://192.168.144.25:8554/main.264 --telemetry udpin:0.0.0.0:14550 --camera-file camera.json
  pc-ground live --camera /dev/video0 --telemetry serial:/dev/ttyUSB0:57600 --camera-file camera.json   (HDMI grabber)
  pc-ground live ... --set mount.pitch_deg=-45 --set camera.mask=/home/anna/osd.png

--camera is camera.device and --telemetry is telemetry.url of the aircraft's configuration (config.toml); --set gives
any other key of it. What is learned in flight, and recordings, stay in a folder next to your pins.
"""
START_S = 30.0  # until the aircraft's program listens: it imports much, and GStreamer may look through its plugins
LOG_PREFIX = re.compile(r"^[\d-]+ [\d:,]+ [A-Z]+ +")
REFUSED = 2  # pc-onboard's exit code for what no waiting mends
END_S = 12.0  # for it to write what it has learned
# The link does not leave this machine: pictures for the page may be large.
DEFAULTS: dict[str, Any] = {
    "link.max_bit_rate": 8e6, "picture.enabled": True, "picture.max_px": 1280, "picture.quality": 60,
    "picture.rate_hz": 2.0,
}  # fmt: skip


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `live`."""
    parser.add_argument("--camera", metavar="DEVICE", required=True, help="rtsp://..., /dev/videoN, gst:PIPELINE, ...")
    parser.add_argument(
        "--telemetry", metavar="URL", required=True, help="udpin:HOST:PORT, serial:/dev/ttyUSB0:57600, ..."
    )
    parser.add_argument("--camera-file", metavar="FILE", type=Path, required=True, help="the camera's optics, as JSON")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="another key, as mount.pitch_deg=-45; repeatable",
    )
    parser.add_argument(
        "--state", metavar="DIR", type=Path, help="where what is learned and recordings stay (default: with your pins)"
    )
    opened_page.add_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Both programs until a signal ends them, or the aircraft's ends. Raises PointclickError."""
    check_installed()
    if not args.camera_file.is_file():
        raise InputError(f"{args.camera_file}: no such file; pc-onboard calibrate makes one (docs/calibrate.md)")
    folder = args.state or default_path().parent / "live"
    port = unused_port()
    config = _write_config(args, folder, port)
    program = pc_onboard()
    _check(program, config)
    signal.signal(signal.SIGTERM, _interrupt)  # so that what follows is ended in order
    with _onboard(program, config, folder / "onboard.log", port) as onboard:
        print(f"pc-onboard runs; its log: {folder / 'onboard.log'}", flush=True)
        try:
            web.run(opened_page.web_options(args, ["--connect", f"tcp/127.0.0.1:{port}"]))
        except KeyboardInterrupt:
            if onboard.poll() is None:
                raise
        if onboard.poll() is None:
            return 0
        raise InputError(f"pc-onboard has ended: {_last_line(folder / 'onboard.log')}")


def settings(args: argparse.Namespace, folder: Path, port: int) -> dict[str, Any]:
    """The aircraft's configuration by dotted keys. Raises InputError for a --set that is no KEY=VALUE."""
    keys = {
        **DEFAULTS,
        "camera.device": args.camera,
        "camera.file": str(args.camera_file.resolve()),
        "telemetry.url": args.telemetry,
        "link.listen": [f"tcp/127.0.0.1:{port}"],
        "service.state_dir": str(folder.resolve()),
    }
    for text in args.set:
        key, equals, value = text.partition("=")
        if not equals or key.count(".") != 1:
            raise InputError(f"--set {text}: it is SECTION.KEY=VALUE, as mount.pitch_deg=-45")
        try:
            keys[key] = tomllib.loads(f"value = {value}")["value"]
        except ValueError:
            keys[key] = value  # a text without its quotes
    return keys


def to_toml(keys: dict[str, Any]) -> str:
    """Dotted keys as a file; JSON's texts, numbers, switches and lists are TOML's."""
    sections: dict[str, list[str]] = {}
    for key, value in keys.items():
        section, _, name = key.partition(".")
        sections.setdefault(section, []).append(f"{name} = {json.dumps(value, ensure_ascii=False)}")
    return "\n".join(f"[{section}]\n" + "\n".join(lines) + "\n" for section, lines in sections.items())


def _write_config(args: argparse.Namespace, folder: Path, port: int) -> Path:
    path = folder / "config.toml"
    text = to_toml(settings(args, folder, port))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        path.touch(mode=0o600)  # a camera's URL may hold a password
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{error.filename or path}: {error.strerror}") from error
    return path


def _check(program: str, config: Path) -> None:
    """Raises InputError with what can never work of the configuration; what may come later is waited for."""
    command = [program, "check-config", "--fly", "--config", str(config)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode == REFUSED:
        lines = (done.stderr.strip() or done.stdout.strip()).splitlines()[-1:] or ["the configuration is refused"]
        raise InputError(lines[0].removeprefix("pc-onboard: error: ").removeprefix(f"{config}: "))


@contextmanager
def _onboard(program: str, config: Path, log: Path, port: int) -> Iterator[subprocess.Popen[bytes]]:
    """The aircraft's program, once it listens; ended at the end. This process is interrupted when it ends by itself."""
    with log.open("wb") as out:
        command = tied([program, "run", "--config", str(config)], signal.SIGTERM)
        process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=out, stderr=out)
    try:
        _wait_until_it_listens(process, port, log)
        threading.Thread(target=_interrupt_at_end, args=(process,), daemon=True, name="pc-onboard").start()
        yield process
    finally:
        process.terminate()
        try:
            process.wait(END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _wait_until_it_listens(process: subprocess.Popen[bytes], port: int, log: Path) -> None:
    deadline = time.monotonic() + START_S
    while True:
        if process.poll() is not None:
            raise InputError(f"pc-onboard did not start: {_last_line(log)}")
        try:
            socket.create_connection(("127.0.0.1", port), 0.5).close()
        except OSError:
            if time.monotonic() > deadline:
                raise InputError(f"pc-onboard does not answer; its log: {log}") from None
            time.sleep(0.1)
        else:
            return


def _interrupt_at_end(process: subprocess.Popen[bytes]) -> None:
    process.wait()
    os.kill(os.getpid(), signal.SIGINT)  # the page's server ends in order


def _interrupt(*_: object) -> None:
    raise KeyboardInterrupt


def _last_line(log: Path) -> str:
    """The last line that the aircraft's program printed, without its log prefix."""
    lines = [line for line in log.read_text(encoding="utf-8", errors="replace").splitlines() if line.strip()]
    return LOG_PREFIX.sub("", lines[-1]) if lines else f"nothing in its log, {log}"
