"""Files of tests are rewritten before the workers need them, and what is kept is what a worker would have made."""

import os
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import CodeType

import pytest

from tests import rewriting
from tests.rewriting import kept_code, rewrite_once

REWRITE = rewriting._rewrite


class InThisProcess:
    """Stands for a process that is begun and ended, and does what it is to do here."""

    def __init__(self, target: Callable[..., object], args: tuple[object, ...]) -> None:
        self.start = partial(target, *args)

    @staticmethod
    def Process(target: Callable[..., object], args: tuple[object, ...]) -> "InThisProcess":
        return InThisProcess(target, args)

    def join(self) -> None:
        pass


def test_a_file_is_rewritten_once_as_pytest_does_it(
    pytestconfig: pytest.Config, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    source = tmp_path / "test_two.py"
    source.write_text("def test_two() -> None:\n    assert 1 + 1 == 2\n")
    rewrite_once(pytestconfig, [source], tmp_path / "kept")
    kept = kept_code(source)
    assert b"@pytest_ar" in kept.read_bytes()
    kept.write_bytes(whole := kept.read_bytes())
    before = kept.stat().st_mtime_ns
    rewrite_once(pytestconfig, [source], tmp_path / "kept")
    assert (kept.stat().st_mtime_ns, kept.read_bytes()) == (before, whole)


@pytest.mark.parametrize("damage", ["", "not a code", "missing"])
def test_another_clone_has_what_was_rewritten_of_the_same_content_under_its_own_name(
    pytestconfig: pytest.Config, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, damage: str
) -> None:
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    kept = tmp_path / "home" / "kept"
    codes, rewritten = [], []
    monkeypatch.setattr(rewriting, "_rewrite", lambda config, files: rewritten.extend(files) or REWRITE(config, files))
    monkeypatch.setattr(rewriting.multiprocessing, "get_context", lambda kind: InThisProcess)
    for clone in ("one", "two"):
        source = tmp_path / clone / "test_two.py"
        source.parent.mkdir()
        source.write_text("def test_two() -> None:\n    assert 1 + 1 == 2\n")
        os.utime(source, (1e9 + len(codes), 1e9 + len(codes)))
        rewrite_once(pytestconfig, [source], kept)
        code = rewriting.rewrite._read_pyc(source, kept_code(source))
        assert code is not None
        (inner,) = (value for value in code.co_consts if isinstance(value, CodeType))
        codes.append((code.co_filename, inner.co_filename, code.co_code))
        if damage == "missing":
            kept.unlink()
        elif damage:
            kept.write_text(damage)
    assert codes == [(str(file), str(file), codes[0][2]) for file in sorted(tmp_path.glob("*/test_two.py"))]
    assert len(rewritten) == (2 if damage else 1)
    assert rewriting._read(kept) or damage


def test_contents_that_were_used_long_ago_go_first(
    pytestconfig: pytest.Config, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    monkeypatch.setattr(rewriting, "MOST", 2)
    monkeypatch.setattr(rewriting.multiprocessing, "get_context", lambda kind: InThisProcess)
    kept, sources = tmp_path / "kept", [tmp_path / f"test_{name}.py" for name in ("one", "two", "three")]
    for source in sources:
        source.write_text(f"{source.stem} = 1\n")
    one, two, three = sources
    rewrite_once(pytestconfig, [one, two], kept)
    kept_code(one).unlink()
    rewrite_once(pytestconfig, [one, three], kept)
    assert {code.co_names[-1] for code in rewriting._read(kept).values()} == {"test_one", "test_three"}
