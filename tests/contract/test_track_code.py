"""Reports of tracks: at most 60 bytes, read back, golden, and never anything but a WireError."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from contract.answer import Ellipse, Place
from contract.errors import InputError
from contract.feature_set import Status
from contract.track import (
    Course,
    ListTracks,
    StartTrack,
    StopTrack,
    TrackReport,
    TrackState,
    Unseen,
    parameters_of,
    read_request,
)
from contract.wire.track_code import MAX_TRACK_BYTES, decode_track, decode_tracks, encode_track

REPORT = TrackReport(
    3, TrackState.COASTING, Unseen.HIDDEN, 1_700_000_000, 1234, 1_700_000_000_123_450_000, 320.0, 119.5, 22.5,
    Status.OK,
    Place(-43.123456789, 172.987654321, 113.444, 123.456, Ellipse(2.5, 1.5, 30.0), 3.0),
    Course(14.98, 0.21, 271.4, 1.3), "uav-1",
)  # fmt: skip
GOLDEN = (
    "1103110f0000f15365d204000039d09c359d9a040ac0035aeb44a4f5f5b120de462824bb01001c2700dcb988b6ab2a0cbbda05bca9ffc0ed00"
)

PLACES = st.builds(
    Place, st.floats(-90.0, 90.0), st.floats(-180.0, 180.0), st.none() | st.floats(-500.0, 9000.0), st.none(),
    st.builds(Ellipse, st.floats(0.01, 5000.0), st.floats(0.01, 5000.0), st.floats(0.0, 179.99)),
    st.floats(0.01, 500.0),
)  # fmt: skip
COURSES = st.builds(Course, st.floats(0.0, 600.0), st.floats(0.0, 1e4)) | st.builds(
    Course, st.floats(0.0, 600.0), st.floats(0.0, 1e4), st.floats(0.0, 359.99), st.floats(0.0, 180.0)
)
REPORTS = st.builds(
    TrackReport, st.integers(0, 255), st.sampled_from(TrackState), st.sampled_from(Unseen), st.integers(0, 2**32 - 1),
    st.integers(0, 2**32 - 1), st.integers(0, 2**60), st.floats(-100.0, 9000.0), st.floats(-100.0, 9000.0),
    st.floats(0.0, 100.0), st.sampled_from(Status), st.none() | PLACES, st.none() | COURSES,
)  # fmt: skip


@given(REPORTS)
def test_a_report_is_read_back_from_60_bytes_or_fewer(report: TrackReport) -> None:
    payload = encode_track(report)
    assert 24 <= len(payload) <= MAX_TRACK_BYTES
    found = decode_track(payload)
    assert (found.number, found.state, found.unseen, found.status) == (
        report.number, report.state, report.unseen, report.status,
    )  # fmt: skip
    assert (found.session, found.frame) == (report.session, report.frame)
    assert abs(found.capture_unix_ns - report.capture_unix_ns) <= 10_000
    assert (found.place is None) == (report.place is None) and (found.course is None) == (report.course is None)
    if found.place is not None and report.place is not None:
        p, q = found.place, report.place
        assert abs(p.lat_deg - q.lat_deg) <= 1e-9 and abs(p.lon_deg - q.lon_deg) <= 1e-9
        assert (p.height_amsl_m is None) == (q.height_amsl_m is None)
        assert p.ellipse.semi_major_m == pytest.approx(q.ellipse.semi_major_m, rel=4e-4)
    if found.course is not None and report.course is not None:
        c, d = found.course, report.course
        assert abs(c.speed_m_s - d.speed_m_s) <= 0.0051 and c.is_moving == d.is_moving
        if c.course_deg is not None and d.course_deg is not None:
            assert min(abs(c.course_deg - d.course_deg), 360.0 - abs(c.course_deg - d.course_deg)) <= 0.003
    assert encode_track(found) == payload  # rounding happens once


@given(REPORTS, st.floats(0.0, 60.0))
def test_the_age_of_the_last_look_takes_a_byte_where_there_is_one(report: TrackReport, unseen_s: float) -> None:
    aged = replace(report, unseen_s=unseen_s)
    payload = encode_track(aged)
    found = decode_track(payload)
    assert found.unseen_s == pytest.approx(min(unseen_s, 25.5), abs=0.051) and encode_track(found) == payload
    assert len(payload) - len(encode_track(report)) == (found.unseen_s > 0.0) and len(payload) <= MAX_TRACK_BYTES


def test_the_bytes_are_those_of_the_document() -> None:
    b = encode_track(REPORT)
    assert len(b) == 57
    assert (b[0], b[1], b[2], b[3], b[4]) == (0x11, 3, 0x11, 0x0F, 0)
    assert int.from_bytes(b[5:9], "little") == 1_700_000_000 and int.from_bytes(b[9:13], "little") == 1234
    assert int.from_bytes(b[13:19], "little") == 170_000_000_012_345
    assert int.from_bytes(b[19:21], "little") == 2564 and int.from_bytes(b[21:23], "little") == 960 and b[23] == 90
    assert int.from_bytes(b[24:29], "little", signed=True) == -43_123_456_789
    assert int.from_bytes(b[29:34], "little", signed=True) == 172_987_654_321
    assert int.from_bytes(b[34:38], "little") == 113_444 and int.from_bytes(b[38:41], "little") == 10_012
    assert int.from_bytes(b[45:47], "little") == round(30.0 * 65536 / 180)
    assert int.from_bytes(b[49:51], "little") == 1498
    assert int.from_bytes(b[53:55], "little") == round(271.4 * 65536 / 360)
    assert int.from_bytes(b[55:57], "little") == round(1.3 * 65536 / 360)


def test_golden_bytes() -> None:
    assert encode_track(REPORT).hex() == GOLDEN
    assert decode_track(bytes.fromhex(GOLDEN), "uav-1").to_text() == REPORT.to_text()


@given(st.lists(REPORTS, max_size=8))
def test_a_message_is_reports_one_after_the_other(reports: list[TrackReport]) -> None:
    payload = b"".join(encode_track(report) for report in reports)
    assert [report.number for report in decode_tracks(payload)] == [report.number for report in reports]


REQUESTS = (
    st.builds(ListTracks)
    | st.builds(StopTrack, st.integers(0, 255))
    | st.builds(StartTrack, st.floats(-0.5, 8190.0), st.floats(-0.5, 8190.0), st.none() | st.integers(0, 2**32 - 1))
)


@given(REQUESTS)
def test_a_request_is_read_back(request: ListTracks | StopTrack | StartTrack) -> None:
    assert read_request(parameters_of(request)) == request


@given(st.text(max_size=300) | st.text(alphabet="uvframestop=;0123456789.-einf", max_size=60))
def test_any_text_is_a_request_or_an_input_error(text: str) -> None:
    try:
        found = read_request(text)
    except InputError as error:
        assert "\n" not in str(error)
        return
    assert isinstance(found, ListTracks | StopTrack | StartTrack)


@pytest.mark.parametrize(
    "text",
    ["u=1", "u=nan;v=1", "u=1;v=inf", "u=-3;v=1", "u=1;v=2;frame=-1", "u=1;v=2;frame=x", "stop=256", "stop=",
     "u=1;u=2;v=1", "u=1;v=2;size=9", "frame=1", "u=9e9;v=1", "x" * 201],
)  # fmt: skip
def test_what_is_no_request_is_refused(text: str) -> None:
    with pytest.raises(InputError):
        read_request(text)
