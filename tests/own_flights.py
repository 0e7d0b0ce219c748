"""A simulated flight as its pilot has it: a video with the subtitles of a drone, or pictures named by UTC and a log."""

import csv
import shutil
import struct
from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy as np

from contract.camera import Camera
from contract.geodesy import LocalFrame
from onboard.camera.photo_lens import FULL_FRAME_DIAGONAL_MM
from tests.onboard.telemetry import log_writers

SLOW_ERROR_M = (0.9, -0.6, 4.0)  # east, north, up: of a receiver for a minute


def write_video(session: Path, video: Path, *, subtitles: bool = True, drop: int | None = None) -> Path:
    """The frames of a session as MP4 and next to it what a drone writes into subtitles. `drop`: every so many missing.

    Returns the file of subtitles.
    """
    camera = Camera.from_json(session / "camera.json")
    with (session / "truth.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    with (session / "stamps.csv").open(newline="") as stream:
        stamps = list(csv.DictReader(stream))
    times_s = np.array([float(row["unix_time_s"]) for row in stamps])
    rate_hz = (len(times_s) - 1) / float(times_s[-1] - times_s[0])
    writer = cv2.VideoWriter(str(video), cv2.VideoWriter_fourcc(*"mp4v"), rate_hz, camera.size_px)  # type: ignore[attr-defined]
    assert writer.isOpened()
    for row in stamps:
        writer.write(cv2.imread(str(session / "frames" / row["file"]), cv2.IMREAD_COLOR))
    writer.release()
    path = video.with_suffix(".SRT")
    if subtitles:
        focal_mm = camera.focal_px * FULL_FRAME_DIAGONAL_MM / float(np.hypot(*camera.size_px))
        path.write_text("".join(_subtitle(k, k / rate_hz, times_s[0], row, focal_mm) for k, row in enumerate(rows)))
    return path


def _subtitle(number: int, at_s: float, began_s: float, row: dict[str, str], focal_mm: float) -> str:
    place = LocalFrame(float(row["lat_deg"]), float(row["lon_deg"]), float(row["height_amsl_m"]))
    lat, lon, height = (float(c) for c in place.to_geodetic(np.array(SLOW_ERROR_M)))
    moment = datetime.fromtimestamp(began_s + at_s, UTC)
    return (
        f'{number + 1}\n{_clock(at_s)} --> {_clock(at_s + 0.03)}\n<font size="28">FrameCnt: {number + 1}\n'
        f"{moment:%Y-%m-%d %H:%M:%S}.{moment.microsecond // 1000:03d}\n"
        f"[iso: 100] [focal_len: {focal_mm:.2f}] [latitude: {lat:.6f}] [longitude: {lon:.6f}] "
        f"[rel_alt: {height - 100.0:.3f} abs_alt: {height:.3f}] </font>\n\n"
    )


def _clock(seconds: float) -> str:
    ms = round(seconds * 1000.0)
    return f"{ms // 3_600_000:02d}:{ms // 60_000 % 60:02d}:{ms // 1000 % 60:02d},{ms % 1000:03d}"


def write_named_photographs(session: Path, folder: Path) -> None:
    """The frames of a session, without EXIF, by names that say when they were taken, and the autopilot's log."""
    folder.mkdir()
    with (session / "stamps.csv").open(newline="") as stream:
        for row in csv.DictReader(stream):
            moment = datetime.fromtimestamp(float(row["unix_time_s"]), UTC)
            name = f"{moment:%Y%m%d%H%M%S}{moment.microsecond // 1000:03d}Z.png"
            shutil.copyfile(session / "frames" / row["file"], folder / name)
    shutil.copyfile(session / "telemetry.tlog", folder / "flight.tlog")


def vary_rate(video: Path, apart: list[int]) -> None:
    """Give the frames of an MP4 of OpenCV's other times: how many ticks each lasts, in its table `stts`."""
    data = bytearray(video.read_bytes())
    at, around = 0, []
    for kind in (b"moov", b"trak", b"mdia", b"minf", b"stbl", b"stts"):
        while data[at + 4 : at + 8] != kind:
            at += struct.unpack_from(">I", data, at)[0]
        around.append(at)
        at += 8
    start, (size, _, _, entries) = around[-1], struct.unpack_from(">I4sII", data, around[-1])
    assert size == 16 + 8 * entries
    table = b"".join(struct.pack(">II", 1, ticks) for ticks in apart)
    # The pictures lie before, so nothing that is pointed at moves.
    data[start : start + size] = struct.pack(">I4sII", 16 + len(table), b"stts", 0, len(apart)) + table
    for box in around[:-1]:
        struct.pack_into(">I", data, box, struct.unpack_from(">I", data, box)[0] + 16 + len(table) - size)
    video.write_bytes(data)


def turn(video: Path) -> None:
    """Into an MP4 of OpenCV's, that it is to be shown turned by a quarter, as a phone's held upright is."""
    data = bytearray(video.read_bytes())
    struct.pack_into(">9i", data, data.index(b"tkhd") + 44, 0, 1 << 16, 0, -(1 << 16), 0, 0, 0, 0, 1 << 30)
    video.write_bytes(data)


def show_from(video: Path, begin_s: float, lasts_s: float) -> None:
    """Into an MP4 of OpenCV's, of what part it is to be shown, as programs cut that leave the pictures as they are."""
    data = bytearray(video.read_bytes())
    units_hz, per_s = (struct.unpack_from(">I", data, data.index(box) + 16)[0] for box in (b"mdhd", b"mvhd"))
    edit = round(lasts_s * per_s), round(begin_s * units_hz)
    struct.pack_into(">Ii", data, data.index(b"elst") + 12, *edit)
    video.write_bytes(data)


def set_creation(video: Path, moment: datetime) -> None:
    """Into the header of an MP4 of OpenCV's, when it was begun."""
    data = bytearray(video.read_bytes())
    since_1904 = moment - datetime(1904, 1, 1, tzinfo=UTC)
    struct.pack_into(">I", data, data.index(b"mvhd") + 8, since_1904.days * 86_400 + since_1904.seconds)
    video.write_bytes(data)


def with_metadata(video: Path, sets: dict[float, bytes], is_timed: bool = True) -> None:
    """Into a transport stream of OpenCV's (MPEG-4), sets at their times (s) on the video's own."""
    data, out, left, at_s = video.read_bytes(), b"", sorted(sets.items()), -1.0
    for k in range(0, len(data), 188):
        packet = data[k : k + 188]
        pid = (packet[1] & 0x1F) << 8 | packet[2]
        if pid == log_writers.VIDEO_PID and packet[1] & 0x40:
            start = 4 + (1 + packet[4] if packet[3] & 0x20 else 0)
            a, b, c = packet[start + 9], *struct.unpack_from(">HH", packet, start + 10)
            at_s = ((a >> 1 & 7) << 30 | (b >> 1) << 15 | c >> 1) / 90_000 - 1.4
            while left and left[0][0] <= at_s:
                time_s, content = left.pop(0)
                out += log_writers.metadata_packets(content, time_s if is_timed else None)
        out += log_writers.map_of_streams(0x10, 0x15 if is_timed else 0x06) if pid == log_writers.MAP_PID else packet
    video.write_bytes(out)
