"""GStreamer's RTSP server with a flight's pictures, for tests and benchmarks: run by the system's Python, `-I`.

On standard input one line of JSON: `frames` (a file of raw grey pictures, played over and over), `width`, `height`,
`rate_hz`, `bit_rate`, `codec` (H264, H265), `delay_s` and `jitter_s` between a picture's capture and its way into the
network, `sei` (write MISB times), `sei_ahead_s` (of the sender's clock), `loss` (the share of packets that never
leave, after the first 20 pictures), `port` (0: any).

Prints the port, then a line `NUMBER CAPTURE_NS` (CLOCK_MONOTONIC) for every picture that a client gets. Ends when
standard input is closed.
"""

import json
import random
import sys
import threading
import time
from pathlib import Path

import gi

gi.require_version("Gst", "1.0")
gi.require_version("GstRtspServer", "1.0")
from gi.repository import GLib, Gst, GstRtspServer  # noqa: E402

sys.path.insert(0, str(Path(__file__).parent))
from rtsp_times import sei_unit  # noqa: E402

BEHIND_S, BEHIND_PICTURES = 0.5, 10  # from which a picture is left out

ENCODERS = {
    "H264": "openh264enc name=enc complexity=low rate-control=bitrate gop-size=15 bitrate={} ! "
    "video/x-h264,profile=baseline ! h264parse config-interval=-1 ! "
    "video/x-h264,stream-format=byte-stream,alignment=au ! identity name=sei ! rtph264pay name=pay0 pt=96",
    "H265": "x265enc speed-preset=ultrafast tune=zerolatency key-int-max=15 bitrate={} ! "
    "h265parse config-interval=-1 ! "
    "video/x-h265,stream-format=byte-stream,alignment=au ! identity name=sei ! rtph265pay name=pay0 pt=96",
}


class Flight:
    """The pictures of one client's stream, pushed at their times."""

    def __init__(self, spec: dict, data: bytes, media: object) -> None:
        self.spec, self.data, self.number = spec, data, 0
        self.size = spec["width"] * spec["height"]
        element = media.get_element()
        self.source = element.get_by_name("src")
        self.ended = threading.Event()
        self.captured: list[int] = []
        self.stamping = False
        if spec.get("sei"):
            element.get_by_name("sei").get_static_pad("src").add_probe(Gst.PadProbeType.BUFFER, self.write_time)
        if spec.get("loss"):
            self.chance = random.Random(5)
            kinds = Gst.PadProbeType.BUFFER | Gst.PadProbeType.BUFFER_LIST
            element.get_by_name("pay0").get_static_pad("src").add_probe(kinds, self.lose)
        media.connect("unprepared", lambda *_: self.ended.set())
        threading.Thread(target=self.play, daemon=True).start()

    def write_time(self, pad: object, info: object) -> object:
        buffer = info.get_buffer()
        if self.stamping:  # our own buffer comes by here, too
            return Gst.PadProbeReturn.OK
        captured_ns = self.captured.pop(0)  # encoders keep the order here, and one of them shifts the times
        unix_ns = captured_ns + time.time_ns() - time.monotonic_ns() + round(1e9 * self.spec.get("sei_ahead_s", 0.0))
        is_h265 = self.spec["codec"] == "H265"
        old = buffer.extract_dup(0, buffer.get_size())
        new = Gst.Buffer.new_wrapped(sei_unit(unix_ns // 1000, is_h265) + old)
        new.pts, new.dts, new.duration = buffer.pts, buffer.dts, buffer.duration
        if not buffer.has_flags(Gst.BufferFlags.DELTA_UNIT):
            new.unset_flags(Gst.BufferFlags.DELTA_UNIT)
        else:
            new.set_flags(Gst.BufferFlags.DELTA_UNIT)
        self.stamping = True
        pad.push(new)
        self.stamping = False
        return Gst.PadProbeReturn.DROP

    def lose(self, pad: object, info: object) -> object:
        """Some packets, singly or of a list."""
        is_list = info.type & Gst.PadProbeType.BUFFER_LIST
        packets = info.get_buffer_list() if is_list else None
        sent = [packets.get(k) for k in range(packets.length())] if is_list else [info.get_buffer()]
        kept = [packet for packet in sent if self.number < 20 or self.chance.random() >= self.spec["loss"]]
        if len(kept) == len(sent):
            return Gst.PadProbeReturn.OK
        for packet in kept:
            pad.get_peer().chain(packet)
        return Gst.PadProbeReturn.DROP

    def play(self) -> None:
        spec, period_s = self.spec, 1.0 / self.spec["rate_hz"]
        noise = random.Random(7)
        count = len(self.data) // self.size
        began_s = time.monotonic()
        last_s = 0.0
        while not self.ended.is_set():
            k = self.number
            captured_s = began_s + k * period_s
            sent_s = captured_s + spec.get("delay_s", 0.0) + spec.get("jitter_s", 0.0) * noise.uniform(-1.0, 1.0)
            last_s = max(sent_s, last_s)
            if (wait_s := last_s - time.monotonic()) > 0.0:
                time.sleep(wait_s)
            self.number += 1
            if self.is_behind(-wait_s):
                continue
            at = (k % count) * self.size
            buffer = Gst.Buffer.new_wrapped(self.data[at : at + self.size])
            buffer.pts, buffer.duration = round(k * 1e9 * period_s), round(1e9 * period_s)
            self.captured.append(round(captured_s * 1e9))
            print(k, self.captured[-1], flush=True)
            if self.source.emit("push-buffer", buffer) != Gst.FlowReturn.OK:
                return

    def is_behind(self, late_s: float) -> bool:
        """Whether the computer is too busy for this picture: cameras leave out what their encoder cannot take, too."""
        return late_s > BEHIND_S or self.source.get_property("current-level-bytes") > BEHIND_PICTURES * self.size


def main() -> None:
    spec = json.loads(sys.stdin.readline())
    Gst.init(None)
    data = Path(spec["frames"]).read_bytes()
    rate = f"{round(1000 * spec['rate_hz'])}/1000"
    raw = f"video/x-raw,format=GRAY8,width={spec['width']},height={spec['height']},framerate={rate}"
    bits = spec.get("bit_rate", 2_000_000) // (1 if spec["codec"] == "H264" else 1000)
    server = GstRtspServer.RTSPServer()
    server.set_address("127.0.0.1")
    server.set_service(str(spec.get("port", 0)))
    factory = GstRtspServer.RTSPMediaFactory()
    factory.set_launch(
        f"( appsrc name=src is-live=true format=time caps={raw} ! videoconvert ! video/x-raw,format=I420 ! "
        + ENCODERS[spec["codec"]].format(bits)
        + " )"
    )
    factory.set_shared(False)
    factory.connect("media-configure", lambda _, media: Flight(spec, data, media))
    server.get_mount_points().add_factory("/flight", factory)
    server.attach(None)
    print(server.get_bound_port(), flush=True)
    loop = GLib.MainLoop()

    def watch() -> None:
        sys.stdin.read()
        loop.quit()

    threading.Thread(target=watch, daemon=True).start()
    loop.run()


if __name__ == "__main__":
    main()
