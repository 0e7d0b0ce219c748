"""MISB's metadata in a transport stream; that of a whole flight is in `test_log_files`."""

import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from contract.errors import InputError
from contract.rotations import euler_from_matrix, matrix_from_quaternion
from onboard.events.types import GimbalAttitude, PositionFix
from onboard.telemetry.log_files import read_log
from onboard.telemetry.misb import Reader, Sample
from onboard.telemetry.read_options import ReadOptions
from onboard.telemetry.telemetry_log import TelemetryLog
from onboard.telemetry.transport_stream import has_metadata, metadata_of
from tests.onboard.telemetry import log_writers as w
from tests.onboard.telemetry.log_events import of

BEGAN_NS = round(w.T0_S * 1e9)


def sample(items: dict[int, bytes]) -> Sample:
    (only,) = Reader().samples(w.misb_set({2: bytes(8)} | items))
    return only


def read(tmp_path: Path, content: bytes, options: ReadOptions | None = None) -> TelemetryLog:
    (tmp_path / "video.ts").write_bytes(content)
    return read_log(tmp_path / "video.ts", options)


def stream(sets: dict[float, bytes], kind: int = 0x15, is_timed: bool = True) -> bytes:
    """A stream whose pictures are a tenth of a second apart, and each set behind the picture of its time."""
    out = w.PROGRAMMES + w.map_of_streams(0x1B, kind)
    for k in range(20):
        out += w.in_packets(w.VIDEO_PID, w.own_packet(0xE0, bytes(300), 0.1 * k))
        for time_s, content in sets.items():
            if round(10 * time_s) == k:
                out += w.metadata_packets(content, time_s if is_timed else None)
    return out


def test_values_are_mapped_as_the_standard_s_own_examples() -> None:
    items = {
        2: "00046050584e0180", 5: "71c2", 6: "fd3d", 7: "08b8", 13: "5595b66d", 14: "5b5360c4", 15: "c221",
        16: "cd9c", 18: "724a0a20", 19: "87f84b86",
    }  # fmt: skip
    found = sample({item: bytes.fromhex(value) for item, value in items.items()})
    assert found.stamp_ns == 1_231_798_102 * 10**9 and not found.is_utc
    values = {
        5: 159.9744, 6: -0.4315, 7: 3.4059, 13: 60.1768, 14: 128.4268, 15: 14190.7, 16: 144.571, 18: 160.719,
        19: -168.792,
    }  # fmt: skip
    assert found.values == pytest.approx(values, rel=1e-4)


def test_a_value_that_is_out_of_range_or_of_another_length_is_not_there() -> None:
    found = sample({13: b"\x80\0\0\0", 14: bytes(4), 6: b"\x80\0", 7: bytes(2), 5: bytes(4)})
    assert set(found.values) == {14, 7}
    assert found.row() == {}


def test_the_camera_is_turned_by_the_sensor_s_angles_against_the_aircraft() -> None:
    """Heading east and banked to the right by 20 degrees: 30 degrees below the right wing's plane looks at 50 to the
    south.
    """
    angles = {5: w.mapped(90.0, 0.0, 360.0, 2), 90: bytes(4), 91: w.mapped(20.0, -90.0, 90.0, 4)}
    angles |= {18: w.mapped(90.0, 0.0, 360.0, 4), 19: w.mapped(-30.0, -180.0, 180.0, 4)}
    row = sample(angles).row()
    roll, pitch, yaw = (row[f"gimbal_{name}_deg"] for name in ("roll", "pitch", "yaw"))
    assert [roll, pitch, yaw % 360.0] == pytest.approx([0.0, -50.0, 180.0], abs=0.01)


def test_what_a_sender_need_not_repeat_lasts_and_the_rest_does_not() -> None:
    reader = Reader()
    both = [
        next(reader.samples(w.misb_set({2: bytes(8)} | items)))
        for items in ({16: w.mapped(40.0, 0.0, 180.0, 2), 5: bytes(2)}, {7: bytes(2)})
    ]
    assert both[1].width_deg == pytest.approx(40.0, abs=0.01)
    assert 5 not in both[1].values


@pytest.mark.parametrize(("leap", "seconds", "sigma_s"), [(b"\x1b", 27, 0.0), (b"\xff", -1, 0.0), (None, 0, 29.0)])
def test_leap_seconds_make_it_utc_and_without_them_it_is_so_to_half_a_minute(
    tmp_path: Path, leap: bytes | None, seconds: int, sigma_s: float
) -> None:
    items = w.misb_items(w.Moment(0.0))
    del items[136]
    log = read(tmp_path, stream({0.0: w.misb_set(items | ({} if leap is None else {136: leap}))}))
    (fix,) = of(log, PositionFix)
    assert fix.stamp_ns == BEGAN_NS + seconds * 10**9 and log.utc_sigma_s == sigma_s


@pytest.mark.parametrize(("kind", "is_timed"), [(0x15, True), (0x06, True), (0x06, False)])
def test_the_beginning_of_the_video_is_that_of_its_first_picture(tmp_path: Path, kind: int, is_timed: bool) -> None:
    """Also where its clock begins again after 26.5 hours, and where each packet has a time before it (.m2ts)."""
    sets = {round(0.1 * k, 1): w.misb_set(w.misb_items(w.Moment(0.1 * k))) for k in range(3, 15)}
    plain = stream(sets, kind, is_timed)
    late = b"".join(bytes(4) + plain[k : k + 188] for k in range(0, len(plain), 188))
    for content in (plain, late, wrapped(plain)):
        log = read(tmp_path, content)
        assert log.video_began is not None
        assert abs(log.video_began[0] - BEGAN_NS) < 1e6 and log.video_began[1] == 0.5
        assert has_metadata(tmp_path / "video.ts")
        assert {packet.is_synchronous for packet in metadata_of(tmp_path / "video.ts")} == {is_timed}


def wrapped(content: bytes) -> bytes:
    """The same with times that begin again one second after the first picture."""
    out = bytearray(content)
    for at in range(0, len(out), 188):
        start = at + 4 + (1 + out[at + 4] if out[at + 3] & 0x20 else 0)
        if out[at + 1] & 0x40 and out[start : start + 3] == b"\0\0\1" and out[start + 7] & 0x80:
            a, b, c = out[start + 9], *struct.unpack_from(">HH", out, start + 10)
            pts = (a >> 1 & 7) << 30 | (b >> 1) << 15 | c >> 1
            out[start + 9 : start + 14] = w.ticks((pts - round(2.4 * 90_000)) % 2**33)
    return bytes(out)


def test_damaged_sets_are_left_out_and_counted(tmp_path: Path) -> None:
    sets = {0.1 * k: w.misb_set(w.misb_items(w.Moment(0.1 * k))) for k in range(10)}
    sets[0.5] = sets[0.5][:40] + bytes([sets[0.5][40] ^ 1]) + sets[0.5][41:]
    log = read(tmp_path, stream(sets))
    assert sum(isinstance(event, PositionFix) for event in log.events) == 9
    assert log.notes[0] == "1 of 10 sets of metadata are damaged and are not used"


def test_a_zoom_is_reported_and_the_steps_of_a_field_of_view_are_none(tmp_path: Path) -> None:
    widths = [60.0, 60.2, 60.0, 59.9, 40.0, 40.1]
    sets = {
        0.1 * k: w.misb_set(w.misb_items(w.Moment(0.1 * k)) | {16: w.mapped(width, 0.0, 180.0, 2)})
        for k, width in enumerate(widths)
    }
    focal_mm = read(tmp_path, stream(sets)).focal_mm
    assert [round((stamp - BEGAN_NS) / 1e8) for stamp, _ in focal_mm] == [0, 4]
    assert [mm for _, mm in focal_mm] == pytest.approx(
        [18.0 / np.tan(np.radians(a / 2)) for a in (60.0, 40.0)], rel=1e-3
    )


def test_heights_above_the_ellipsoid_take_the_undulation(tmp_path: Path) -> None:
    items = w.misb_items(w.Moment(0.0))
    items[75] = items.pop(15)
    content = stream({0.0: w.misb_set(items)})
    (fix,) = (e for e in read(tmp_path, content, ReadOptions(undulation_m=11.0)).events if isinstance(e, PositionFix))
    assert fix.height_amsl_m == pytest.approx(w.HOME_M + w.ABOVE_M - 11.0, abs=0.2)
    assert "set gps.undulation_m" in read(tmp_path, content).notes[-1]


def test_a_camera_that_looks_straight_down_is_read_so(tmp_path: Path) -> None:
    log = read(tmp_path, stream({0.0: w.misb_set(w.misb_items(w.Moment(0.0), (0.0, -89.9, 30.0)))}))
    (gimbal,) = of(log, GimbalAttitude)
    angles = np.degrees(euler_from_matrix(matrix_from_quaternion(gimbal.q_ref_gimbal)))
    assert angles[1] == pytest.approx(-89.9, abs=0.01)


@pytest.mark.parametrize(
    ("content", "printed"),
    [
        (stream({}), "no metadata that is known"),
        (stream({0.0: w.misb_set({3: b"Mission"})}), "no metadata that is known"),
        (stream({0.0: w.misb_set({2: bytes(8), 5: bytes(2)})}), "no position in it"),
        (w.PROGRAMMES * 30, "no metadata that is known"),
    ],
)
def test_a_stream_without_metadata_or_position_is_refused_in_a_line(
    tmp_path: Path, content: bytes, printed: str
) -> None:
    with pytest.raises(InputError, match=printed) as refused:
        read(tmp_path, content)
    assert "a transport stream" in str(refused.value) and "\n" not in str(refused.value)


@given(st.binary(max_size=300), st.integers(0, 200))
def test_whatever_stands_in_the_metadata_is_read_or_left_out(content: bytes, at: int) -> None:
    whole = w.misb_set(w.misb_items(w.Moment(1.0)))
    for data in (content, w.MISB_KEY + content, whole[:at] + content + whole[at:]):
        for found in Reader().samples(data):
            found.row()
