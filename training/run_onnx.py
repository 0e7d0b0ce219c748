"""The net as it is used in flight: read from ONNX by OpenCV's dnn, one thread."""

from __future__ import annotations

import time
from hashlib import sha256
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from training.labelled_pictures import Grey
from training.net_input import level_of, net_input

Maps = NDArray[np.float32]


class OnnxNet:
    """A net read from a file; `seconds` lists how long each picture's forward pass took."""

    def __init__(self, path: Path) -> None:
        self._net = cv2.dnn.readNetFromONNX(str(path))
        self.seconds: list[float] = []
        self._known: dict[bytes, Maps] = {}

    def maps_once(self, grey: Grey) -> Maps:
        """Return the maps of a picture, from memory if it has been looked at before."""
        key = sha256(grey.tobytes()).digest()
        if key not in self._known:
            self._known[key] = self.maps(grey)
        return self._known[key]

    def maps(self, grey: Grey) -> Maps:
        """Return the maps (7, H/4, W/4) of a picture (H, W) whose sides are multiples of 16."""
        inputs = net_input(grey, level_of(grey))[None]
        start = time.perf_counter()
        self._net.setInput(inputs)
        out: Maps = np.array(self._net.forward(), dtype=np.float32)[0]
        self.seconds.append(time.perf_counter() - start)
        return out
