"""The modules that tests of the code's own text read, each parsed once."""

import ast
from functools import cache
from pathlib import Path


@cache
def parsed(path: Path) -> ast.Module:
    """The syntax tree of a file, not to be changed."""
    return ast.parse(path.read_text(encoding="utf-8"))
