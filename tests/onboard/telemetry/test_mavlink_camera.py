"""A MAVLink camera component: a client of the standard asks, clicks and gets places with honest accuracies; whatever
else is sent to it gets no answer that was not asked for, and no command ever leaves it.
"""

import math
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from contract.answer import Ellipse, Fix, Place, Refusal
from contract.errors import ConfigError
from contract.feature_set import Status
from contract.locate import locate
from contract.mavlink_camera.clicks import CameraClicks
from contract.mavlink_camera.component import MAX_OUT, MavlinkCamera
from contract.mavlink_camera.end import Answered, Asked, Clicked, VideoClick, View
from contract.mavlink_camera.messages import CameraFacts, Stream, words_of
from contract.rotations import matrix_from_quaternion
from contract.track import Course, TrackReport, TrackState, Unseen
from onboard.config.schema import parse_config
from onboard.events.session_clock import SessionClock
from onboard.link.autopilot_radio import radio_bucket
from onboard.telemetry.factory import open_telemetry
from tests.onboard.link.ports import free_udp_port
from tests.onboard.telemetry.standard_client import GROUND, StandardClient, standard
from tests.onboard.tracks.flat_world import CAMERA, EPOCH_NS, PLACE, Thing, World, at

SPEED_M_S, DELAY_S, SIGMA_S = 8.0, 0.5, 0.3
CAR = Thing(at(24.0, 6.0))
WORLD = World((CAR,), camera=lambda t: (SPEED_M_S * t, 0.0))
SETS = [WORLD.its_set(number) for number in range(80)]
VIDEO = "rtsp://192.168.1.20:8554/video"
ACCEPTED, BUSY, DENIED, UNSUPPORTED, FAILED = 0, 1, 2, 3, 4


def facts(video: str | None = VIDEO, boot_ns: int = 0) -> CameraFacts:
    return CameraFacts(mavlink, "uav-1", CAMERA, 30.0, None if video is None else Stream.parse(video), boot_ns)


@contextmanager
def live(video: str | None = VIDEO, rate: float = 1e5) -> Iterator[tuple[StandardClient, SessionClock]]:
    """The telemetry of an aircraft that has been over the world for three seconds, and a ground station."""
    port = free_udp_port()
    config = parse_config(f'[telemetry]\nurl = "udpin:127.0.0.1:{port}"\nsystem = 1\n')
    clock = SessionClock(EPOCH_NS + 3_000_000_000 - time.monotonic_ns())
    clicks, stop = CameraClicks("uav-1", DELAY_S, SIGMA_S), threading.Event()
    for found in SETS:
        clicks.feature_set(found)
    share = radio_bucket(rate, time.monotonic())
    camera = MavlinkCamera(100, facts(video, clock.now_ns()), clicks, share)
    source = open_telemetry(config, clock, camera=camera)
    thread = threading.Thread(target=source.run, args=(lambda arrival_ns, event: None, stop))
    client = StandardClient(port)
    with clicks:
        thread.start()
        try:
            client.wait("HEARTBEAT")
            yield client, clock
        finally:
            stop.set()
            thread.join(5.0)
            client.close()


def test_a_client_of_the_standard_finds_the_camera_and_what_it_can_do() -> None:
    with live() as (client, _):
        beat = client.wait("HEARTBEAT")
        assert (beat.type, beat.autopilot) == (standard.MAV_TYPE_CAMERA, standard.MAV_AUTOPILOT_INVALID)
        for command in (
            (standard.MAV_CMD_REQUEST_MESSAGE, standard.MAVLINK_MSG_ID_CAMERA_INFORMATION),
            (standard.MAV_CMD_REQUEST_CAMERA_INFORMATION, 1),
        ):
            answer, since = client.command(*command)
            information = client.wait("CAMERA_INFORMATION", since)
            assert answer.result == ACCEPTED and bytes(information.vendor_name).startswith(b"pointclick\0")
            assert (information.resolution_h, information.resolution_v) == (CAMERA.width_px, CAMERA.height_px)
            can = standard.CAMERA_CAP_FLAGS_HAS_TRACKING_POINT | standard.CAMERA_CAP_FLAGS_HAS_VIDEO_STREAM
            assert information.flags == can | 2048 and not information.cam_definition_uri  # HAS_TRACKING_GEO_STATUS
        _, since = client.request(standard.MAVLINK_MSG_ID_VIDEO_STREAM_INFORMATION, 1)
        stream = client.wait("VIDEO_STREAM_INFORMATION", since)
        assert (stream.stream_id, stream.count, stream.type, stream.uri) == (1, 1, 0, VIDEO)
        assert client.wait("VIDEO_STREAM_STATUS", client.request(270)[1]).flags == 1
        assert math.isnan(client.wait("CAMERA_SETTINGS", client.request(260)[1]).zoomLevel)
        for refused in (standard.MAV_CMD_IMAGE_START_CAPTURE, standard.MAV_CMD_CAMERA_TRACK_RECTANGLE, 400, 176):
            assert client.command(refused, 1.0)[0].result == UNSUPPORTED
        assert client.request(standard.MAVLINK_MSG_ID_ATTITUDE)[0].result == DENIED
        assert client.request(269, 2.0)[0].result == DENIED  # there is one stream


def test_where_it_looks_is_the_newest_pictures_pose() -> None:
    with live(video=None) as (client, _):
        fov = client.wait("CAMERA_FOV_STATUS", client.request(271)[1])
        assert client.request(269)[0].result == DENIED  # no stream is configured
        expected = locate(SETS[-1], (159.5, 119.5))
        assert np.allclose([fov.lat_image, fov.lon_image], [expected.lat_deg * 1e7, expected.lon_deg * 1e7], atol=1.0)
        assert abs(fov.alt_camera / 1e3 - SETS[-1].camera_height_m) < 0.001
        hfov_deg = 2.0 * math.degrees(math.atan(0.5 * CAMERA.width_px / CAMERA.fx_px))
        assert abs(fov.hfov - hfov_deg) < 0.01
        # Straight down, the picture's top to the north: the optical axis (x) points down, the right (y) to the east.
        assert np.allclose(matrix_from_quaternion(fov.q), [[0, 0, -1], [0, 1, 0], [1, 0, 0]], atol=1e-6)


@pytest.mark.wall_clock(waits=True)
def test_a_click_gets_the_place_of_what_was_shown_with_the_delay_in_its_accuracy() -> None:
    with live() as (client, clock):
        late_s = DELAY_S + 1.2 * SIGMA_S  # of this video
        shown_s = (clock.now_ns() - EPOCH_NS) / 1e9 - late_s
        u, v = WORLD.pixel(CAR, 0) - [SPEED_M_S * shown_s / 0.2, 0.0]  # at 0.2 m a pixel
        share = (u + 0.5) / CAMERA.width_px, (v + 0.5) / CAMERA.height_px
        answer, since = client.command(standard.MAV_CMD_CAMERA_TRACK_POINT, *share, 0.02)
        geo = client.wait("CAMERA_TRACKING_GEO_STATUS", since)
        east_m, north_m, up_m = PLACE.to_enu(geo.lat * 1e-7, geo.lon * 1e-7, geo.alt)
        client.wait("STATUSTEXT", since)
    assert answer.result == ACCEPTED
    error_m = np.array([east_m, north_m]) - CAR.place(0.0)
    # The pose is off by 0.8 and -0.5 m; the picture was taken 1.2 sigmas earlier than the mean.
    assert abs(error_m[0] - 0.8 - 1.2 * SIGMA_S * SPEED_M_S) < 1.0 and abs(error_m[1] + 0.5) < 0.1
    stated_m = 2.146 * math.hypot(SPEED_M_S * SIGMA_S, 1.0)
    assert np.linalg.norm(error_m) < geo.h_acc and 0.95 < geo.h_acc / stated_m < 1.1
    assert abs(up_m) < 0.1 < geo.v_acc < 3.0 and 60.0 < geo.dist < 80.0
    assert all(math.isnan(unknown) for unknown in (geo.vel_n, geo.vel_e, geo.vel_d, geo.hdg, geo.hdg_acc))
    assert f"+-{math.ceil(geo.h_acc)} m" in client.texts()


def test_a_click_that_has_no_answer_is_refused_in_words() -> None:
    with live() as (client, _):
        for point in ((1.2, 0.5), (math.nan, 0.5), (0.5, -math.inf)):
            assert client.command(standard.MAV_CMD_CAMERA_TRACK_POINT, *point)[0].result == DENIED
        assert client.command(standard.MAV_CMD_CAMERA_TRACK_POINT, 0.5, 0.5, 0.0, 101.0)[0].result == DENIED
        client.wait("STATUSTEXT")
        assert "CAMERA_TRACKING_GEO_STATUS" not in {m.get_type() for _, m in client.got}
    assert "off the picture" in client.texts()


# --- without a wire ---


class End:
    def __init__(self, answer: Fix | Refusal | None = None) -> None:
        self.answer, self.asked, self.stopped = answer, list[Asked](), 0
        self._ready: list[Answered] = []
        self.is_following = False

    def ask(self, asked: Asked) -> bool:
        self.asked.append(asked)
        if len(self.asked) > 100:
            return False
        if isinstance(asked, VideoClick) and self.answer is not None:
            self._ready.append(Clicked(asked.number, self.answer, self.is_following))
        elif not isinstance(asked, VideoClick):
            self._ready.append(View(asked.number, SETS[0], locate(SETS[0], (159.5, 119.5))))
        return True

    def answers(self) -> list[Answered]:
        out, self._ready = self._ready, []
        return out

    def stop(self) -> None:
        self.stopped += 1

    def followed(self) -> None:
        return None


class Virtual:
    """A camera without a wire: `now_s` is the clock."""

    def __init__(self, answer: Fix | Refusal | None = None, rate: float = 1e6) -> None:
        self.end, self.now_s = End(answer), 0.0
        share = radio_bucket(rate, 0.0)
        self.camera = MavlinkCamera(100, facts(), self.end, share, monotonic_s=lambda: self.now_s)

    def send(self, message: Any, system: int = GROUND[0], component: int = GROUND[1]) -> None:
        packet = message.pack(mavlink.MAVLink(None, system, component))
        (found,) = mavlink.MAVLink(None).parse_buffer(packet)
        self.camera.receive(found, 1, round(self.now_s * 1e9))

    def click(self, u: float, v: float, again: int = 0, component: int = 100) -> None:
        self.send(mavlink.MAVLink_command_long_message(1, component, 2004, again, u, v, 0, 0, 0, 0, 0))

    def due(self) -> list[Any]:
        return [m for m in self.camera.due(round(self.now_s * 1e9)) if m.get_type() != "HEARTBEAT"]

    def results(self) -> list[int]:
        return [m.result for m in self.due() if m.get_type() == "COMMAND_ACK"]


GEO = "CAMERA_TRACKING_GEO_STATUS"
FIX = locate(SETS[10], (160.0, 120.0))


@pytest.mark.parametrize(
    ("status", "result"),
    [(Status.ABOVE_HORIZON, FAILED), (Status.OUTSIDE, FAILED), (Status.TURNING, BUSY), (Status.STARTING, BUSY)],
)
def test_the_result_states_whether_a_later_click_may_succeed(status: Status, result: int) -> None:
    virtual = Virtual(Refusal(status))
    virtual.click(0.5, 0.5)
    assert virtual.results() == [result]
    virtual.now_s = 1.0
    assert virtual.results() == [] and len(virtual.end.asked) == 1


@pytest.mark.parametrize(("is_followed", "ends"), [(False, "refused"), (True, "lost"), (True, "never reported")])
def test_a_place_is_stated_only_as_long_as_what_was_clicked_is_there(is_followed: bool, ends: str) -> None:
    """What was followed has left where it was clicked; a refused click has no place, least of all the last one's."""
    virtual = Virtual(FIX)
    virtual.end.is_following = is_followed
    virtual.click(0.5, 0.5)
    assert [m.tracking_status for m in virtual.due() if m.get_type() == GEO] == [int(is_followed)]
    virtual.send(mavlink.MAVLink_command_long_message(1, 100, 512, 0, 276, 0, 0, 0, 0, 0, 0))
    assert [m.tracking_status for m in virtual.due() if m.get_type() == GEO] == [int(is_followed)]
    if is_followed:
        virtual.end.is_following = ends == "never reported"
        virtual.now_s += 1.1 if ends == "never reported" else 0.0
    else:
        virtual.end.answer = Refusal(Status.TURNING)
        virtual.click(0.4, 0.5)
        virtual.due()
    virtual.send(mavlink.MAVLink_command_long_message(1, 100, 512, 0, 276, 0, 0, 0, 0, 0, 0))
    sent = virtual.due()
    assert [m.result for m in sent if m.get_type() == "COMMAND_ACK"] == [BUSY] and GEO not in {
        m.get_type() for m in sent
    }


def test_a_text_states_no_radius_below_the_ellipse() -> None:
    assert isinstance(FIX, Fix)
    small = replace(FIX, ellipse=Ellipse(0.4, 0.3, 0.0))
    assert "+-1 m" in words_of(small)


def test_a_click_that_is_sent_again_is_one_click() -> None:
    virtual = Virtual(None)
    virtual.click(0.5, 0.5)
    virtual.click(0.5, 0.5, again=1)
    assert virtual.results() == [mavlink.MAV_RESULT_IN_PROGRESS] and len(virtual.end.asked) == 1
    answered = Virtual(FIX)
    answered.click(0.5, 0.5)
    assert answered.results() == [ACCEPTED]
    answered.click(0.5, 0.5, again=1)
    assert answered.results() == [ACCEPTED] and len(answered.end.asked) == 1
    answered.click(0.5, 0.5)
    assert answered.results() == [ACCEPTED] and len(answered.end.asked) == 2


def test_a_click_of_which_only_the_repetition_comes_is_refused_for_its_moment_is_not_known() -> None:
    """A station sends again after seconds, in which the aircraft has moved by more than any ellipse states."""
    virtual = Virtual(FIX)
    virtual.click(0.3, 0.5, again=1)
    sent = virtual.due()
    assert [m.result for m in sent if m.get_type() == "COMMAND_ACK"] == [BUSY] and not virtual.end.asked
    assert any("click again" in str(m.text) for m in sent if m.get_type() == "STATUSTEXT")
    virtual.click(0.3, 0.5)
    assert virtual.results() == [ACCEPTED] and len(virtual.end.asked) == 1


def test_a_stop_cancels_the_clicks_that_are_under_way() -> None:
    """They were answered, and followed, after it."""
    virtual = Virtual(None)
    virtual.click(0.5, 0.5)
    virtual.send(mavlink.MAVLink_command_long_message(1, 100, 2010, 0, 0, 0, 0, 0, 0, 0, 0))
    assert [(m.command, m.result) for m in virtual.due()] == [(2004, 6), (2010, ACCEPTED)]
    assert virtual.end.stopped == 1 and isinstance(FIX, Fix)
    virtual.end.answers = lambda: [Clicked(1, FIX)]
    assert not virtual.due()  # an answer that comes later is none any more
    virtual.send(mavlink.MAVLink_command_long_message(1, 100, 512, 0, 276, 0, 0, 0, 0, 0, 0))
    assert [m.result for m in virtual.due()] == [BUSY]


def test_a_question_that_no_one_answers_is_given_up_in_the_end() -> None:
    virtual = Virtual(None)
    virtual.click(0.5, 0.5)
    virtual.now_s = 6.0
    assert virtual.results() == [BUSY]


def test_what_is_for_others_is_not_answered_and_a_second_camera_of_the_number_ends_all_answers() -> None:
    virtual = Virtual(FIX)
    for system, component in ((1, 1), (1, 101), (2, 100), (0, 0)):
        virtual.send(mavlink.MAVLink_command_long_message(system, component, 2004, 0, 0.5, 0.5, 0, 0, 0, 0, 0))
    virtual.send(mavlink.MAVLink_command_long_message(1, 0, 400, 0, 1, 0, 0, 0, 0, 0, 0))  # to all: arm
    virtual.send(mavlink.MAVLink_command_long_message(1, 0, 512, 0, 148, 0, 0, 0, 0, 0, 0))  # to all: your version
    assert not virtual.due() and not virtual.end.asked
    virtual.click(0.5, 0.5, component=0)  # to all cameras
    assert virtual.results() == [ACCEPTED]
    virtual.send(mavlink.MAVLink_heartbeat_message(30, 8, 0, 0, 4, 3), 1, 100)
    virtual.click(0.4, 0.4)
    assert not virtual.camera.due(2_000_000_000) and "component 100" in virtual.camera.complaint(2_000_000_000)
    assert not virtual.camera.complaint(11_000_000_000)


def test_intervals_are_kept_and_ended_as_asked() -> None:
    virtual = Virtual(FIX)
    interval = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL

    def ask(message: int, interval_us: float) -> int:
        virtual.send(mavlink.MAVLink_command_long_message(1, 100, interval, 0, message, interval_us, 0, 0, 0, 0, 0))
        (result,) = virtual.results()
        return result

    assert [ask(275, 5e5), ask(276, 5e5), ask(271, 1e6)] == [ACCEPTED] * 3
    assert [ask(276, 10.0), ask(30, 5e5), ask(276, math.nan)] == [DENIED] * 3
    virtual.click(0.5, 0.5)
    sent: list[str] = []
    for step in range(1, 41):
        virtual.now_s = 0.1 * step
        sent += [m.get_type() for m in virtual.due()]
    # The answer and eight of four seconds; of the picture nothing, since nothing is followed.
    assert sent.count("CAMERA_TRACKING_GEO_STATUS") == 9 and "CAMERA_TRACKING_IMAGE_STATUS" not in sent
    assert sent.count("CAMERA_FOV_STATUS") == 3  # the fourth is asked for
    assert [ask(276, -1.0), ask(271, 0.0)] == [ACCEPTED] * 2
    virtual.now_s = 9.0
    assert not virtual.due()


def test_views_in_intervals_wait_for_one_another_and_leave_the_queue_to_clicks() -> None:
    virtual = Virtual(None)
    virtual.end.answers = lambda: []
    virtual.send(mavlink.MAVLink_command_long_message(1, 100, 511, 0, 271, 1e5, 0, 0, 0, 0, 0))
    for step in range(1, 30):
        virtual.now_s = 0.1 * step
        virtual.due()
    assert len(virtual.end.asked) == 1


@given(
    st.lists(st.floats(allow_nan=True, allow_infinity=True), min_size=6, max_size=6),
    st.floats() | st.none(),
    st.floats(-1e9, 1e9),
)
def test_whatever_was_estimated_has_a_place_on_the_wire(
    values: list[float], height_m: float | None, pixel: float
) -> None:
    lat, lon, major, sigma, speed, sigma_speed = values
    place = Place(lat, lon, height_m, None, Ellipse(major, major, 0.0), sigma)
    course = Course(speed, sigma_speed, 30.0, 1.0)
    report = TrackReport(1, TrackState.FOLLOWED, Unseen.NONE, 1, 1, 0, pixel, pixel, 1.0, Status.OK, place, course)
    fov = facts().fov_status(replace(SETS[0], camera_lat_deg=lat, camera_height_m=major), Refusal(Status.OUTSIDE), 0)
    for message in (facts().geo_of_track(report), facts().image_status(report), fov):
        message.pack(mavlink.MAVLink(None, 1, 100))


@pytest.mark.parametrize("rate", [800.0, 4800.0])
def test_a_flood_keeps_below_the_bit_rate_and_waits_in_a_bounded_queue(rate: float) -> None:
    virtual, sent = Virtual(FIX, rate), 0
    for step in range(300):
        virtual.now_s = 0.1 * step
        for number in range(8):
            virtual.click(number / 8.0, step / 300.0)
        packets = virtual.camera.due(round(virtual.now_s * 1e9))
        sent += sum(len(packet.pack(mavlink.MAVLink(None, 1, 100))) for packet in packets)
    assert 0.8 * 30.0 * rate / 8.0 < sent < 30.5 * rate / 8.0 + 300
    assert len(virtual.camera._acknowledgements) <= MAX_OUT


REALS = st.floats(width=32)
FIELDS = st.tuples(st.integers(0, 255), st.integers(0, 255), st.sampled_from([*range(2004, 2011), 511, 512, 521, 2504]))
COMMANDS = st.one_of(
    st.builds(
        lambda to, again, values: mavlink.MAVLink_command_long_message(*to, again, *values),
        FIELDS | st.tuples(st.just(1), st.sampled_from([0, 100]), st.integers(0, 65535)),
        st.integers(0, 255),
        st.lists(REALS | st.sampled_from([0.0, 1.0, 259.0, 271.0, 275.0, 276.0]), min_size=7, max_size=7),
    ),
    st.builds(
        lambda to, values, whole: mavlink.MAVLink_command_int_message(*to[:2], 0, to[2], 0, 0, *values, *whole, 0.0),
        FIELDS,
        st.lists(REALS, min_size=4, max_size=4),
        st.tuples(*[st.integers(-(2**31), 2**31 - 1)] * 2),
    ),
)
MAY_LEAVE = {
    "COMMAND_ACK", "STATUSTEXT", "CAMERA_INFORMATION", "CAMERA_SETTINGS", "CAMERA_FOV_STATUS", "VIDEO_STREAM_STATUS",
    "VIDEO_STREAM_INFORMATION", "CAMERA_TRACKING_IMAGE_STATUS", "CAMERA_TRACKING_GEO_STATUS",
}  # fmt: skip


@given(st.lists(COMMANDS, max_size=12), st.booleans(), st.binary(max_size=60))
def test_whatever_comes_there_is_one_answer_to_what_was_asked_and_no_command(
    commands: list[Any], is_answered: bool, junk: bytes
) -> None:
    virtual = Virtual(FIX if is_answered else Refusal(Status.NO_GPS))
    parser = mavlink.MAVLink(None)
    parser.robust_parsing = True
    for message in parser.parse_buffer(junk) or []:
        virtual.camera.receive(message, 1, 0)
    for message in commands:
        virtual.send(message)
    out = virtual.due()
    for step in range(1, 20):
        virtual.now_s = 0.5 * step
        out += [m for m in virtual.due() if m.get_type() not in ("CAMERA_TRACKING_GEO_STATUS", "CAMERA_FOV_STATUS")]
    asked = [m.command for m in commands if m.target_system == 1 and m.target_component in (0, 100)]
    answers = [m for m in out if m.get_type() == "COMMAND_ACK"]
    assert all((m.target_system, m.target_component) == GROUND for m in answers)
    assert len(answers) <= len(asked) and {m.command for m in answers} <= set(asked)
    addressed = [m.command for m in commands if (m.target_system, m.target_component) == (1, 100)]
    assert len(answers) >= len(addressed)
    assert {m.get_type() for m in out} <= MAY_LEAVE
    assert out == [] or asked
    for message in out:
        message.pack(mavlink.MAVLink(None, 1, 100))


@pytest.mark.parametrize(
    ("text", "kind", "encoding", "uri"),
    [
        ("rtsp://10.0.0.2:554/live", 0, 0, "rtsp://10.0.0.2:554/live"),
        ("tcp://10.0.0.2:5000", 2, 0, "tcp://10.0.0.2:5000"),
        ("h264:5600", 1, 1, "5600"),
        ("h265:5600", 1, 2, "5600"),
        ("mpegts:1234", 3, 0, "1234"),
    ],
)
def test_a_video_is_named_as_the_standard_has_it(text: str, kind: int, encoding: int, uri: str) -> None:
    assert Stream.parse(text) == Stream(kind, encoding, uri)


@pytest.mark.parametrize(
    ("telemetry", "words"),
    [
        ('url = "nmea:/dev/null:9600"', "live autopilot"),
        ('backend = "mavsdk"', "pymavlink"),
        ("component = 100", "two numbers"),
    ],
)
def test_where_no_camera_can_be_it_is_refused_at_the_start(telemetry: str, words: str) -> None:
    config = parse_config(f"[telemetry]\n{telemetry}\n")
    camera = MavlinkCamera(100, facts(), End(), radio_bucket(4800.0, 0.0))
    with pytest.raises(ConfigError, match=words):
        open_telemetry(config, SessionClock.start(), camera=camera)
