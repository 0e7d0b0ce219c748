"""Code and docs/mathematics.md cite each other: no number in the code that is not derived, none derived in vain."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
# Sections that belong to single programs have pages of their own.
PAGES = ("", "-budget", "-camera", "-clock", "-pins", "-seen", "-tracks", "-spots", "-measured")
DOCUMENTS = [ROOT / "docs" / f"mathematics{part}.md" for part in PAGES]
FOLDERS = ("contract", "onboard", "ground", "simulation", "benchmarks")
# A formula's own number ends an indented line; between parentheses nothing but the number.
DEFINED = re.compile(r"^    .*\s{2,}\(([0-9]+\.[0-9]+)\)$", re.MULTILINE)
SECTION = re.compile(r"^## ([0-9]+) ", re.MULTILINE)
NUMBER = r"\(([1-9][0-9]?\.[0-9]{1,2})\)"
# Prose cites: in a docstring or comment the number stands after a blank or an opening parenthesis; a call has its
# name before it.
CITED = re.compile(rf"(?<![\w)\]]){NUMBER}")
RANGE = re.compile(rf"{NUMBER} to {NUMBER}")


def defined() -> list[str]:
    """Every number, page by page in the order of the pages' first sections."""
    return [number for page in DOCUMENTS for number in DEFINED.findall(page.read_text())]


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


def misnumbered(texts: list[str]) -> list[str]:
    """What is wrong with the pages' numbers: each stands in the section it names, once, and counts on from 1."""
    wrong, sections = [], []
    for text in texts:
        heads = list(SECTION.finditer(text))
        for head, end in zip(heads, [*(head.start() for head in heads[1:]), len(text)], strict=True):
            sections.append(int(head[1]))
            numbers = DEFINED.findall(text[head.start() : end])
            due = [f"{head[1]}.{k}" for k in range(1, len(numbers) + 1)]
            wrong += [f"({number}) where ({k}) is due" for number, k in zip(numbers, due, strict=True) if number != k]
            wrong += [] if numbers else [f"section {head[1]} has no equation"]
    if sorted(sections) != list(range(1, len(sections) + 1)):
        wrong.append(f"sections {sections}")
    return wrong


def test_every_number_is_given_once_and_in_order() -> None:
    assert not misnumbered([page.read_text() for page in DOCUMENTS])
    assert len(defined()) >= 100


def test_a_number_that_is_skipped_given_twice_or_in_another_section_is_found_in_every_section() -> None:
    texts = [page.read_text() for page in DOCUMENTS]
    for number in defined():
        section, k = number.split(".")
        for other in (f"{section}.{int(k) + 1}", f"{int(section) + 1}.{k}"):
            own = re.compile(rf"\({re.escape(number)}\)$", re.MULTILINE)
            assert misnumbered([own.sub(f"({other})", text) for text in texts]), number


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
    headings = {number for page in DOCUMENTS for number in SECTION.findall(page.read_text())}
    assert headings
    for path in sources():
        text = " ".join(path.read_text().split())
        for first, second in re.findall(
            r"[Ss]ection ([0-9]+) of docs/mathematics|docs/mathematics\.md,? section ([0-9]+)", text
        ):
            assert (first or second) in headings, path
