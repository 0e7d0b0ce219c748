"""Words that people who learned English at school, or know the field, do not expect: how often each may still occur.

A word counts wherever it occurs: in text, and as a part of an identifier (`heard_at`, `ServerContext`). A limit may go
down, never up: where one of these is the right word after all ("reading a file"), another occurrence has become plain.
"""

import re
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
CODE = "onboard", "ground", "contract", "simulation", "frontend/src", "config.toml"
SUFFIXES = {".py", ".ts", ".html", ".css", ".toml"}
GENERATED = {"static", "__pycache__", "node_modules"}
PLAIN = {
    "say": "specify, report, state", "says": "specifies, reports, states", "said": "specified, reported, stated",
    "tell": "report, determine, distinguish", "tells": "reports, determines", "told": "known, given, reported",
    "belief": "prior, estimate", "believe": "accept", "believes": "accepts", "believed": "accepted, estimated",
    "desk": "server context, service", "beside": "next to, with, relative to", "heard": "received",
    "hear": "receive", "hears": "receives", "flown": "simulated, travelled, recorded", "drawn": "sampled, rendered",
    "sight": "observation", "alike": "equal, correlated", "anew": "again", "nobody": "no one, nothing",
    "reading": "hypothesis", "lasting": "persistent, correlated", "carrier": "mount", "errs": "is off",
    "strayed": "deviated", "strays": "deviates", "foretold": "predicted", "foretell": "predict",
    "wander": "correlated error, drift", "wanders": "drifts", "lately": "recently",
}  # fmt: skip
MOST = {
    "code": {
        "say": 1, "says": 0, "said": 4, "tell": 2, "tells": 0, "told": 0, "belief": 0, "believe": 0, "believes": 0,
        "believed": 0, "desk": 0, "beside": 0, "heard": 4, "hear": 0, "hears": 0, "flown": 2, "drawn": 7,
        "sight": 1, "alike": 0, "anew": 2, "nobody": 0, "reading": 17, "lasting": 0, "carrier": 0, "errs": 0,
        "strayed": 0, "strays": 0, "foretold": 0, "foretell": 0, "wander": 4, "wanders": 0, "lately": 0,
    },
    "tests": {
        "say": 93, "says": 194, "said": 57, "tell": 26, "tells": 34, "told": 54, "belief": 7, "believe": 2,
        "believes": 5, "believed": 23, "desk": 2, "beside": 21, "heard": 19, "hear": 6, "hears": 11, "flown": 107,
        "drawn": 197, "sight": 7, "alike": 17, "anew": 3, "nobody": 17, "reading": 10, "lasting": 7, "carrier": 6,
        "errs": 13, "strayed": 4, "strays": 2, "foretold": 0, "foretell": 0, "wander": 9, "wanders": 6,
        "lately": 0,
    },
    "benchmarks": {
        "say": 19, "says": 1, "said": 74, "tell": 7, "tells": 1, "told": 6, "belief": 0, "believe": 0,
        "believes": 0, "believed": 5, "desk": 0, "beside": 5, "heard": 3, "hear": 7, "hears": 0, "flown": 2,
        "drawn": 10, "sight": 4, "alike": 0, "anew": 0, "nobody": 0, "reading": 1, "lasting": 0, "carrier": 0,
        "errs": 0, "strayed": 5, "strays": 0, "foretold": 0, "foretell": 0, "wander": 10, "wanders": 0,
        "lately": 0,
    },
}  # fmt: skip


def words_of(text: str) -> Counter[str]:
    """Every word of a text in small letters; identifiers count as the words that they are made of."""
    return Counter(word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", text))


def files_in(places: Iterable[str]) -> list[Path]:
    """The texts in some folders, or the files themselves."""
    found = [p for place in places for p in ([ROOT / place] if (ROOT / place).is_file() else (ROOT / place).rglob("*"))]
    return sorted(
        path for path in found if path.suffix in SUFFIXES and not GENERATED & set(path.parts) and path != Path(__file__)
    )


def too_many(part: str, files: Iterable[Path]) -> list[str]:
    """A line for each word that occurs more often in these files than it may."""
    found: Counter[str] = Counter()
    where: dict[str, Counter[str]] = {word: Counter() for word in PLAIN}
    for path in files:
        counts = words_of(path.read_text(encoding="utf-8"))
        found.update(counts)
        for word in PLAIN.keys() & counts.keys():
            where[word][str(path.relative_to(ROOT))] += counts[word]
    return [
        f"{word!r}: {found[word]} times in {part}, at most {most}; rather: {PLAIN[word]}; most of them in "
        + ", ".join(f"{name} ({count})" for name, count in where[word].most_common(3))
        for word, most in MOST[part].items()
        if found[word] > most
    ]


PARTS = {"code": CODE, "tests": ("tests",), "benchmarks": ("benchmarks", "demo", "examples", "training")}


@pytest.mark.parametrize("part", PARTS)
def test_plain_words_stay(part: str) -> None:
    files = files_in(PARTS[part])
    assert files
    exceeded = too_many(part, files)
    assert not exceeded, "\n".join(exceeded)


@pytest.mark.parametrize("part", PARTS)
def test_every_word_has_a_limit_in_every_part(part: str) -> None:
    assert MOST[part].keys() == PLAIN.keys()


def test_words_are_found_inside_identifiers() -> None:
    text = "heard_at HeardSpots _SAID_S unheard 'what it said' isDrawn aforesaid"
    found = words_of(text)
    assert (found["heard"], found["said"], found["drawn"]) == (2, 2, 1)


def test_one_more_than_allowed_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(f"{__name__}.ROOT", tmp_path)
    path = tmp_path / "more.py"
    path.write_text("heard = 1\n" * (MOST["code"]["heard"] + 1))
    (line,) = too_many("code", [path])
    assert line.startswith("'heard': ") and "received" in line and "more.py" in line
