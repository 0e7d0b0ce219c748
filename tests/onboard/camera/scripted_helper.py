"""A helper program that does what it is asked, for the tests: `scripted_helper.py STARTS ACT [ACT ...]`.

Each start takes the next list of acts, separated by `then`; the last list serves for all later starts. Acts:
`frames:N`, `stall:S`, `garbage:N` bytes, `half` a frame and killed, `back:S` stamps that much earlier, `size:WxH`,
`rate:HZ`, `say:TEXT` on the error stream, `exit:N`, `child` that never ends, `same:N` the same picture, `epoch:S` the
sender's clock with that origin. `@NAME` in the place of a number: until there is a file of that name next to STARTS.
"""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from onboard.camera.frame_protocol import Clock, Header, Moment, Origin, encode

PERIOD_S = 1.0 / 30.0


class Writer:
    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.size, self.number, self.back_ns, self.epoch_s = (64, 48), 0, 0, None
        self.period_s = PERIOD_S

    def frame(self, luma: bytes | None = None) -> bytes:
        now_ns = time.monotonic_ns()
        width, height = self.size
        stamp_ns, clock = now_ns - 5_000_000 - self.back_ns, Clock.MONOTONIC
        if self.epoch_s is not None:
            stamp_ns, clock = stamp_ns + round(self.epoch_s * 1e9), Clock.SENDER
        header = Header(
            width, height, stamp_ns, self.number, arrival_ns=now_ns, clock=clock, moment=Moment.MIDDLE,
            origin=Origin.RTCP if self.epoch_s is not None else Origin.SENSOR, sigma_s=0.001,
        )  # fmt: skip
        self.number += 1
        return encode(header, os.urandom(width * height) if luma is None else luma)

    def while_not(self, name: str) -> Iterator[None]:
        while not (self.folder / name[1:]).exists():
            yield

    def act(self, act: str) -> None:
        name, _, value = act.partition(":")
        out = sys.stdout.buffer
        if name in {"frames", "same"}:
            luma = None if name == "frames" else bytes(range(64)) * 48
            for _ in self.while_not(value) if value.startswith("@") else range(int(value)):
                out.write(self.frame(luma))
                out.flush()
                time.sleep(self.period_s)
        elif name == "rate":
            self.period_s = 1.0 / float(value)
        elif name == "stall" and value.startswith("@"):
            for _ in self.while_not(value):
                time.sleep(0.01)
        elif name == "stall":
            time.sleep(float(value))
        elif name == "garbage":
            out.write(os.urandom(int(value)))
            out.flush()
        elif name == "half":
            out.write(self.frame()[:1500])
            out.flush()
            os.kill(os.getpid(), signal.SIGKILL)
        elif name == "back":
            self.back_ns = round(float(value) * 1e9)
        elif name == "epoch":
            self.epoch_s = float(value)
        elif name == "size":
            width, _, height = value.partition("x")
            self.size = int(width), int(height)
        elif name == "say":
            print(value, file=sys.stderr, flush=True)
        elif name == "exit":
            sys.exit(int(value))
        elif name == "child":
            subprocess.Popen(["sleep", "600"])
        else:
            raise ValueError(act)


def main() -> None:
    starts = Path(sys.argv[1])
    number = int(starts.read_text()) if starts.exists() else 0
    starts.write_text(str(number + 1))
    lists = " ".join(sys.argv[2:]).split(" then ")
    writer = Writer(starts.parent)
    for act in lists[min(number, len(lists) - 1)].split():
        writer.act(act)


if __name__ == "__main__":
    main()
