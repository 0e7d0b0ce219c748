"""Our helper with the real GStreamer: RTSP from a real server, any pipeline; and what it reports where it cannot."""

from __future__ import annotations

import ctypes
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from contract.errors import ConfigError
from contract.secrets import without_secrets
from onboard.camera import helper_launch as launching
from onboard.camera.frame_protocol import FrameReader, Header, Origin
from onboard.camera.gstreamer_helper import (
    HEALED_NS,
    MISB,
    Hopeless,
    Player,
    Stamps,
    Whole,
    nal_units,
    precision_time_ns,
)
from onboard.camera.helper_launch import (
    HELPER,
    SYSTEM_PYTHON,
    decoders_text,
    helper_launch,
    libcamera_names,
    unable,
)  # fmt: skip
from onboard.config.schema import CameraConfig
from onboard.events.session_clock import SessionClock
from onboard.events.source import SourceStatus, State
from tests.onboard.camera import test_helper_camera
from tests.onboard.camera.test_helper_camera import BACK_S, CLOCK, REPORTED_S, Running, running
from tests.onboard.link.ports import free_port
from tests.rest_long import rest_long
from tests.rtsp import RtspServer, drifting_ground, number_of
from tests.rtsp_times import escaped, sei_unit
from tests.waiting import PATIENCE_S, eventually

SIZE_PX = (320, 240)
RATE_HZ = 30.0
DELAY_S, JITTER_S = 0.15, 0.03
START_S = PATIENCE_S  # of GStreamer, a connection, an encoder, a key frame and the least delay


@pytest.fixture(scope="module")
def pictures() -> list[np.ndarray]:
    return drifting_ground(300, SIZE_PX)


def off_ms(camera: Running, captured_ns: dict[int, int], after: int = 0) -> np.ndarray:
    """How far stamps lie behind the true capture times, by the numbers in the pictures."""
    rows = [
        (frame.stamp_ns - CLOCK.offset_ns - captured_ns[number_of(frame.image)]) / 1e6
        for _, frame in camera.frames[after:]
        if frame.image is not None
    ]
    return np.array(rows)


def one_stream(
    serving: Callable[[], RtspServer], scheme: str, count: int, words: str, **keys: object
) -> tuple[Running, SourceStatus, dict[int, int]]:
    """So many pictures and more of one connection, none lost; another where the machine stood still until some were."""
    for _ in range(3):
        with serving() as server, running(server.url(scheme), size_px=SIZE_PX, **keys) as camera:
            camera.wait_for_pictures(count, START_S)
            health = camera.wait_for(State.OK, words, START_S)
            camera.stop.set()
            camera.thread.join(PATIENCE_S)
            clients = server.stop()
        if len(clients) == 1 and health.figures["damaged"] == 0:
            return camera, health, clients[0]
    raise AssertionError(f"{len(clients)} connections in the time of one, {health.figures['damaged']} pictures damaged")


@pytest.mark.wall_clock(waits=True)
@pytest.mark.usefixtures("gstreamer")
@pytest.mark.parametrize(
    ("scheme", "keys", "origin"),
    rest_long(
        [
            ("rtspt", {"codec": "H264"}, "time stamps of the stream"),
            ("rtspu", {"codec": "H264", "sei": True, "sei_ahead_s": 7.0}, "capture times in the video (MISB 0604)"),
            ("rtspu", {"codec": "H265", "sei": True, "sei_ahead_s": -3.0}, "capture times in the video (MISB 0604)"),
        ],
        2,
    ),
)
def test_stamps_of_a_stream_lack_its_jitter_and_keep_its_least_delay(
    tmp_path: Path, pictures: list[np.ndarray], scheme: str, keys: dict[str, object], origin: str
) -> None:
    serving = partial(RtspServer, tmp_path, pictures, RATE_HZ, delay_s=DELAY_S, jitter_s=JITTER_S, **keys)
    camera, health, captured_ns = one_stream(serving, scheme, 60, f"320x240, {origin}", latency_s=0.0)
    late_ms = off_ms(camera, captured_ns)
    waited_ms = np.array([(at_ns - frame.stamp_ns) / 1e6 for at_ns, frame in camera.frames if frame.image is not None])
    # Arrivals jitter by 60 ms and by what a busy machine adds or evens out: what is stated is how they came.
    usual_ms = np.mean([np.mean(some) - np.min(some) for some in np.array_split(waited_ms, len(waited_ms) // 30)])
    assert 0.3 * usual_ms - 1.0 < health.figures["stamp_sigma_ms"] < 20.0 + 1.5 * np.max(waited_ms)
    # Stamps differ by nothing but how the least delay is found ever better.
    assert np.ptp(late_ms[len(late_ms) // 2 :]) < 20.0 and np.ptp(late_ms) < 2e3 * JITTER_S
    assert np.median(np.abs(np.diff(late_ms))) < 0.5
    assert 1e3 * (DELAY_S - JITTER_S) - 5.0 < late_ms[-1] < max(1e3 * DELAY_S + 40.0, min(late_ms + waited_ms) + 10.0)


@pytest.mark.wall_clock(waits=True)
@pytest.mark.usefixtures("gstreamer")
@pytest.mark.parametrize("codec", rest_long(["H264", "H265"]))
def test_behind_lost_packets_no_picture_bears_the_capture_time_of_another(
    tmp_path: Path, pictures: list[np.ndarray], codec: str
) -> None:
    """A picture whose end is lost and the next one come as one, with the times of both."""
    keys = {"codec": codec, "sei": True, "loss": 0.03}
    with (
        RtspServer(tmp_path, pictures, RATE_HZ, delay_s=DELAY_S, **keys) as server,
        running(server.url("rtspu"), size_px=SIZE_PX, latency_s=0.0) as camera,
    ):
        camera.wait_for_pictures(60, START_S)
        health = camera.source.health()
        camera.stop.set()
        camera.thread.join(PATIENCE_S)
        (captured_ns,) = server.stop()
    again_ms = 1e3 * len(pictures) / RATE_HZ
    late_ms = (off_ms(camera, captured_ns) + 0.5 * again_ms) % again_ms
    assert np.ptp(late_ms) < 20.0  # pictures are 33 ms apart
    assert health.figures["damaged"] > 20


@pytest.mark.wall_clock(waits=True)
@pytest.mark.usefixtures("gstreamer")
@pytest.mark.parametrize("bit_rate", rest_long([300_000, 2_000_000]))
def test_repeats_in_a_compressed_stream_have_no_image(
    tmp_path: Path, pictures: list[np.ndarray], bit_rate: int
) -> None:
    """A camera of 15 Hz in a stream of 30: each picture comes twice, the second time compressed again."""
    twice = [picture for picture in pictures for _ in range(2)]
    serving = partial(RtspServer, tmp_path, twice, RATE_HZ, bit_rate=bit_rate)
    camera, health, _ = one_stream(serving, "rtspt", 60, "320x240", frozen_after_s=30.0)
    figures = health.figures
    handed_out = [number_of(frame.image) for _, frame in camera.frames[15:] if frame.image is not None]
    seen = set(handed_out)
    assert len(seen) >= 0.95 * (max(seen) - min(seen) + 1)  # hardly any picture is lost for it
    assert len(handed_out) < 1.25 * len(seen) and figures["repeated"] > 0.35 * figures["pictures"]


@pytest.mark.wall_clock(waits=True)
@pytest.mark.usefixtures("gstreamer")
def test_a_server_that_goes_and_comes_back(tmp_path: Path, pictures: list[np.ndarray]) -> None:
    port = free_port()
    with (
        RtspServer(tmp_path, pictures, RATE_HZ, port=port) as server,
        running(server.url(), size_px=SIZE_PX) as camera,
    ):
        camera.wait_for_pictures(10, START_S)
        server.stop()
        camera.wait_for(State.LOST, "", REPORTED_S)
        with RtspServer(tmp_path, pictures, RATE_HZ, port=port):
            camera.wait_for_pictures(5, BACK_S + camera.start_s)
            camera.wait_for(State.OK, "", START_S)


@pytest.mark.wall_clock(waits=True)
@pytest.mark.usefixtures("gstreamer")
def test_a_decoder_that_is_killed_takes_nothing_with_it(tmp_path: Path, pictures: list[np.ndarray]) -> None:
    with RtspServer(tmp_path, pictures, RATE_HZ) as server, running(server.url(), size_px=SIZE_PX) as camera:
        camera.wait_for_pictures(10, START_S)
        assert test_helper_camera.shared_memory(test_helper_camera.group_of(camera)) == []
        os.kill(test_helper_camera.group_of(camera), signal.SIGKILL)
        camera.wait_for(State.LOST, "ended by SIGKILL", REPORTED_S)
        camera.wait_for_pictures(5, BACK_S + camera.start_s)


@pytest.mark.usefixtures("gstreamer")
def test_a_trusted_utc_gives_the_capture_time_itself(
    tmp_path: Path, pictures: list[np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    ours = SessionClock.start()
    monkeypatch.setattr(test_helper_camera, "CLOCK", ours)
    serving = partial(RtspServer, tmp_path, pictures, RATE_HZ, delay_s=DELAY_S, jitter_s=JITTER_S, sei=True)
    words = "the sender's UTC, taken for ours"
    camera, _, captured_ns = one_stream(serving, "rtsp", 30, words, stream_clock="utc")
    late_ms = [
        (frame.stamp_ns - ours.offset_ns - captured_ns[number_of(frame.image)]) / 1e6
        for _, frame in camera.frames
        if frame.image is not None
    ]
    assert np.abs(late_ms).max() < 2.0


@pytest.mark.usefixtures("gstreamer")
def test_a_utc_that_is_off_gives_no_picture_and_says_by_how_much(tmp_path: Path, pictures: list[np.ndarray]) -> None:
    with (
        RtspServer(tmp_path, pictures, RATE_HZ, sei=True) as server,
        running(server.url(), size_px=SIZE_PX, stream_clock="utc") as camera,  # CLOCK is years off
    ):
        camera.wait_for(State.DEGRADED, "s off ours, and no picture is used: set both clocks, or", START_S)
        assert camera.frames == []


@pytest.mark.usefixtures("gstreamer")
def test_any_pipeline_up_to_raw_video_and_another_size_in_mid_stream() -> None:
    pipeline = (
        "concat name=c videotestsrc pattern=snow num-buffers=45 ! video/x-raw,width=320,height=240,framerate=30/1 ! c. "
        "videotestsrc pattern=snow num-buffers=45 ! video/x-raw,width=160,height=120,framerate=30/1 ! c. "
        "c. ! jpegenc ! jpegdec"
    )
    with running(f"gst:{pipeline}", size_px=SIZE_PX) as camera:
        camera.wait_for_pictures(10, START_S)
        image = camera.frames[-1][1].image
        assert image.shape == (240, 320) and image.std() > 20.0
        camera.wait_for(State.DEGRADED, "pictures are 160x120, the camera file is for 320x240", START_S)
        camera.wait_for(State.LOST, "the stream has ended", START_S)


@pytest.mark.usefixtures("gstreamer")
@pytest.mark.parametrize(
    ("device", "why"),
    [
        ("gst:videotestsrc ! nosuchdecoder", 'no element "nosuchdecoder": it is in none of Debian\'s usual packages'),
        ("gst:videotestsrc ! avdec_nosuch", "sudo apt-get install gstreamer1.0-libav"),
        ("gst:videotestsrc ! !", "no pipeline: syntax error"),
    ],
)
def test_a_pipeline_that_can_never_work_is_refused_in_one_line(device: str, why: str) -> None:
    with running(device, size_px=SIZE_PX) as camera:
        camera.thread.join(START_S)
    assert why in str(camera.error) and "\n" not in str(camera.error)


@pytest.mark.parametrize("end", ["appsink", "autovideosink sync=false", "xvimagesink", "appsink name=out"])
def test_a_pipeline_with_a_sink_of_its_own_is_refused_with_what_to_leave_out(end: str) -> None:
    with pytest.raises(ConfigError, match=f"ends in '{end.split(maxsplit=1)[0]}': leave that"):
        helper_launch(CameraConfig(device=f"gst:videotestsrc ! videoconvert ! {end}"), SIZE_PX)
    assert helper_launch(CameraConfig(device="gst:videotestsrc ! videoconvert"), SIZE_PX) is not None


@pytest.mark.usefixtures("gstreamer")
def test_a_stream_is_opened_by_its_address(tmp_path: Path, pictures: list[np.ndarray]) -> None:
    """By http a file of a camera's server; udp:// and srt:// are opened by the same element."""
    writer = cv2.VideoWriter(str(tmp_path / "clip.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 10.0, SIZE_PX, False)
    for k in range(40):
        writer.write(pictures[k % len(pictures)])
    writer.release()
    handler = partial(SimpleHTTPRequestHandler, directory=str(tmp_path))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        try:
            with running(f"http://127.0.0.1:{server.server_port}/clip.avi", size_px=SIZE_PX) as camera:
                assert eventually(lambda: len(camera.frames) >= 5)
        finally:
            server.shutdown()
    for device in ("udp://0.0.0.0:5600", "srt://127.0.0.1:7001"):
        launch = helper_launch(CameraConfig(device=device), SIZE_PX)
        assert f'uri=\\"{device}\\"' in launch.stdin.decode()


@pytest.mark.usefixtures("gstreamer")
@pytest.mark.parametrize(
    ("device", "why"),
    [
        ("rtsp://anna:secret@127.0.0.1:1/live", "rtsp://127.0.0.1:1/live: "),
        ("libcamera:no-such-camera", "libcamera:no-such-camera: libcamera has no camera 'no-such-camera'"),
        ("libcamera:", "libcamera:: libcamera has no camera"),
    ],
)
def test_what_may_come_later_is_waited_for(device: str, why: str) -> None:
    with running(device, size_px=SIZE_PX) as camera:
        health = camera.wait_for(State.LOST, why, START_S)
        time.sleep(1.0)
        assert camera.source.health().state is State.LOST
    assert "secret" not in health.detail and len(health.detail) > 30  # a reason is given


@pytest.mark.usefixtures("gstreamer")
def test_it_is_known_before_a_flight_whether_a_source_can_be_opened() -> None:
    def unable_at(device: str) -> str:
        launch = helper_launch(CameraConfig.model_validate({"device": device}), SIZE_PX)
        assert launch is not None
        return unable(launch)

    for device in ("rtsp://127.0.0.1:1/live", "libcamera:", "gst:videotestsrc", "exec:/usr/bin/env camera"):
        assert unable_at(device) == ""
    assert "sudo apt-get install gstreamer1.0-libav" in unable_at("gst:videotestsrc ! avdec_nosuch")
    assert unable_at("exec:/no/such/program") == "/no/such/program: no such program"
    assert libcamera_names()[1] == ""


def frames_of(pipeline: str) -> list[tuple[Header, bytes]]:
    """What our helper writes of a pipeline that ends by itself."""
    width, height = SIZE_PX
    spec = {"kind": "gst", "pipeline": pipeline, "width": width, "height": height, "rate_hz": RATE_HZ}
    command = [SYSTEM_PYTHON, "-I", str(HELPER)]
    done = subprocess.run(command, input=json.dumps(spec).encode(), capture_output=True, check=False, timeout=60.0)
    return [(header, bytes(luma)) for header, luma in FrameReader().feed(done.stdout)]


@pytest.mark.wall_clock  # played in its own time: the sink drops what a busy computer does not take
@pytest.mark.usefixtures("gstreamer")
@pytest.mark.parametrize(
    ("encoder", "codec"),
    rest_long(
        [
            ("openh264enc gop-size=15 bitrate=2000000", "264"),
            ("x265enc speed-preset=ultrafast tune=zerolatency key-int-max=15 bitrate=2000", "265"),
        ]
    ),
)
def test_no_picture_behind_a_lost_packet_counts_until_one_that_needs_no_other(encoder: str, codec: str) -> None:
    """The decoder calls them whole. They are sharp, and show where the camera was before the gap."""

    def sent(loss: float) -> str:
        return (
            "videotestsrc pattern=smpte75 horizontal-speed=7 num-buffers=150 ! "
            f"video/x-raw,width={SIZE_PX[0]},height={SIZE_PX[1]},framerate=30/1 ! videoconvert ! {encoder} ! "
            f"h{codec}parse config-interval=-1 ! rtph{codec}pay mtu=300 ! identity drop-probability={loss} ! "
            f"rtph{codec}depay ! h{codec}parse ! avdec_h{codec}"
        )

    true = {header.stamp_ns: luma for header, luma in frames_of(sent(0.0))}
    assert len(true) == 150
    came = [(header, luma) for header, luma in frames_of(sent(0.02)) if header.stamp_ns in true]
    whole = [luma == true[header.stamp_ns] for header, luma in came if not header.is_damaged]
    damaged = [luma == true[header.stamp_ns] for header, luma in came if header.is_damaged]
    assert len(whole) > 50 and all(whole)
    assert len(damaged) > 5 and not all(damaged)


@given(st.lists(st.tuples(st.booleans(), st.booleans(), st.integers(0, 2 * HEALED_NS)), max_size=40))
def test_a_stream_is_whole_from_a_picture_that_needs_no_other_to_the_next_gap(
    events: list[tuple[bool, bool, int]],
) -> None:
    whole, now_ns, broken_ns = Whole(), 0, None
    for k, (is_gap, is_key, step_ns) in enumerate(events):
        now_ns += step_ns
        is_healed = is_key or (broken_ns is not None and now_ns - broken_ns > HEALED_NS)
        broken_ns = None if is_healed else broken_ns
        broken_ns = now_ns if is_gap and not is_key else broken_ns
        assert whole.see(is_gap, is_key, now_ns) == (broken_ns is None and (k == 0 or not is_gap))
        assert whole.is_whole == (broken_ns is None)


class Installed:
    """A registry of GStreamer's that has these elements, and makes them by their names."""

    def __init__(self, *names: str) -> None:
        self.names = {"rtph264depay", "h264parse", "rtph265depay", "h265parse", "capsfilter", "nvvidconv", *names}
        self.ElementFactory = self.Caps = self

    def find(self, name: str) -> str | None:
        return name if name in self.names else None

    def make(self, name: str, _: None) -> Made:
        assert name in self.names
        return Made(name)

    def from_string(self, text: str) -> str:
        return text

    def util_set_object_arg(self, element: Made, name: str, value: str) -> None:
        element.set_property(name, value)


class Made:
    def __init__(self, name: str) -> None:
        self.name, self.properties = name, dict[str, object]()

    def find_property(self, name: str) -> str:
        return name

    def set_property(self, name: str, value: object) -> None:
        self.properties[name] = value


@pytest.mark.parametrize(
    ("codec", "installed", "chain", "then"),
    [
        ("H264", ("avdec_h264", "v4l2h264dec"), "rtph264depay h264parse capsfilter v4l2h264dec", ["avdec_h264"]),
        ("H265", ("nvv4l2decoder", "avdec_h265"), "rtph265depay h265parse capsfilter nvv4l2decoder nvvidconv",
         ["avdec_h265"]),
        ("H264", ("openh264dec", "avdec_h264"), "rtph264depay h264parse capsfilter avdec_h264", ["openh264dec"]),
    ],
)  # fmt: skip
def test_a_decoder_in_hardware_is_taken_first_and_others_are_left_to_be_tried(
    codec: str, installed: tuple[str, ...], chain: str, then: list[str]
) -> None:
    player = Player(Installed(*installed), None, {"kind": "rtsp"}, 1)
    made = player._chain(codec)
    assert " ".join(element.name for element in made) == chain
    assert player.decoders == then
    if player.decoder.startswith("avdec_"):
        assert made[-1].properties == {"thread-type": "slice"}


def test_without_any_decoder_it_is_reported_which_package_has_one() -> None:
    with pytest.raises(Hopeless, match=r"no avdec_h265: sudo apt-get install gstreamer1.0-libav"):
        Player(Installed("avdec_h264"), None, {"kind": "rtsp"}, 1)._chain("H265")


def test_which_decoders_there_are_is_reported_before_a_flight(monkeypatch: pytest.MonkeyPatch) -> None:
    found = {"H264": ["v4l2h264dec", "avdec_h264"], "H265": ["avdec_h265"], "JPEG": []}
    monkeypatch.setattr(launching, "_ask", lambda spec: (json.dumps(found), ""))
    printed = "H264 by v4l2h264dec (hardware), else avdec_h264; H265 by avdec_h265; JPEG by nothing that is installed"
    assert decoders_text() == printed
    monkeypatch.setattr(launching, "_ask", lambda spec: ("", "GStreamer is not installed: sudo"))
    assert decoders_text() == "video of streams is not decoded: GStreamer is not installed: sudo"


@pytest.mark.usefixtures("gstreamer")
def test_this_computers_decoders_are_those_of_its_registry() -> None:
    printed = dict(part.split(" by ") for part in decoders_text().split("; "))
    assert list(printed) == ["H264", "H265", "JPEG", "MP4V-ES"]
    assert "avdec_h264" in printed["H264"] and "avdec_h265" in printed["H265"] and "jpegdec" in printed["JPEG"]


def test_without_gstreamer_it_is_reported_what_to_install() -> None:
    done = subprocess.run(  # this Python has no bindings
        [sys.executable, "-I", str(HELPER)], input=b'{"kind": "list"}', capture_output=True, check=False
    )
    assert done.returncode == 2
    assert b"GStreamer is not installed: sudo apt-get install python3-gi gir1.2-gstreamer-1.0" in done.stderr


@pytest.mark.usefixtures("gstreamer")
def test_it_runs_where_no_memory_may_be_written_and_executed() -> None:
    """As under MemoryDenyWriteExecute= of our unit."""
    spec = {"kind": "gst", "pipeline": "videotestsrc num-buffers=5 ! video/x-raw,format=YUY2", "width": 1, "height": 1}
    done = subprocess.run(
        [SYSTEM_PYTHON, "-I", str(HELPER)],
        input=json.dumps(spec).encode(),
        capture_output=True,
        check=False,
        timeout=PATIENCE_S,
        preexec_fn=lambda: ctypes.CDLL(None).prctl(65, 1, 0, 0, 0),  # PR_SET_MDWE, PR_MDWE_REFUSE_EXEC_GAIN
    )
    frames = list(FrameReader().feed(done.stdout))
    assert [header.sequence for header, _ in frames] == [1, 2, 3, 4, 5], done.stderr
    assert frames[0][0].origin is Origin.MEDIA and frames[0][0].width_px == 320


@pytest.mark.parametrize("is_h265", [False, True])
@given(unix_us=st.integers(0, 2**64 - 1), before=st.binary(max_size=60), after=st.binary(max_size=60))
def test_a_capture_time_is_found_in_whatever_surrounds_it(
    is_h265: bool, unix_us: int, before: bytes, after: bytes
) -> None:
    parameters = b"\x00\x00\x00\x01" + (b"\x40\x01" if is_h265 else b"\x67") + escaped(before) + b"\x80"
    picture = b"\x00\x00\x01" + (b"\x26\x01" if is_h265 else b"\x65") + escaped(after) + b"\x80"
    stream = parameters + sei_unit(unix_us, is_h265) + picture
    assert precision_time_ns(stream, is_h265) == unix_us * 1000
    units = list(nal_units(stream, True))
    assert len(units) == 3
    in_lengths = b"".join(len(unit).to_bytes(4, "big") + unit for unit in units)
    assert precision_time_ns(in_lengths, is_h265, False) == unix_us * 1000


@given(st.binary(max_size=200), st.booleans(), st.booleans(), st.sampled_from(sorted(MISB)))
def test_no_access_unit_makes_the_reader_fail(data: bytes, is_h265: bool, is_byte_stream: bool, key: bytes) -> None:
    for mangled in (data, data + key, data[:50] + key + data[50:], b"\x00\x00\x01\x06\x05\xff" + data + key):
        found = precision_time_ns(mangled, is_h265, is_byte_stream)
        assert found is None or found >= 0


def test_a_kind_of_stamp_is_used_once_it_comes_with_every_picture() -> None:
    stamps = Stamps(is_utc_trusted=True)
    sei, rtcp, media, arrival = Origin.SEI, Origin.RTCP, Origin.MEDIA, Origin.ARRIVAL
    assert stamps.choose({media: 1}) == media
    assert [stamps.choose({sei: 1, media: 1}) for _ in range(20)] == [media] * 14 + [sei] * 6
    assert stamps.choose({media: 1, rtcp: 1}) == media  # one without the time of the SEI
    assert [stamps.choose({rtcp: 1, media: 1}) for _ in range(20)] == [media] * 13 + [rtcp] * 7
    assert stamps.choose({}) == arrival
    assert Stamps(is_utc_trusted=False).choose({rtcp: 1, media: 1}) == media


def test_no_password_is_shown() -> None:
    assert without_secrets("rtsp://a:b@cam/live") == "rtsp://cam/live"
    shown = without_secrets("gst:rtspsrc location=rtsp://anna:secret@10.0.0.2:554/live ! rtph264depay")
    assert shown == "gst:rtspsrc location=rtsp://10.0.0.2:554/live ! rtph264depay"
