"""What the pages name exists: files by their paths, and configuration keys."""

from __future__ import annotations

import re
from pathlib import Path

from contract.feature_set import Status
from demo.__main__ import HEADER, head_text, row_text

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


def test_every_refusal_has_one_row_on_its_page() -> None:
    rows = re.findall(r"^\| `(\w+)` \|", (ROOT / "docs" / "refusals.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert sorted(rows) == sorted(status.value for status in Status if status is not Status.OK)


def test_the_readme_shows_the_demo_s_table_as_the_demo_prints_it() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert text.count(HEADER) == 1
    rows = text.partition(f"{HEADER}\n")[2].partition("```")[0].splitlines()
    assert len(rows) >= 2
    for row in rows:
        spot, *numbers = re.findall(r"^\s*\w+|-?\d+(?:\.\d+)?", row)
        frame, u, v, lat, lon, height, radius, error = map(float, numbers)
        head = head_text(spot.strip(), int(frame), int(u), int(v))
        assert row == row_text(head, (lat, lon, height), radius, error)
