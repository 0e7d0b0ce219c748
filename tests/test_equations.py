"""Code and docs/mathematics.md cite each other: no number in the code that is not derived, none derived in vain."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DOCUMENT = ROOT / "docs" / "mathematics.md"
FOLDERS = ("contract", "onboard", "ground", "simulation", "benchmarks")
# A formula's own number ends an indented line; between parentheses nothing but the number.
DEFINED = re.compile(r"^    .*\s{2,}\(([0-9]+\.[0-9]+)\)$", re.MULTILINE)
NUMBER = r"\(([1-9][0-9]?\.[0-9]{1,2})\)"
# Prose cites: in a docstring or comment the number stands after a blank or an opening parenthesis; a call has its
# name before it.
CITED = re.compile(rf"(?<![\w)\]]){NUMBER}")
RANGE = re.compile(rf"{NUMBER} to {NUMBER}")


def defined() -> list[str]:
    return DEFINED.findall(DOCUMENT.read_text())


def citations(text: str, known: set[str]) -> set[str]:
    """Numbers cited, ranges spelt out."""
    out = set(CITED.findall(text))
    for first, last in RANGE.findall(text):
        section, low, high = first.split(".")[0], int(first.split(".")[1]), int(last.split(".")[1])
        assert last.startswith(section + ".")
        out |= {f"{section}.{n}" for n in range(low, high + 1)} & known
    return out


def sources() -> list[Path]:
    return [path for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*.py"))]


def test_every_number_is_given_once_and_in_order() -> None:
    numbers = [tuple(int(part) for part in number.split(".")) for number in defined()]
    assert len(numbers) >= 50
    assert numbers == sorted(set(numbers))
    for section in range(1, 15):
        of_section = [minor for major, minor in numbers if major == section]
        assert of_section == list(range(1, len(of_section) + 1)), f"section {section} skips a number"


def test_every_equation_cited_in_the_code_is_in_the_document() -> None:
    known = set(defined())
    unknown = {
        f"{path.relative_to(ROOT)}: ({number})"
        for path in sources()
        for number in citations(path.read_text(), known) - known
    }
    assert not unknown


def test_every_equation_is_cited_somewhere() -> None:
    known = set(defined())
    cited = set().union(*(citations(path.read_text(), known) for path in sources()))
    for page in sorted((ROOT / "docs").rglob("*.md")):
        cited |= citations(DEFINED.sub("", page.read_text()), known)
    assert not known - cited


def test_sections_named_in_the_code_exist() -> None:
    headings = set(re.findall(r"^## ([0-9]+) ", DOCUMENT.read_text(), re.MULTILINE))
    assert headings == {str(n) for n in range(1, 20)}
    for path in sources():
        text = " ".join(path.read_text().split())
        for first, second in re.findall(
            r"[Ss]ection ([0-9]+) of docs/mathematics|docs/mathematics\.md,? section ([0-9]+)", text
        ):
            assert (first or second) in headings, path
