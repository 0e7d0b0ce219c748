"""Images that several processes need: the first generates them, the others read them from a folder.

Land takes four seconds to generate, longer than many short flights over it. An environment variable names the folder.
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]

# A folder, of one checkout's programs only: an image is identified by its name, not by the code that generated it.
FOLDER_VARIABLE = "POINTCLICK_DRAWINGS"


def kept(name: str, draw: Callable[[], list[Image]]) -> list[Image]:
    """Return the pictures that `draw` makes, float32, any shapes, from the folder if they are kept there.

    Without a folder they are generated each time.
    """
    folder = os.environ.get(FOLDER_VARIABLE)
    if not folder:
        return draw()
    path = Path(folder) / f"{name}.npz"
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not path.is_file():
            half = path.with_suffix(".half.npz")
            np.savez(half, *draw())
            half.replace(path)  # whole or not at all
    with np.load(path) as found:
        return [np.asarray(found[f"arr_{i}"], np.float32) for i in range(len(found))]
