"""Where what was built is kept: one folder per artefact, named by a key of all that went into it."""

import fcntl
import hashlib
import os
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

KEPT_OF_A_KIND = 4
"""Several checkouts share the cache, each with its own lock file and guest; older artefacts go."""

_started_s = time.monotonic()


def folder() -> Path:
    """The cache: $POINTCLICK_BENCH_CACHE, or ~/.cache/pointclick-bench."""
    named = os.environ.get("POINTCLICK_BENCH_CACHE")
    return (Path(named) if named else Path.home() / ".cache" / "pointclick-bench").resolve()


def say(text: str) -> None:
    print(f"[bench {time.monotonic() - _started_s:5.0f} s] {text}", flush=True)


def key_of(*parts: str | bytes) -> str:
    """A short name for everything that goes into an artefact."""
    digest = hashlib.sha256()
    for part in parts:
        raw = part.encode() if isinstance(part, str) else part
        digest.update(len(raw).to_bytes(8, "big") + raw)
    return digest.hexdigest()[:12]


def artefact(kind: str, key: str, build: Callable[[Path], None]) -> Path:
    """The folder of an artefact, built if it is not there yet.

    `build` fills an empty folder; only a finished one gets its name, so an interrupted build leaves nothing that looks
    whole. Two runs at once wait for each other instead of building twice.
    """
    done = folder() / f"{kind}-{key}"
    with _lock(kind):
        if not done.is_dir():
            work = folder() / f"{kind}.building"
            shutil.rmtree(work, ignore_errors=True)
            work.mkdir(parents=True)
            started_s = time.monotonic()
            say(f"{kind}: building")
            build(work)
            work.rename(done)
            say(f"{kind}: built in {time.monotonic() - started_s:.0f} s")
        os.utime(done)
        _drop_old(kind)
    return done


def _drop_old(kind: str) -> None:
    present = sorted(folder().glob(f"{kind}-*"), key=lambda path: path.stat().st_mtime, reverse=True)
    for old in present[KEPT_OF_A_KIND:]:
        shutil.rmtree(old)


@contextmanager
def _lock(kind: str) -> Iterator[None]:
    folder().mkdir(parents=True, exist_ok=True)
    with (folder() / f"{kind}.lock").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
