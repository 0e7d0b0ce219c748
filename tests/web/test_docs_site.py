"""`make docs`: every page as a site that opens from a folder, search too, and fetches nothing from the network."""

import re
import subprocess
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import pytest

from tests.waiting import eventually

ROOT = Path(__file__).resolve().parents[2]
pytestmark = pytest.mark.xdist_group("web")


@pytest.fixture(scope="module")
def site() -> Path:
    done = subprocess.run(["make", "docs"], cwd=ROOT, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    return ROOT / "build" / "docs" / "site"


def pages(site: Path) -> dict[Path, str]:
    return {page: page.read_text(encoding="utf-8") for page in site.rglob("*.html") if page.name != "404.html"}


@pytest.mark.long
def test_every_page_is_in_the_site_and_in_its_contents(site: Path) -> None:
    start = (site / "index.html").read_text(encoding="utf-8")
    written = {f"docs/{page.stem}.html" for page in (ROOT / "docs").glob("*.md")} | {"docs/modules.html"}
    assert written <= set(re.findall(r'href="\./([\w./-]+\.html)"', start))
    assert "<code>pose_noise</code>" not in start  # it lists pages, not modules
    modules = (site / "docs" / "modules.html").read_text(encoding="utf-8")
    assert modules.count("<tr>") > 300


@pytest.mark.long
def test_links_within_the_site_lead_somewhere(site: Path) -> None:
    there, links = pages(site), 0
    for page, text in there.items():
        for link in re.findall(r'href="([^"#:]*)(?:#[^"]*)?"', text):
            links += 1
            assert not link or (page.parent / unquote(link)).resolve().exists(), f"{page.relative_to(site)}: {link}"
    assert links > 1000


@pytest.mark.long
def test_nothing_is_fetched_from_elsewhere_and_the_search_in_a_folder_finds_a_word(site: Path, chromium: Any) -> None:
    context = chromium.new_context()
    asked: list[str] = []
    context.on("request", lambda request: asked.append(request.url))
    try:
        page = context.new_page()
        page.goto((site / "index.html").as_uri())
        page.keyboard.press("/")
        page.keyboard.type("low_parallax")
        assert eventually(lambda: "When there is no answer" in page.content()), "the search found nothing"
    finally:
        context.close()
    assert not [url for url in asked if url.startswith("http")]
