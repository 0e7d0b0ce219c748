"""docs/modules.md out of the docstrings: `python -m tests.module_map` writes it, test_architecture.py compares."""

from __future__ import annotations

import ast
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "modules.md"
SENTENCE = re.compile(r"(?<=[.:])\s+(?=[A-Z0-9`(])")
HEAD = """# Modules

Every shipped module with the first sentence of its docstring, and every file of the page with its first comment.
Generated: `python -m tests.module_map`. What the packages are for, and how data flow through them:
[architecture.md](architecture.md). A package imports only those named below its heading, and `contract`.
"""


def first_sentence(text: str) -> str:
    """The first sentence of a docstring's or comment's first paragraph, without what would end a table's cell."""
    paragraph = " ".join(text.strip().split("\n\n")[0].split())
    return SENTENCE.split(paragraph)[0].rstrip(".:").replace("|", "\\|")


def of_python(path: Path) -> str:
    return first_sentence(ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or "")


def of_typescript(path: Path) -> str:
    lines = path.read_text(encoding="utf-8").splitlines()
    comment = []
    for line in lines:
        if not line.startswith("//"):
            break
        comment.append(line.removeprefix("//").strip())
    return first_sentence("\n".join(comment))


def section(package: str, imports: set[str]) -> list[str]:
    folder = ROOT.joinpath(*package.split("."))
    files = sorted(file for file in folder.glob("*.py") if file.name != "__init__.py")
    heading = f"## {package.replace('.', '/')}/"
    allowed = f"Imports: {', '.join(sorted(imports))}." if imports else "Imports none of the others."
    rows = [f"| `{file.stem}` | {of_python(file)} |" for file in files]
    return [
        heading,
        "",
        f"{of_python(folder / '__init__.py')}. {allowed}",
        "",
        "| module | what |",
        "|---|---|",
        *rows,
        "",
    ]


def page(arrows: dict[str, set[str]], shipped: tuple[str, ...]) -> str:
    """The page's text. `arrows`: package -> packages that it may import."""
    lines = [HEAD]
    for package, imports in arrows.items():
        if package.split(".")[0] in shipped:
            lines += section(package, imports)
    files = sorted(f for f in (ROOT / "frontend" / "src").glob("*.ts") if not f.name.endswith(".d.ts"))
    lines += ["## frontend/src/", "", "The page of `pc-ground web` (TypeScript), bundled by `make web`.", ""]
    lines += ["| file | what |", "|---|---|", *(f"| `{f.stem}` | {of_typescript(f)} |" for f in files), ""]
    return "\n".join(lines)


if __name__ == "__main__":
    from tests.test_architecture import ARROWS, SHIPPED

    PAGE.write_text(page(ARROWS, SHIPPED), encoding="utf-8")
