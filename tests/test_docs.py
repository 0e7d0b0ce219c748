"""The pages: files, pages and sections that they name exist, and none but a reference is long."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from contract.feature_set import Measured, Status
from demo.__main__ import HEADER, head_text, row_text

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
TOPS = "contract|onboard|ground|simulation|demo|benchmarks|training|tests|docs|systemd|packaging"
# A path in backticks from the root on, without a placeholder.
PATH = re.compile(rf"`((?:{TOPS})/[\w./-]*\w)`")
LINK = re.compile(r"\]\(([\w./-]+\.md)(?:#[\w-]+)?\)")
ANCHOR = re.compile(r"\]\(([\w./-]+\.md)?#([\w-]+)\)")
FENCED = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
# Tables, pictures with their captions, and indented code.
NO_PROSE = re.compile(r"\s*\||!\[| {4}(?! )")
CODE = (
    "contract", "onboard", "ground", "simulation", "demo", "benchmarks", "training", "tests", "examples", "packaging",
    "systemd",
)  # fmt: skip
CODE_SUFFIXES = {".py", ".toml", ".ts", ".html", ".service"}
NAMED_IN_CODE = re.compile(r"\bdocs/[a-z][\w-]*\.md\b")

MOST_WORDS = 1500
REFERENCE = re.compile(r"(wire-format|mathematics.*|glossary|architecture|licences)\.md")
"""Pages in which one looks something up: they may be of any length."""


def prose(text: str) -> list[str]:
    """The words of a page without its tables, code and captions."""
    lines = [line for line in FENCED.sub("", text).splitlines() if not NO_PROSE.match(line)]
    return re.findall(r"\S*\w\S*", re.sub(r"\]\([^)]*\)", "]", "\n".join(lines)))


def anchors(page: Path) -> set[str]:
    """The sections of a page as a link names them, where GitHub and the site (Python-Markdown) give the same name."""
    heads = re.findall(r"^#+ (.*)", FENCED.sub("", page.read_text(encoding="utf-8")), re.MULTILINE)
    plain = [re.sub(r"[^\w\s-]", "", re.sub(r"\]\([^)]*\)", "]", head)).strip().lower() for head in heads]
    return {name.replace(" ", "-") for name in plain if name.isascii() and not re.search(r"[\s-]{2}", name)}


@pytest.mark.parametrize(
    ("pattern", "least", "is_there"),
    [
        pytest.param(PATH, 100, lambda _, path: (ROOT / path).exists(), id="files and folders"),
        pytest.param(LINK, 20, lambda page, link: (page.parent / link).exists(), id="pages by links"),
        pytest.param(
            ANCHOR, 10, lambda page, link: link[1] in anchors(page.parent / link[0] if link[0] else page), id="sections"
        ),
    ],
)
def test_what_the_pages_name_is_there(
    pattern: re.Pattern[str], least: int, is_there: Callable[[Path, Any], bool]
) -> None:
    named = {(page, found) for page in PAGES for found in pattern.findall(page.read_text(encoding="utf-8"))}
    assert len(named) > least
    missing = [f"{page.relative_to(ROOT)}: {found}" for page, found in sorted(named) if not is_there(page, found)]
    assert not missing, "\n".join(missing)


def test_every_page_has_one_place_in_the_contents_of_the_site() -> None:
    places = re.findall(r'"((?:docs/)?[\w-]+\.md)"', (ROOT / "packaging" / "zensical.toml").read_text(encoding="utf-8"))
    pages = {str(page.relative_to(ROOT)) for page in PAGES} | {"docs/modules.md", "CHANGELOG.md"}
    assert sorted(places) == sorted(pages)


def test_pages_that_the_code_names_exist() -> None:
    files = [ROOT / "config.toml", *(path for top in CODE for path in (ROOT / top).rglob("*"))]
    texts = {file: file.read_text(encoding="utf-8") for file in files if file.suffix in CODE_SUFFIXES}
    named = {(file, page) for file, text in texts.items() for page in NAMED_IN_CODE.findall(text)}
    assert len(named) > 50
    made = {"docs/modules.md"}  # by `make docs`
    missing = [f"{file.relative_to(ROOT)}: {page}" for file, page in sorted(named) if not (ROOT / page).exists()]
    assert not [line for line in missing if line.partition(": ")[2] not in made], "\n".join(missing)


def test_a_page_is_read_in_a_few_minutes() -> None:
    counts = {
        page.stem: len(prose(page.read_text(encoding="utf-8"))) for page in PAGES if not REFERENCE.match(page.name)
    }
    long = [f"{name}: {n} words" for name, n in counts.items() if n > MOST_WORDS]
    assert not long, "\n".join(long)


def test_tables_code_and_captions_are_no_prose() -> None:
    page = "# A head\n\nOne [link](there.md#x), `two` words.\n\n| a | b |\n|---|---|\n\n![A caption](x.jpg)\n\n"
    assert len(prose(page + "```\nno = 1\n```\n\n    indented too\n")) == 6


@pytest.mark.parametrize(
    ("section", "words"),
    [
        ("# ", [status.value for status in Status if status is not Status.OK]),
        ("## Not measured", [word.value for word in Measured if word is not Measured.MEASURED]),
    ],
)
def test_every_refusal_and_every_reason_not_to_measure_has_one_row(section: str, words: list[str]) -> None:
    page = (ROOT / "docs" / "refusals.md").read_text(encoding="utf-8")
    part = page[page.index(section) :].split("\n## ")[0]
    assert sorted(re.findall(r"^\| `([\w ]+)` \|", part, re.MULTILINE)) == sorted(words)


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
