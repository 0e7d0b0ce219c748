"""The documentation as a static site in build/docs/site, which opens from a folder, search too: `make docs`.

Zensical builds it out of a copy of the pages, laid out as in the checkout so that their links hold. Node's packages,
which `make web` has installed in frontend/, hold the script with which a browser searches in a folder.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
OUT = ROOT / "build" / "docs"
PAGES = OUT / "pages"
SITE = OUT / "site"
CONFIG = ROOT / "packaging" / "zensical.toml"
SHIM = ROOT / "frontend" / "node_modules" / "iframe-worker" / "shim" / "index.js"
SHIM_FETCHED = "https://unpkg.com/iframe-worker/shim"
"""The address from which a page of Zensical's would fetch that script when it is opened."""


def gather() -> None:
    """Copy the pages and their pictures into an empty `PAGES`, and what Zensical is to do next to it."""
    shutil.rmtree(OUT, ignore_errors=True)
    for pattern in ("*.md", "docs/*.md", "docs/images/*", "benchmarks/*.md", "examples/*", "config.toml"):
        for file in ROOT.glob(pattern):
            copied = PAGES / file.relative_to(ROOT)
            copied.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(file, copied)
    shutil.copy2(CONFIG, OUT)


def build() -> None:
    """Build `SITE` out of `PAGES`; nothing of it is fetched when it is read."""
    subprocess.run([sys.executable, "-m", "zensical", "build", "--strict", "-f", OUT / CONFIG.name], check=True)
    shutil.copy2(SHIM, SITE / "assets" / "iframe-worker.js")
    for page in SITE.rglob("*.html"):
        up = "../" * len(page.relative_to(SITE).parent.parts)
        text = page.read_text(encoding="utf-8")
        page.write_text(text.replace(SHIM_FETCHED, f"{up}assets/iframe-worker.js"), encoding="utf-8")


if __name__ == "__main__":
    gather() if sys.argv[1:] == ["gather"] else build()
