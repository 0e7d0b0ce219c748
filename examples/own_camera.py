"""A camera of your own for `camera.device = "exec:python3 own_camera.py"`: replace `capture` by your SDK's call.

The standard library alone; docs/own-camera.md describes every field. Standard output is for frames only: print what
people should read to standard error, whose last line `pc-onboard status` shows if the program ends.
"""

import os
import struct
import sys
import time
import zlib

WIDTH, HEIGHT = int(os.environ["POINTCLICK_WIDTH"]), int(os.environ["POINTCLICK_HEIGHT"])
RATE_HZ = float(os.environ["POINTCLICK_RATE_HZ"])
NAN = float("nan")
HEADER = struct.Struct("<4sHHIII4sIIqqQBBBB4f4f32x")
MONOTONIC, FIRST_ROW_END, SENSOR, NO_GIMBAL = 0, 2, 1, 0


def capture(number: int) -> tuple[bytes, int, float]:
    """Luma of WIDTH * HEIGHT bytes, CLOCK_MONOTONIC in ns when the first row was read, exposure in s."""
    time.sleep(1.0 / RATE_HZ)
    row = bytes((x * 7 + number) % 251 for x in range(WIDTH))
    rows = [row[y % WIDTH :] + row[: y % WIDTH] for y in range(HEIGHT)]
    return b"".join(rows), time.monotonic_ns(), 0.004


def main() -> None:
    """Write frames for ever; ends with the daemon, which closes the pipe."""
    number = 0
    while True:
        luma, stamp_ns, exposure_s = capture(number)
        header = HEADER.pack(
            b"PCFR", 1, 128, WIDTH, HEIGHT, WIDTH, b"GREY", len(luma), 0, stamp_ns, time.monotonic_ns(), number,
            MONOTONIC, FIRST_ROW_END, SENSOR, NO_GIMBAL, exposure_s, 0.0005, NAN, NAN, NAN, NAN, NAN, NAN,
        )  # fmt: skip
        checksum = struct.pack("<I", zlib.crc32(header))
        sys.stdout.buffer.write(header + checksum + luma + struct.pack("<4sI", b"PCFE", number & 0xFFFFFFFF))
        sys.stdout.buffer.flush()
        number += 1


if __name__ == "__main__":
    main()
