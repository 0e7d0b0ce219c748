"""Files of tests are rewritten before the workers need them, and what is kept is what a worker would have made."""

import sys
from pathlib import Path

import pytest

from tests.rewriting import kept_code, rewrite_once


def test_a_file_is_rewritten_once_as_pytest_does_it(
    pytestconfig: pytest.Config, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    source = tmp_path / "test_two.py"
    source.write_text("def test_two() -> None:\n    assert 1 + 1 == 2\n")
    rewrite_once(pytestconfig, [source])
    kept = kept_code(source)
    assert b"@pytest_ar" in kept.read_bytes()
    kept.write_bytes(whole := kept.read_bytes())
    before = kept.stat().st_mtime_ns
    rewrite_once(pytestconfig, [source])
    assert (kept.stat().st_mtime_ns, kept.read_bytes()) == (before, whole)
