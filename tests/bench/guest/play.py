"""Inside the guest: plays pictures into a loopback camera at the moments they were taken.

`play.py DEVICE PICTURES.json FIRST_NS`: the description names the raw pictures next to it (one after the other), their
format, sizes in bytes and times after the first; FIRST_NS is when, on the guest's CLOCK_MONOTONIC, the first is taken.
Each is handed over `delay_ns` after that moment and carries the moment itself, as an exposure's. Pictures whose time
has passed are left out, not hurried. The last line is `played N of M`.
"""

import json
import sys
import time
from pathlib import Path

from tests.bench.v4l2 import Output


def main() -> None:
    device, description, first_ns = sys.argv[1], Path(sys.argv[2]), int(sys.argv[3])
    flight = json.loads(description.read_text())
    width_px, height_px = flight["size_px"]
    played = 0
    with (
        Output(device, flight["fourcc"], width_px, height_px, flight["rate_hz"]) as camera,
        description.with_suffix(".raw").open("rb") as raw,
    ):
        print("open", flush=True)
        for size, after_ns in zip(flight["bytes"], flight["after_ns"], strict=True):
            stamp_ns = first_ns + after_ns
            wait_s = (stamp_ns + flight["delay_ns"] - time.monotonic_ns()) / 1e9
            picture = raw.read(size)
            if wait_s < -flight["late_s"]:
                continue
            time.sleep(max(wait_s, 0.0))
            camera.put(picture, stamp_ns)
            played += 1
        time.sleep(0.5)
    print(f"played {played} of {len(flight['bytes'])}")


if __name__ == "__main__":
    main()
