"""What the pages name exists: files by their paths, and configuration keys."""

from __future__ import annotations

import re
from pathlib import Path

from contract.feature_set import Status
from onboard.config.schema import key_table

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
TOPS = "contract|onboard|ground|simulation|demo|benchmarks|tests|docs|systemd|packaging"
# A path in backticks from the root on, without a placeholder.
PATH = re.compile(rf"`((?:{TOPS})/[\w./-]*\w)`")
LINK = re.compile(r"\]\(([\w./-]+\.md)(?:#[\w-]+)?\)")


def test_files_and_folders_that_the_pages_name_exist() -> None:
    named = {(page, path) for page in PAGES for path in PATH.findall(page.read_text(encoding="utf-8"))}
    assert len(named) > 100
    missing = [f"{page.relative_to(ROOT)}: {path}" for page, path in sorted(named) if not (ROOT / path).exists()]
    assert not missing, "\n".join(missing)


def test_links_between_the_pages_lead_somewhere() -> None:
    links = {(page, link) for page in PAGES for link in LINK.findall(page.read_text(encoding="utf-8"))}
    assert len(links) > 20
    missing = [f"{page.relative_to(ROOT)}: {link}" for page, link in sorted(links) if not (page.parent / link).exists()]
    assert not missing, "\n".join(missing)


def test_every_refusal_has_one_row_in_the_readme() -> None:
    rows = re.findall(r"^\| `(\w+)` \|", (ROOT / "README.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert sorted(rows) == sorted(status.value for status in Status if status is not Status.OK)


def test_the_keys_with_older_words_are_keys() -> None:
    """The glossary explains them for as long as the configuration has them, and no longer."""
    text = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8").partition("## Keys with older words")[2]
    named = set(re.findall(r"`(\w+\.\w+)`", text))
    older = {key for key in key_table() if re.search(r"wander|relief|slip", key)}
    assert named == older
