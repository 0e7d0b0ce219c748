"""`camera.device` -> the helper program that gives its pictures, and how it is started."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from contract.errors import ConfigError
from contract.secrets import without_secrets
from onboard.camera.helper_camera import Launch
from onboard.config.schema import CameraConfig, Config

EXEC, GST, LIBCAMERA, RTSP = "exec:", "gst:", "libcamera:", ("rtsp://", "rtspt://", "rtspu://", "rtsps://")
URLS = ("udp://", "srt://", "http://", "https://")  # of streams and files that GStreamer opens by their address
SYSTEM_PYTHON = "/usr/bin/python3"  # Debian's, which has GStreamer's bindings
ASK_S = 20.0  # GStreamer looks through all its plugins when it is asked for the first time
HELPER = Path(__file__).with_name("gstreamer_helper.py")
BOX = Path(__file__).with_name("box.py")
NO_NETWORK = "--no-network"  # of box.py
OF_THE_UNIT = ("STATE_DIRECTORY", "LOGS_DIRECTORY", "CONFIGURATION_DIRECTORY")
"""Variables in which systemd names the unit's own folders: recordings, keys, what was learned."""
IN_SOFTWARE = {"avdec_h264", "avdec_h265", "avdec_mjpeg", "avdec_mpeg4", "jpegdec", "openh264dec"}
LOCAL_SOURCES = {
    "v4l2src",
    "libcamerasrc",
    "nvarguscamerasrc",
    "nvv4l2camerasrc",
    "videotestsrc",
    "filesrc",
    "multifilesrc",
}
_SOURCE = re.compile(r"\w+src\b")
_OUTSIDE = re.compile(r"sink|uri|://|rtsp|rtmp|webrtc|whip|client|server", re.IGNORECASE)  # in a pipeline of one's own
_SINK = re.compile(r"\w*sink\b")  # appsink, autovideosink, xvimagesink, fakesink, ...


def helper_launch(config: CameraConfig, size_px: tuple[int, int], closed: Sequence[str] = ()) -> Launch | None:
    """The program for a device that needs one; None for V4L2. Raises ConfigError where its form is wrong.

    Ours decodes what a network sends, in a box (box.py) from which what is `closed` cannot be read.
    A program of the user's own gets size and rate in its environment, and no box.
    """
    device = config.device
    if device.startswith(EXEC):
        return _own_program(device.removeprefix(EXEC), size_px, config.rate_hz)
    asked: dict[str, Any] = {"width": size_px[0], "height": size_px[1], "rate_hz": config.rate_hz}
    asked["utc"] = config.stream_clock == "utc"
    if device.startswith(RTSP):
        return gstreamer_launch({"kind": "rtsp", "location": device, **asked}, without_secrets(device), closed)
    if device.startswith(LIBCAMERA):
        asked |= {"camera": device.removeprefix(LIBCAMERA), "exposure_us": config.exposure_us}
        return gstreamer_launch({"kind": "libcamera", **asked}, device, closed)
    if device.startswith(URLS):
        pipeline = f"uridecodebin uri={json.dumps(device)}"
        return gstreamer_launch({"kind": "gst", "pipeline": pipeline, **asked}, without_secrets(device), closed)
    if device.startswith(GST):
        pipeline = device.removeprefix(GST).strip()
        if not pipeline:
            raise ConfigError(f"camera.device: {GST} needs a pipeline, as {GST}v4l2src ! image/jpeg ! jpegdec")
        end = pipeline.rpartition("!")[2].strip()
        if _SINK.match(end):
            raise ConfigError(
                f"camera.device: the pipeline ends in {end.split()[0]!r}: leave that and the '!' before it out; "
                "pictures are taken where the pipeline ends"
            )
        return gstreamer_launch({"kind": "gst", "pipeline": pipeline, **asked}, without_secrets(device), closed)
    if re.match(r"[a-z]+:", device):
        raise ConfigError(
            f"camera.device = {device!r} is none of /dev/NAME, {LIBCAMERA}ID, rtsp://HOST/PATH, "
            f"{', '.join(URLS)}..., {GST}PIPELINE, {EXEC}COMMAND, replay:FOLDER"
        )
    return None


def private_paths(config: Config, environment: Mapping[str, str]) -> tuple[str, ...]:
    """Return the files and folders that the decoder of strangers' video has no business in: keys, state, recordings."""
    state = config.service.state_dir or str(Path.home() / ".local" / "state" / "pointclick")
    named = (state, config.recording.folder, config.link.key, config.telemetry.signing_key)
    of_the_unit = (path for name in OF_THE_UNIT for path in environment.get(name, "").split(":"))
    return tuple(str(Path(path).absolute()) for path in (*named, *of_the_unit) if path)


def gstreamer_launch(spec: dict[str, Any], name: str, closed: Sequence[str] = ()) -> Launch:
    """Our own helper with something to open; what is to be opened, which may hold a password, goes by its input."""
    environment = {"LIBCAMERA_LOG_LEVELS": "*:ERROR"}  # the last line printed is shown as the reason of an end
    box = (str(BOX), *(() if needs_network(spec) else (NO_NETWORK,)), *closed)
    command = (SYSTEM_PYTHON, "-I", *box, "--", SYSTEM_PYTHON, "-I", str(HELPER))
    return Launch(name, command, json.dumps(spec).encode(), environment, is_compressed=spec["kind"] != "libcamera")


def needs_network(spec: Mapping[str, Any]) -> bool:
    """Return whether what is opened may use the network: a pipeline unless all of it is known not to."""
    if spec["kind"] != "gst":
        return bool(spec["kind"] == "rtsp")
    sources = set(_SOURCE.findall(spec["pipeline"]))
    return not sources or not sources <= LOCAL_SOURCES or _OUTSIDE.search(spec["pipeline"]) is not None


def unable(launch: Launch) -> str:
    """Return why a helper cannot be started, or cannot open things of that kind; empty if it can. Nothing is opened."""
    if launch.command[:1] != (SYSTEM_PYTHON,) or str(HELPER) not in launch.command:
        return "" if shutil.which(launch.command[0]) else f"{launch.command[0]}: no such program"
    return _ask({**json.loads(launch.stdin), "is_check": True})[1]


def libcamera_names() -> tuple[list[str], str]:
    """The IDs of libcamera's cameras, and why they could not be listed (empty if they could)."""
    text, why = _ask({"kind": "list"})
    return ([] if why else [str(name) for name in json.loads(text)]), why


def decoders_text() -> str:
    """Return in words what decodes the video of streams on this computer, or why that is not known."""
    text, why = _ask({"kind": "decoders"})
    if why:
        return f"video of streams is not decoded: {why}"
    return "; ".join(_decoded(codec, names) for codec, names in json.loads(text).items())


def _decoded(codec: str, names: list[str]) -> str:
    """Return in words which decoder of a codec is tried first, and which if that does not work."""
    decoders = [f"{name} (hardware)" if name not in IN_SOFTWARE else name for name in names]
    return f"{codec} by {', else '.join(decoders)}" if decoders else f"{codec} by nothing that is installed"


def _ask(spec: dict[str, Any]) -> tuple[str, str]:
    """Return our helper's answer to `spec`, and why it did not answer ('' if it did)."""
    launch = gstreamer_launch(spec, "")
    try:
        done = subprocess.run(
            launch.command,
            input=launch.stdin,
            capture_output=True,
            env={**os.environ, **launch.environment},
            timeout=ASK_S,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return "", f"{SYSTEM_PYTHON}: {getattr(error, 'strerror', '') or 'does not answer'}"
    lines = done.stderr.decode("utf-8", "replace").strip().splitlines()
    why = "" if done.returncode == 0 else (lines[-1] if lines else f"ended with exit status {done.returncode}")
    return done.stdout.decode("utf-8", "replace"), why


def _own_program(text: str, size_px: tuple[int, int], rate_hz: float) -> Launch:
    try:
        command = shlex.split(text)
    except ValueError as error:
        raise ConfigError(f"camera.device: {EXEC}{text}: {error}") from error
    if not command:
        raise ConfigError(f"camera.device: {EXEC} needs a command, as exec:/usr/local/bin/my-camera --gain 3")
    width, height = size_px
    asked = {"POINTCLICK_WIDTH": f"{width}", "POINTCLICK_HEIGHT": f"{height}", "POINTCLICK_RATE_HZ": f"{rate_hz:g}"}
    return Launch(f"{EXEC}{command[0]}", tuple(command), environment=asked)
