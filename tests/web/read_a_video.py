"""Run with the extra `video` alone (tests/test_install.py): a video is written, read, and its frames' size printed."""

import sys
import time

import cv2
import numpy as np

from ground.web.video_frames import Ring
from ground.web.video_reader import VideoReader

if __name__ == "__main__":
    path = sys.argv[1]
    out = cv2.VideoWriter(path, cv2.VideoWriter_fourcc(*"MJPG"), 10.0, (64, 48))
    for grey in range(8):
        out.write(np.full((48, 64, 3), 20 * grey, np.uint8))
    out.release()
    ring = Ring()
    reader = VideoReader(path, ring)
    end_s = time.monotonic() + 60.0
    while not ring.frames()[1] and time.monotonic() < end_s:
        time.sleep(0.01)
    print(ring.frames()[1][0].size_px)
    reader.close()
