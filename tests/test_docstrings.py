"""A docstring begins with a verb or a noun phrase, and every public function of more than one statement has one.

"Return the age", "The age", and not "How old it is": a clause without a head states neither what a name is nor what it
does.
"""

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from tests.parsed import parsed

pytestmark = pytest.mark.xdist_group("the code's own text")  # one worker: each file is parsed once
ROOT = Path(__file__).resolve().parents[1]
PARTS = {
    "contract": 0.02, "ground": 0.02, "onboard": 0.02, "simulation": 0.02, "demo": 0.02, "benchmarks": 0.02,
    "packaging": 0.02, "training": 0.02,
}  # fmt: skip
"""The largest share of docstrings that may begin with such a clause; quotations and names are some of them."""
CLAUSE = {
    "as", "at", "by", "does", "for", "from", "how", "if", "in", "is", "it", "of", "on", "that", "those", "to", "what",
    "when", "where", "whether", "which", "who", "whose", "why", "with",
}  # fmt: skip
Function = ast.FunctionDef | ast.AsyncFunctionDef


@cache
def definitions(part: str) -> tuple[list[tuple[str, str]], list[str]]:
    """Places with their docstrings; and the public functions of more than one statement that have none."""
    found, silent = [], []
    for path in sorted((ROOT / part).rglob("*.py")):
        tree, name = parsed(path), path.relative_to(ROOT)
        for node in ast.walk(tree):
            if isinstance(node, Function | ast.ClassDef | ast.Module) and (text := ast.get_docstring(node)):
                found.append((f"{name}:{getattr(node, 'lineno', 1)}", text))
        for node in public_functions(tree):
            if len(node.body) > 1 and ast.get_docstring(node) is None and not has_summary(node):
                silent.append(f"{name}:{node.lineno}: {node.name}")
    return found, silent


def begins_with_a_clause(docstring: str) -> bool:
    first = re.match(r"[A-Za-z]+", docstring)
    return first is not None and first.group().lower() in CLAUSE


@pytest.mark.parametrize("part", PARTS)
def test_docstrings_begin_with_a_verb_or_a_noun_phrase(part: str) -> None:
    found, _ = definitions(part)
    clauses = [f"{place}: {text.splitlines()[0]}" for place, text in found if begins_with_a_clause(text)]
    assert len(clauses) <= PARTS[part] * len(found), "\n".join(clauses)


def public_functions(tree: ast.AST) -> Iterator[Function]:
    """Functions of a module and methods of its classes, not those within functions."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, Function) and not node.name.startswith("_"):
            yield node
        elif isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            yield from public_functions(node)


def has_summary(node: Function) -> bool:
    """Return whether it is a route that the API's definition describes by its decorator's summary."""
    calls = [decorator for decorator in node.decorator_list if isinstance(decorator, ast.Call)]
    return any(keyword.arg == "summary" for call in calls for keyword in call.keywords)


@pytest.mark.parametrize("part", ["contract", "ground", "onboard", "simulation"])
def test_a_public_function_of_more_than_one_statement_has_a_docstring(part: str) -> None:
    _, silent = definitions(part)
    assert not silent, "\n".join(silent)


@pytest.mark.parametrize(
    ("docstring", "is_clause"),
    [("Whether it is closed.", True), ("What it holds.", True), ("Return whether it is closed.", False),
     ("The state.", False), ("Offset of it.", False), ("`what` it is.", False)],
)  # fmt: skip
def test_a_clause_is_known_by_its_first_word(docstring: str, is_clause: bool) -> None:
    assert begins_with_a_clause(docstring) is is_clause
