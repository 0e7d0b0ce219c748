"""Pictures through an encoder, a network and a decoder, as fast as it goes: run by the system's Python, `-I`.

On standard input one line of JSON: `frames` (a file of raw grey pictures), `out` (a file for what was decoded),
`width`, `height`, `rate_hz`, `bit_rate`, `codec` (H264, H265), `loss` (share of RTP packets that never come; 0: as over
TCP).

Writes the decoded pictures one after the other and prints JSON: `numbers` of those that came undamaged, in their order,
`damaged` (how many came that our helper calls damaged), `bytes` of the stream, and `decode_s`, the decoder's
processor time.
"""

import json
import random
import resource
import sys
from collections.abc import Callable
from pathlib import Path

import gi

gi.require_version("Gst", "1.0")
from gi.repository import Gst  # noqa: E402

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "onboard" / "camera"))
from gstreamer_helper import Whole  # noqa: E402

# As gimbals and encoders of downlinks send: a key picture every second, no pictures that refer to later ones.
ENCODERS = {
    "H264": "openh264enc complexity=low rate-control=bitrate gop-size={gop} bitrate={bits} ! "
    "video/x-h264,profile=baseline ! h264parse config-interval=-1 ! "
    "video/x-h264,stream-format=byte-stream,alignment=au",
    "H265": "x265enc speed-preset=ultrafast tune=zerolatency key-int-max={gop} bitrate={kbits} ! "
    "h265parse config-interval=-1 ! video/x-h265,stream-format=byte-stream,alignment=au",
}
SENT = {
    "H264": ("rtph264pay mtu=1400", "rtph264depay ! h264parse name=parse ! avdec_h264 output-corrupt=true"),
    "H265": ("rtph265pay mtu=1400", "rtph265depay ! h265parse name=parse ! avdec_h265 output-corrupt=true"),
}


def run(text: str, feed: list[Gst.Buffer], look: Callable[[Gst.Buffer], None] | None = None) -> list[Gst.Sample]:
    """What comes out of a pipeline between `in` and an appsink `out`; `look` at what its parser hands on."""
    pipeline = Gst.parse_launch(text)
    source, sink = pipeline.get_by_name("in"), pipeline.get_by_name("out")
    if look is not None:

        def passed(_: Gst.Pad, info: Gst.PadProbeInfo) -> Gst.PadProbeReturn:
            look(info.get_buffer())
            return Gst.PadProbeReturn.OK

        pipeline.get_by_name("parse").get_static_pad("src").add_probe(Gst.PadProbeType.BUFFER, passed)
    pipeline.set_state(Gst.State.PLAYING)
    out = []
    for buffer in feed:
        source.emit("push-buffer", buffer)
        while (sample := sink.emit("try-pull-sample", 0)) is not None:
            out.append(sample)
    source.emit("end-of-stream")
    while (sample := sink.emit("try-pull-sample", 60 * Gst.SECOND)) is not None:
        out.append(sample)
    error = pipeline.get_bus().pop_filtered(Gst.MessageType.ERROR)
    pipeline.set_state(Gst.State.NULL)
    if error is not None:
        raise SystemExit(error.parse_error()[0].message)
    return out


def compressed(spec: dict, encoder: str) -> list[Gst.Buffer]:
    """What an encoder, with what follows it, makes of the pictures."""
    size = spec["width"] * spec["height"]
    data = Path(spec["frames"]).read_bytes()
    rate = f"{round(1000 * spec['rate_hz'])}/1000"
    feed, period_ns = [], Gst.SECOND / spec["rate_hz"]
    for k in range(len(data) // size):
        buffer = Gst.Buffer.new_wrapped(data[k * size : (k + 1) * size])
        buffer.pts, buffer.duration = round(k * period_ns), round(period_ns)
        feed.append(buffer)
    bits = spec["bit_rate"]
    encoder = encoder.format(gop=max(round(spec["rate_hz"]), 2), bits=bits, kbits=max(round(bits / 1000), 1))
    caps = f"video/x-raw,format=GRAY8,width={spec['width']},height={spec['height']},framerate={rate}"
    samples = run(
        f"appsrc name=in format=time caps={caps} ! videoconvert ! video/x-raw,format=I420 ! {encoder} ! "
        "appsink name=out sync=false max-buffers=0",
        feed,
    )
    return [sample.get_buffer() for sample in samples]


def packets(spec: dict) -> list[Gst.Buffer]:
    """The stream's RTP packets."""
    codec = spec["codec"]
    return compressed(spec, f"{ENCODERS[codec]} ! {SENT[codec][0]}")


def decoded(spec: dict, sent: list[Gst.Buffer]) -> tuple[list[Gst.Sample], dict[int, bool]]:
    """What the decoder makes of packets; and by presentation time, whether a picture is whole."""
    whole, is_whole = Whole(), {}

    def look(buffer: Gst.Buffer) -> None:
        flags = Gst.BufferFlags
        is_gap, is_key = buffer.has_flags(flags.DISCONT), not buffer.has_flags(flags.DELTA_UNIT)
        is_whole[buffer.pts] = whole.see(is_gap, is_key, buffer.pts)

    samples = run(
        "appsrc name=in format=time caps=application/x-rtp,media=video,clock-rate=90000,"
        f"encoding-name={spec['codec']} ! {SENT[spec['codec']][1]} ! video/x-raw,format=I420 ! "
        "appsink name=out sync=false max-buffers=0",
        sent,
        look,
    )
    return samples, is_whole


def spent_s() -> float:
    use = resource.getrusage(resource.RUSAGE_SELF)
    return use.ru_utime + use.ru_stime


def main() -> None:
    spec = json.loads(sys.stdin.readline())
    Gst.init(None)
    all_sent = packets(spec)
    first_ns = min(packet.pts for packet in all_sent)  # x265enc counts from a thousand hours
    chance = random.Random(spec.get("seed", 1))
    sent = [packet for packet in all_sent if chance.random() >= spec["loss"]]
    began_s = spent_s()
    samples, is_whole = decoded(spec, sent)
    decode_s = spent_s() - began_s
    size, numbers, damaged = spec["width"] * spec["height"], [], 0
    with Path(spec["out"]).open("wb") as out:
        for sample in samples:
            buffer = sample.get_buffer()
            if buffer.has_flags(Gst.BufferFlags.CORRUPTED) or not is_whole.get(buffer.pts, True):
                damaged += 1
                continue
            numbers.append(round((buffer.pts - first_ns) * spec["rate_hz"] / Gst.SECOND))
            out.write(buffer.extract_dup(0, size))
    stream_bytes = sum(packet.get_size() for packet in all_sent)
    print(json.dumps({"numbers": numbers, "damaged": damaged, "bytes": stream_bytes, "decode_s": decode_s}))


if __name__ == "__main__":
    main()
