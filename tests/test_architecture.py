"""The arrows of docs/architecture.md, read from the imports themselves."""

import ast
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterable, Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path
from typing import NamedTuple

import pytest

from tests import module_map
from tests.parsed import parsed

pytestmark = pytest.mark.xdist_group("the code's own text")  # one worker: each file is parsed once
ROOT = Path(__file__).resolve().parents[1]
MAX_LINES = 600  # what belongs together stays together; functions are kept short by ruff

# Every package -> the packages that it may import. `contract` may be imported by all. Read top to bottom as data flows.
ARROWS: dict[str, set[str]] = {
    "contract": set(),
    "contract.mavlink_camera": set(),
    "contract.wire": set(),
    "ground": set(),
    "ground.pins": {"ground", "ground.spots"},
    "ground.formats": {"ground", "ground.pins", "ground.spots"},
    "ground.seen": set(),
    "ground.spots": {"ground", "ground.seen"},
    "ground.commands": {"ground", "ground.pins", "ground.formats", "ground.seen", "ground.spots"},
    "ground.web": {"ground", "ground.pins", "ground.formats", "ground.seen", "ground.spots"},
    "onboard.events": set(),
    "onboard.camera_files": {"calibration"},
    "onboard.config": {"camera_files"},
    "onboard.clocks": set(),
    "onboard.camera": {"events", "config", "clocks"},
    "onboard.telemetry": {"events", "config", "clocks"},
    "onboard.navigation": {"events", "config"},
    "onboard.geometry": set(),
    "onboard.vision": {"geometry"},
    "onboard.estimation": {"geometry", "navigation", "config"},
    "onboard.georeferencing": {"estimation", "geometry", "navigation", "config"},
    "onboard.pipeline": {"georeferencing", "estimation", "vision", "geometry", "navigation", "events", "config"},
    "onboard.tracks": {"geometry", "events"},
    "onboard.measured": {"geometry", "events"},
    "onboard.spots": {"events", "config"},
    "onboard.foreign_clock": {"vision", "geometry", "navigation", "telemetry", "events", "config"},
    "onboard.link": {"events", "config"},
    "onboard.storage": {"events", "config", "estimation", "geometry"},
    "onboard.replay": {
        "pipeline", "tracks", "spots", "camera", "telemetry", "storage", "events", "config", "foreign_clock",
    },
    "onboard.service": {"pipeline", "tracks", "measured", "spots", "storage", "events", "config"},
    "onboard.calibration": set(),
    "onboard.commands": {
        "calibration", "camera", "camera_files", "config", "events", "foreign_clock", "link", "pipeline", "replay",
        "service", "storage", "telemetry",
    },
    "onboard": {"commands", "config", "link"},  # __main__: arguments and exit codes
    "simulation": set(),
    "simulation.autopilot": {"simulation"},
    "demo": {"onboard", "ground", "simulation"},
    "benchmarks": {"onboard", "ground", "simulation", "tests"},
    "training": {"onboard.spots"},
}  # fmt: skip
# The error study simulates the estimator itself; the rest of the simulation knows nothing of what it tests.
STUDY = re.compile(r"simulation\.study\w*")
# What the outside world is reached through, and the only packages that may.
IO_PACKAGES = {
    "argparse", "asyncio", "concurrent", "fcntl", "http", "mavsdk", "mcap", "prometheus_client", "pymavlink", "queue",
    "select", "serial", "signal", "socket", "subprocess", "threading", "tqdm", "zenoh",
}  # fmt: skip
IO_ALLOWED = {
    "ground", "ground.commands", "ground.pins", "ground.web", "onboard", "onboard.camera", "onboard.telemetry",
    "onboard.link", "onboard.storage", "onboard.replay",
    "onboard.service", "onboard.commands", "onboard.events", "simulation", "simulation.autopilot", "demo", "benchmarks",
    "training",
}  # fmt: skip
# One kind of thread for both sides, neither of which may import the other.
IO_MODULES = {"contract.callback_threads", "contract.supervised_thread", "ground.spots.received"}
CHANGING = {"add", "append", "clear", "discard", "extend", "insert", "pop", "remove", "reverse", "sort", "update"}
# Attributes of other classes with a name that a `Window` or a `Record` has too.
SAME_NAMES = {
    "TimedStandingParts.seen", "buffer.memory", "out.solved", "request.memory", "self._statistics.keyframes",
}  # fmt: skip
SHIPPED = ("contract", "ground", "onboard")


class Import(NamedTuple):
    """One imported module with the names taken from it, and whether it is only loaded inside of a function."""

    module: str
    names: tuple[str, ...]
    is_lazy: bool

    @property
    def top(self) -> str:
        return self.module.split(".")[0]


def modules(*tops: str) -> list[str]:
    """Dotted names of every module below some top-level packages."""
    files = sorted(file for top in tops for file in (ROOT / top).rglob("*.py"))
    return [".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__") for file in files]


def path_of(module: str) -> Path:
    file = ROOT.joinpath(*module.split("."))
    return file / "__init__.py" if file.is_dir() else file.with_suffix(".py")


def package_of(module: str) -> str:
    return module if (ROOT / Path(*module.split("."))).is_dir() else module.rpartition(".")[0]


@cache
def imports(module: str) -> tuple[Import, ...]:
    """Everything a module imports, type-checking blocks included: an arrow is an arrow."""

    def visit(node: ast.AST, is_lazy: bool) -> Iterator[Import]:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.Import):
                yield from (Import(alias.name, (), is_lazy) for alias in child.names)
            elif isinstance(child, ast.ImportFrom):
                assert child.level == 0, f"{module}: relative import"
                base = child.module or ""
                plain = [a.name for a in child.names if not path_of(f"{base}.{a.name}").is_file()]
                if plain:
                    yield Import(base, tuple(plain), is_lazy)
                # `from onboard.storage import mcap_writer` means the module.
                yield from (Import(f"{base}.{a.name}", (), is_lazy) for a in child.names if a.name not in plain)
            else:
                lazy = is_lazy or isinstance(child, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda))
                yield from visit(child, lazy)

    return tuple(visit(parsed(path_of(module)), False))


@cache
def docstring_of(module: str) -> str:
    return ast.get_docstring(parsed(path_of(module))) or ""


def is_allowed(importer: str, imported: str) -> bool:
    """Whether a module may import another of this project."""
    one, other = package_of(importer), package_of(imported)
    if one == other or other.split(".")[0] == "contract":
        return one.split(".")[0] != "contract" or other.split(".")[0] == "contract"
    if STUDY.fullmatch(importer) and other.split(".")[0] == "onboard":
        return True
    allowed = ARROWS.get(one, set())
    return other in allowed or other.split(".")[0] in allowed or other.removeprefix("onboard.") in allowed


def broken_arrows(all_modules: Iterable[str]) -> list[str]:
    """One line for every import that the table does not allow."""
    tops = {name.split(".")[0] for name in ARROWS} | {"tests"}
    return [
        f"{path_of(m).relative_to(ROOT)} imports {i.module}: {package_of(m)} may import only "
        f"{', '.join(sorted(ARROWS.get(package_of(m), set()))) or 'nobody'} (and contract)"
        for m in all_modules
        for i in imports(m)
        if i.top in tops and not is_allowed(m, i.module)
    ]


def attributes_of(name: str, module: str) -> set[str]:
    """The names of a class's attributes: those that it declares, and those that its methods assign."""
    tree = parsed(path_of(module))
    body = next(n for n in tree.body if isinstance(n, ast.ClassDef) and n.name == name)
    stored = [n for n in ast.walk(body) if isinstance(n, ast.Attribute) and isinstance(n.ctx, ast.Store)]
    declared = {n.target.id for n in body.body if isinstance(n, ast.AnnAssign) and isinstance(n.target, ast.Name)}
    return declared | {n.attr for n in stored if ast.unparse(n.value) == "self"}


def changed_from_outside(tree: ast.AST, attributes: set[str]) -> Iterator[ast.Attribute]:
    """The attributes of these names, but for those of `self`, that are assigned, deleted, or changed in place."""
    for node in ast.walk(tree):
        changed: ast.AST = node
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in CHANGING:
            changed = node.func.value
        elif not isinstance(getattr(node, "ctx", None), (ast.Store, ast.Del)):
            continue
        while isinstance(changed, ast.Subscript):
            changed = changed.value
        if isinstance(changed, ast.Attribute) and changed.attr in attributes and ast.unparse(changed.value) != "self":
            yield changed


EVERY = modules("contract", "ground", "onboard", "simulation", "demo", "benchmarks", "training")


def test_no_import_runs_against_the_arrows() -> None:
    assert not (broken := broken_arrows(EVERY)), "\n".join(broken)


def test_every_package_is_in_the_table_and_the_table_has_no_others() -> None:
    assert {package_of(m) for m in EVERY} == set(ARROWS)


def test_the_arrows_run_one_way() -> None:
    """No package reaches itself again by following arrows."""
    reach = {p: {a if a in ARROWS else f"onboard.{a}" for a in to} for p, to in ARROWS.items()}
    for package, first in reach.items():
        seen: set[str] = set()
        ahead = set(first)
        while ahead:
            seen |= ahead
            ahead = {b for a in ahead for b in reach.get(a, set())} - seen
        assert package not in seen, f"{package} reaches itself"


def test_a_broken_arrow_is_named() -> None:
    assert is_allowed("onboard.vision.klt_tracker", "onboard.geometry.plane_homography")
    assert not is_allowed("onboard.geometry.plane_fit", "onboard.vision.klt_tracker")
    assert not is_allowed("ground.click", "onboard.config.schema")
    assert not is_allowed("contract.camera", "ground.click")
    assert not is_allowed("simulation.flight", "onboard.config.schema")
    seen = {i.module: i for i in imports("onboard.__main__")}
    assert not seen["argparse"].is_lazy
    assert seen["onboard.commands.replay"].is_lazy


def test_only_packages_that_meet_the_world_know_sockets_threads_and_command_lines() -> None:
    found = [
        f"{path_of(m).relative_to(ROOT)} imports {i.module}: {package_of(m)} is not in IO_ALLOWED"
        for m in EVERY
        for i in imports(m)
        if i.top in IO_PACKAGES and package_of(m) not in IO_ALLOWED and m not in IO_MODULES
    ]
    assert not found, "\n".join(found)


def test_the_base_install_needs_numpy_and_zenoh_alone() -> None:
    """`contract` NumPy; `ground` zenoh besides; what an extra brings is imported only where it is used.

    `ground.web` is that place for the extra `web`: its `command` and `startup` alone are loaded without it.
    """
    without_extra = {"ground.web.command", "ground.web.startup"}
    allowed = {"contract": {"numpy"}, "ground": {"numpy", "zenoh"}}
    page = {"fastapi", "pydantic", "starlette", "uvicorn", "segno", "PIL"}
    own = {name.split(".")[0] for name in ARROWS}
    found = [
        f"{path_of(m).relative_to(ROOT)} imports {i.module}"
        for m in modules("contract", "ground")
        for i in imports(m)
        if not i.is_lazy
        and i.top not in own | set(sys.stdlib_module_names) | allowed[m.split(".")[0]]
        and not (package_of(m) == "ground.web" and m not in without_extra and i.top in page)
    ]
    assert not found, "\n".join(found)


def test_no_modules_import_each_other_in_a_circle() -> None:
    """Imports within functions and for types count too: a circle shows that something lies in the wrong module."""
    known = set(EVERY)
    needs = {
        m: {
            name
            for i in imports(m)
            for name in [n for n in (f"{i.module}.{n}" for n in i.names) if n in known] or [i.module]
            if name in known - {m}
        }
        for m in EVERY
    }
    assert sum(map(len, needs.values())) > 1000
    list(TopologicalSorter(needs).static_order())  # CycleError names one


def test_a_window_and_a_record_are_changed_by_their_own_methods_alone() -> None:
    held = attributes_of("Window", "onboard.estimation.sliding_window")
    held |= attributes_of("Record", "onboard.pipeline.record_book")
    assert held >= {"keyframes", "solved", "terrain", "_times_s", "placed", "is_settled"}
    found = [
        f"{path_of(m).relative_to(ROOT)}:{a.lineno} changes {ast.unparse(a)}"
        for m in modules("onboard", "simulation", "demo", "benchmarks")
        for a in changed_from_outside(parsed(path_of(m)), held)
        if ast.unparse(a) not in SAME_NAMES
    ]
    assert not found, "\n".join(found)


def test_nothing_heavy_is_loaded_by_importing_the_ground() -> None:
    heavy = (
        "{'cv2', 'scipy', 'mavsdk', 'pymavlink', 'mcap', 'pydantic', "
        "'PIL', 'fastapi', 'uvicorn', 'matplotlib', 'onboard', 'simulation'}"
    )
    check = f"import sys, ground.__main__, ground.client, ground.web.command; print(sorted({heavy} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", check], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_no_file_is_longer_than_one_thing() -> None:
    lengths = {m: len(path_of(m).read_text(encoding="utf-8").splitlines()) for m in [*EVERY, *modules("tests")]}
    assert not {m: n for m, n in lengths.items() if n > MAX_LINES}


def test_what_is_installed_is_what_ships() -> None:
    """A folder that `pyproject.toml` does not list works in a checkout and is missing once installed."""
    listed = set(tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"])
    assert listed == {package_of(m) for m in modules(*SHIPPED)}


def test_what_packages_take_from_each_other_is_public() -> None:
    """Names that cross a border are listed in the docstring of the package that they come from."""
    found = []
    for m in modules("onboard"):
        for i in imports(m):
            home = package_of(i.module)
            if i.top != "onboard" or home == package_of(m) or home == "onboard":
                continue
            listed = docstring_of(home)
            missing = [n for n in i.names or (i.module.rpartition(".")[2],) if not re.search(rf"\b{n}\b", listed)]
            found += [f"{m} takes {i.module}.{n}, which {home}'s docstring does not list" for n in missing]
    assert not found, "\n".join(found)


def test_every_module_has_a_first_sentence_in_the_list_of_modules() -> None:
    rows = module_map.page(ARROWS, SHIPPED).splitlines()
    assert len(rows) > 300
    silent = [line for line in rows if line.endswith("|  |")]
    assert not silent, "no docstring: " + ", ".join(silent)


def test_every_package_is_in_the_architecture() -> None:
    """docs/architecture.md has a row for each package that ships."""
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    rows = set(re.findall(r"^\| `([\w/]+)/` \|", text, re.MULTILINE))
    packages = {p.replace(".", "/") for p in ARROWS if p.split(".")[0] in SHIPPED}
    assert rows >= packages | {"frontend"}, packages - rows
