"""The asserts of all test files rewritten once, before the workers begin: each would rewrite every file by itself.

What was rewritten is kept for the next clone on this machine, as mypy's cache is: a file is known by its content.
"""

import hashlib
import marshal
import multiprocessing
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from types import CodeType

import pytest
from _pytest.assertion import rewrite

PROCESSES = 2
MOST = 1000  # contents that are kept, of some four hundred files: 45 MB
KEPT = Path.home() / ".cache" / "pointclick" / f"rewritten{rewrite.PYC_TAIL.removesuffix('.pyc')}"


def rewrite_once(config: pytest.Config, files: Sequence[Path], kept: Path = KEPT) -> None:
    """Write the rewritten code of `files` where pytest looks for it (`__pycache__`), if it may be written there.

    A file whose code there is of its time and size is left as it is. Rewriting is two thirds of what collecting takes,
    and what `kept` has of an earlier run is not rewritten.
    """
    if sys.dont_write_bytecode:
        return
    old = [source for source in files if rewrite._read_pyc(source, kept_code(source)) is None]
    known = _read(kept) if old else {}
    unknown = [source for source in old if not _is_written(config, source, known.get(_digest(source)))]
    fork = multiprocessing.get_context("fork")
    shares = [fork.Process(target=_rewrite, args=(config, unknown[first::PROCESSES])) for first in range(PROCESSES)]
    for share in shares if unknown else ():
        share.start()
    for share in shares if unknown else ():
        share.join()
    if unknown:
        _keep(kept, known, old, unknown)


def _rewrite(config: pytest.Config, files: Sequence[Path]) -> None:
    for source in files:
        code = kept_code(source)
        if rewrite.try_makedirs(code.parent):
            rewrite._write_pyc(config.stash[rewrite.assertstate_key], *_rewritten(config, source), code)


def _rewritten(config: pytest.Config, source: Path) -> tuple[CodeType, os.stat_result]:
    stat, code = rewrite._rewrite_test(source, config)
    return code, stat


def _is_written(config: pytest.Config, source: Path, known: CodeType | None) -> bool:
    """Write the code that is known of a file's content; it names the file itself, wherever it was first."""
    code = kept_code(source)
    if known is None or not rewrite.try_makedirs(code.parent):
        return False
    return rewrite._write_pyc(config.stash[rewrite.assertstate_key], _moved(known, str(source)), source.stat(), code)


def _moved(code: CodeType, filename: str) -> CodeType:
    constants = (_moved(value, filename) if isinstance(value, CodeType) else value for value in code.co_consts)
    return code.replace(co_filename=filename, co_consts=tuple(constants))


def _digest(source: Path) -> bytes:
    return hashlib.sha256(source.read_bytes()).digest()


def _read(kept: Path) -> dict[bytes, CodeType]:
    """Return the rewritten code by content; nothing where the file is missing or no such file."""
    try:
        found = marshal.loads(kept.read_bytes())
    except (OSError, ValueError, EOFError, TypeError):
        return {}
    return found if isinstance(found, dict) else {}


def _keep(kept: Path, known: dict[bytes, CodeType], used: Sequence[Path], new: Sequence[Path]) -> None:
    """Replace the file at once, for several clones may write it; contents that were used long ago go."""
    now = {digest: known.pop(digest) for digest in map(_digest, used) if digest in known}
    codes = known | now | {_digest(file): code for file in new if (code := rewrite._read_pyc(file, kept_code(file)))}
    half = kept.with_name(f"{kept.name}.{os.getpid()}")
    try:
        kept.parent.mkdir(parents=True, exist_ok=True)
        half.write_bytes(marshal.dumps(dict(list(codes.items())[-MOST:])))
        half.replace(kept)
    except OSError:
        half.unlink(missing_ok=True)  # the next clone rewrites them again


def kept_code(source: Path) -> Path:
    """The file in which pytest keeps the rewritten code of `source`."""
    return rewrite.get_cache_dir(source) / (source.name.removesuffix(".py") + rewrite.PYC_TAIL)
