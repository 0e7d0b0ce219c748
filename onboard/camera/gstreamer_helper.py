"""Pictures that GStreamer can open, as frames in a pipe: RTSP, libcamera, or any pipeline up to raw video.

A program of its own, run as a script by the system's Python (`/usr/bin/python3 -I`), which has GStreamer's bindings:
nothing of this project is imported. What to open comes as JSON on standard input; frames go to standard output as
docs/own-camera.md describes them. It ends with 2 for what no other attempt can mend, else with 1 and one line of why.
"""

from __future__ import annotations

import json
import os
import re
import signal
import struct
import sys
import time
import zlib
from collections.abc import Iterator
from typing import Any

NEVER_WORKS, FAILED = 2, 1
BASE = "python3-gi gir1.2-gstreamer-1.0 gir1.2-gst-plugins-base-1.0 gstreamer1.0-plugins-base gstreamer1.0-plugins-good"
PACKAGES = {
    "gstreamer1.0-libav": ("avdec_",),
    "gstreamer1.0-libcamera libcamera-ipa": ("libcamerasrc",),
    "gstreamer1.0-plugins-bad": (
        "h264parse", "h265parse", "mpeg4videoparse", "openh264dec", "bayer2rgb", "srtsrc", "tsdemux", "v4l2sl", "va",
    ),
    "gstreamer1.0-plugins-base": ("videoconvert", "appsink", "decodebin", "uridecodebin", "videotestsrc", "app"),
    "gstreamer1.0-plugins-good": ("rtsp", "rtp", "udpsrc", "v4l2", "jpegdec", "matroskademux", "qtdemux"),
}  # fmt: skip

# The numbers of docs/own-camera.md.
HEADER = struct.Struct("<4sHHIII4sIIqqQBBBB4f4f32x")
MONOTONIC, SENDER, SENDER_UTC = 0, 1, 2
UNKNOWN, FIRST_ROW_END = 0, 2
SENSOR, SEI, RTCP, MEDIA, ARRIVAL = 1, 2, 3, 4, 5
NAN = float("nan")

# Depayloader, parser and decoders of each codec, those in hardware first.
CODECS = {
    "H264": (
        "rtph264depay", "h264parse", ("v4l2h264dec", "nvv4l2decoder", "v4l2slh264dec", "avdec_h264", "openh264dec"),
    ),
    "H265": ("rtph265depay", "h265parse", ("v4l2h265dec", "nvv4l2decoder", "v4l2slh265dec", "avdec_h265")),
    "JPEG": ("rtpjpegdepay", "", ("v4l2jpegdec", "jpegdec", "avdec_mjpeg")),
    "MP4V-ES": ("rtpmp4vdepay", "mpeg4videoparse", ("v4l2mpeg4dec", "avdec_mpeg4")),
}  # fmt: skip
LUMA = "video/x-raw,format=(string){GRAY8,I420,YV12,NV12,NV21,Y42B,NV16,Y444,GRAY16_LE}"
LOCAL = {"v4l2src": UNKNOWN, "libcamerasrc": FIRST_ROW_END, "nvarguscamerasrc": UNKNOWN, "nvv4l2camerasrc": UNKNOWN}
"""Sources on this computer, whose buffers bear the driver's time, and which moment of the exposure that is."""
JITTER_MS = 100  # for packets that come out of order
TIMEOUT_US = 3_000_000
HEALED_NS = 3_000_000_000  # longer than it takes to refresh a picture bit by bit
HELD = 256  # pictures between parser and decoder, at most
STEADY = 15  # pictures in a row that must have a kind of stamp before it is used
NTP_TO_UNIX_NS = 2_208_988_800 * 10**9

# MISB ST 0604: a user data SEI with one of these, a status byte, and eight bytes of time with 0xFF after every two.
MISB = {
    b"MISPmicrosectime": 1000,
    bytes.fromhex("a8687dd4d7593758a5cef0338b6545f1"): 1000,
    bytes.fromhex("cf848278ee23306c9265e8fef22fb8b8"): 1,
}


class Hopeless(Exception):
    """No other attempt can be better; the text states what to do."""


class Over(Exception):
    """This stream has ended or failed; the text states how."""


def nal_units(data: bytes, is_byte_stream: bool) -> Iterator[bytes]:
    """The units of an access unit, without start codes or lengths."""
    if is_byte_stream:
        starts = [m.end() for m in re.finditer(b"\x00\x00\x01", data)]
        for start, following in zip(starts, [*starts[1:], len(data) + 3], strict=False):  # none: nothing
            yield data[start : following - 3]
        return
    at = 0
    while at + 4 <= len(data):
        size = int.from_bytes(data[at : at + 4], "big")
        yield data[at + 4 : at + 4 + size]
        at += 4 + size


def precision_time_ns(data: bytes, is_h265: bool, is_byte_stream: bool = True) -> int | None:
    """Unix time in the SEI of an access unit (MISB ST 0604), or None."""
    if not any(identifier in data for identifier in MISB):  # nearly all pictures of nearly all cameras
        return None
    for unit in nal_units(data, is_byte_stream):
        kind = (unit[0] >> 1) & 0x3F if is_h265 and unit else unit[0] & 0x1F if unit else -1
        if kind not in ({39, 40} if is_h265 else {6}):
            continue
        found = _time_in_sei(unit[2 if is_h265 else 1 :].replace(b"\x00\x00\x03", b"\x00\x00"))
        if found is not None:
            return found
    return None


def _time_in_sei(payloads: bytes) -> int | None:
    at = 0
    while at + 2 <= len(payloads):
        numbers = [0, 0]  # kind and size, each with 255 for every byte that continues it
        for which in (0, 1):
            while at < len(payloads) and payloads[at] == 255:
                numbers[which], at = numbers[which] + 255, at + 1
            if at >= len(payloads):
                return None
            numbers[which], at = numbers[which] + payloads[at], at + 1
        body, at = payloads[at : at + numbers[1]], at + numbers[1]
        unit_ns = MISB.get(body[:16])
        if numbers[0] == 5 and unit_ns is not None and len(body) >= 28 and body[19] == body[22] == body[25] == 255:
            time = body[17:19] + body[20:22] + body[23:25] + body[26:28]
            return int.from_bytes(time, "big") * unit_ns
    return None


def package_of(element: str) -> str:
    """Debian's package with an element of GStreamer, as a sentence."""
    for package, beginnings in PACKAGES.items():
        if element.startswith(beginnings):
            return f"sudo apt-get install {package}"
    return f"it is in none of Debian's usual packages: gst-inspect-1.0 {element}"


def load() -> tuple[Any, Any]:
    """GStreamer's bindings; raises Hopeless with what to install."""
    try:
        import gi  # noqa: PLC0415

        gi.require_version("Gst", "1.0")
        gi.require_version("GstVideo", "1.0")
        from gi.repository import Gst, GstVideo  # noqa: PLC0415
    except (ImportError, ValueError) as error:
        raise Hopeless(f"GStreamer is not installed: sudo apt-get install {BASE} ({error})") from error
    Gst.init(None)
    return Gst, GstVideo


def decoders_at_hand(Gst: Any) -> dict[str, list[str]]:
    """Return for each codec the decoders that are installed, in the order in which they are tried."""
    return {
        codec: [name for name in names if Gst.ElementFactory.find(name) is not None]
        for codec, (_, _, names) in CODECS.items()
    }


class Stamps:
    """The choice among the stamps that a stream has: the best that every picture has had for a while."""

    def __init__(self, is_utc_trusted: bool) -> None:
        self._seen = 0
        # Sender reports only add what time it is to the stream's own stamps: of use where that is trusted, not else.
        self._row = {SEI: 0, RTCP: 0, MEDIA: 0} if is_utc_trusted else {SEI: 0, MEDIA: 0}

    def choose(self, found: dict[int, int]) -> int:
        """The origin to be used for this picture, of those that it has."""
        self._seen += 1
        for origin in self._row:
            self._row[origin] = self._row[origin] + 1 if origin in found else 0
        enough = min(STEADY, self._seen)
        return next((origin for origin, row in self._row.items() if row >= enough), ARRIVAL)


class Whole:
    """The judgement of which pictures of a stream are whole: none from a gap to the next picture that needs no other.

    A decoder puts something in place of what was lost, and goes on: pictures look sharp, and show where the camera was
    before the gap. A stream without such pictures (intra refresh) is whole again after HEALED_NS.
    """

    def __init__(self) -> None:
        self._broken_ns: int | None = None
        self._has_begun = False

    @property
    def is_whole(self) -> bool:
        return self._broken_ns is None

    def see(self, is_gap: bool, is_key: bool, now_ns: int) -> bool:
        """Return whether the next picture is whole; it comes to the decoder behind a gap or not, a key picture or not.

        The picture directly behind a gap may begin with the rest of an earlier one, and then bears its times. So it
        does not count itself, but what follows a key picture (one that needs no other) does. A stream begins with a
        gap.
        """
        if is_key or (self._broken_ns is not None and now_ns - self._broken_ns > HEALED_NS):
            self._broken_ns = None
        if is_gap and not is_key:
            self._broken_ns = now_ns
        is_first, self._has_begun = not self._has_begun, True
        return self.is_whole and (is_first or not is_gap)


class Player:
    """One pipeline from its source to frames."""

    def __init__(self, Gst: Any, GstVideo: Any, spec: dict[str, Any], out: int) -> None:
        self.Gst, self.GstVideo, self.spec, self.out = Gst, GstVideo, spec, out
        self.moment: int | None = None  # of a local source's stamps; None: the stream is someone else's
        self.decoders: list[str] = []  # still to be tried
        self.decoder = ""
        self.written = 0
        self.failure = ""  # found by a thread of GStreamer's
        self._known: dict[int, tuple[int, dict[int, int], bool]] = {}  # by presentation time: arrival, stamps, if whole
        self._stamps = Stamps(bool(spec.get("utc")))
        self._whole = Whole()
        self._number = 0
        self._last_pts: int | None = None
        self._is_asked_to_end = False

    def end(self, *_: object) -> None:
        self._is_asked_to_end = True

    def need(self, *elements: str) -> None:
        """Raises Hopeless unless all elements are installed."""
        for element in elements:
            if self.Gst.ElementFactory.find(element) is None:
                raise Hopeless(f"GStreamer has no {element}: {package_of(element)}")

    def check(self) -> None:
        """Raises Hopeless where something that this kind of source needs is not installed; opens nothing."""
        self.need("videoconvert", "appsink")
        if self.spec["kind"] == "gst":
            self._own()
        elif self.spec["kind"] == "libcamera":
            self.need("libcamerasrc")
        else:
            self.need("rtspsrc")
            for codec, (depay, parse, _) in CODECS.items():
                self.need(depay, *([parse] if parse else []))
                self._decoders_of(codec)

    def _decoders_of(self, codec: str) -> list[str]:
        """Return the decoders that are installed, at least one; raises Hopeless."""
        found = decoders_at_hand(self.Gst)[codec]
        if not found:
            self.need(next(name for name in CODECS[codec][2] if name.startswith(("avdec", "jpegdec"))))
        return found

    def play(self) -> None:
        """Write frames until asked to end; raises Over or Hopeless."""
        self.need("videoconvert", "appsink")
        pipeline = {"rtsp": self._rtsp, "libcamera": self._libcamera, "gst": self._own}[self.spec["kind"]]()
        sink = pipeline.get_by_name("pc_out")
        pipeline.use_clock(self.Gst.SystemClock.obtain())  # CLOCK_MONOTONIC
        try:
            self._run(pipeline, sink)
        finally:
            pipeline.set_state(self.Gst.State.NULL)

    def _run(self, pipeline: Any, sink: Any) -> None:
        Gst, bus = self.Gst, pipeline.get_bus()
        changed = pipeline.set_state(Gst.State.PAUSED)
        is_paused = True
        while not self._is_asked_to_end:
            if self.failure:
                raise Hopeless(self.failure)
            message = bus.pop_filtered(Gst.MessageType.ERROR | Gst.MessageType.EOS)
            if message is not None:
                raise Over(self._words(message))
            if is_paused and changed == Gst.StateChangeReturn.ASYNC:
                changed = pipeline.get_state(100 * Gst.MSECOND)[0]
                continue
            if is_paused:
                # A file is played in its own time; what is live comes when it comes.
                sink.set_property("sync", changed == Gst.StateChangeReturn.SUCCESS)
                pipeline.set_state(Gst.State.PLAYING)
                is_paused = False
            sample = sink.emit("try-pull-sample", 100 * Gst.MSECOND)
            if sample is not None:
                self._write(pipeline, sample)
            elif sink.get_property("eos") and not bus.have_pending():
                raise Over("the stream has ended")

    def _words(self, message: Any) -> str:
        if message.type == self.Gst.MessageType.EOS:
            return "the stream has ended"
        error, debug = message.parse_error()
        resource = self.Gst.ResourceError
        if self.spec["kind"] == "libcamera" and error.matches(resource.quark(), resource.NOT_FOUND):
            return self._absent()
        last = (debug or "").strip().splitlines()[-1:] or [""]
        detail = last[0].split("): ")[-1]
        reason = error.message.rstrip(".")
        if "nauthorized" in f"{reason}{detail}":
            return "the server asks for a user and a password: rtsp://USER:PASSWORD@HOST/PATH"
        if "not-negotiated" in detail:
            return f"{reason}: {message.src.get_name()} cannot give {self.spec['width']}x{self.spec['height']}"
        return f"{reason} ({detail})" if detail and detail != reason else reason

    def _absent(self) -> str:
        """Return a line that names the camera that libcamera does not have, and those that it has."""
        wanted, there = self.spec.get("camera"), ", ".join(map(repr, cameras(self.Gst)))
        return f"libcamera has {f'no camera {wanted!r}' if wanted else 'no camera'}{f', but {there}' if there else ''}"

    # --- the three kinds of source ---

    def _parsed(self, text: str) -> Any:
        """A pipeline by its text, with the end that gives luma."""
        Gst = self.Gst
        tail = f"{LUMA} ! appsink name=pc_out sync=false max-buffers=2 drop=true"
        try:
            pipeline = Gst.parse_launch(f"{text} ! {tail}")
        except Exception as error:  # GLib.Error, whose module needs GStreamer
            reason = str(getattr(error, "message", error))
            missing = re.search(r'no element "([^"]+)"', reason)
            raise Hopeless(f"{reason}: {package_of(missing[1])}" if missing else f"no pipeline: {reason}") from error
        if not hasattr(pipeline, "get_by_name") or pipeline.get_by_name("pc_out") is None:
            raise Hopeless("no pipeline: it must have a source and end in raw video")
        pipeline.connect("deep-element-added", self._added)
        elements = pipeline.iterate_recurse()
        while True:
            result, element = elements.next()
            if result != Gst.IteratorResult.OK:
                break
            self._added(pipeline, pipeline, element)
        return pipeline

    def _added(self, pipeline: Any, parent: Any, element: Any) -> None:
        """Ask an element for the stamps it can give, and look at what passes a parser."""
        factory = element.get_factory()
        name = factory.get_name() if factory is not None else ""
        if name in LOCAL:
            self.moment = LOCAL[name]
        elif name == "rtspsrc":
            self._set(element, "add-reference-timestamp-meta", "true")
            self._set(element, "buffer-mode", "none")  # times as sent: they are mapped to our clock by the daemon
        elif name in {"h264parse", "h265parse"}:
            pad = element.get_static_pad("src")
            pad.add_probe(self.Gst.PadProbeType.BUFFER, self._passed, name == "h265parse")

    def _set(self, element: Any, name: str, value: str) -> bool:
        """Set a property that not every version has."""
        if element.find_property(name) is None:
            return False
        self.Gst.util_set_object_arg(element, name, value)
        return True

    def _own(self) -> Any:
        return self._parsed(f"{self.spec['pipeline']} ! videoconvert")

    def _libcamera(self) -> Any:
        self.need("libcamerasrc")
        width, height, rate = self.spec["width"], self.spec["height"], self.spec["rate_hz"]
        caps = f"video/x-raw,width={width},height={height},framerate={round(1000 * rate)}/1000"
        pipeline = self._parsed(f"libcamerasrc name=pc_camera ! {caps} ! videoconvert")
        source = pipeline.get_by_name("pc_camera")
        if self.spec.get("camera"):
            source.set_property("camera-name", self.spec["camera"])
        exposure_us = self.spec.get("exposure_us")
        if exposure_us is not None:
            self._set(source, "exposure-time-mode", "manual")
            if not self._set(source, "exposure-time", str(round(exposure_us))):
                raise Hopeless("this version of libcamerasrc cannot fix the exposure: leave camera.exposure_us out")
        return pipeline

    def _rtsp(self) -> Any:
        self.need("rtspsrc")
        pipeline = self._parsed("videoconvert name=pc_convert")
        source = self.Gst.ElementFactory.make("rtspsrc", None)
        source.set_property("location", self.spec["location"])
        source.set_property("latency", JITTER_MS)
        source.set_property("timeout", TIMEOUT_US)
        source.set_property("tcp-timeout", TIMEOUT_US)
        source.connect("select-stream", lambda _, number, caps: caps.get_structure(0).get_string("media") == "video")
        source.connect("pad-added", self._link_video, pipeline)
        pipeline.add(source)
        return pipeline

    def _link_video(self, source: Any, pad: Any, pipeline: Any) -> None:
        """Put depayloader, parser and decoder between a stream and the end."""
        Gst, convert = self.Gst, pipeline.get_by_name("pc_convert")
        caps = pad.get_current_caps() or pad.query_caps(None)
        codec = caps.get_structure(0).get_string("encoding-name") or ""
        if caps.get_structure(0).get_string("media") != "video" or convert.get_static_pad("sink").is_linked():
            return
        try:
            chain = self._chain(codec)
        except Hopeless as error:
            self.failure = str(error)
            return
        for element in chain:
            pipeline.add(element)
            element.sync_state_with_parent()
        for one, other in zip(chain, [*chain[1:], convert], strict=True):
            if not one.link(other):
                self.failure = f"{one.get_name()} does not fit {other.get_name()}"
                return
        if pad.link(chain[0].get_static_pad("sink")) != Gst.PadLinkReturn.OK:
            self.failure = f"{codec}: the stream does not fit {chain[0].get_name()}"

    def _chain(self, codec: str) -> list[Any]:
        Gst = self.Gst
        if codec not in CODECS:
            raise Hopeless(f"video of codec {codec or 'unknown'}: it is one of {', '.join(CODECS)}; else gst:PIPELINE")
        depay, parse, _ = CODECS[codec]
        self.need(depay, *([parse] if parse else []))
        if not self.decoder:
            self.decoder, *self.decoders = self._decoders_of(codec)
        made = [Gst.ElementFactory.make(name, None) for name in (depay, parse, self.decoder) if name]
        if codec in {"H264", "H265"}:
            form = Gst.ElementFactory.make("capsfilter", None)
            form.set_property(
                "caps", Gst.Caps.from_string(f"video/x-{codec.lower()},stream-format=byte-stream,alignment=au")
            )
            made.insert(2, form)
        if self.decoder.startswith("avdec_"):
            self._set(made[-1], "thread-type", "slice")  # threads by frames would hold pictures back
        if self.decoder == "nvv4l2decoder":  # out of the graphics chip's memory
            made.append(Gst.ElementFactory.make("nvvidconv", None))
        return made

    # --- stamps and frames ---

    def _passed(self, pad: Any, info: Any, is_h265: bool) -> Any:
        """A compressed picture on its way to the decoder: when it came, and the times that it bears."""
        buffer, arrival_ns = info.get_buffer(), time.monotonic_ns()
        found: dict[int, int] = {}
        reference = buffer.get_reference_timestamp_meta(None)
        if reference is not None and reference.reference.get_structure(0).get_name() == "timestamp/x-ntp":
            found[RTCP] = reference.timestamp - NTP_TO_UNIX_NS
        caps = pad.get_current_caps()
        is_byte_stream = caps is None or caps.get_structure(0).get_string("stream-format") in {None, "byte-stream"}
        sei_ns = precision_time_ns(buffer.extract_dup(0, buffer.get_size()), is_h265, is_byte_stream)
        if sei_ns is not None:
            found[SEI] = sei_ns
        flags = self.Gst.BufferFlags
        is_gap, is_key = buffer.has_flags(flags.DISCONT), not buffer.has_flags(flags.DELTA_UNIT)
        # The stream's time counts where it has one: a computer that stands still heals nothing.
        passed_ns = arrival_ns if buffer.pts == self.Gst.CLOCK_TIME_NONE else buffer.pts
        self._known[buffer.pts] = arrival_ns, found, self._whole.see(is_gap, is_key, passed_ns)
        while len(self._known) > HELD:
            del self._known[next(iter(self._known))]
        return self.Gst.PadProbeReturn.OK

    def _write(self, pipeline: Any, sample: Any) -> None:
        Gst, buffer, caps = self.Gst, sample.get_buffer(), sample.get_caps()
        now_ns = time.monotonic_ns()
        info = self.GstVideo.VideoInfo.new_from_caps(caps)
        meta = self.GstVideo.buffer_get_video_meta(buffer)
        stride, offset = (meta.stride[0], meta.offset[0]) if meta is not None else (info.stride[0], info.offset[0])
        luma = buffer.extract_dup(offset, stride * info.height)
        if len(luma) < stride * info.height:  # the last row comes without its padding
            luma = luma.ljust(stride * info.height, b"\0")
        pts = buffer.pts if buffer.pts != Gst.CLOCK_TIME_NONE else None
        arrival_ns, found, is_whole = self._known.pop(buffer.pts, (now_ns, {}, self._whole.is_whole))
        if pts is not None:
            found[MEDIA] = pts
        stamp_ns, clock, moment, origin = now_ns, MONOTONIC, UNKNOWN, ARRIVAL
        if self.moment is not None and pts is not None:
            stamp_ns, moment, origin = pts + pipeline.get_base_time(), self.moment, SENSOR
        else:
            origin = self._stamps.choose(found)
            if origin in found:
                stamp_ns, clock = found[origin], SENDER if origin == MEDIA else SENDER_UTC
        self._count(pts, buffer.duration, info)
        damaged = buffer.has_flags(Gst.BufferFlags.CORRUPTED) or not is_whole
        exposure_us = self.spec.get("exposure_us")
        exposure_s = NAN if exposure_us is None or self.spec["kind"] != "libcamera" else exposure_us / 1e6
        fourcc = b"Y16 " if caps.get_structure(0).get_string("format") == "GRAY16_LE" else b"GREY"
        header = HEADER.pack(
            b"PCFR", 1, 128, info.width, info.height, stride, fourcc, len(luma), int(damaged), stamp_ns, arrival_ns,
            self._number, clock, moment, origin, 0, exposure_s, NAN, NAN, NAN, NAN, NAN, NAN, NAN,
        )  # fmt: skip
        trailer = struct.pack("<4sI", b"PCFE", self._number & 0xFFFFFFFF)
        for part in (header + struct.pack("<I", zlib.crc32(header)), luma, trailer):
            view = memoryview(part)
            while view:
                view = view[os.write(self.out, view) :]
        self.written += 1

    def _count(self, pts: int | None, duration: int, info: Any) -> None:
        """Number the picture by how many periods have passed, where the stream states its period."""
        period_ns = duration if duration not in {self.Gst.CLOCK_TIME_NONE, 0} else 0
        if not period_ns and info.fps_n > 0:
            period_ns = 10**9 * info.fps_d // info.fps_n
        steps = 1
        if self._last_pts is not None and pts is not None and period_ns:
            steps = max(round((pts - self._last_pts) / period_ns), 1)
        self._number += steps
        self._last_pts = pts


def cameras(Gst: Any) -> list[str]:
    """The names of libcamera's cameras."""
    factory = Gst.DeviceProviderFactory.find("libcameraprovider")
    if factory is None:
        raise Hopeless(f"GStreamer has no libcamerasrc: {package_of('libcamerasrc')}")
    return [device.get_display_name() for device in factory.get().get_devices() or []]


def main() -> int:
    """Read what to open, and write frames until the reader or a signal ends it."""
    spec = json.load(sys.stdin)
    out = os.dup(1)
    os.dup2(2, 1)  # whatever a plugin prints must not come between frames
    try:
        Gst, GstVideo = load()
        if spec["kind"] == "list":
            os.write(out, json.dumps(cameras(Gst)).encode())
            return 0
        if spec["kind"] == "decoders":
            os.write(out, json.dumps(decoders_at_hand(Gst)).encode())
            return 0
        if spec.get("is_check"):
            Player(Gst, GstVideo, spec, out).check()
            return 0
        decoders: list[str] = []
        decoder = ""
        while True:
            player = Player(Gst, GstVideo, spec, out)
            player.decoders, player.decoder = decoders, decoder
            signal.signal(signal.SIGTERM, player.end)
            signal.signal(signal.SIGINT, player.end)
            try:
                player.play()
                return 0
            except Over:
                if player.written or not player.decoder or not player.decoders:
                    raise
                # Hardware may be there and not work: the next decoder.
                decoder, decoders = player.decoders[0], player.decoders[1:]
    except Hopeless as error:
        print(" ".join(str(error).split()), file=sys.stderr)
        return NEVER_WORKS
    except Over as error:
        print(" ".join(str(error).split()), file=sys.stderr)
        return FAILED
    except BrokenPipeError:
        return 0


if __name__ == "__main__":
    sys.exit(main())
