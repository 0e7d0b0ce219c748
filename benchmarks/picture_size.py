"""What keyframes of a folder of pictures take on the link, and to make.

    python -m benchmarks.picture_size [FOLDER]

Without a folder: the simulated leg of the other benchmarks (`simulated`); photographs have more to compress.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import cv2
import numpy as np

from benchmarks.short_flight import leg_folder
from onboard.config.schema import PictureConfig
from onboard.link.picture_sender import small_image

FORMATS = ("webp", "jpeg")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--most", type=int, default=10, help="pictures, spread over the folder")
    parser.add_argument("--qualities", type=int, nargs="+", default=[30])
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    folder = leg_folder() / "frames" if arguments.folder is None else arguments.folder
    files = sorted(f for f in folder.iterdir() if f.suffix.lower() in (".jpg", ".jpeg", ".png"))
    chosen = files[:: max(len(files) // arguments.most, 1)][: arguments.most]
    images = [i.astype(np.uint8) for f in chosen if (i := cv2.imread(str(f), cv2.IMREAD_GRAYSCALE)) is not None]
    if not images:
        parser.error(f"{folder}: no pictures in it")
    print(f"{len(images)} pictures of {images[0].shape[1]}x{images[0].shape[0]} px; bytes, and processor time each\n")
    print(f"| longer side, quality | {' | '.join(FORMATS)} |\n|---|{'---|' * len(FORMATS)}")
    for max_px in (320, 480, 640):
        for quality in arguments.qualities:
            cells = []
            for kind in FORMATS:
                section = PictureConfig(format=kind, max_px=max_px, quality=quality)  # type: ignore[arg-type]
                began_s = time.process_time()
                size = sum(len(small_image(image, section)[0]) for image in images) / len(images)
                took_ms = 1e3 * (time.process_time() - began_s) / len(images)
                cells.append(f"{size:.0f} B, {took_ms:.1f} ms")
            print(f"| {max_px}, {quality} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
