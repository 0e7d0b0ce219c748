"""The lock, for tests: versions by name, and lines that pip checks."""

import sys
from collections.abc import Iterable
from importlib import import_module
from pathlib import Path
from types import ModuleType

PACKAGING = Path(__file__).resolve().parents[1] / "packaging"


def program(name: str) -> ModuleType:
    """Return a module of packaging/, which is a folder of programs and no package."""
    sys.path.insert(0, str(PACKAGING))
    try:
        return import_module(name)
    finally:
        sys.path.remove(str(PACKAGING))


def versions() -> dict[str, str]:
    """Return the locked version of each package, by its normal name."""
    return {name: locked.version for name, locked in program("lock").read().items()}


def lines(names: Iterable[str]) -> str:
    """Return the lock's lines for some packages, hashes and all."""
    lock = program("lock")
    return "".join(f"{lock.read()[name].text}\n" for name in map(lock.normal, names))
