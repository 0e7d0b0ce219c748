"""Where the workers of one run keep the flights that they share."""

import fcntl
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

FLIGHTS_VARIABLE = "POINTCLICK_TEST_FLIGHTS"
_OWN = TemporaryDirectory(prefix="flights-")


def flights_folder() -> Path:
    """The run's, or this process's own where none is named."""
    return Path(os.environ.get(FLIGHTS_VARIABLE) or _OWN.name)


def kept(name: str, make: Callable[[Path], object]) -> Path:
    """The folder that `make` fills, not to be written to: once in a run, whichever worker needs it first."""
    folder = flights_folder() / name
    whole = folder.with_suffix(".whole")
    with folder.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not whole.exists():
            shutil.rmtree(folder, ignore_errors=True)  # a worker may have died over it
            make(folder)
            whole.touch()
    return folder
