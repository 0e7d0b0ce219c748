"""Pictures as the compressed pictures that a camera with an encoder of its own hands out: by the system's Python, `-I`.

On standard input one line of JSON: `frames` (a file of raw grey pictures), `out`, `width`, `height`, `rate_hz`,
`bit_rate`, `codec` (H264, H265). Each picture is a four-byte length, little-endian, and what the encoder made of it.
"""

import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from recoding import ENCODERS, Gst, compressed


def main() -> None:
    spec = json.loads(sys.stdin.readline())
    Gst.init(None)
    with Path(spec["out"]).open("wb") as out:
        for buffer in compressed(spec, ENCODERS[spec["codec"]]):
            size = buffer.get_size()
            out.write(size.to_bytes(4, "little") + buffer.extract_dup(0, size))


if __name__ == "__main__":
    main()
