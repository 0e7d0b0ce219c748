"""The picture around a click, small enough to be kept with the pin."""

from __future__ import annotations

import io
import warnings

from PIL import Image

SIDE_SHARE = 0.2  # of the picture's width, that the crop shows
SIDE_PX = 160
MAX_PIXELS = 40_000_000
QUALITY = 80


def crop(content: bytes, u_px: float, v_px: float, camera_size_px: tuple[int, int]) -> bytes | None:
    """A square WebP about a pixel of the camera, from a picture of any size; None if the picture cannot be read."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with Image.open(io.BytesIO(content)) as picture:
                if picture.width * picture.height > MAX_PIXELS:
                    return None
                picture.draft("RGB", (1280, 1280))  # a large JPEG is decoded at a part of its size
                x = (u_px + 0.5) * picture.width / camera_size_px[0]
                y = (v_px + 0.5) * picture.height / camera_size_px[1]
                half = 0.5 * SIDE_SHARE * picture.width
                box = round(x - half), round(y - half), round(x + half), round(y + half)
                out = io.BytesIO()
                picture.convert("RGB").crop(box).resize((SIDE_PX, SIDE_PX), Image.Resampling.BILINEAR).save(
                    out, "WEBP", quality=QUALITY, method=0
                )
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError, Warning):
        return None
    return out.getvalue()
