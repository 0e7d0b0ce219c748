"""The arrows of docs/architecture.md, read from the imports themselves."""

from __future__ import annotations

import ast
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

HOUSE = Path(__file__).resolve().parents[1]
ROOMS = {"contract", "ground", "onboard", "simulation", "demo", "benchmarks"}
MAX_LINES = 450

# Files that belong to another's room: it alone knows them.
PART_OF = {"onboard.backlog": "onboard.publisher"}
# Rooms of the aircraft that meet the world: files, links, clocks. Only the plumbing may know them.
IO_ROOMS = {
    "onboard.camera", "onboard.telemetry", "onboard.publisher", "onboard.recording", "onboard.terrain_files",
    "onboard.credentials", "onboard.replay_recording", *PART_OF,
    "onboard.state_file", "onboard.notify", "onboard.intake", "onboard.prometheus", "onboard.service_log",
    "onboard.recent", "onboard.host", "onboard.ask_daemon", "onboard.config_files",
}  # fmt: skip
PLUMBING = {
    "onboard.__main__", "onboard.daemon", "onboard.session", "onboard.replay", "onboard.replay_command",
    "onboard.run_command", "onboard.status_command", "onboard.doctor", "onboard.doctor_command", "onboard.recorded",
    "onboard.cameras_command", "onboard.calibrate_command",
}  # fmt: skip
# What the outside world is reached through. None of it belongs in a room of mathematics.
IO_PACKAGES = {
    "argparse", "asyncio", "concurrent", "fcntl", "http", "linuxpy", "mavsdk", "mcap", "pymavlink", "queue", "select",
    "serial", "signal", "socket", "subprocess", "threading", "tqdm", "zenoh",
}  # fmt: skip


class Import(NamedTuple):
    """One imported module, and whether it is only loaded inside of a function."""

    name: str
    is_lazy: bool

    @property
    def package(self) -> str:
        return self.name.split(".")[0]


def modules(*rooms: str) -> list[str]:
    """Dotted names of every module in some rooms."""
    files = sorted(file for room in rooms for file in (HOUSE / room).rglob("*.py"))
    return [".".join(file.relative_to(HOUSE).with_suffix("").parts).removesuffix(".__init__") for file in files]


def path_of(module: str) -> Path:
    file = HOUSE.joinpath(*module.split("."))
    return file / "__init__.py" if file.is_dir() else file.with_suffix(".py")


def imports(module: str) -> Iterator[Import]:
    """Everything a module imports, type-checking blocks included: an arrow is an arrow."""

    def visit(node: ast.AST, is_lazy: bool) -> Iterator[Import]:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.Import):
                yield from (Import(alias.name, is_lazy) for alias in child.names)
            elif isinstance(child, ast.ImportFrom):
                assert child.level == 0, f"{module}: relative import"
                base = child.module or ""
                yield Import(base, is_lazy)
                # `from onboard import tracking` means the module onboard.tracking.
                yield from (
                    Import(f"{base}.{alias.name}", is_lazy)
                    for alias in child.names
                    if base.split(".")[0] in ROOMS and path_of(f"{base}.{alias.name}").is_file()
                )
            else:
                lazy = is_lazy or isinstance(child, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda))
                yield from visit(child, lazy)

    return visit(ast.parse(path_of(module).read_text(encoding="utf-8")), False)


def foreign(module: str) -> set[str]:
    """Imported packages that come neither with Python nor from this house."""
    return {i.package for i in imports(module)} - ROOMS - sys.stdlib_module_names


def rooms_of(module: str) -> set[str]:
    return {i.package for i in imports(module)} & ROOMS


def test_the_reader_of_imports_sees_them_all() -> None:
    seen = set(imports("onboard.__main__"))
    assert Import("argparse", False) in seen
    assert Import("onboard.replay_command", True) in seen
    assert Import("onboard.pipeline", False) in set(imports("onboard.replay"))
    assert Import("onboard.starting", False) in set(imports("onboard.adjustment"))


@pytest.mark.parametrize("module", modules("contract"))
def test_the_contract_imports_nobody(module: str) -> None:
    assert rooms_of(module) <= {"contract"}
    assert foreign(module) <= {"numpy"}


@pytest.mark.parametrize("module", modules("ground"))
def test_the_ground_stands_on_the_contract_alone(module: str) -> None:
    assert rooms_of(module) <= {"contract", "ground"}
    assert {i.package for i in imports(module) if not i.is_lazy} - ROOMS - sys.stdlib_module_names <= {"numpy", "zenoh"}


@pytest.mark.parametrize("module", modules("onboard"))
def test_the_aircraft_knows_neither_ground_nor_simulation(module: str) -> None:
    assert rooms_of(module) <= {"contract", "onboard"}


@pytest.mark.parametrize("module", modules("simulation"))
def test_the_simulation_is_independent_of_what_it_tests(module: str) -> None:
    allowed = {"contract", "simulation"}
    if module.startswith("simulation.study"):  # the seed's error study simulates the estimator itself
        allowed = {*allowed, "onboard"}
    assert rooms_of(module) <= allowed


@pytest.mark.parametrize("module", modules("contract", "ground", "onboard", "simulation"))
def test_no_room_knows_the_demo_or_the_benchmarks(module: str) -> None:
    assert not rooms_of(module) & {"demo", "benchmarks"}


@pytest.mark.parametrize("module", [m for m in modules("onboard") if m not in PLUMBING])
def test_only_the_plumbing_knows_cameras_telemetry_link_and_recording(module: str) -> None:
    room = ".".join(module.split(".")[:2])
    known = {i.name for i in imports(module) for io in IO_ROOMS if i.name == io or i.name.startswith(f"{io}.")}
    assert not {name for name in known if ".".join(name.split(".")[:2]) != room and PART_OF.get(name) != room}
    assert not {i.name for i in imports(module)} & PLUMBING


@pytest.mark.parametrize(
    "module",
    [m for m in modules("onboard") if m not in PLUMBING and ".".join(m.split(".")[:2]) not in IO_ROOMS]
    + modules("contract"),
)
def test_the_mathematics_has_no_sockets_threads_or_command_line(module: str) -> None:
    assert not {i.package for i in imports(module)} & IO_PACKAGES


@pytest.mark.parametrize("program", ["ground.__main__", "ground.client"])
def test_nothing_heavy_is_loaded_by_importing_the_ground(program: str) -> None:
    heavy = "{'cv2', 'scipy', 'mavsdk', 'pymavlink', 'mcap', 'pydantic', 'PIL', 'matplotlib', 'onboard', 'simulation'}"
    check = f"import sys, {program}; print(sorted({heavy} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", check], cwd=HOUSE, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize(
    "file", sorted(p.relative_to(HOUSE) for r in ROOMS for p in (HOUSE / r).rglob("*.py")), ids=str
)
def test_no_file_is_longer_than_one_thing(file: Path) -> None:
    assert len((HOUSE / file).read_text(encoding="utf-8").splitlines()) <= MAX_LINES


def test_every_package_is_installed() -> None:
    """A folder of modules that `pyproject.toml` does not list works in a checkout and is missing once installed."""
    listed = set(tomllib.loads((HOUSE / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"])
    shipped = {"contract", "ground", "onboard", "simulation"}
    found = {".".join(p.parent.relative_to(HOUSE).parts) for r in shipped for p in (HOUSE / r).rglob("*.py")}
    assert listed == found


@pytest.mark.parametrize("module", [m for m in modules("contract", "onboard", "ground") if m.count(".") == 1])
def test_every_room_is_on_the_map(module: str) -> None:
    """docs/architecture.md names each file of the three packages, or the folder that it is in."""
    room = module.split(".")[1]
    text = (HOUSE / "docs" / "architecture.md").read_text(encoding="utf-8")
    assert room == "__init__" or f"`{room}`" in text or f"`{room}/`" in text
