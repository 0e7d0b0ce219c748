"""The build backend: the page is built where it is missing or old, and an installation without npm still succeeds."""

import importlib
import os
import sys
from pathlib import Path
from types import ModuleType

import pytest

PACKAGING = Path(__file__).resolve().parents[1] / "packaging"


@pytest.fixture
def backend(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The backend in a checkout of a page with one source."""
    monkeypatch.syspath_prepend(str(PACKAGING))
    monkeypatch.delitem(sys.modules, "with_page", raising=False)
    module = importlib.import_module("with_page")
    monkeypatch.setattr(module, "FRONTEND", tmp_path / "frontend")
    monkeypatch.setattr(module, "PAGE", tmp_path / "static" / "index.html")
    (tmp_path / "frontend" / "src").mkdir(parents=True)
    (tmp_path / "frontend" / "src" / "main.ts").write_text("")
    (tmp_path / "static").mkdir()
    return module


def test_the_page_is_due_where_it_is_missing_or_older_than_a_source(backend: ModuleType) -> None:
    assert backend.is_page_due()
    backend.PAGE.write_text("")
    os.utime(backend.PAGE, (2e9, 2e9))
    assert not backend.is_page_due()
    os.utime(backend.PAGE, (1e9, 1e9))
    assert backend.is_page_due()
    (backend.FRONTEND / "src" / "main.ts").unlink()  # of a source archive: as it was packed
    assert not backend.is_page_due()


def test_node_is_fetched_for_the_build_only_where_it_is_needed(
    backend: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    for has_node, wanted in ((True, []), (False, [backend.NODE_OF_PYPI])):
        monkeypatch.setattr(backend, "has_node", lambda has_node=has_node: has_node)
        assert [line for line in backend.get_requires_for_build_wheel() if "nodejs" in line] == wanted
    backend.PAGE.write_text("")
    assert not [line for line in backend.get_requires_for_build_wheel() if "nodejs" in line]


@pytest.mark.parametrize(
    ("npm", "printed"),
    [([], "there is no npm"), (["sh", "-c", "echo 'npm error no network'; exit 1"], "npm error no network")],
)
def test_a_wheel_without_its_page_is_made_and_says_so_in_a_line(
    backend: ModuleType,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    npm: list[str],
    printed: str,
) -> None:
    monkeypatch.setattr(backend, "find_npm", lambda: (npm, os.environ["PATH"]))
    monkeypatch.setattr(backend.build_meta, "build_wheel", lambda *_: "pointclick.whl")
    assert backend.build_wheel("there") == "pointclick.whl"
    complaint = capsys.readouterr().err
    assert printed in complaint and "without the page" in complaint and complaint.count("\n") == 1
