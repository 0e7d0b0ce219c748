"""`camera.mask`: where something is burned into every picture, an on-screen display or the frame of a lens."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from contract.errors import InputError
from onboard.camera.pixel_formats import UNDECODABLE

DARK = 128  # grey below which a pixel is burned in
LEAST_SHARE = 0.1  # of the picture that must be left


def read_mask(path: Path | str | None, size_px: tuple[int, int]) -> NDArray[np.bool_] | None:
    """(H, W), true where something is burned in; None without a file. Raises InputError for what is no such mask."""
    if path is None:
        return None
    try:
        with Image.open(path) as image:
            size = image.size
            grey = np.asarray(image.convert("L"))
    except UNDECODABLE as error:
        raise InputError(f"camera.mask: {path}: {getattr(error, 'strerror', None) or 'no picture'}") from error
    if size != size_px:
        seen, own = ("x".join(map(str, s)) for s in (size, size_px))
        raise InputError(f"camera.mask: {path} is {seen}; the camera file is for {own}")
    burned_in = grey < DARK
    left = 1.0 - float(burned_in.mean())
    if left < LEAST_SHARE:
        raise InputError(f"camera.mask: {path} leaves {100.0 * left:.0f} % of the picture: the ground is white in it")
    return burned_in
