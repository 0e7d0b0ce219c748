"""The tables of docs/licences.md are what the installed packages state; none is under the GPL."""

import re
from importlib.metadata import distribution
from pathlib import Path

import pytest

from tests.installed import declared, extras, needed
from tests.locked import versions

ROOT = Path(__file__).resolve().parents[1]
ROW = re.compile(r"^\| ([\w.-]+) \| ([^|]+) \|$", re.MULTILINE)
GPL = re.compile(r"(?<!L)GPL|(?<!Lesser )(?<!Library )General Public License", re.IGNORECASE)


def locked() -> set[str]:
    return set(versions())


def flying() -> set[str]:
    """What runs: the base and every extra but `dev`."""
    return set(needed(declared(*sorted(extras() - {"dev"}))))


def licence(name: str) -> str:
    """What a package's metadata says: the expression, else the classifiers, else the first words of its licence."""
    metadata = distribution(name).metadata
    if expression := metadata.get("License-Expression"):
        return str(expression)
    classifiers = [c.split(" :: ")[-1] for c in metadata.get_all("Classifier") or [] if c.startswith("License ::")]
    return " or ".join(classifiers) or str(metadata.get("License") or "?").splitlines()[0]


def tables() -> tuple[dict[str, str], dict[str, str]]:
    """Package -> licence: the table of what runs, and the table of what only development needs."""
    text = (ROOT / "docs" / "licences.md").read_text(encoding="utf-8")
    runs, _, develops = text.partition("Only for development")
    read = [{name: reported for name, reported in ROW.findall(part) if name != "package"} for part in (runs, develops)]
    return read[0], read[1]


def test_the_page_names_every_package_that_runs_with_its_licence() -> None:
    wanted = {name: licence(name) for name in flying()}
    assert tables()[0] == wanted, "\n".join(f"| {name} | {wanted[name]} |" for name in sorted(wanted))


def test_the_page_names_every_package_of_development_with_its_licence() -> None:
    wanted = {name: licence(name) for name in locked() - flying()}
    assert tables()[1] == wanted, "\n".join(f"| {name} | {wanted[name]} |" for name in sorted(wanted))


def test_the_lock_holds_everything_that_runs() -> None:
    assert flying() <= locked()


def test_no_dependency_is_under_the_gpl() -> None:
    assert not {name: licence(name) for name in locked() | flying() if GPL.search(licence(name))}


@pytest.mark.parametrize(
    ("words", "is_gpl"),
    [
        ("GPL-3.0-or-later", True),
        ("GNU General Public License v3 (GPLv3)", True),
        ("GNU Affero General Public License v3", True),
        ("AGPL-3.0-only", True),
        ("MIT OR GPL-2.0", True),
        ("LGPLv3", False),
        ("GNU Lesser General Public License v3 (LGPLv3)", False),
        ("MPL-2.0", False),
        ("Apache-2.0 OR BSD-3-Clause", False),
    ],
)
def test_the_gpl_is_known_by_its_names(words: str, is_gpl: bool) -> None:
    assert bool(GPL.search(words)) is is_gpl


def test_the_pages_say_whose_choice_the_projects_own_licence_is() -> None:
    for page in ("README.md", "docs/licences.md"):
        assert "still to be chosen by its owner" in " ".join((ROOT / page).read_text(encoding="utf-8").split())


def test_whose_pictures_the_net_is_made_from_is_stated_where_it_goes() -> None:
    for page in ("docs/licences.md", "onboard/spots/weights/MODEL_CARD.md"):
        text = " ".join((ROOT / page).read_text(encoding="utf-8").split())
        assert all(words in text for words in ("HIT-UAV", "Suo et al.", "Scientific Data 10, 227 (2023)", "CC BY 4.0"))
