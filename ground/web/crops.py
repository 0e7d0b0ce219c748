"""The picture around a click, small enough to be kept with the pin."""

from __future__ import annotations

import io
import threading
from collections import OrderedDict
from collections.abc import Callable

from PIL import Image

from ground.bounded_picture import decoded

SIDE_SHARE = 0.2  # of the picture's width, that the crop shows
SIDE_PX = 160
MAX_PIXELS = 40_000_000
DECODED_PX = 1280  # a larger JPEG is decoded at a part of its size
KEPT = 4  # decoded pictures: an operator clicks the same one several times
QUALITY = 80


class Cropper:
    """Thread-safe. The pictures clicked last are kept decoded, which costs more than all else of a crop."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._kept: OrderedDict[tuple[str, int | None, int], Image.Image] = OrderedDict()

    def crop(
        self,
        key: tuple[str, int | None, int],
        read: Callable[[], bytes | None],
        u_px: float,
        v_px: float,
        camera_size_px: tuple[int, int],
    ) -> bytes | None:
        """A square WebP about a pixel of the camera, from a picture of any size; None if there is none to be read.

        `key`: the picture's vehicle, session and frame; `read` gives its content, encoded.
        """
        with self._lock:
            picture = self._kept.get(key)
        if picture is None:
            content = read()
            picture = None if content is None else decoded(content, MAX_PIXELS, _reduced)
            if picture is None:
                return None
            with self._lock:
                self._kept[key] = picture
                while len(self._kept) > KEPT:
                    self._kept.popitem(last=False)
        x = (u_px + 0.5) * picture.width / camera_size_px[0]
        y = (v_px + 0.5) * picture.height / camera_size_px[1]
        half = 0.5 * SIDE_SHARE * picture.width
        box = round(x - half), round(y - half), round(x + half), round(y + half)
        out = io.BytesIO()
        square = picture.crop(box).resize((SIDE_PX, SIDE_PX), Image.Resampling.BILINEAR)
        square.save(out, "WEBP", quality=QUALITY, method=0)
        return out.getvalue()


def _reduced(picture: Image.Image) -> Image.Image:
    """The picture's colours, a large JPEG's at a part of its size."""
    picture.draft("RGB", (DECODED_PX, DECODED_PX))
    reduced = picture.convert("RGB")
    reduced.thumbnail((2 * DECODED_PX, 2 * DECODED_PX))
    return reduced
