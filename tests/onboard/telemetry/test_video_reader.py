"""Telemetry in a video's own tracks; that of a whole flight is in `test_log_files`."""

import math
import os
import shutil
import struct
from pathlib import Path

import numpy as np
import pytest

from contract.errors import InputError
from onboard.events.types import Attitude, GimbalAttitude, PositionFix
from onboard.telemetry import exiftool_reader
from onboard.telemetry.log_files import read_log
from onboard.telemetry.mp4_container import first_picture_s
from onboard.telemetry.telemetry_log import TelemetryLog, quaternion
from tests.bench.image.host import install
from tests.left_out import NO_PROGRAM
from tests.onboard.telemetry.log_events import of
from tests.onboard.telemetry.log_writers import box, gpmf, mp4, track

BEGAN_NS = 1_780_308_000 * 10**9  # 2026-06-01 10:00:00
SUBTITLE = "2026-06-01 10:00:0{0}.000 [latitude: 47.10000{0}] [longitude: 8.2] [rel_alt: 30.1 abs_alt: 501.3]"


def read(tmp_path: Path, content: bytes) -> TelemetryLog:
    (tmp_path / "video.MP4").write_bytes(content)
    return read_log(tmp_path / "video.MP4")


Parts = tuple[tuple[float, float | None], ...]


def edits(*parts: tuple[float, float | None]) -> bytes:
    """A list of edits, of a thousand units a second: how long each lasts, s, and where it begins; None: empty."""
    rows = [(round(1000 * lasts), -1 if begins is None else round(1000 * begins)) for lasts, begins in parts]
    return box(b"edts", box(b"elst", struct.pack(">4xI", len(rows)), *(struct.pack(">Ii4x", *row) for row in rows)))


def five(utc: bytes, lat_deg: float, fix: int = 3, origin: bytes = b"") -> bytes:
    """A second of a Hero 5 to 10: two positions, one time for both."""
    one = struct.pack(">5i", round(lat_deg * 1e7), 82_000_000, 500_000, 0, 0)
    stream = gpmf(b"GPSF", b"L", 4, struct.pack(">I", fix)) + gpmf(b"GPSU", b"U", 16, utc)
    stream += gpmf(b"GPSP", b"S", 2, struct.pack(">H", 160)) + (gpmf(b"GPSA", b"F", 4, origin) if origin else b"")
    stream += gpmf(b"SCAL", b"l", 4, struct.pack(">5i", 10**7, 10**7, 1000, 1000, 100))
    stream += gpmf(
        b"GPS5", b"l", 20, one + struct.pack(">5i", round((lat_deg + 1e-5) * 1e7), 82_000_000, 500_000, 0, 0)
    )
    return gpmf(b"DEVC", b"\0", 1, gpmf(b"STRM", b"\0", 1, stream))


def test_a_stale_time_of_an_older_gopro_moves_no_position(tmp_path: Path) -> None:
    """A Max writes one that is 1.4 s old with the first second of its video."""
    times = [b"260601095958.600", b"260601100001.000", b"260601100002.000", b"260601100003.000"]
    seconds = [five(utc, 47.0 + 1e-4 * k, fix=2 if k == 3 else 3) for k, utc in enumerate(times)]
    log = read(tmp_path, mp4(b"gpmd", seconds, [0.0, 1.0, 2.0, 3.0]))
    fixes = of(log, PositionFix)
    assert [fix.stamp_ns - BEGAN_NS for fix in fixes] == [k * 500_000_000 for k in range(6)]  # none of the last second
    assert [fix.lat_deg for fix in fixes] == pytest.approx([47.0, 47.00001, 47.0001, 47.00011, 47.0002, 47.00021])
    assert log.video_began == (BEGAN_NS, 0.5) and log.utc_sigma_s == 0.0
    assert log.notes[0].startswith("2 of 8 positions") and log.notes[1].startswith("heights count from the ellipsoid")


def test_heights_that_a_gopro_counts_from_the_sea_are_not_the_ellipsoid_s(tmp_path: Path) -> None:
    log = read(tmp_path, mp4(b"gpmd", [five(b"260601100000.000", 47.0, origin=b"MSLV")], [0.0]))
    assert log.notes == ("heights above sea level are +-40 m as a whole",)


def test_subtitles_in_a_video_are_as_those_next_to_it(tmp_path: Path) -> None:
    texts = [SUBTITLE.format(k).encode() for k in range(3)]
    samples = [struct.pack(">H", len(text)) + text for text in texts]
    log = read(tmp_path, mp4(b"tx3g", samples, [0.0, 1.0, 2.0], handler=b"sbtl"))
    fixes = of(log, PositionFix)
    assert log.video_epoch_ns == BEGAN_NS
    assert [(fix.stamp_ns - BEGAN_NS) // 10**9 for fix in fixes] == [0, 1, 2]
    assert [fix.lat_deg for fix in fixes] == [47.1, 47.100001, 47.100002]


@pytest.mark.parametrize(
    ("of_video", "of_texts", "shown_s"),
    [
        ((), ((2.0, 1.0),), {1: 0.0, 2: 1.0}),  # the first second cut off
        ((), ((0.5, None), (3.0, 0.0)), {0: 0.5, 1: 1.5, 2: 2.5}),  # they begin later
        (((0.5, None), (3.0, 0.0)), (), {0: -0.5, 1: 0.5, 2: 1.5}),  # the pictures do
        ((), ((1.0, 2.0), (1.0, 0.0)), {2: 0.0, 0: 1.0}),
        ((), ((0.0, 1.0),), {1: 0.0, 2: 1.0}),  # to its end
    ],
)
def test_what_is_cut_off_a_video_is_cut_off_its_subtitles(
    tmp_path: Path, of_video: Parts, of_texts: Parts, shown_s: dict[int, float]
) -> None:
    """Of one that a program had cut without touching the pictures they were late by what was cut off."""
    texts = [SUBTITLE.format(k).encode() for k in range(3)]
    samples = [struct.pack(">H", len(text)) + text for text in texts]
    of_both = {"of_video": edits(*of_video), "of_track": edits(*of_texts)}
    log = read(tmp_path, mp4(b"tx3g", samples, [0.0, 1.0, 2.0], b"sbtl", **of_both))
    fixes = of(log, PositionFix)
    assert log.video_epoch_ns is not None
    found = {round((fix.lat_deg - 47.1) * 1e6): (fix.stamp_ns - log.video_epoch_ns) / 1e9 for fix in fixes}
    assert found == pytest.approx(shown_s)


@pytest.mark.parametrize(
    ("later_s", "begin_s", "first_s"),
    [((), 0.0, 0.0), ((), 1.2, 0.8), ((1.0, 3.0, 0.0, 0.0), 1.0, 0.0), ((1.0, 3.0, 0.0, 0.0), 1.5, 0.5)],
)
def test_the_first_picture_is_the_first_that_is_shown_in_whatever_order_they_lie(
    tmp_path: Path, later_s: tuple[float, ...], begin_s: float, first_s: float
) -> None:
    """Pictures that others are decoded from lie before these: shown at 1, 4, 2, 3 s in the last two."""
    of_video = edits((2.0, begin_s))
    pictures = track(b"vide", b"avc1", [b"x"] * 4, [0.0, 1.0, 2.0, 3.0], 0, b"", of_video, later_s)
    movie = box(b"moov", box(b"mvhd", struct.pack(">12xI84x", 1000)), pictures)
    (tmp_path / "video.MP4").write_bytes(box(b"ftyp", b"mp42\0\0\0\0") + movie)
    assert first_picture_s(tmp_path / "video.MP4") == pytest.approx(first_s)


@pytest.mark.parametrize(
    ("kind", "about", "printed"),
    [
        (b"gpmd", b"", "its GPMF track has no position"),
        (b"mett", b"application/octet-stream;type=com.parrot.videometadata2", "a Parrot's telemetry, of another"),
        (b"mett", b"application/octet-stream;type=com.parrot.videometadata3", "none of the 1 samples"),
        (b"mett", b"application/x-others", "no telemetry that is known"),
        (b"djmd", b"", "DJI's own data"),
        (b"tx3g", b"", "no position in its 1 subtitles"),
    ],
)
def test_what_is_in_a_video_and_not_read_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: bytes, about: bytes, printed: str
) -> None:
    monkeypatch.setattr(exiftool_reader, "PROGRAM", "no-exiftool-here")
    with pytest.raises(InputError, match=printed):
        read(tmp_path, mp4(kind, [b"\0\5hello"], [0.0], about=about))


def camm(count: int, of_track: bytes = b"", of_video: bytes = b"") -> bytes:
    """Google's camera motion: positions of type 5, half a second apart."""
    samples = [struct.pack("<HH3d", 0, 5, 47.0 + 1e-4 * k, 8.2, 500.0 + k) for k in range(count)]
    return mp4(b"camm", samples, [0.5 * k for k in range(count)], of_track=of_track, of_video=of_video)


EXIFTOOL_PRINTS = (
    ";;;\n0;47;8.2;500\n0.5;47.0001;8.2;501\n1;;8.2;502\n1.5;97;8.2;502\n2;nan;8.2;inf\n2.5;47.0005;8.2;505\n"
)


def positions_of(log: TelemetryLog) -> list[tuple[float, float, float]]:
    fixes = of(log, PositionFix)
    return [((fix.stamp_ns - fixes[0].stamp_ns) / 1e9, fix.lat_deg, fix.height_amsl_m) for fix in fixes]


def test_what_exiftool_prints_is_the_log_of_a_track_that_is_not_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = tmp_path / "exiftool"
    program.write_text(f"#!/bin/sh\nprintf '%s' '{EXIFTOOL_PRINTS}'\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    log = read(tmp_path, camm(6))
    assert positions_of(log) == [(0.0, 47.0, 500.0), (0.5, 47.0001, 501.0), (2.5, 47.0005, 505.0)]
    assert log.video_began is not None and log.video_began[1] == 0.5 and log.utc_sigma_s is None
    assert log.notes[0] == "positions as exiftool reads them"
    # Its times are the track's own: of a video that was cut, the positions were late by what was cut off.
    cut = read(tmp_path, camm(6, edits((9.0, 0.5)), edits((0.25, None), (9.0, 0.0))))
    assert cut.video_began is not None
    since_s = [(e.stamp_ns - cut.video_began[0]) / 1e9 for e in cut.events if isinstance(e, PositionFix)]
    assert since_s == [-0.25, 1.75]
    with pytest.raises(InputError, match="all positions that exiftool finds are of parts that were cut off"):
        read(tmp_path, camm(6, edits((9.0, 50.0))))
    program.write_text("#!/bin/sh\nexit 1\n")
    with pytest.raises(InputError, match=r"camera motion \(camm\): exiftool finds no positions"):
        read(tmp_path, camm(6))


@pytest.mark.long  # short: what it printed, above; and `make test` does not install it
def test_exiftool_reads_a_track(tmp_path: Path) -> None:
    install_exiftool()
    expected = [(0.5 * k, 47.0 + 1e-4 * k, 500.0 + k) for k in range(6)]
    assert np.allclose(positions_of(read(tmp_path, camm(6))), expected, atol=1e-6)


def install_exiftool() -> None:
    if exiftool_reader.is_there():
        return
    if os.geteuid() or shutil.which("apt-get") is None:
        pytest.skip(f"{NO_PROGRAM} exiftool; sudo apt-get install {exiftool_reader.PACKAGE}")
    install([exiftool_reader.PACKAGE])


PARROT = b"application/octet-stream;type=com.parrot.videometadata3"


def parrot(
    lat_deg: float,
    drone_deg: tuple[float, float, float] = (5.0, -3.0, 40.0),
    view_deg: tuple[float, float, float] = (0.0, -60.0, 42.0),
    height_m: float = 501.25,
    width_deg: float = 69.0,
) -> bytes:
    """A sample of version 3, with an extension behind it."""
    fixed = [round(x * 2**22) for x in (lat_deg, 8.2)]
    quaternions = [round(x * 2**14) for angles in (drone_deg, (0.0, 0.0, 42.0), view_deg) for x in quaternion(angles)]
    base = struct.pack(">i2i", 80 << 16, *fixed) + struct.pack(">i", round(height_m * 256) << 8 | 14)
    base += struct.pack(">4h", *(round(x * 256) for x in (12.0, -3.0, 0.5, -1.0))) + struct.pack(">12h", *quaternions)
    base += struct.pack(">4H2HI4B", 512, 100, 2**14, 2**14, round(width_deg * 256), 40 * 256, 0, 200, 80, 3, 1)
    return struct.pack(">HH", 0x5033, len(base) // 4) + base + struct.pack(">HHQ", 0x4531, 2, 123)


def test_a_parrot_s_samples_belong_to_their_pictures(tmp_path: Path) -> None:
    samples = [parrot(47.0 + 1e-4 * k) for k in range(4)]
    log = read(tmp_path, mp4(b"mett", samples, [0.0, 0.5, 1.0, 1.5], about=PARROT))
    assert log.video_epoch_ns is not None and log.utc_sigma_s is None  # the container has no time of its own
    fixes = of(log, PositionFix)
    assert [fix.stamp_ns - log.video_epoch_ns for fix in fixes] == [k * 500_000_000 for k in range(4)]
    assert [fix.lat_deg for fix in fixes] == pytest.approx([47.0 + 1e-4 * k for k in range(4)], abs=2e-7)
    assert fixes[0].height_amsl_m == 501.25 and fixes[0].velocity_ned_m_s == (12.0, -3.0, 0.5)
    (attitude, *_), (gimbal, *_) = (of(log, kind) for kind in (Attitude, GimbalAttitude))
    assert gimbal.reference == "earth" and gimbal.is_of_camera
    assert attitude.q_ned_body == pytest.approx(quaternion((5.0, -3.0, 40.0)), abs=1e-4)
    assert gimbal.q_ref_gimbal == pytest.approx(quaternion((0.0, -60.0, 42.0)), abs=1e-4)
    assert [mm for _, mm in log.focal_mm] == [pytest.approx(18.0 / math.tan(math.radians(34.5)), rel=1e-3)]


def test_a_parrot_without_a_fix_or_with_half_a_sample_has_no_position_then(tmp_path: Path) -> None:
    known, below = parrot(47.0, height_m=-12.5), parrot(47.001)[:60]
    samples = [parrot(500.0), known, below, b"", bytes(80), parrot(47.002, drone_deg=(0.0, 0.0, 0.0))]
    log = read(tmp_path, mp4(b"mett", samples, [0.5 * k for k in range(6)], about=PARROT))
    fixes = of(log, PositionFix)
    assert [fix.height_amsl_m for fix in fixes] == [-12.5, 501.25]
    assert log.notes[0] == "1 of 3 samples have no position"


def test_a_damaged_container_is_refused_in_a_line(tmp_path: Path) -> None:
    whole = mp4(b"gpmd", [five(b"260601100000.000", 47.0)], [0.0])
    for at in range(0, whole.index(b"mdat"), 3):
        for value in (b"\0", b"\xff"):
            try:
                log = read(tmp_path, whole[:at] + 3 * value + whole[at + 3 :])
            except InputError as error:
                assert "\n" not in str(error)
            else:
                assert len(log.events) < 20
