"""The asserts of all test files rewritten once, before the workers begin: each would rewrite every file by itself."""

import multiprocessing
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest
from _pytest.assertion import rewrite

PROCESSES = 2


def rewrite_once(config: pytest.Config, files: Sequence[Path]) -> None:
    """Keep the rewritten code of `files` where pytest looks for it (`__pycache__`), if it may be written there.

    A file whose kept code is of its time and size is left as it is. Rewriting is two thirds of what collecting takes.
    """
    if sys.dont_write_bytecode:
        return
    fork = multiprocessing.get_context("fork")
    shares = [fork.Process(target=_rewrite, args=(config, files[first::PROCESSES])) for first in range(PROCESSES)]
    for share in shares:
        share.start()
    for share in shares:
        share.join()


def _rewrite(config: pytest.Config, files: Sequence[Path]) -> None:
    for source in files:
        kept = kept_code(source)
        if rewrite.try_makedirs(kept.parent) and rewrite._read_pyc(source, kept) is None:
            stat, code = rewrite._rewrite_test(source, config)
            rewrite._write_pyc(config.stash[rewrite.assertstate_key], code, stat, kept)


def kept_code(source: Path) -> Path:
    """The file in which pytest keeps the rewritten code of `source`."""
    return rewrite.get_cache_dir(source) / (source.name.removesuffix(".py") + rewrite.PYC_TAIL)
