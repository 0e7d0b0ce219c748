"""Pictures that others sent or wrote, decoded no larger than is asked. Pillow, of an extra, is imported when used."""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable
from typing import Any, TypeVar

T = TypeVar("T")


def decoded(content: bytes, most_pixels: int, use: Callable[[Any], T]) -> T | None:
    """Return what `use` makes of a picture (Pillow's); None for what is no picture, or has more pixels.

    Raises ImportError without Pillow.
    """
    from PIL import Image  # noqa: PLC0415

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with Image.open(io.BytesIO(content)) as picture:
                return None if picture.width * picture.height > most_pixels else use(picture)
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError, Warning):
        return None
